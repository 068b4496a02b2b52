"""Compares networks with the ideal observer: the ratio of their bits, on the same counts of held-out specimens."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import _invalid
from ..recipes import Recipe
from ..streaming import Sample, stream
from .columns import Columns, columns_of
from .episodes import Acquired
from .findings import Findings
from .forecasts import bits_by_column, nearest_columns
from .ideal import evidence, log_likelihood
from .neural import NeuralAnalyst
from .prior import Prior, prior_of
from .templates import templates_of

__all__ = ["Fraction", "fractions"]

Values = npt.NDArray[np.float64]

#: Seed of the evaluated specimen. Specimens for training have even seeds.
HELD_OUT_SEED = 4_001
#: Number of draws of the bootstrap over tiles.
_DRAWS = 1000
#: Least number of bits that the ideal observer has to gain in a column. Below it, the ratio is mostly noise.
LEAST_BITS = 0.005


@dataclass(frozen=True)
class Fraction:
    """Result for the columns of one kind of one recipe at one dose.

    Attributes:
        recipe, tier, kind: recipe, tier, and kind of the columns.
        dose: dose in electrons per square Angstrom.
        tiles, columns: numbers of evaluated tiles and columns.
        prior_bits: bits per column that the truth would gain over the prior.
        ideal_bits, network_bits: bits per column that ideal observer and network gain over the prior.
        fraction: ``network_bits`` divided by ``ideal_bits``; ``None`` if the ideal observer gains less than :data:`LEAST_BITS`.
        interval: 95 % interval of the fraction, by a bootstrap over tiles.
        found: share of the columns that the network finds within 0.1 nm.
        error_nm: root mean square error of the found places along one axis.
    """

    recipe: str
    tier: str | None
    kind: str
    dose: float
    tiles: int
    columns: int
    prior_bits: float
    ideal_bits: float
    network_bits: float
    fraction: float | None
    interval: tuple[float, float] | None
    found: float
    error_nm: float


@dataclass
class _Sums:
    """Sums for the columns of one kind, by tile."""

    columns: list[int] = field(default_factory=list)
    prior: list[float] = field(default_factory=list)
    ideal: list[float] = field(default_factory=list)
    network: list[float] = field(default_factory=list)
    found: int = 0
    squares: float = 0.0


def fractions(
    models: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    recipe: Recipe,
    doses: Sequence[float],
    *,
    tiles: int = 32,
    seed: int = HELD_OUT_SEED,
    threads: int | None = None,
) -> list[Fraction]:
    """Compares a network, or an ensemble, with the ideal observer.

    The tiles have the form of the benchmark: unrotated, with the recipe's pixel size, from a specimen that was not used for training. All
    specimens of a recipe use one library, so training has used its simulations with their phonons and defects; a recipe with another
    ``phonons.library_seed`` shows neither of them.

    Args:
        models: files of networks from ``stemworlds train``, or names of shipped networks.
        recipe: recipe of the specimen.
        doses: doses in electrons per square Angstrom. All doses use the same places.
        tiles: number of tiles.
        seed: odd seed of specimen, places and noise.

    Raises:
        InvalidValue: for an even seed, since specimens with even seeds are for training.
    """
    if seed % 2 == 0:
        raise _invalid("seed", f"seed = {seed}: expected an odd number; specimens with even seeds are for training")
    specimen = recipe.with_seed(seed)
    prior, templates = prior_of(recipe), templates_of(recipe.with_seed(0).toml, None)
    rows = []
    whole = columns_of(specimen.toml, threads=threads)
    for dose in doses:
        samples = stream(specimen, angle_deg=0.0, dose=dose, seed=seed, threads=threads).samples(range(tiles))
        sums: dict[str, _Sums] = {}
        for sample in samples:
            _compare(_acquired(sample), _within(whole, sample), prior, templates, _forecast(models, specimen, sample), sums)
        rows += [_row(recipe, kind, dose, own) for kind, own in sorted(sums.items())]
    return rows


def _acquired(sample: Sample) -> Acquired:
    """Converts a sample to an acquisition of the benchmark."""
    edge = sample.counts.shape[0] * sample.pixel_nm
    electrons = sample.dose * (10 * sample.pixel_nm) ** 2
    return Acquired(0, 0, sample.centre_nm, edge, sample.pixel_nm, 1.0, sample.dose / 100, sample.dose, electrons, 1.0, 0.0, sample.image)


def _within(columns: Columns, sample: Sample) -> Columns:
    """Returns the columns that an unrotated sample shows."""
    half = sample.counts.shape[0] * sample.pixel_nm / 2
    x, y = sample.centre_nm
    return columns.within(x - half, y - half, x + half, y + half)


class _Facts:
    """The facts of field and world that an analyst reads."""

    task, target, phases = "defect-census", None, ()

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe


def _forecast(models: Any, specimen: Recipe, sample: Sample) -> Findings:
    analyst = _analyst(models)
    facts: Any = _Facts(specimen)
    analyst.attach(facts)
    analyst.start(facts, np.random.default_rng(0))
    return analyst.findings([_acquired(sample)])


def _analyst(models: Any) -> NeuralAnalyst:
    """Returns the analyst of these files, which is opened once in a process."""
    paths = (os.fspath(models),) if isinstance(models, str | os.PathLike) else tuple(map(os.fspath, models))
    if paths not in _OPENED:
        _OPENED[paths] = NeuralAnalyst(paths)
    return _OPENED[paths]


_OPENED: dict[tuple[str, ...], NeuralAnalyst] = {}


def _compare(tile: Acquired, columns: Columns, prior: Prior, templates: Any, said: Findings, sums: dict[str, _Sums]) -> None:
    """Adds the bits of ideal observer and network for a tile's columns to ``sums``."""
    counts, chances = columns.counts(None), prior.of(columns, None)
    network = bits_by_column(said, columns.places_nm, counts, chances)
    owner = nearest_columns(said.forecasts[:, :2], columns.places_nm)
    apart = np.full(len(counts), np.nan)
    own = owner >= 0
    apart[owner[own]] = ((said.forecasts[own, :2] - columns.places_nm[owner[own]]) ** 2).mean(axis=1)
    lacking = -np.log2(chances[np.arange(len(counts)), np.minimum(counts, chances.shape[1] - 1)])
    for kind, name in enumerate(columns.names):
        of_kind = np.flatnonzero(columns.kinds == kind)
        if not len(of_kind):
            continue
        ideal = np.zeros(len(of_kind))
        if name in templates:
            posterior = _ideal(tile, columns.places_nm[of_kind], chances[of_kind], templates[name])
            findings = Findings(forecasts=np.column_stack([columns.places_nm[of_kind], posterior]))
            ideal = bits_by_column(findings, columns.places_nm[of_kind], counts[of_kind], chances[of_kind])
        held = sums.setdefault(name, _Sums())
        held.columns.append(len(of_kind))
        held.prior.append(float(lacking[of_kind].sum()))
        held.ideal.append(float(ideal.sum()))
        held.network.append(float(network[of_kind].sum()))
        held.found += int(np.isfinite(apart[of_kind]).sum())
        held.squares += float(np.nansum(apart[of_kind]))


