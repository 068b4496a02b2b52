"""What an agent is made of: a navigator, an analyst and a planner are any objects with these methods."""

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
    """The next acquisition: a tile of the grid, zoom, and times the reference dose."""

    row: int
    column: int
    zoom: float = 1.0
    dose: float = 1.0


class Plan(NamedTuple):
    """What a planner wants: ``mode`` for the record, ``beta`` for navigators that explore, ``end`` to be done."""

    mode: str
    beta: float | None = None
    end: bool = False


@dataclass(eq=False)
class Seen:
    """What an agent knows at a moment of an episode.

    Attributes:
        field: the facts of the field: grid, sizes, phases, task, budget.
        tiles: acquisitions so far, in order.
        findings: what the analyst says of them; ``None`` before the first.
        dose_left: share of the budget that is left.
        plan: what the planner said last.
        uncertainty_of: of each acquisition, how uncertain the analyst is; ``None`` for an analyst that does not say.
        counts_of: of each acquisition, defects that the analyst counts in its tile and their standard deviation; ``None`` as well.
    """

    field: FieldFacts
    tiles: list[Acquired] = dataclasses.field(default_factory=list)
    findings: Findings | None = None
    dose_left: float = 1.0
    plan: Plan | None = None
    uncertainty_of: Callable[[Sequence[Acquired]], npt.NDArray[np.float64]] | None = None
    counts_of: Callable[[Sequence[Acquired]], npt.NDArray[np.float64]] | None = None

    def visited(self) -> npt.NDArray[np.bool_]:
        """Tiles that were acquired, [row, column]."""
        grid = np.zeros(self.field.grid, dtype=bool)
        for tile in self.tiles:
            grid[tile.row, tile.column] = True
        return grid

    def coverage(self) -> float:
        """Share of the tiles that were acquired."""
        return float(self.visited().mean())

    def defects(self) -> int:
        """Number of defects declared so far."""
        if self.findings is None:
            return 0
        if self.findings.counts is not None:
            return int(sum(self.findings.counts.values()))
        return sum(len(np.asarray(places)) for places in (self.findings.defects or {}).values())


@runtime_checkable
class Navigator(Protocol):
    """Chooses where to look next."""

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        """Begins an episode; all random numbers come from ``random``."""

    def choose(self, seen: Seen) -> Look | None:
        """The next acquisition; ``None`` when there is nothing left to see."""


@runtime_checkable
class Analyst(Protocol):
    """Says what the tiles show.

    An analyst may also have ``uncertainty(tiles)``, one number for each of the tiles, for navigators that look where it is uncertain,
    ``tile_counts(tiles)``, (N, 2), defects in each tile and their standard deviations, for those that look where most are, and ``notes()``, a dict of numbers for the record of the episode.
    """

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        """Begins an episode."""

    def findings(self, tiles: Sequence[Acquired]) -> Findings:
        """All that the tiles acquired so far show. Called again and again, each time with more tiles."""


@runtime_checkable
class Planner(Protocol):
    """Decides how much to explore, and when to be done."""

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        """Begins an episode."""

    def plan(self, seen: Seen) -> Plan:
        """The plan for the next acquisition."""
