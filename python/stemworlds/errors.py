"""The exceptions of the package, with messages of the library and keywords of Python.

Every exception is a :class:`StemworldsError`. An invalid value is a :class:`ValueError` too, an error of a file an :class:`OSError`, and a
lack of memory a :class:`MemoryError`. Ctrl-C raises :class:`KeyboardInterrupt`, as usual in Python.
"""

from __future__ import annotations

import errno as _errno
import os as _os

__all__ = [
    "DiskFull",
    "FileError",
    "FileForbidden",
    "FileMissing",
    "FileThere",
    "FormatError",
    "InternalError",
    "InvalidValue",
    "NotEnoughMemory",
    "OutputLocked",
    "StemworldsError",
    "WrongType",
]


class StemworldsError(Exception):
    """Base of all exceptions. The message names the fault, its place, and a remedy.

    Attributes:
        keyword: name of the argument to change; ``None`` if no argument is at fault.
        setting: the library's name of the setting; ``None`` likewise.
    """

    keyword: str | None = None
    setting: str | None = None

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class InvalidValue(StemworldsError, ValueError):
    """Raised if a value is out of its limits, or two values contradict each other."""


class WrongType(StemworldsError, TypeError):
    """Raised if a value has a wrong type, for example a text instead of a number."""


class FileError(StemworldsError, OSError):
    """Raised if a file cannot be read or written. ``filename`` is its name, and ``errno`` the system's reason."""


class FileMissing(FileError, FileNotFoundError):
    """Raised if a file or its folder does not exist."""


class FileThere(FileError, FileExistsError):
    """Raised if a file exists already. ``overwrite=True`` replaces it."""


class FileForbidden(FileError, PermissionError):
    """Raised without permission to read or write a file or folder."""


class FormatError(FileError, ValueError):
    """Raised if a file is damaged, or has another format."""


class DiskFull(FileError):
    """Raised if the disk has too little free space for the output."""


class OutputLocked(FileError):
    """Raised if another process is writing the same file."""


class NotEnoughMemory(StemworldsError, MemoryError):
    """Raised if a computation needs more memory than is free. ``force=True`` computes nevertheless."""


class InternalError(StemworldsError, RuntimeError):
    """Raised for a fault of the program. Please report it."""


#: The argument for each setting of the library; ``None`` for settings that only a recipe has, or nothing changes.
_KEYWORDS: dict[str, str | None] = {
    "EnergyKev": "energy_kv",
    "SemiangleMrad": "semiangle_mrad",
    "Aberration": "aberrations or defocus_angstrom",
    "Defocus": "defocus_angstrom",
    "Frames": "frames",
    "Scan": "scan",
    "PlaneWave": None,
    "OutputName": "out",
    "MistiltMrad": "tilt_mrad",
    "FocalSpreadAngstrom": "focal_spread_angstrom",
    "SourceLorentzShare": "source_lorentz",
    "SourceSizeAngstrom": "source_size_angstrom",
    "Detector": "detectors",
    "DetectorName": "detectors",
    "Detectors": "detectors",
    "PatternPixels": "pixels",
    "MaxAngleMrad": "max_angle_mrad",
    "RingWidthMrad": "radial_mrad",
    "DetectorMtf": "mtf",
    "StructureFile": "atoms",
    "Crystal": None,
    "Cell": "zone",
    "Zone": "zone",
    "Up": "up",
    "MaxStrain": "max_strain_percent",
    "Repeat": "repeat",
    "SupercellAtoms": "repeat",
    "Occupancy": "atoms",
    "SiteOccupancy": "atoms",
    "ThermalSigma": "sigma",
    "Displacements": "displacements",
    "Temperature": "temperature_k",
    "ClusterDiameterNm": None,
    "Algorithm": "engine",
    "CellAngstrom": "atoms",
    "CellHeightAngstrom": "atoms",
    "Gpts": "gpts",
    "SamplingAngstrom": "sampling_angstrom",
    "SliceThicknessAngstrom": "slice_thickness_angstrom",
    "SliceSpanAngstrom": "slice_thickness_angstrom",
    "ThicknessAngstrom": "thicknesses_angstrom",
    "AngleMargin": "angle_margin",
    "BandFraction": "band_fraction",
    "BandTaper": "band_taper",
    "ExpansionPercent": "expansion_percent",
    "Oversampling": "oversampling",
    "PhononConfigurations": "phonons",
    "ProbeBox": "probe_box",
    "Interpolation": "interpolation",
    "WindowAngstrom": "window_angstrom",
    "AccuracyPercent": "accuracy_percent",
    "Pattern": None,
    "SampleStepAngstrom": "probe_step",
    "Material": "recipe",
    "Difficulty": "difficulty",
    "Recipe": None,
    "Grid": "grid",
    "Alloy": None,
    "AlloyRate": None,
    "AlloyEndMember": None,
    "BoundaryCount": None,
    "BoundarySigma": None,
    "Domains": None,
    "DomainCrystal": None,
    "Particles": None,
    "ParticleCount": None,
    "ParticleDiameterNm": None,
    "VacancyRate": None,
    "CrystalSites": None,
    "ColumnSites": None,
    "SubtileNm": "subtile_nm",
    "Shard": "shard",
    "Manifest": "manifest",
    "Score": "score",
    "Episode": None,
    "Findings": "findings",
    "BuildProfile": "profile",
    "TilePixels": "size",
    "Dose": "dose",
    "BeamCurrentPa": "current_pa",
    "Acquisition": "profile or acquisition",
    "RecordedRegionNm": "region_nm or at_nm",
    "RecordedPixelNm": "pixel_nm or zoom",
    "EngineMarginAngstrom": None,
    "EngineImageShape": None,
    "Intensity": None,
    "Library": "cache",
    "LargestErrorPercent": "max_error_percent",
    "AuditedRegionNm": "size_nm",
    "AuditCentreNm": "regions or at_nm",
    "VacuumAngstrom": "vacuum_angstrom",
    "Output": "out",
    "WorldFile": None,
    "SitesInFile": None,
    "SiteRange": None,
    "Region": "region_nm or scan",
    "CleanImage": "clean",
    "DataSet": "dataset",
    "ImageAxes": None,
    "ImageIndex": "index",
    "ImageUnits": None,
    "ReplayPixelNm": "pixel_nm",
    "ReplaySpacingNm": "spacing_nm",
    "ReplayImage": None,
    "Overlay": "overlays",
    "Colormap": "colormap",
    "ContrastRange": "contrast",
    "ContrastPercentiles": "contrast",
    "LongestSidePixels": "size",
    "PixelAngstrom": None,
    "Images": None,
    "ImageShape": None,
    "ImageValue": None,
    "MarkerPosition": None,
    "Page": "overlays",
    "Figure": None,
    "Card": None,
    "MostDose": "dose",
    "Recordings": "frames",
    "Snapshot": None,
    "Case": "cases",
    "Reference": None,
    "ScatteringFactor": None,
    "Alpha": "alpha",
    "PixelSizeNm": None,
    "Defect": "defects",
    "DefectSite": "site_angstrom or column",
    "DefectThicknessNm": "thicknesses_nm",
    "FalseAlarms": "false_alarms",
    "Power": "power",
    "DefectRate": "rate",
    "PatchRadiusAngstrom": "radius_angstrom",
    "AveragedConfigurations": "averaged",
    "Experiments": "experiments",
}

