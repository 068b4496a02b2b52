"""The ideal observer: what the counts of a tile tell of each column, and no more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from ..errors import _invalid
from .blind import recipe_of, usual_phases
from .columns import DEFECT_TYPES, Columns, columns_of
from .field_analysis import cell_share, with_map
from .field_scores import BEST_COLUMNS
from .field_truth import FIELD_TASKS, expected_counts, field_truth, grid_of
from .findings import NO_PHASE, Findings
from .prior import Prior, prior_of
from .templates import Template, templates_of

if TYPE_CHECKING:
    from .episodes import Acquired, FieldFacts

__all__ = ["Ideal"]

Values = npt.NDArray[np.float64]
Grade = Literal["linear", "mixture", "known"]

#: Evidence below this says nothing, and a count without evidence has an error of so many times what is usual.
_LEAST_SHARPNESS, _UNKNOWN = 1e-9, 1e3


@dataclass(eq=False)
class _Evidence:
    """What all recordings say of one column: the log likelihood is ``toward @ v - v @ sharpness @ v / 2`` for v = (defects, modes)."""

    toward: Values
    sharpness: Values
    template: Template


class Ideal:
    """Declares, for each column it has seen, the posterior chances of 0, 1, 2 ... defects.

    It knows where the columns are and of what kind, the recipe's prior, and the images of columns with any number of defects from the
    library: no analyst that reads the same counts can have more bits on average, up to its approximations. These are: the mean image
    is a straight line in the number of defects; columns are judged one by one, within some 0.1 nm; Poisson counts have the variance of
    the mean image; eight modes tell how images of equal columns differ.

    In the tasks that ask for the field it counts the defects of each tile, with their error: the columns' evidence together tells how many times the usual
    number there are. The map of the field follows from that by a Gaussian process about the usual map.

    In phase mapping and the particle census it declares the truth of what was seen, and in phase mapping what is usual elsewhere: an upper bound.

    Args:
        grade: what is known of the frozen phonons and neighbours. ``"linear"``: the normal distribution of the modes. ``"mixture"``: the
            modes of some 400 columns that were learned from, each as likely. ``"known"``: all modes are 0 and the change by a defect is
            added to the very image, as if it were known but for the defects: a bound from above, which needs the truth.
    """

    def __init__(self, grade: Grade = "linear") -> None:
        if grade not in ("linear", "mixture", "known"):
            raise _invalid("grade", f"grade = {grade!r}: expected linear, mixture or known")
        self.grade: Grade = grade
        self._world: Any = None

    def attach(self, world: Any) -> None:
        """Takes the environment that is played."""
        self._world = world

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        self._field = field
        self._target = field.target if field.task == "targeted" else None
        self._recipe = recipe_of(self._world)
        self._places: list[tuple[float, float]] = []
        self._facts: dict[tuple[int, int], tuple[Values, Values]] = {}
        self._evidence: dict[tuple[int, int], _Evidence] = {}
        #: Posteriors that no later recording has changed.
        self._known: dict[tuple[int, int], Values] = {}
        self._looked = 0
        self._seed = int(random.integers(2**63))
        self._counted: list[tuple[float, float]] = []
        self._usual: Values | None = None
        if field.task in FIELD_TASKS:
            self._usual = expected_counts(self._recipe, grid_of(self._recipe))
        if field.task in ("defect-census", "targeted", *FIELD_TASKS):
            self._specimen = self._world.specimen().toml
            self._prior: Prior = prior_of(self._recipe)
            self._templates = templates_of(self._recipe.with_seed(0).toml, self._target)

    def findings(self, tiles: Sequence[Acquired]) -> Findings:
        if self._field.task == "particle-census":
            truth: Findings = self._world.truth_seen()
            return truth
        if self._field.task == "phase-mapping":
            return self._phases()
        self._follow(tiles)
        found = self._declared()
        if self._usual is None or not self._counted:
            return found
        likeliest = found.columns[np.argsort(-found.columns[:, 2], kind="stable")[:BEST_COLUMNS]]
        return with_map(Findings(columns=likeliest), self._field, tiles, np.array(self._counted), self._usual)

    def tile_counts(self, tiles: Sequence[Acquired]) -> Values:
        """Defects in each tile and their standard deviations, (N, 2)."""
        self._follow(tiles)
        return np.array(self._counted, dtype=np.float64).reshape(-1, 2)

    def _follow(self, tiles: Sequence[Acquired]) -> None:
        for number in range(self._looked, len(tiles)):
            self._look(tiles[number], number)
        self._looked = len(tiles)

    def _phases(self) -> Findings:
        truth: Findings = self._world.truth_seen()
        if truth.phases is None:
            return truth
        usual = usual_phases(self._recipe.toml)
        rows, columns = (np.arange(n) * m // n for n, m in zip(truth.phases.shape, usual.shape, strict=True))
        return Findings(phases=np.where(truth.phases == NO_PHASE, usual[np.ix_(rows, columns)], truth.phases))

    def _look(self, tile: Acquired, number: int) -> None:
        """Adds what a tile says."""
        x, y = tile.centre_nm
        half = tile.size_nm / 2
        view = (x - half, y - half, x + half, y + half)
        columns = columns_of(self._specimen, view) if self._usual is None else field_truth(self._specimen).columns.within(*view)
        chances, shares = self._prior.of(columns, self._target), _shares(self._prior, columns)
        keys = [(round(x * 1e5), round(y * 1e5)) for x, y in columns.places_nm.tolist()]
        for n, key in enumerate(keys):
            self._facts.setdefault(key, (chances[n], shares[n]))
        pulls: list[tuple[Values, Values]] = []
        for kind, name in enumerate(columns.names):
            template = self._templates.get(name)
            own = np.flatnonzero(columns.kinds == kind)
            if template is None or not len(own):
                continue
            toward, sharpness = evidence(tile, columns.places_nm[own], template)
            if self.grade == "known":
                toward = self._of_the_known_image(number, columns, own, sharpness)
            pulls.append(_pull(toward, sharpness, chances[own], self.grade))
            for n, index in enumerate(own):
                known = self._evidence.get(keys[index])
                if known is None:
                    self._evidence[keys[index]] = _Evidence(toward[n], sharpness[n], template)
                else:
                    self._known.pop(keys[index], None)
                    known.toward = known.toward + toward[n]
                    known.sharpness = known.sharpness + sharpness[n]
        self._counted.append(_count(float((chances @ np.arange(chances.shape[1])).sum()), pulls, cell_share(self._field, tile)))

    def _of_the_known_image(self, number: int, columns: Columns, own: npt.NDArray[np.intp], sharpness: Values) -> Values:
        """What counts would say of columns whose images are known but for the defects: the true number, and Poisson noise alone. The noise
        is drawn anew, from a seed for each column and recording, since the noise-free image of the tile is not at hand."""
        counts = columns.counts(self._target)[own]
        toward = np.zeros(sharpness.shape[:2])
        for n, (index, count) in enumerate(zip(own.tolist(), counts.tolist(), strict=True)):
            x, y = columns.places_nm[index]
            random = np.random.default_rng([self._seed, number, round(x * 1e5) % 2**32, round(y * 1e5) % 2**32])
            information = sharpness[n, 0, 0]
            toward[n, 0] = count * information + np.sqrt(information) * random.standard_normal()
        return toward

    def _declared(self) -> Findings:
        """Posterior chances of all columns seen, and the claims that the paper's scores ask for."""
        keys = sorted(self._facts)
        if not keys:
            return Findings()
        places = np.array(keys, dtype=np.float64) / 1e5
        posterior = np.array([self._posterior(key) for key in keys])
        expected: Values = posterior @ np.arange(posterior.shape[1], dtype=np.float64)
        shares = np.array([self._facts[key][1] for key in keys])
        defects = {}
        for n, kind in enumerate(DEFECT_TYPES):
            if self._target in (None, kind):
                defects[kind] = places[claims(expected if self._target else expected * shares[:, n])]
        sure = np.column_stack([places, 1 - posterior[:, 0] if self._usual is None else expected])
        return Findings(defects=defects, columns=sure, forecasts=np.column_stack([places, posterior]))

    def _posterior(self, key: tuple[int, int]) -> Values:
        if key not in self._known:
            self._known[key] = self._made(key)
        return self._known[key]

    def _made(self, key: tuple[int, int]) -> Values:
        prior = self._facts[key][0]
        evidence = self._evidence.get(key)
        if evidence is None:
            return prior
        number = np.arange(len(prior), dtype=np.float64)
        log = np.log(prior) + log_likelihood(evidence.toward, evidence.sharpness, evidence.template, number, self.grade)
        chances = np.exp(log - log.max())
        result: Values = chances / chances.sum()
        return result


