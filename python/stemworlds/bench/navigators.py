"""Navigators with a fixed or random order of tiles, and navigators with a Gaussian process over the tiles."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from ..errors import _invalid
from .peaks import find_peaks
from .extras import needed
from .protocols import Look, Seen

if TYPE_CHECKING:
    from .episodes import Acquired, FieldFacts

__all__ = ["GaussianProcess", "RandomMask", "RandomTiles", "Raster"]

Values = npt.NDArray[np.float64]
Acquisition = Literal["ucb", "ei", "thompson"]
Interest = Literal["variance", "features", "uncertainty"]


class RandomTiles:
    """Chooses a random tile that was not acquired."""

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        self._random = random

    def choose(self, seen: Seen) -> Look | None:
        free = np.flatnonzero(~seen.visited().ravel())
        return None if free.size == 0 else _tile(seen, int(self._random.choice(free)))


class Raster:
    """Chooses the tiles row by row from the upper left, each row from left to right."""

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        pass

    def choose(self, seen: Seen) -> Look | None:
        free = np.flatnonzero(~seen.visited().ravel())
        return None if free.size == 0 else _tile(seen, int(free[0]))


class RandomMask:
    """Chooses a random share of the tiles, drawn at the start of the episode.

    Args:
        share: share of the tiles of the grid. 0.2 is CS-20 of the STEMGym paper.
    """

    def __init__(self, share: float = 0.2) -> None:
        if not 0 < share <= 1:
            raise _invalid("share", f"share = {share}: expected more than 0 and at most 1")
        self.share: float = share

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        tiles = math.prod(field.grid)
        self._order = random.permutation(tiles)[: max(1, round(self.share * tiles))]

    def choose(self, seen: Seen) -> Look | None:
        visited = seen.visited().ravel()
        free = self._order[~visited[self._order]]
        return None if free.size == 0 else _tile(seen, int(free[0]))


class GaussianProcess:
    """Fits a Gaussian process to the interest of the tiles, as a function of their positions.

    Args:
        acquisition: ``"ucb"``, mean + beta x deviation; ``"ei"``, expected improvement; ``"thompson"``, the best of one sample.
        beta: number of deviations for ``"ucb"``. A planner's ``beta`` takes precedence.
        interest: ``"variance"`` of the intensity; ``"features"``, the mean of three standardised features (variance, density of peaks,
            dispersion of their intensities); or ``"uncertainty"`` of the analyst, which needs a method of this name.
        initial: number of random tiles at the start.
        refit: number of tiles from one fit of the kernel to the next.
    """

    def __init__(
        self, acquisition: Acquisition = "ucb", *, beta: float = 2.0, interest: Interest = "variance", initial: int = 4, refit: int = 3
    ) -> None:
        for keyword, value, known in (("acquisition", acquisition, _ACQUISITIONS), ("interest", interest, _INTERESTS)):
            if value not in known:
                raise _invalid(keyword, f"{keyword} = {value!r}: expected one of {', '.join(known)}")
        if not (math.isfinite(beta) and beta >= 0):
            raise _invalid("beta", f"beta = {beta}: expected a number from 0 on")
        if initial < 1 or refit < 1:
            raise _invalid("initial or refit", f"initial = {initial}, refit = {refit}: expected 1 or more")
        self.acquisition: Acquisition = acquisition
        self.beta: float = beta
        self.interest: Interest = interest
        self.initial: int = initial
        self.refit: int = refit

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        rows, columns = field.grid
        places = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), axis=-1).reshape(-1, 2)
        self._places: Values = (places + 0.5) / max(rows, columns)
        self._random = random
        self._kernel: Any = None
        self._fitted = 0
        self._features: list[Values] = []

    def choose(self, seen: Seen) -> Look | None:
        free = np.flatnonzero(~seen.visited().ravel())
        if free.size == 0:
            return None
        if len(seen.tiles) < self.initial:
            return _tile(seen, int(self._random.choice(free)))
        return _tile(seen, int(free[np.argmax(self._values(seen, free))]))

    def _values(self, seen: Seen, free: npt.NDArray[np.intp]) -> Values:
        """Returns the value of the acquisition function for each free tile."""
        target = _INTERESTS[self.interest](self, seen)
        spread = float(target.std())
        target = (target - target.mean()) / (spread if spread > 0 else 1.0)
        columns = seen.field.grid[1]
        visited = self._places[[tile.row * columns + tile.column for tile in seen.tiles]]
        model = self._model(visited, target)
        if self.acquisition == "thompson":
            mean, covariance = model.predict(self._places[free], return_cov=True)
            return _sample(mean, covariance, self._random)
        mean, deviation = model.predict(self._places[free], return_std=True)
        if self.acquisition == "ei":
            return _expected_improvement(mean, deviation, float(target.max()))
        beta = self.beta if seen.plan is None or seen.plan.beta is None else seen.plan.beta
        result: Values = mean + beta * deviation
        return result

    def _model(self, places: Values, target: Values) -> Any:
        """Returns the process, with a new fit of its kernel if it is due."""
        processes, kernels = needed("sklearn.gaussian_process"), needed("sklearn.gaussian_process.kernels")
        again = self._kernel is None or len(target) >= self._fitted + self.refit
        if self._kernel is None:
            self._kernel = kernels.Matern(0.2, (0.02, 2.0), nu=2.5) + kernels.WhiteKernel(0.1, (1e-4, 2.0))
        optimizer = "fmin_l_bfgs_b" if again else None
        model = processes.GaussianProcessRegressor(self._kernel, alpha=1e-8, optimizer=optimizer)
        with warnings.catch_warnings():
            # The fit warns about a kernel at a bound, which is the correct kernel of a field without structure.
            warnings.simplefilter("ignore")
            model.fit(places, target)
        if again:
            self._kernel, self._fitted = model.kernel_, len(target)
        return model


def _variance(_navigator: GaussianProcess, seen: Seen) -> Values:
    return np.array([_intensity(tile).var() for tile in seen.tiles])


def _hand_made(navigator: GaussianProcess, seen: Seen) -> Values:
    known = navigator._features
    known.extend(tile_features(tile) for tile in seen.tiles[len(known) :])
    features = np.array(known)
    spread = features.std(axis=0)
    result: Values = ((features - features.mean(axis=0)) / np.where(spread > 0, spread, 1.0)).mean(axis=1)
    return result


def _uncertainty(_navigator: GaussianProcess, seen: Seen) -> Values:
    if seen.uncertainty_of is None:
        raise _invalid("interest", "interest = 'uncertainty': this analyst does not say how uncertain it is; heuristic, neural and onnx do")
    return np.asarray(seen.uncertainty_of(seen.tiles), dtype=np.float64)


_ACQUISITIONS = ("ucb", "ei", "thompson")
_INTERESTS: dict[str, Callable[[GaussianProcess, Seen], Values]] = {
    "variance": _variance,
    "features": _hand_made,
    "uncertainty": _uncertainty,
}


def tile_features(tile: Acquired) -> Values:
    """Returns the variance of the intensity, the peaks per nm^2, and the relative spread of the peak intensities, (3,)."""
    intensity = _intensity(tile)
    peaks = find_peaks(intensity, tile.pixel_nm)
    level = float(peaks.intensity.mean()) if len(peaks.intensity) else 0.0
    dispersion = float(peaks.intensity.std()) / level if level > 0 else 0.0
    return np.array([intensity.var(), len(peaks.intensity) / tile.size_nm**2, dispersion])


def _intensity(tile: Acquired) -> Values:
    """Returns the image in fractions of the beam, [y, x]."""
    return tile.image.astype(np.float64) * tile.scale + tile.offset


def _expected_improvement(mean: Values, deviation: Values, best: float) -> Values:
    normal = needed("scipy.special")
    deviation = np.maximum(deviation, 1e-12)
    z = (mean - best) / deviation
    density = np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)
    result: Values = (mean - best) * normal.ndtr(z) + deviation * density
    return result


def _sample(mean: Values, covariance: Values, random: np.random.Generator) -> Values:
    """Draws one sample of a multivariate normal distribution."""
    jitter = 1e-6 * max(float(np.trace(covariance)) / len(mean), 1e-12)
    for _ in range(6):
        try:
            root = np.linalg.cholesky(covariance + jitter * np.eye(len(mean)))
            break
        except np.linalg.LinAlgError:
            jitter *= 10
    else:
        root = np.diag(np.sqrt(np.maximum(np.diag(covariance), 0)))
    result: Values = mean + root @ random.standard_normal(len(mean))
    return result


def _tile(seen: Seen, index: int) -> Look:
    return Look(*divmod(index, seen.field.grid[1]))
