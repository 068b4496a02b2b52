"""Maps of a field from counts in a few tiles: Gaussian processes over the grid, averaged over how smooth the field may be."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

#: Correlation lengths along y and x in tiles that are thought possible.
LENGTHS = (0.5, 1.5, 4.0, 12.0, 40.0)
#: Shares of the counts' mean square that the field itself may have; where the noise is not known, the rest is noise.
_SHARES = (0.0, 0.1, 0.3, 0.6, 1.0)
#: Least share that is noise where it is not known, and least variance of the field in units of the noise.
_LEAST_NOISE, _LEAST_FIELD = 0.02, 0.001
#: The likeliest ideas count, as many as these.
_MOST_IDEAS = 12


@dataclass(frozen=True, eq=False)
class CountMap:
    """What is expected in each tile, ``[row, column]``.

    Attributes:
        mean: expected numbers of defects.
        deviation: standard deviations of that expectation: of the field's rate, without the chance of the number itself.
    """

    mean: Values
    deviation: Values

    def numbers(self) -> Values:
        """Expected numbers, none below 0: of a normal distribution what lies below is 0, so a tile of which little is known never gets none."""
        deviation = np.maximum(self.deviation, 1e-12)
        z = np.clip(self.mean / deviation, -30.0, 30.0)
        density = np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)
        below = 0.5 * np.vectorize(math.erfc)(z / math.sqrt(2))
        result: Values = np.maximum(self.mean * (1 - below) + deviation * density, 0.0)
        return result


@dataclass(frozen=True)
class _Field:
    """One idea of the field: correlation lengths in tiles, the field's variance, that of the noise where it is not known, and how likely it is."""

    lengths: tuple[float, float]
    variance: float
    noise: float | None
    weight: float


class CountProcess:
    """A Gaussian process over the tiles of a grid, Matern 3/2, fitted to counts.

    It averages over correlation lengths and variances, each weighted by its likelihood, so that noise alone leaves the map as it was expected.

    Args:
        grid: rows and columns of tiles.
        expected: the map that is expected without counts; ``None`` for one that is the same everywhere, as the counts' mean says.
    """

    def __init__(self, grid: tuple[int, int], expected: Values | None = None) -> None:
        self._grid = grid
        self._expected = expected
        self._ideas: list[_Field] = []

    def fit(self, tiles: Whole, counts: Values, sigmas: Values) -> None:
        """Weighs the ideas.

        Args:
            tiles: (N,), rows times columns plus columns.
            counts: (N,), of each tile.
            sigmas: (N,), their standard deviations; NaN where they are not known.
        """
        level, known = self._level(tiles, counts, sigmas), bool(np.isfinite(sigmas).all())
        off = counts - level
        spread = float(np.mean(off**2)) + 1e-12
        noise = np.square(sigmas) if known else np.full(len(counts), spread)
        ideas = []
        for lengths in itertools.product(LENGTHS, LENGTHS):
            shape = self._kernel(lengths, tiles, tiles)
            for share in _SHARES:
                variance = share * spread + _LEAST_FIELD * float(noise.mean())
                rest = None if known else max(1 - share, _LEAST_NOISE) * spread
                likelihood = _log_likelihood(variance * shape + np.diag(noise if rest is None else np.full(len(counts), rest)), off)
                ideas.append(_Field(lengths, variance, rest, likelihood))
        kept = sorted(ideas, key=lambda idea: -idea.weight)[:_MOST_IDEAS]
        weights = np.exp([idea.weight - kept[0].weight for idea in kept])
        weights /= weights.sum()
        self._ideas = [_Field(idea.lengths, idea.variance, idea.noise, float(weight)) for idea, weight in zip(kept, weights, strict=True)]

    def predict(self, tiles: Whole, counts: Values, sigmas: Values) -> CountMap:
        """The map of all tiles."""
        rows, columns = self._grid
        level = self._level(tiles, counts, sigmas)
        everywhere = np.arange(rows * columns)
        mean, square = np.zeros(rows * columns), np.zeros(rows * columns)
        for idea in self._ideas:
            noise = np.square(sigmas) if idea.noise is None else np.full(len(tiles), idea.noise)
            own = idea.variance * self._kernel(idea.lengths, tiles, tiles) + np.diag(noise)
            across = idea.variance * self._kernel(idea.lengths, everywhere, tiles)
            pulled = across @ np.linalg.inv(own + 1e-9 * idea.variance * np.eye(len(tiles)))
            found = pulled @ (counts - level)
            mean += idea.weight * found
            square += idea.weight * (np.maximum(idea.variance - (pulled * across).sum(axis=1), 0.0) + found**2)
        base = np.full(rows * columns, float(np.mean(level))) if self._expected is None else self._expected.ravel()
        deviation = np.sqrt(np.maximum(square - mean**2, 0.0))
        return CountMap((base + mean).reshape(rows, columns), deviation.reshape(rows, columns))

    def _level(self, tiles: Whole, counts: Values, sigmas: Values) -> Values:
        """What is expected of the tiles."""
        if self._expected is not None:
            result: Values = self._expected.ravel()[tiles]
            return result
        return np.full(len(tiles), float(counts.mean()))

    def _kernel(self, lengths: tuple[float, float], first: Whole, second: Whole) -> Values:
        """Correlations of tiles."""
        columns = self._grid[1]
        down = (first[:, None] // columns - second[None, :] // columns) / lengths[0]
        across = (first[:, None] % columns - second[None, :] % columns) / lengths[1]
        apart = np.sqrt(3 * (down**2 + across**2))
        result: Values = (1 + apart) * np.exp(-apart)
        return result


def _log_likelihood(covariance: Values, off: Values) -> float:
    root = np.linalg.cholesky(covariance)
    half = np.linalg.solve(root, off)
    return float(-0.5 * (half @ half) - np.log(np.diag(root)).sum())
