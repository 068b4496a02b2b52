"""Makes batches of labelled noise-free tiles from a stream, with the prior of each column."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from .._running import call, running
from ..recipes import Recipe, RecipeLike
from ..streaming import Sample, Stream, stream
from .config import Config
from .contents import Contents, contents_of, processors

#: The arrays of a batch by name. Their first axis is the tile.
Batch = dict[str, npt.NDArray[Any]]

#: Standard deviation of a column in heat maps, in pixels. Columns 3.5 pixels apart are still resolved.
_HEAT_SIGMA_PX = 1.5
#: Greatest number of columns per pixel of a tile. Columns far from the centre are dropped. At the coarsest, a tile of 128 pixels has 500
#: columns.
_COLUMNS_PER_PIXEL = 1 / 24


class TileBatches:
    """Makes batches of tiles by their numbers. A batch depends on its number alone, not on earlier batches or on the process.

    Attributes:
        contents: kinds and priors of the recipes.
        facts: float32 ``[recipe, (inner mrad, outer mrad, thickness nm)]``.
        phases: number of phases of each recipe.
    """

    def __init__(self, config: Config) -> None:
        table = config.stream
        recipes = config.recipes()
        self.batch: int = config.optimiser.batch
        self.contents: Contents = contents_of([recipe for recipe, _ in recipes])
        self.facts: npt.NDArray[np.float32] = np.array(
            [[recipe["detector"]["inner_mrad"], recipe["detector"]["outer_mrad"], recipe["field"]["thickness_nm"]] for recipe, _ in recipes],
            dtype=np.float32,
        )
        self.phases: npt.NDArray[np.int64] = np.array([phases_of(recipe) for recipe, _ in recipes])
        self.columns: int = max(math.ceil(table.size**2 * _COLUMNS_PER_PIXEL), 16)
        weights: dict[RecipeLike, float] = dict(recipes)
        self._stream: Stream = stream(
            weights,
            dose=1.0,
            size=table.size,
            pixel_nm=table.pixel_nm,
            heat_sigma_px=_HEAT_SIGMA_PX,
            seed=table.seed,
            samples_per_specimen=table.samples_per_specimen or None,
            threads=1,
        )

    def prepare(self, first: int = 0) -> None:
        """Lays out the specimens of batches from ``first`` on, so that forked processes share them."""
        index = first * self.batch
        with ThreadPoolExecutor(processors()) as pool:
            list(pool.map(lambda source: call(source.prepare, index, running(1, False)), self._stream._sources))

    def __getitem__(self, number: int) -> Batch:
        first = number * self.batch
        made = [self._labelled(sample) for sample in self._stream.samples(range(first, first + self.batch))]
        return {name: np.stack([one[name] for one in made]) for name in made[0]}

    def _labelled(self, sample: Sample) -> Batch:
        columns, most = sample.targets.columns, self.columns
        size = sample.clean.shape[0]
        places = np.column_stack([columns["x_px"], columns["y_px"]]).astype(np.float64)
        if len(columns) > most:
            near = np.argsort(np.abs(places - (size - 1) / 2).max(axis=1), kind="stable")[:most]
            columns, places = columns[near], places[near]
        count = len(columns)
        rows = self.contents.rows(sample.source, _in_the_field(sample, places), columns["number"].astype(np.int64))
        table: dict[str, npt.NDArray[Any]] = {
            "places": np.full((most, 2), -100.0, dtype=np.float32),
            "row": np.zeros(most, dtype=np.int32),
            "defects": np.zeros((most, 2), dtype=np.int32),
            "there": np.zeros(most, dtype=bool),
        }
        table["places"][:count], table["row"][:count], table["there"][:count] = places, rows, True
        defects = np.column_stack([columns["vacancies"], columns["substitutions"]])
        table["defects"][:count] = np.minimum(defects, self.contents.most[rows])
        half = slice(None, None, 2)
        return {
            **table,
            "clean": sample.clean,
            "heat": sample.targets.heat_map.reshape(size // 2, 2, size // 2, 2).mean(axis=(1, 3)).astype(np.float32),
            "phase": sample.targets.phase_mask[half, half].astype(np.int8),
            "particle": _particles(sample),
            "pixel_nm": np.float32(sample.pixel_nm),
            "source": np.int32(sample.source),
        }


def _in_the_field(sample: Sample, places_px: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Converts places (x, y) in a rotated sample to nm in the field."""
    away = (places_px - (sample.clean.shape[0] - 1) / 2) * sample.pixel_nm
    turn = math.radians(sample.angle_deg)
    cosine, sine = math.cos(turn), math.sin(turn)
    turned = np.column_stack([cosine * away[:, 0] - sine * away[:, 1], sine * away[:, 0] + cosine * away[:, 1]])
    result: npt.NDArray[np.float64] = np.array(sample.centre_nm) + turned
    return result


def _particles(sample: Sample) -> npt.NDArray[np.float32]:
    """Returns a mask of the cells, 2 x 2 pixels each, with their centre in the outline of a particle."""
    size = sample.clean.shape[0] // 2
    middle = 2 * np.arange(size) + 0.5
    mask = np.zeros((size, size), dtype=np.float32)
    for particle in sample.targets.particles:
        mask[np.hypot(middle[:, None] - particle["y_px"], middle[None, :] - particle["x_px"]) <= particle["radius_px"]] = 1.0
    return mask


def phases_of(recipe: Recipe) -> int:
    """Returns the number of phases of a recipe's specimens."""
    if "wells" in recipe:
        return 2
    return len(recipe["domains"]["phases"]) if "domains" in recipe else 1
