"""Computes the position of agents between guessing (0) and the limit of physics (1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from .tables import Case, Results

Values = npt.NDArray[np.float64]

#: Least difference between the ideal observer's and the blind analyst's score. Below it, the score does not measure seeing.
LEAST_ROOM = 0.005
_DRAWS = 2000


@dataclass(frozen=True)
class Stand:
    """The position of an agent between the blind analyst and the ideal observer.

    Attributes:
        mean: mean score in the cases that all three played.
        skill: (score - blind) / (ideal - blind): 0 is guessing, 1 the limit of physics; NaN if ideal and blind are too close.
        low, high: 95 % interval of the skill (percentiles of 2000 bootstrap draws of cases).
        cases: number of cases. A case is a world with a seed.
    """

    mean: float
    skill: float
    low: float
    high: float
    cases: int


@dataclass(frozen=True)
class Scale:
    """Blind analyst, ideal observer, and the other agents of a task.

    Attributes:
        blind, ideal: names of the two agents, and their means in the cases that both played.
        stands: the positions of all other agents that share a case with both.
    """

    blind: tuple[str, float]
    ideal: tuple[str, float]
    stands: Mapping[str, Stand]

    @property
    def room(self) -> bool:
        """Whether the score distinguishes seeing from guessing."""
        return self.ideal[1] - self.blind[1] >= LEAST_ROOM


def scale(results: Results, task: str, budget: float | None = None) -> Scale | None:
    """Returns the scale of a task; ``None`` if no blind agent and ideal observer have played the same world and seed.

    The best of several blind agents counts, and the best of several ideal observers whose grade is not ``"known"``.
    """
    tables = {agent: results.by_case(agent, task, budget) for agent in results.in_task(task, budget)}
    blind = _best(tables, [name for name in tables if results.role[name] == "blind"])
    ideal = _best(tables, [name for name in tables if results.role[name] == "ideal" and not _knows_image(results, name)])
    if blind is None or ideal is None:
        return None
    common = sorted(set(tables[blind]) & set(tables[ideal]))
    if not common:
        return None
    stands = {}
    for agent, table in tables.items():
        cases = [case for case in common if case in table]
        if agent not in (blind, ideal) and cases:
            own, low, high = (np.array([tables[name][case] for case in cases]) for name in (agent, blind, ideal))
            stands[agent] = _stand(own, low, high)
    return Scale((blind, _mean(tables[blind], common)), (ideal, _mean(tables[ideal], common)), stands)


def _stand(own: Values, blind: Values, ideal: Values) -> Stand:
    def of(weights: Values) -> Values:
        room = weights @ (ideal - blind)
        with np.errstate(divide="ignore", invalid="ignore"):
            found: Values = np.where(room >= LEAST_ROOM, weights @ (own - blind) / room, np.nan)
        return found

    cases = len(own)
    skill = float(of(np.full((1, cases), 1 / cases))[0])
    draws = of(np.random.default_rng(0).multinomial(cases, np.full(cases, 1 / cases), size=_DRAWS) / cases)
    draws = draws[np.isfinite(draws)]
    low, high = np.percentile(draws, [2.5, 97.5]) if len(draws) and math.isfinite(skill) else (math.nan, math.nan)
    return Stand(float(own.mean()), skill, float(low), float(high), cases)


def _best(tables: Mapping[str, Mapping[Case, float]], names: list[str]) -> str | None:
    return max(names, key=lambda name: (float(np.mean(list(tables[name].values()))), name), default=None)


def _knows_image(results: Results, agent: str) -> bool:
    grades = {(row.get("specification") or {}).get("analyst", {}).get("grade") for row in results.rows if row["agent"] == agent}
    return "known" in grades


def _mean(table: Mapping[Case, float], cases: list[Case]) -> float:
    return float(np.mean([table[case] for case in cases]))
