"""Scores the tasks about the whole field: the share of its defects that was found, and the prediction for tiles that were not acquired."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .field_truth import FieldTruth, Mask, Values
from .forecasts import RADIUS_NM, nearest_columns

#: Number of columns that count in the strict form of recall. The agent's likeliest columns are used.
BEST_COLUMNS = 100
#: Smaller values of a map are raised to this share of the constant rate, so that no cell costs infinitely many bits.
LEAST_RATE = 0.01


def named_columns(truth: FieldTruth, columns: npt.ArrayLike) -> tuple[int, int, int]:
    """Scores the named columns that the agent considers likeliest, at most :data:`BEST_COLUMNS`.

    An entry has x and y in nm, and a number that increases with the expected number of defects. It names the nearest column within 0.1 nm.
    Each column counts once.

    Returns:
        The number of these columns with a defect; their number of defects; and the number of defects in the best columns of the field, as
        many as count at most.
    """
    most = min(BEST_COLUMNS, len(truth.numbers))
    best = int(np.partition(truth.numbers, len(truth.numbers) - most)[len(truth.numbers) - most :].sum()) if most else 0
    said = np.asarray(columns, dtype=np.float64).reshape(-1, 3)
    said = said[np.argsort(-said[:, 2], kind="stable")[:most]]
    if not len(said):
        return 0, 0, best
    places = truth.columns.places_nm
    near = np.flatnonzero(np.isin(_squares(places, 0, 0), np.concatenate([_squares(said[:, :2], x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])))
    owner = nearest_columns(said[:, :2], places[near])
    held = truth.numbers[near[owner[owner >= 0]]]
    return int((held > 0).sum()), int(held.sum()), best


def _squares(places_nm: Values, right: int, down: int) -> npt.NDArray[np.int64]:
    """Returns a number for the square of 0.1 nm that contains each place, shifted by ``right`` and ``down`` squares."""
    square = np.floor(places_nm / RADIUS_NM).astype(np.int64) + np.array([right, down])
    result: npt.NDArray[np.int64] = square[:, 0] * 2**32 + square[:, 1]
    return result


def map_bits(truth: FieldTruth, density: npt.ArrayLike | None, constant: float, seen: Mask) -> tuple[float, float]:
    """Returns the bits that a map gains over a constant rate in the tiles that were not acquired, and the bits of the true numbers.

    The likelihood of a number of defects is Poisson's, with the value of the map as mean. The best map on average is therefore the expected
    number.

    Args:
        density: expected numbers of defects in equal parts of the field; ``None`` gains 0 bits.
        constant: mean number of defects in a tile by the prior.
        seen: mask of the acquired tiles.
    """
    counts = truth.counts[~seen]
    least = max(LEAST_RATE * constant, 1e-9)
    said = np.full(counts.shape, constant) if density is None else truth.grid.per_cell(density)[~seen]
    own, same, best = (_log_chance(counts, np.maximum(rate, least)) for rate in (said, np.full(counts.shape, constant), counts))
    return math.fsum(own - same), math.fsum(best - same)


def _log_chance(counts: Values, rates: Values) -> Values:
    """Returns Poisson's log likelihood in bits, without the term that does not depend on the rate."""
    result: Values = (counts * np.log(rates) - rates) / math.log(2)
    return result


def rare_score(truth: FieldTruth, rare: npt.ArrayLike, seen: Mask) -> tuple[float, int, int, int]:
    """Scores claims of rare tiles.

    Each acquired tile with a claim counts once; claims in other tiles do not count. One correct claim finds a cluster. If there is no
    cluster and no claim, the score is 1.

    Returns:
        The F1 score of the found clusters (recall) and the correct claims (precision); the number of found clusters; of clusters; and of
        claims.
    """
    places = np.asarray(rare, dtype=np.float64).reshape(-1, 2)
    claimed = np.zeros(seen.shape, dtype=bool)
    if len(places):
        claimed[truth.grid.cells_of(places)] = True
    claimed &= seen
    right = truth.clusters[claimed]
    found, clusters, claims = len(np.unique(right[right > 0])), int(truth.clusters.max(initial=0)), int(claimed.sum())
    if not clusters:
        return (0.0 if claims else 1.0), 0, 0, claims
    if not found:
        return 0.0, 0, clusters, claims
    precision, recall = float((right > 0).mean()), found / clusters
    return 2 * precision * recall / (precision + recall), found, clusters, claims
