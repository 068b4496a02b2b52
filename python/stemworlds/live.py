"""Live worlds: specimens in memory that are looked at, recorded, and changed by the electrons that record them."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import _core
from ._forking import Used
from ._running import Progress, call, running
from .images import Image
from .recipes import Acquisition, Difficulty, Recipe, RecipeLike
from .recording import Recording, _recording, recording_request
from .worlds import COLUMN_DTYPE, SITE_DTYPE, StructuredArray

#: Left, upper, right and lower edge in nm.
Region = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class LiveView:
    """What a look shows. Places are in nm in the field.

    Attributes:
        image: the noise-free image, in fractions of the beam.
        columns: columns in it, :data:`COLUMN_DTYPE`.
        sites: their sites, :data:`SITE_DTYPE`.
    """

    image: Image
    columns: StructuredArray
    sites: StructuredArray


class LiveWorld:
    """A world in memory, which recordings change as the table ``[damage]`` of its recipe says.

    The same recipe, seed and recordings give the same values, whatever the number of threads. The first world of a recipe fills
    the library of its mosaic; it is kept for all others. The more atoms ``most_dose`` may take away, the more images the library needs: those that
    come along serve SrTiO3 easy to 1e5 electrons per square Angstrom at once, and for the default of 1e6 a quarter of them is simulated, minutes on
    two free processors. ``progress=True`` shows how far it is. docs/live.md tells more.

    Threads may share a world: one call at a time works on it. A process that is forked while another thread uses the world has a copy that
    refuses all calls.

    Args:
        recipe: name, path, TOML, dict or :class:`Recipe`; ``**changes`` are ``difficulty``, ``set``, ``unset``, ``grid``, ``seed``.
        most_dose: the greatest dose that any place may get, in electrons per square Angstrom, all recordings together.

    Raises:
        InvalidValue: for a recipe or dose out of limits.
    """

    def __init__(
        self,
        recipe: RecipeLike,
        difficulty: Difficulty | None = None,
        *,
        most_dose: float = 1e6,
        cache: bool | str | os.PathLike[str] = True,
        threads: int | None = None,
        progress: Progress = False,
        **changes: Any,
    ) -> None:
        self._threads = threads
        toml = Recipe(recipe, difficulty, **changes).toml
        kept = cache if isinstance(cache, bool) else os.fspath(cache)
        options: _core.LiveOptions = {"toml": toml, "most_dose": most_dose, "cache": kept}
        self._field = call(_core.LiveField, options, running(threads, progress))
        self._used = Used("this live world", "make another LiveWorld in the child (restore takes it to a snapshot)")

    @property
    def recipe(self) -> Recipe:
        """The recipe, with its seed."""
        return Recipe(self._used.by(self._field.recipe)())

    def look(self, region_nm: Region) -> LiveView:
        """The noise-free image of a region (left, upper, right and lower edge) and what is there. It costs no electron."""
        found = self._used.by(call)(self._field.look, region_nm, running(self._threads, False))
        pixel, (x, y) = found["pixel_nm"], found["origin_nm"]
        image = Image("live", found["clean"], (pixel, pixel), (y, x))
        return LiveView(image, _columns(found), _sites(found))

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
        """Records a place, as :func:`stemworlds.acquire` does. Its electrons change the specimen when the recording has ended.

        Raises:
            InvalidValue: for a place that the beam leaves, and a dose beyond ``most_dose``. The world is then as it was.
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

    def columns(self, region_nm: Region) -> StructuredArray:
        """Columns in a region as they are now, :data:`COLUMN_DTYPE`."""
        return _columns(self._used.by(call)(self._field.truth, region_nm))

    def sites(self, region_nm: Region) -> StructuredArray:
        """Sites of these columns, vacant ones too, :data:`SITE_DTYPE`."""
        return _sites(self._used.by(call)(self._field.truth, region_nm))

    def dose(self, region_nm: Region) -> float:
        """Mean dose that a region has had, in electrons per square Angstrom."""
        return self._used.by(call)(self._field.dose, region_nm)

    @property
    def history(self) -> tuple[Mapping[str, Any], ...]:
        """All recordings: place, dose, current, electrons, time, and the atoms that each took away (``lost``)."""
        return tuple(json.loads(self._used.by(self._field.history)()))

    def snapshot(self) -> str:
        """This moment, as text (JSON), for :meth:`restore`."""
        return self._used.by(self._field.snapshot)()

    def restore(self, snapshot: str) -> None:
        """Goes to a moment of a world of the same recipe and seed.

        Raises:
            InvalidValue: for a snapshot of another world, or a text that is none.
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
