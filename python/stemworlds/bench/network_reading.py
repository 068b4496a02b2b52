"""Runs networks that the package trained, and reads the columns of a tile from their outputs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import FormatError, _invalid
from .network_format import INPUTS, KEY, OUTPUTS, Card
from .networks import path_of
from .onnx_session import opened

Values = npt.NDArray[np.float64]

#: Least edge of a pixel in a network's input. Smaller pixels are summed first, which loses no detail that a network uses.
_LEAST_PIXEL_NM = 0.0105


@dataclass(frozen=True, eq=False)
class SeenColumns:
    """Columns, phases and particles that networks find in a tile.

    Attributes:
        places_px: (N, 2), x and y; pixel centres are whole numbers.
        sure: (N,), probability that the column exists.
        kinds: (N, kinds), probabilities of the kinds.
        toward, sharpness: (N, types), evidence. The log likelihood of k defects of a type is ``k toward - k^2 sharpness / 2``.
        phases: probabilities of the phases ``[phase, y, x]`` in cells with the edge ``cell_px``.
        particles: probability of a particle ``[y, x]`` in these cells.
        cell_px: edge of a cell in pixels.
    """

    places_px: Values
    sure: Values
    kinds: Values
    toward: Values
    sharpness: Values
    phases: Values
    particles: Values
    cell_px: int


class Reader:
    """Runs one or several networks, and averages their outputs.

    Args:
        models: path of an ONNX file or name of a shipped network, or several. All networks have to distinguish the same kinds.
        least: the least probability of a column.

    Raises:
        FileMissing, FormatError: for a file that is missing, or is no network of this package.
        InvalidValue: if no network is given, or the networks differ in kinds or size of tile.
    """

    def __init__(self, models: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], least: float) -> None:
        paths = [path_of(model) for model in ([models] if isinstance(models, str | os.PathLike) else models)]
        if not paths:
            raise _invalid("models", "expected one network or more")
        opened = [_opened(path) for path in paths]
        self._sessions = [session for session, _ in opened]
        self.card: Card = opened[0][1]
        self._least = least
        for path, (_, card) in zip(paths, opened, strict=True):
            if card.kinds != self.card.kinds or card.size_px != self.card.size_px:
                raise _invalid("models", f"{path}: knows {', '.join(card.kinds)} in tiles of {card.size_px}; the first knows {', '.join(self.card.kinds)}")

    def read(self, counts: Values, electrons: float, pixel_nm: float, facts: tuple[float, float, float]) -> SeenColumns:
        """Analyses the counts ``[y, x]`` of a tile. ``facts`` are inner and outer angle in mrad, and thickness in nm."""
        size = self.card.size_px
        if counts.shape != (size, size):
            raise _invalid("models", f"this tile has {counts.shape[0]} x {counts.shape[1]} pixels, the network takes {size} x {size}")
        together = _together(pixel_nm, size)
        shown, margin = _added(counts, together)
        electrons, pixel_nm = electrons * together**2, pixel_nm * together
        conditions = np.array([[electrons / (10 * pixel_nm) ** 2, electrons, pixel_nm, *facts]], dtype=np.float32)
        given = dict(zip(INPUTS, (shown[None, None].astype(np.float32), conditions), strict=True))
        every = [[np.asarray(one[0], dtype=np.float64) for one in session.run(list(OUTPUTS), given)] for session in self._sessions]
        column, offset, kind, toward, sharpness, phase, particle = (np.mean([one[n] for one in every], axis=0) for n in range(len(OUTPUTS)))
        inner = slice(margin // 2, (margin + size // together + 1) // 2)
        rows, columns = _maxima(column[0], self._least)
        sure = column[0, rows, columns]
        x, y = (index + 0.5 + np.clip(offset[axis, rows, columns], -1, 1) for axis, index in ((0, columns), (1, rows)))
        places = (2 * np.column_stack([x, y]) - margin) * together - 0.5
        there = ((places > -0.5) & (places < size - 0.5)).all(axis=1)
        x, y, rows, columns, places = x[there], y[there], rows[there], columns[there], places[there]
        return SeenColumns(
            places_px=places,
            sure=sure[there],
            kinds=kind[:, rows, columns].T,
            toward=_between(toward, x, y),
            sharpness=_between(sharpness, x, y),
            phases=phase[:, inner, inner],
            particles=particle[0, inner, inner],
            cell_px=2 * together,
        )


def _opened(path: str) -> tuple[Any, Card]:
    """Opens a session on one thread. Returns it with the network's card."""
    session = opened(path)
    card = Card.read(path, session.get_modelmeta().custom_metadata_map.get(KEY))
    names = {one.name for one in session.get_outputs()}
    if not names.issuperset(OUTPUTS):
        raise FormatError(f"{path}: has outputs {', '.join(sorted(names))}; expected {', '.join(OUTPUTS)}")
    return session, card


def _together(pixel_nm: float, size: int) -> int:
    """Returns the number of pixels along an edge that are summed, a power of two."""
    together = 1
    while pixel_nm * together < _LEAST_PIXEL_NM and size // (2 * together) >= 16:
        together *= 2
    return together


def _added(counts: Values, together: int) -> tuple[Values, int]:
    """Sums pixels. Returns the counts with mirrored margins, which keep the shape, and the width of the margins in pixels."""
    if together == 1:
        return counts, 0
    size = counts.shape[0]
    small = counts.reshape(size // together, together, size // together, together).sum(axis=(1, 3))
    margin = (size - len(small)) // 2
    return np.pad(small, margin, mode="symmetric"), margin


def _maxima(heat: Values, least: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Returns the cells that are local maxima and at least ``least``. Of equal neighbours it returns the first."""
    wide = np.pad(heat, 1, constant_values=-1.0)
    height, width = heat.shape
    top = heat >= least
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if (dy, dx) != (0, 0):
                other = wide[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]
                top &= heat >= other if (dy, dx) > (0, 0) else heat > other
    rows, columns = np.nonzero(top)
    return rows, columns


def _between(maps: Values, x: Values, y: Values) -> Values:
    """Interpolates maps ``[channel, y, x]`` linearly between the centres of cells: (N, channels)."""
    height, width = maps.shape[1:]
    x, y = np.clip(x - 0.5, 0, width - 1), np.clip(y - 0.5, 0, height - 1)
    left, top = np.minimum(x.astype(np.int64), width - 2), np.minimum(y.astype(np.int64), height - 2)
    right, down = x - left, y - top
    upper = maps[:, top, left] * (1 - right) + maps[:, top, left + 1] * right
    lower = maps[:, top + 1, left] * (1 - right) + maps[:, top + 1, left + 1] * right
    result: Values = (upper * (1 - down) + lower * down).T
    return result
