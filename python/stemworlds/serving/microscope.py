"""The simulated microscope: the verbs for clients, and its state."""

from __future__ import annotations

import inspect
import json
import math
import re
import reprlib
import threading
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from ..live import LiveWorld
from ..recipes import Acquisition, Recipe
from .messages import Answer

Arguments = Mapping[str, str]

#: Longest frame in s, as in asyncroscopy's own server.
LONGEST_FRAME_S = 600.0
#: Limits of the time on a pixel in s. A longer exposure by the resting beam is recorded in parts.
DWELL_S = (1e-8, 1.0)
#: Limits of the edge of a pixel in Angstrom.
PIXEL_ANGSTROM = (1e-3, 100.0)
#: Limits of the current of the beam in pA.
CURRENT_PA = (1e-3, 1e6)
#: Least field of view in Angstrom. The greatest one is the specimen.
LEAST_FOV_ANGSTROM = 1.0
#: Edge in nm of the square that a resting beam exposes.
BEAM_NM = 0.1
#: Limits of the number of rows and columns of an image.
SIZES = (8, 4096)
#: Arguments of the verbs that change the state or record. They are checked, since a misspelt name would silently use the default.
_TAKES = {
    "set_stage": {"x", "y", "z", "a", "b", "relative"},
    "set_fov": {"fov"},
    "set_current": {"current"},
    "set_beam_current": {"current"},
    "get_scanned_image": {"scanning_detector", "detector", "size", "dwell_time"},
    "place_beam": {"x", "y", "beam_pos"},
    "unblank_beam": {"duration", "dwell_time"},
}


