"""Sections of the report page. Each function returns HTML, or an empty text if the results lack the data that it needs."""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from .drawing import Line, coverage, panels
from .paper import AGREEMENT, DISCRETISATION, LATENCY_MS, TRAINED, told
from .tables import ALTERNATIVES, Cell, Results, cell

_METRIC_WORDS = {
    "final_score": "final score",
    "time_to_threshold": "time to 0.8",
    "early_weighted": "early-weighted area",
    "late_weighted": "late-weighted area",
    "half_budget": "area of half the budget",
}
_CURVE_TICKS = {"no dose": 0.0, "whole budget": 1.0}


def summary(results: Results) -> str:
    """Describes the results, and explains the page."""
    rows = results.rows
    experiments = ", ".join(sorted({str(row.get("experiment", "?")) for row in rows}))
    versions = ", ".join(sorted({str(row.get("version", "?")) for row in rows}))
    seeds = len({row["seed"] for row in rows})
    numbers = {"agent": len(results.agents), "task": len(results.tasks), "world": len(results.worlds), "seed": seeds}
    counts = f"{_counted(len(rows), 'episode')}: {', '.join(_counted(count, what) for what, count in numbers.items())}"
    budgets = " and ".join(f"{budget:g}" for budget in results.budgets) if len(results.budgets) < 3 else _range(results.budgets)
    return (
        f'<p class="soft">{html.escape(experiments)}; {counts}; budget {budgets} e/Å²; stemworlds {html.escape(versions)}.</p>'
        "<p>Numbers are DEC-AUC, the area below score over dose, unless a table says otherwise. The <b>floor</b> is an agent that says nothing is "
        "there, the <b>ceiling</b> the same navigators with the truth of "
        f"what they saw. Mean ± standard deviation is over worlds and seeds, at {results.budget:g} e/Å² where nothing else is said.</p>"
    )


def main_table(results: Results) -> str:
    """Tabulates agents by tasks, with the paper's numbers."""
    tasks = [task for task in results.tasks if results.in_task(task)]
    if not tasks:
        return ""
    beside = results.budget == 5000
    lines = []
    for agent in results.agents:
        cells = []
        for task in tasks:
            own = cell(results.values(agent, task), interval=True)
            paper = told(agent, task) if beside else None
            text = "" if own is None else f"<b>{own.mean:.3f}</b> ± {own.deviation:.3f}<br><small>{own.low:.3f} to {own.high:.3f}, n {own.count}</small>"
            if paper is not None:
                mark = "*" if agent in TRAINED and not agent.endswith("+Analyst") else ""
                text += f"<br><small>paper {paper.mean:.3f} ± {paper.deviation:.3f}{mark}</small>"
            cells.append(text)
        lines.append((agent, cells))
    note = "<p>Mean ± standard deviation; below it the bootstrap 95 % interval of the mean (BCa, 10 000 resamples)"
    note += ", and the paper's numbers. Those are of other worlds: a direction, no target. * has a trained analyst in the paper.</p>" if beside else ".</p>"
    return note + _table(results, tasks, lines)


def curves(results: Results) -> str:
    """Draws the mean score against dose, one panel for each agent."""
    out = []
    for number, task in enumerate(results.tasks):
        agents = results.in_task(task)
        if agents:
            lines = [Line(agent, *results.mean_curve(agent, task), results.role[agent]) for agent in agents]
            drawn = panels(lines, np.linspace(0, 1, 50), _CURVE_TICKS, f"{task}, score over dose", f"d{number}")
            out.append(f"<h3>{task}</h3>{drawn}")
    if not out:
        return ""
    return (
        "<p>Blue: the agent's mean score, with the 95 % interval of the mean. Grey: all others; dotted: the floor; dashed: ceilings, where "
        f"they are not far above.</p>{''.join(out)}"
    )


