"""Simulates images, exit waves and diffraction patterns of atoms."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from . import _core
from ._running import Progress, call, running
from .atoms import Atoms, atoms_source
from .errors import _invalid
from .images import DiffractionPattern, ExitWaves, Image, Images, PlaneWave

Engine = Literal["multislice", "prism", "window"]
Sigma = float | Mapping[str, float] | Literal["from-file", "table"]
Detectors = Mapping[
    str, tuple[float, float] | tuple[float, float, int] | tuple[float, float, int, float] | tuple[float, float, Literal["com"]]
]
Aberrations = Mapping[str, float | tuple[float, float]]


@dataclass(frozen=True)
class Scan:
    """Probe positions: a raster over a part of the simulated box.

    Attributes:
        start: first probe ``(x, y)``.
        end: end of the scan ``(x, y)``, excluded; ``None`` for the edges of the box.
        unit: unit of ``start`` and ``end``: ``"cell"`` (fractions of the box, after ``zone`` and ``repeat``), ``"nm"`` or ``"angstrom"``.
        step_angstrom: distance of probes, reduced so that it divides the scan; by default the Nyquist limit of the image, wavelength / (4
            semiangle).
        points: number of probes along ``(x, y)``, instead of ``step_angstrom``.
    """

    start: tuple[float, float] = (0.0, 0.0)
    end: tuple[float, float] | None = None
    unit: Literal["cell", "nm", "angstrom"] = "cell"
    step_angstrom: float | None = None
    points: tuple[int, int] | None = None

    def _request(self) -> _core.ScanRequest:
        request: _core.ScanRequest = {"start": _pair("scan", self.start), "unit": self.unit}
        if self.end is not None:
            request["end"] = _pair("scan", self.end)
        if self.step_angstrom is not None:
            request["step_angstrom"] = self.step_angstrom
        if self.points is not None:
            request["points"] = _counts("scan", self.points, 2)
        return request


class SimulationOptions(TypedDict, total=False):
    """Options of :func:`simulate`, :func:`plan_simulation`, :func:`plane_wave` and :func:`diffraction`.

    Specimen:
        zone: lattice direction along the beam. The simulation then uses an orthogonal box. Four indices are for hexagonal lattices.
        up: lattice direction along +y, perpendicular to the zone.
        max_strain_percent: greatest strain that makes an orthogonal box from a cell with angles near 90 degrees. A warning and
            ``metadata["strain_percent"]`` report the applied strain.
        repeat: number of repetitions of the cell (after ``zone``) along x, y and the beam.
        phonons: number of frozen-phonon configurations to average; needs ``sigma``. Default: no displacements.
        sigma: standard deviation of each Cartesian component of the thermal displacement in A: one value for all atoms; one for each
            element; ``"from-file"``, from U or B of a CIF, anisotropic where it gives them; or ``"table"``, the values of elemental
            crystals (Peng et al. 1996).
        displacements: mean square displacements of each atom in A², ``[atom, 3, 3]``, along x, y and z as the positions; instead of
            ``sigma``, for atoms in memory.
        temperature_k: temperature of ``sigma="table"`` in K, 200 to 400; 293 by default.
        frames: frames of a trajectory (extended XYZ, XDATCAR) to average, ``range(10, 200, 5)``.
        seed: seed of thermal displacements, mixed sites and counted electrons. Default 1.

    Microscope:
        energy_kv: accelerating voltage in kV. Default 200.
        semiangle_mrad: convergence semiangle; the objective aperture of a plane wave. Default 21.
        defocus_angstrom: defocus relative to the entrance surface; underfocus is positive. Several values give a series. Default 0.
        aberrations: coefficients in A, ``{"C30": 1e5, "C12": (30, 0.3)}``. The second number of a pair is the azimuth in rad.
        tilt_mrad: mistilt of the specimen ``(x, y)``, up to 20 mrad.
        focal_spread_angstrom: standard deviation of the focus.
        source_size_angstrom: full width at half maximum of the electron source; by default a point source.
        source_lorentz: share of the source's intensity in a Lorentzian with long tails, 0 to 1.
        detectors: inner and outer angle in mrad by name. Default ``{"HAADF": (68, 200)}``. A third number divides the annulus into
            that many equal sectors, a fourth is the azimuth in degrees at which the first begins, from +x towards +y:
            ``{"DPC": (0, 21, 4, 45)}`` gives the images ``DPC_0`` to ``DPC_3``. ``{"COM": (0, 50, "com")}`` gives ``COM_x`` and
            ``COM_y``, the mean angle of the counted electrons in mrad (centre of mass).
        allow_empty_angles: continue if a detector extends beyond the band limit of the grid.

    Results:
        scan: probe positions; the whole box by default.
        thicknesses_angstrom: thicknesses at which images are recorded, rounded to slice boundaries; by default the whole thickness.
        dose: electrons per square Angstrom. With a dose, electrons are counted.

    Numerics:
        engine: ``"multislice"`` (exact), ``"prism"`` (exact with interpolation 1), ``"window"``; by default the fastest engine with the
            accuracy ``accuracy_percent``, for a laterally infinite specimen (``probe_box="large"``).
        accuracy_percent: use the narrowest window whose rms error, in per cent of the mean image, is at most this, or the exact engine. 0.5
            if neither this nor an engine is given.
        interpolation: interpolation of PRISM, one number, or one for x and one for y.
        window_angstrom: width of the window that follows each probe. Default 11.7.
        sampling_angstrom, gpts: greatest pixel of the grid, or number of grid points along ``(x, y)``. By default the band limit is the
            outermost detector angle times ``angle_margin`` (1.2).
        slice_thickness_angstrom: greatest thickness of slices, which then have equal thickness; by default one slice for each atomic plane.
        projection: ``"infinite"`` (default) or ``"finite"``.
        parametrization: ``"lobato"`` (default), ``"kirkland"``, ``"peng"``.
        band_fraction, band_taper, oversampling, probe_step, expansion_percent, probe_box, full_exit_grid, tail_correction: see ``stemgen
            simulate --help``.
        force: continue if the simulation needs more memory than is free.

    Running:
        threads: number of threads; all processors by default. The result does not depend on it.
        progress: ``True`` for a bar (by tqdm, if installed), or a function of (stage, unit, done, total).
    """

    zone: tuple[int, int, int] | tuple[int, int, int, int] | None
    up: tuple[int, int, int] | tuple[int, int, int, int] | None
    max_strain_percent: float | None
    repeat: tuple[int, int, int] | None
    phonons: int | None
    sigma: Sigma | None
    displacements: npt.ArrayLike | None
    temperature_k: float | None
    frames: range | None
    seed: int
    energy_kv: float
    semiangle_mrad: float
    defocus_angstrom: float | Sequence[float]
    aberrations: Aberrations
    tilt_mrad: tuple[float, float]
    focal_spread_angstrom: float
    source_size_angstrom: float | None
    source_lorentz: float
    detectors: Detectors
    allow_empty_angles: bool
    scan: Scan | None
    thicknesses_angstrom: Sequence[float]
    dose: float | None
    engine: Engine | None
    accuracy_percent: float | None
    interpolation: int | tuple[int, int] | None
    window_angstrom: float | None
    sampling_angstrom: float | None
    gpts: tuple[int, int] | None
    slice_thickness_angstrom: float | None
    projection: Literal["infinite", "finite"]
    parametrization: Literal["lobato", "kirkland", "peng"]
    band_fraction: float | None
    band_taper: float
    oversampling: int | None
    angle_margin: float
    probe_step: Literal["auto", "scan"] | float
    expansion_percent: Literal["auto", "off"] | float
    probe_box: Literal["cell", "large"] | None
    full_exit_grid: bool
    tail_correction: bool
    force: bool
    threads: int | None
    progress: Progress


@dataclass(frozen=True)
class SimulationPlan:
    """Size, memory and time of a simulation, before it begins.

    Attributes:
        atoms: number of atoms.
        box_angstrom: edges of the box ``(x, y, z)``.
        scan_shape: pixels of the image along ``(y, x)``. The attribute ``probes`` is the number of propagated probes.
        band_limit_mrad: greatest scattering angle of the grid.
        memory_bytes: estimated memory.
        time_range_s: least and greatest estimated time, from a short measurement.
        warnings: warnings about the simulation.
        details: all values, as in ``stemgen simulate --dry-run --json``.
    """

    atoms: int
    box_angstrom: tuple[float, float, float]
    scan_shape: tuple[int, int]
    probes: int
    slices: int
    configurations: int
    band_limit_mrad: float
    memory_bytes: int
    time_range_s: tuple[float, float]
    warnings: tuple[str, ...]
    details: Mapping[str, Any]


def simulate(atoms: Atoms, **options: Unpack[SimulationOptions]) -> Images:
    """Simulates STEM images of atoms.

    Args:
        atoms: ``ase.Atoms``, :class:`AtomArrays`, or the path of a CIF, extended XYZ or POSCAR file. Lengths are in Angstrom; the
            beam runs along +z.
        **options: see :class:`SimulationOptions`.

    Returns:
        One :class:`Image` for each detector, ``[y, x]`` in fractions of the incident beam (a centre of mass has two, in mrad);
        ``[thickness, y, x]`` for several thicknesses. A
        defocus series has one image for each value: ``"HAADF_defocus_20A"``; files contain the series as one stack. If there is one image
        only, the result can be used as this image.

    Raises:
        InvalidValue: for an option out of its limits.
        FormatError, FileError: if the file cannot be read.
        NotEnoughMemory: if the simulation needs more memory than is free, unless ``force`` is set.
        KeyboardInterrupt: after Ctrl-C.
    """
    found = call(_core.simulate, *_request(atoms, options), options.get("force", False), _run(options))
    (dx, dy), (x, y) = found["step_angstrom"], found["origin_angstrom"]
    metadata = {
        "settings": json.loads(found["settings"]),
        "box_angstrom": tuple(found["box_angstrom"]),
        "band_limit_mrad": found["band_limit_mrad"],
        "accuracy": [json.loads(text) for text in found["accuracy"]],
        "strain_percent": found["strain_percent"],
    }
    thicknesses = tuple(found["thicknesses_angstrom"])
    images = {}
    for item in found["images"]:
        data, counts, counted_mrad = item["data"], item["counts"], item["counted_mrad"]
        if len(thicknesses) == 1:
            data, counts = data[0], None if counts is None else counts[0]
            counted_mrad = None if counted_mrad is None else counted_mrad[0]
        more: dict[str, Any] = {"defocus_angstrom": item["defocus_angstrom"], "annulus_mrad": tuple(item["annulus_mrad"])}
        if item["sector_degrees"] is not None:
            more["sector_degrees"] = tuple(item["sector_degrees"])
        images[item["name"]] = Image(
            name=item["name"],
            array=data,
            sampling_nm=(dy / 10, dx / 10),
            origin_nm=(y / 10, x / 10),
            thicknesses_angstrom=thicknesses,
            units=item["units"],
            counts=counts,
            counted_mrad=counted_mrad,
            electrons_per_pixel=found["electrons_per_pixel"],
            metadata={**metadata, **more},
        )
    return Images(images, metadata=metadata)


@dataclass(frozen=True, eq=False)
class ProbeValues(Mapping[str, npt.NDArray[np.float32]]):
    """Detector values of single probes: ``values["HAADF"]``, by name of the detector, in fractions of the incident beam (a centre of mass
    in mrad).

    Attributes:
        values_of: float32 [probe], or [thickness, probe] for several thicknesses, by name of the detector.
        positions_angstrom: places of the probes, float64 [probe, (x, y)].
        thicknesses_angstrom: thicknesses at which the values are recorded.
        metadata: parameters of the simulation.
    """

    values_of: Mapping[str, npt.NDArray[np.float32]]
    positions_angstrom: npt.NDArray[np.float64]
    thicknesses_angstrom: tuple[float, ...]
    metadata: Mapping[str, Any]

    def __getitem__(self, name: str) -> npt.NDArray[np.float32]:
        return self.values_of[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.values_of)

    def __len__(self) -> int:
        return len(self.values_of)


def simulate_probes(
    atoms: Atoms,
    positions: npt.ArrayLike,
    *,
    unit: Literal["cell", "nm", "angstrom"] = "angstrom",
    **options: Unpack[SimulationOptions],
) -> ProbeValues:
    """Simulates single probes at given places, for example at atomic columns, along a line, or at the places of a scan with errors.

    Each probe is propagated separately, so :func:`simulate` is faster for a raster. With ``engine="window"`` each probe has its own window.

    Args:
        atoms: see :func:`simulate`.
        positions: ``(x, y)`` of each probe, of shape (N, 2). The box is periodic.
        unit: unit of the positions: ``"angstrom"``, ``"nm"``, or ``"cell"``, fractions of the box after ``zone`` and ``repeat``.
        **options: see :class:`SimulationOptions`. ``scan``, ``dose``, ``source_size_angstrom`` and ``accuracy_percent`` need a raster, and
            PRISM has no single probes.

    Returns:
        Values by name of the detector; for a defocus series with the name ``"HAADF_defocus_20A"``.

    Raises:
        InvalidValue: for positions that are no pairs of finite numbers, and for options out of their limits.
        FormatError, FileError, NotEnoughMemory, KeyboardInterrupt: see :func:`simulate`.
    """
    unused = {"scan", "source_size_angstrom", "dose", "accuracy_percent"} & options.keys()
    if unused:
        name = sorted(unused)[0]
        raise _invalid(name, f"{name} needs a raster of probes: simulate() has one")
    pairs = _places(positions)
    request, arrays = _request(atoms, options)
    found = call(_core.simulate_places, request, arrays, pairs, unit, options.get("force", False), _run(options))
    thicknesses = tuple(found["thicknesses_angstrom"])
    return ProbeValues(
        values_of={name: data[0] if len(thicknesses) == 1 else data for name, data in found["values"]},
        positions_angstrom=np.array(found["places_angstrom"]),
        thicknesses_angstrom=thicknesses,
        metadata={
            "settings": json.loads(found["settings"]),
            "box_angstrom": tuple(found["box_angstrom"]),
            "band_limit_mrad": found["band_limit_mrad"],
        },
    )


def plan_simulation(atoms: Atoms, **options: Unpack[SimulationOptions]) -> SimulationPlan:
    """Estimates size, memory and time of :func:`simulate` with these arguments, from a short measurement."""
    report = json.loads(call(_core.plan_simulation, *_request(atoms, options), _run(options)))
    x, y, z = report["box_angstrom"]
    rows, columns = report["scan_shape"]
    least, most = report["estimated_range_s"]
    return SimulationPlan(
        atoms=report["atoms"],
        box_angstrom=(x, y, z),
        scan_shape=(rows, columns),
        probes=report["probes"],
        slices=report["slices"]["count"],
        configurations=report["configurations"],
        band_limit_mrad=report["band_limit_mrad"],
        memory_bytes=report["memory_bytes"],
        time_range_s=(least, most),
        warnings=tuple(report["warnings"]),
        details=report,
    )


def plane_wave(atoms: Atoms, **options: Unpack[SimulationOptions]) -> PlaneWave:
    """Propagates a plane wave through atoms, and images it with the objective lens (conventional TEM).

    Args:
        atoms: see :func:`simulate`.
        **options: see :class:`SimulationOptions`. ``scan``, ``detectors``, ``source_size_angstrom``, ``dose`` and ``accuracy_percent`` are
            refused.

    Returns:
        Exit waves ``[configuration, y, x]``, and an image ``[y, x]`` for each defocus.
    """
    unused = {"scan", "detectors", "source_size_angstrom", "dose", "accuracy_percent"} & options.keys()
    if unused:
        name = sorted(unused)[0]
        raise _invalid(name, f"{name} is for scanned images; a plane wave has no such thing")
    request, arrays = _request(atoms, options)
    request["plane_wave"] = True
    found = call(_core.simulate_plane_wave, request, arrays, options.get("force", False), _run(options))
    dx, dy = found["step_angstrom"]
    sampling = (dy / 10, dx / 10)
    images = (
        Image("lens", array, sampling, units="intensity; that of the incident wave is 1", metadata={"defocus_angstrom": defocus})
        for array, defocus in zip(found["images"], _defoci(options.get("defocus_angstrom", 0.0)), strict=True)
    )
    return PlaneWave(exit_waves=found["exit_waves"], images=tuple(images), sampling_nm=sampling)


def diffraction(
    atoms: Atoms, position_angstrom: tuple[float, float], **options: Unpack[SimulationOptions]
) -> DiffractionPattern:
    """Simulates the diffraction pattern of one probe by multislice or in a window, averaged over phonon configurations.

    Args:
        atoms: see :func:`simulate`.
        position_angstrom: place of the probe, ``(x, y)``.
        **options: see :class:`SimulationOptions`. The outermost detector angle determines the band limit of the grid.
    """
    request, arrays = _request(atoms, options)
    place = _pair("position_angstrom", position_angstrom)
    found = call(_core.diffraction, request, arrays, place, options.get("force", False), _run(options))
    dx, dy = found["step_mrad"]
    return DiffractionPattern(
        array=np.fft.fftshift(found["data"]),
        sampling_mrad=(dy, dx),
        band_limit_mrad=found["band_limit_mrad"],
    )


def exit_waves(atoms: Atoms, positions_angstrom: npt.ArrayLike, **options: Unpack[SimulationOptions]) -> ExitWaves:
    """Simulates the waves of probes behind the specimen by multislice on the full grid.

    Args:
        atoms: see :func:`simulate`.
        positions_angstrom: ``(x, y)`` of each probe, of shape (N, 2). The box is periodic.
        **options: see :class:`SimulationOptions`. The outermost detector angle determines the band limit of the grid. ``scan``,
            ``source_size_angstrom``, ``dose``, ``accuracy_percent`` and ``focal_spread_angstrom`` are refused.

    Returns:
        Waves ``[defocus, configuration, probe, thickness, y, x]``.

    Raises:
        InvalidValue, FormatError, FileError, NotEnoughMemory, KeyboardInterrupt: see :func:`simulate_probes`.
    """
    unused = {"scan", "source_size_angstrom", "dose", "accuracy_percent"} & options.keys()
    if unused:
        name = sorted(unused)[0]
        raise _invalid(name, f"{name} is for scanned images; waves of single probes have no such thing")
    pairs = _places(positions_angstrom)
    request, arrays = _request(atoms, options)
    found = call(_core.exit_waves, request, arrays, pairs, options.get("force", False), _run(options))
    dx, dy = found["sampling_angstrom"]
    return ExitWaves(
        array=np.stack(found["data"]),
        sampling_nm=(dy / 10, dx / 10),
        positions_angstrom=np.array(pairs),
        thicknesses_angstrom=tuple(found["thicknesses_angstrom"]),
        defocus_angstrom=tuple(_defoci(options.get("defocus_angstrom", 0.0))),
    )


def _places(positions: npt.ArrayLike) -> list[tuple[float, float]]:
    """Returns places of probes, or raises for what are no pairs of finite numbers."""
    try:
        places = np.asarray(positions, dtype=np.float64)
    except (TypeError, ValueError):
        places = np.empty(0)
    if places.ndim != 2 or places.shape[1] != 2 or len(places) == 0:
        raise _invalid("positions", f"positions of shape {np.shape(places)}: expected (N, 2), x and y of one probe or more")
    if not np.isfinite(places).all():
        raise _invalid("positions", f"positions: {places[~np.isfinite(places).all(axis=1)][0]} are no finite numbers")
    return [(float(x), float(y)) for x, y in places]


def _run(options: SimulationOptions) -> Any:
    return running(options.get("threads"), options.get("progress"))


#: Options that are copied to the request unchanged: table and key.
_AS_GIVEN: dict[str, tuple[str, str]] = {
    **{key: ("specimen", key) for key in ("max_strain_percent", "temperature_k")},
    **{
        key: ("microscope", key)
        for key in ("semiangle_mrad", "focal_spread_angstrom", "source_size_angstrom", "allow_empty_angles")
    },
    "energy_kv": ("microscope", "energy_kev"),
    "source_lorentz": ("microscope", "source_lorentz_share"),
    **{
        key: ("numerics", key)
        for key in (
            "engine",
            "accuracy_percent",
            "window_angstrom",
            "sampling_angstrom",
            "slice_thickness_angstrom",
            "projection",
            "parametrization",
            "band_fraction",
            "band_taper",
            "oversampling",
            "angle_margin",
            "probe_step",
            "expansion_percent",
            "probe_box",
            "full_exit_grid",
            "tail_correction",
        )
    },
}


_NULLABLE = {key for key, kind in SimulationOptions.__annotations__.items() if "None" in str(kind)}


def _request(atoms: Atoms, options: SimulationOptions) -> tuple[_core.SimulationRequest, _core.AtomArrays | None]:
    """Returns the given options as a request of the library, which contains the defaults, and the atoms if they are in memory."""
    unknown = options.keys() - SimulationOptions.__annotations__.keys()
    if unknown:
        raise TypeError(f"unexpected keyword argument {sorted(unknown)[0]!r}")
    displacements = options.get("displacements")
    source = atoms_source(atoms, displacements)
    # None is the default of options with None in their type. For other options the library reports it as an error.
    given: dict[str, Any] = {key: value for key, value in options.items() if value is not None or key not in _NULLABLE}
    request: Any = {"structure": source if isinstance(source, str) else "", **_tables(given)}
    if displacements is not None:
        if "sigma" in given:
            raise _invalid("displacements", "displacements and sigma exclude each other")
        request["specimen"]["sigma_angstrom"] = "from-file"
    if "scan" in given:
        request["scan"] = given["scan"]._request()
    if "thicknesses_angstrom" in given:
        request["thicknesses_angstrom"] = [float(t) for t in given["thicknesses_angstrom"]]
    if "dose" in given:
        request["electrons_per_angstrom2"] = given["dose"]
    return request, None if isinstance(source, str) else source


def _tables(given: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Returns the tables of a request with the given options."""
    tables: dict[str, dict[str, Any]] = {"specimen": {}, "microscope": {}, "numerics": {}}
    for keyword, value in given.items():
        if value is None and keyword in _NULLABLE:
            continue
        if keyword in _AS_GIVEN:
            table, key = _AS_GIVEN[keyword]
            tables[table][key] = value
        elif keyword in _READERS:
            table, key, read = _READERS[keyword]
            tables[table][key] = read(value)
    return tables


