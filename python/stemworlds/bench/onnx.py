"""An analyst that runs trained networks in the ONNX format."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..errors import _invalid
from .analysts import PlacedDefects, TileByTile, entropy_bits, places_nm
from .findings import Findings
from .peaks import Peaks, find_peaks
from .onnx_session import opened

if TYPE_CHECKING:
    from .episodes import Acquired

__all__ = ["OnnxAnalyst"]

Values = npt.NDArray[np.float64]


class OnnxAnalyst(TileByTile):
    """Finds atoms and defects with any network that returns a score of each class for each pixel.

    The input of the network is float32 ``(1, 1, 128, 128)``, the tile of the observation in [0, 1]. Its output ``(1, classes, 128, 128)``
    contains logits or probabilities. Atoms are the maxima of one minus the background; each gets the class with the greatest probability at
    its place. A second output ``(1, phases)`` or ``(1, phases, 128, 128)`` gives the phase of the tile. The probabilities of several
    networks are averaged.

    Args:
        models: path of a network, or several paths.
        classes: names of the channels; the first is the background. ``vacancy`` and ``substitution`` are declared.
        output, phase_output: names of the outputs; by default the first output, and no phases.
        probabilities: the outputs are probabilities, not logits.
        least: the least probability of an atom.

    Raises:
        InvalidValue: when it runs, if the outputs of a network have a wrong shape, or contain values that are no numbers.
    """

    def __init__(
        self,
        models: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        *,
        classes: Sequence[str] = ("background", "pristine", "vacancy", "substitution"),
        output: str | None = None,
        phase_output: str | None = None,
        probabilities: bool = False,
        least: float = 0.5,
    ) -> None:
        paths = [models] if isinstance(models, str | os.PathLike) else list(models)
        if not paths or len(classes) < 2:
            raise _invalid("models or classes", "expected one network or more, and two classes or more")
        self.classes: tuple[str, ...] = tuple(classes)
        self.output: str | None = output
        self.phase_output: str | None = phase_output
        self.probabilities: bool = probabilities
        self.least: float = least
        self._networks = [_network(os.fspath(path), output, phase_output) for path in paths]

    def begin(self) -> None:
        self._defects = PlacedDefects()
        self._columns: list[Values] = []
        self._phases: dict[tuple[int, int], int] = {}
        self._uncertain: list[float] = []

    def look(self, tile: Acquired) -> None:
        chances, phase = self._run(tile.image)
        atom = 1 - chances[0]
        peaks = find_peaks(atom, tile.pixel_nm)
        row, column = np.rint(peaks.row_px).astype(int), np.rint(peaks.column_px).astype(int)
        there = atom[row, column] >= self.least
        peaks = Peaks(peaks.row_px[there], peaks.column_px[there], peaks.intensity[there])
        at = chances[:, row[there], column[there]]
        places, best = places_nm(peaks, tile), 1 + at[1:].argmax(axis=0)
        defect = np.zeros(len(places))
        for number, name in enumerate(self.classes):
            if name in ("vacancy", "substitution"):
                self._defects.add(name, places[best == number])
                defect += at[number]
        self._columns.append(np.column_stack([places, defect]))
        self._uncertain.append(float(entropy_bits(at).mean()) if at.shape[1] else 0.0)
        if phase is not None:
            self._phases[tile.row, tile.column] = phase

    def summary(self) -> Findings:
        phases = None
        if len(set(self._phases.values())) > 1:
            phases = np.full(self.field.grid, -1, dtype=np.int64)
            for place, phase in self._phases.items():
                phases[place] = phase
        columns = np.concatenate([np.zeros((0, 3)), *self._columns])
        return Findings(counts=None, defects=self._defects.arrays(), phases=phases, columns=columns)

    def uncertainty(self, tiles: Sequence[Acquired]) -> Values:
        """Returns the mean entropy of the classes at the atoms of each tile, in bits."""
        self._follow(tiles)
        return np.array(self._uncertain)

    def _run(self, image: npt.NDArray[np.float32]) -> tuple[Values, int | None]:
        """Runs the networks. Returns the probabilities (classes, y, x), and the phase of the tile."""
        taken = np.ascontiguousarray(image[np.newaxis, np.newaxis], dtype=np.float32)
        total: Values = np.zeros((len(self.classes), *image.shape))
        phases: Values = np.zeros(1)
        for session, wanted in self._networks:
            given = session.run(wanted, {session.get_inputs()[0].name: taken})
            scores = np.asarray(given[0][0], dtype=np.float64)
            if scores.shape != (len(self.classes), *image.shape):
                raise _invalid(
                    "classes", f"the network gives {scores.shape} for a tile of {image.shape}: expected {len(self.classes)} classes"
                )
            chances = scores if self.probabilities else _softmax(scores)
            total = total + _numbers(chances, "a score")
            if self.phase_output is not None:
                told = np.asarray(given[1][0], dtype=np.float64)
                told = told.reshape(len(told), -1)
                phases = phases + _numbers(told if self.probabilities else _softmax(told), "a phase").mean(axis=1)
        phase = None if self.phase_output is None else int(np.argmax(phases))
        return total / len(self._networks), phase


def _numbers(chances: Values, what: str) -> Values:
    """Returns the probabilities.

    Raises:
        InvalidValue: if one of them is no number.
    """
    if not np.isfinite(chances).all():
        raise _invalid("models", f"the network gives {what} that is no number (NaN or infinite); was its training sound?")
    return chances


def _softmax(scores: Values) -> Values:
    with np.errstate(invalid="ignore"):
        powers = np.exp(scores - scores.max(axis=0))
        result: Values = powers / powers.sum(axis=0)
    return result


def _network(path: str, output: str | None, phase_output: str | None) -> tuple[Any, list[str]]:
    """Opens a session on one thread. Returns it with the names of the outputs to compute."""
    session = opened(path)
    names = [given.name for given in session.get_outputs()]
    wanted = [names[0] if output is None else output, *([] if phase_output is None else [phase_output])]
    for name in wanted:
        if name not in names:
            raise _invalid("output or phase_output", f"{path}: no output {name!r}; it has {', '.join(names)}")
    return session, wanted
