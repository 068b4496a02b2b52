"""Navigators for the tasks about the whole field: by the analyst's counts, by the usual map, and by the truth."""

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
    """Fits a Gaussian process to the analyst's counts of defects, with their errors as noise. Chooses the greatest mean + ``beta``
    deviations.

    The analyst needs a method ``tile_counts(tiles)``. It returns the number of defects found in each tile and the standard deviation of
    that number, (N, 2); NaN for an unknown error.

    Args:
        beta: number of deviations. 0 chooses the greatest expected number, a large value the greatest uncertainty. A planner's ``beta``
            takes precedence.
        usual: the expected map before the first acquisition: ``"prior"``, the map of the recipe's usual specimens, or ``"flat"``, a
            constant.
        initial: number of random tiles at the start.
        refit: number of tiles from one fit of the process to the next.
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
        """Stores the environment of the episode. Only its recipe is used."""
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
    """Chooses the tiles in which specimens of the recipe usually have most defects. It reads no pixel."""

    def attach(self, world: Any) -> None:
        """Stores the environment of the episode. Only its recipe is used."""
        self._world = world

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        recipe = recipe_of(self._world)
        self._expected, self._random = expected_counts(recipe, grid_of(recipe)).ravel(), random

    def choose(self, seen: Seen) -> Look | None:
        free = _free(seen)
        return None if free.size == 0 else _look(seen, _best(self._expected, free, self._random))


class ByTruth:
    """Chooses the tiles with most defects first. Its score is the ceiling of every navigator."""

    def attach(self, world: Any) -> None:
        """Stores the environment of the episode."""
        self._world = world

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        # Raises an error with a clear message for a world without a recipe.
        recipe_of(self._world)
        self._counts, self._random = field_truth(self._world.specimen().toml).counts.ravel(), random

    def choose(self, seen: Seen) -> Look | None:
        free = _free(seen)
        return None if free.size == 0 else _look(seen, _best(self._counts, free, self._random))


def _free(seen: Seen) -> npt.NDArray[np.intp]:
    """Returns the indices of the tiles that were not acquired."""
    return np.flatnonzero(~seen.visited().ravel())


def _best(values: Values, free: npt.NDArray[np.intp], random: np.random.Generator) -> int:
    """Returns a free tile with the greatest value, a random one of several equal ones."""
    own = values[free]
    best = free[own >= own.max() - 1e-9 * max(abs(float(own.max())), 1.0)]
    return int(random.choice(best))


def _look(seen: Seen, index: int) -> Look:
    return Look(*divmod(index, seen.field.grid[1]))
