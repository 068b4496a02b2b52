"""The ideal observer: computes the posterior of each column from the counts of its tiles."""

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

#: Sharpness below which a tile has no evidence, and the error of a count without evidence, in units of the usual count.
_LEAST_SHARPNESS, _UNKNOWN = 1e-9, 1e3


@dataclass(eq=False)
class _Evidence:
    """Evidence of all recordings of one column: the log likelihood is ``toward @ v - v @ sharpness @ v / 2`` for v = (defects, modes)."""

    toward: Values
    sharpness: Values
    template: Template


class Ideal:
    """Declares the posterior probabilities of 0, 1, 2 ... defects for each seen column.

    It knows the places and kinds of the columns, the recipe's prior, and the library's images of columns with any number of defects. No
    analyst that reads the same counts can gain more bits on average, within its four approximations: The mean image is linear in the number
    of defects. Columns are evaluated separately, within about 0.1 nm. The variance of the Poisson counts is taken from the mean image.
    Eight modes describe the differences between images of equal columns.

    In the tasks about the whole field it estimates the number of defects in each tile, with its error: the evidence of all columns together
    gives the ratio to the usual number. A Gaussian process around the usual map then gives the map of the field.

    In phase mapping and the particle census it declares the truth of the acquired tiles, which is an upper bound. In phase mapping it
    declares the usual phases elsewhere.

    Args:
        grade: knowledge about frozen phonons and neighbours. ``"linear"``: the modes have a normal distribution. ``"mixture"``: the modes
            have the values of about 400 example columns, with equal probabilities. ``"known"``: the image without the defects is known
            exactly, so all modes are 0. This is an upper bound that needs the truth.
    """

    def __init__(self, grade: Grade = "linear") -> None:
        if grade not in ("linear", "mixture", "known"):
            raise _invalid("grade", f"grade = {grade!r}: expected linear, mixture or known")
        self.grade: Grade = grade
        self._world: Any = None

    def attach(self, world: Any) -> None:
        """Stores the environment of the episode."""
        self._world = world

    def start(self, field: FieldFacts, random: np.random.Generator) -> None:
        self._field = field
        self._target = field.target if field.task == "targeted" else None
        self._recipe = recipe_of(self._world)
        self._places: list[tuple[float, float]] = []
        self._facts: dict[tuple[int, int], tuple[Values, Values]] = {}
        self._evidence: dict[tuple[int, int], _Evidence] = {}
        #: Cached posteriors. A new recording of a column removes its entry.
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
        """Returns the number of defects in each tile and its standard deviation, (N, 2)."""
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
        """Adds the evidence of a tile."""
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
        """Returns the evidence for columns whose images are known except for the defects: the true number with Poisson noise alone.

        The noise is drawn here, from a seed for each column and recording, since the noise-free image of the tile is not available.
        """
        counts = columns.counts(self._target)[own]
        toward = np.zeros(sharpness.shape[:2])
        for n, (index, count) in enumerate(zip(own.tolist(), counts.tolist(), strict=True)):
            x, y = columns.places_nm[index]
            random = np.random.default_rng([self._seed, number, round(x * 1e5) % 2**32, round(y * 1e5) % 2**32])
            information = sharpness[n, 0, 0]
            toward[n, 0] = count * information + np.sqrt(information) * random.standard_normal()
        return toward

    def _declared(self) -> Findings:
        """Returns the posterior probabilities of all seen columns, and the claims for the paper's scores."""
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
    """Returns the linear and the quadratic part of the log likelihood of a tile, in (defects, modes), for each column."""
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
    # The variance of a pixel is Poisson's plus the variance that the modes do not describe.
    weight = np.where(inside, 1 / (electrons * np.maximum(mean, 1e-6) + left**2), 0.0)
    toward = np.einsum("anyx,nyx->na", ways, weight * (seen - electrons * mean))
    sharpness = np.einsum("anyx,bnyx,nyx->nab", ways, ways, weight, optimize=True)
    return toward, sharpness


def log_likelihood(toward: Values, sharpness: Values, template: Template, number: Values, grade: Grade) -> Values:
    """Returns the log likelihood of numbers of defects in a column, up to a constant."""
    if grade == "known":
        result: Values = number * toward[0] - number**2 * sharpness[0, 0] / 2
        return result
    across, of_modes = sharpness[0, 1:], sharpness[1:, 1:]
    if grade == "linear":
        # The modes are normally distributed with deviation 1, so they are integrated out.
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
    """Returns the weighted slope and curvature of each column's log likelihood, ``slope n - curve n^2 / 2`` for n defects.

    The weights contain the prior's mean and variance of the number. The ratio ``sum of slopes / sum of curves`` therefore estimates the
    number of defects in units of the usual number, with the variance ``1 / sum of curves``.
    """
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
    """Returns the number of defects of a tile and its standard deviation, from the evidence of its seen columns.

    ``usual`` is the usual number in the seen part of the tile. ``share`` is the area of the tile divided by the area of the seen part.
    """
    sharp = sum(float(curves.sum()) for _, curves in pulls)
    if usual <= 0 or sharp <= _LEAST_SHARPNESS:
        # Without evidence, the count is the usual number, with an error so large that it has no weight.
        return usual * share, _UNKNOWN * max(usual * share, 1.0)
    times = sum(float(slopes.sum()) for slopes, _ in pulls) / sharp
    return times * usual * share, usual * share / float(np.sqrt(sharp))


def _shares(prior: Prior, columns: Columns) -> Values:
    """Returns the share of each type in the expected number of defects of each column, (N, types)."""
    means = np.column_stack([prior.of(columns, kind) @ np.arange(prior.chances[kind].shape[2]) for kind in DEFECT_TYPES])
    result: Values = means / np.maximum(means.sum(axis=1, keepdims=True), 1e-300)
    return result


def claims(expected: Values) -> npt.NDArray[np.intp]:
    """Returns the indices of the columns with claimed defects, once for each defect.

    The number of claims is the rounded sum of the expected numbers. They go to the columns with the greatest expected numbers.
    """
    whole = np.floor(expected).astype(np.int64)
    more = int(round(float(expected.sum()))) - int(whole.sum())
    if more > 0:
        whole[np.argsort(whole - expected, kind="stable")[:more]] += 1
    return np.repeat(np.arange(len(expected)), whole)
