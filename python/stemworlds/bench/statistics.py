"""Computes statistics of results: intervals, paired tests, equivalence, agreement of rankings."""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .. import _core
from ..errors import _invalid
from .extras import needed

__all__ = ["Equivalence", "bootstrap_interval", "dec_auc", "on_checkpoints", "paired_wilcoxon", "rank_agreement", "tost"]

#: Greatest number of pairs that are tested exactly, also with ties, as in SciPy.
_FEW_PAIRS = 13
Values = npt.NDArray[np.float64]
Numbers = Sequence[float] | Values

CHECKPOINTS = 50


def bootstrap_interval(values: Numbers, *, level: float = 0.95, resamples: int = 10_000, seed: int = 0) -> tuple[float, float]:
    """Returns an interval of the mean by the bias-corrected and accelerated bootstrap (BCa). For equal values both ends are this value."""
    data = _numbers("values", values)
    if len(data) == 1 or float(np.ptp(data)) == 0.0:
        return float(data[0]), float(data[0])
    stats = needed("scipy.stats")
    made = stats.bootstrap(
        (data,), np.mean, confidence_level=level, n_resamples=resamples, method="BCa", rng=np.random.default_rng(seed), vectorized=True
    )
    return float(made.confidence_interval.low), float(made.confidence_interval.high)


def paired_wilcoxon(a: Numbers, b: Numbers) -> float:
    """Returns the two-sided p of the signed-rank test of pairs; 1 if all differences are 0."""
    return _signed_rank(_differences(a, b), "two-sided")


@dataclass(frozen=True)
class Equivalence:
    """Result of two one-sided tests.

    Attributes:
        pairs: number of pairs.
        mean, deviation: mean and sample standard deviation of the differences a - b.
        p_low, p_high: p of the hypotheses that the difference is not above -margin, and not below +margin.
        margin, level: the arguments of :func:`tost`.
    """

    pairs: int
    mean: float
    deviation: float
    p_low: float
    p_high: float
    margin: float
    level: float

    @property
    def equivalent(self) -> bool:
        """Whether both tests reject their hypotheses."""
        return max(self.p_low, self.p_high) < self.level


def tost(a: Numbers, b: Numbers, *, margin: float = 0.05, level: float = 0.05) -> Equivalence:
    """Tests whether pairs are equivalent within ``margin``, by one-sided signed-rank tests of a - b + margin and a - b - margin."""
    if not margin > 0:
        raise _invalid("margin", f"margin = {margin}: expected a number above 0")
    apart = _differences(a, b)
    deviation = float(apart.std(ddof=1)) if len(apart) > 1 else 0.0
    low, high = _signed_rank(apart + margin, "greater"), _signed_rank(apart - margin, "less")
    return Equivalence(len(apart), float(apart.mean()), deviation, low, high, margin, level)


def rank_agreement(a: Numbers, b: Numbers) -> float:
    """Returns Spearman's rho; NaN if ``a`` or ``b`` is constant."""
    first, second = _numbers("a", a), _numbers("b", b)
    if len(first) != len(second) or len(first) < 2 or np.ptp(first) == 0 or np.ptp(second) == 0:
        return float("nan")
    return float(needed("scipy.stats").spearmanr(first, second).statistic)


def on_checkpoints(curve: Sequence[Sequence[float]], checkpoints: int = CHECKPOINTS) -> Values:
    """Interpolates scores at equally spaced shares of the budget, (checkpoints,).

    The score is 0 before the first record, linear between records, and constant after the last.
    """
    return np.array(_core.dose_checkpoints(_records(curve), checkpoints), dtype=np.float64)


def dec_auc(curve: Sequence[Sequence[float]], checkpoints: int = CHECKPOINTS) -> float:
    """Returns the area under the curve of score against share of the budget."""
    return float(json.loads(_core.dose_metrics(_records(curve), checkpoints))["dec_auc"])


def _records(curve: Sequence[Sequence[float]]) -> list[tuple[float, float]]:
    return [(float(share), float(score)) for share, score in curve]


def _signed_rank(apart: Values, alternative: str) -> float:
    if not np.any(apart):
        return 1.0
    if len(apart) <= _FEW_PAIRS:
        return _exact_signed_rank(apart[apart != 0], alternative)
    with warnings.catch_warnings():
        # SciPy warns about few pairs and about ties, but its values are valid for them.
        warnings.simplefilter("ignore")
        return float(needed("scipy.stats").wilcoxon(apart, alternative=alternative).pvalue)


def _exact_signed_rank(apart: Values, alternative: str) -> float:
    """Returns the exact p of the signed-rank test over all signs with equal probabilities.

    For ties, SciPy enumerates all 2^N signs, which takes seconds. This function counts the sums instead.
    """
    ranks = np.rint(2 * needed("scipy.stats").rankdata(np.abs(apart))).astype(int)
    ways = np.ones(1)
    for rank in ranks.tolist():
        ways = np.pad(ways, (0, rank)) + np.pad(ways, (rank, 0))
    above = int(ranks[apart > 0].sum())
    greater, less = float(ways[above:].sum() / ways.sum()), float(ways[: above + 1].sum() / ways.sum())
    return {"greater": greater, "less": less, "two-sided": min(1.0, 2 * min(greater, less))}[alternative]


def _differences(a: Numbers, b: Numbers) -> Values:
    first, second = _numbers("a", a), _numbers("b", b)
    if len(first) != len(second):
        raise _invalid("a or b", f"{len(first)} and {len(second)} values are no pairs")
    # Rounding makes differences equal that are equal in exact arithmetic, so that they count as ties.
    return np.round(first - second, 12)


def _numbers(keyword: str, values: Numbers) -> Values:
    data = np.asarray(values, dtype=np.float64).ravel()
    if len(data) == 0 or not np.isfinite(data).all():
        raise _invalid(keyword, f"{keyword}: expected one finite number or more")
    return data
