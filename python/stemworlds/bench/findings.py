"""The findings that an agent declares about a field."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import InvalidValue, _invalid

#: Value of a phase map without a prediction.
NO_PHASE = -1
#: Digits behind the point of a density in a report.
_DENSITY_DIGITS = 5


def _places(width: int) -> npt.NDArray[np.float64]:
    return np.zeros((0, width))


@dataclass(eq=False)
class Findings:
    """The findings of an agent about a field.

    An empty attribute declares that the field has none of these features. A task scores only the attributes that it needs.

    Attributes:
        counts: number of defects by type, ``{"vacancy": 3}``; ``None`` counts the places in ``defects``.
        defects: places ``(x, y)`` in nm, ``(N, 2)``, by type: ``"vacancy"``, ``"substitution"``. With ``None``, counts alone are scored.
        phases: int ``[row, column]``, phases of equal parts of the whole field, of any number; :data:`NO_PHASE` for parts without a
            prediction. ``None`` declares one phase.
        particles: ``(N, 3)``: x, y and diameter in nm.
        morphologies: shapes of the particles: ``"wulff"``, ``"icosahedral"``, ``"decahedral"``, ``"sphere"``.
        columns: ``(N, 3)``: x, y in nm, and a number that increases with the probability of a defect; for the scores by column.
        forecasts: ``(N, 2 + K)``: x, y in nm of a column, and the probabilities of 0, 1, ... defects in it, of all types together or of the
            target. The last one is the probability of ``K - 1`` or more defects. The strict tasks about defects score them.
        density: expected numbers of defects, all types together, ``[row, column]``, in equal parts of the whole field, of any number; for
            the task ``density-map``.
        rare: ``(N, 2)``: x, y in nm of places with far more defects than elsewhere; for the task ``rare``.
    """

    counts: Mapping[str, int] | None = None
    defects: Mapping[str, npt.ArrayLike] | None = None
    phases: npt.NDArray[np.integer[Any]] | None = None
    particles: npt.NDArray[np.float64] = field(default_factory=lambda: _places(3))
    morphologies: Sequence[str] = ()
    columns: npt.NDArray[np.float64] = field(default_factory=lambda: _places(3))
    forecasts: npt.NDArray[np.float64] = field(default_factory=lambda: _places(4))
    density: npt.NDArray[np.float64] | None = None
    rare: npt.NDArray[np.float64] = field(default_factory=lambda: _places(2))

    def report(self) -> str:
        """Returns the text (JSON) of a declaration.

        Raises:
            InvalidValue: for an array of a wrong shape.
        """
        out: dict[str, Any] = {}
        if self.counts is not None:
            out["counts"] = {kind: int(count) for kind, count in self.counts.items()}
        if self.defects is not None:
            out["defects"] = {kind: _listed("defects", places, 2) for kind, places in self.defects.items()}
        if self.phases is not None:
            out["phases"] = np.asarray(self.phases).astype(int).tolist()
        out["particles"] = _listed("particles", self.particles, 3)
        out["morphologies"] = list(self.morphologies)
        out["columns"] = _listed("columns", self.columns, 3)
        if len(self.forecasts):
            out["forecasts"] = forecasts_of(self.forecasts).tolist()
        if self.density is not None:
            out["density"] = np.round(density_of(self.density), _DENSITY_DIGITS).tolist()
        if len(self.rare):
            out["rare"] = _listed("rare", self.rare, 2)
        return json.dumps(out, separators=(",", ":"))

    @staticmethod
    def read(report: str) -> Findings:
        """Reads findings from a text that :meth:`report` wrote.

        Raises:
            InvalidValue: for a text that is no JSON object of findings.
        """
        try:
            found = json.loads(report)
            defects = found.get("defects")
            return Findings(
                counts=found.get("counts"),
                defects=None if defects is None else {kind: _array(places, 2) for kind, places in defects.items()},
                phases=None if found.get("phases") is None else np.array(found["phases"], dtype=np.int32),
                particles=_array(found.get("particles", ()), 3),
                morphologies=tuple(found.get("morphologies", ())),
                columns=_array(found.get("columns", ()), 3),
                forecasts=forecasts_of(found.get("forecasts", ())),
                density=None if found.get("density") is None else density_of(found["density"]),
                rare=_finite("rare", _array(found.get("rare", ()), 2)),
            )
        except InvalidValue:
            raise
        except (ValueError, TypeError, AttributeError) as error:
            raise _invalid("findings", f"findings: the text is no report: {error}") from None


def _array(values: Any, width: int) -> npt.NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64).reshape(-1, width)


def forecasts_of(values: Any) -> npt.NDArray[np.float64]:
    """Checks forecasts: at least two classes, and no negative probability."""
    array = np.asarray(values, dtype=np.float64)
    if array.size == 0:
        return _places(4)
    if array.ndim != 2 or array.shape[1] < 4:
        raise _invalid("findings", f"forecasts have shape {array.shape}: expected (N, 2 + K): x, y, and chances of 0, 1, ... defects, K = 2 at least")
    if not np.isfinite(array).all() or (array[:, 2:] < 0).any() or (array[:, 2:].sum(axis=1) <= 0).any():
        raise _invalid("findings", "forecasts: expected finite places, and chances that are not negative and not all 0")
    return array


def density_of(values: Any) -> npt.NDArray[np.float64]:
    """Checks a density map: at least one row and one column, and no negative number."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.size == 0:
        raise _invalid("findings", f"density has shape {array.shape}: expected (rows, columns) of equal parts of the field")
    if not np.isfinite(array).all() or (array < 0).any():
        raise _invalid("findings", "density: expected finite numbers of defects from 0 on")
    return array


def _finite(name: str, array: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    if not np.isfinite(array).all():
        raise _invalid("findings", f"{name}: expected finite places")
    return array


def _listed(name: str, values: npt.ArrayLike, width: int) -> list[list[float]]:
    array = np.asarray(values, dtype=np.float64)
    if array.size == 0:
        return []
    if array.ndim != 2 or array.shape[1] != width:
        raise _invalid("findings", f"{name} has shape {array.shape}: expected (N, {width})")
    listed: list[list[float]] = array.tolist()
    return listed
