"""Declares the compiled extension module. It is private: the other modules of the package are the interface."""

import os
from collections.abc import Sequence
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt

from ._running import Running

_Path = str | os.PathLike[str]
_Region = tuple[float, float, float, float]
_Rows = tuple[int, int]

__version__: str

class AtomArrays(TypedDict):
    numbers: list[int]
    positions: npt.NDArray[np.float64]
    cell: list[list[float]]
    occupancies: list[float] | None
    displacements: npt.NDArray[np.float64] | None

class SpecimenRequest(TypedDict, total=False):
    zone: tuple[int, ...]
    up: tuple[int, ...]
    max_strain_percent: float
    repeat: tuple[int, ...]
    phonons: int
    sigma_angstrom: float | str | dict[str, float]
    temperature_k: float
    frames: dict[str, int]
    seed: int

class MicroscopeRequest(TypedDict, total=False):
    energy_kev: float
    semiangle_mrad: float
    defocus_angstrom: list[float]
    aberrations: list[dict[str, Any]]
    tilt_mrad: tuple[float, float]
    focal_spread_angstrom: float
    source_size_angstrom: float
    source_lorentz_share: float
    detectors: list[dict[str, Any]]
    allow_empty_angles: bool

class ScanRequest(TypedDict, total=False):
    start: tuple[float, float]
    end: tuple[float, float]
    unit: str
    step_angstrom: float
    points: tuple[int, ...]

class NumericsRequest(TypedDict, total=False):
    engine: str
    accuracy_percent: float
    interpolation: tuple[int, ...]
    window_angstrom: float
    sampling_angstrom: float
    gpts: tuple[int, ...]
    slice_thickness_angstrom: float
    projection: str
    parametrization: str
    band_fraction: float
    band_taper: float
    oversampling: int
    angle_margin: float
    probe_step: str | float
    expansion_percent: str | float
    probe_box: str
    full_exit_grid: bool
    tail_correction: bool

class _SimulationRequest(TypedDict):
    structure: str

class PatternsRequest(TypedDict, total=False):
    """A pixelated detector and its binning."""

    pixels: int
    max_angle_mrad: float
    coherent_tail: bool
    radial_mrad: float
    mtf: float | list[list[float]]

class SimulationRequest(_SimulationRequest, total=False):
    """The options of ``stemgen::simulation::SimulationRequest``. Missing keys take the library's defaults."""

    thicknesses_angstrom: list[float]
    plane_wave: bool
    electrons_per_angstrom2: float
    patterns: PatternsRequest
    specimen: SpecimenRequest
    microscope: MicroscopeRequest
    scan: ScanRequest
    numerics: NumericsRequest

class DefectSource(TypedDict):
    recipe: str | None
    atoms: AtomArrays | None
    name: str

def detectability(
    request: dict[str, Any], source: DefectSource, force: bool, running: Running
) -> tuple[str, list[str], str, str]: ...

class _SharedFacts(TypedDict):
    thicknesses_angstrom: list[float]
    box_angstrom: list[float]
    settings: str
    band_limit_mrad: float

class SimulatedImage(TypedDict):
    name: str
    data: npt.NDArray[np.float32]
    counts: npt.NDArray[np.uint32] | None
    counted_mrad: npt.NDArray[np.float32] | None
    units: str
    defocus_angstrom: float
    annulus_mrad: list[float]
    sector_degrees: list[float] | None

class SimulatedImages(_SharedFacts):
    images: list[SimulatedImage]
    electrons_per_pixel: float | None
    strain_percent: float | None
    step_angstrom: list[float]
    origin_angstrom: list[float]
    accuracy: list[str]

class ProbeValues(_SharedFacts):
    values: list[tuple[str, npt.NDArray[np.float32]]]
    places_angstrom: list[list[float]]

class PlaneWaveImages(TypedDict):
    exit_waves: npt.NDArray[np.complex64]
    images: list[npt.NDArray[np.float32]]
    step_angstrom: list[float]

class DiffractionPattern(TypedDict):
    data: npt.NDArray[np.float32]
    step_mrad: list[float]
    band_limit_mrad: float

class ProbeExitWaves(TypedDict):
    data: list[npt.NDArray[np.complex64]]
    sampling_angstrom: list[float]
    thicknesses_angstrom: list[float]

