"""Makes the section of the report page about the tasks of the whole field."""

from __future__ import annotations

import html

import numpy as np

from .results import Row
from .sections import _table
from .statistics import bootstrap_interval
from .tables import Results, cell

#: The columns of the table: key of ``scores["field"]``, heading, digits.
_SHOWN = (
    ("recall", "share of all defects looked at", 3),
    ("area_seen", "share of the tiles", 3),
    ("precision_at_k", "columns named that hold a defect", 3),
    ("defects_at_k", "their defects over those of the best", 3),
    ("map_bits_per_tile", "bits of the map an unseen tile", 3),
    ("rare_found", "rare clusters found", 2),
)


def field(results: Results) -> str:
    """Returns the section: the results of the agents by task and world."""
    out = []
    for task in results.tasks:
        rows = {agent: [row for row in results.pick(agent, task) if (row.get("scores") or {}).get("field")] for agent in results.in_task(task)}
        for world in results.worlds:
            lines = []
            for agent, every in rows.items():
                own = [row for row in every if row["world"] == world]
                if own:
                    lines.append((agent, [*(_shown(own, name, digits) for name, _, digits in _SHOWN), _times_raster(agent, rows, world)]))
            if lines:
                out.append(f"<h3>{html.escape(task)}, {html.escape(world)}</h3>{_table(results, [*(head for _, head, _ in _SHOWN), 'recall over raster'], lines)}")
    if not out:
        return ""
    return (
        "<p>At the end of an episode, means over seeds, with the bootstrap 95 % interval of the mean for three seeds or more. Recall says where an agent looked. Of the columns that it names, the hundred "
        "likeliest count; a hundred named at random hold as often a defect as columns do. A map is scored in the tiles that nobody looked at, in bits over the prior's mean rate, the same everywhere. The "
        f"last column is the mean ratio of the recall to that of the first agent that looks row by row, in the same specimens.</p>{''.join(out)}"
    )


def _shown(rows: list[Row], name: str, digits: int) -> str:
    values = [float(row["scores"]["field"][name]) for row in rows if row["scores"]["field"].get(name) is not None]
    own = cell(values)
    if own is None:
        return ""
    text = f"{own.mean:.{digits}f}"
    if own.count > 2 and own.deviation > 0:
        low, high = bootstrap_interval(np.array(values))
        text += f"<br><small>{low:.{digits}f} to {high:.{digits}f}</small>"
    return text


def _times_raster(agent: str, rows: dict[str, list[Row]], world: str) -> str:
    """Returns the mean over seeds of the agent's recall divided by the raster's recall for the same seed."""
    raster = next((name for name, own in rows.items() if own and ((own[0].get("specification") or {}).get("navigator") or {}).get("kind") == "raster"), None)
    if raster is None or raster == agent:
        return ""
    base = {row["seed"]: float(row["scores"]["field"]["recall"]) for row in rows[raster] if row["world"] == world}
    ratios = [float(row["scores"]["field"]["recall"]) / base[row["seed"]] for row in rows[agent] if row["world"] == world and base.get(row["seed"], 0.0) > 0]
    if not ratios:
        return ""
    text = f"{float(np.mean(ratios)):.2f}"
    if len(ratios) > 2 and float(np.ptp(ratios)) > 0:
        low, high = bootstrap_interval(np.array(ratios))
        text += f"<br><small>{low:.2f} to {high:.2f}</small>"
    return text
