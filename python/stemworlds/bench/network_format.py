"""The format of the networks that the package trains: inputs, outputs, and the card in each file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import FormatError

#: ``counts`` float32 ``[tile, 1, y, x]``, electrons; ``conditions`` float32 ``[tile, 6]``: dose (e/A^2), electrons per pixel, edge of a
#: pixel (nm), inner and outer angle of the detector (mrad), thickness (nm).
INPUTS = ("counts", "conditions")
#: float32 ``[tile, channel, y / 2, x / 2]``, for cells of 2 x 2 pixels: probability that the cell contains the centre of a column; offset
#: (x, y) of the column from the centre of the cell, in cells; probabilities of kinds; evidence by type of defect, with the log likelihood
#: ``k toward - k^2 sharpness / 2`` of k defects; probabilities of phases; probability of a particle.
OUTPUTS = ("column", "offset", "kind", "toward", "sharpness", "phase", "particle")
#: Key of the card in the metadata of an ONNX file.
KEY = "stemworlds"
_VERSION = 1


@dataclass(frozen=True)
class Card:
    """The description of a network.

    Attributes:
        kinds: names of the kinds of columns, for example ``"O Ti"``.
        usual: prior probabilities of 0, 1, ... defects ``[kind, type, number]``, for fields without a recipe.
        size_px: edge of a tile.
        about: facts about the training: config, steps, versions.
    """

    kinds: tuple[str, ...]
    usual: list[Any]
    size_px: int
    about: Mapping[str, Any] = field(default_factory=dict)

    def table(self) -> dict[str, Any]:
        """Returns the card as a table for the file."""
        return {"version": _VERSION, "kinds": list(self.kinds), "usual": self.usual, "size_px": self.size_px, "about": dict(self.about)}

    @staticmethod
    def read(path: str, text: str | None) -> Card:
        """Reads the card of a file.

        Raises:
            FormatError: if the file has no card, or a card of another version.
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
