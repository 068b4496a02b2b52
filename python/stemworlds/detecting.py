"""Finds the dose at which a defect is seen."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from . import _core
from ._running import Progress, call, running
from .atoms import AseAtoms, AtomArrays, Atoms, atoms_source
from .errors import _invalid
from .recipes import Difficulty, Recipe, RecipeLike
from .simulation import _KEYS_OF_REQUEST, Aberrations, Detectors, Engine, Sigma, _tables

#: Endings of files of atoms.
_ATOMS = (".xyz", ".extxyz", ".cif", ".vasp", ".poscar")


class DetectabilityOptions(TypedDict, total=False):
    """Options of :func:`detectability`.

    Test:
        doses: electrons per square Angstrom at which the test is reported. Default 1e2 to 1e6 in decades, and the dose of the recipe.
        power: share of the defects that has to be found. Default 0.9.
        false_alarms: share of columns without the defect that the test reports. Default 0.01.
        rate: share of columns with the defect, for the average precision. Default: the rate of the recipe, or 0.05.
        phonons: number of simulated phonon configurations, from 4. Default 16.
        averaged: number of configurations that an image averages, as in worlds, so that their scatter hides defects. Default: an experiment,
            in which every electron meets its own configuration.
        radius_angstrom: radius of the patch around the column that the test reads. Default 1.2.
        step_angstrom: distance of probes in the patch. Default: half the Nyquist limit with windows, the Nyquist limit with other engines.
        ring_mrad: width of the rings of which the best annulus is made; 0 for no search. Default 10.
        experiments: number of simulated experiments that judge a test without a closed form. Default 4000.

    Defect:
        site_angstrom: place ``(x, y)`` in the box; the nearest column that holds the element is taken. Default: near the centre.
        column: elements of the column that holds the defect, ``"Ti-O"``. Default: the columns with the fewest other elements.

    Specimen:
        zone, up, repeat: for atoms, see :class:`SimulationOptions`. By default the box is as wide as the engine needs.

    Microscope:
        sigma, temperature_k, seed, energy_kv, semiangle_mrad, defocus_angstrom: see :class:`SimulationOptions`. Default: values of the recipe.
        aberrations, tilt_mrad, focal_spread_angstrom, source_size_angstrom: likewise.
        source_lorentz, detectors: likewise.
        engine, window_angstrom: see :class:`SimulationOptions`. Default: windows with an error of 0.8 %, and multislice if a detector begins
            below two semiangles.
        force: continue if the simulation needs more memory than is free.

    Running:
        threads, progress: see :class:`SimulationOptions`.
    """

    doses: Sequence[float]
    power: float
    false_alarms: float
    rate: float
    phonons: int
    averaged: int | None
    radius_angstrom: float
    step_angstrom: float | None
    ring_mrad: float
    experiments: int
    site_angstrom: tuple[float, float] | None
    column: str | None
    zone: tuple[int, int, int] | tuple[int, int, int, int] | None
    up: tuple[int, int, int] | tuple[int, int, int, int] | None
    repeat: tuple[int, int, int] | None
    sigma: Sigma | None
    temperature_k: float | None
    seed: int
    energy_kv: float
    semiangle_mrad: float
    defocus_angstrom: float
    aberrations: Aberrations
    tilt_mrad: tuple[float, float]
    focal_spread_angstrom: float
    source_size_angstrom: float | None
    source_lorentz: float
    detectors: Detectors
    engine: Engine | None
    window_angstrom: float | None
    force: bool
    threads: int | None
    progress: Progress


@dataclass(frozen=True)
class NeededDose:
    """The dose at which a defect is found.

    Attributes:
        verdict: ``"found"``; ``"never"``, if no dose suffices; ``"unresolved"``, if the signal is within two standard errors of 0, so that
            more configurations are needed. Then ``low`` is a lower limit of the dose.
        dose: electrons per square Angstrom; ``None`` without a dose.
        low: the dose minus one standard error.
        high: the dose plus one standard error; ``None`` without a limit.
    """

    verdict: Literal["found", "never", "unresolved"]
    dose: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class DetectorResult:
    """How well one detector finds a defect.

    Attributes:
        detector: name of the detector.
        annulus_mrad: inner and outer angle.
        contrast_percent: change of the patch by the defect in per cent of the patch.
        information_angstrom2: squared d' for one electron per square Angstrom.
        information_error_angstrom2: its standard error.
        needed: the needed dose of the question that was asked. At an unknown depth it is the dose of the mixture, for images that average
            few configurations the dose of the linear observer, and else the dose with known images.
        known: the needed dose with known images, a lower limit.
        doses: the tests at each dose, as dicts: ``electrons_per_angstrom2``, ``known`` (and ``linear``, ``mixture``) with ``d_prime``,
            ``auc``, ``power``, ``average_precision`` and ``roc``, and ``position_error_angstrom``.
    """

    detector: str
    annulus_mrad: tuple[float, float]
    contrast_percent: float
    information_angstrom2: float
    information_error_angstrom2: float
    needed: NeededDose
    known: NeededDose
    doses: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class DetectabilityCase:
    """A defect at one thickness.

    Attributes:
        defect: the defect, ``"vacancy:O@middle"``.
        thickness_nm: thickness, a whole number of cells.
        column: elements of the column with their numbers of atoms, ``"Ti26 O26"``.
        site_angstrom: place ``(x, y)`` of the column in the box.
        depths_nm: heights of the changed atoms from the entrance surface.
        detectors: one result for each detector, by name.
        best_annulus: angles and needed dose of the annulus of whole rings with the lowest dose; ``None`` without rings.
        all_rings: the same for all rings, each counted and weighed alone.
    """

    defect: str
    thickness_nm: float
    column: str
    site_angstrom: tuple[float, float]
    depths_nm: tuple[float, ...]
    detectors: Mapping[str, DetectorResult]
    best_annulus: tuple[tuple[float, float], NeededDose] | None
    all_rings: tuple[tuple[float, float], NeededDose] | None


class Detectability:
    """How well defects are found: a sequence of cases, thicknesses first, and in each the defects.

    Attributes:
        name: name of the material or of the file.
        cases: all cases.
        sentences: one sentence for each case and detector.
        details: all values, as in ``stemgen detectability --json``.
    """

    def __init__(self, report: str, sentences: Sequence[str], csv: str, svg: str) -> None:
        self.details: dict[str, Any] = json.loads(report)
        self.name: str = self.details["name"]
        self.sentences: tuple[str, ...] = tuple(sentences)
        self.cases: tuple[DetectabilityCase, ...] = tuple(_case(case) for case in self.details["cases"])
        self._csv, self._svg = csv, svg

    def __len__(self) -> int:
        return len(self.cases)

    def __getitem__(self, index: int) -> DetectabilityCase:
        return self.cases[index]

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Writes all numbers (``.json``), a table (``.csv``), or curves of the power over the dose (``.svg``).

        Raises:
            InvalidValue: for another ending.
            FileError: if the file exists, unless ``overwrite`` is set, or cannot be written.
        """
        contents = {".json": json.dumps(self.details, indent=2) + "\n", ".csv": self._csv, ".svg": self._svg}
        ending = Path(path).suffix.lower()
        if ending not in contents:
            raise _invalid("path", f"path = {os.fspath(path)!r}: the name ends in .json, .csv or .svg")
        _core.write_file(os.fspath(path), contents[ending].encode(), overwrite)

    def __repr__(self) -> str:
        return f"<Detectability of {self.name}: {len(self.cases)} cases>"

    def __str__(self) -> str:
        return "\n".join(self.sentences)

    def _repr_svg_(self) -> str:
        return self._svg