def maps(results: Results) -> str:
    """Draws the tiles that the agents acquired in one world."""
    rows = [row for row in results.rows if row["budget"] == results.budget and row.get("grid") and row.get("tiles")]
    if not rows:
        return ""
    task = next(task for task in results.tasks if any(row["task"] == task for row in rows))
    world = next(world for world in results.worlds if any(row["task"] == task and row["world"] == world for row in rows))
    drawn, episodes = [], 0
    agents = [agent for agent in results.in_task(task) if results.role[agent] == "agent"]
    for agent in agents or results.in_task(task):
        own = [row for row in rows if (row["agent"], row["task"], row["world"]) == (agent, task, world)]
        if own:
            grid = (int(own[0]["grid"][0]), int(own[0]["grid"][1]))
            visits = np.zeros(grid)
            for row in own:
                for place in {tuple(tile) for tile in row["tiles"]}:
                    visits[place] += 1 / len(own)
            episodes = max(episodes, len(own))
            drawn.append(coverage(grid, np.round(visits, 6), agent))
    about = f"<p>{html.escape(world)}, {task}: tiles that were acquired, the darker the more of {episodes} episodes looked there.</p>"
    return about + f'<div class="panels">{"".join(drawn)}</div>'


def worlds(results: Results) -> str:
    """Tabulates agents by worlds, for each task."""
    if len(results.worlds) < 2:
        return ""
    out = []
    for task in results.tasks:
        agents = results.in_task(task)
        there = [world for world in results.worlds if any(results.values(agent, task, world=world) for agent in agents)]
        lines = [(agent, [_mean(results.values(agent, task, world=world)) for world in there]) for agent in agents]
        if lines:
            out.append(f"<h3>{task}</h3>{_table(results, there, lines)}")
    return "".join(out)


def difficulty(results: Results) -> str:
    """Tabulates agents by difficulty."""
    out = []
    for number, task in enumerate(results.tasks):
        found = {agent: results.by_difficulty(agent, task) for agent in results.in_task(task)}
        found = {agent: values for agent, values in found.items() if values}
        if found:
            names = list(dict.fromkeys(name for values in found.values() for name in values))
            lines = [(agent, [_short(cell(values.get(name, []))) for name in names]) for agent, values in found.items()]
            places = np.linspace(0.1, 0.9, len(names))
            drawn = [
                Line(agent, np.array([np.mean(values.get(name, [np.nan])) for name in names]), role=results.role[agent])
                for agent, values in found.items()
            ]
            ticks = dict(zip(names, places.tolist(), strict=True))
            out.append(f"<h3>{task}</h3>{_table(results, names, lines)}{panels(drawn, places, ticks, f'{task} by difficulty', f'h{number}')}")
    return "<p>Of the materials that have worlds of all these difficulties.</p>" + "".join(out) if out else ""


def budgets(results: Results) -> str:
    """Tabulates agents by budget."""
    if len(results.budgets) < 2:
        return ""
    out = []
    names = [f"{budget:g}" for budget in results.budgets]
    logs = np.log10(results.budgets)
    places = (logs - logs[0]) / (logs[-1] - logs[0])
    for number, task in enumerate(results.tasks):
        lines, drawn = [], []
        for agent in results.agents:
            cells = [cell(results.values(agent, task, budget)) for budget in results.budgets]
            if any(cells):
                lines.append((agent, [_short(own) for own in cells]))
                heights = np.array([np.nan if own is None else own.mean for own in cells])
                drawn.append(Line(agent, heights, role=results.role[agent]))
        if lines:
            ticks = {names[0]: 0.0, names[-1]: 1.0}
            out.append(f"<h3>{task}</h3>{_table(results, names, lines)}{panels(drawn, places, ticks, f'{task} by budget', f'b{number}')}")
    return f"<p>DEC-AUC by budget in e/Å²; the axes are logarithmic.</p>{''.join(out)}"


