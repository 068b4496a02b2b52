"""Kinds of columns of all recipes, and prior probabilities of their defects by recipe, place and kind."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..bench.columns import DEFECT_TYPES
from ..bench.kinds import kind_by_number
from ..bench.prior import Prior, prior_of
from ..recipes import Recipe

Values = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

#: Log probability of a number of defects that a recipe does not have.
_NEVER = -60.0


@dataclass(frozen=True, eq=False)
class Contents:
    """Kinds and prior probabilities of all recipes together.

    Attributes:
        kinds: names of kinds of columns, for example ``"O Ti"``.
        log_chances: log probabilities, float32 ``[row, type of defect, number of defects]``. A row is one kind in one part of one recipe's
            field.
        kind_of_row: index into ``kinds`` for each row.
        most: greatest number of defects ``[row, type]``, which means "that many or more".
        possible: whether the recipe of a row has defects of a type, ``[row, type]``.
        usual: probabilities for each kind, averaged over all recipes ``[kind, type, number]``, for fields without a recipe.
    """

    kinds: tuple[str, ...]
    log_chances: npt.NDArray[np.float32]
    kind_of_row: Whole
    most: Whole
    possible: npt.NDArray[np.bool_]
    usual: Values
    _priors: tuple[Prior, ...]
    _by_number: tuple[npt.NDArray[np.int64], ...]
    _first_row: tuple[int, ...]

    def rows(self, source: int, places_nm: Values, numbers: Whole) -> Whole:
        """Returns the rows of columns of the recipe ``source``, by place and atomic number of the heaviest atom."""
        prior = self._priors[source]
        kind = self._by_number[source][numbers]
        result: Whole = self._first_row[source] + prior.part_of(places_nm) * len(prior.names) + kind
        return result


def contents_of(recipes: Sequence[Recipe]) -> Contents:
    """Counts the contents of recipes in specimens of the training split. It takes seconds for each recipe."""
    with ThreadPoolExecutor(processors()) as pool:
        priors = list(pool.map(prior_of, recipes))
    kinds = tuple(sorted({name for prior in priors for name in prior.names}))
    classes = max(table.shape[2] for prior in priors for table in prior.chances.values())
    logs, kind_of_row, most, possible, first = [], list[int](), [], [], list[int]()
    usual = np.zeros((len(kinds), len(DEFECT_TYPES), classes))
    for prior in priors:
        first.append(len(kind_of_row))
        tables = [prior.chances[target] for target in DEFECT_TYPES]
        parts = tables[0].shape[0]
        # The last kind of a prior is the sum of all kinds, which is left out.
        chances = np.zeros((parts, len(prior.names), len(DEFECT_TYPES), classes))
        for n, table in enumerate(tables):
            chances[:, :, n, : table.shape[2]] = table[:, :-1]
        own = [kinds.index(name) for name in prior.names]
        for n, kind in enumerate(own):
            usual[kind] += chances[:, n].mean(axis=0)
        logs.append(np.log(np.maximum(chances, np.exp(_NEVER))).reshape(-1, len(DEFECT_TYPES), classes))
        kind_of_row += own * parts
        most.append(np.tile([table.shape[2] - 1 for table in tables], (len(own) * parts, 1)))
        possible.append(np.tile([bool(prior.rates[target].any()) for target in DEFECT_TYPES], (len(own) * parts, 1)))
    return Contents(
        kinds,
        np.concatenate(logs).astype(np.float32),
        np.array(kind_of_row),
        np.concatenate(most),
        np.concatenate(possible),
        usual / np.maximum(usual.sum(axis=2, keepdims=True), 1e-300),
        tuple(priors),
        tuple(kind_by_number(prior.names, tomllib.loads(recipe.toml)) for prior, recipe in zip(priors, recipes, strict=True)),
        tuple(first),
    )


def processors() -> int:
    """Returns the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
