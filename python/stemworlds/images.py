"""The results of simulations, as NumPy arrays with axes and metadata."""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _core
from .errors import _invalid

Float32Array = npt.NDArray[np.float32]
Path = str | os.PathLike[str]


@dataclass(frozen=True, eq=False, repr=False)
class Image:
    """An image with its axes.

    Attributes:
        name: name of the detector, or of the quantity.
        array: float32, ``[y, x]``, or ``[thickness, y, x]`` for several thicknesses.
        sampling_nm: edge of a pixel along ``(y, x)`` in nm.
        origin_nm: place of the first pixel ``(y, x)`` in nm.
        units: quantity and unit of the values.
        thicknesses_angstrom: thickness of the specimen, one for each image.
        counts: counted electrons, uint32 with the shape of ``array``; ``None`` without a dose. For a centre of mass, all electrons on
            its detector.
        electrons_per_pixel: incident electrons on a pixel; ``None`` without a dose.
        metadata: parameters of the simulation.
        counted_mrad: for a centre of mass with a dose, the mean angle of the counted electrons in mrad.
    """

    name: str
    array: Float32Array
    sampling_nm: tuple[float, float]
    origin_nm: tuple[float, float] = (0.0, 0.0)
    units: str = "fraction of the incident beam"
    thicknesses_angstrom: tuple[float, ...] = ()
    counts: npt.NDArray[np.uint32] | None = None
    electrons_per_pixel: float | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    counted_mrad: Float32Array | None = None

    def __repr__(self) -> str:
        dy, dx = self.sampling_nm
        shape = " x ".join(map(str, self.array.shape))
        return f"<Image {self.name}: {shape} pixels of {dx:.4g} x {dy:.4g} nm, {self.units}>"

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return self.array.shape

    @property
    def extent_nm(self) -> tuple[float, float, float, float]:
        """Left, right, lower and upper edge in nm, in the order of ``matplotlib.pyplot.imshow``."""
        rows, columns = self.array.shape[-2:]
        (dy, dx), (y, x) = self.sampling_nm, self.origin_nm
        return (x - dx / 2, x + (columns - 0.5) * dx, y + (rows - 0.5) * dy, y - dy / 2)

    @property
    def noisy(self) -> Image:
        """The image from the counted electrons: counts divided by the incident electrons of a pixel, or their mean angle.

        Raises:
            InvalidValue: without a dose.
        """
        if self.counts is None or not self.electrons_per_pixel:
            raise _invalid("dose", "the image was made without a dose, so no electrons were counted")
        array = self.counted_mrad
        if array is None:
            array = (self.counts / self.electrons_per_pixel).astype(np.float32)
        return replace(self, name=f"{self.name}_noisy", array=array)

    def at(self, thickness: int) -> Image:
        """Returns the image at one of several thicknesses, ``[y, x]``. ``thickness`` is an index from 0."""
        if self.array.ndim == 2:
            if thickness not in (0, -1):
                raise _invalid("thickness", f"thickness = {thickness}: there is one image only")
            return self
        counts = None if self.counts is None else self.counts[thickness]
        counted_mrad = None if self.counted_mrad is None else self.counted_mrad[thickness]
        at = self.thicknesses_angstrom[thickness]
        array = self.array[thickness]
        return replace(self, array=array, counts=counts, counted_mrad=counted_mrad, thicknesses_angstrom=(at,))

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        array: npt.NDArray[Any] = self.array if dtype is None else self.array.astype(dtype)
        return array.copy() if copy else array

    def _stack(self) -> _core.ImageStack:
        data = self.array if self.array.ndim == 3 else self.array[np.newaxis]
        (dy, dx), (y, x) = self.sampling_nm, self.origin_nm
        return {
            "name": self.name,
            "data": np.ascontiguousarray(data, dtype=np.float32),
            "units": self.units,
            "step_angstrom": (10 * dx, 10 * dy),
            "origin_angstrom": (10 * x, 10 * y),
            "thicknesses_angstrom": list(self.thicknesses_angstrom) or [0.0] * len(data),
            "defocus_angstrom": self.metadata.get("defocus_angstrom"),
            "annulus_mrad": self.metadata.get("annulus_mrad"),
            "sector_degrees": self.metadata.get("sector_degrees"),
            "electrons_per_pixel": self.electrons_per_pixel if self._is_noisy else None,
        }

    @property
    def _is_noisy(self) -> bool:
        """Whether the array contains counts divided by the incident electrons of a pixel."""
        return self.counts is not None and self.name.endswith("_noisy")

    def _about(self, series: bool) -> _core.HspyOptions:
        """Returns the microscope's metadata for a HyperSpy file."""
        settings = self.metadata.get("settings", {})
        optics = settings.get("optics", {})
        tilt = optics.get("mistilt_mrad", (0.0, 0.0)) if optics else None
        (dy, dx), electrons = self.sampling_nm, self.electrons_per_pixel
        return {
            "energy_kev": optics["energy_ev"] / 1e3 if optics else None,
            "semiangle_mrad": optics.get("semiangle_mrad"),
            "tilt_mrad": None if tilt is None else (tilt[0], tilt[1]),
            "defocus_angstrom": None if series else self.metadata.get("defocus_angstrom"),
            "dose": None if electrons is None else electrons / (100 * dx * dy),
            "settings": json.dumps(settings) if settings else None,
        }

    def to_hspy(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes a file for HyperSpy (``.hspy``), with axes in Angstrom and the microscope in its metadata. HyperSpy need not be
        installed."""
        _core.save_hspy(os.fspath(path), [self._stack()], self._about(False), overwrite)

    def to_tiff(self, path: Path, *, bits: int = 32, overwrite: bool = False) -> None:
        """Writes a TIFF of 8, 16 or 32 bits, with pixels and values calibrated for ImageJ."""
        _core.save_tiff(os.fspath(path), [self._stack()], bits, overwrite)

    def to_png(
        self, path: Path, *, scale_bar: bool = True, grey_bar: bool = False, overwrite: bool = False
    ) -> None:
        """Writes a picture. For several thicknesses it shows the last one.

        ``grey_bar`` draws a scale of grey values, with the numbers for black and white: the percentiles 0.1 and 99.9.
        """
        _core.write_file(os.fspath(path), self._png(scale_bar, grey_bar), overwrite)

    def to_hyperspy(self) -> Any:
        """Returns the image as a ``hyperspy.signals.Signal2D``, with axes in nm. HyperSpy has to be installed."""
        from hyperspy.signals import Signal2D

        signal = Signal2D(self.array.copy())
        # HyperSpy lists x first.
        for axis, name, scale, offset in zip(
            signal.axes_manager.signal_axes, "xy", self.sampling_nm[::-1], self.origin_nm[::-1], strict=True
        ):
            axis.name, axis.scale, axis.offset, axis.units = name, scale, offset, "nm"
        signal.metadata.General.title = self.name
        return signal

    def to_abtem(self) -> Any:
        """Returns the image as ``abtem.measurements.Images`` with an array ``[x, y]``. abTEM has to be installed."""
        from abtem.measurements import Images as AbtemImages

        dy, dx = self.sampling_nm
        array = np.ascontiguousarray(np.swapaxes(self.array, -1, -2))
        if array.ndim == 3:
            raise _invalid("array", "abTEM takes one thickness: image.at(n).to_abtem()")
        return AbtemImages(array, sampling=(10 * dx, 10 * dy), metadata={"label": self.name})

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Draws the image with matplotlib. Returns the axes. ``options`` are passed to ``imshow``.

        y runs down, along the rows of the array. ``origin="lower"`` draws y upwards.
        """
        import matplotlib.pyplot as plt

        if ax is None:
            _, ax = plt.subplots()
        image = self.at(-1)
        left, right, bottom, top = self.extent_nm
        if options.get("origin") == "lower":
            bottom, top = top, bottom
        ax.imshow(image.array, **{"cmap": "gray", "extent": (left, right, bottom, top), **options})
        ax.set(title=self.name, xlabel="x (nm)", ylabel="y (nm)")
        return ax

    def _png(self, scale_bar: bool = True, grey_bar: bool = False) -> bytes:
        array = np.ascontiguousarray(self.at(-1).array, dtype=np.float32)
        dy, dx = self.sampling_nm
        return _core.png(array, (10 * dx, 10 * dy), scale_bar, grey_bar)

    def _repr_png_(self) -> bytes:
        return self._png()

    def _repr_html_(self) -> str:
        picture = base64.b64encode(self._png()).decode()
        rows, columns = self.array.shape[-2:]
        dy, dx = self.sampling_nm
        about = (
            f"{html.escape(self.name)}: {columns} x {rows} pixels of {dx:.4g} x {dy:.4g} nm, "
            f"{float(self.array.min()):.3g} to {float(self.array.max()):.3g} {html.escape(self.units)}"
        )
        return f'<figure><img src="data:image/png;base64,{picture}"><figcaption>{about}</figcaption></figure>'


class Images(Mapping[str, Image]):
    """Images of one simulation, by name. If there is one image only, the object can be used as this image."""

    def __init__(self, images: Mapping[str, Image], *, metadata: Mapping[str, Any]) -> None:
        self._images = dict(images)
        self.metadata: Mapping[str, Any] = metadata

    def __getitem__(self, name: str) -> Image:
        try:
            return self._images[name]
        except KeyError:
            raise KeyError(f"{name!r}; there are {', '.join(map(repr, self._images))}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._images)

    def __len__(self) -> int:
        return len(self._images)

    def __repr__(self) -> str:
        return f"Images({', '.join(f'{name}: {image.shape}' for name, image in self.items())})"

    @property
    def only(self) -> Image:
        """The only image.

        Raises:
            InvalidValue: if there are several images.
        """
        if len(self) == 1:
            return next(iter(self._images.values()))
        raise _invalid("detectors", f"there are {len(self)} images; choose one: result[{next(iter(self))!r}]")

    @property
    def array(self) -> Float32Array:
        """Array of the only image, ``[y, x]``."""
        return self.only.array

    @property
    def sampling_nm(self) -> tuple[float, float]:
        """Edge of a pixel along ``(y, x)`` in nm."""
        return next(iter(self._images.values())).sampling_nm

    @property
    def origin_nm(self) -> tuple[float, float]:
        """Place of the first pixel ``(y, x)`` in nm."""
        return next(iter(self._images.values())).origin_nm

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return self.only.__array__(dtype, copy)

    def to_hspy(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes all images to one file for HyperSpy (``.hspy``). ``hyperspy.api.load`` returns one signal for each detector.

        A defocus series is one signal with the axis ``defocus``.
        """
        images = list(self.values())
        series = len({image.metadata.get("defocus_angstrom") for image in images}) > 1
        _core.save_hspy(os.fspath(path), [image._stack() for image in images], images[0]._about(series), overwrite)

    def to_tiff(self, path: Path, *, bits: int = 32, overwrite: bool = False) -> None:
        """Writes the only image, or the images of a defocus series of one detector, as one TIFF."""
        _core.save_tiff(os.fspath(path), [image._stack() for image in self.values()], bits, overwrite)

    def to_png(
        self, path: Path, *, scale_bar: bool = True, grey_bar: bool = False, overwrite: bool = False
    ) -> None:
        """Writes a picture of the only image."""
        self.only.to_png(path, scale_bar=scale_bar, grey_bar=grey_bar, overwrite=overwrite)

    def to_hyperspy(self) -> Any:
        """Returns the only image as a signal of HyperSpy."""
        return self.only.to_hyperspy()

    def to_abtem(self) -> Any:
        """Returns the only image as an object of abTEM."""
        return self.only.to_abtem()

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Draws the only image with matplotlib."""
        return self.only.plot(ax, **options)

    def _repr_html_(self) -> str:
        return "".join(image._repr_html_() for image in self.values())


@dataclass(frozen=True, eq=False)
class PlaneWave:
    """Result of a plane-wave simulation.

    Attributes:
        exit_waves: complex64, ``[configuration, y, x]``, in units of the amplitude of the incident wave.
        images: image through the lens for each defocus, averaged over configurations.
        sampling_nm: edge of a pixel along ``(y, x)`` in nm.
    """

    exit_waves: npt.NDArray[np.complex64]
    images: tuple[Image, ...]
    sampling_nm: tuple[float, float]


@dataclass(frozen=True, eq=False)
class ExitWaves:
    """The waves of probes behind the specimen, from :func:`exit_waves`.

    Attributes:
        array: complex64, ``[defocus, configuration, probe, thickness, y, x]``; the squared moduli of a wave add to the fraction of the beam.
            The square of a Fourier transform with ``norm="ortho"`` is the diffraction pattern.
        sampling_nm: edge of a pixel along ``(y, x)`` in nm.
        positions_angstrom: ``(x, y)`` of each probe, of shape (N, 2).
        thicknesses_angstrom: recorded thicknesses.
        defocus_angstrom: defocus of each part of the first axis.
    """

    array: npt.NDArray[np.complex64]
    sampling_nm: tuple[float, float]
    positions_angstrom: npt.NDArray[np.float64]
    thicknesses_angstrom: tuple[float, ...]
    defocus_angstrom: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class DiffractionPattern:
    """The diffraction pattern of one probe, averaged over phonon configurations.

    Attributes:
        array: float32, ``[ky, kx]``, fractions of the incident beam in each pixel; the unscattered beam is at ``centre``.
        sampling_mrad: edge of a pixel along ``(ky, kx)`` in mrad.
        band_limit_mrad: greatest scattering angle of the grid; the pattern is 0 beyond it.
    """

    array: Float32Array
    sampling_mrad: tuple[float, float]
    band_limit_mrad: float

    @property
    def centre(self) -> tuple[int, int]:
        """Row and column of the unscattered beam."""
        rows, columns = self.array.shape
        return rows // 2, columns // 2

    def annulus(self, inner_mrad: float, outer_mrad: float) -> float:
        """Returns the fraction of the beam between two angles. Each pixel counts entirely or not at all."""
        rows, columns = np.indices(self.array.shape)
        (row, column), (dy, dx) = self.centre, self.sampling_mrad
        angle = np.hypot((rows - row) * dy, (columns - column) * dx)
        return float(self.array[(angle >= inner_mrad) & (angle < outer_mrad)].sum(dtype=np.float64))
