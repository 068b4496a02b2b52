"""Statistics of results, against scipy, R, and hand-worked cases."""

from __future__ import annotations

import numpy as np
import pytest

import stemworlds as sw
from stemworlds import bench

stats = pytest.importorskip("scipy.stats")


def test_intervals_are_those_of_scipy() -> None:
    values = np.random.default_rng(1).gamma(2.0, 0.1, 40)
    low, high = bench.bootstrap_interval(values)
    other = stats.bootstrap((values,), np.mean, n_resamples=10_000, method="BCa", rng=np.random.default_rng(99)).confidence_interval
    assert (low, high) == pytest.approx((other.low, other.high), abs=0.003) and low < values.mean() < high
    assert bench.bootstrap_interval(values) == (low, high)
    # Of a symmetric sample it is near to that of Student.
    normal = np.random.default_rng(2).normal(0.5, 0.1, 200)
    student = stats.t.interval(0.95, 199, normal.mean(), normal.std(ddof=1) / 200**0.5)
    assert bench.bootstrap_interval(normal) == pytest.approx(student, abs=0.002)
    assert bench.bootstrap_interval([0.908] * 10) == (0.908, 0.908) and bench.bootstrap_interval([0.3]) == (0.3, 0.3)
    # Nearly all are equal: still an interval.
    low, high = bench.bootstrap_interval([0.0] * 19 + [1.0])
    assert 0 <= low <= 0.05 <= high <= 1


def test_intervals_hold_the_mean_as_often_as_they_say() -> None:
    random = np.random.default_rng(3)
    held = []
    for _ in range(200):
        low, high = bench.bootstrap_interval(random.exponential(1.0, 40), resamples=500)
        held.append(low <= 1.0 <= high)
    assert 0.88 <= np.mean(held) <= 0.99


def test_the_paired_test_has_r_s_values() -> None:
    """wilcox.test(x, y, paired = TRUE) of R's own example, the depression scale of Hollander and Wolfe."""
    x = [1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30]
    y = [0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29]
    # V = 40; alternative = "greater" gives 0.01953.
    assert bench.paired_wilcoxon(x, y) == pytest.approx(2 * 0.01953125)
    assert bench.paired_wilcoxon(y, x) == bench.paired_wilcoxon(x, y)
    # Five differences of one sign: 2 / 2^5.
    assert bench.paired_wilcoxon([2, 3, 4, 5, 6], [1, 1, 1, 1, 1]) == 2 / 32
    assert bench.paired_wilcoxon([0.1, 0.2], [0.1, 0.2]) == 1.0


def test_equivalence_is_two_one_sided_tests() -> None:
    random = np.random.default_rng(4)
    a = random.normal(0.28, 0.12, 70)
    b = a + random.normal(0.005, 0.03, 70)
    found = bench.tost(a, b, margin=0.05)
    low = stats.wilcoxon(a - b + 0.05, alternative="greater").pvalue
    high = stats.wilcoxon(a - b - 0.05, alternative="less").pvalue
    assert (found.p_low, found.p_high) == pytest.approx((low, high), rel=1e-9) and found.equivalent
    assert (found.pairs, found.mean, found.deviation) == (70, pytest.approx((a - b).mean()), pytest.approx((a - b).std(ddof=1)))
    assert not bench.tost(a, b + 0.06).equivalent
    # Nine pairs can show it, four cannot: 1 / 2^4 is above 0.05.
    assert bench.tost(a[:9], a[:9]).equivalent and not bench.tost(a[:4], a[:4]).equivalent
    assert bench.tost(a[:4], a[:4]).p_low == 1 / 16
    with pytest.raises(sw.InvalidValue, match="no pairs"):
        bench.tost(a, b[:3])
    with pytest.raises(sw.InvalidValue, match="margin"):
        bench.tost(a, b, margin=0.0)


def test_few_pairs_are_tested_exactly_with_ties_and_zeros_too() -> None:
    from stemworlds.bench.statistics import _signed_rank

    random = np.random.default_rng(6)
    for count in (1, 2, 5, 7, 7, 7):
        # Tenths: many are equal, and some are zero.
        apart = np.round(random.normal(0.05, 0.15, count), 1)
        apart[0] = 0.3
        for alternative in ("greater", "less", "two-sided"):
            assert _signed_rank(apart, alternative) == pytest.approx(stats.wilcoxon(apart, alternative=alternative).pvalue, rel=1e-12)
    # Thirteen at once, which SciPy takes seconds for: all of one sign, and two of them zero.
    assert _signed_rank(np.array([0.1] * 6 + [0.2] * 5 + [0.0] * 2), "greater") == 2**-11


def test_ranks_agree_as_scipy_says() -> None:
    random = np.random.default_rng(5)
    a, b = random.random(12), random.random(12)
    assert bench.rank_agreement(a, b) == pytest.approx(stats.spearmanr(a, b).statistic)
    assert bench.rank_agreement([1, 2, 3], [10, 20, 25]) == pytest.approx(1.0)
    assert bench.rank_agreement([1, 2, 3, 4], [2, 1, 4, 3]) == pytest.approx(0.6)
    assert np.isnan(bench.rank_agreement([1, 1, 1], [1, 2, 3]))


def test_holm_s_correction_by_hand() -> None:
    from stemworlds.bench.tables import holm

    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == [] and holm([0.9, 0.8]) == [1.0, 1.0]


def test_dose_efficiency_has_the_paper_s_numbers() -> None:
    right = [[share / 10, 1.0] for share in range(1, 11)]
    assert bench.dec_auc(right) == pytest.approx(0.90816, abs=5e-6)
    assert bench.dec_auc([[1.0, 1.0]]) == pytest.approx(0.01020, abs=5e-6)
    assert bench.dec_auc([]) == 0.0
    curve = [[0.25, 0.2], [0.75, 0.6]]
    scores = bench.on_checkpoints(curve, 5)
    assert scores.tolist() == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.6])
    assert bench.dec_auc(curve, 5) == pytest.approx((0.1 + 0.3 + 0.5 + 0.6) / 4)


def test_the_area_of_a_record_is_that_of_its_curve() -> None:
    """NumPy's interpolation and trapezoids give the area that the core writes into every record."""
    import gymnasium as gym

    env = gym.make("stemworlds/DefectCensus-v0", recipe="test", set={"field.thickness_nm": 0.4}, cadence=1, overview=False)
    agent = bench.Agent("often", bench.RandomTiles(), bench.Heuristic(), declare_every=1)
    for seed in range(3):
        record = bench.play(env, agent, seed)
        assert len({score for _, score in record["curve"]}) >= 3
        shares, at = np.array(record["curve"]).T, np.linspace(0, 1, 50)
        scores = np.where(at < shares[0][0], 0.0, np.interp(at, *shares))
        assert bench.on_checkpoints(record["curve"]) == pytest.approx(scores, abs=1e-9)
        assert record["metrics"]["dec_auc"] == pytest.approx((scores[1:] + scores[:-1]).sum() / 98, abs=1e-9)
        assert bench.dec_auc(record["curve"]) == record["metrics"]["dec_auc"]
