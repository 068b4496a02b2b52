"""Kinds of columns by their heaviest atom: what training samples and networks know of a column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..specimens import _SYMBOLS

#: Tables of recipes that replace atoms: which key names the new element, and which the old one.
REPLACED = (("alloy", "guest", "host"), ("substitutions", "by", "element"))
_ELEMENTS = 120


def heaviest(name: str) -> int:
    """Atomic number of the heaviest element of a kind, ``"O Ti"``."""
    return max(_SYMBOLS.index(symbol) for symbol in name.split())


def kind_by_number(names: Sequence[str], recipe: Mapping[str, Any]) -> npt.NDArray[np.int64]:
    """For each atomic number the kind of the columns whose heaviest atom it is; a guest's is its host's. What no kind has is the first."""
    table = np.zeros(_ELEMENTS, dtype=np.int64)
    for key, new, old in REPLACED:
        if key in recipe:
            holding = [n for n, name in enumerate(names) if recipe[key][old] in name.split()]
            if holding:
                table[_SYMBOLS.index(recipe[key][new])] = holding[0]
    # A host that is the heaviest of its column, last: it says more than a guest that may be in another one.
    for n, name in enumerate(names):
        table[heaviest(name)] = n
    return table