class Microscope:
    """A microscope with a specimen that its electrons change. Its calls run one after the other.

    Every public method except :meth:`answer` is a verb. The units are asyncroscopy's: the stage is in m, the field of view in Angstrom,
    currents are in pA, times in s, and the beam is in fractions of the field of view.

    Args:
        world: the specimen.
        profile: profile with the errors of scan and detector: ``"ideal"``, ``"routine"``, ``"poor"``.
        fov_angstrom: edge of the field of view.
        current_pa: current of the beam.

    Raises:
        ValueError: for a field of view larger than the specimen, and a current out of limits.
    """

    def __init__(self, world: LiveWorld, *, profile: Acquisition = "ideal", fov_angstrom: float = 50.0, current_pa: float = 20.0) -> None:
        self._world = world
        self._profile = profile
        self._size_nm = specimen_size_nm(world.recipe)
        self._stage_m = np.zeros(5)
        self._fov_angstrom = checked_fov(fov_angstrom)
        self._current_pa = checked_current(current_pa)
        view_nm(self._size_nm, self._stage_m, self._fov_angstrom)
        self._beam = (0.5, 0.5)
        self._blanked = True
        self._busy = threading.Lock()

    def answer(self, verb: str, arguments: Arguments) -> Answer:
        """Executes a verb. Returns its answer.

        Raises:
            ValueError: for an unknown verb, and for invalid or missing arguments. The message is sent to the client.
        """
        does = self._verbs().get(verb)
        if does is None:
            raise ValueError(f"unknown verb {reprlib.repr(verb)}; discover_commands lists all verbs")
        takes = _TAKES.get(verb, set(arguments))
        unknown = sorted(set(arguments) - takes)
        if unknown:
            raise ValueError(f"{verb} takes no {unknown[0]!r}; it takes {', '.join(sorted(takes))}")
        if verb == "get_status":
            # The status is available while another call runs.
            return does(arguments)
        with self._busy:
            return does(arguments)

    def _verbs(self) -> dict[str, Callable[[Arguments], Answer]]:
        own = {"answer"}
        return {name: getattr(self, name) for name in dir(self) if not name.startswith("_") and name not in own}

    def connect(self, arguments: Arguments) -> Answer:
        """Confirms the connection to the microscope. Addresses from clients are ignored."""
        return f"Connected to a simulated microscope: {self._world.recipe['id']}"

    connect_AS = connect

    def set_routing_table(self, arguments: Arguments) -> Answer:
        """Accepts and ignores a routing table, since one server executes all verbs."""
        return "Routing table is not needed: one server answers all"

    def discover_commands(self, arguments: Arguments) -> Answer:
        """Returns the names of all verbs, as JSON."""
        return json.dumps(sorted(self._verbs()))

    def get_help(self, arguments: Arguments) -> Answer:
        """Returns the description of ``command_name``, as JSON."""
        name = arguments.get("command_name", "")
        if name not in self._verbs():
            return json.dumps({"error": f"unknown verb {name!r}"})
        doc = inspect.getdoc(getattr(self, name)) or ""
        return json.dumps({"name": name, "summary": doc.split("\n")[0], "doc": doc})

    def get_status(self, arguments: Arguments) -> Answer:
        """Returns whether the microscope is busy or ready."""
        return "Microscope is Busy" if self._busy.locked() else "Microscope is Ready"

    def get_stage(self, arguments: Arguments) -> Answer:
        """Returns x, y, z in m and the two tilts in rad, float32. (0, 0) is the centre of the specimen."""
        return self._stage_m.astype(np.float32)

    def set_stage(self, arguments: Arguments) -> Answer:
        """Moves the stage to ``x`` and ``y`` in m, or by these distances with ``relative=True``.

        The field of view has to stay on the specimen.
        """
        x, y = (_number(arguments, key, default=math.nan) for key in ("x", "y"))
        relative = _flag(arguments, "relative")
        moved = self._stage_m.copy()
        for axis, value in enumerate((x, y)):
            if not math.isnan(value):
                moved[axis] = value + (moved[axis] if relative else 0.0)
        if any(_number(arguments, key, default=0.0) for key in ("z", "a", "b")):
            raise ValueError("z, a, b: the specimen is thin and flat: only x and y move it")
        view_nm(self._size_nm, moved, self._fov_angstrom)
        self._stage_m = moved
        return f"Stage moved to {moved[0]:.4e}, {moved[1]:.4e} m"

    def set_fov(self, arguments: Arguments) -> Answer:
        """Sets the edge of the field of view, ``fov`` in Angstrom."""
        fov = checked_fov(_number(arguments, "fov"))
        view_nm(self._size_nm, self._stage_m, fov)
        self._fov_angstrom = fov
        return f"FOV set to {fov} A"

    def get_fov(self, arguments: Arguments) -> Answer:
        """Returns the edge of the field of view in Angstrom."""
        return np.array([self._fov_angstrom], dtype=np.float32)

    def set_current(self, arguments: Arguments) -> Answer:
        """Sets the current of the beam, ``current`` in pA."""
        current = checked_current(_number(arguments, "current"))
        self._current_pa = current
        return f"Beam current set to {current} pA"

    set_beam_current = set_current

    def get_current(self, arguments: Arguments) -> Answer:
        """Returns the current of the beam in pA."""
        return np.array([self._current_pa], dtype=np.float32)

    get_beam_current = get_current

    def get_scanned_image(self, arguments: Arguments) -> Answer:
        """Records the field of view: ``size`` x ``size`` pixels, ``dwell_time`` in s, ``scanning_detector`` (or ``detector``) HAADF.

        The dose is current x dwell time / pixel area, and changes the specimen. The answer is float32, in counts of the detector.
        """
        detector = arguments.get("scanning_detector", arguments.get("detector", "HAADF"))
        if detector.upper() != "HAADF":
            raise ValueError(f"detector {detector!r}: this microscope has HAADF")
        given, dwell_s = _number(arguments, "size", default=512), _number(arguments, "dwell_time", default=2e-6)
        size = int(given)
        if size != given or not SIZES[0] <= size <= SIZES[1]:
            raise ValueError(f"size={given:g}: expected a whole number from {SIZES[0]} to {SIZES[1]}, pixels along an edge")
        pixel = self._fov_angstrom / size
        if not PIXEL_ANGSTROM[0] <= pixel <= PIXEL_ANGSTROM[1]:
            raise ValueError(
                f"size={size}: pixels of {pixel:.3g} A in a field of view of {self._fov_angstrom:g} A; expected {PIXEL_ANGSTROM[0]:g} to {PIXEL_ANGSTROM[1]:g} A"
            )
        longest = min(DWELL_S[1], LONGEST_FRAME_S / size**2)
        if not DWELL_S[0] <= dwell_s <= longest:
            raise ValueError(
                f"dwell_time={dwell_s}: expected {DWELL_S[0]:g} to {longest:.3g} s for {size} x {size} pixels, which may take {LONGEST_FRAME_S:.0f} s together"
            )
        return self._recorded(self._view_nm(), size, dwell_s)

    def get_dose(self, arguments: Arguments) -> Answer:
        """Returns the mean dose of the field of view so far, in electrons per square Angstrom."""
        dose = self._world.dose(self._view_nm())
        return np.array([dose], dtype=np.float32)

    def place_beam(self, arguments: Arguments) -> Answer:
        """Moves the resting beam to ``x``, ``y`` (or ``beam_pos=(x,y)``) in fractions of the field of view. The beam stays blanked."""
        if "beam_pos" in arguments:
            x, y = _pair(arguments["beam_pos"])
        else:
            x, y = _number(arguments, "x"), _number(arguments, "y")
        if not (0 <= x <= 1 and 0 <= y <= 1):
            raise ValueError(f"{x}, {y}: expected fractions of the field of view, from 0 to 1")
        self._beam = (x, y)
        return f"Beam moved to {x}, {y}"

    def unblank_beam(self, arguments: Arguments) -> Answer:
        """Exposes the specimen to the resting beam for ``duration`` (or ``dwell_time``) seconds, and blanks the beam again."""
        given = arguments.get("duration", arguments.get("dwell_time"))
        if given is None:
            raise ValueError("duration: say for how many seconds; a simulated beam does not wait for the next command")
        duration = _float("duration", given)
        if not DWELL_S[0] <= duration <= LONGEST_FRAME_S:
            raise ValueError(f"duration={duration}: expected {DWELL_S[0]:g} to {LONGEST_FRAME_S:.0f} s")
        left, top, right, bottom = self._view_nm()
        x, y = left + self._beam[0] * (right - left), top + self._beam[1] * (bottom - top)
        half = 0.5 * BEAM_NM
        parts = math.ceil(duration / DWELL_S[1])
        self._recorded((x - half, y - half, x + half, y + half), 1, duration / parts, parts)
        return f"Beam unblanked for {duration} s"

    def blank_beam(self, arguments: Arguments) -> Answer:
        """Blanks the beam. Between commands it is always blanked."""
        return "Beam blanked"

    def _recorded(
        self, region_nm: tuple[float, float, float, float], size: int, dwell_s: float, frames: int | None = None
    ) -> npt.NDArray[np.float32]:
        recording = self._world.acquire(
            region_nm=region_nm,
            pixel_nm=(region_nm[2] - region_nm[0]) / size,
            current_pa=self._current_pa,
            dwell_us=1e6 * dwell_s,
            frames=frames,
            profile=self._profile,
        )
        return recording.array.astype(np.float32)

    def _view_nm(self) -> tuple[float, float, float, float]:
        return view_nm(self._size_nm, self._stage_m, self._fov_angstrom)


