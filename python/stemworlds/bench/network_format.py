"""What the networks that the package trains take and give: names of inputs and outputs, and the card in each file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import FormatError

#: ``counts`` float32 ``[tile, 1, y, x]``, electrons; ``conditions`` float32 ``[tile, 6]``: dose (e/A^2), electrons a pixel, edge of a pixel
#: (nm), inner and outer angle of the detector (mrad), thickness (nm).
INPUTS = ("counts", "conditions")
#: float32 ``[tile, channel, y / 2, x / 2]``: chance of a column's middle in a cell of two pixels; its offset (x, y) from the cell's middle in
#: cells; chances of kinds; evidence by type of defect, the log likelihood of k of them being ``k toward - k^2 sharpness / 2``; chances of phases, of a
#: particle.
OUTPUTS = ("column", "offset", "kind", "toward", "sharpness", "phase", "particle")
#: Key of the card in the metadata of an ONNX file.
KEY = "stemworlds"
_VERSION = 1


@dataclass(frozen=True)
class Card:
    """What a network was trained for.

    Attributes:
        kinds: names of kinds of columns, ``"O Ti"``.
        usual: chances of 0, 1, ... defects ``[kind, type, number]``, for fields without a recipe.
        size_px: edge of a tile.
        about: how it was trained: config, steps, versions.
    """

    kinds: tuple[str, ...]
    usual: list[Any]
    size_px: int
    about: Mapping[str, Any] = field(default_factory=dict)

    def table(self) -> dict[str, Any]:
        """As it stands in the file."""
        return {"version": _VERSION, "kinds": list(self.kinds), "usual": self.usual, "size_px": self.size_px, "about": dict(self.about)}

    @staticmethod
    def read(path: str, text: str | None) -> Card:
        """The card of a file.

        Raises:
            FormatError: without one, or for one of another version.
        """
        if text is None:
            raise FormatError(f"{path}: no network that stemworlds trained: it has no card; OnnxAnalyst runs other networks")
        try:
            table = json.loads(text)
            if table["version"] != _VERSION:
                raise FormatError(f"{path}: version {table['version']} of networks, this program reads {_VERSION}")
            card = Card(tuple(table["kinds"]), table["usual"], int(table["size_px"]), table["about"])
            if np.asarray(card.usual, dtype=np.float64).ndim != 3:
                raise ValueError("usual has another shape")
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, FormatError):
                raise
            raise FormatError(f"{path}: its card cannot be read: {error}") from error
        return card
