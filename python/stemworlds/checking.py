"""Checks accuracy and integrity: audits, validation, and comparison of worlds."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from . import _core
from ._fields import FieldLike, field_options, world_path
from ._running import Progress, call, running
from .worlds import World

Path = str | os.PathLike[str]


@dataclass(frozen=True)
class Audit:
    """The error of a world's image, compared with multislice for the same atoms.

    Attributes:
        bright_rms_percent: rms error at bright columns, in per cent of their intensity.
        all_rms_percent: rms error of all pixels, in per cent of the brightest column.
        worst_percent: greatest absolute error of a pixel, in per cent of the brightest column.
        regions: number of audited regions.
        details: all values, as in ``stemgen audit --json``.
    """

    bright_rms_percent: float
    all_rms_percent: float
    worst_percent: float
    regions: int
    details: Mapping[str, Any]


def audit(
    field: FieldLike,
    *,
    regions: int = 3,
    at_nm: Sequence[tuple[float, float]] = (),
    size_nm: float = 1.0,
    stride: int | None = None,
    configurations: int | None = None,
    audit_seed: int = 1,
    cache: bool | Path = True,
    force: bool = False,
    check: bool = True,
    threads: int | None = None,
    progress: Progress = False,
    **recipe: Any,
) -> Audit:
    """Simulates regions of a world again by plain multislice with the same displaced atoms. Returns the error of the world.

    Args:
        field: a :class:`World`, its path, or a recipe. For a recipe, the error of a world is estimated before it is built.
        regions: number of regions, drawn at random.
        at_nm: centres ``(x, y)`` in nm, instead of random ones.
        size_nm: edge of a region.
        stride: distance of compared pixels; 1 compares every pixel.
        configurations: number of phonon configurations to average.
        audit_seed: seed of the random places.
        check: if ``field`` is a path, read the file first in a separate process, see :class:`World`.
        **recipe: ``difficulty``, ``set``, ``unset``, ``grid``, ``seed`` of a recipe, see :class:`Recipe`.
    """
    path = None if isinstance(field, World) else world_path(field)
    if check and path is not None:
        check_file(path)
    options: _core.AuditOptions = {
        "field": field_options(field, recipe),
        "regions": regions,
        "at_nm": [(x, y) for x, y in at_nm],
        "size_nm": size_nm,
        "stride": stride,
        "configurations": configurations,
        "seed": audit_seed,
        "cache": cache if isinstance(cache, bool) else os.fspath(cache),
        "force": force,
    }
    found = json.loads(call(_core.audit_field, options, running(threads, progress)))
    return Audit(
        bright_rms_percent=found["bright_rms_percent"],
        all_rms_percent=found["all_rms_percent"],
        worst_percent=found["worst_percent"],
        regions=len(found["regions"]),
        details=found,
    )


@dataclass(frozen=True)
class Validation:
    """Result of the validation suite.

    Attributes:
        passed: whether all numbers are within their limits.
        failed: names of the cases with a number outside of its limit.
        details: all values.
    """

    passed: bool
    failed: tuple[str, ...]
    details: Mapping[str, Any]


def validation_cases() -> dict[str, str]:
    """Returns the name and the title of each case of the validation suite."""
    return {name: title for name, title, _, _ in _core.validation_cases()}


def validate(
    cases: Sequence[str] = (),
    *,
    quick: bool = False,
    out: Path | None = None,
    overwrite: bool = False,
    threads: int | None = None,
    progress: Progress = False,
) -> Validation:
    """Compares the program with abTEM, published numbers and conservation laws. It takes some minutes.

    Args:
        cases: names of cases; all by default.
        quick: run the quick cases only.
        out: page (HTML) to write.
    """
    names = [cases] if isinstance(cases, str) else list(cases)
    found = json.loads(
        call(_core.validate_suite, names, quick, _path(out), overwrite, running(threads, progress))
    )
    failed = tuple(case["name"] for case in found["cases"] if case["verdict"] == "fail")
    return Validation(passed=found["verdict"] != "fail", failed=failed, details=found)


@dataclass(frozen=True)
class Comparison:
    """Result of a statistical comparison of two worlds.

    Attributes:
        verdict: ``"same"``, ``"different"`` or ``"undecided"``.
        summary: the verdict in a sentence.
        different: names of the statistics that differ.
        details: all values.
    """

    verdict: Literal["same", "different", "undecided"]
    summary: str
    different: tuple[str, ...]
    details: Mapping[str, Any]


def compare(
    a: Path,
    b: Path,
    *,
    alpha: float = 0.001,
    out: Path | None = None,
    overwrite: bool = False,
    check: bool = True,
    threads: int | None = None,
    progress: Progress = False,
) -> Comparison:
    """Compares two worlds by their statistics.

    Args:
        a, b: the files.
        alpha: accepted probability of the verdict ``"different"`` for two worlds that differ in their seed alone.
        out: page (HTML) to write.
        check: read both files first in a separate process, see :class:`World`.
    """
    paths = [os.fspath(a), os.fspath(b)]
    if check:
        for path in paths:
            check_file(path)
    found = json.loads(
        call(_core.compare_worlds, paths, alpha, _path(out), overwrite, running(threads, progress))
    )
    different = tuple(line["what"] for line in found["lines"] if line["verdict"] == "different")
    return Comparison(verdict=found["verdict"], summary=found["summary"], different=different, details=found)


@dataclass(frozen=True)
class Verification:
    """Result of the consistency checks of a world file.

    Attributes:
        sound: whether all checks passed.
        faults: descriptions of the faults, by name of the check.
        details: results of each check, by name.
    """

    sound: bool
    faults: Mapping[str, str]
    details: Mapping[str, str]


def verify(world: Path, *, check: bool = True, threads: int | None = None, progress: Progress = False) -> Verification:
    """Checks a world file: tiles against neighbours and overview, lists of the truth against each other and the field, counts against the
    dose.

    Args:
        world: the file.
        check: read the file first in a separate process, see :class:`World`.

    Raises:
        FileError: if the file does not exist, or cannot be read.
    """
    if check:
        check_file(os.fspath(world))
    checks = json.loads(call(_core.verify_world, os.fspath(world), running(threads, progress)))
    faults = {one["what"]: one["found"] for one in checks if one["outcome"] == "fault"}
    return Verification(sound=not faults, faults=faults, details={one["what"]: one["found"] for one in checks})


def check_file(path: str) -> None:
    """Reads a whole file in a separate process, since a damaged file may crash or hang the HDF5 library."""
    _core.check_file(path, [sys.executable, "-m", "stemworlds"])


def _path(path: Path | None) -> str | None:
    return None if path is None else os.fspath(path)
