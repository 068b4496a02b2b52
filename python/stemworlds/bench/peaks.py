"""Finds the peaks of a tile, which are the places of its atomic columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .extras import needed

Values = npt.NDArray[np.float64]

#: Width of the Gaussian against noise: half of a typical column.
_SMOOTHING_NM = 0.03
#: Least distance of two peaks. Atomic columns have larger distances.
_APART_NM = 0.1


@dataclass(frozen=True, eq=False)
class Peaks:
    """Peaks of a tile.

    Attributes:
        row_px, column_px: float64 (N,), places with subpixel accuracy; pixel centres are whole numbers.
        intensity: float64 (N,), intensities of the smoothed image.
    """

    row_px: Values
    column_px: Values
    intensity: Values


def find_peaks(image: Values, pixel_nm: float) -> Peaks:
    """Finds maxima of the smoothed image above its mean, at least 0.1 nm apart, sorted by row."""
    ndimage = needed("scipy.ndimage")
    smooth: Values = ndimage.gaussian_filter(image, max(_SMOOTHING_NM / pixel_nm, 0.7), mode="nearest")
    reach = 2 * max(round(_APART_NM / pixel_nm), 1) + 1
    top = ndimage.maximum_filter(smooth, size=reach, mode="constant", cval=-np.inf)
    level, spread = float(smooth.mean()), float(smooth.std())
    rows, columns = np.nonzero((smooth == top) & (smooth > level + 0.25 * spread) & (spread > 0))
    return Peaks(
        rows + _vertex(smooth, rows, columns, 0),
        columns + _vertex(smooth, rows, columns, 1),
        smooth[rows, columns],
    )


def _vertex(image: Values, rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp], axis: int) -> Values:
    """Returns the distance from each pixel to the vertex of the parabola through it and its neighbours; 0 at the edge."""
    at = (rows, columns)[axis]
    inside = (at > 0) & (at < image.shape[axis] - 1)
    step = np.where(inside, 1, 0)
    before = image[rows - step, columns] if axis == 0 else image[rows, columns - step]
    after = image[rows + step, columns] if axis == 0 else image[rows, columns + step]
    curve = before - 2 * image[rows, columns] + after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(inside & (curve < 0), (before - after) / (2 * curve), 0.0)
    result: Values = np.clip(shift, -0.5, 0.5)
    return result
