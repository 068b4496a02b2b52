"""Writes the report page of results, and its tables as CSV."""

from __future__ import annotations

import csv
import errno
import html
import io
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .._text import table_cell
from ..errors import DiskFull, FileError, _invalid
from . import field_sections, sections, seeing
from .paper import told
from .tables import ALTERNATIVES, Results, cell, files, ranking

__all__ = ["leaderboard", "write_report"]

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


class _Section(NamedTuple):
    """A section of the page. ``make`` returns its HTML, or an empty text if the results lack the data that ``needs`` names."""

    title: str
    make: Callable[[Results], str]
    needs: str


_SECTIONS = (
    _Section("Seeing and guessing", seeing.seeing, "a blind agent and an ideal observer in the same world and seed, or forecasts"),
    _Section("The field", field_sections.field, "tasks that ask for the field"),
    _Section("Agents and tasks", sections.main_table, "an episode at the main budget"),
    _Section("Score over dose", sections.curves, "an episode at the main budget"),
    _Section("Where agents looked", sections.maps, "the grid of a world"),
    _Section("World by world", sections.worlds, "two worlds or more"),
    _Section("Easy, medium, hard", sections.difficulty, "materials with worlds of two difficulties or more"),
    _Section("Budgets", sections.budgets, "two budgets or more"),
    _Section("Strict scores", sections.strict, "scores by the strict rules"),
    _Section("Which agents differ", sections.pairs, "two agents with five worlds and seeds in common"),
    _Section("Other metrics", sections.agreement, "three agents or more in a task"),
    _Section("Checkpoints", sections.discretisation, "an episode"),
    _Section("Time", sections.latency, "times of episodes"),
    _Section("What went wrong", sections.faults, "an episode"),
)


def write_report(results: Paths, out: str | os.PathLike[str]) -> list[Path]:
    """Writes a self-contained page, and three tables beside it, whose names end in ``-agents.csv``, ``-episodes.csv`` and ``-pairs.csv``.

    The same results give the same bytes.

    Args:
        results: one or several files of results.
        out: the page; its name ends in ``.html``.

    Returns:
        The files that were written.

    Raises:
        FileMissing, FormatError: for a file that is missing, or contains no results.
        InvalidValue: for results that contradict each other, for example one name for two agents.
        DiskFull, FileError: if a file cannot be written. Existing files are then unchanged.
    """
    page = Path(out)
    if page.suffix != ".html":
        raise _invalid("out", f"{page}: expected a name that ends in .html")
    read = Results(files(results))
    made = {
        page: _page(read, page.stem),
        page.with_name(f"{page.stem}-agents.csv"): _agents_csv(read),
        page.with_name(f"{page.stem}-episodes.csv"): _episodes_csv(read),
        page.with_name(f"{page.stem}-pairs.csv"): _pairs_csv(read),
    }
    _write(made)
    return list(made)


