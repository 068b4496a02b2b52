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
from .findings import NO_PHASE, Findings
from .prior import Prior, prior_of
from .templates import Template, templates_of

if TYPE_CHECKING:
    from .episodes import Acquired, FieldFacts

__all__ = ["Ideal"]

Values = npt.NDArray[np.float64]
Grade = Literal["linear", "mixture", "known"]


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
        if field.task in ("defect-census", "targeted"):
            self._specimen = self._world.specimen().toml
            self._prior: Prior = prior_of(self._recipe)
            self._templates = templates_of(self._recipe.with_seed(0).toml, self._target)

    def findings(self, tiles: Sequence[Acquired]) -> Findings:
        if self._field.task == "particle-census":
            truth: Findings = self._world.truth_seen()
            return truth
        if self._field.task == "phase-mapping":
            return self._phases()
        for number in range(self._looked, len(tiles)):
            self._look(tiles[number], number)
        self._looked = len(tiles)
        return self._declared()

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
        columns = columns_of(self._specimen, (x - half, y - half, x + half, y + half))
        chances, shares = self._prior.of(columns, self._target), _shares(self._prior, columns)
        keys = [(round(x * 1e5), round(y * 1e5)) for x, y in columns.places_nm.tolist()]
        for n, key in enumerate(keys):
            self._facts.setdefault(key, (chances[n], shares[n]))
        for kind, name in enumerate(columns.names):
            template = self._templates.get(name)
            own = np.flatnonzero(columns.kinds == kind)
            if template is None or not len(own):
                continue
            toward, sharpness = evidence(tile, columns.places_nm[own], template)
            if self.grade == "known":
                toward = self._of_the_known_image(number, columns, own, sharpness)
            for n, index in enumerate(own):
                known = self._evidence.get(keys[index])
                if known is None:
                    self._evidence[keys[index]] = _Evidence(toward[n], sharpness[n], template)
                else:
                    self._known.pop(keys[index], None)
                    known.toward = known.toward + toward[n]
                    known.sharpness = known.sharpness + sharpness[n]

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
        sure = np.column_stack([places, 1 - posterior[:, 0]])
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
