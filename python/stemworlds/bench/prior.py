"""What is known of a recipe's specimens before any electron: counted on specimens of the split for training."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..recipes import Recipe
from .columns import DEFECT_TYPES, Columns, columns_of

Values = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

#: Seeds of the specimens that are counted. Those of the split for training are even.
TRAINING_SEEDS = (2, 4, 6, 8)
#: Parts of the field along an axis, in each of which columns are counted apart.
PARTS = 64
#: A part's own counts weigh as much as the whole field's when it holds so many columns.
_PSEUDO_COLUMNS = 20.0
#: Which axis of (x, y) the counts depend on; with ``None`` they are the same everywhere.
Axis = int | None


@dataclass(frozen=True, eq=False)
class Prior:
    """Chances of numbers of defects by kind of column and place.

    Attributes:
        names: kinds of columns.
        chances: for each target (``"vacancy"``, ``"substitution"``, ``None`` for all types together) an array
            ``[part, kind, number of defects]``; the last number stands for itself and all above.
        rates: defects per nm^2 by type, ``[part]``.
        axis: the axis (0 is x) along which the field is divided into parts; ``None`` for one part.
        size_nm: width and height of the field.
    """

    names: tuple[str, ...]
    chances: dict[str | None, Values]
    rates: dict[str, Values]
    axis: Axis
    size_nm: tuple[float, float]

    def part_of(self, places_nm: npt.ArrayLike) -> Whole:
        """The part of the field in which each place (x, y) lies."""
        places = np.asarray(places_nm, dtype=np.float64).reshape(-1, 2)
        if self.axis is None:
            return np.zeros(len(places), dtype=np.int64)
        return _parts(places[:, self.axis], self.size_nm[self.axis])

    def of(self, columns: Columns, target: str | None) -> Values:
        """Chances of 0, 1, ... defects in each column, (N, K). A kind that no training specimen holds has those of all columns."""
        table = self.chances[target]
        known = {name: n for n, name in enumerate(self.names)}
        last = table.shape[1] - 1
        kinds = np.array([known.get(name, last) for name in columns.names] or [last])[columns.kinds]
        result: Values = table[self.part_of(columns.places_nm), kinds]
        return result

    def expected(self, places_nm: npt.ArrayLike, areas_nm2: npt.ArrayLike) -> dict[str, float]:
        """Defects of each type to be expected in areas at places."""
        part, areas = self.part_of(places_nm), np.asarray(areas_nm2, dtype=np.float64)
        return {kind: float((rate[part] * areas).sum()) for kind, rate in self.rates.items() if rate.any()}


def prior_of(recipe: Recipe) -> Prior:
    """The prior of a recipe, whatever its seed. The first call lays out four specimens, about a second each; it is kept for all others.

    Chances may depend on x or on y, if specimens that were left out are then foretold better; else they are the same everywhere.
    """
    return _prior(recipe.with_seed(TRAINING_SEEDS[0]).toml)


@functools.lru_cache(maxsize=32)
def _prior(toml: str) -> Prior:
    recipe = Recipe(toml)
    height, width = recipe.fov_nm
    size = (width, height)
    fields = [columns_of(recipe.with_seed(seed).toml) for seed in TRAINING_SEEDS]
    names = tuple(sorted({name for field in fields for name in field.names}))
    tables: dict[str | None, Values] = {target: _counted(fields, names, size, target) for target in (None, *DEFECT_TYPES)}
    axis = _best_axis(tables[None])
    chances: dict[str | None, Values] = {target: _chances(_along(table, axis).sum(axis=0)) for target, table in tables.items()}
    parts = 1 if axis is None else PARTS
    area = size[0] * size[1] / parts * len(fields)
    rates = {}
    for target in DEFECT_TYPES:
        table = _along(tables[target], axis)
        rates[target] = (table[:, :, :-1].sum(axis=(0, 2)) * np.arange(table.shape[-1])).sum(axis=-1) / area
    return Prior(names, chances, rates, axis, size)


def _parts(along_nm: Values, size_nm: float) -> Whole:
    part: Whole = np.clip((along_nm / size_nm * PARTS).astype(np.int64), 0, PARTS - 1)
    return part


def _counted(fields: list[Columns], names: tuple[str, ...], size_nm: tuple[float, float], target: str | None) -> Values:
    """Numbers of columns ``[axis, specimen, part, kind, number of defects]``; the last kind is all kinds together."""
    most = 1 + max(int(field.counts(target).max(initial=0)) for field in fields)
    out = np.zeros((2, len(fields), PARTS, len(names) + 1, most + 1))
    for n, field in enumerate(fields):
        own = np.array([names.index(name) for name in field.names] or [0])[field.kinds]
        counts = field.counts(target)
        for axis in (0, 1):
            part = _parts(field.places_nm[:, axis], size_nm[axis])
            cell = np.ravel_multi_index((part, own, counts), out.shape[2:])
            out[axis, n] = np.bincount(cell, minlength=out[axis, n].size).reshape(out.shape[2:])
    out[:, :, :, -1] = out[:, :, :, :-1].sum(axis=3)
    return out


def _along(table: Values, axis: Axis) -> Values:
    """``[specimen, part, kind, number]`` of counts along an axis, or in one part."""
    result: Values = table[0].sum(axis=1, keepdims=True) if axis is None else table[axis]
    return result


def _chances(counts: Values) -> Values:
    """Chances from counts ``[part, kind, number]``: those of a part lean on the whole field's, which lean on equal ones by one column.
    No chance is 0, so no forecast of the prior is infinitely wrong."""
    whole = counts.sum(axis=0, keepdims=True)
    classes = counts.shape[-1]
    usual = (whole + 1 / classes) / (whole.sum(axis=-1, keepdims=True) + 1)
    result: Values = (counts + _PSEUDO_COLUMNS * usual) / (counts.sum(axis=-1, keepdims=True) + _PSEUDO_COLUMNS)
    return result


def _best_axis(table: Values) -> Axis:
    """The axis along which each specimen is foretold best by the others; ``None`` unless that is better than one part."""

    def foretold(axis: Axis) -> float:
        counts = _along(table, axis)
        every = counts.sum(axis=0)
        return float(sum((own[:, :-1] * np.log(_chances(every - own))[:, :-1]).sum() for own in counts))

    axes: tuple[Axis, ...] = (None, 0, 1)
    scores = [foretold(axis) for axis in axes]
    return axes[int(np.argmax(scores))]