def detectability(
    specimen: RecipeLike | Atoms,
    defects: str | Sequence[str] | None = None,
    *,
    thicknesses_nm: float | Sequence[float] | None = None,
    difficulty: Difficulty | None = None,
    **options: Unpack[DetectabilityOptions],
) -> Detectability:
    """Finds the dose at which a defect of a column is seen, by the best possible test (the likelihood ratio).

    Args:
        specimen: a recipe (:class:`Recipe`, its name or file), whose crystal, thickness and microscope are used; or atoms without defects,
            see :func:`simulate`.
        defects: ``"vacancy:O"``, ``"substitution:Ti:Nb"`` or ``"column:O"``, with a depth: ``"@top"`` (entrance surface), ``"@middle"``,
            ``"@bottom"``, ``"@any"`` (unknown) or a fraction of the thickness, ``"@0.25"``. Default: the vacancy or the substitution of the
            recipe, in the middle.
        thicknesses_nm: thicknesses, moved to whole cells. Default: the thickness of the recipe or of the atoms.
        difficulty: tier of the recipe.
        **options: see :class:`DetectabilityOptions`.

    Returns:
        The needed dose of each thickness, defect and detector, with the tests at each dose.

    Raises:
        InvalidValue: for an option out of its limits, and for a defect whose element the atoms do not hold.
        FormatError, FileError: if a file cannot be read.
        NotEnoughMemory: if the simulation needs more memory than is free, unless ``force`` is set.
        KeyboardInterrupt: after Ctrl-C.
    """
    unknown = options.keys() - DetectabilityOptions.__annotations__.keys()
    if unknown:
        raise TypeError(f"unexpected keyword argument {sorted(unknown)[0]!r}")
    given: dict[str, Any] = dict(options)
    request: dict[str, Any] = {}
    if defects is not None:
        request["defects"] = [defects] if isinstance(defects, str) else [str(defect) for defect in defects]
    if thicknesses_nm is not None:
        listed = thicknesses_nm if isinstance(thicknesses_nm, Sequence) else [thicknesses_nm]
        request["thicknesses_nm"] = [float(nm) for nm in listed]
    if given.get("phonons") is not None:
        request["configurations"] = given.pop("phonons")
    for key in ("power", "false_alarms", "rate", "averaged", "radius_angstrom", "step_angstrom", "ring_mrad", "experiments", "column"):
        if given.get(key) is not None:
            request[key] = given.pop(key)
    if given.get("doses") is not None:
        request["doses"] = [float(dose) for dose in given.pop("doses")]
    if given.get("site_angstrom") is not None:
        x, y = given.pop("site_angstrom")
        request["site_angstrom"] = [float(x), float(y)]
    request.update(_tables({key: value for key, value in given.items() if key in _KEYS_OF_REQUEST}))
    source = _source(specimen, difficulty, request)
    run = running(options.get("threads"), options.get("progress"))
    return Detectability(*call(_core.detectability, request, source, options.get("force", False), run))