def strict(results: Results) -> str:
    """Tabulates final scores by the paper's rules, by the strict rules, and by column."""
    out = []
    for task in results.tasks:
        lines = []
        for agent in results.in_task(task):
            every = [row.get("scores") or {} for row in results.pick(agent, task)]
            scores = [score for score in every if score.get("strict") is not None or score.get("close") is not None]
            if scores:
                columns = [score["columns"] for score in scores if score.get("columns")]
                found = [cell([score[name] for score in scores if score.get(name) is not None]) for name in ("paper", "close", "strict")]
                found += [cell([own[name] for own in columns if own.get(name) is not None]) for name in ("precision", "recall", "average_precision")]
                lines.append((agent, [_short(own) for own in found]))
        if lines:
            head = ["5 nm, the paper's", "0.1 nm", "strict", "precision", "recall", "average precision"]
            out.append(f"<h3>{task}</h3>{_table(results, head, lines)}")
    if not out:
        return ""
    return (
        "<p>Scores of what was declared last. 5 nm are wider than a tile, so the paper's rule takes almost any guess for a hit. By 0.1 nm "
        "a match is the column itself. Strictly, defects are scored by forecasts of each column: the share of the prior's ignorance that they take "
        "away. Particles have to be right to 0.5 nm. Precision, recall and average precision are by column, of agents that list "
        f"columns.</p>{''.join(out)}"
    )


def pairs(results: Results) -> str:
    """Tabulates paired tests of all agents, as a matrix for each task."""
    out = []
    for task in results.tasks:
        found = {(pair.a, pair.b): pair for pair in results.pairs(task)}
        agents = [agent for agent in results.in_task(task) if any(agent in pair for pair in found)]
        if not agents:
            continue
        body = []
        for row, agent in enumerate(agents[1:], 1):
            cells = []
            for other in agents[:row]:
                pair = found.get((other, agent))
                if pair is None:
                    cells.append("<td></td>")
                    continue
                differ = pair.p_holm < 0.05
                kind, mark = ("differ", " ≠") if differ else ("same", " ≈") if pair.equivalence.equivalent else ("", "")
                if differ and pair.equivalence.equivalent:
                    kind, mark = "same", " ≈≠"
                same = pair.equivalence
                tests = f"Wilcoxon p {pair.p:.3g}, Holm {pair.p_holm:.3g}; TOST p {same.p_low:.3g}, {same.p_high:.3g}; {same.pairs} cases"
                title = html.escape(f"{agent} against {other}: {tests}")
                cells.append(f'<td class="{kind}" title="{title}">{0.0 - same.mean:+.3f}{mark}</td>')
            body.append(f'<tr><th scope="row">{html.escape(agent)}</th>{"".join(cells)}</tr>')
        head = "".join(f'<th scope="col">{html.escape(agent)}</th>' for agent in agents[:-1])
        table = f'<table class="matrix"><thead><tr><td></td>{head}</tr></thead><tbody>{"".join(body)}</tbody></table>'
        out.append(f'<h3>{task}</h3><div class="wide">{table}</div>')
    if not out:
        return ""
    return (
        "<p>Mean difference of DEC-AUC, row minus column, in the worlds and seeds that both played. ≠: the paired Wilcoxon test tells them apart "
        "(p below 0.05 after Holm's correction for the pairs of the task). ≈: equivalent within 0.05 by two one-sided Wilcoxon tests (both p below "
        f"0.05). Without a mark the episodes do not decide. Ceilings are left out. All p values are in the table of pairs beside this page.</p>{''.join(out)}"
    )


def agreement(results: Results) -> str:
    """Tabulates Spearman's rho between DEC-AUC and the other metrics."""
    found = {task: rho for task in results.tasks if (rho := results.agreement(task)) is not None}
    if not found:
        return ""
    lines = []
    for metric in ALTERNATIVES:
        cells = []
        for task, rho in found.items():
            paper = AGREEMENT[metric].get(task)
            own = "no ranks" if math.isnan(rho[metric]) else f"<b>{rho[metric]:.3f}</b>"
            cells.append(own + ("" if paper is None else f"<br><small>paper {paper:.3f}</small>"))
        lines.append((_METRIC_WORDS[metric], cells))
    about = "<p>Spearman's rank correlation of the agents' means by DEC-AUC and by each other metric, without floor and ceilings.</p>"
    return about + _table(None, list(found), lines)