def _frames(frames: Any) -> dict[str, int]:
    if not isinstance(frames, range) or frames.start < 0 or frames.step < 1:
        raise _invalid("frames", f"frames = {frames!r}: expected range(start, end, step)")
    if not frames:
        raise _invalid("frames", f"frames = {frames!r}: holds no frame")
    return {"start": frames.start, "end": frames[-1], "step": frames.step}


def _sigma(sigma: Any) -> Any:
    if isinstance(sigma, Mapping):
        return {str(symbol): float(value) for symbol, value in sigma.items()}
    return sigma if isinstance(sigma, str) else float(sigma)


def _detectors(detectors: Any) -> list[dict[str, Any]]:
    listed = []
    for name, angles in detectors.items():
        sectors = list(angles)[2:] if isinstance(angles, (tuple, list)) and len(angles) < 5 else []
        inner, outer = _pair("detectors", angles[:2] if sectors else angles)
        whole = {"name": name, "inner_mrad": inner, "outer_mrad": outer}
        if sectors == ["com"]:
            listed.append({**whole, "centre_of_mass": "images"})
            continue
        if not sectors:
            listed.append(whole)
            continue
        count = _whole("detectors", sectors[0], 2, 360)
        first = float(sectors[1]) if len(sectors) > 1 else 0.0
        for n in range(count):
            edges = [first + 360.0 * n / count, first + 360.0 * (n + 1) / count]
            listed.append({**whole, "name": f"{name}_{n}", "sector_degrees": edges})
    return listed


