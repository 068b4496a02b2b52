"""The parts of an agent: navigators, analysts and planners are objects with the methods below."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from .episodes import Acquired, FieldFacts
    from .findings import Findings

__all__ = ["Analyst", "Look", "Navigator", "Plan", "Planner", "Seen"]


class Look(NamedTuple):
    """The next acquisition: a tile of the grid, the zoom, and the dose in units of the reference dose."""

    row: int
    column: int
    zoom: float = 1.0
    dose: float = 1.0


class Plan(NamedTuple):
    """The decision of a planner: ``mode`` for the record, ``beta`` for navigators that explore, ``end`` to end the episode."""

    mode: str
    beta: float | None = None
    end: bool = False


@dataclass(eq=False)
class Seen:
    """The knowledge of an agent during an episode.

    Attributes:
        field: the facts of the field: grid, sizes, phases, task, budget.
        tiles: acquisitions so far, in order.
        findings: the analyst's findings in these tiles; ``None`` before the first acquisition.
        dose_left: remaining share of the budget.
        plan: the last plan; ``None`` without a planner.
        uncertainty_of: the analyst's method ``uncertainty``, which returns one number for each acquisition; ``None`` if it has none.
        counts_of: the analyst's method ``tile_counts``, which returns the number of defects in each tile and its standard deviation;
            ``None`` if it has none.
    """

    field: FieldFacts
    tiles: list[Acquired] = dataclasses.field(default_factory=list)
    findings: Findings | None = None
    dose_left: float = 1.0
    plan: Plan | None = None
    uncertainty_of: Callable[[Sequence[Acquired]], npt.NDArray[np.float64]] | None = None
    counts_of: Callable[[Sequence[Acquired]], npt.NDArray[np.float64]] | None = None

    def visited(self) -> npt.NDArray[np.bool_]:
        """Returns a mask of the acquired tiles, [row, column]."""
        grid = np.zeros(self.field.grid, dtype=bool)
        for tile in self.tiles:
            grid[tile.row, tile.column] = True
        return grid

    def coverage(self) -> float:
        """Returns the share of the tiles that were acquired."""
        return float(self.visited().mean())

    def defects(self) -> int:
        """Returns the number of defects in the findings."""
        if self.findings is None:
            return 0
        if self.findings.counts is not None:
            return int(sum(self.findings.counts.values()))
        return sum(len(np.asarray(places)) for places in (self.findings.defects or {}).values())


@runtime_checkable
class Navigator(Protocol):
    """Chooses the next acquisition."""

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        """Begins an episode. All random numbers come from ``random``."""

    def choose(self, seen: Seen) -> Look | None:
        """Returns the next acquisition; ``None`` if no tile is left."""


@runtime_checkable
class Analyst(Protocol):
    """Analyses the tiles.

    An analyst may have three further methods. ``uncertainty(tiles)`` returns one number for each tile, for navigators that choose uncertain
    places. ``tile_counts(tiles)`` returns the number of defects in each tile and its standard deviation, (N, 2), for navigators that choose
    places with many defects. ``notes()`` returns a dict of numbers for the record of the episode.
    """

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        """Begins an episode."""

    def findings(self, tiles: Sequence[Acquired]) -> Findings:
        """Returns the findings in all tiles acquired so far. It is called repeatedly, each time with more tiles."""


@runtime_checkable
class Planner(Protocol):
    """Chooses the amount of exploration, and the end of an episode."""

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        """Begins an episode."""

    def plan(self, seen: Seen) -> Plan:
        """Returns the plan for the next acquisition."""