def _ideal(tile: Acquired, places: Values, prior: Values, template: Any) -> Values:
    """Returns the posterior of the ideal observer with the grade ``linear``."""
    toward, sharpness = evidence(tile, places, template)
    number = np.arange(prior.shape[1], dtype=np.float64)
    logs = np.array([log_likelihood(toward[n], sharpness[n], template, number, "linear") for n in range(len(places))])
    powers = np.exp(np.log(prior) + logs - (np.log(prior) + logs).max(axis=1, keepdims=True))
    result: Values = powers / powers.sum(axis=1, keepdims=True)
    return result


def _row(recipe: Recipe, kind: str, dose: float, sums: _Sums) -> Fraction:
    columns = sum(sums.columns)
    ideal, network = np.array(sums.ideal), np.array(sums.network)
    share, interval = None, None
    if ideal.sum() / columns >= LEAST_BITS:
        drawn = np.random.default_rng(1).integers(len(ideal), size=(_DRAWS, len(ideal)))
        shares = network[drawn].sum(axis=1) / np.maximum(ideal[drawn].sum(axis=1), 1e-9)
        low, high = np.quantile(shares, [0.025, 0.975])
        share, interval = float(network.sum() / ideal.sum()), (float(low), float(high))
    return Fraction(
        recipe=recipe.id,
        tier=recipe.tier,
        kind=kind,
        dose=float(dose),
        tiles=len(ideal),
        columns=columns,
        prior_bits=sum(sums.prior) / columns,
        ideal_bits=float(ideal.sum()) / columns,
        network_bits=float(network.sum()) / columns,
        fraction=share,
        interval=interval,
        found=sums.found / columns,
        error_nm=float(np.sqrt(sums.squares / max(sums.found, 1))),
    )