def evidence(tile: Acquired, places_nm: Values, template: Template) -> tuple[Values, Values]:
    """What a tile says of columns: for each the linear and the quadratic part of its log likelihood in (defects, modes)."""
    height, width = tile.image.shape
    pixel, electrons = tile.pixel_nm, tile.electrons_per_pixel
    counts = (tile.image.astype(np.float64) * tile.scale + tile.offset) * electrons
    corner = np.array(tile.centre_nm) - (np.array([width, height]) - 1) / 2 * pixel
    near = np.rint((places_nm - corner) / pixel).astype(np.int64)
    half = int(np.ceil(template.radius_nm / pixel))
    offset = np.arange(-half, half + 1)
    columns, rows = near[:, 0, None, None] + offset[None, None, :], near[:, 1, None, None] + offset[None, :, None]
    columns, rows = np.broadcast_arrays(columns, rows)
    x = corner[0] + columns * pixel - places_nm[:, 0, None, None]
    y = corner[1] + rows * pixel - places_nm[:, 1, None, None]
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height) & (np.hypot(x, y) <= template.radius_nm)
    seen = counts[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    layers = template.at(x, y)
    mean, ways, left = layers[0], electrons * layers[1:-1], electrons * layers[-1]
    # A pixel has Poisson's variance, and that of what the modes leave.
    weight = np.where(inside, 1 / (electrons * np.maximum(mean, 1e-6) + left**2), 0.0)
    toward = np.einsum("anyx,nyx->na", ways, weight * (seen - electrons * mean))
    sharpness = np.einsum("anyx,bnyx,nyx->nab", ways, ways, weight, optimize=True)
    return toward, sharpness


def log_likelihood(toward: Values, sharpness: Values, template: Template, number: Values, grade: Grade) -> Values:
    """Log likelihood of numbers of defects in a column, but for a constant."""
    if grade == "known":
        result: Values = number * toward[0] - number**2 * sharpness[0, 0] / 2
        return result
    across, of_modes = sharpness[0, 1:], sharpness[1:, 1:]
    if grade == "linear":
        # Modes are normal with deviation 1: they are integrated out.
        solved = np.linalg.solve(np.eye(template.modes) + of_modes, np.column_stack([toward[1:], across]))
        slope, curve = toward[0] - across @ solved[:, 0], sharpness[0, 0] - across @ solved[:, 1]
        result = number * slope - number**2 * curve / 2
        return result
    samples = template.samples
    own = samples @ toward[1:] - ((samples @ of_modes) * samples).sum(axis=1) / 2
    logs = number[:, None] * (toward[0] - samples @ across)[None, :] + own[None, :]
    most = logs.max(axis=1)
    result = most + np.log(np.exp(logs - most[:, None]).mean(axis=1)) - number**2 * sharpness[0, 0] / 2
    return result


def _pull(toward: Values, sharpness: Values, prior: Values, grade: Grade) -> tuple[Values, Values]:
    """Of columns, by how much their counts ask for more defects than none, and how sharply: each column's log likelihood for n defects is
    ``slope n - curve n^2 / 2``. Both are weighted by the mean and variance that the prior gives the number, so that their sums say how
    many times the usual number there are: ``sum of slopes / sum of curves``, with the variance ``1 / sum of curves``."""
    if grade == "known":
        slope, curve = toward[:, 0], sharpness[:, 0, 0]
    else:
        across, of_modes = sharpness[:, 0, 1:], sharpness[:, 1:, 1:]
        solved = np.linalg.solve(np.eye(of_modes.shape[1]) + of_modes, np.stack([toward[:, 1:], across], axis=-1))
        slope = toward[:, 0] - np.einsum("nm,nm->n", across, solved[:, :, 0])
        curve = sharpness[:, 0, 0] - np.einsum("nm,nm->n", across, solved[:, :, 1])
    number = np.arange(prior.shape[1], dtype=np.float64)
    mean = prior @ number
    variance = prior @ number**2 - mean**2
    fading = 1 / (1 + curve * variance)
    return mean * slope * fading, mean**2 * curve * fading


def _count(usual: float, pulls: Sequence[tuple[Values, Values]], share: float) -> tuple[float, float]:
    """Defects of a tile and their standard deviation, from those that are usual in what was seen of it and the evidence of its columns; ``share`` is
    the tile's area over that of what was seen."""
    sharp = sum(float(curves.sum()) for _, curves in pulls)
    if usual <= 0 or sharp <= _LEAST_SHARPNESS:
        # Nothing was told: as usual, and not known.
        return usual * share, _UNKNOWN * max(usual * share, 1.0)
    times = sum(float(slopes.sum()) for slopes, _ in pulls) / sharp
    return times * usual * share, usual * share / float(np.sqrt(sharp))


def _shares(prior: Prior, columns: Columns) -> Values:
    """Of the defects to be expected in each column the share of each type, (N, types)."""
    means = np.column_stack([prior.of(columns, kind) @ np.arange(prior.chances[kind].shape[2]) for kind in DEFECT_TYPES])
    result: Values = means / np.maximum(means.sum(axis=1, keepdims=True), 1e-300)
    return result


def claims(expected: Values) -> npt.NDArray[np.intp]:
    """Indices of columns, each as often as defects are claimed in it: as many in all as are to be expected, where most are."""
    whole = np.floor(expected).astype(np.int64)
    more = int(round(float(expected.sum()))) - int(whole.sum())
    if more > 0:
        whole[np.argsort(whole - expected, kind="stable")[:more]] += 1
    return np.repeat(np.arange(len(expected)), whole)