def discretisation(results: Results) -> str:
    """Tabulates the change of DEC-AUC with the number of checkpoints."""
    found = results.discretisation()
    words = [f"from {a} to {b}: {found[a, b]:.4f} (paper {DISCRETISATION[a, b]:.4f})" for a, b in found]
    return f"<p>The most that DEC-AUC of an episode changes with the number of checkpoints, {'; '.join(words)}. 50 are used.</p>"


def latency(results: Results) -> str:
    """Tabulates times of episodes and tiles."""
    lines = []
    for agent in results.agents:
        times = [row["wall"] for row in results.rows if row["agent"] == agent and row.get("wall")]
        if times:
            seconds = [time["seconds"] for time in times]
            tile = float(np.median([time["seconds_per_tile"] for time in times])) * 1e3
            paper = f"{LATENCY_MS[agent]:.0f}" if agent in LATENCY_MS else ""
            lines.append((agent, [str(len(times)), f"{np.mean(seconds):.2f}", f"{np.median(seconds):.2f}", f"{tile:.1f}", paper]))
    head = ["episodes", "mean s", "median s", "median ms a tile", "paper, ms a tile"]
    return "<p>Of whole episodes on the machine that ran them: world, agent, scores.</p>" + _table(results, head, lines) if lines else ""


def faults(results: Results) -> str:
    """Lists failed episodes, and counts unreadable reports."""
    lines = []
    for agent in [*results.agents, *sorted({row["agent"] for row in results.failures} - set(results.agents))]:
        rows = [row for row in results.rows if row["agent"] == agent]
        ended = Counter(str(row.get("ended")) for row in rows)
        notes: Counter[str] = Counter()
        for row in rows:
            notes.update({name: count for name, count in (row.get("notes") or {}).items() if count})
        failed = sum(row["agent"] == agent for row in results.failures)
        unreadable = sum(int(row.get("unreadable") or 0) for row in rows)
        counted = ", ".join(f"{name.replace('_', ' ')} {count:g}" for name, count in sorted(notes.items()))
        ends = [str(ended[how]) for how in ("done", "refused", "horizon")]
        lines.append((agent, [str(len(rows)), str(failed), str(unreadable), *ends, html.escape(counted)]))
    head = ["episodes", "failed", "unreadable reports", "ended themselves", "refused", "by the horizon", "counted by the agent"]
    out = _table(results, head, lines)
    kinds = Counter(str(row["error"]).partition(": ")[2] for row in results.failures)
    if kinds:
        out += "<ul>" + "".join(f"<li>{count} x {html.escape(error)}</li>" for error, count in sorted(kinds.items())) + "</ul>"
    return out


def _short(own: Cell | None) -> str:
    return "" if own is None else f"{own.mean:.3f} <small>± {own.deviation:.3f}</small>"


def _mean(values: Sequence[float]) -> str:
    return f"{np.mean(values):.3f}" if values else ""


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _range(values: Sequence[float]) -> str:
    return f"{values[0]:g} to {values[-1]:g} ({len(values)} of them)"


def _table(results: Results | None, head: Sequence[str], lines: Iterable[tuple[str, Sequence[str]]]) -> str:
    """Returns a table. Names are escaped; cells are HTML already."""
    columns = "".join(f'<th scope="col">{html.escape(name)}</th>' for name in head)
    body = []
    for name, cells in lines:
        role = "agent" if results is None else results.role.get(name, "agent")
        mark = "" if role == "agent" else f' <i class="role">{role}</i>'
        body.append(f'<tr class="{role}"><th scope="row">{html.escape(name)}{mark}</th>{"".join(f"<td>{text}</td>" for text in cells)}</tr>')
    return f'<div class="wide"><table><thead><tr><td></td>{columns}</tr></thead><tbody>{"".join(body)}</tbody></table></div>'
