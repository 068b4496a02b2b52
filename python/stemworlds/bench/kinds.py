"""Kinds of columns by their heaviest atom. Training samples and networks distinguish columns by this atom alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..specimens import _SYMBOLS

#: Tables of recipes that replace atoms, with the key of the new element and the key of the old element.
REPLACED = (("alloy", "guest", "host"), ("substitutions", "by", "element"))
_ELEMENTS = 120


def heaviest(name: str) -> int:
    """Returns the atomic number of the heaviest element of a kind, for example ``"O Ti"``."""
    return max(_SYMBOLS.index(symbol) for symbol in name.split())


def kind_by_number(names: Sequence[str], recipe: Mapping[str, Any]) -> npt.NDArray[np.int64]:
    """Returns for each atomic number the kind of the columns with this heaviest atom.

    A guest atom has the kind of its host. Elements of no kind get the first kind.
    """
    table = np.zeros(_ELEMENTS, dtype=np.int64)
    for key, new, old in REPLACED:
        if key in recipe:
            holding = [n for n, name in enumerate(names) if recipe[key][old] in name.split()]
            if holding:
                table[_SYMBOLS.index(recipe[key][new])] = holding[0]
    # Hosts overwrite guests: an element that is the heaviest host of one kind belongs to this kind.
    for n, name in enumerate(names):
        table[heaviest(name)] = n
    return table
