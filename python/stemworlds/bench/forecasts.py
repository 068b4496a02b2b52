"""Scores forecasts by column: the information of an agent about each column beyond the prior."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .findings import Findings

Values = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

#: A forecast belongs to the nearest column within this distance in nm, which is half the distance of two columns.
RADIUS_NM = 0.1
#: Least probability. A forecast of 0 for a defect that exists therefore costs 20 bits, and not infinitely many.
LEAST_CHANCE = 2.0**-20


@dataclass(frozen=True)
class ForecastScore:
    """The information of a declaration about the seen columns.

    Attributes:
        columns: number of seen columns.
        bits: bits gained over the prior, summed over all columns; negative if the forecasts are worse than the prior.
        prior_bits: bits that the truth would gain over the prior.
        average_precision: average precision in finding the columns with a defect, ranked by the forecasts.
        prior_average_precision: average precision with the ranking by the prior.
        count_error: expected number of defects minus their true number.
        count_sigma: standard deviation of the number of defects by the forecasts, with independent columns.
    """

    columns: int
    bits: float
    prior_bits: float
    average_precision: float
    prior_average_precision: float
    count_error: float
    count_sigma: float

    @property
    def share(self) -> float:
        """The score of the strict tasks: ``bits`` divided by ``prior_bits``, from 0 to 1. It is 0 if ``prior_bits`` is 0."""
        return min(max(self.bits / self.prior_bits, 0.0), 1.0) if self.prior_bits > 0 else 0.0

    def numbers(self, electrons: float) -> dict[str, float]:
        """Returns the numbers for records. ``electrons`` is the number of electrons on the acquired tiles."""
        return {
            "share": self.share,
            "columns": self.columns,
            "bits": self.bits,
            "bits_per_column": self.bits / self.columns if self.columns else 0.0,
            "bits_per_million_electrons": 1e6 * self.bits / electrons if electrons > 0 else 0.0,
            "prior_bits": self.prior_bits,
            "average_precision": self.average_precision,
            "average_precision_gain": self.average_precision - self.prior_average_precision,
            "count_error": self.count_error,
            "count_sigma": self.count_sigma,
        }


def score_forecasts(findings: Findings | None, places_nm: Values, counts: Whole, prior: Values) -> ForecastScore:
    """Scores forecasts against the columns that were seen.

    A column without a forecast takes the prior, which gains 0 bits. The last class of a forecast with fewer classes than the prior means
    "that many or more". It is divided in the prior's proportions.

    Args:
        findings: the declared findings.
        places_nm: (N, 2), places of the columns.
        counts: (N,), true numbers of defects in the columns.
        prior: (N, K), probabilities of 0, 1, ... defects; the last class means "that many or more".
    """
    said, owner, chances = _matched(findings, places_nm, prior)
    true = np.minimum(counts, prior.shape[1] - 1)
    each = np.arange(len(true))
    gained = _bits(chances, prior, true)
    number = np.arange(prior.shape[1])
    mean = chances @ number
    stray = _fair(said[owner < 0, 2:])
    sure = np.concatenate([1 - chances[:, 0], 1 - stray[:, 0] if len(stray) else np.zeros(0)])
    there = np.concatenate([counts > 0, np.zeros(len(stray), dtype=bool)])
    return ForecastScore(
        columns=len(true),
        bits=math.fsum(gained),
        prior_bits=math.fsum(-np.log2(np.maximum(prior[each, true], LEAST_CHANCE))),
        average_precision=average_precision(there, sure),
        prior_average_precision=average_precision(counts > 0, 1 - prior[:, 0]),
        count_error=float(mean.sum() - counts.sum()),
        count_sigma=math.sqrt(max(float((chances @ number**2 - mean**2).sum()), 0.0)),
    )


def bits_by_column(findings: Findings | None, places_nm: Values, counts: Whole, prior: Values) -> Values:
    """Returns the bits that forecasts gain over the prior in each column, (N,). The arguments are described at :func:`score_forecasts`."""
    _, _, chances = _matched(findings, places_nm, prior)
    return _bits(chances, prior, np.minimum(counts, prior.shape[1] - 1))


def _matched(findings: Findings | None, places_nm: Values, prior: Values) -> tuple[Values, Whole, Values]:
    """Returns the forecasts, the column of each forecast (-1 for none), and the probabilities of all columns by forecast or prior."""
    said = np.zeros((0, 4)) if findings is None else np.asarray(findings.forecasts, dtype=np.float64)
    owner = nearest_columns(said[:, :2], places_nm)
    chances = prior
    if len(said):
        chances = prior.copy()
        own = np.flatnonzero(owner >= 0)
        chances[owner[own]] = _spread(_fair(said[own, 2:]), prior[owner[own]])
    return said, owner, chances


def _bits(chances: Values, prior: Values, true: Whole) -> Values:
    each = np.arange(len(true))
    gained: Values = np.log2(np.maximum(chances[each, true], LEAST_CHANCE)) - np.log2(np.maximum(prior[each, true], LEAST_CHANCE))
    # The prior may have probabilities below the least one. A forecast that equals the prior gains exactly 0 bits.
    gained[(chances == prior).all(axis=1)] = 0.0
    return gained


def _fair(chances: Values) -> Values:
    """Returns probabilities that sum to 1."""
    total = chances.sum(axis=1, keepdims=True)
    result: Values = np.divide(chances, total, out=np.full_like(chances, 1 / max(chances.shape[1], 1)), where=total > 0)
    return result


def _spread(said: Values, prior: Values) -> Values:
    """Converts forecasts to the classes of the prior."""
    classes, known = said.shape[1], prior.shape[1]
    if classes >= known:
        return np.column_stack([said[:, : known - 1], said[:, known - 1 :].sum(axis=1)])
    tail = prior[:, classes - 1 :]
    within = tail / np.maximum(tail.sum(axis=1, keepdims=True), 1e-300)
    return np.column_stack([said[:, : classes - 1], said[:, classes - 1 :] * within])


def nearest_columns(said_nm: Values, places_nm: Values) -> Whole:
    """Assigns a column within :data:`RADIUS_NM` to each declared place, or -1. Nearest pairs are assigned first, and each column once."""
    owner = np.full(len(said_nm), -1, dtype=np.int64)
    if not len(said_nm) or not len(places_nm):
        return owner
    cells: dict[tuple[int, int], list[int]] = {}
    for n, (x, y) in enumerate(places_nm.tolist()):
        cells.setdefault((math.floor(x / RADIUS_NM), math.floor(y / RADIUS_NM)), []).append(n)
    pairs = []
    columns = places_nm.tolist()
    for n, (x, y) in enumerate(said_nm.tolist()):
        column, row = math.floor(x / RADIUS_NM), math.floor(y / RADIUS_NM)
        for c in (column - 1, column, column + 1):
            for r in (row - 1, row, row + 1):
                for m in cells.get((c, r), ()):
                    apart = math.hypot(x - columns[m][0], y - columns[m][1])
                    if apart <= RADIUS_NM:
                        pairs.append((apart, n, m))
    taken: set[int] = set()
    for _, n, m in sorted(pairs):
        if owner[n] < 0 and m not in taken:
            owner[n] = m
            taken.add(m)
    return owner


def average_precision(there: npt.NDArray[np.bool_], sure: Values) -> float:
    """Returns the sum over thresholds of precision times gain in recall. Equal values are one threshold. 0 if ``there`` is nowhere true."""
    if not there.any():
        return 0.0
    order = np.argsort(-sure, kind="stable")
    hits = np.cumsum(there[order])
    last = np.append(np.flatnonzero(np.diff(sure[order])), len(order) - 1)
    precision, recall = hits[last] / (last + 1), hits[last] / hits[-1]
    return float((np.diff(recall, prepend=0.0) * precision).sum())