def _interpolation(factors: Any) -> tuple[int, ...]:
    return _counts("interpolation", (factors, factors) if isinstance(factors, int) else factors, 2)


def _aberrations(aberrations: Any) -> list[dict[str, Any]]:
    """Converts coefficients with names, for example C12: order 1, symmetry 2."""
    listed = []
    for name, value in aberrations.items():
        magnitude, azimuth = value if isinstance(value, (tuple, list)) else (value, 0.0)
        if not re.fullmatch("C[0-9]{2}", str(name)):
            raise _invalid("aberrations", f"aberrations has {name!r}: expected names such as C12 or C30")
        listed.append(
            {
                "order": int(name[1]),
                "symmetry": int(name[2]),
                "magnitude_angstrom": float(magnitude),
                "azimuth_rad": float(azimuth),
            }
        )
    return listed


#: Options that are converted for the request: table, key, converter.
_READERS: dict[str, tuple[str, str, Callable[[Any], Any]]] = {
    "zone": ("specimen", "zone", lambda value: _directions("zone", value)),
    "up": ("specimen", "up", lambda value: _directions("up", value)),
    "repeat": ("specimen", "repeat", lambda value: _counts("repeat", value, 3)),
    "phonons": ("specimen", "phonons", lambda value: _whole("phonons", value, 0, 2**32 - 1)),
    "sigma": ("specimen", "sigma_angstrom", _sigma),
    "frames": ("specimen", "frames", _frames),
    "seed": ("specimen", "seed", lambda value: _whole("seed", value, 0, 2**64 - 1)),
    "defocus_angstrom": ("microscope", "defocus_angstrom", lambda value: _defoci(value)),
    "aberrations": ("microscope", "aberrations", _aberrations),
    "tilt_mrad": ("microscope", "tilt_mrad", lambda value: _pair("tilt_mrad", value)),
    "detectors": ("microscope", "detectors", _detectors),
    "interpolation": ("numerics", "interpolation", _interpolation),
    "gpts": ("numerics", "gpts", lambda value: _counts("gpts", value, 2)),
}


