"""Computes the numbers of reports from results."""

from __future__ import annotations

import itertools
import math
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..errors import _invalid
from .catalogue import agent_names
from .experiments import TASKS
from .results import METRICS, Row, read_failures, read_results
from .skill import Scale, scale
from .statistics import Equivalence, bootstrap_interval, dec_auc, on_checkpoints, paired_wilcoxon, rank_agreement, tost

Values = npt.NDArray[np.float64]
#: An agent that declares nothing; an agent that reads no pixel; other agents; the ideal observer; agents that know the truth.
Role = Literal["floor", "blind", "agent", "ideal", "ceiling"]
Case = tuple[str, int]
ROLES: tuple[Role, ...] = ("floor", "blind", "agent", "ideal", "ceiling")

DIFFICULTIES = ("easy", "medium", "hard")
#: The metrics except DEC-AUC.
ALTERNATIVES = METRICS[1:]
PAPER_BUDGET = 5000.0


@dataclass(frozen=True)
class Cell:
    """Summary of values: number, mean, sample standard deviation, and optionally the 95 % bootstrap interval of the mean."""

    count: int
    mean: float
    deviation: float
    low: float
    high: float


def cell(values: Sequence[float] | Values, *, interval: bool = False) -> Cell | None:
    """Summarises values. Returns ``None`` for no values."""
    data = np.asarray(values, dtype=np.float64)
    if data.size == 0:
        return None
    low, high = bootstrap_interval(data) if interval else (float("nan"), float("nan"))
    return Cell(data.size, float(data.mean()), float(data.std(ddof=1)) if data.size > 1 else 0.0, low, high)


@dataclass(frozen=True)
class Pair:
    """Comparison of two agents in the cases that both played.

    Attributes:
        a, b: names of the agents.
        p: two-sided p of the paired Wilcoxon test; ``p_holm`` is corrected for the number of pairs of the task.
        equivalence: result of the two one-sided tests.
    """

    a: str
    b: str
    p: float
    p_holm: float
    equivalence: Equivalence


