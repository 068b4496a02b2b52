"""Makes annotated samples on demand, in endless streams."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _core
from ._forking import Used
from ._running import Progress, call, running
from .errors import _invalid
from .recipes import Difficulty, Recipe, RecipeLike

#: Fields of :attr:`Targets.columns`.
SAMPLE_COLUMN_DTYPE = np.dtype(
    [
        ("x_px", "f4"),
        ("y_px", "f4"),
        ("class", "i4"),
        ("number", "i4"),
        ("occupancy", "f4"),
        ("sites", "i4"),
        ("vacancies", "i4"),
        ("substitutions", "i4"),
    ]
)
#: Fields of :attr:`Targets.particles`.
SAMPLE_PARTICLE_DTYPE = np.dtype([("x_px", "f8"), ("y_px", "f8"), ("radius_px", "f8"), ("morphology", "U16")])


@dataclass(frozen=True, eq=False)
class Targets:
    """The truth of a sample. Images are ``[y, x]``.

    Attributes:
        heat_map: float32, Gaussians of height 1 around columns. Each pixel belongs to the nearest column.
        class_mask: uint8, class of the column (:data:`COLUMN_CLASSES`) in pixels with a heat map above one half; 0 in other pixels.
        phase_mask: int32, phase of each pixel.
        columns: columns in the sample, :data:`SAMPLE_COLUMN_DTYPE`. ``number`` is the atomic number of the heaviest atom, ``occupancy`` the
            share of occupied sites.
        particles: outlines of particles that overlap the sample, :data:`SAMPLE_PARTICLE_DTYPE`.
    """

    heat_map: npt.NDArray[np.float32]
    class_mask: npt.NDArray[np.uint8]
    phase_mask: npt.NDArray[np.int32]
    columns: npt.NDArray[np.void]
    particles: npt.NDArray[np.void]


@dataclass(frozen=True, eq=False)
class Sample:
    """An annotated image. It can be unpacked: ``image, targets = sample``.

    Attributes:
        index: number of the sample.
        source: index of the recipe.
        recipe: the recipe as TOML.
        image: float32 ``[y, x]``, fractions of the beam with noise: counts divided by the incident electrons of a pixel.
        counts: uint32, counted electrons.
        clean: float32, the image without noise, in fractions of the beam.
        dose: electrons per square Angstrom.
        pixel_nm: edge of a pixel.
        angle_deg: angle between scan and specimen.
        centre_nm: centre ``(x, y)`` of the sample in the full field.
        images: the images on all detectors by name, the main one first, as ``image``; with ``stream(..., detectors="all")``, else empty.
            A centre of mass is in mrad, along the axes of the specimen, which ``angle_deg`` turns against the image.
        clean_images: these images without noise, as ``clean``.
    """

    index: int
    source: int
    image: npt.NDArray[np.float32]
    counts: npt.NDArray[np.uint32]
    clean: npt.NDArray[np.float32]
    targets: Targets
    dose: float
    pixel_nm: float
    angle_deg: float
    centre_nm: tuple[float, float]
    recipe: str = ""
    images: Mapping[str, npt.NDArray[np.float32]] = field(default_factory=dict)
    clean_images: Mapping[str, npt.NDArray[np.float32]] = field(default_factory=dict)

    def __iter__(self) -> Iterator[Any]:
        return iter((self.image, self.targets))


class Stream:
    """Makes samples by their numbers, see :func:`stream`. It can be pickled; spawned processes make it again from its recipes."""

    def __init__(self, fields: Sequence[_core.SampleOptions], weights: Sequence[float], seed: int, batch: int, threads: int | None) -> None:
        self._made = (tuple(fields), tuple(weights))
        self._sources = [call(_core.TileSource, one, running(threads, False)) for one in fields]
        self._used = Used("this stream", "make another one in the child")
        total = math.fsum(weights)
        self._shares = np.cumsum([weight / total for weight in weights])
        self.seed = seed
        self.batch = batch
        self.threads = threads

    def __reduce__(self) -> tuple[type[Stream], tuple[Any, ...]]:
        return Stream, (*self._made, self.seed, self.batch, self.threads)

    def prepare(self, *, index: int = 0, progress: Progress = False) -> None:
        """Computes the libraries for samples from ``index`` on. Without this call, the first sample waits for them."""
        for source in self._sources:
            self._used.by(call)(source.prepare, index, running(self.threads, progress))

    def sample(self, index: int) -> Sample:
        """Returns the sample of this number. It depends on recipes, options and seed alone, not on earlier samples."""
        return self.samples([index])[0]

    def samples(self, indices: Sequence[int]) -> list[Sample]:
        """Returns the samples of these numbers, made in parallel."""
        wanted = [(int(index), self._source(int(index))) for index in indices]
        found: dict[int, Sample] = {}
        for number, source in enumerate(self._sources):
            mine = [index for index, chosen in wanted if chosen == number]
            if mine:
                made = self._used.by(call)(source.samples, mine, running(self.threads, False))
                toml = self._made[0][number]["toml"]
                found.update((item["index"], _sample(item, number, toml)) for item in made)
        return [found[index] for index, _ in wanted]

    def iterate(self, first: int = 0, step: int = 1, count: int | None = None) -> Iterator[Sample]:
        """Yields the samples ``first``, ``first + step`` ...; endlessly without ``count``."""
        done = 0
        while count is None or done < count:
            size = self.batch if count is None else min(self.batch, count - done)
            yield from self.samples(range(first + done * step, first + (done + size) * step, step))
            done += size

    def __iter__(self) -> Iterator[Sample]:
        return self.iterate()

    def _source(self, index: int) -> int:
        if len(self._sources) == 1:
            return 0
        draw = np.random.Generator(np.random.Philox(key=self.seed, counter=[0, 0, 0, index])).random()
        return min(int(np.searchsorted(self._shares, draw, side="right")), len(self._sources) - 1)


def stream(
    recipe: RecipeLike | Mapping[RecipeLike, float] | Sequence[RecipeLike],
    *,
    difficulty: Difficulty | None = None,
    dose: float | tuple[float, float] | None = None,
    size: int = 128,
    pixel_nm: float | tuple[float, float] | None = None,
    angle_deg: float | tuple[float, float] = (0.0, 360.0),
    heat_sigma_px: float = 2.0,
    detectors: Literal["main", "all"] = "main",
    seed: int = 1,
    samples_per_specimen: int | None = None,
    batch: int = 16,
    cache: bool | str | os.PathLike[str] = True,
    threads: int | None = None,
    **changes: Any,
) -> Stream:
    """Makes an endless stream of annotated images, simulated on demand at random places of a specimen.

    Place, angle, pixel size and dose are drawn for each sample. An image is interpolated once, from the simulated probes to its pixels.
    Seed and index determine a sample; the number of threads and workers has no effect.

    Args:
        recipe: name, path, TOML, dict or :class:`Recipe`; or a list of several, or a dict with a weight for each.
        difficulty: the tier, if the recipes have tiers.
        dose: electrons per square Angstrom, or a range with a uniform distribution of the logarithm; by default the recipe's dose.
        size: edge of a sample in pixels.
        pixel_nm: edge of a pixel, or a range; by default the recipe's value.
        angle_deg: angle between scan and specimen, or a range.
        heat_sigma_px: standard deviation, in pixels, of a column in the heat maps.
        detectors: ``"all"`` adds the images on all detectors of the recipe (:attr:`Sample.images`), each with its own noise.
        samples_per_specimen: number of samples after which a new specimen, with a new seed, is laid out; by default all samples show one
            specimen.
        batch: number of samples that are made in parallel.
        **changes: ``set``, ``unset``, ``grid`` of the recipes, see :class:`Recipe`. ``grid`` determines the size of the field.

    Returns:
        A :class:`Stream`. Iterate over it, or call :meth:`Stream.sample` with a number.
    """
    first, last = (math.radians(angle) for angle in _range("angle_deg", angle_deg))
    if detectors not in ("main", "all"):
        raise _invalid("detectors", f"detectors = {detectors!r}: expected 'main' or 'all'")
    options: _core.SampleOptions = {
        "toml": "",
        "all_detectors": detectors == "all",
        "size_px": size,
        "pixel_nm": None if pixel_nm is None else _range("pixel_nm", pixel_nm),
        "angle_rad": (first, last),
        "dose": None if dose is None else _range("dose", dose),
        "sigma_px": heat_sigma_px,
        "seed": seed,
        "per_specimen": samples_per_specimen,
        "cache": cache if isinstance(cache, bool) else os.fspath(cache),
    }
    if batch < 1 or (samples_per_specimen is not None and samples_per_specimen < 1):
        raise _invalid("batch or samples_per_specimen", "expected whole numbers above 0")
    fields, weights = [], []
    for one, weight in _weighted(recipe):
        if not weight > 0:
            raise _invalid("recipe", f"weight {weight}: expected a number above 0")
        resolved = one if isinstance(one, Recipe) and not changes else Recipe(one, _tier(one, difficulty), **changes)
        drawn: _core.SampleOptions = {**options, "toml": resolved.toml}
        fields.append(drawn)
        weights.append(weight)
    return Stream(fields, weights, seed, batch, threads)


def _tier(recipe: RecipeLike, difficulty: Difficulty | None) -> Difficulty | None:
    return None if isinstance(recipe, Recipe) else difficulty


def _weighted(recipe: Any) -> list[tuple[RecipeLike, float]]:
    if isinstance(recipe, Recipe) or isinstance(recipe, (str, os.PathLike)):
        return [(recipe, 1.0)]
    if isinstance(recipe, Mapping):
        # A recipe as a dict has the key version; a dict of several recipes has not.
        if "version" in recipe:
            return [(recipe, 1.0)]
        return [(one, float(weight)) for one, weight in recipe.items()]
    found = [(one, 1.0) for one in recipe]
    if not found:
        raise _invalid("recipe", "there is no recipe to draw from")
    return found


def _range(keyword: str, value: Any) -> tuple[float, float]:
    try:
        low, high = value if isinstance(value, (tuple, list, np.ndarray)) else (value, value)
        return float(low), float(high)
    except (TypeError, ValueError):
        raise _invalid(keyword, f"{keyword} = {value!r}: expected a number, or (low, high)") from None


def _sample(item: Mapping[str, Any], source: int, recipe: str) -> Sample:
    counts = item["counts"]
    facts = item["columns"].reshape(-1, 5)
    columns = np.zeros(len(facts), SAMPLE_COLUMN_DTYPE)
    columns["x_px"], columns["y_px"] = item["positions_px"].reshape(-1, 2).T
    columns["class"], columns["sites"], columns["vacancies"], columns["substitutions"], columns["number"] = facts.T
    columns["occupancy"] = 1 - columns["vacancies"] / np.maximum(columns["sites"], 1)
    outlines = item["particles_px"].reshape(-1, 3)
    particles = np.zeros(len(outlines), SAMPLE_PARTICLE_DTYPE)
    particles["x_px"], particles["y_px"], particles["radius_px"] = outlines.T
    particles["morphology"] = item["morphologies"]
    targets = Targets(item["heat_map"], item["class_mask"], item["phase_mask"], columns, particles)
    names = _detector_names(recipe) if item["others"] else ["main"]
    electrons = item["electrons_per_pixel"]
    found = {names[0]: (counts, item["clean"], None), **item["others"]}
    images = {
        name: (counted / electrons).astype(np.float32) if angles is None else angles for name, (counted, _, angles) in found.items()
    }
    return Sample(
        index=item["index"],
        source=source,
        image=(counts / item["electrons_per_pixel"]).astype(np.float32),
        counts=counts,
        clean=item["clean"],
        targets=targets,
        dose=item["dose"],
        pixel_nm=item["pixel_nm"],
        angle_deg=math.degrees(item["angle_rad"]),
        centre_nm=tuple(item["centre_nm"]),
        recipe=recipe,
        images=images if item["others"] else {},
        clean_images={name: clean for name, (_, clean, _) in found.items()} if item["others"] else {},
    )


def _detector_names(recipe: str) -> list[str]:
    """Names of the tables ``[[detector]]`` of a recipe."""
    tables = tomllib.loads(recipe)["detector"]
    return [table["name"] for table in tables]