def _write(made: Mapping[Path, str]) -> None:
    """Writes all files or none: under temporary names first, then all are renamed."""
    aside = {path: path.with_name(f".{path.name}.{os.getpid()}.partial") for path in made}
    path = next(iter(made))
    try:
        for path, text in made.items():
            with open(aside[path], "w", encoding="utf-8", newline="\n") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
        for path in made:
            os.replace(aside[path], path)
    except OSError as error:
        kind = DiskFull if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG) else FileError
        raise kind(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        for left in aside.values():
            left.unlink(missing_ok=True)


def leaderboard(results: Paths) -> list[dict[str, Any]]:
    """Ranks the agents of each task and budget, in the worlds and seeds that all of them played.

    Returns:
        One dict for each task and budget, with ``task``, ``budget``, ``note`` and ``agents``. The entries of ``agents``, the best first,
        have ``rank``, ``agent``, ``role`` (floor, blind, agent, ideal, ceiling), ``mean`` and ``deviation`` of DEC-AUC, ``interval`` (95 %,
        bootstrap), ``of_the_way`` from floor to ceiling, ``skill`` from blind to ideal, and ``episodes``.
    """
    read = Results(files(results))
    tables = (ranking(read, task, budget) for task in read.tasks for budget in read.budgets)
    return [table for table in tables if table is not None]


def _page(results: Results, name: str) -> str:
    body, left = [], []
    for number, section in enumerate(_SECTIONS):
        made = section.make(results)
        if made:
            body.append(f'<section id="s{number}"><h2>{section.title}</h2>{made}</section>')
        else:
            left.append(f"{section.title.lower()} (needs {section.needs})")
    if left:
        body.append(f"<p>Left out, since these results do not hold what they need: {'; '.join(left)}.</p>")
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(name)}</title><style>{_STYLE}</style></head><body><main>
<h1>{html.escape(name)}</h1>
{seeing.first_lines(results)}
{sections.summary(results)}
{"".join(body)}
</main></body></html>
"""


def _csv(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([f"{value:.6g}" if isinstance(value, float) else table_cell(value) for value in row] for row in rows)
    return text.getvalue()


def _agents_csv(results: Results) -> str:
    rows = []
    for task in results.tasks:
        for budget in results.budgets:
            for agent in results.in_task(task, budget):
                own = cell(results.values(agent, task, budget), interval=True)
                assert own is not None, "the agent is in the task"
                paper = told(agent, task) if budget == results.budget else None
                numbers = (own.count, own.mean, own.deviation, own.low, own.high)
                rows.append([task, budget, agent, results.role[agent], *numbers, *(paper or ("", ""))])
    head = "task,budget,agent,role,episodes,dec_auc_mean,dec_auc_std,ci95_low,ci95_high,paper_mean,paper_std"
    return _csv(head.split(","), rows)


def _episodes_csv(results: Results) -> str:
    head = ["task", "budget", "agent", "world", "recipe", "difficulty", "seed", "dec_auc", *ALTERNATIVES, "strict_final"]
    head += ["tiles", "ended", "unreadable", "seconds", "ms_per_tile"]
    rows = []
    for row in results.rows:
        metrics, wall = row["metrics"], row.get("wall") or {}
        strict = (row.get("scores") or {}).get("strict")
        names = [row["task"], row["budget"], row["agent"], row["world"], row.get("recipe", ""), row.get("difficulty", ""), row["seed"]]
        numbers = [metrics["dec_auc"], *(metrics[name] for name in ALTERNATIVES), "" if strict is None else strict]
        ends = [len(row.get("tiles", ())), row.get("ended", ""), row.get("unreadable", 0)]
        rows.append([*names, *numbers, *ends, wall.get("seconds", ""), 1e3 * wall.get("seconds_per_tile", float("nan"))])
    return _csv(head, rows)


def _pairs_csv(results: Results) -> str:
    head = "task,budget,a,b,cases,mean_difference,std_difference,p_wilcoxon,p_wilcoxon_holm,margin,p_low,p_high,equivalent"
    rows = []
    for task in results.tasks:
        for pair in results.pairs(task):
            same = pair.equivalence
            numbers = [same.pairs, same.mean, same.deviation, pair.p, pair.p_holm, same.margin, same.p_low, same.p_high]
            rows.append([task, results.budget, pair.a, pair.b, *numbers, "yes" if same.equivalent else "no"])
    return _csv(head.split(","), rows)


_STYLE = """
:root{color-scheme:light dark;--paper:#fff;--ink:#1b1e23;--soft:#646b76;--rule:#d9dde3;--field:#f3f5f7;--own:#1f6fd6;--other:#b9c0ca;
--good:#dff1e4;--bad:#fbe3df}
@media (prefers-color-scheme:dark){:root{--paper:#15181c;--ink:#e6e8eb;--soft:#9aa3af;--rule:#333941;--field:#1f242a;--own:#6aa9ff;
--other:#4b535e;--good:#1d3a28;--bad:#4a2622}}
body{margin:0;background:var(--paper);color:var(--ink);font:15px/1.5 system-ui,sans-serif}
main{max-width:1180px;margin:0 auto;padding:24px 20px 60px}
h1{font-size:24px;margin:0 0 8px}h2{font-size:19px;margin:40px 0 8px;border-top:1px solid var(--rule);padding-top:20px}h3{font-size:15px;margin:22px 0 6px}
p{max-width:76ch;margin:6px 0 12px}.soft,small{color:var(--soft)}small{font-size:12px}
.wide{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:14px}
th,td{padding:5px 12px 5px 0;text-align:left;vertical-align:top;border-bottom:1px solid var(--rule);white-space:nowrap}
thead th{font-weight:600;color:var(--soft);font-size:13px;white-space:normal}tbody th{font-weight:500;padding-right:20px}
tr.floor th,tr.blind th,tr.ideal th,tr.ceiling th{color:var(--soft)}i.role{font-style:normal;font-size:11px;color:var(--soft);border:1px solid var(--rule);
border-radius:8px;padding:0 6px}
table.matrix{font-size:12px}table.matrix td,table.matrix th{padding:3px 6px}td.same{background:var(--good)}td.differ{background:var(--bad)}
table.matrix thead th{writing-mode:vertical-rl;transform:rotate(180deg);vertical-align:bottom;padding:6px 3px}
.panels{display:grid;grid-template-columns:repeat(auto-fill,minmax(210px,1fr));gap:14px 18px;margin:10px 0}
figure{margin:0}figcaption{font-size:13px;margin-bottom:2px}svg{display:block;width:100%;height:auto}svg.shared{position:absolute;width:0;height:0}
.tick{font:10px system-ui,sans-serif;fill:var(--soft)}.axis{fill:none;stroke:var(--soft);stroke-width:.8}.grid{fill:none;stroke:var(--rule);stroke-width:.6}
.other,.floor,.blind,.ideal,.ceiling{fill:none}.other{stroke:var(--other);stroke-width:.9}path.floor,path.blind,path.ideal,path.ceiling{stroke:var(--soft);stroke-width:1.1;stroke-dasharray:4 3}
path.floor{stroke-dasharray:1.5 2.5}.own{fill:none;stroke:var(--own);stroke-width:2}.band{fill:var(--own);fill-opacity:.2}.dot{fill:var(--own)}
.map{background:var(--field)}.field{fill:none}.tile{fill:var(--own)}
"""
