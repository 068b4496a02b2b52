"""The blind analyst: it knows the recipe's usual specimens, and reads no pixel.

An agent with a score below the blind analyst's score does not profit from its images.
"""

from __future__ import annotations

import functools
import math
import tomllib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..errors import _invalid
from ..recipes import Recipe
from .columns import Columns
from .field_analysis import rare_places
from .field_scores import BEST_COLUMNS
from .field_truth import FIELD_TASKS, expected_counts, field_truth, grid_of, rare_from
from .findings import NO_PHASE, Findings
from .prior import TRAINING_SEEDS, Axis, Prior, prior_of

if TYPE_CHECKING:
    from .episodes import Acquired, FieldFacts

__all__ = ["Usual"]

Values = npt.NDArray[np.float64]
Phases = npt.NDArray[np.int64]

#: Cells along the edge of a tile in which the seen area is counted: the edge (128 pixels) over the shared pixels of neighbouring tiles (4).
_CELLS = 32
#: Number of specimens of the training split from which the usual places of phases are counted.
_PHASE_SPECIMENS = 3


def recipe_of(world: Any) -> Recipe:
    """Returns the recipe of an environment.

    Raises:
        InvalidValue: if the world has no recipe: a recorded image, or a file of another program.
    """
    recipe = getattr(world, "recipe", None)
    if recipe is None:
        raise _invalid("analyst", "this world has no recipe, so nothing is known of it beforehand; Prior and Ideal need recipe=... or a world file built from one")
    found: Recipe = recipe
    return found


class Usual:
    """Declares the usual content of the recipe's specimens in the acquired tiles.

    Defect census: the usual number of defects of each type. Targeted characterisation: the usual number, at random places. Phase mapping:
    the commonest phases in specimens of the training split. Tasks about the field: its usual map. Particle census: one particle of medium
    size in each tile if most tiles contain one, otherwise none.

    Args:
        places: declares random places instead of counts in the defect census as well.
    """

    def __init__(self, places: bool = False) -> None:
        self.places: bool = places
        self._world: Any = None

    def attach(self, world: Any) -> None:
        """Stores the environment of the episode. Its recipe is used; its images are not."""
        self._world = world

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        self._field = field
        self._seed = int(random.integers(2**63))
        self._recipe = recipe_of(self._world)

    def findings(self, tiles: Sequence[Acquired]) -> Findings:
        task = self._field.task
        if task == "phase-mapping":
            return Findings(phases=usual_phases(self._recipe.toml) if self._field.phases else None)
        if task == "particle-census":
            return self._particles(tiles)
        if task in FIELD_TASKS:
            return self._field_map(tiles)
        return self._defects(tiles)

    def tile_counts(self, tiles: Sequence[Acquired]) -> Values:
        """Returns the usual number of defects in each tile, and the standard deviation of that number, (N, 2)."""
        usual = expected_counts(self._recipe, grid_of(self._recipe)).ravel()[[tile.row * self._field.grid[1] + tile.column for tile in tiles]]
        return np.column_stack([usual, np.sqrt(usual) + 1])

    def _field_map(self, tiles: Sequence[Acquired]) -> Findings:
        """Returns the usual map, the seen columns that contain defects most probably by their kind and place, and the tiles that are
        usually rare.

        It reads the places and kinds of the columns from the specimen, as the ideal observer does. It does not read their defects.
        """
        usual = expected_counts(self._recipe, grid_of(self._recipe))
        if not tiles:
            return Findings(density=usual)
        own = np.unique([tile.row * self._field.grid[1] + tile.column for tile in tiles])
        rare = rare_places(self._field, own[usual.ravel()[own] >= max(rare_from(float(usual.mean())), 1.0)])
        columns = np.zeros((0, 3))
        if self._field.task == "field-recall" and self._field.strict:
            columns = self._likeliest(tiles)
        return Findings(density=usual, rare=rare, columns=columns)

    def _likeliest(self, tiles: Sequence[Acquired]) -> Values:
        """Returns the seen columns with the greatest usual numbers of defects."""
        prior, columns = prior_of(self._recipe), field_truth(self._world.specimen().toml).columns
        x, y = columns.places_nm.T
        seen = np.zeros(len(x), dtype=bool)
        for tile in tiles:
            half = tile.size_nm / 2
            seen |= (np.abs(x - tile.centre_nm[0]) <= half) & (np.abs(y - tile.centre_nm[1]) <= half)
        own = Columns(columns.places_nm[seen], columns.kinds[seen], columns.names, columns.defects[seen])
        chances = prior.of(own, None)
        expected = chances @ np.arange(chances.shape[1])
        best = np.argsort(-expected, kind="stable")[:BEST_COLUMNS]
        return np.column_stack([own.places_nm[best], expected[best]])

    def _defects(self, tiles: Sequence[Acquired]) -> Findings:
        prior, counts, named = prior_of(self._recipe), dict[str, int](), dict[str, list[Values]]()
        so_far: dict[str, float] = {}
        for number, (tile, area) in enumerate(zip(tiles, fresh_areas_nm2(tiles), strict=True)):
            random = np.random.default_rng([self._seed, number])
            for kind, expected in prior.expected([tile.centre_nm], [area]).items():
                so_far[kind] = so_far.get(kind, 0.0) + expected
                more = round(so_far[kind]) - counts.get(kind, 0)
                counts[kind] = counts.get(kind, 0) + more
                named.setdefault(kind, []).append(tile.centre_nm + tile.size_nm * random.uniform(-0.5, 0.5, (more, 2)))
        if self._field.task == "defect-census" and not self.places:
            return Findings(counts=counts)
        return Findings(defects={kind: np.concatenate(places) for kind, places in named.items()})

    def _particles(self, tiles: Sequence[Acquired]) -> Findings:
        table = tomllib.loads(self._recipe.toml)
        if "particles" not in table or not tiles:
            return Findings()
        particles, (height, width) = table["particles"], table["field"]["fov_nm"]
        diameter = float(np.mean(particles["diameter_nm"]))
        edge = tiles[0].size_nm
        reached = edge**2 + 2 * edge * diameter + math.pi * diameter**2 / 4
        # Particles have random places, so the probability that none reaches a tile is Poisson's.
        if math.exp(-particles["count"] * reached / (height * width)) > 0.5:
            return Findings()
        places = np.unique([tile.centre_nm for tile in tiles], axis=0)
        return Findings(
            particles=np.column_stack([places, np.full(len(places), diameter)]),
            morphologies=[str(particles["morphologies"][0])] * len(places),
        )


