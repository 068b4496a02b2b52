"""Learns the image of a column with 0, 1, 2 ... defects from noise-free images of the library."""

from __future__ import annotations

import functools
import itertools
import tomllib
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..recipes import Recipe
from ..streaming import stream
from .columns import columns_of
from .extras import needed

Values = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

#: Seed of the training specimen. It is even, as all seeds of the training split, and differs from the prior's seeds.
LEARNED_SEED = 10
#: Number of training tiles.
_TILES = 64
#: A template's radius is half the distance of neighbours plus the first number (nm), limited to the range of the second (nm).
_BEYOND_NM, _RADIUS_NM = 0.02, (0.06, 0.12)
#: Number of principal components of the differences between images of equal columns. The rest is treated as independent noise of each
#: pixel.
MODES = 8
#: Fewest columns from which a template is made.
_LEAST_COLUMNS = 40
#: Most columns that the grade ``mixture`` stores.
_MOST_SAMPLES = 400


@dataclass(frozen=True, eq=False)
class Template:
    """Images around the columns of one kind, on a square grid of the field's pixels with the column in its centre.

    Attributes:
        layers: spline coefficients ``[layer, y, x]``: the mean without a defect, the change by one defect, the modes, scaled to their
            standard deviation, and last the standard deviation of the rest.
        modes: number of modes.
        samples: amplitudes of the modes in the training columns, ``[column, mode]``.
        pixel_nm: edge of a pixel of the grid.
        radius_nm: distance from the column up to which the template is used.
    """

    layers: Values
    modes: int
    samples: Values
    pixel_nm: float
    radius_nm: float

    def at(self, x_nm: Values, y_nm: Values) -> Values:
        """Interpolates all layers at distances from the column, ``[layer, ...]``."""
        ndimage = needed("scipy.ndimage")
        middle = (self.layers.shape[1] - 1) / 2
        places = np.stack([y_nm / self.pixel_nm + middle, x_nm / self.pixel_nm + middle])
        return np.stack([ndimage.map_coordinates(layer, places, order=3, prefilter=False, mode="nearest") for layer in self.layers])


@functools.lru_cache(maxsize=16)
def templates_of(toml: str, target: str | None) -> dict[str, Template]:
    """Returns the templates by kind of column, for defects of the type ``target``, or of all types.

    A kind without defects, or with too few columns in the training tiles, has no template. Particles have none either, since they have
    random orientations and show no columns. Without a template the posterior is the prior.
    """
    if "particles" in tomllib.loads(toml):
        return {}
    recipe = Recipe(toml).with_seed(LEARNED_SEED)
    patches, counts, pixel_nm, radius_nm = _patches(recipe, target)
    made = {}
    for name, own in patches.items():
        number = counts[name]
        if len(own) >= _LEAST_COLUMNS and np.ptp(number) > 0:
            made[name] = _template(own, number, pixel_nm, radius_nm)
    return made


def _patches(recipe: Recipe, target: str | None) -> tuple[dict[str, Values], dict[str, Whole], float, float]:
    """Returns noise-free images around columns by kind, ``[column, y, x]``, their numbers of defects, pixel size and radius in nm."""
    ndimage, spatial = needed("scipy.ndimage"), needed("scipy.spatial")
    samples = stream(recipe, angle_deg=0.0, seed=LEARNED_SEED).samples(range(_TILES))
    every: dict[str, list[Values]] = {}
    counts: dict[str, list[Whole]] = {}
    radius, half = 0.0, 0
    for sample in samples:
        edge = sample.clean.shape[0] * sample.pixel_nm
        corner = np.array(sample.centre_nm) - edge / 2 + sample.pixel_nm / 2
        x, y = sample.centre_nm
        columns = columns_of(recipe.toml, (x - edge / 2, y - edge / 2, x + edge / 2, y + edge / 2))
        if len(columns.kinds) < 2:
            continue
        if not half:
            apart = float(np.median(spatial.cKDTree(columns.places_nm).query(columns.places_nm, k=2)[0][:, 1]))
            radius = float(np.clip(apart / 2 + _BEYOND_NM, *_RADIUS_NM))
            half = int(np.ceil(radius / sample.pixel_nm)) + 2
        places = (columns.places_nm - corner) / sample.pixel_nm
        inside = (places >= half + 2).all(axis=1) & (places <= sample.clean.shape[0] - half - 3).all(axis=1)
        offset = np.arange(-half, half + 1)
        at = [places[inside, axis][:, None, None] + grid for axis, grid in ((1, offset[:, None]), (0, offset[None, :]))]
        spline = ndimage.spline_filter(sample.clean.astype(np.float64), 3)
        found = ndimage.map_coordinates(spline, np.broadcast_arrays(*at), order=3, prefilter=False)
        for kind, name in enumerate(columns.names):
            own = columns.kinds[inside] == kind
            every.setdefault(name, []).append(found[own])
            counts.setdefault(name, []).append(columns.counts(target)[inside][own])
    names = sorted(every)
    return {name: np.concatenate(every[name]) for name in names}, {name: np.concatenate(counts[name]) for name in names}, samples[0].pixel_nm, radius


def _template(patches: Values, counts: Whole, pixel_nm: float, radius_nm: float) -> Template:
    """Fits the template of one kind: a mean image that is linear in the number of defects, and the modes of the deviations."""
    ndimage = needed("scipy.ndimage")
    shape, flat = patches.shape[1:], patches.reshape(len(patches), -1)
    lines = np.column_stack([np.ones(len(counts)), counts])
    (mean, change), *_ = np.linalg.lstsq(lines, flat, rcond=None)
    off = flat - lines @ np.stack([mean, change])
    # The margin for interpolation is excluded from the modes.
    y, x = np.mgrid[: shape[0], : shape[1]] - (shape[0] - 1) / 2
    inside = (np.hypot(x, y) * pixel_nm <= radius_nm + pixel_nm).ravel()
    modes = min(MODES, int(inside.sum()))
    scores, sizes, _ = np.linalg.svd(off[:, inside], full_matrices=False)
    # The sign of a mode is arbitrary. Its greatest weight is made positive, so that templates are equal on all machines.
    weights = scores[:, :modes] * np.sqrt(len(off))
    shapes = weights.T @ off / len(off)
    signs = np.sign(shapes[np.arange(modes), np.abs(shapes).argmax(axis=1)])
    shapes, weights = shapes * signs[:, None], weights * signs
    left = np.sqrt(np.maximum(off.var(axis=0) - (shapes**2).sum(axis=0), 0))
    layers = np.stack([mean, change, *shapes, left]).reshape(-1, *shape)
    coefficients = np.stack([ndimage.spline_filter(layer, 3) for layer in layers])
    step = max(len(weights) // _MOST_SAMPLES, 1)
    return Template(coefficients, modes, np.stack(list(itertools.islice(weights, 0, None, step))), pixel_nm, radius_nm)