class Results:
    """Rows of results, sorted, so that the order of the files does not matter."""

    def __init__(self, paths: Iterable[str | os.PathLike[str]]) -> None:
        rows: dict[str, Row] = {}
        failures: dict[str, Row] = {}
        for path in paths:
            rows.update({row["key"]: row for row in read_results(path)})
            failures.update({row["key"]: row for row in read_failures(path)})
        self.rows: list[Row] = sorted(rows.values(), key=_place)
        self.failures: list[Row] = sorted((row for key, row in failures.items() if key not in rows), key=_place)
        self._check()
        self._by: dict[tuple[str, str, float], list[Row]] = {}
        for row in self.rows:
            self._by.setdefault((row["agent"], row["task"], row["budget"]), []).append(row)
        self.role: dict[str, Role] = {row["agent"]: _role(row) for row in self.rows}
        self.agents: list[str] = sorted(self.role, key=lambda name: _agent_place(name, self.role[name]))
        self.tasks: list[str] = sorted({row["task"] for row in self.rows}, key=_task_place)
        self.budgets: list[float] = sorted({row["budget"] for row in self.rows})
        self.worlds: list[str] = list(dict.fromkeys(row["world"] for row in sorted(self.rows, key=_world_place)))
        common = Counter(row["budget"] for row in self.rows)
        self.budget: float = PAPER_BUDGET if PAPER_BUDGET in common else max(common, key=lambda budget: (common[budget], -budget))

    def _check(self) -> None:
        """Checks that each name of an agent has one specification, and that all rows have the same options of the environment."""
        for key, what in (("agent", "specification"), ("", "environment")):
            seen: dict[str, Any] = {}
            for row in self.rows:
                name = str(row[key]) if key else ""
                known = seen.setdefault(name, row.get(what))
                if known != row.get(what):
                    which = f"agent {name!r} is of two kinds" if key else "they are of environments with different options"
                    raise _invalid("results", f"these results do not go together: {which} ({known} and {row.get(what)}); report them apart")

    def pick(self, agent: str, task: str, budget: float | None = None) -> list[Row]:
        """Returns the rows of an agent in a task, sorted by world and seed."""
        return self._by.get((agent, task, self.budget if budget is None else budget), [])

    def values(self, agent: str, task: str, budget: float | None = None, *, world: str | None = None, metric: str = "dec_auc") -> list[float]:
        """Returns a metric of each row."""
        return [row["metrics"][metric] for row in self.pick(agent, task, budget) if world in (None, row["world"])]

    def by_case(self, agent: str, task: str, budget: float | None = None) -> dict[Case, float]:
        """Returns DEC-AUC by world and seed."""
        return {(row["world"], row["seed"]): row["metrics"]["dec_auc"] for row in self.pick(agent, task, budget)}

    def in_task(self, task: str, budget: float | None = None) -> list[str]:
        """Returns the agents that played a task."""
        return [agent for agent in self.agents if self.pick(agent, task, budget)]

    def mean_curve(self, agent: str, task: str) -> tuple[Values, Values, Values]:
        """Returns the mean of the curves at 50 checkpoints, and the ends of its 95 % interval (percentiles of 1000 bootstrap means)."""
        curves = np.array([on_checkpoints(row["curve"]) for row in self.pick(agent, task)])
        draws = np.random.default_rng(0).multinomial(len(curves), np.full(len(curves), 1 / len(curves)), size=1000)
        low, high = np.percentile(draws @ curves / len(curves), [2.5, 97.5], axis=0)
        return curves.mean(axis=0), low, high

    def pairs(self, task: str) -> list[Pair]:
        """Compares all pairs of agents that share at least five cases, without ideal observers and ceilings."""
        tables = {agent: self.by_case(agent, task) for agent in self.in_task(task) if self.role[agent] not in ("ideal", "ceiling")}
        found = []
        for a, b in itertools.combinations(tables, 2):
            cases = [case for case in tables[a] if case in tables[b]]
            if len(cases) >= 5:
                first, second = ([tables[name][case] for case in cases] for name in (a, b))
                found.append((a, b, paired_wilcoxon(first, second), tost(first, second)))
        corrected = holm([p for *_, p, _ in found])
        return [Pair(a, b, p, q, equal) for (a, b, p, equal), q in zip(found, corrected, strict=True)]

    def agreement(self, task: str) -> dict[str, float] | None:
        """Returns Spearman's rho between the agents' means of DEC-AUC and of each other metric; ``None`` for fewer than three agents.

        Floor and ceilings are excluded, since all metrics rank them at the ends.
        """
        agents = [agent for agent in self.in_task(task) if self.role[agent] == "agent"]
        if len(agents) < 3:
            return None
        means = {
            metric: [float(np.mean(self.values(agent, task, metric=metric))) for agent in agents] for metric in ("dec_auc", *ALTERNATIVES)
        }
        # A short time is good, while for the other metrics a large value is good.
        means["time_to_threshold"] = [-value for value in means["time_to_threshold"]]
        return {metric: rank_agreement(np.round(means["dec_auc"], 9), np.round(means[metric], 9)) for metric in ALTERNATIVES}

    def discretisation(self) -> dict[tuple[int, int], float]:
        """Returns the largest change of an episode's DEC-AUC from one number of checkpoints to another."""
        areas = {count: np.array([dec_auc(row["curve"], count) for row in self.rows]) for count in (20, 50, 100)}
        return {pair: float(np.abs(areas[pair[0]] - areas[pair[1]]).max()) for pair in ((20, 50), (50, 100))}

    def by_difficulty(self, agent: str, task: str) -> dict[str, list[float]]:
        """Returns DEC-AUC by difficulty, for the materials with results in all difficulties."""
        found: dict[str, dict[str, list[float]]] = {}
        for row in self.pick(agent, task):
            if row.get("difficulty") in DIFFICULTIES:
                material, level = str(row.get("recipe", row["world"])), str(row["difficulty"])
                found.setdefault(material, {}).setdefault(level, []).append(row["metrics"]["dec_auc"])
        every = {difficulty for values in found.values() for difficulty in values}
        whole = [values for values in found.values() if values.keys() == every]
        if len(every) < 2 or not whole:
            return {}
        return {name: [value for values in whole for value in values[name]] for name in DIFFICULTIES if name in every}


