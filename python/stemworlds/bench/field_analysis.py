"""Extends counts of defects by tile to a map of the whole field."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from .count_maps import CountProcess
from .field_truth import rare_from
from .findings import Findings

if TYPE_CHECKING:
    from .episodes import Acquired, FieldFacts

Values = npt.NDArray[np.float64]


def with_map(findings: Findings, field: FieldFacts, tiles: Sequence[Acquired], counted: Values, expected: Values | None) -> Findings:
    """Returns findings with a map of the field from counts, and with the places of rare tiles among the acquired ones.

    Args:
        counted: (N, 2), number of defects found in each tile and its standard deviation, NaN if it is unknown.
        expected: the expected map before any acquisition; ``None`` for a constant map with the mean of the counts.
    """
    rows, columns = field.grid
    own = np.array([tile.row * columns + tile.column for tile in tiles], dtype=np.int64)
    counts, sigmas = counted[:, 0], counted[:, 1]
    process = CountProcess((rows, columns), expected)
    process.fit(own, counts, sigmas)
    density = process.predict(own, counts, sigmas).numbers()
    usual = float(density.mean() if expected is None else expected.mean())
    # The weighted mean of a tile's count and the map: the larger the error of the count, the larger the weight of the map.
    weight = np.where(np.isfinite(sigmas), usual / (usual + np.square(sigmas)), 1.0) if usual > 0 else np.ones(len(own))
    level = weight * counts + (1 - weight) * density.ravel()[own]
    return dataclasses.replace(findings, density=density, rare=rare_places(field, own[level >= max(rare_from(usual), 1.0)]))


def cell_share(field: FieldFacts, tile: Acquired) -> float:
    """Returns the area of a cell of the grid divided by the area of an acquisition."""
    return field.size_nm[0] * field.size_nm[1] / (field.grid[0] * field.grid[1]) / tile.size_nm**2


def rare_places(field: FieldFacts, tiles: npt.NDArray[np.int64]) -> Values:
    """Returns the centres of the cells of some tiles, (N, 2), x and y in nm."""
    rows, columns = field.grid
    height, width = field.size_nm
    return np.column_stack([(tiles % columns + 0.5) * width / columns, (tiles // columns + 0.5) * height / rows]).reshape(-1, 2)
