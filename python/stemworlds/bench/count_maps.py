"""Estimates maps of a field from counts in a few tiles, by Gaussian processes over the grid, averaged over correlation lengths."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

#: Correlation lengths, in tiles, that are tried along y and x.
LENGTHS = (0.5, 1.5, 4.0, 12.0, 40.0)
#: Shares of the counts' mean square that are tried for the variance of the field. If the noise is unknown, the rest is noise.
_SHARES = (0.0, 0.1, 0.3, 0.6, 1.0)
#: Least share of noise if the noise is unknown, and least variance of the field in units of the noise.
_LEAST_NOISE, _LEAST_FIELD = 0.02, 0.001
#: Number of hypotheses that are kept, the likeliest first.
_MOST_IDEAS = 12


@dataclass(frozen=True, eq=False)
class CountMap:
    """Expected numbers of defects in each tile, ``[row, column]``.

    Attributes:
        mean: expected numbers of defects.
        deviation: standard deviations of the expected numbers. They contain the uncertainty of the rate, without Poisson noise.
    """

    mean: Values
    deviation: Values

    def numbers(self) -> Values:
        """Returns expected numbers that are not negative: means of the normal distributions with their negative part set to 0.

        An uncertain tile therefore never gets 0.
        """
        deviation = np.maximum(self.deviation, 1e-12)
        z = np.clip(self.mean / deviation, -30.0, 30.0)
        density = np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)
        below = 0.5 * np.vectorize(math.erfc)(z / math.sqrt(2))
        result: Values = np.maximum(self.mean * (1 - below) + deviation * density, 0.0)
        return result


@dataclass(frozen=True)
class _Field:
    """One hypothesis: correlation lengths in tiles, variance of the field, variance of the noise if it is unknown, and weight."""

    lengths: tuple[float, float]
    variance: float
    noise: float | None
    weight: float


class CountProcess:
    """A Gaussian process over the tiles of a grid, Matern 3/2, fitted to counts.

    It averages over correlation lengths and variances, weighted by their likelihoods. Pure noise therefore leaves the expected map
    unchanged.

    Args:
        grid: rows and columns of tiles.
        expected: the expected map before any count, ``[row, column]``; ``None`` for a constant map with the mean of the counts.
    """

    def __init__(self, grid: tuple[int, int], expected: Values | None = None) -> None:
        self._grid = grid
        self._expected = expected
        self._ideas: list[_Field] = []

    def fit(self, tiles: Whole, counts: Values, sigmas: Values) -> None:
        """Computes the weights of the hypotheses.

        Args:
            tiles: (N,), indices of the tiles: row times number of columns, plus column.
            counts: (N,), number of defects counted in each tile.
            sigmas: (N,), standard deviations of the counts; NaN for unknown ones.
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
        """Returns the map of all tiles."""
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
        """Returns the expected numbers of the tiles before any count."""
        if self._expected is not None:
            result: Values = self._expected.ravel()[tiles]
            return result
        return np.full(len(tiles), float(counts.mean()))

    def _kernel(self, lengths: tuple[float, float], first: Whole, second: Whole) -> Values:
        """Returns the correlations between tiles."""
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
