"""Live worlds: specimens in memory that lose atoms where electrons record them."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _core
from ._forking import Used
from ._running import Progress, call, running
from .images import Image
from .patterns import DataCube, _cubes, _detector
from .recipes import Acquisition, Difficulty, Recipe, RecipeLike
from .recording import Recording, _recording, detector_names, recording_request
from .worlds import COLUMN_DTYPE, SITE_DTYPE, StructuredArray

#: Left, upper, right and lower edge in nm.
Region = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class LiveView:
    """The noise-free image and the truth of a region. Places are in nm in the field.

    Attributes:
        image: the noise-free image on the first detector, in fractions of the beam.
        columns: columns in the region, :data:`COLUMN_DTYPE`.
        sites: sites of these columns, :data:`SITE_DTYPE`.
        images: the images on all detectors by name, the first one first; a centre of mass is in mrad.
    """

    image: Image
    columns: StructuredArray
    sites: StructuredArray
    images: Mapping[str, Image]


class LiveWorld:
    """A world in memory. Recordings change it as the table ``[damage]`` of its recipe specifies.

    Recipe, seed and recordings determine all values. The number of threads has no effect. The first world of a recipe computes the library
    of its mosaic, which is cached for later worlds. The more atoms ``most_dose`` can remove, the more images the library needs. The
    supplied library contains all images for SrTiO3 easy up to 1e5 electrons per square Angstrom. For the default of 1e6, a quarter of the
    images has to be simulated, which takes minutes on two free processors. ``progress=True`` shows the progress. docs/live.md explains the
    model.

    Threads may share a world; its calls run one after the other. If a process is forked while another thread uses the world, the copy in
    the child refuses all calls.

    Args:
        recipe: name, path, TOML, dict or :class:`Recipe`. ``**changes`` are ``difficulty``, ``set``, ``unset``, ``grid``, ``seed``.
        most_dose: greatest total dose of a place, over all recordings, in electrons per square Angstrom.
        detectors: names of the detectors of its images and recordings, as in :func:`stemworlds.acquire`; by default all of the recipe.

    Raises:
        InvalidValue: for an invalid recipe, or a dose out of limits.
    """

    def __init__(
        self,
        recipe: RecipeLike,
        difficulty: Difficulty | None = None,
        *,
        most_dose: float = 1e6,
        detectors: Sequence[str] | None = None,
        cache: bool | str | os.PathLike[str] = True,
        threads: int | None = None,
        progress: Progress = False,
        **changes: Any,
    ) -> None:
        self._threads = threads
        toml = Recipe(recipe, difficulty, **changes).toml
        kept = cache if isinstance(cache, bool) else os.fspath(cache)
        options: _core.LiveOptions = {"toml": toml, "most_dose": most_dose, "cache": kept, "detectors": detector_names(detectors)}
        self._field = call(_core.LiveField, options, running(threads, progress))
        self._used = Used("this live world", "make another LiveWorld in the child (restore takes it to a snapshot)")

    @property
    def recipe(self) -> Recipe:
        """The recipe, with its seed."""
        return Recipe(self._used.by(self._field.recipe)())

    def look(self, region_nm: Region) -> LiveView:
        """Returns the noise-free images and the truth of a region (left, upper, right and lower edge). It does not change the specimen."""
        found = self._used.by(call)(self._field.look, region_nm, running(self._threads, False))
        pixel, (x, y) = found["pixel_nm"], found["origin_nm"]
        made = {name: Image(name, array, (pixel, pixel), (y, x), units) for name, units, array in found["images"]}
        image = replace(next(iter(made.values())), name="live")
        return LiveView(image, _columns(found), _sites(found), made)

    def acquire(
        self,
        *,
        region_nm: Region | None = None,
        at_nm: tuple[float, float] | None = None,
        zoom: float | None = None,
        pixel_nm: float | None = None,
        dose: float | None = None,
        current_pa: float | None = None,
        profile: Acquisition | None = None,
        dwell_us: float | None = None,
        frames: int | None = None,
        keep_frames: bool = False,
        progress: Progress = False,
    ) -> Recording:
        """Records a place on all detectors of the world, see :func:`stemworlds.acquire`. At the end of the recording, its electrons change the
        specimen, once for all detectors.

        Raises:
            InvalidValue: if the beam would leave the field, or the dose would exceed ``most_dose``. The world is then unchanged.
        """
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
        )
        recorded = self._used.by(call)(self._field.acquire, request, running(self._threads, progress))
        return _recording(recorded, keep_frames)

    def acquire_patterns(
        self,
        *,
        region_nm: Region | None = None,
        at_nm: tuple[float, float] | None = None,
        zoom: float | None = None,
        pixel_nm: float | None = None,
        dose: float | None = None,
        current_pa: float | None = None,
        dwell_us: float | None = None,
        pixels: int | None = None,
        max_angle_mrad: float | None = None,
        radial_mrad: float | None = None,
        mtf: float | npt.ArrayLike | None = None,
        coherent_tail: bool | None = None,
        progress: Progress = False,
    ) -> DataCube:
        """Records the diffraction pattern of every probe of a place (4D-STEM), with counted electrons.

        The place is chosen as in :meth:`acquire`, the detector as in :func:`stemworlds.simulate_patterns`. Patterns show the specimen as it
        is before the scan. At the end of the scan, its electrons change the specimen. The scan has no errors. Each probe is simulated, so a
        place of 64 x 64 probes takes minutes.

        Returns:
            The patterns, uint32. ``axes.origin_angstrom`` is the place (y, x) of the first probe in the field.

        Raises:
            InvalidValue: if a probe would be outside the field, if the dose would exceed ``most_dose``, or if there is carbon on the faces of
                the specimen, which patterns would leave out. The world is then unchanged.
            NotEnoughMemory: for more patterns than the memory holds.
        """
        request = recording_request(
            region_nm=region_nm,
            at_nm=at_nm,
            zoom=zoom,
            pixel_nm=pixel_nm,
            electrons_per_angstrom2=dose,
            current_pa=current_pa,
            dwell_us=dwell_us,
        )
        detector = _detector(pixels, max_angle_mrad, radial_mrad, mtf, coherent_tail)
        (cube,) = _cubes(self._used.by(call)(self._field.acquire_patterns, request, detector, running(self._threads, progress)))
        return cube

    def columns(self, region_nm: Region) -> StructuredArray:
        """Returns the present columns in a region, :data:`COLUMN_DTYPE`."""
        return _columns(self._used.by(call)(self._field.truth, region_nm))

    def sites(self, region_nm: Region) -> StructuredArray:
        """Returns the sites of the columns in a region, with vacant sites, :data:`SITE_DTYPE`."""
        return _sites(self._used.by(call)(self._field.truth, region_nm))

    def dose(self, region_nm: Region) -> float:
        """Returns the mean dose of a region so far, in electrons per square Angstrom."""
        return self._used.by(call)(self._field.dose, region_nm)

    @property
    def history(self) -> tuple[Mapping[str, Any], ...]:
        """Lists all recordings: place, dose, current, electrons, time, and the number of removed atoms (``lost``)."""
        return tuple(json.loads(self._used.by(self._field.history)()))

    def snapshot(self) -> str:
        """Returns the present state as text (JSON), for :meth:`restore`."""
        return self._used.by(self._field.snapshot)()

    def restore(self, snapshot: str) -> None:
        """Restores a state of a world with the same recipe and seed.

        Raises:
            InvalidValue: for a snapshot of another world, or a text that is no snapshot.
        """
        self._used.by(call)(self._field.restore, snapshot)


def _columns(found: Mapping[str, Any]) -> StructuredArray:
    out = np.zeros(len(found["compositions"]), COLUMN_DTYPE)
    out["x_nm"], out["y_nm"] = found["positions_nm"].reshape(-1, 2).T
    out["sites"], out["vacancies"], out["substitutions"] = found["counts"].reshape(-1, 3).T
    out["composition"] = found["compositions"]
    return out


def _sites(found: Mapping[str, Any]) -> StructuredArray:
    out = np.zeros(len(found["types"]), SITE_DTYPE)
    out["x_nm"], out["y_nm"], out["z_nm"] = found["site_positions_nm"].reshape(-1, 3).T
    out["type"], out["number"], out["column"] = found["types"], found["numbers"], found["site_columns"]
    out["defect"] = out["type"] != 0
    return out
