"""Makes the first lines of the report page: the position of each agent between blind analyst and ideal observer."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

import numpy as np

from .results import Row
from .sections import _table
from .skill import LEAST_ROOM, Scale, scale
from .tables import Results


def first_lines(results: Results) -> str:
    """Returns one sentence for each task."""
    said = []
    for task in results.tasks:
        found = scale(results, task)
        if found is None:
            continue
        (blind, low), (ideal, high) = found.blind, found.ideal
        line = f"<b>{html.escape(task)}</b>: blind {low:.3f} ({html.escape(blind)}), ideal {high:.3f} ({html.escape(ideal)})"
        if not found.room:
            said.append(f"{line}. They are nearer than {LEAST_ROOM:g} to each other: this score does not tell seeing from guessing.")
            continue
        agents = [name for name in found.stands if results.role[name] == "agent"]
        ranked = sorted(agents, key=lambda name: (-found.stands[name].skill, name))
        stands = ", ".join(f"{html.escape(name)} {found.stands[name].skill:.0%}" for name in ranked)
        said.append(f"{line}. Of the way from blind to ideal: {stands}." if ranked else f"{line}. No other agent played the same worlds and seeds.")
    if not said:
        return (
            "<p><b>What is seen and what is guessed is not known</b>: no blind agent (<code>Prior</code>) and ideal observer (<code>Ideal</code>) played "
            "the same worlds and seeds. Add both to the experiment.</p>"
        )
    lines = "".join(f"<li>{line}</li>" for line in said)
    return f"<p>A <b>blind</b> agent knows the usual specimens and reads no pixel. The <b>ideal</b> observer knows what the counts tell, and no more.</p><ul>{lines}</ul>"


def seeing(results: Results) -> str:
    """Tabulates skill, bits, average precision and counts for each task."""
    out = []
    for task in results.tasks:
        found = scale(results, task)
        rows = {agent: [row for row in results.pick(agent, task) if (row.get("scores") or {}).get("forecasts")] for agent in results.in_task(task)}
        if found is None and not any(rows.values()):
            continue
        sigma = _sigmas(results, rows)
        lines = [(agent, [*_stand_cells(found, agent), *_bit_cells(rows[agent], sigma)]) for agent in results.in_task(task)]
        head = ["mean DEC-AUC", "skill", "bits a column", "bits a million electrons", "average precision over the prior's", "error of the count, ideal sigmas"]
        out.append(f"<h3>{html.escape(task)}</h3>{_table(results, head, lines)}")
    if not out:
        return ""
    return (
        "<p>Skill = (score - blind) / (ideal - blind), of means over the worlds and seeds that all three played, with its 95 % interval: 0 is "
        "guessing, 1 is what physics allows. Bits are gained over the prior by the last forecasts of an episode; agents that give no chances gain "
        "none. The error of the count is that of all defects seen, root mean square, in units of the ideal observer's standard "
        f"deviation.</p>{''.join(out)}"
    )


def _stand_cells(found: Scale | None, agent: str) -> list[str]:
    if found is None:
        return ["", ""]
    for role, (name, mean) in (("blind", found.blind), ("ideal", found.ideal)):
        if name == agent:
            return [f"{mean:.3f}", ("0" if role == "blind" else "1") if found.room else "no room"]
    stand = found.stands.get(agent)
    if stand is None:
        return ["", ""]
    skill = "no room" if math.isnan(stand.skill) else f"<b>{stand.skill:.2f}</b><br><small>{stand.low:.2f} to {stand.high:.2f}, n {stand.cases}</small>"
    return [f"{stand.mean:.3f}", skill]


def _sigmas(results: Results, rows: dict[str, list[Row]]) -> dict[tuple[str, int], float]:
    """Returns the ideal observer's standard deviation of the count, by world and seed."""
    found: dict[tuple[str, int], float] = {}
    for agent, own in rows.items():
        if results.role[agent] == "ideal":
            for row in own:
                found.setdefault((row["world"], row["seed"]), float(row["scores"]["forecasts"]["count_sigma"]))
    return found


def _bit_cells(rows: Sequence[Row], sigma: dict[tuple[str, int], float]) -> list[str]:
    if not rows:
        return ["", "", "", ""]
    scores = [row["scores"]["forecasts"] for row in rows]
    means = [float(np.mean([score[name] for score in scores])) for name in ("bits_per_column", "bits_per_million_electrons", "average_precision_gain")]
    errors = [row["scores"]["forecasts"]["count_error"] / sigma[row["world"], row["seed"]] for row in rows if sigma.get((row["world"], row["seed"]), 0.0) > 0]
    error = f"{math.sqrt(float(np.mean(np.square(errors)))):.2f}" if errors else ""
    return [f"{means[0]:.4f}", f"{means[1]:.2f}", f"{means[2]:+.3f}", error]
