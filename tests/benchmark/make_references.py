"""Scores by scikit-learn and scipy, for tests/worlds/scores.rs: python3 tests/benchmark/make_references.py > tests/benchmark/references.json

Made with scikit-learn 1.7 or later, scipy 1.15 or later, numpy 2.
"""

import json

import numpy as np
from scipy.integrate import trapezoid
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from sklearn.metrics import average_precision_score, f1_score, jaccard_score

rng = np.random.default_rng(7)


def places(n: int) -> np.ndarray:
    return np.round(rng.uniform(0, 30, (n, 2)), 3)


def matching() -> list[dict]:
    """The greatest number of pairs within a radius, and of those the least sum of distances."""
    cases = []
    for n, m, radius in [(40, 40, 1.0), (60, 25, 2.5), (10, 80, 5.0), (80, 80, 1.7), (1, 3, 40.0), (30, 30, 0.1)]:
        found, truth = places(n), places(m)
        distance = cdist(found, truth)
        cost = np.where(distance <= radius, distance, 1e6)
        pairs = [(i, j) for i, j in zip(*linear_sum_assignment(cost)) if cost[i, j] < 1e6]
        cases.append(
            {
                "found": found.tolist(),
                "truth": truth.tolist(),
                "radius_nm": radius,
                "pairs": len(pairs),
                "distance_nm": float(sum(distance[i, j] for i, j in pairs)),
            }
        )
    return cases


def phases() -> list[dict]:
    cases = []
    for count, wrong, none in [(2, 0.2, 0.0), (3, 0.5, 0.1), (4, 0.9, 0.3), (2, 0.0, 0.5), (1, 0.3, 0.0)]:
        truth = rng.integers(0, count, (12, 15))
        found = np.where(rng.random(truth.shape) < wrong, rng.integers(0, count + 1, truth.shape), truth)
        found = np.where(rng.random(truth.shape) < none, -1, found)
        labels = sorted(set(truth.ravel()) | set(found.ravel()) - {-1})
        score = jaccard_score(truth.ravel(), found.ravel(), labels=labels, average="macro", zero_division=0)
        cases.append({"truth": truth.tolist(), "found": found.tolist(), "iou": float(score)})
    return cases


def classes() -> list[dict]:
    cases = []
    for count in (2, 3, 5):
        truth, found = rng.integers(0, count, 40), rng.integers(0, count, 40)
        cases.append({"truth": truth.tolist(), "found": found.tolist(), "f1": float(f1_score(truth, found, average="macro"))})
    return cases


def counts() -> list[dict]:
    """Counts as lists of labels: a hit for each that both have, the rest are claimed or missed."""
    cases = []
    for _ in range(5):
        found, truth = rng.integers(0, 9, 3), rng.integers(0, 9, 3)
        y_true, y_pred = [], []
        for kind, (a, b) in enumerate(zip(found, truth)):
            hits = min(a, b)
            y_true += [kind] * hits + [9] * (a - hits) + [kind] * (b - hits)
            y_pred += [kind] * hits + [kind] * (a - hits) + [9] * (b - hits)
        labels = [k for k in range(3) if found[k] + truth[k] > 0]
        score = f1_score(y_true, y_pred, labels=labels, average="macro", zero_division=0)
        cases.append({"found": found.tolist(), "truth": truth.tolist(), "f1": float(score)})
    return cases


def precisions() -> list[dict]:
    """Columns on a line, 0.2 nm apart: which hold a defect, and how sure the claim of each is."""
    cases = []
    for n, digits in [(30, 3), (60, 1), (12, 0)]:
        truth = rng.random(n) < 0.4
        score = np.round(0.5 * truth + rng.random(n), digits)
        cases.append({"defect": truth.tolist(), "score": score.tolist(), "average_precision": float(average_precision_score(truth, score))})
    return cases


def curves() -> list[dict]:
    """Dose-efficiency curves, read at 200001 points: what the metrics are without the 50 checkpoints."""
    cases = []
    for n in (1, 2, 5, 12):
        shares = np.sort(np.round(rng.uniform(0.02, 1, n), 3))
        scores = np.round(rng.random(n), 3)
        f = np.linspace(0, 1, 200_001)
        s = np.where(f < shares[0], 0.0, np.interp(f, shares, scores))
        half = f <= 0.5
        coarse_f = np.linspace(0, 1, 50)
        coarse = np.where(coarse_f < shares[0], 0.0, np.interp(coarse_f, shares, scores))
        cases.append(
            {
                "records": np.stack([shares, scores], 1).tolist(),
                "dec_auc_50": float(trapezoid(coarse, coarse_f)),
                "dec_auc": float(trapezoid(s, f)),
                "early_weighted": float(trapezoid(s * 2 * (1 - f), f)),
                "late_weighted": float(trapezoid(s * 2 * f, f)),
                "half_budget": float(2 * trapezoid(s[half], f[half])),
            }
        )
    return cases


print(
    json.dumps(
        {
            "matching": matching(),
            "phases": phases(),
            "classes": classes(),
            "counts": counts(),
            "precisions": precisions(),
            "curves": curves(),
        }
    )
)
