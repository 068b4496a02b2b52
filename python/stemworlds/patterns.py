"""Simulates and reads the diffraction patterns of every probe of a scan (4D-STEM)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path as _FilePath
from typing import Any, Unpack, cast

import numpy as np
import numpy.typing as npt

from . import _core
from ._running import call, running
from .atoms import Atoms
from .errors import _invalid
from .images import Float32Array, Image, Path
from .simulation import SimulationOptions, _request, _run

#: Greatest number of bytes, about, of the rows that are read from a file at once.
_TOGETHER_BYTES = 64 << 20


@dataclass(frozen=True)
class Axes4D:
    """Axes and parameters of the patterns of a scan.

    Attributes:
        shape: number of probes along ``(y, x)``, and of pixels along ``(ky, kx)``.
        step_angstrom: distance of neighbouring probes along ``(y, x)``.
        origin_angstrom: place of the first probe ``(y, x)``.
        max_angle_mrad: half of the width of the detector, or the outer angle of the last ring. The centre of pixel ``n // 2`` of each axis
            is on the optical axis.
        thickness_angstrom, defocus_angstrom, energy_kv, semiangle_mrad: parameters of specimen and probe. Underfocus is positive.
        wavelength_angstrom: wavelength of the electrons.
        electrons_per_pattern: incident electrons of each pattern; ``None`` if no electrons were counted.
        ring_mrad: width of the rings, if patterns are sums over rings. Their shape is then ``(y, x, 1, ring)``. ``None`` for pixels.
    """

    shape: tuple[int, int, int, int]
    step_angstrom: tuple[float, float]
    origin_angstrom: tuple[float, float]
    max_angle_mrad: float
    thickness_angstrom: float
    defocus_angstrom: float
    energy_kv: float
    semiangle_mrad: float
    wavelength_angstrom: float
    electrons_per_pattern: float | None = None
    ring_mrad: float | None = None

    @property
    def pixel_mrad(self) -> float:
        """Edge of a pixel, or width of a ring, in mrad."""
        if self.ring_mrad is not None:
            return self.ring_mrad
        return 2 * self.max_angle_mrad / self.shape[2]

    @property
    def pixel_k(self) -> float:
        """Edge of a pixel in 1/A."""
        return 1e-3 * self.pixel_mrad / self.wavelength_angstrom

    @property
    def angles_mrad(self) -> npt.NDArray[np.float64]:
        """Angles of the centres of the pixels along an axis, or of the rings."""
        if self.ring_mrad is not None:
            return (np.arange(self.shape[3], dtype=np.float64) + 0.5) * np.float64(self.ring_mrad)
        return (np.arange(self.shape[2], dtype=np.float64) - self.shape[2] // 2) * np.float64(self.pixel_mrad)


class DataCube:
    """The diffraction patterns of a scan: in memory, or in a file that is read row by row.

    Attributes:
        axes: axes and parameters of the patterns.
        vacuum: the pattern of the beam without a specimen, ``[ky, kx]``; ``None`` if the file contains none.
    """

    def __init__(
        self, axes: Axes4D, data: npt.NDArray[Any] | None, vacuum: Float32Array | None, path: Path | None = None
    ) -> None:
        self.axes = axes
        self.vacuum = vacuum
        self._data = data
        self._path = path
        self._reader: _core.PatternReader | None = None

    @classmethod
    def open(cls, path: Path) -> DataCube:
        """Opens a file (``.emd``) from ``stemgen patterns`` or :func:`simulate_patterns`. Patterns are read at their first use.

        Raises:
            FileError, FormatError: for a file that cannot be read, or was not written by stemgen.
        """
        header = call(_core.PatternReader, os.fspath(path)).header()
        return cls(_axes(header), None, header["vacuum"], path)

    @property
    def data(self) -> npt.NDArray[Any]:
        """All patterns, ``[y, x, ky, kx]``: float32 fractions of the beam, or electrons. For a file, all patterns are read into memory."""
        if self._data is None:
            self._data = np.concatenate([rows for _, rows in self._rows()])
        return self._data

    def __getitem__(self, at: tuple[int, int]) -> npt.NDArray[Any]:
        """Returns the pattern of the probe ``[y, x]``, ``[ky, kx]``."""
        y, x = at
        rows, columns = self.axes.shape[:2]
        if not (-rows <= y < rows and -columns <= x < columns):
            raise IndexError(f"there are {rows} x {columns} probes")
        if self._data is not None:
            kept: npt.NDArray[Any] = self._data[y, x]
            return kept
        first = y % rows
        read: npt.NDArray[Any] = call(self._file().rows, first, first + 1)[0, x]
        return read

    def __repr__(self) -> str:
        rows, columns, ky, kx = self.axes.shape
        if self.axes.ring_mrad is not None:
            return f"<DataCube: {columns} x {rows} probes, {kx} rings of {self.axes.ring_mrad:g} mrad>"
        return f"<DataCube: {columns} x {rows} probes, {kx} x {ky} pixels to {self.axes.max_angle_mrad:g} mrad>"

    def _file(self) -> _core.PatternReader:
        if self._reader is None:
            assert self._path is not None
            self._reader = call(_core.PatternReader, os.fspath(self._path))
        return self._reader

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_reader": None}

    def _rows(self) -> Iterator[tuple[int, npt.NDArray[Any]]]:
        """Yields the patterns, some rows at a time, with the number of the first row."""
        if self._data is not None:
            yield 0, self._data
            return
        rows, columns, ky, kx = self.axes.shape
        together = max(1, _TOGETHER_BYTES // (4 * columns * ky * kx))
        for first in range(0, rows, together):
            yield first, call(self._file().rows, first, min(first + together, rows))

    def _image(self, name: str, array: npt.NDArray[Any], units: str) -> Image:
        (dy, dx), (y, x) = self.axes.step_angstrom, self.axes.origin_angstrom
        return Image(
            name=name,
            array=array.astype(np.float32),
            sampling_nm=(dy / 10, dx / 10),
            origin_nm=(y / 10, x / 10),
            units=units,
            thicknesses_angstrom=(self.axes.thickness_angstrom,),
            metadata={"defocus_angstrom": self.axes.defocus_angstrom},
        )

    def detector(
        self,
        inner_mrad: float,
        outer_mrad: float,
        *,
        sector_degrees: tuple[float, float] | None = None,
        centre_mrad: tuple[float, float] = (0.0, 0.0),
    ) -> Float32Array:
        """Returns the share of each pixel's area on a ring, or on a sector of it, ``[ky, kx]``.

        Args:
            inner_mrad, outer_mrad: inner and outer angle of the ring.
            sector_degrees: first and last azimuth of the sector, counted from +x towards +y, which runs down.
            centre_mrad: centre of the ring, ``(x, y)``.

        Raises:
            InvalidValue: for a ring that extends beyond the patterns, or lies between their pixels. For sums over rings: for a detector
                that begins or ends inside a ring, and for sectors.
        """
        annulus, a = (float(inner_mrad), float(outer_mrad)), self.axes
        detector = (a.shape[2], a.max_angle_mrad, a.ring_mrad)
        return call(_core.detector_weights, detector, annulus, sector_degrees, centre_mrad)

    def virtual_image(
        self,
        inner_mrad: float = 0.0,
        outer_mrad: float | None = None,
        *,
        mask: npt.ArrayLike | None = None,
        sector_degrees: tuple[float, float] | None = None,
        centre_mrad: tuple[float, float] = (0.0, 0.0),
        name: str = "virtual",
    ) -> Image:
        """Returns the image of a virtual detector.

        Args:
            inner_mrad, outer_mrad, sector_degrees, centre_mrad: see :meth:`detector`.
            mask: weights of the pixels ``[ky, kx]``, instead of a ring.
            name: name of the image.

        Raises:
            InvalidValue: see :meth:`detector`; for a mask of a wrong shape; and if neither ring nor mask is given.
        """
        if mask is not None:
            weights = np.asarray(mask, dtype=np.float32)
            if weights.shape != self.axes.shape[2:]:
                raise _invalid("mask", f"a mask of shape {weights.shape}: expected {self.axes.shape[2:]}")
        elif outer_mrad is None:
            raise _invalid("outer_mrad", "give the angles of a ring, or a mask")
        else:
            weights = self.detector(inner_mrad, outer_mrad, sector_degrees=sector_degrees, centre_mrad=centre_mrad)
        parts = [np.einsum("yxij,ij->yx", rows, weights, dtype=np.float64) for _, rows in self._rows()]
        units = "electrons" if self.axes.electrons_per_pattern else "fraction of the incident beam"
        return self._image(name, np.concatenate(parts), units)

    def centre_of_mass(self) -> tuple[Image, Image]:
        """Returns the centre of mass of every pattern, ``(y, x)`` in mrad: the mean angle of its electrons, 0 for a pattern without
        electrons.

        Raises:
            InvalidValue: for sums over rings, which have no centre of mass.
        """
        self._needs_pixels("have no centre of mass")
        angles = self.axes.angles_mrad
        found: list[list[npt.NDArray[Any]]] = [[], []]
        for _, rows in self._rows():
            total = rows.sum(axis=(2, 3), dtype=np.float64)
            safe = np.where(total > 0, total, 1.0)
            found[0].append(np.einsum("yxij,i->yx", rows, angles, dtype=np.float64) / safe)
            found[1].append(np.einsum("yxij,j->yx", rows, angles, dtype=np.float64) / safe)
        y, x = (np.concatenate(parts) for parts in found)
        return self._image("com_y", y, "mrad"), self._image("com_x", x, "mrad")

    def integrated_centre_of_mass(self) -> Image:
        """Returns the integrated centre of mass (iCOM) in radians, which is the phase for thin specimens. The scan is treated as periodic.

        I. Lazic, E. Bosch and S. Lazar, Ultramicroscopy 160 (2016) 265.
        """
        y, x = self.centre_of_mass()
        dy, dx = self.axes.step_angstrom
        phase = call(_core.integrated_centre_of_mass, x.array, y.array, (dx, dy), self.axes.wavelength_angstrom)
        return self._image("icom", phase, "radians")

    def _needs_pixels(self, why: str) -> None:
        if self.axes.ring_mrad is not None:
            raise _invalid("radial_mrad", f"sums over rings {why}; simulate pixels")

    def mean_pattern(self) -> npt.NDArray[np.float64]:
        """Returns the mean of all patterns (position-averaged CBED), ``[ky, kx]``."""
        rows, columns = self.axes.shape[:2]
        total = sum(part.sum(axis=(0, 1), dtype=np.float64) for _, part in self._rows())
        return np.asarray(total) / (rows * columns)

    def page(self, out: Path, *, overwrite: bool = False) -> str:
        """Writes a page (HTML) for the browser: point at the scan to see a pattern, draw a detector to see its image.

        The page is one file and needs no network. It holds at most 16.8 million intensities: pixels of larger cubes are summed 2 x 2 until they
        fit, then probes are averaged, and the page says so.

        Args:
            out: the file, ``.html``.
            overwrite: replace an existing file.

        Returns:
            The path of the file.

        Raises:
            InvalidValue: for another ending, and for sums over rings.
            FileError: where the file cannot be written, or exists.
        """
        self._needs_pixels("have no page")
        path, run = os.fspath(out), running(None, False)
        if not path.lower().endswith((".html", ".htm")):
            raise _invalid("out", f"{path}: a page ends in .html")
        if self._data is None:
            assert self._path is not None
            call(self._file().page, _FilePath(self._path).stem, path, overwrite, run)
            return path
        a = self.axes
        axes: _core.CubeAxes = {
            "title": _FilePath(path).stem,
            "step_angstrom": (a.step_angstrom[1], a.step_angstrom[0]),
            "origin_angstrom": (a.origin_angstrom[1], a.origin_angstrom[0]),
            "max_angle_mrad": a.max_angle_mrad,
            "thickness_angstrom": a.thickness_angstrom,
            "defocus_angstrom": a.defocus_angstrom,
            "energy_kev": a.energy_kv,
            "semiangle_mrad": a.semiangle_mrad,
            "wavelength_angstrom": a.wavelength_angstrom,
            "electrons_per_pattern": a.electrons_per_pattern,
        }
        call(_core.write_pattern_page, self._data.astype(np.float32), axes, path, overwrite, run)
        return path

    def to_hyperspy(self) -> Any:
        """Returns the patterns as a ``hyperspy.signals.Signal2D`` over the scan. HyperSpy has to be installed."""
        self._needs_pixels("make no images")
        from hyperspy.signals import Signal2D

        signal = Signal2D(self.data)
        a = self.axes
        first = -(a.shape[2] // 2) * a.pixel_k
        places = zip("xy", a.step_angstrom[::-1], a.origin_angstrom[::-1], strict=True)
        for axis, (name, scale, offset) in zip(signal.axes_manager.navigation_axes, places, strict=True):
            axis.name, axis.scale, axis.offset, axis.units = name, scale, offset, "\u212b"
        for axis, name in zip(signal.axes_manager.signal_axes, ("kx", "ky"), strict=True):
            axis.name, axis.scale, axis.offset, axis.units = name, a.pixel_k, first, "1/\u212b"
        signal.metadata.set_item("Acquisition_instrument.TEM.beam_energy", a.energy_kv)
        signal.metadata.set_item("Acquisition_instrument.TEM.convergence_angle", a.semiangle_mrad)
        return signal

    def to_py4dstem(self) -> Any:
        """Returns the patterns as a calibrated ``py4DSTEM.DataCube``. py4DSTEM has to be installed."""
        self._needs_pixels("make no images")
        from py4DSTEM import DataCube as Py4dstemCube

        cube = Py4dstemCube(data=self.data)
        cube.calibration.set_Q_pixel_size(self.axes.pixel_k)
        cube.calibration.set_Q_pixel_units("A^-1")
        cube.calibration.set_R_pixel_size(self.axes.step_angstrom[1])
        cube.calibration.set_R_pixel_units("A")
        return cube


def simulate_patterns(
    atoms: Atoms,
    *,
    pixels: int | None = None,
    max_angle_mrad: float | None = None,
    radial_mrad: float | None = None,
    mtf: float | npt.ArrayLike | None = None,
    coherent_tail: bool | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    **options: Unpack[SimulationOptions],
) -> DataCube:
    """Simulates the diffraction pattern of every probe of a scan (4D-STEM).

    Args:
        atoms: see :func:`simulate`.
        pixels: number of pixels along each edge of the detector. Default 64.
        max_angle_mrad: half of the detector's width, or the outer angle of the last ring. Default 100.
        radial_mrad: width of rings. If it is given, each pattern is summed over rings, and :meth:`DataCube.virtual_image` makes images of
            any annulus of whole rings.
        mtf: spread of electrons over neighbouring pixels: the standard deviation of a Gaussian in pixels, or a table of the modulation
            transfer function, rows of (cycles per pixel, transfer) from (0, 1) on. Default: no spread.
        coherent_tail: add the part of the probe outside of its window. Default true.
        out: a file (``.emd``) to which the patterns are written row by row, instead of memory. py4DSTEM, LiberTEM and HyperSpy open it.
        overwrite: replace an existing file.
        **options: see :class:`SimulationOptions`. ``detectors``, ``source_lorentz`` and ``accuracy_percent`` are for images. Without an
            engine, probes are propagated in windows that contain the beam throughout the specimen.

    Returns:
        The patterns: fractions of the beam, float32, or with ``dose`` (electrons per square Angstrom) counted electrons, uint32.

    Raises:
        InvalidValue: for an option out of its limits, and for several thicknesses or defocus values, which :func:`simulate_pattern_series`
            accepts.
        FormatError, FileError, NotEnoughMemory, KeyboardInterrupt: see :func:`simulate`.
    """
    for keyword in ("thicknesses_angstrom", "defocus_angstrom"):
        value = options.get(keyword)
        if isinstance(value, (Sequence, np.ndarray)) and len(value) > 1:
            raise _invalid(keyword, f"{keyword}: several make a series; simulate_pattern_series() takes them")
    detector = _detector(pixels, max_angle_mrad, radial_mrad, mtf, coherent_tail)
    (cube,) = _simulate(atoms, detector, (out, overwrite), options)
    return cube


def simulate_pattern_series(
    atoms: Atoms,
    *,
    pixels: int | None = None,
    max_angle_mrad: float | None = None,
    radial_mrad: float | None = None,
    mtf: float | npt.ArrayLike | None = None,
    coherent_tail: bool | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    **options: Unpack[SimulationOptions],
) -> tuple[DataCube, ...]:
    """Simulates the patterns for several thicknesses and defocus values, see :func:`simulate_patterns`.

    The results are sorted by defocus, then by thickness. Files have both in their names: ``NAME_defocus_50A_39.0A.emd``.
    """
    detector = _detector(pixels, max_angle_mrad, radial_mrad, mtf, coherent_tail)
    return _simulate(atoms, detector, (out, overwrite), options)


def _detector(
    pixels: int | None,
    max_angle_mrad: float | None,
    radial_mrad: float | None,
    mtf: float | npt.ArrayLike | None,
    coherent_tail: bool | None,
) -> _core.PatternsRequest:
    """Returns the detector's table of the request, with the given options."""
    if pixels is not None and radial_mrad is not None:
        raise _invalid("radial_mrad", "rings take the place of pixels: leave one of the two out")
    asked: dict[str, Any] = {"pixels": pixels, "max_angle_mrad": max_angle_mrad, "radial_mrad": radial_mrad}
    asked |= {"mtf": None if mtf is None else _transfer(mtf), "coherent_tail": coherent_tail}
    return cast("_core.PatternsRequest", {name: value for name, value in asked.items() if value is not None})