def fresh_areas_nm2(tiles: Sequence[Acquired]) -> list[float]:
    """Returns the area of each tile that no earlier tile shows, with a resolution of 1/32 of a tile's edge."""
    seen: set[tuple[int, int]] = set()
    areas = []
    for tile in tiles:
        cell = tile.size_nm * tile.zoom / _CELLS
        first = [round((centre - tile.size_nm / 2) / cell) for centre in tile.centre_nm]
        edge = max(round(tile.size_nm / cell), 1)
        own = {(first[0] + x, first[1] + y) for x in range(edge) for y in range(edge)} - seen
        seen |= own
        areas.append(len(own) * (tile.size_nm / edge) ** 2)
    return areas


@functools.lru_cache(maxsize=32)
def usual_phases(toml: str) -> Phases:
    """Returns the usual phase of each part of the field.

    The field is divided along x, along y, or not at all. The division is used that predicts left-out specimens best. Three specimens of the
    training split are evaluated, each along one row and one column of tiles.
    """
    recipe = Recipe(toml)
    seen = [_phases_of(recipe, seed) for seed in TRAINING_SEEDS[:_PHASE_SPECIMENS]]
    axes: tuple[Axis, ...] = (None, 0, 1)

    def right(axis: Axis) -> float:
        shares = []
        for n, own in enumerate(seen):
            map_of_others = np.broadcast_to(_commonest([other for m, other in enumerate(seen) if m != n], axis), own.shape)
            known = own != NO_PHASE
            shares.append(float((map_of_others == own)[known].mean()))
        return float(np.mean(shares))

    return _commonest(seen, axes[int(np.argmax([right(axis) for axis in axes]))])


def _phases_of(recipe: Recipe, seed: int) -> Phases:
    """Returns the phases of a specimen along the middle row and column of its tiles; -1 elsewhere."""
    from .environment import MicroscopeEnv

    rows, columns = recipe.grid
    tiles = [(rows // 2, column) for column in range(columns)] + [(row, columns // 2) for row in range(rows)]
    env = MicroscopeEnv("phase-mapping", recipe=recipe, split="train", overview=False, budget=1e9, horizon=4 * len(tiles))
    env.reset(seed=seed)
    for row, column in tiles:
        env.acquire(row, column)
    found = env.truth_seen().phases
    return np.zeros((1, 1), dtype=np.int64) if found is None else np.asarray(found, dtype=np.int64)


def _commonest(seen: Sequence[Phases], axis: Axis) -> Phases:
    """Returns the commonest phase, ``(1, 1)``, ``(1, columns)`` or ``(rows, 1)``. Parts without a tile get the commonest phase of the
    field."""
    shape = max((one.shape for one in seen), key=lambda shape: shape[0] * shape[1])
    phases = np.stack([np.broadcast_to(one, shape) for one in seen])
    most = int(phases.max(initial=0)) + 1
    over = (0, 1, 2) if axis is None else (0, 1 if axis == 0 else 2)
    votes = np.stack([(phases == phase).sum(axis=over, keepdims=True)[0] for phase in range(most)])
    best = votes.argmax(axis=0)
    everywhere = int(votes.reshape(most, -1).sum(axis=1).argmax())
    result: Phases = np.where(votes.sum(axis=0) > 0, best, everywhere).astype(np.int64)
    return result


def prior_at(world: Any) -> Prior:
    """Returns the prior of an environment's recipe."""
    return prior_of(recipe_of(world))
