"""An analyst that asks a vision-language model."""

from __future__ import annotations

import reprlib
import struct
import zlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .analysts import PlacedDefects, TileByTile, places_nm
from .endpoint import Endpoint, Unparsable, json_of
from .findings import Findings
from .peaks import Peaks, find_peaks

if TYPE_CHECKING:
    from .episodes import Acquired

__all__ = ["VisionLanguageAnalyst"]

Values = npt.NDArray[np.float64]

#: Most defects and phases in a valid reply. A tile has fewer atoms, and a field fewer phases.
_MOST_DEFECTS = 1000
_MOST_PHASES = 256
#: Largest distance, in pixels of the tile, between a defect in the reply and its atom.
_NEAR_PX = 8.0
_KINDS = ("vacancy", "substitution")


class VisionLanguageAnalyst(TileByTile):
    """Finds atoms by peaks, and asks a vision-language model for the defects among them, tile by tile.

    The tile is sent as a PNG of 256 x 256 pixels. A defect in the reply is moved to the nearest atom within 8 pixels, or keeps its place if
    there is none. An unreadable reply gives no findings, and is counted in the record of the episode.

    Args:
        endpoint: an OpenAI-compatible service with a model that accepts images.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint: Endpoint = endpoint

    def begin(self) -> None:
        self._defects = PlacedDefects()
        self._columns: list[Values] = []
        self._phases: dict[tuple[int, int], int] = {}
        self.unparsable: int = 0
        self._before = (self.endpoint.calls, self.endpoint.retried)

    def look(self, tile: Acquired) -> None:
        peaks = find_peaks(tile.image.astype(np.float64), tile.pixel_nm)
        try:
            said = self.endpoint.ask(_INSTRUCTIONS, _QUESTION, png=png_of(tile.image), read=_read)
        except Unparsable:
            self.unparsable += 1
            said = {"defects": [], "phase": None}
        score = np.zeros(len(peaks.intensity))
        for kind in _KINDS:
            named = [defect for defect in said["defects"] if defect[0] == kind]
            if named:
                self._defects.add(kind, self._placed(named, peaks, score, tile))
        self._columns.append(np.column_stack([places_nm(peaks, tile), score]))
        if said["phase"] is not None:
            self._phases[tile.row, tile.column] = said["phase"]

    def _placed(self, named: list[tuple[str, float, float]], peaks: Peaks, score: Values, tile: Acquired) -> Values:
        """Returns the places (N, 2) of the defects of one kind, and marks their atoms."""
        rows, columns = np.array([d[1] for d in named]), np.array([d[2] for d in named])
        for number, (row, column) in enumerate(zip(rows, columns, strict=True)):
            if score.size:
                apart = np.hypot(peaks.row_px - row, peaks.column_px - column)
                nearest = int(apart.argmin())
                if apart[nearest] <= _NEAR_PX:
                    score[nearest] = 1.0
                    rows[number], columns[number] = peaks.row_px[nearest], peaks.column_px[nearest]
        return places_nm(Peaks(rows, columns, np.zeros(len(rows))), tile)

    def summary(self) -> Findings:
        phases = None
        if len(set(self._phases.values())) > 1:
            phases = np.full(self.field.grid, -1, dtype=np.int64)
            for place, phase in self._phases.items():
                phases[place] = phase
        columns = np.concatenate([np.zeros((0, 3)), *self._columns])
        return Findings(counts=None, defects=self._defects.arrays(), phases=phases, columns=columns)

    def notes(self) -> dict[str, float]:
        """Returns numbers for the record of the episode."""
        calls, retried = self._before
        return {
            "model_calls": self.endpoint.calls - calls,
            "model_retries": self.endpoint.retried - retried,
            "model_unparsable": self.unparsable,
        }


def _read(reply: str) -> dict[str, Any]:
    """Reads the defects as (kind, row, column), and the phase, from a reply."""
    told = json_of(reply)
    defects = told.get("defects", [])
    if not isinstance(defects, list) or len(defects) > _MOST_DEFECTS:
        raise ValueError(f"defects is no list of at most {_MOST_DEFECTS}")
    found = []
    for defect in defects:
        if not isinstance(defect, Mapping) or defect.get("type") not in _KINDS:
            raise ValueError(f"{reprlib.repr(defect)} is no defect")
        row, column = float(defect["row"]), float(defect["col"])
        if not (0 <= row <= 127 and 0 <= column <= 127):
            raise ValueError(f"row {row}, col {column}: outside of the tile")
        found.append((str(defect["type"]), row, column))
    phase = told.get("phase")
    if isinstance(phase, bool) or not isinstance(phase, int) or not 0 <= phase < _MOST_PHASES:
        phase = None
    return {"defects": found, "phase": phase}


def png_of(image: npt.NDArray[np.float32], times: int = 2) -> bytes:
    """Returns a grey PNG of an image in [0, 1], with each pixel enlarged ``times`` times."""
    grey = np.clip(np.rint(image * 255), 0, 255).astype(np.uint8).repeat(times, axis=0).repeat(times, axis=1)
    height, width = grey.shape
    rows = np.zeros((height, width + 1), dtype=np.uint8)
    rows[:, 1:] = grey

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes())) + chunk(b"IEND", b"")


_INSTRUCTIONS = """You find defects in dark-field images of a scanning transmission electron microscope. Bright spots are columns of atoms;
heavier atoms are brighter. A vacancy is a spot of the lattice that is missing or much darker than its like. A substitution is a spot that is
much brighter than its like. The image is a tile of 128 x 128 pixels, enlarged. Reply with one JSON object and nothing else."""
_QUESTION = """Which atoms of this tile are defects? Reply as
{"defects": [{"row": <0 to 127>, "col": <0 to 127>, "type": "vacancy" or "substitution"}], "phase": <whole number>}
with rows and columns of the tile of 128 x 128 pixels. An empty list says that there are none. Name only those you are sure of."""
