"""Fills in tiles that were not acquired, by total variation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .extras import needed

if TYPE_CHECKING:
    from .episodes import Acquired, FieldFacts

Values = npt.NDArray[np.float64]

#: Most pixels along each side of the reconstructed field. Total variation gives no finer detail in unseen areas.
_MOST_PIXELS = 640
_ROUNDS = 30


@dataclass(frozen=True, eq=False)
class _FilledIn:
    """A filled-in tile, in the form of an acquired one."""

    row: int
    column: int
    centre_nm: tuple[float, float]
    size_nm: float
    pixel_nm: float
    image: npt.NDArray[np.float32]
    scale: float
    offset: float
    zoom: float = 1.0
    dose: float = 0.0
    cost: float = 0.0
    electrons_per_pixel: float = 0.0


def inpaint(image: Values, known: npt.NDArray[np.bool_], rounds: int = _ROUNDS) -> Values:
    """Fills in the pixels that are not ``known``, by alternating Chambolle's total-variation denoising and resetting the known pixels."""
    denoise = needed("skimage.restoration").denoise_tv_chambolle
    mean, spread = float(image[known].mean()), float(image[known].std())
    scaled = np.where(known, (image - mean) / (spread if spread > 0 else 1.0), 0.0)
    filled = scaled.copy()
    for _ in range(rounds):
        filled = np.where(known, scaled, denoise(filled, weight=0.1, max_num_iter=10))
    result: Values = np.where(known, image, filled * (spread if spread > 0 else 1.0) + mean)
    return result


def reconstructed(field: FieldFacts, tiles: Sequence[Acquired]) -> list[Any]:
    """Returns all tiles of the grid that were not acquired at zoom 1, filled in from the acquired tiles, row by row."""
    rows, columns = field.grid
    edge = field.tile_px
    bins = 1
    while max(rows, columns) * edge // bins > _MOST_PIXELS and edge % (2 * bins) == 0 and edge // (2 * bins) >= 2:
        bins *= 2
    block = edge // bins
    picture, known = np.zeros((rows * block, columns * block)), np.zeros((rows * block, columns * block), dtype=bool)
    seen = set()
    for tile in tiles:
        if tile.zoom == 1.0:
            place = np.s_[tile.row * block : (tile.row + 1) * block, tile.column * block : (tile.column + 1) * block]
            intensity = tile.image.astype(np.float64) * tile.scale + tile.offset
            picture[place] = intensity.reshape(block, bins, block, bins).mean(axis=(1, 3))
            known[place] = True
            seen.add((tile.row, tile.column))
    if not seen or known.all():
        return []
    filled = inpaint(picture, known)
    low, high = float(filled.min()), float(filled.max())
    scale = high - low if high > low else 1.0
    shown = ((filled - low) / scale).astype(np.float32)
    height_nm, width_nm = field.size_nm
    missing = ((row, column) for row in range(rows) for column in range(columns) if (row, column) not in seen)
    zoom = needed("scipy.ndimage").zoom
    made = []
    for row, column in missing:
        image = shown[row * block : (row + 1) * block, column * block : (column + 1) * block]
        # Blocks of equal pixels would have edges that an analyst takes for atoms, so the image is interpolated.
        image = zoom(image, bins, order=1, mode="nearest", grid_mode=True) if bins > 1 else image
        stride_nm = (field.tile_px - field.overlap_px) * field.pixel_nm
        half = (field.tile_px - 1) / 2 * field.pixel_nm
        centre = (min(column * stride_nm + half, width_nm), min(row * stride_nm + half, height_nm))
        made.append(_FilledIn(row, column, centre, edge * field.pixel_nm, field.pixel_nm, image, scale, low))
    return made