class RecordingRequest(TypedDict, total=False):
    """The options of ``stemgen::world::RecordingRequest``. Missing keys take the library's defaults."""

    region_nm: tuple[float, float, float, float]
    at_nm: tuple[float, float]
    zoom: float
    pixel_nm: float
    profile: str
    electrons_per_angstrom2: float
    current_pa: float
    dwell_us: float
    frames: int
    keep_frames: bool
    keep_stages: bool
    seed: int
    detectors: list[str]

class RecordingOptions(TypedDict):
    field: FieldOptions
    request: RecordingRequest
    cache: bool | str
    out: str | None
    overwrite: bool

class FieldOptions(TypedDict):
    """A recipe, or a world, whose file contains its recipe."""

    toml: str | None
    world: str | None
    acquisition: list[str]

class BuildOptions(TypedDict):
    toml: str
    out: str
    noise: bool
    keep_clean: bool
    overwrite: bool
    engine: str | None
    profile: str | None
    window_angstrom: float | None
    accuracy_percent: float | None
    expansion_percent: str | float
    interpolation: tuple[int, ...] | None
    audit: int | None
    max_error_percent: float | None
    cache: bool | str
    subtile_nm: float | None
    subtile_overlap_nm: float | None
    png: bool
    force: bool

class AuditOptions(TypedDict):
    field: FieldOptions
    regions: int
    at_nm: Sequence[tuple[float, float]]
    size_nm: float
    stride: int | None
    configurations: int | None
    seed: int
    cache: bool | str
    force: bool

class LiveOptions(TypedDict):
    toml: str
    most_dose: float
    cache: bool | str
    detectors: list[str] | None

class SampleOptions(TypedDict):
    toml: str
    size_px: int
    pixel_nm: tuple[float, float] | None
    angle_rad: tuple[float, float]
    dose: tuple[float, float] | None
    sigma_px: float
    seed: int
    all_detectors: bool
    per_specimen: int | None
    cache: bool | str

class RecipeSource(TypedDict):
    name: str | None
    path: str | None
    text: str | None
    difficulty: str | None

class RecipeChanges(TypedDict):
    set: list[str]
    grid: tuple[int, ...] | None
    seed: int | None
    acquisition: str | None

class ImportOptions(TypedDict):
    path: str
    out: str
    overwrite: bool
    dataset: str | None
    index: int | None
    pixel_nm: float | None
    spacing_nm: float | None
    contrast: tuple[float, float]

class ImageStack(TypedDict):
    name: str
    data: npt.NDArray[np.float32]
    units: str
    step_angstrom: tuple[float, float]
    origin_angstrom: tuple[float, float]
    thicknesses_angstrom: list[float]
    defocus_angstrom: float | None
    annulus_mrad: tuple[float, float] | None
    sector_degrees: tuple[float, float] | None
    electrons_per_pixel: float | None

class HspyOptions(TypedDict):
    energy_kev: float | None
    semiangle_mrad: float | None
    tilt_mrad: tuple[float, float] | None
    defocus_angstrom: float | None
    dose: float | None
    settings: str | None

class ViewOptions(TypedDict):
    world: str
    out: str
    html: bool
    region_nm: _Region | None
    clean: bool
    colormap: str
    contrast: tuple[float, float]
    overlays: list[str]
    size: int
    overwrite: bool

class Scene(TypedDict):
    world: str | None
    toml: str | None
    damage: bool
    split: str
    cache: bool | str

class Rules(TypedDict):
    task: str
    strict: bool
    target: str | None
    budget: float
    horizon: int
    cadence: int
    exposure: str
    noise: str | None
    reward: str
    phase_stride_px: int
    overview: bool

class Moves(TypedDict):
    begin: list[tuple[int, int] | None]
    kinds: npt.NDArray[np.int64] | list[int]
    positions: npt.NDArray[np.float64] | list[tuple[float, float]]
    zooms: npt.NDArray[np.float64] | list[float]
    doses: npt.NDArray[np.float64] | list[float]
    reports: list[str | None]

class Episodes:
    def __new__(cls, scene: Scene, rules: Rules, count: int, running: Running) -> Episodes: ...
    def facts(self) -> str: ...
    def step(self, moves: Moves, running: Running) -> dict[str, Any]: ...
    def record(self, slot: int, running: Running) -> str: ...
    def score(self, slot: int, running: Running) -> float: ...
    def truth_seen(self, slot: int, running: Running) -> str: ...
    def overview(self, slot: int, size: int, running: Running) -> npt.NDArray[np.float32]: ...

