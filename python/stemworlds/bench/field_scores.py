"""Scores of the tasks that ask for the field: what was found of all that it holds, and what is said of tiles that nobody looked at."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .field_truth import FieldTruth, Mask, Values
from .forecasts import RADIUS_NM, nearest_columns

#: Columns that count in the strict form of recall: the likeliest that an agent names.
BEST_COLUMNS = 100
#: A map that says fewer defects than this share of the constant rate says this share, so that no cell costs infinitely much.
LEAST_RATE = 0.01


def named_columns(truth: FieldTruth, columns: npt.ArrayLike) -> tuple[int, int, int]:
    """Of the likeliest columns that were named, at most :data:`BEST_COLUMNS`: how many hold a defect, how many defects they hold together, and how
    many defects the best as many columns of the field hold.

    A name (x, y, and a number that is greater where more defects are likely) is that of the nearest column within 0.1 nm, each once.
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
    """A number for the square of 0.1 nm that each place lies in, or that beside it."""
    square = np.floor(places_nm / RADIUS_NM).astype(np.int64) + np.array([right, down])
    result: npt.NDArray[np.int64] = square[:, 0] * 2**32 + square[:, 1]
    return result


def map_bits(truth: FieldTruth, density: npt.ArrayLike | None, constant: float, seen: Mask) -> tuple[float, float]:
    """Bits that a map gains over a constant rate in the tiles that were not seen, and those that the true numbers would gain.

    Numbers of defects are taken for Poisson's about what the map says, whose best map in the mean is the expected number.

    Args:
        density: expected numbers of defects in equal parts of the field; ``None`` gains nothing.
        constant: defects that the prior expects in a tile, the same everywhere.
        seen: tiles that were looked at.
    """
    counts = truth.counts[~seen]
    least = max(LEAST_RATE * constant, 1e-9)
    said = np.full(counts.shape, constant) if density is None else truth.grid.per_cell(density)[~seen]
    own, same, best = (_log_chance(counts, np.maximum(rate, least)) for rate in (said, np.full(counts.shape, constant), counts))
    return math.fsum(own - same), math.fsum(best - same)


def _log_chance(counts: Values, rates: Values) -> Values:
    """Poisson's, in bits, but for what does not depend on the rate."""
    result: Values = (counts * np.log(rates) - rates) / math.log(2)
    return result


def rare_score(truth: FieldTruth, rare: npt.ArrayLike, seen: Mask) -> tuple[float, int, int, int]:
    """F1 of the clusters that were found and of the claims that are right; clusters found; clusters; and claims.

    Places that are claimed count by tile, each tile once, and only where it was looked at. A cluster is found by one right claim in it. Where there is none and none is
    claimed, the score is 1.
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
