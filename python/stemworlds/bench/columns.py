"""The true atomic columns of a specimen, without an image. Priors are counted from them, and forecasts are scored against them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core
from .._running import call, running
from ..specimens import _SYMBOLS

Values = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

_VACANCY, _SUBSTITUTION = 1, 2
#: The types of defects, in the order of :attr:`Columns.defects`.
DEFECT_TYPES = ("vacancy", "substitution")


@dataclass(frozen=True, eq=False)
class Columns:
    """Atomic columns.

    Attributes:
        places_nm: (N, 2), x and y in the field.
        kinds: (N,), the kind of each column, an index into ``names``. It ignores vacancies and substitutions.
        names: the elements of each kind without defects, ``"O"``, ``"O Ti"``.
        defects: (N, 2), numbers of vacancies and of substitutions.
    """

    places_nm: Values
    kinds: Whole
    names: tuple[str, ...]
    defects: Whole

    def counts(self, target: str | None) -> Whole:
        """Returns the number of defects of the type ``target`` in each column; of all types if it is ``None``."""
        if target is None:
            total: Whole = self.defects.sum(axis=1)
            return total
        return self.defects[:, DEFECT_TYPES.index(target)]

    def within(self, left: float, top: float, right: float, bottom: float) -> Columns:
        """Returns the columns in a rectangle, edges in nm."""
        x, y = self.places_nm.T
        there = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
        return Columns(self.places_nm[there], self.kinds[there], self.names, self.defects[there])


def columns_of(toml: str, region_nm: tuple[float, float, float, float] | None = None, *, threads: int | None = None) -> Columns:
    """Lists the columns of a recipe's specimen in a region (left, upper, right and lower edge in nm of the field), or all columns.

    No image is simulated: the atoms are laid out and counted.
    """
    found = call(_core.specimen_sites, toml, region_nm, running(threads, False))
    own = found["columns"] >= 0
    numbers, types, columns = found["numbers"][own], found["types"][own], found["columns"][own]
    places = found["positions_nm"].reshape(-1, 3)[own, :2]
    # Columns are numbered from 0, and each has a site, so the greatest index gives their number.
    count = int(columns.max(initial=-1)) + 1
    sites = np.bincount(columns, minlength=count)
    held = np.flatnonzero(sites)
    middle = np.column_stack([np.bincount(columns, places[:, axis], count)[held] / sites[held] for axis in (0, 1)]).reshape(-1, 2)
    defects = np.column_stack([np.bincount(columns[types == kind], minlength=count)[held] for kind in (_VACANCY, _SUBSTITUTION)])
    names, kinds = _kinds(_hosts(numbers, types, tomllib.loads(toml)), columns, count)
    made = Columns(middle, kinds[held], names, defects.astype(np.int64).reshape(-1, 2))
    return made if region_nm is None else made.within(*region_nm)


def _hosts(numbers: npt.NDArray[Any], types: npt.NDArray[Any], recipe: Mapping[str, Any]) -> npt.NDArray[Any]:
    """Returns the atomic numbers of the sites before substitution."""
    hosts = numbers.copy()
    for table, guest, host in (("alloy", "guest", "host"), ("substitutions", "by", "element")):
        if table in recipe:
            replaced = (types == _SUBSTITUTION) & (numbers == _SYMBOLS.index(recipe[table][guest]))
            hosts[replaced] = _SYMBOLS.index(recipe[table][host])
    return hosts


def _kinds(hosts: npt.NDArray[Any], index: npt.NDArray[Any], count: int) -> tuple[tuple[str, ...], Whole]:
    """Returns the names of the kinds in alphabetical order, and the kind of each column."""
    elements = [int(number) for number in np.flatnonzero(np.bincount(hosts, minlength=1))]
    held = np.zeros((count, len(elements)), dtype=bool)
    for which, number in enumerate(elements):
        held[index[hosts == number], which] = True
    patterns, inverse = np.unique(held @ (1 << np.arange(len(elements))), return_inverse=True)
    names = [" ".join(sorted(_SYMBOLS[number] for bit, number in enumerate(elements) if pattern >> bit & 1)) for pattern in patterns.tolist()]
    order = np.argsort(names, kind="stable")
    place = np.empty(len(names), dtype=np.int64)
    place[order] = np.arange(len(names))
    return tuple(names[n] for n in order), place[np.asarray(inverse).reshape(-1)]