class LiveField:
    def __new__(cls, options: LiveOptions, running: Running) -> LiveField: ...
    def look(self, region: _Region, running: Running) -> dict[str, Any]: ...
    def acquire(self, asked: RecordingRequest, running: Running) -> dict[str, Any]: ...
    def acquire_patterns(self, asked: RecordingRequest, detector: PatternsRequest, running: Running) -> list[Patterns]: ...
    def truth(self, region: _Region) -> dict[str, Any]: ...
    def dose(self, region: _Region) -> float: ...
    def history(self) -> str: ...
    def snapshot(self) -> str: ...
    def restore(self, snapshot: str) -> None: ...
    def recipe(self) -> str: ...

class TileSource:
    def __new__(cls, options: SampleOptions, running: Running) -> TileSource: ...
    def prepare(self, index: int, running: Running) -> None: ...
    def samples(self, indices: Sequence[int], running: Running) -> list[dict[str, Any]]: ...

class WorldReader:
    def __new__(cls, path: _Path) -> WorldReader: ...
    def close(self) -> None: ...
    def metadata(self) -> str: ...
    def tile(self, row: int, column: int, clean: bool, detector: str | None) -> npt.NDArray[np.float32]: ...
    def image(self, rows: _Rows, columns: _Rows, clean: bool, detector: str | None) -> npt.NDArray[np.float32]: ...
    def scaling(self, detector: str | None) -> list[float] | None: ...
    def overview(self, detector: str | None) -> npt.NDArray[np.float32]: ...
    def phase_map(self, rows: _Rows, columns: _Rows) -> npt.NDArray[np.int32] | None: ...
    def columns(self) -> dict[str, Any]: ...
    def sites(self) -> dict[str, Any]: ...
    def particles(self) -> dict[str, Any]: ...
    def boundaries(self) -> list[tuple[str, npt.NDArray[np.float32]]]: ...
    def layers(self) -> list[tuple[str, list[float], list[float], float]]: ...
    def dislocations(self) -> list[tuple[list[float], list[float]]]: ...
    def png(self) -> bytes: ...