def checked_fov(fov_angstrom: float) -> float:
    """Checks a field of view. Returns it.

    Raises:
        ValueError: for a value out of its limits, or no number.
    """
    if not fov_angstrom >= LEAST_FOV_ANGSTROM:
        raise ValueError(f"fov={fov_angstrom}: expected {LEAST_FOV_ANGSTROM:g} Angstrom or more, within the specimen")
    return fov_angstrom


def checked_current(current_pa: float) -> float:
    """Checks a current. Returns it.

    Raises:
        ValueError: for a value out of its limits, or no number.
    """
    low, high = CURRENT_PA
    if not low <= current_pa <= high:
        raise ValueError(f"current={current_pa}: expected {low:g} to {high:g} pA")
    return current_pa


def specimen_size_nm(recipe: Recipe) -> tuple[float, float]:
    """Returns width and height of a recipe's field, in nm."""
    rows, columns = recipe.grid
    tile, overlap = recipe["field.tile_px"], recipe["field.overlap_px"]
    width, height = ((n * (tile - overlap) + overlap) * recipe.pixel_nm for n in (columns, rows))
    return width, height


def view_nm(size_nm: tuple[float, float], stage_m: npt.NDArray[np.float64], fov_angstrom: float) -> tuple[float, float, float, float]:
    """Returns the field of view on a specimen, in nm: left, upper, right and lower edge.

    Raises:
        ValueError: if the field of view leaves the specimen.
    """
    half = 0.05 * fov_angstrom
    x, y = 0.5 * size_nm[0] + 1e9 * stage_m[0], 0.5 * size_nm[1] + 1e9 * stage_m[1]
    if not (half > 0 and x - half >= 0 and y - half >= 0 and x + half <= size_nm[0] and y + half <= size_nm[1]):
        raise ValueError(
            f"a field of view of {fov_angstrom} A at stage {stage_m[0]:.3e}, {stage_m[1]:.3e} m leaves the specimen, "
            f"which is {10 * size_nm[0]:.0f} x {10 * size_nm[1]:.0f} A"
        )
    return float(x - half), float(y - half), float(x + half), float(y + half)


def _number(arguments: Arguments, key: str, default: float | None = None) -> float:
    if key not in arguments:
        if default is None:
            raise ValueError(f"{key} is missing")
        return default
    return _float(key, arguments[key])


def _float(key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{key}={reprlib.repr(text)}: expected a number") from None
    if not math.isfinite(value):
        raise ValueError(f"{key}={reprlib.repr(text)}: expected a finite number")
    return value


def _flag(arguments: Arguments, key: str) -> bool:
    text = arguments.get(key, "false")
    if text.lower() not in ("true", "false", "1", "0"):
        raise ValueError(f"{key}={reprlib.repr(text)}: expected true or false")
    return text.lower() in ("true", "1")


#: Two numbers in brackets, in the notation of Python or JSON.
_PAIR = re.compile(r"[(\[]([^,()\[\]]+),([^,()\[\]]+),?[)\]]")


def _pair(text: str) -> tuple[float, float]:
    found = _PAIR.fullmatch(text)
    if found is None:
        raise ValueError(f"beam_pos={reprlib.repr(text)}: expected (x,y)")
    return _float("beam_pos", found[1]), _float("beam_pos", found[2])
