"""The truth of a whole field, tile by tile, for the tasks about the field."""

from __future__ import annotations

import functools
import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..recipes import Recipe
from .columns import Columns, columns_of
from .prior import Prior, prior_of

Values = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
View = tuple[float, float, float, float]

#: Tasks about the whole field. The library runs them as a defect census; Python computes their scores.
FIELD_TASKS = ("field-recall", "density-map", "rare")
#: A tile is rare if its number of defects is at least this multiple of the mean, and exceeds the mean by this many standard deviations.
RARE_TIMES, RARE_SIGMAS = 3.0, 4.0
#: Number of points of a cell along an axis at which the prior is evaluated.
_PLACES_A_CELL = 32


@dataclass(frozen=True)
class Grid:
    """A field, divided into equal cells, one for each tile.

    Attributes:
        rows, columns: numbers of rows and columns of tiles.
        size_nm: width and height of the field.
        overlap_nm: width of the overlap of neighbouring tiles.
    """

    rows: int
    columns: int
    size_nm: tuple[float, float]
    overlap_nm: float

    @property
    def cell_nm(self) -> tuple[float, float]:
        """Width and height of a cell."""
        return self.size_nm[0] / self.columns, self.size_nm[1] / self.rows

    def cells_of(self, places_nm: Values) -> tuple[Whole, Whole]:
        """Returns the row and the column of each place (x, y)."""
        width, height = self.cell_nm
        column = np.clip((places_nm[:, 0] / width).astype(np.int64), 0, self.columns - 1)
        row = np.clip((places_nm[:, 1] / height).astype(np.int64), 0, self.rows - 1)
        return row, column

    def summed(self, places_nm: Values, weights: npt.ArrayLike) -> Values:
        """Returns the sums of weights by cell, ``[row, column]``."""
        row, column = self.cells_of(places_nm)
        result = np.zeros((self.rows, self.columns))
        np.add.at(result, (row, column), np.asarray(weights, dtype=np.float64))
        return result

    def touched(self, view: View) -> Mask:
        """Returns a mask of the cells that a view shows. A view of a cell's overlap with its neighbours alone does not count."""
        width, height = self.cell_nm
        left, top, right, bottom = view
        x, y = np.arange(self.columns) * width, np.arange(self.rows) * height
        across = (right > x + self.overlap_nm) & (left < x + width - self.overlap_nm)
        down = (bottom > y + self.overlap_nm) & (top < y + height - self.overlap_nm)
        result: Mask = down[:, None] & across[None, :]
        return result

    def per_cell(self, density: npt.ArrayLike) -> Values:
        """Resamples a map of expected numbers in equal parts of the field to expected numbers in the cells."""
        given = np.asarray(density, dtype=np.float64)
        rows = (np.arange(self.rows) * 2 + 1) * given.shape[0] // (2 * self.rows)
        columns = (np.arange(self.columns) * 2 + 1) * given.shape[1] // (2 * self.columns)
        result: Values = given[np.ix_(rows, columns)] * (given.size / (self.rows * self.columns))
        return result


def grid_of(recipe: Recipe) -> Grid:
    """Returns the grid of a recipe, for the part of the field that is built."""
    rows, columns = recipe.grid
    height, width = recipe.fov_nm
    return Grid(rows, columns, (width, height), recipe["field"]["overlap_px"] * recipe.pixel_nm)


def rare_from(mean: float) -> float:
    """Returns the smallest number of defects of a rare tile, if tiles have ``mean`` defects on average."""
    return RARE_TIMES * mean + RARE_SIGMAS * math.sqrt(mean)


@dataclass(frozen=True, eq=False)
class FieldTruth:
    """The defects of a specimen.

    Attributes:
        grid: grid of the field.
        columns: all columns of the field.
        numbers: number of defects in each column, all types together.
        counts: number of defects in each cell, ``[row, column]``.
        clusters: for each cell, the number of its cluster of rare tiles, from 1 on; 0 for other tiles. Rare tiles that share an edge or a
            corner form one cluster.
    """

    grid: Grid
    columns: Columns
    numbers: Whole
    counts: Values
    clusters: Whole

    @staticmethod
    def of(grid: Grid, columns: Columns) -> FieldTruth:
        """Returns the truth for some columns."""
        numbers = columns.counts(None)
        counts = grid.summed(columns.places_nm, numbers)
        return FieldTruth(grid, columns, numbers, counts, grouped(counts >= max(rare_from(float(counts.mean())), 1.0)))

    @property
    def total(self) -> int:
        """The number of defects of the field."""
        return int(self.numbers.sum())


@functools.lru_cache(maxsize=2)
def field_truth(toml: str) -> FieldTruth:
    """Returns the truth of a recipe's specimen.

    Its atoms are laid out, which takes 1 to 2 s for a field of 100 nm. The result is cached for the next agent.
    """
    return FieldTruth.of(grid_of(Recipe(toml)), columns_of(toml))


def expected_counts(recipe: Recipe, grid: Grid) -> Values:
    """Returns the prior's expected number of defects in each cell, ``[row, column]``."""
    prior: Prior = prior_of(recipe)
    total = np.sum(list(prior.rates.values()), axis=0)

    def along(axis: int, cells: int) -> Values:
        """Returns the mean rates of equal parts along an axis, each averaged over several points."""
        if axis != prior.axis:
            return np.ones(cells)
        places = np.zeros((cells * _PLACES_A_CELL, 2))
        places[:, axis] = (np.arange(len(places)) + 0.5) / len(places) * prior.size_nm[axis]
        result: Values = total[prior.part_of(places)].reshape(cells, _PLACES_A_CELL).mean(axis=1)
        return result

    width, height = grid.cell_nm
    rates = np.outer(along(1, grid.rows), along(0, grid.columns)) * (total[0] if prior.axis is None else 1.0)
    result: Values = rates * width * height
    return result


def grouped(there: Mask) -> Whole:
    """Numbers the groups of cells that share an edge or a corner, from 1 on; 0 for cells in which ``there`` is false."""
    groups = np.zeros(there.shape, dtype=np.int64)
    number = 0
    for start in zip(*np.nonzero(there), strict=True):
        if groups[start]:
            continue
        number += 1
        groups[start] = number
        waiting = deque([start])
        while waiting:
            row, column = waiting.popleft()
            for near in ((r, c) for r in range(row - 1, row + 2) for c in range(column - 1, column + 2)):
                if 0 <= near[0] < there.shape[0] and 0 <= near[1] < there.shape[1] and there[near] and not groups[near]:
                    groups[near] = number
                    waiting.append(near)
    return groups