def dose_checkpoints(records: Sequence[tuple[float, float]], checkpoints: int) -> list[float]: ...
def dose_metrics(records: Sequence[tuple[float, float]], checkpoints: int) -> str: ...
def build_part(options: BuildOptions, shard: tuple[int, int], running: Running) -> str: ...
def build_world(options: BuildOptions, running: Running) -> str: ...
def plan_build(options: BuildOptions, running: Running) -> str: ...
def audit_field(options: AuditOptions, running: Running) -> str: ...
def cache_clear(material: str | None) -> list[tuple[str, int, int]]: ...
def cache_export(out: _Path, material: str | None, overwrite: bool, running: Running) -> str: ...
def cache_import(path: _Path, running: Running) -> str: ...
def cache_fill(toml: str, shard: tuple[int, int], supplied: bool, running: Running) -> tuple[int, int, int] | None: ...
def cache_verify(
    material: str | None, again: tuple[str, int, int] | None, running: Running
) -> tuple[int, int, list[tuple[str, str]], list[tuple[str, float, bool]]]: ...
def cache_folder() -> str | None: ...
def library_folder() -> str | None: ...
def library_list() -> list[tuple[str, int, int]]: ...
def set_library(folder: _Path) -> None: ...
def cache_list() -> list[tuple[str, int, int]]: ...
def compare_worlds(
    paths: Sequence[_Path], alpha: float, out: _Path | None, overwrite: bool, running: Running
) -> str: ...
def verify_world(path: _Path, running: Running) -> str: ...
def validate_suite(
    cases: Sequence[str], quick: bool, out: _Path | None, overwrite: bool, running: Running
) -> str: ...
def validation_cases() -> list[tuple[str, str, bool, float]]: ...
def import_image(options: ImportOptions, running: Running) -> str: ...
def check_file(path: _Path, again: Sequence[str]) -> None: ...
def main(arguments: Sequence[str], again: Sequence[str]) -> int: ...
def settings() -> list[str]: ...
def save_hspy(path: _Path, images: Sequence[ImageStack], about: HspyOptions, overwrite: bool) -> None: ...
def save_tiff(path: _Path, images: Sequence[ImageStack], bits: int, overwrite: bool) -> None: ...
def describe_recipe(toml: str) -> str: ...
def recipes() -> list[tuple[str, list[str]]]: ...
def resolve_recipe(source: RecipeSource, changes: RecipeChanges) -> str: ...
def record_field(options: RecordingOptions, running: Running) -> dict[str, Any]: ...
def diffraction(
    request: SimulationRequest,
    atoms: AtomArrays | None,
    position_angstrom: tuple[float, float],
    force: bool,
    running: Running,
) -> DiffractionPattern: ...
def exit_waves(
    request: SimulationRequest,
    atoms: AtomArrays | None,
    positions_angstrom: list[tuple[float, float]],
    force: bool,
    running: Running,
) -> ProbeExitWaves: ...
def plan_simulation(request: SimulationRequest, atoms: AtomArrays | None, running: Running) -> str: ...
def simulate(
    request: SimulationRequest, atoms: AtomArrays | None, force: bool, running: Running
) -> SimulatedImages: ...
def simulate_places(
    request: SimulationRequest,
    atoms: AtomArrays | None,
    places: list[tuple[float, float]],
    unit: str,
    force: bool,
    running: Running,
) -> ProbeValues: ...
def simulate_plane_wave(
    request: SimulationRequest, atoms: AtomArrays | None, force: bool, running: Running
) -> PlaneWaveImages: ...
class PatternHeader(TypedDict):
    shape: tuple[int, int, int, int]
    step_angstrom: list[float]
    origin_angstrom: list[float]
    max_angle_mrad: float
    thickness_angstrom: float
    defocus_angstrom: float
    energy_kev: float
    semiangle_mrad: float
    wavelength_angstrom: float
    electrons_per_pattern: float | None
    ring_mrad: float | None
    vacuum: npt.NDArray[np.float32] | None

class Patterns(PatternHeader):
    data: npt.NDArray[Any]

class PatternReader:
    """A file of patterns, read row by row."""

    def __init__(self, path: _Path) -> None: ...
    def header(self) -> PatternHeader: ...
    def rows(self, first: int, end: int) -> npt.NDArray[np.float32]: ...
    def page(self, title: str, out: _Path, overwrite: bool, running: Running) -> None: ...

class CubeAxes(TypedDict):
    title: str
    step_angstrom: tuple[float, float]
    origin_angstrom: tuple[float, float]
    max_angle_mrad: float
    thickness_angstrom: float
    defocus_angstrom: float
    energy_kev: float
    semiangle_mrad: float
    wavelength_angstrom: float
    electrons_per_pattern: float | None

def write_pattern_page(
    data: npt.NDArray[np.float32], axes: CubeAxes, out: _Path, overwrite: bool, running: Running
) -> None: ...
def simulate_patterns(
    request: SimulationRequest, atoms: AtomArrays | None, force: bool, running: Running
) -> list[Patterns]: ...
def write_patterns(
    request: SimulationRequest,
    atoms: AtomArrays | None,
    out: _Path,
    overwrite: bool,
    force: bool,
    running: Running,
) -> list[_Path]: ...
def integrated_centre_of_mass(
    x: npt.NDArray[np.float32],
    y: npt.NDArray[np.float32],
    step_angstrom: tuple[float, float],
    wavelength_angstrom: float,
) -> npt.NDArray[np.float32]: ...
def detector_weights(
    detector: tuple[int, float, float | None],
    annulus_mrad: tuple[float, float],
    sector_degrees: tuple[float, float] | None,
    centre_mrad: tuple[float, float],
) -> npt.NDArray[np.float32]: ...
def draw_recipe(toml: str, out: _Path, running: Running) -> None: ...
def specimen_sites(
    toml: str, region_nm: tuple[float, float, float, float] | None, running: Running
) -> dict[str, Any]: ...
def png(
    image: npt.NDArray[np.float32], step_angstrom: tuple[float, float], scale_bar: bool, grey_bar: bool
) -> bytes: ...
def view_world(options: ViewOptions, running: Running) -> None: ...
def write_file(path: _Path, bytes: bytes, overwrite: bool) -> None: ...
