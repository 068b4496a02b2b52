"""Navigators of the tasks that ask for the field: by the analyst's counts, by what is usual, and by the truth."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from ..errors import _invalid
from .blind import recipe_of
from .count_maps import CountProcess
from .field_truth import expected_counts, field_truth, grid_of
from .protocols import Look, Seen

if TYPE_CHECKING:
    from .episodes import FieldFacts

__all__ = ["ByCounts", "ByPrior", "ByTruth"]

Values = npt.NDArray[np.float64]


class ByCounts:
    """A Gaussian process over the analyst's counts of defects, with their errors as noise: looks where mean + ``beta`` deviations is greatest.

    The analyst has a method ``tile_counts(tiles)``, which gives for each tile the number of defects that it found and the standard deviation of
    that number, (N, 2); NaN where it does not know its error.

    Args:
        beta: deviations; 0 looks where most is expected, a large number where least is known. That of a planner comes first.
        usual: what is expected before the first look: ``"prior"`` is the map of the recipe's usual specimens, ``"flat"`` the same everywhere.
        initial: tiles drawn at random at first.
        refit: the process is fitted again after that many tiles.
    """

    def __init__(self, beta: float = 1.0, *, usual: Literal["prior", "flat"] = "prior", initial: int = 4, refit: int = 3) -> None:
        if not (math.isfinite(beta) and beta >= 0):
            raise _invalid("beta", f"beta = {beta}: expected a number from 0 on")
        if usual not in ("prior", "flat"):
            raise _invalid("usual", f"usual = {usual!r}: expected prior or flat")
        if initial < 1 or refit < 1:
            raise _invalid("initial or refit", f"initial = {initial}, refit = {refit}: expected 1 or more")
        self.beta: float = beta
        self.usual: Literal["prior", "flat"] = usual
        self.initial: int = initial
        self.refit: int = refit
        self._world: Any = None

    def attach(self, world: Any) -> None:
        """Takes the environment that is played; only its recipe is used."""
        self._world = world

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        self._random = random
        expected = None
        if self.usual == "prior":
            recipe = recipe_of(self._world)
            expected = expected_counts(recipe, grid_of(recipe))
        self._process = CountProcess(field.grid, expected)
        self._fitted = 0

    def choose(self, seen: Seen) -> Look | None:
        if seen.counts_of is None:
            raise _invalid("analyst", "this analyst does not count defects by tile (a method tile_counts); heuristic, prior and ideal do")
        free = _free(seen)
        if free.size == 0:
            return None
        if len(seen.tiles) < self.initial:
            return _look(seen, int(self._random.choice(free)))
        counts, sigmas = np.asarray(seen.counts_of(seen.tiles), dtype=np.float64).reshape(-1, 2).T
        tiles = np.array([tile.row * seen.field.grid[1] + tile.column for tile in seen.tiles])
        if not self._fitted or len(tiles) >= self._fitted + self.refit:
            self._process.fit(tiles, counts, sigmas)
            self._fitted = len(tiles)
        found = self._process.predict(tiles, counts, sigmas)
        beta = self.beta if seen.plan is None or seen.plan.beta is None else seen.plan.beta
        return _look(seen, _best((found.mean + beta * found.deviation).ravel(), free, self._random))


class ByPrior:
    """Looks where specimens of the recipe usually hold most defects, and reads no pixel."""

    def attach(self, world: Any) -> None:
        """Takes the environment that is played; only its recipe is used."""
        self._world = world

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        recipe = recipe_of(self._world)
        self._expected, self._random = expected_counts(recipe, grid_of(recipe)).ravel(), random

    def choose(self, seen: Seen) -> Look | None:
        free = _free(seen)
        return None if free.size == 0 else _look(seen, _best(self._expected, free, self._random))


class ByTruth:
    """Looks at the tiles that hold most defects, the most first: the ceiling of every navigator."""

    def attach(self, world: Any) -> None:
        """Takes the environment that is played."""
        self._world = world

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        # Also names a world without a recipe as one.
        recipe_of(self._world)
        self._counts, self._random = field_truth(self._world.specimen().toml).counts.ravel(), random

    def choose(self, seen: Seen) -> Look | None:
        free = _free(seen)
        return None if free.size == 0 else _look(seen, _best(self._counts, free, self._random))


def _free(seen: Seen) -> npt.NDArray[np.intp]:
    """Tiles that were not visited."""
    return np.flatnonzero(~seen.visited().ravel())


def _best(values: Values, free: npt.NDArray[np.intp], random: np.random.Generator) -> int:
    """A free tile with the greatest value; of several that are as good, any."""
    own = values[free]
    best = free[own >= own.max() - 1e-9 * max(abs(float(own.max())), 1.0)]
    return int(random.choice(best))


def _look(seen: Seen, index: int) -> Look:
    return Look(*divmod(index, seen.field.grid[1]))
