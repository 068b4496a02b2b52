"""An analyst that runs networks from ``stemworlds train``, and forecasts the defects of each column."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .analysts import TileByTile, entropy_bits, find_regions, places_nm
from .blind import usual_phases
from .columns import DEFECT_TYPES
from .findings import NO_PHASE, Findings
from .ideal import claims
from .network_reading import Reader, SeenColumns
from .peaks import Peaks
from .prior import Prior, prior_of

if TYPE_CHECKING:
    from .episodes import Acquired

__all__ = ["NeuralAnalyst"]

Values = npt.NDArray[np.float64]

#: Two columns closer than this are one column, seen in two tiles.
_SAME_NM = 0.06
#: Least probability of a defect. A kind of column with a lower probability has no defects.
_NEVER = 1e-4
#: Number of parts along the edge of a tile in the phase map.
_PHASE_PARTS = 4
#: Inner and outer angle (mrad) and thickness (nm) for worlds without a recipe: the values of the shipped recipes.
_USUAL_FACTS = (68.0, 200.0, 10.0)


@dataclass(eq=False)
class _Column:
    """Evidence of all tiles for one column."""

    place: Values
    looks: int
    kinds: Values
    toward: Values
    sharpness: Values


class NeuralAnalyst(TileByTile):
    """Declares the posterior probabilities of 0, 1, 2 ... defects for each column that the networks find.

    Dose, electrons per pixel and edge of a pixel come from each observation. The detector's angles and the thickness come from the recipe
    or from the arguments. The networks give the likelihood, which depends on the counts alone. The prior comes from the recipe's specimens
    of the training split, as for the agents ``Prior`` and ``Ideal``; without a recipe it is the prior of the training. Evidence from
    several recordings of a column is added.

    Args:
        models: path of an ONNX file from ``stemworlds train`` or name of a shipped network (:func:`packaged_networks`), or several. The
            evidence of an ensemble is averaged.
        least: the least probability of a column.
        detector_mrad, thickness_nm: angles ``(inner, outer)`` and thickness, instead of the recipe's values.
    """

    def __init__(
        self,
        models: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        *,
        least: float = 0.3,
        detector_mrad: tuple[float, float] | None = None,
        thickness_nm: float | None = None,
    ) -> None:
        self._reader = Reader(models, least)
        self.detector_mrad = detector_mrad
        self.thickness_nm = thickness_nm
        self._world: Any = None

    def attach(self, world: Any) -> None:
        """Stores the environment of the episode. Only its recipe is used."""
        self._world = world

    def begin(self) -> None:
        self._recipe = getattr(self._world, "recipe", None)
        self._facts = self._known_facts()
        self._target = self.field.target if self.field.task == "targeted" else None
        forecasts = self.field.task in ("defect-census", "targeted")
        self._prior: Prior | None = prior_of(self._recipe) if forecasts and self._recipe is not None else None
        self._columns: list[_Column] = []
        self._squares: dict[tuple[int, int], list[int]] = {}
        self._phases: dict[tuple[int, int], Values] = {}
        self._particles: list[tuple[float, float, float]] = []
        self._of_tiles: list[list[int]] = []

    def look(self, tile: Acquired) -> None:
        counts = (tile.image.astype(np.float64) * tile.scale + tile.offset) * tile.electrons_per_pixel
        seen = self._reader.read(np.maximum(counts, 0.0), tile.electrons_per_pixel, tile.pixel_nm, self._facts)
        task = self.field.task
        if task == "phase-mapping" and tile.zoom == 1.0:
            self._phases[tile.row, tile.column] = seen.phases
        if task == "particle-census":
            self._particles += _regions(seen, tile)
        if task not in ("defect-census", "targeted"):
            self._of_tiles.append([])
            return
        places = places_nm(Peaks(seen.places_px[:, 1], seen.places_px[:, 0], seen.sure), tile)
        self._of_tiles.append([self._add(seen, n, place) for n, place in enumerate(places)])

    def summary(self) -> Findings:
        if self.field.task == "phase-mapping":
            return Findings(phases=self._phase_map())
        if self.field.task == "particle-census":
            particles = np.array(self._particles).reshape(-1, 3)
            return Findings(particles=particles, morphologies=["unknown"] * len(particles))
        if not self._columns:
            return Findings()
        places = np.array([column.place for column in self._columns])
        chances, expected = self._forecasts(range(len(self._columns)))
        defects = {}
        for n, kind in enumerate(DEFECT_TYPES):
            if self._target in (None, kind):
                defects[kind] = places[claims(expected[:, n])]
        return Findings(
            defects=defects, columns=np.column_stack([places, 1 - chances[:, 0]]), forecasts=np.column_stack([places, chances])
        )

    def uncertainty(self, tiles: Sequence[Acquired]) -> Values:
        """Returns the mean entropy of the forecasts for each tile's columns, in bits."""
        self._follow(tiles)
        return np.array([float(entropy_bits(self._forecasts(own)[0].T).mean()) if own else 0.0 for own in self._of_tiles])

    def _known_facts(self) -> tuple[float, float, float]:
        inner, outer, thickness = _USUAL_FACTS
        if self._recipe is not None:
            detector = self._recipe["detector"]
            inner, outer, thickness = detector["inner_mrad"], detector["outer_mrad"], self._recipe["field"]["thickness_nm"]
        inner, outer = self.detector_mrad or (inner, outer)
        return float(inner), float(outer), float(self.thickness_nm or thickness)

    def _add(self, seen: SeenColumns, n: int, place: Values) -> int:
        """Adds the evidence of a tile for a column. Returns the column's number."""
        x, y = place.tolist()
        square = (math.floor(x / _SAME_NM), math.floor(y / _SAME_NM))
        near = [m for c in (-1, 0, 1) for r in (-1, 0, 1) for m in self._squares.get((square[0] + c, square[1] + r), ())]
        apart = [float(np.hypot(*(self._columns[m].place - place))) for m in near]
        if near and min(apart) <= _SAME_NM:
            number = near[int(np.argmin(apart))]
            known = self._columns[number]
            known.kinds, known.toward, known.sharpness = known.kinds + seen.kinds[n], known.toward + seen.toward[n], known.sharpness + seen.sharpness[n]
            return number
        self._squares.setdefault(square, []).append(len(self._columns))
        self._columns.append(_Column(place, 1, seen.kinds[n], seen.toward[n], seen.sharpness[n]))
        return len(self._columns) - 1

    def _forecasts(self, numbers: Sequence[int]) -> tuple[Values, Values]:
        """Returns the probabilities of numbers of defects, of the target or of all types, and the expected numbers of each type."""
        own = [self._columns[number] for number in numbers]
        places, kinds = np.array([column.place for column in own]), np.array([column.kinds for column in own])
        of_types = []
        for n, target in enumerate(DEFECT_TYPES):
            prior = self._prior_chances(places, kinds, n, target)
            # Networks cannot learn a type of defect that no training specimen contains, so their evidence for it is ignored.
            possible = (1 - prior[:, :1] > _NEVER) if self._prior is None else np.full((len(own), 1), self._prior.rates[target].any())
            toward, sharpness = (possible * np.array([getattr(column, name)[n] for column in own])[:, None] for name in ("toward", "sharpness"))
            of_types.append(posterior(prior, toward, sharpness))
        expected = np.column_stack([chances @ np.arange(chances.shape[1]) for chances in of_types])
        if self._target is not None:
            return of_types[DEFECT_TYPES.index(self._target)], expected
        return _sums(*of_types), expected

    def _prior_chances(self, places: Values, kinds: Values, n: int, target: str) -> Values:
        known = self._reader.card.kinds
        if self._prior is None:
            result: Values = np.asarray(self._reader.card.usual)[kinds.argmax(axis=1), n]
            return result
        shared = [kind for kind in self._prior.names if kind in known]
        table = self._prior.chances[target]
        rows = np.full(len(places), table.shape[1] - 1)
        if shared:
            best = kinds[:, [known.index(kind) for kind in shared]].argmax(axis=1)
            rows = np.array([self._prior.names.index(kind) for kind in shared])[best]
        found: Values = table[self._prior.part_of(places), rows]
        return found

    def _phase_map(self) -> npt.NDArray[np.int64] | None:
        """Returns the phases of the field in parts of tiles. Parts that were not seen get the recipe's usual phase, if there is a
        recipe."""
        if not self.field.phases:
            return None
        rows, columns = (count * _PHASE_PARTS for count in self.field.grid)
        phases = np.full((rows, columns), NO_PHASE, dtype=np.int64)
        if self._recipe is not None:
            usual = usual_phases(self._recipe.toml)
            take = (np.arange(n) * m // n for n, m in zip((rows, columns), usual.shape, strict=True))
            phases = usual[np.ix_(*take)].copy()
        several = len(self.field.phases)
        for (row, column), chances in self._phases.items():
            cells = chances[:several]
            edge = cells.shape[1] // _PHASE_PARTS * _PHASE_PARTS
            parts = cells[:, :edge, :edge].reshape(len(cells), _PHASE_PARTS, -1, _PHASE_PARTS, edge // _PHASE_PARTS).mean(axis=(2, 4))
            there = (slice(row * _PHASE_PARTS, (row + 1) * _PHASE_PARTS), slice(column * _PHASE_PARTS, (column + 1) * _PHASE_PARTS))
            phases[there] = parts.argmax(axis=0)
        return phases


def posterior(prior: Values, toward: Values, sharpness: Values) -> Values:
    """Returns the probabilities of 0, 1, ... defects, (N, K): prior times likelihood, with the log likelihood ``k toward - k^2 sharpness /
    2``."""
    number = np.arange(prior.shape[1])
    log = np.log(np.maximum(prior, 1e-300)) + number * toward - number**2 * sharpness / 2
    powers = np.exp(log - log.max(axis=1, keepdims=True))
    result: Values = powers / powers.sum(axis=1, keepdims=True)
    return result


def _sums(first: Values, second: Values) -> Values:
    """Returns the probabilities of the sum of two independent numbers. The last class means "that many or more"."""
    classes = max(first.shape[1], second.shape[1])
    out = np.zeros((len(first), classes))
    for n in range(first.shape[1]):
        for m in range(second.shape[1]):
            out[:, min(n + m, classes - 1)] += first[:, n] * second[:, m]
    return out


def _regions(seen: SeenColumns, tile: Acquired) -> list[tuple[float, float, float]]:
    """Returns the particles of a tile: x, y and equivalent diameter in nm."""
    height = tile.image.shape[0]
    found = find_regions(seen.particles > 0.5)
    return [
        (
            tile.centre_nm[0] + ((column + 0.5) * seen.cell_px - height / 2) * tile.pixel_nm,
            tile.centre_nm[1] + ((row + 0.5) * seen.cell_px - height / 2) * tile.pixel_nm,
            diameter * seen.cell_px * tile.pixel_nm,
        )
        for row, column, diameter in found
    ]