def _source(specimen: Any, difficulty: Difficulty | None, request: dict[str, Any]) -> _core.DefectSource:
    """Returns the source of the atoms in the extension's form; the path of a file of atoms becomes part of the request."""
    is_file = isinstance(specimen, (str, os.PathLike)) and os.fspath(specimen).lower().endswith(_ATOMS)
    if is_file or isinstance(specimen, (AtomArrays, AseAtoms)):
        if difficulty is not None:
            raise _invalid("difficulty", "atoms have no tiers; leave the difficulty out")
        atoms = atoms_source(specimen)
        request["structure"] = atoms if isinstance(atoms, str) else ""
        name = Path(atoms).stem if isinstance(atoms, str) else "atoms"
        return {"recipe": None, "atoms": None if isinstance(atoms, str) else atoms, "name": name}
    recipe = specimen if isinstance(specimen, Recipe) and difficulty is None else Recipe(specimen, difficulty)
    return {"recipe": recipe.toml, "atoms": None, "name": recipe.id}


def _needed(found: Mapping[str, Any]) -> NeededDose:
    low, high = found["range"]
    return NeededDose(found["verdict"], found["electrons_per_angstrom2"], low, high)


def _pair(values: Sequence[float]) -> tuple[float, float]:
    first, second = values
    return first, second


def _detector(found: Mapping[str, Any]) -> DetectorResult:
    needed = found.get("linear") or found.get("mixture") or found["known"]
    return DetectorResult(
        detector=found["detector"],
        annulus_mrad=_pair(found["annulus_mrad"]),
        contrast_percent=found["contrast_percent"],
        information_angstrom2=found["information_angstrom2"],
        information_error_angstrom2=found["information_error_angstrom2"],
        needed=_needed(needed),
        known=_needed(found["known"]),
        doses=tuple(found["doses"]),
    )


def _case(case: Mapping[str, Any]) -> DetectabilityCase:
    def annulus(key: str) -> tuple[tuple[float, float], NeededDose] | None:
        found = case.get(key)
        return None if found is None else (_pair(found["annulus_mrad"]), _needed(found["needed"]))

    return DetectabilityCase(
        defect=case["defect"],
        thickness_nm=case["thickness_nm"],
        column=case["column"],
        site_angstrom=_pair(case["site_angstrom"]),
        depths_nm=tuple(case["depths_nm"]),
        detectors={found["detector"]: _detector(found) for found in case["detectors"]},
        best_annulus=annulus("best_annulus"),
        all_rings=annulus("all_rings"),
    )