def holm(p: Sequence[float]) -> list[float]:
    """Applies Holm's correction for the number of tests."""
    out = [1.0] * len(p)
    least = 0.0
    for rank, index in enumerate(sorted(range(len(p)), key=lambda n: p[n])):
        least = max(least, min(1.0, (len(p) - rank) * p[index]))
        out[index] = least
    return out


def ranking(results: Results, task: str, budget: float) -> dict[str, Any] | None:
    """Ranks the agents of a task by their means, in the cases that all of them played."""
    tables = {agent: results.by_case(agent, task, budget) for agent in results.in_task(task, budget)}
    if not tables:
        return None
    cases = set.intersection(*(set(table) for table in tables.values()))
    every = set.union(*(set(table) for table in tables.values()))
    note = ""
    if not cases:
        note = "the agents have no world and seed in common: these numbers are of different episodes"
    elif len(cases) < len(every):
        note = f"of {len(every)} worlds and seeds the {len(cases)} that all agents played"
    means: dict[str, Cell] = {}
    for agent, table in tables.items():
        chosen = sorted(cases) if cases else sorted(table)
        made = cell([table[case] for case in chosen], interval=True)
        assert made is not None, "each agent has a row"
        means[agent] = made
    floor = max((means[agent].mean for agent in means if results.role[agent] == "floor"), default=None)
    ceiling = max((means[agent].mean for agent in means if results.role[agent] == "ceiling"), default=None)
    between = scale(results, task, budget)
    lines, rank = [], 0
    for agent in sorted(means, key=lambda name: (-means[name].mean, name)):
        own, role = means[agent], results.role[agent]
        rank += role == "agent"
        known = floor is not None and ceiling is not None and ceiling > floor
        way = (own.mean - floor) / (ceiling - floor) if known and floor is not None and ceiling is not None else None
        lines.append(
            {
                "rank": rank if role == "agent" else None,
                "agent": agent,
                "role": role,
                "mean": own.mean,
                "deviation": own.deviation,
                "interval": [own.low, own.high],
                "of_the_way": way,
                "skill": _skill(between, agent),
                "episodes": own.count,
            }
        )
    return {"task": task, "budget": budget, "agents": lines, "note": note}


def _skill(between: Scale | None, agent: str) -> float | None:
    if between is None or not between.room:
        return None
    if agent in (between.blind[0], between.ideal[0]):
        return float(agent == between.ideal[0])
    stand = between.stands.get(agent)
    return None if stand is None or math.isnan(stand.skill) else stand.skill


def files(paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Returns a list of paths from one path or several."""
    return [Path(paths)] if isinstance(paths, str | os.PathLike) else [Path(path) for path in paths]


def _role(row: Row) -> Role:
    specification = row.get("specification", {})
    analyst = specification.get("analyst", {}).get("kind")
    if (specification.get("navigator") or {}).get("kind") == "truth":
        return "ceiling"
    # Files of older versions contain agents with the analyst "columns", which know the columns with defects.
    roles: dict[Any, Role] = {"nothing": "floor", "prior": "blind", "ideal": "ideal", "oracle": "ceiling", "columns": "ceiling"}
    return roles.get(analyst, "agent")


def _agent_place(name: str, role: Role) -> tuple[Any, ...]:
    known = agent_names()
    return ROLES.index(role), known.index(name) if name in known else len(known), name


def _task_place(task: str) -> tuple[bool, int]:
    return task.endswith("-strict"), list(TASKS).index(task.removesuffix("-strict"))


def _world_place(row: Row) -> tuple[Any, ...]:
    difficulty = row.get("difficulty")
    return str(row.get("recipe", "~")), DIFFICULTIES.index(difficulty) if difficulty in DIFFICULTIES else -1, str(row["world"])


def _place(row: Row) -> tuple[Any, ...]:
    return row["task"], row["budget"], row["agent"], *_world_place(row), row["seed"], row["key"]
