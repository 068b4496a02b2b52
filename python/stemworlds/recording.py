"""Simulates recordings of a world or a recipe, with the errors of a real microscope."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from . import _core
from ._fields import FieldLike, field_options
from ._running import Progress, call, running
from .errors import _invalid
from .images import Image
from .recipes import Acquisition
from .worlds import Table


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording, and the truth about it.

    Attributes:
        array: the values of a microscope's file, float64 ``[y, x]``, or ``[frame, y, x]`` with ``keep_frames``; the mean angle of the counted
            electrons in mrad for a centre of mass.
        ideal: the noise-free image at the intended pixels, in fractions of the beam, or in mrad for a centre of mass.
        columns: atomic columns; ``x_nm``, ``y_nm`` from the centre of the first pixel, ``x_px``, ``y_px`` their places in the recording.
        position_in_image: places of the columns in the recording, ``[frame, column, (x, y)]`` in pixels, or the mean of all frames.
        drift: time in s and drift ``(x, y)`` in nm of each line of each frame.
        detector: name of the detector, the first one of the recording.
        others: recordings of the same electrons on the other detectors, by name. They share path, dose and truth.
        moved, electrons: intermediate images between noise-free image and recording, ``[frame, y, x]``; ``None`` without ``stages``.
    """

    array: npt.NDArray[np.float64]
    ideal: Image
    columns: Table
    position_in_image: npt.NDArray[np.float64]
    drift: npt.NDArray[np.float64]
    pixel_nm: float
    origin_nm: tuple[float, float]
    dose: float
    current_pa: float
    electrons_per_pixel: float
    clipped_pixels: int
    moved: npt.NDArray[np.float32] | None
    electrons: npt.NDArray[np.float32] | None
    detector: str = "HAADF"
    others: Mapping[str, Recording] = field(default_factory=dict)

    @property
    def detectors(self) -> Mapping[str, Recording]:
        """The recordings on all detectors by name, this one first."""
        return {self.detector: self, **self.others}

    @property
    def image(self) -> Image:
        """The recording as an image: the sum of all frames in counts, or the mean of all frames of a centre of mass in mrad."""
        name = "recording" if self.ideal.name == "ideal" else self.detector
        angles = self.ideal.units == "mrad"
        array = self.array
        if array.ndim == 3:
            array = array.mean(axis=0) if angles else array.sum(axis=0)
        units = "mrad" if angles else "counts"
        return Image(name, array.astype(np.float32), (self.pixel_nm,) * 2, self.ideal.origin_nm, units=units)

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Draws the recording with matplotlib."""
        return self.image.plot(ax, **options)

    def _repr_html_(self) -> str:
        return self.image._repr_html_()


def acquire(
    field: FieldLike,
    *,
    profile: Acquisition | None = None,
    acquisition: Mapping[str, Any] | None = None,
    region_nm: tuple[float, float, float, float] | None = None,
    at_nm: tuple[float, float] | None = None,
    zoom: float | None = None,
    pixel_nm: float | None = None,
    dose: float | None = None,
    current_pa: float | None = None,
    dwell_us: float | None = None,
    frames: int | None = None,
    keep_frames: bool = False,
    stages: bool = False,
    scan_seed: int = 1,
    detectors: Sequence[str] | None = None,
    cache: bool | str | os.PathLike[str] = True,
    out: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    threads: int | None = None,
    progress: Progress = False,
    **recipe: Any,
) -> Recording:
    """Simulates a recording with drift, jitter, hum, dose and detector.

    Args:
        field: a :class:`World`, its path, or a recipe. A recipe needs no world file.
        profile: named set of values for the microscope; by default the values of the recipe, or ``"ideal"``.
        acquisition: single values, for example ``{"drift_nm_per_s": (0.5, 0)}``; docs/acquisition.md explains them.
        region_nm: region to record, left, upper, right and lower edge.
        at_nm: centre of the region, instead of ``region_nm``. The recording then has as many pixels as a tile.
        zoom: ratio of the world's pixel edge to the recording's pixel edge.
        pixel_nm: edge of a pixel, instead of ``zoom``.
        dose: electrons per square Angstrom, all frames together.
        current_pa: current of the beam, instead of ``dose``.
        dwell_us: time on each pixel.
        frames: number of frames.
        keep_frames: return the single frames instead of their sum.
        stages: return the intermediate images as well.
        scan_seed: seed of electrons, noise, jitter and random drift.
        detectors: names of the detectors of the recipe or the world that record (names of tables ``[[detector]]``, of sectors, or of axes of a
            centre of mass); by default all. They record the same electrons on the same path, each with noise of its own.
        out: file (HDF5) that is written as well.
        **recipe: ``difficulty``, ``set``, ``unset``, ``grid``, ``seed`` of a recipe.
    """
    if frames is not None and frames < 1:
        raise _invalid("frames", f"frames = {frames}: expected a whole number above 0")
    request = recording_request(
        region_nm=region_nm,
        at_nm=at_nm,
        zoom=zoom,
        pixel_nm=pixel_nm,
        profile=profile,
        electrons_per_angstrom2=dose,
        current_pa=current_pa,
        dwell_us=dwell_us,
        frames=frames,
        keep_frames=keep_frames,
        keep_stages=stages,
        seed=scan_seed,
        detectors=detector_names(detectors),
    )
    options: _core.RecordingOptions = {
        "field": field_options(field, recipe, acquisition),
        "request": request,
        "cache": cache if isinstance(cache, bool) else os.fspath(cache),
        "out": None if out is None else os.fspath(out),
        "overwrite": overwrite,
    }
    return _recording(call(_core.record_field, options, running(threads, progress)), keep_frames)


def detector_names(names: Sequence[str] | None) -> list[str] | None:
    """Returns the names of detectors as a list."""
    if isinstance(names, str) or not (names is None or all(isinstance(name, str) for name in names)):
        raise _invalid("detectors", f"detectors = {names!r}: expected names, such as ('HAADF', 'ABF')")
    return None if names is None else list(names)


def recording_request(**given: Any) -> _core.RecordingRequest:
    """Returns the given options as a request of the library, which contains the defaults."""
    return cast("_core.RecordingRequest", {key: value for key, value in given.items() if value is not None})


def _recording(found: Mapping[str, Any], keep_frames: bool) -> Recording:
    pixel = found["pixel_nm"]
    x, y = found["origin_nm"]
    places = found["position_in_image"]
    first, *others = found["detectors"]

    def on(one: Mapping[str, Any], name: str) -> dict[str, Any]:
        units = "mrad" if one["mrad"] else "fraction of the incident beam"
        return {
            "array": one["data"] if keep_frames else one["data"][0],
            "ideal": Image(name, one["ideal"], (pixel, pixel), (y, x), units),
            "clipped_pixels": one["clipped"],
            "moved": one.get("moved"),
            "electrons": one.get("electrons"),
            "detector": one["name"],
        }

    recording = Recording(
        **on(first, "ideal"),
        columns=_columns(found, places.mean(axis=0)),
        position_in_image=places if keep_frames else places[0],
        drift=found["drift"],
        pixel_nm=pixel,
        origin_nm=(x, y),
        dose=found["dose"],
        current_pa=found["current_pa"],
        electrons_per_pixel=found["electrons_per_pixel"],
    )
    return replace(recording, others={one["name"]: replace(recording, **on(one, f"{one['name']}_ideal")) for one in others})


def _columns(found: Mapping[str, Any], places: npt.NDArray[np.float64]) -> Table:
    fields = [("x_nm", "f4"), ("y_nm", "f4"), ("x_px", "f4"), ("y_px", "f4"), ("sites", "i4"), ("vacancies", "i4")]
    out = np.zeros(len(places), [*fields, ("substitutions", "i4"), ("composition", "U32")])
    out["x_nm"], out["y_nm"] = found["positions_nm"].reshape(-1, 2).T
    out["x_px"], out["y_px"] = places.T
    out["sites"], out["vacancies"], out["substitutions"] = found["counts"].reshape(-1, 3).T
    out["composition"] = found["compositions"]
    return Table(out)