_KINDS: dict[str, type[StemworldsError]] = {
    "value": InvalidValue,
    "file": FileError,
    "format": FormatError,
    "disk": DiskFull,
    "locked": OutputLocked,
    "memory": NotEnoughMemory,
    "internal": InternalError,
}

_ERRNOS: dict[int, type[FileError]] = {
    _errno.ENOENT: FileMissing,
    _errno.ENOTDIR: FileMissing,
    _errno.EEXIST: FileThere,
    _errno.EACCES: FileForbidden,
    _errno.EPERM: FileForbidden,
    _errno.EROFS: FileForbidden,
    _errno.ENOSPC: DiskFull,
}

_ADVICE = {
    "memory": "force=True goes on all the same",
    "internal": "this is a fault of the program: please report it",
}


def _of_library(
    kind: str,
    message: str,
    setting: str | None = None,
    path: str | _os.PathLike[str] | None = None,
    errno: int | None = None,
) -> StemworldsError:
    """Makes the exception for an error of the library. The extension calls this function."""
    family = _KINDS.get(kind, InternalError)
    if kind == "file" and errno is not None:
        family = _ERRNOS.get(errno, FileError)
    keyword = _KEYWORDS.get(setting) if setting else None
    if family is FileThere and setting == "Output":
        keyword = "overwrite"
    if keyword and keyword not in message:
        message = f"{message} (argument {keyword})"
    if kind in _ADVICE:
        message = f"{message}; {_ADVICE[kind]}"
    error = family(message)
    error.keyword, error.setting = keyword, setting
    if isinstance(error, OSError):
        error.errno = errno
        error.filename = None if path is None else _os.fspath(path)
    return error


#: The argument for each key of the request with another name.
_KEYS: dict[str, str] = {
    "energy_kev": "energy_kv",
    "source_lorentz_share": "source_lorentz",
    "sigma_angstrom": "sigma",
    "electrons_per_angstrom2": "dose",
    "keep_stages": "stages",
}


def _of_request(place: str, message: str, wrong_type: bool) -> StemworldsError:
    """Makes the exception for an invalid value at ``place`` of a request. The extension calls this function."""
    tables = {"specimen", "microscope", "numerics", ""}
    words = [word for word in place.split(".") if word not in tables] or [place]
    key = words[0].partition("[")[0]
    keyword = _KEYS.get(key, key)
    family = WrongType if wrong_type else InvalidValue
    error = family(f"{keyword}: {message}")
    error.keyword = keyword
    return error


def _invalid(keyword: str, message: str) -> InvalidValue:
    """Makes the exception for a value that Python code refuses."""
    error = InvalidValue(f"{message} (argument {keyword})")
    error.keyword = keyword
    return error


def _wrong_type(error: TypeError) -> WrongType:
    """Shortens the extension's message about an option of a wrong type."""
    told = str(error)
    keyword = told.rsplit(".", 1)[-1] if "field" in told else told.split("'")[1]
    causes = []
    cause = error.__cause__
    while cause is not None:
        causes.append(str(cause))
        if "field" in str(cause):
            keyword = str(cause).rsplit(".", 1)[-1]
        cause = cause.__cause__
    why = causes[-1].splitlines()[0] if causes else "is of another type than expected"
    wrong = WrongType(f"{keyword}: {why} (argument {keyword})")
    wrong.keyword = keyword
    return wrong