#: Options that the tables of a request hold.
_KEYS_OF_REQUEST = _AS_GIVEN.keys() | _READERS.keys()


def _defoci(defocus: Any) -> list[float]:
    return [float(d) for d in defocus] if isinstance(defocus, (Sequence, np.ndarray)) else [float(defocus)]


def _pair(keyword: str, values: Any) -> tuple[float, float]:
    try:
        first, second = (float(value) for value in values)
    except (TypeError, ValueError):
        raise _invalid(keyword, f"{values!r}: expected two numbers") from None
    return first, second


def _counts(keyword: str, values: Any, length: int) -> tuple[int, ...]:
    try:
        counts = tuple(values)
    except TypeError:
        counts = ()
    if len(counts) != length:
        raise _invalid(keyword, f"{keyword} = {values!r}: expected {length} whole numbers")
    return tuple(_whole(keyword, count, 1, 2**32 - 1) for count in counts)


def _directions(keyword: str, values: Any) -> tuple[int, ...] | None:
    if values is None:
        return None
    found = tuple(values) if isinstance(values, (Sequence, np.ndarray)) else ()
    if len(found) not in (3, 4) or isinstance(values, str):
        raise _invalid(keyword, f"{keyword} = {values!r}: expected three whole numbers, such as (1, 1, 0)")
    indices = tuple(_whole(keyword, value, -1000, 1000) for value in found)
    if len(indices) == 3:
        return indices
    u, v, t, w = indices
    three = (2 * u + v, u + 2 * v, w)
    if u + v + t != 0 or not any(three):
        raise _invalid(keyword, f"{keyword} = {values!r}: the first three of four indices (hexagonal lattices) must add to 0")
    divisor = math.gcd(*three)
    return tuple(index // divisor for index in three)


def _whole(keyword: str, value: Any, low: int, high: int) -> int:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)) or not low <= value <= high:
        raise _invalid(keyword, f"{keyword} = {value!r}: expected a whole number from {low} to {high}")
    return int(value)
