"""Builds and plans worlds."""

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
        difficulty, set, unset, grid, seed, acquisition: see :class:`Recipe`.

    Image:
        noise: add Poisson noise. Default ``True``.
        keep_clean: also store the noise-free tiles.
        engine: method of simulation; by default a mosaic, or windows for a field that is too small for a mosaic to be faster.
        window_angstrom: width of the window that follows each probe.
        interpolation: interpolation of PRISM along x and y.
        accuracy_percent: widen the windows until the audit's rms error is at most this, in per cent of the mean image.
        max_error_percent: widen the windows until both errors of the audit are at most this: at bright columns, in per cent of their
            intensity, and over all pixels, in per cent of the brightest column.
        expansion_percent: ``"auto"``, ``"off"`` or per cent.
        profile: ``"published"`` uses the settings of the published worlds.
        audit: number of regions that are audited before the build; 0 for none, 1 by default.
        subtile_nm, subtile_overlap_nm: width and overlap of sub-tiles.

    Running:
        cache: ``False`` stores no simulations for other worlds; a path is the folder in which they are stored.
        overwrite: replace an existing file.
        png: also write a picture beside the file.
        force: continue if the build needs more memory than is free.
        threads: number of threads; all processors by default. The result does not depend on it.
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
    """Result of :func:`build_part`.

    Attributes:
        shard: number of the part, from 0, and number of parts.
        library_lacks: number of library simulations that other parts have not made yet. Sub-tiles are made only if it is 0.
        subtiles: number of finished sub-tiles of this part.
        subtiles_resumed: number of these sub-tiles that were finished before the call.
        wall_time_s: duration of the call.
    """

    shard: tuple[int, int]
    library_lacks: int
    subtiles: int
    subtiles_resumed: int
    wall_time_s: float


@dataclass(frozen=True)
class BuildPlan:
    """Size, memory and time of a build, before it begins.

    Attributes:
        grid: rows and columns of tiles.
        shape: height and width in pixels.
        fov_nm: height and width in nm.
        subtiles: number of sub-tiles.
        memory_bytes, disk_bytes: estimated maximum of memory and disk space.
        time_range_s: least and greatest estimated time, from a short measurement.
        warnings: warnings about the build.
        details: all values, as in ``stemgen build --dry-run --json``.
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

    Recipe, seed and version determine image and truth byte for byte. The number of threads has no effect, and ``stemgen build`` writes the
    same bytes. After Ctrl-C or a crash, an identical call continues the build.

    Args:
        recipe: name, path, TOML, dict or :class:`Recipe`.
        out: file to write (HDF5).
        **options: see :class:`BuildOptions`.

    Returns:
        The world, open for reading. Its ``summary`` contains the facts about the build.

    Raises:
        InvalidValue: for an invalid recipe or option.
        FileThere: if ``out`` exists, unless ``overwrite`` is set.
        DiskFull, OutputLocked: if the file cannot be written.
        NotEnoughMemory: if the build needs more memory than is free, unless ``force`` is set.
        KeyboardInterrupt: after Ctrl-C. Finished parts are kept in the folder ``FILE.work``.
    """
    built = call(_core.build_world, _building(recipe, out, options), _run(options))
    world = World(out)
    world.summary = json.loads(built)
    return world


def build_part(recipe: RecipeLike, *, out: str | os.PathLike[str], shard: tuple[int, int], **options: Unpack[BuildOptions]) -> BuildPart:
    """Makes one of several parts of a world, for processes or machines that share a file system.

    :func:`build` with equal arguments, but without ``shard``, collects all parts, makes missing ones, and writes the world. The number of
    parts does not change its bytes. The sub-tiles of a mosaic need the library of all parts. Start the parts a second time when all have
    ended, or let :func:`build` make the sub-tiles.

    Args:
        recipe: name, path, TOML, dict or :class:`Recipe`.
        out: the file that :func:`build` will write.
        shard: number of this part, from 0, and number of parts.
        **options: see :class:`BuildOptions`.

    Raises:
        InvalidValue: for an invalid recipe, option or shard, and if parts of another world lie beside ``out``. These are kept.
        FileThere, OutputLocked, DiskFull: if the world cannot be written.
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
    """Estimates size, memory and time of :func:`build` with these arguments. No file is written."""
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
