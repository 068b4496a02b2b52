"""Simulates STEM images of atoms, and worlds: large images of specimens with defects, with the truth about each atom.

Lengths of atoms and probes are in Angstrom, lengths of fields and worlds in nm; names contain the unit. Images are arrays ``[y, x]`` in
fractions of the incident beam. Every error is a :class:`StemworldsError`.

    >>> import stemworlds as sw
    >>> image = sw.simulate("si.cif", zone=(1, 1, 0), repeat=(3, 4, 13))          # doctest: +SKIP
    >>> world = sw.build("srtio3", difficulty="easy", grid=(2, 2), out="w.h5")    # doctest: +SKIP
    >>> world.tile(0, 0), world.columns, world.sites                             # doctest: +SKIP
"""

from typing import Any as _Any

from . import cache, errors
from ._core import __version__
from .atoms import AtomArrays
from .building import BuildOptions, BuildPart, BuildPlan, build, build_part, plan
from .checking import Audit, Comparison, Validation, Verification, audit, compare, validate, validation_cases, verify
from .detecting import (
    Detectability,
    DetectabilityCase,
    DetectabilityOptions,
    DetectorResult,
    NeededDose,
    detectability,
)
from .errors import (
    FileError,
    FormatError,
    InvalidValue,
    NotEnoughMemory,
    StemworldsError,
)
from .exporting import export
from .images import DiffractionPattern, ExitWaves, Image, Images, PlaneWave
from .importing import import_image
from .live import LiveView, LiveWorld
from .patterns import Axes4D, DataCube, simulate_pattern_series, simulate_patterns
from .recipes import Recipe, recipes
from .recording import Recording, acquire
from .simulation import (
    ProbeValues,
    Scan,
    SimulationOptions,
    SimulationPlan,
    diffraction,
    exit_waves,
    plan_simulation,
    plane_wave,
    simulate,
    simulate_probes,
)
from .specimens import specimen, specimen_arrays
from .streaming import Sample, Stream, Targets, stream
from .viewing import view
from .worlds import COLUMN_CLASSES, Table, World, WorldMetadata


__all__ = [
    "COLUMN_CLASSES",
    "AtomArrays",
    "Audit",
    "Axes4D",
    "BuildOptions",
    "BuildPart",
    "BuildPlan",
    "Comparison",
    "DataCube",
    "Detectability",
    "DetectabilityCase",
    "DetectabilityOptions",
    "DetectorResult",
    "DiffractionPattern",
    "ExitWaves",
    "FileError",
    "FormatError",
    "Image",
    "Images",
    "InvalidValue",
    "LiveView",
    "LiveWorld",
    "NeededDose",
    "NotEnoughMemory",
    "PlaneWave",
    "ProbeValues",
    "Recipe",
    "Recording",
    "Sample",
    "Scan",
    "SimulationOptions",
    "SimulationPlan",
    "StemworldsError",
    "Stream",
    "Table",
    "Targets",
    "Validation",
    "Verification",
    "World",
    "WorldMetadata",
    "__version__",
    "acquire",
    "audit",
    "build",
    "build_part",
    "cache",
    "compare",
    "detectability",
    "diffraction",
    "errors",
    "exit_waves",
    "export",
    "import_image",
    "plan",
    "plan_simulation",
    "plane_wave",
    "recipes",
    "simulate",
    "simulate_pattern_series",
    "simulate_patterns",
    "simulate_probes",
    "specimen",
    "specimen_arrays",
    "stream",
    "validate",
    "validation_cases",
    "verify",
    "view",
]


def __getattr__(name: str) -> _Any:
    # PyTorch takes seconds to import, so it is imported at the first use of `stemworlds.torch`.
    if name == "torch":
        import importlib

        return importlib.import_module(".torch", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
