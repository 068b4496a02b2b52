"""The prior of a recipe: probabilities of defects before any image, counted in specimens of the training split."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..recipes import Recipe
from .columns import DEFECT_TYPES, Columns, columns_of

Values = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

#: Seeds of the counted specimens. The seeds of the training split are even.
TRAINING_SEEDS = (2, 4, 6, 8)
#: Number of parts of the field along an axis. Columns are counted separately in each part.
PARTS = 64
#: Number of columns at which the counts of a part have the same weight as the counts of the whole field.
_PSEUDO_COLUMNS = 20.0
#: The axis of (x, y) on which the probabilities depend; ``None`` for probabilities that are constant in the field.
Axis = int | None


@dataclass(frozen=True, eq=False)
class Prior:
    """Probabilities of numbers of defects by kind of column and place.

    Attributes:
        names: kinds of columns.
        chances: for each target (``"vacancy"``, ``"substitution"``, ``None`` for all types together) an array of probabilities ``[part,
            kind, number of defects]``. The last number means "that many or more".
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
        """Returns the part of the field that contains each place (x, y)."""
        places = np.asarray(places_nm, dtype=np.float64).reshape(-1, 2)
        if self.axis is None:
            return np.zeros(len(places), dtype=np.int64)
        return _parts(places[:, self.axis], self.size_nm[self.axis])

    def of(self, columns: Columns, target: str | None) -> Values:
        """Returns the probabilities of 0, 1, ... defects in each column, (N, K). A kind that no training specimen contains gets the mean of
        all kinds."""
        table = self.chances[target]
        known = {name: n for n, name in enumerate(self.names)}
        last = table.shape[1] - 1
        kinds = np.array([known.get(name, last) for name in columns.names] or [last])[columns.kinds]
        result: Values = table[self.part_of(columns.places_nm), kinds]
        return result

    def expected(self, places_nm: npt.ArrayLike, areas_nm2: npt.ArrayLike) -> dict[str, float]:
        """Returns the expected number of defects of each type in areas at places."""
        part, areas = self.part_of(places_nm), np.asarray(areas_nm2, dtype=np.float64)
        return {kind: float((rate[part] * areas).sum()) for kind, rate in self.rates.items() if rate.any()}


def prior_of(recipe: Recipe) -> Prior:
    """Returns the prior of a recipe. It does not depend on the recipe's seed.

    The first call lays out four specimens, about 1 s each; later calls use the cached prior. The probabilities depend on x or on y if this
    predicts left-out specimens better; otherwise they are constant in the field.
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
    """Counts columns, ``[axis, specimen, part, kind, number of defects]``. The last kind is the sum of all kinds."""
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
    """Returns the counts along an axis, or in one part, ``[specimen, part, kind, number]``."""
    result: Values = table[0].sum(axis=1, keepdims=True) if axis is None else table[axis]
    return result


def _chances(counts: Values) -> Values:
    """Returns probabilities from counts ``[part, kind, number]``.

    Pseudo-counts draw a part towards the whole field, and the whole field, with the weight of one column, towards equal probabilities. No
    probability is 0, so the prior never costs infinitely many bits.
    """
    whole = counts.sum(axis=0, keepdims=True)
    classes = counts.shape[-1]
    usual = (whole + 1 / classes) / (whole.sum(axis=-1, keepdims=True) + 1)
    result: Values = (counts + _PSEUDO_COLUMNS * usual) / (counts.sum(axis=-1, keepdims=True) + _PSEUDO_COLUMNS)
    return result


def _best_axis(table: Values) -> Axis:
    """Returns the axis along which the other specimens predict each specimen best; ``None`` if one part predicts better."""

    def foretold(axis: Axis) -> float:
        counts = _along(table, axis)
        every = counts.sum(axis=0)
        return float(sum((own[:, :-1] * np.log(_chances(every - own))[:, :-1]).sum() for own in counts))

    axes: tuple[Axis, ...] = (None, 0, 1)
    scores = [foretold(axis) for axis in axes]
    return axes[int(np.argmax(scores))]
