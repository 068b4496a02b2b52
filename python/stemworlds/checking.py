"""Is it right? Audits, validation, and the comparison of worlds."""

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
    """The error of a world's image, against multislice of the same atoms.

    Attributes:
        bright_rms_percent: rms error at bright columns, in per cent of their intensity.
        all_rms_percent: rms error of all pixels, in per cent of the brightest column.
        worst_percent: the greatest of them.
        regions: number of regions that were simulated again.
        details: everything, as ``stemgen audit --json`` has it.
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
    """Simulates regions of a world again, by plain multislice of the very same atoms, and tells the error.

    Args:
        field: a :class:`World`, the path of one, or a recipe, of which the error of a world is told before it is built.
        regions: number of regions, drawn at random.
        at_nm: centres ``(x, y)`` in nm in place of random ones.
        size_nm: edge of a region.
        stride: compare every how many-th pixel.
        configurations: phonon configurations to average.
        audit_seed: of the places.
        check: first reads a world given by its path through in a process of its own, as :class:`World` does.
        **recipe: ``difficulty``, ``set``, ``unset``, ``grid``, ``seed`` of a recipe, as :class:`Recipe` takes them.
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
    """What the shipped suite of checks comes to.

    Attributes:
        passed: whether all numbers lie within their limits.
        failed: names of the cases with a number beyond its limit.
        details: everything.
    """

    passed: bool
    failed: tuple[str, ...]
    details: Mapping[str, Any]


def validation_cases() -> dict[str, str]:
    """The cases of the suite: name and title."""
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
    """Checks the program against abTEM, published numbers and conservation laws: some minutes.

    Args:
        cases: names of cases; all by default.
        quick: the quick ones only.
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
    """Whether two worlds are of one kind.

    Attributes:
        verdict: ``"same"``, ``"different"`` or ``"undecided"``.
        summary: the same in a sentence.
        different: what differs.
        details: everything.
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
        alpha: how often worlds of one kind may be called different.
        out: page (HTML) to write.
        check: first reads both files through in a process of their own, as :class:`World` does.
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
    """Whether a world file is whole and agrees with itself.

    Attributes:
        sound: nothing is wrong. faults: what is, by name of the check. details: what each check found, by name.
    """

    sound: bool
    faults: Mapping[str, str]
    details: Mapping[str, str]


def verify(world: Path, *, check: bool = True, threads: int | None = None, progress: Progress = False) -> Verification:
    """Holds tiles against each other and the overview, lists of the truth against each other and the field, and counts against the dose.

    Args:
        world: the file.
        check: first reads it through in a process of its own, as :class:`World` does.

    Raises:
        FileError: the file is not there, or cannot be read.
    """
    if check:
        check_file(os.fspath(world))
    checks = json.loads(call(_core.verify_world, os.fspath(world), running(threads, progress)))
    faults = {one["what"]: one["found"] for one in checks if one["outcome"] == "fault"}
    return Verification(sound=not faults, faults=faults, details={one["what"]: one["found"] for one in checks})


def check_file(path: str) -> None:
    """Reads a file through in a process of its own: damaged files of strangers may end or hang the HDF5 library."""
    _core.check_file(path, [sys.executable, "-m", "stemworlds"])


def _path(path: Path | None) -> str | None:
    return None if path is None else os.fspath(path)
