"""Analysts without a network: one that declares nothing, one that declares the truth, and one with thresholds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from ..errors import _invalid
from .field_analysis import cell_share, with_map
from .field_scores import BEST_COLUMNS
from .field_truth import FIELD_TASKS
from .findings import Findings
from .peaks import Peaks, find_peaks
from .extras import needed

if TYPE_CHECKING:
    from .episodes import Acquired, FieldFacts

__all__ = ["Heuristic", "Nothing", "Oracle", "TileByTile"]

Values = npt.NDArray[np.float64]

#: Two defects of one kind closer than this are one defect, seen in two overlapping tiles.
_SAME_NM = 0.08


class Nothing:
    """Declares no defects, one phase and no particles. Its score is the floor of every navigator."""

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        pass

    def findings(self, tiles: Sequence[Acquired]) -> Findings:
        return Findings()


class _KnowsTruth(Protocol):
    def truth_seen(self) -> Findings: ...


class Oracle:
    """Declares the truth of the acquired tiles. Its score is the ceiling of every navigator."""

    def __init__(self) -> None:
        self._world: _KnowsTruth | None = None

    def attach(self, world: _KnowsTruth) -> None:
        """Stores the environment of the episode. The agent calls this before an episode."""
        self._world = world

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        pass

    def findings(self, tiles: Sequence[Acquired]) -> Findings:
        if self._world is None:
            raise _invalid("analyst", "Oracle: no environment; play it by stemworlds.bench.play, or call attach first")
        return self._world.truth_seen()


class TileByTile:
    """Base of analysts that analyse each tile once. Derived classes define :meth:`look` and :meth:`summary`."""

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        self.field: FieldFacts = field
        self.random: np.random.Generator = random
        self._looked: list[Acquired] = []
        self.begin()

    def findings(self, tiles: Sequence[Acquired]) -> Findings:
        self._follow(tiles)
        return self.summary()

    def _follow(self, tiles: Sequence[Acquired]) -> None:
        known = len(self._looked)
        if len(tiles) < known or any(a is not b for a, b in zip(tiles, self._looked, strict=False)):
            # The tiles do not continue the list of the last call, so the analysis starts again.
            self._looked, known = [], 0
            self.begin()
        for tile in tiles[known:]:
            self.look(tile)
            self._looked.append(tile)

    def begin(self) -> None:
        """Forgets all tiles."""
        raise NotImplementedError

    def look(self, tile: Acquired) -> None:
        """Analyses one more tile."""
        raise NotImplementedError

    def summary(self) -> Findings:
        """Returns the findings of all tiles."""
        raise NotImplementedError


class PlacedDefects:
    """Collects defects by kind. A defect in two overlapping tiles counts once."""

    def __init__(self) -> None:
        self._places: dict[str, list[tuple[float, float]]] = {}
        #: Places of each kind, sorted into squares of that edge length, so that a search visits nine squares only.
        self._squares: dict[tuple[str, int, int], list[tuple[float, float]]] = {}

    def add(self, kind: str, places_nm: Values) -> None:
        """Adds places (N, 2), x and y in nm, except places that are already stored."""
        fresh = [(x, y) for x, y in places_nm.reshape(-1, 2).tolist() if not self._known(kind, x, y)]
        self._places.setdefault(kind, []).extend(fresh)
        for x, y in fresh:
            self._squares.setdefault((kind, *_square(x, y)), []).append((x, y))

    def _known(self, kind: str, x: float, y: float) -> bool:
        column, row = _square(x, y)
        near = (self._squares.get((kind, c, r), ()) for c in range(column - 1, column + 2) for r in range(row - 1, row + 2))
        return any(math.hypot(x - other_x, y - other_y) <= _SAME_NM for places in near for other_x, other_y in places)

    def arrays(self) -> dict[str, Values]:
        return {kind: np.array(places, dtype=np.float64).reshape(-1, 2) for kind, places in sorted(self._places.items())}


def _square(x: float, y: float) -> tuple[int, int]:
    return math.floor(x / _SAME_NM), math.floor(y / _SAME_NM)


class Heuristic(TileByTile):
    """The STEMGym paper's analyst with thresholds.

    Atoms: each peak of a tile has a z-score against the running mean and deviation of all peak intensities of the episode, including this
    tile. A peak above ``threshold`` is a substitution, a peak below its negative a vacancy.

    Phases: the mean intensities of the tiles are split at their median into two phases if the halves are ``bimodality`` deviations apart
    (Cohen's d); otherwise there is one phase. The split of a single normal distribution has d = 2.65, of a uniform distribution 3.46.

    Args:
        threshold: in standard deviations.
        bimodality: the least Cohen's d that makes two phases.
        particles: finds particles by Otsu's threshold, connected regions and equivalent diameter. By default no particles are declared.
    """

    def __init__(self, threshold: float = 1.5, *, bimodality: float = 4.0, particles: bool = False) -> None:
        if not (math.isfinite(threshold) and threshold > 0):
            raise _invalid("threshold", f"threshold = {threshold}: expected a number above 0")
        if not (math.isfinite(bimodality) and bimodality >= 0):
            raise _invalid("bimodality", f"bimodality = {bimodality}: expected a number from 0 on")
        self.threshold: float = threshold
        self.bimodality: float = bimodality
        self.particles: bool = particles

    def begin(self) -> None:
        self._count, self._mean, self._squares = 0, 0.0, 0.0
        self._defects = PlacedDefects()
        self._columns: list[Values] = []
        self._levels: list[tuple[int, int, float]] = []
        self._found: list[tuple[float, float, float]] = []
        self._uncertain: list[float] = []
        self._counted: list[tuple[float, float]] = []

    def look(self, tile: Acquired) -> None:
        intensity = tile.image.astype(np.float64) * tile.scale + tile.offset
        self._levels.append((tile.row, tile.column, float(intensity.mean())))
        peaks = find_peaks(intensity, tile.pixel_nm)
        self._remember(peaks.intensity)
        z = self._scores(peaks.intensity)
        places = places_nm(peaks, tile)
        self._defects.add("substitution", places[z > self.threshold])
        self._defects.add("vacancy", places[z < -self.threshold])
        self._columns.append(np.column_stack([places, np.abs(z)]))
        self._counted.append((float((np.abs(z) > self.threshold).sum()) * cell_share(self.field, tile), math.nan))
        self._uncertain.append(_doubt(np.abs(z) - self.threshold))
        if self.particles:
            self._found.extend(find_particles(intensity, tile))

    def summary(self) -> Findings:
        particles = np.array(self._found, dtype=np.float64).reshape(-1, 3)
        columns = np.concatenate([np.zeros((0, 3)), *self._columns])
        names = ["unknown"] * len(particles)
        found = Findings(
            counts=None,
            defects=self._defects.arrays(),
            phases=self._phases(),
            particles=particles,
            morphologies=names,
            columns=columns,
        )
        if self.field.task in FIELD_TASKS and self._counted:
            best = columns[np.argsort(-columns[:, 2], kind="stable")[:BEST_COLUMNS]]
            return with_map(Findings(columns=best), self.field, self._looked, np.array(self._counted), None)
        return found

    def tile_counts(self, tiles: Sequence[Acquired]) -> Values:
        """Returns the number of claimed defects in each tile, and NaN as its unknown error, (N, 2)."""
        self._follow(tiles)
        return np.array(self._counted, dtype=np.float64).reshape(-1, 2)

    def uncertainty(self, tiles: Sequence[Acquired]) -> Values:
        """Returns for each tile how close its peaks are to the threshold: the mean entropy of a logistic step, in bits."""
        self._follow(tiles)
        return np.array(self._uncertain)

    def _remember(self, intensity: Values) -> None:
        """Updates the running mean and sum of squares by Welford's method."""
        for value in intensity.tolist():
            self._count += 1
            step = value - self._mean
            self._mean += step / self._count
            self._squares += step * (value - self._mean)

    def _scores(self, intensity: Values) -> Values:
        deviation = math.sqrt(self._squares / self._count) if self._count else 0.0
        if deviation == 0:
            return np.zeros_like(intensity)
        result: Values = (intensity - self._mean) / deviation
        return result

    def _phases(self) -> npt.NDArray[np.int64] | None:
        """Returns the phase of each acquired tile, and -1 for the others, (rows, columns)."""
        split = median_split(np.array([level for _, _, level in self._levels]), self.bimodality)
        if split is None:
            return None
        grid = np.full(self.field.grid, -1, dtype=np.int64)
        for (row, column, _), upper in zip(self._levels, split, strict=True):
            grid[row, column] = int(upper)
        return grid


def median_split(levels: Values, least_d: float) -> npt.NDArray[np.bool_] | None:
    """Returns a mask of the levels above the median; ``None`` if the halves are less than ``least_d`` deviations apart (Cohen's d)."""
    upper = levels > np.median(levels) if len(levels) else np.zeros(0, dtype=bool)
    high, low = levels[upper], levels[~upper]
    if min(len(high), len(low)) < 2:
        return None
    freedom = len(high) + len(low) - 2
    pooled = math.sqrt((high.var(ddof=1) * (len(high) - 1) + low.var(ddof=1) * (len(low) - 1)) / freedom)
    apart = float(high.mean() - low.mean())
    return upper if apart > 0 and apart >= least_d * pooled else None


def places_nm(peaks: Peaks, tile: Acquired) -> Values:
    """Returns the places (N, 2) of peaks, x and y in nm in the field."""
    height, width = tile.image.shape
    x = tile.centre_nm[0] + (peaks.column_px - (width - 1) / 2) * tile.pixel_nm
    y = tile.centre_nm[1] + (peaks.row_px - (height - 1) / 2) * tile.pixel_nm
    return np.column_stack([x, y])


def find_particles(intensity: Values, tile: Acquired, *, least_nm: float = 0.5) -> list[tuple[float, float, float]]:
    """Finds the bright regions of a tile, as (x, y, equivalent diameter) in nm.

    The threshold is Otsu's, of the image smoothed by 0.1 nm. There is no region if the two sides of it are less than 4 deviations apart.
    """
    filters, ndimage = needed("skimage.filters"), needed("scipy.ndimage")
    smooth: Values = ndimage.gaussian_filter(intensity, max(0.1 / tile.pixel_nm, 1.0), mode="nearest")
    if float(np.ptp(smooth)) == 0:
        return []
    level = float(filters.threshold_otsu(smooth))
    bright, dark = smooth[smooth > level], smooth[smooth <= level]
    if min(bright.size, dark.size) < 2 or float(bright.mean() - dark.mean()) < 4 * math.sqrt((bright.var() + dark.var()) / 2):
        return []
    height, width = intensity.shape
    found = []
    for row, column, across in find_regions(smooth > level):
        diameter = across * tile.pixel_nm
        if diameter >= least_nm:
            x = tile.centre_nm[0] + (column - (width - 1) / 2) * tile.pixel_nm
            y = tile.centre_nm[1] + (row - (height - 1) / 2) * tile.pixel_nm
            found.append((float(x), float(y), diameter))
    return found


def find_regions(mask: npt.NDArray[np.bool_]) -> list[tuple[float, float, float]]:
    """Finds connected regions of pixels: row and column of the centroid, and the diameter of a circle of equal area, in pixels."""
    measure = needed("skimage.measure")
    regions: list[Any] = measure.regionprops(measure.label(mask))
    return [(*map(float, region.centroid), float(region.equivalent_diameter_area)) for region in regions]  # type: ignore[misc]


def _doubt(beyond: Values) -> float:
    """Returns the mean entropy in bits of logistic steps, each a quarter of a deviation wide."""
    if beyond.size == 0:
        return 0.0
    chance = 1 / (1 + np.exp(-np.clip(beyond / 0.25, -40, 40)))
    return float(entropy_bits(np.stack([chance, 1 - chance])).mean())


def entropy_bits(chances: Values) -> Values:
    """Returns the entropy over the first axis, in bits."""
    result: Values = -(chances * np.log2(np.maximum(chances, 1e-300))).sum(axis=0)
    return result
