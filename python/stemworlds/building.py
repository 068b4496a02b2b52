"""Worlds are built, and planned."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypedDict, Unpack

from . import _core
from ._running import Progress, call, running
from .recipes import Acquisition, Difficulty, Recipe, RecipeLike
from .worlds import World

BuildEngine = Literal["auto", "mosaic", "window", "prism", "multislice"]


class BuildOptions(TypedDict, total=False):
    """Options of :func:`build` and :func:`plan`.

    Recipe:
        difficulty, set, unset, grid, seed, acquisition: as :class:`Recipe` takes them.

    Image:
        noise: add Poisson noise. Default ``True``.
        keep_clean: also store the noise-free tiles.
        engine: how images are made; by default a mosaic, or windows where a field is too small for it to pay.
        window_angstrom: width of the window that follows each probe.
        interpolation: of PRISM, along x and y.
        accuracy_percent: widen the windows until the audit's rms error is at most so many per cent of the mean image.
        max_error_percent: the same for the errors at bright columns and over all pixels of the brightest column.
        expansion_percent: ``"auto"``, ``"off"`` or per cent.
        profile: ``"published"`` takes the settings of the published worlds.
        audit: regions that are simulated exactly beforehand; 0 for none, 1 by default.
        subtile_nm, subtile_overlap_nm: width and overlap of what is simulated at once.

    Running:
        cache: ``False`` keeps no simulations for other worlds; a path is another folder for them.
        overwrite: replace an existing file.
        png: also write a picture beside the file.
        force: go on though more memory is needed than is free.
        threads: number of threads; all processors by default. The result is the same for any number.
        progress: ``True`` for a bar, or a function of (stage, unit, done, total).
    """

    difficulty: Difficulty | None
    set: Mapping[str, Any] | None
    unset: Iterable[str]
    grid: tuple[int, int] | None
    seed: int | None
    acquisition: Acquisition | None
    noise: bool
    keep_clean: bool
    engine: BuildEngine | None
    profile: Literal["default", "published"] | None
    window_angstrom: float | None
    accuracy_percent: float | None
    max_error_percent: float | None
    expansion_percent: Literal["auto", "off"] | float
    interpolation: int | tuple[int, int] | None
    audit: int | None
    subtile_nm: float | None
    subtile_overlap_nm: float | None
    cache: bool | str | os.PathLike[str]
    overwrite: bool
    png: bool
    force: bool
    threads: int | None
    progress: Progress


@dataclass(frozen=True)
class BuildPart:
    """What :func:`build_part` did.

    Attributes:
        shard: number of the part, from 0, and how many there are.
        library_lacks: simulations of the library that other parts have not made yet; sub-tiles are made when there are none.
        subtiles: sub-tiles of this part that are there now.
        subtiles_resumed: those of them that were there before.
        wall_time_s: time it took.
    """

    shard: tuple[int, int]
    library_lacks: int
    subtiles: int
    subtiles_resumed: int
    wall_time_s: float


@dataclass(frozen=True)
class BuildPlan:
    """What a build would do and take; nothing was simulated or written.

    Attributes:
        grid: rows and columns of tiles.
        shape: height and width in pixels.
        fov_nm: the same in nm.
        subtiles: parts that are simulated at once.
        memory_bytes, disk_bytes: about, at most.
        time_range_s: at least and at most, from a short measurement.
        warnings: what should be known.
        details: everything, as ``stemgen build --dry-run --json`` has it.
    """

    grid: tuple[int, int]
    shape: tuple[int, int]
    fov_nm: tuple[float, float]
    pixel_nm: float
    thickness_nm: float
    subtiles: int
    configurations: int
    memory_bytes: int
    disk_bytes: int
    time_range_s: tuple[float, float]
    warnings: tuple[str, ...]
    details: Mapping[str, Any]


def build(recipe: RecipeLike, *, out: str | os.PathLike[str], **options: Unpack[BuildOptions]) -> World:
    """Builds a world: the image of a whole specimen, and the truth about each of its atoms.

    The same recipe, seed and version give the same image and truth, byte for byte, for any number of threads, and the same as
    ``stemgen build``. After Ctrl-C or a crash the same call goes on where it was.

    Args:
        recipe: name, path, TOML, dict or :class:`Recipe`.
        out: file to write (HDF5).
        **options: see :class:`BuildOptions`.

    Returns:
        The world, open for reading; ``summary`` tells how it was built.

    Raises:
        InvalidValue: for recipe and options.
        FileThere: unless ``overwrite``.
        DiskFull, OutputLocked: where the file cannot be written.
        NotEnoughMemory: unless ``force``.
        KeyboardInterrupt: what is done is kept in ``FILE.work``.
    """
    built = call(_core.build_world, _building(recipe, out, options), _run(options))
    world = World(out)
    world.summary = json.loads(built)
    return world


def build_part(recipe: RecipeLike, *, out: str | os.PathLike[str], shard: tuple[int, int], **options: Unpack[BuildOptions]) -> BuildPart:
    """Makes one of several parts of what a world takes, for processes or machines that see the same files.

    :func:`build` with the same arguments, but for ``shard``, finds all parts, makes what is missing, and writes the world: the same
    bytes for any number of parts. The sub-tiles of a mosaic need the library of all parts: start the parts again when all have ended,
    or leave the sub-tiles to :func:`build`.

    Args:
        recipe: name, path, TOML, dict or :class:`Recipe`.
        out: the file that :func:`build` will write.
        shard: number of this part, from 0, and how many there are.
        **options: see :class:`BuildOptions`.

    Raises:
        InvalidValue: for recipe, options and shard, and for parts of another world beside ``out``, which are kept.
        FileThere, OutputLocked, DiskFull: where the world cannot be made.
    """
    made = json.loads(call(_core.build_part, _building(recipe, out, options), shard, _run(options)))
    return BuildPart(
        shard=(made["shard"][0], made["shard"][1]),
        library_lacks=made["library_lacks"],
        subtiles=made["subtiles"],
        subtiles_resumed=made["subtiles_resumed"],
        wall_time_s=made["wall_time_s"],
    )


def plan(recipe: RecipeLike, **options: Unpack[BuildOptions]) -> BuildPlan:
    """What :func:`build` would do and take with the same arguments; nothing is simulated or written."""
    report = json.loads(call(_core.plan_build, _building(recipe, "world.h5", options), _run(options)))
    grid, shape, fov, times = (tuple(report[name]) for name in ("tiles", "pixels", "fov_nm", "estimated_range_s"))
    return BuildPlan(
        grid=(grid[0], grid[1]),
        shape=(shape[0], shape[1]),
        fov_nm=(fov[0], fov[1]),
        pixel_nm=report["pixel_nm"],
        thickness_nm=report["thickness_nm"],
        subtiles=report["subtiles"],
        configurations=report["configurations"],
        memory_bytes=report["memory_bytes"],
        disk_bytes=report["disk_bytes"],
        time_range_s=(times[0], times[1]),
        warnings=tuple(report["warnings"]),
        details=report,
    )


def _run(options: BuildOptions) -> Any:
    return running(options.get("threads"), options.get("progress"))


def _building(recipe: RecipeLike, out: str | os.PathLike[str], options: BuildOptions) -> _core.BuildOptions:
    unknown = options.keys() - BuildOptions.__annotations__.keys()
    if unknown:
        raise TypeError(f"unexpected keyword argument {sorted(unknown)[0]!r}")
    resolved = Recipe(
        recipe,
        options.get("difficulty"),
        set=options.get("set"),
        unset=options.get("unset", ()),
        grid=options.get("grid"),
        seed=options.get("seed"),
        acquisition=options.get("acquisition"),
    )
    interpolation = options.get("interpolation")
    cache = options.get("cache", True)
    return {
        "toml": resolved.toml,
        "out": os.fspath(out),
        "noise": options.get("noise", True),
        "keep_clean": options.get("keep_clean", False),
        "overwrite": options.get("overwrite", False),
        "engine": options.get("engine"),
        "profile": options.get("profile"),
        "window_angstrom": options.get("window_angstrom"),
        "accuracy_percent": options.get("accuracy_percent"),
        "expansion_percent": options.get("expansion_percent", "auto"),
        "interpolation": (interpolation, interpolation) if isinstance(interpolation, int) else interpolation,
        "audit": options.get("audit"),
        "max_error_percent": options.get("max_error_percent"),
        "cache": cache if isinstance(cache, bool) else os.fspath(cache),
        "subtile_nm": options.get("subtile_nm"),
        "subtile_overlap_nm": options.get("subtile_overlap_nm"),
        "png": options.get("png", False),
        "force": options.get("force", False),
    }