def _transfer(mtf: float | npt.ArrayLike) -> Any:
    """Converts ``mtf`` to a number, or to the rows of a table."""
    try:
        array = np.asarray(mtf, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.ndim != 0 and (array.ndim != 2 or array.shape[1] != 2):
        raise _invalid("mtf", "mtf: expected a number, or rows of (cycles per pixel, transfer)")
    return array.tolist()


def _simulate(
    atoms: Atoms,
    detector: _core.PatternsRequest,
    written: tuple[Path | None, bool],
    options: SimulationOptions,
) -> tuple[DataCube, ...]:
    unused = {"detectors", "accuracy_percent"} & options.keys()
    if unused:
        name = sorted(unused)[0]
        raise _invalid(name, f"{name} is for images: DataCube.virtual_image() makes them of patterns")
    request, arrays = _request(atoms, options)
    request["patterns"] = detector
    force, running = options.get("force", False), _run(options)
    out, overwrite = written
    if out is not None:
        if _FilePath(out).suffix.lower() != ".emd":
            raise _invalid("out", f"{os.fspath(out)!r}: patterns are written as .emd; the command `stemgen patterns` writes other files")
        files = call(_core.write_patterns, request, arrays, os.fspath(out), overwrite, force, running)
        return tuple(DataCube.open(path) for path in files)
    return _cubes(call(_core.simulate_patterns, request, arrays, force, running))


def _cubes(found: Iterable[_core.Patterns]) -> tuple[DataCube, ...]:
    return tuple(DataCube(_axes(item), item["data"], item["vacuum"]) for item in found)


def _axes(header: _core.PatternHeader) -> Axes4D:
    rows, columns, ky, kx = header["shape"]
    (dx, dy), (x, y) = header["step_angstrom"], header["origin_angstrom"]
    return Axes4D(
        shape=(rows, columns, ky, kx),
        step_angstrom=(dy, dx),
        origin_angstrom=(y, x),
        max_angle_mrad=header["max_angle_mrad"],
        thickness_angstrom=header["thickness_angstrom"],
        defocus_angstrom=header["defocus_angstrom"],
        energy_kv=header["energy_kev"],
        semiangle_mrad=header["semiangle_mrad"],
        wavelength_angstrom=header["wavelength_angstrom"],
        electrons_per_pattern=header["electrons_per_pattern"],
        ring_mrad=header["ring_mrad"],
    )
