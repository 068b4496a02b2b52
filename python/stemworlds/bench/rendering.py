"""Draws and describes the state of an episode."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .episodes import Acquired, Episodes
from .findings import Findings

Picture = npt.NDArray[np.uint8]

_PANEL_PX = 384
_CURVE_PX = 120
_GAP_PX = 8
_GREY = (60, 60, 66)
_VISITED = (255, 190, 60)
_HERE = (80, 200, 255)
_TRUE = (70, 220, 110)
_FOUND = (255, 90, 90)


@dataclass(frozen=True)
class Scene:
    """The state of an episode that is drawn."""

    episodes: Episodes
    seen: Sequence[Acquired]
    findings: Findings | None

    def record(self) -> dict[str, object]:
        return self.episodes.record(0)


def picture(scene: Scene) -> Picture:
    """Draws an episode in three panels.

    Left: the field with the tiles acquired so far, on the overview of a world file. Right: the last tile with the truth (green) and the
    findings (red circles). Below: score against dose.
    """
    out = np.full((_PANEL_PX + _CURVE_PX + 3 * _GAP_PX, 2 * _PANEL_PX + 3 * _GAP_PX, 3), 24, np.uint8)
    left, right = _GAP_PX, 2 * _GAP_PX + _PANEL_PX
    out[_GAP_PX : _GAP_PX + _PANEL_PX, left : left + _PANEL_PX] = _map(scene)
    out[_GAP_PX : _GAP_PX + _PANEL_PX, right : right + _PANEL_PX] = _tile(scene)
    top = 2 * _GAP_PX + _PANEL_PX
    out[top : top + _CURVE_PX, left : right + _PANEL_PX] = _curve(scene, right + _PANEL_PX - left)
    return out


def text(scene: Scene) -> str:
    """Describes an episode in a few lines."""
    field = scene.episodes.field
    record = scene.episodes.record(0)
    rows, columns = field.grid
    marks = np.full((rows, columns), ".")
    for what in scene.seen:
        marks[what.row, what.column] = "o"
    if scene.seen:
        marks[scene.seen[-1].row, scene.seen[-1].column] = "@"
    metrics = record["metrics"]
    lines = ["".join(line) for line in marks]
    lines.append(f"{field.name}: {field.task}, {len(scene.seen)} tiles, {record['spent']:.0f} of {field.budget:.0f} e/A2")
    lines.append(f"score {scene.episodes.score(0):.3f}, DEC-AUC so far {metrics['dec_auc']:.3f}")
    if scene.findings is not None:
        counts = {kind: len(places) for kind, places in _by_kind(scene.findings)} or dict(scene.findings.counts or {})
        found = ", ".join(f"{count} {kind}" for kind, count in counts.items()) or "nothing"
        lines.append(f"declared: {found}; {len(scene.findings.particles)} particles")
    return "\n".join(lines)


def _by_kind(findings: Findings) -> Iterable[tuple[str, npt.NDArray[np.float64]]]:
    for kind, places in (findings.defects or {}).items():
        yield kind, np.asarray(places, dtype=np.float64).reshape(-1, 2)


def _colours(image: npt.NDArray[np.float32], shape: tuple[int, int]) -> Picture:
    """Returns the grey values of an image, resampled to ``shape``, with contrast from the 1st to the 99.5th percentile."""
    low, high = np.percentile(image, [1, 99.5])
    grey = np.clip((image - low) / max(float(high - low), 1e-9), 0, 1)
    rows, columns = (np.arange(n) * edge // n for n, edge in zip(shape, image.shape, strict=True))
    values = (255 * grey[np.ix_(rows, columns)]).astype(np.uint8)
    return np.repeat(values[:, :, None], 3, axis=2)


def _map(scene: Scene) -> Picture:
    field = scene.episodes.field
    rows, columns = field.grid
    out = np.full((_PANEL_PX, _PANEL_PX, 3), _GREY, np.uint8)
    per_tile = _PANEL_PX / max(rows, columns)

    def box(row: int, column: int) -> tuple[int, int, int, int]:
        return round(row * per_tile), round((row + 1) * per_tile), round(column * per_tile), round((column + 1) * per_tile)

    _, bottom, _, end = box(rows - 1, columns - 1)
    out[bottom:], out[:, end:] = 24, 24
    overview = scene.episodes.whole_overview()
    if overview is not None:
        # The overview is half as bright as the acquired tiles, so that these stand out.
        out[:bottom, :end] = _colours(overview, (bottom, end)) // 2
    images = [what.image for what in scene.seen]
    if images:
        low, high = np.percentile(np.stack(images), [1, 99.5])
        for what in scene.seen:
            top, below, first, last = box(what.row, what.column)
            grey = np.clip((what.image - low) / max(float(high - low), 1e-9), 0, 1)
            at = np.arange(below - top) * grey.shape[0] // max(below - top, 1)
            across = np.arange(last - first) * grey.shape[1] // max(last - first, 1)
            out[top:below, first:last] = (255 * grey[np.ix_(at, across)]).astype(np.uint8)[:, :, None]
            _frame(out, (top, below, first, last), _VISITED)
        _frame(out, box(scene.seen[-1].row, scene.seen[-1].column), _HERE)
    return out


def _frame(out: Picture, box: tuple[int, int, int, int], colour: tuple[int, int, int]) -> None:
    top, bottom, left, right = box
    out[top:bottom, [left, max(right - 1, left)]] = colour
    out[[top, max(bottom - 1, top)], left:right] = colour


def _tile(scene: Scene) -> Picture:
    if not scene.seen:
        return np.full((_PANEL_PX, _PANEL_PX, 3), _GREY, np.uint8)
    last = scene.seen[-1]
    out = _colours(last.image, (_PANEL_PX, _PANEL_PX))
    per_nm = _PANEL_PX / last.size_nm

    def place(positions: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        at: npt.NDArray[np.float64] = (positions - np.asarray(last.centre_nm)) * per_nm + _PANEL_PX / 2
        return at

    truth = scene.episodes.truth_seen(0)
    for _, places in _by_kind(truth):
        for x, y in np.unique(place(places).round(), axis=0):
            _ring(out, x, y, 2, _TRUE)
    if scene.findings is not None:
        for _, places in _by_kind(scene.findings):
            for x, y in np.unique(place(places).round(), axis=0):
                _ring(out, x, y, 6, _FOUND)
        for particle in scene.findings.particles:
            (x, y), radius = place(particle[None, :2])[0], particle[2] / 2 * per_nm
            _ring(out, x, y, radius, _FOUND)
    for x, y, diameter in truth.particles:
        at = place(np.array([[x, y]]))[0]
        _ring(out, at[0], at[1], diameter / 2 * per_nm, _TRUE)
    return out


def _ring(out: Picture, x: float, y: float, radius: float, colour: tuple[int, int, int]) -> None:
    angles = np.linspace(0, 2 * np.pi, max(int(8 * radius), 12))
    columns = np.round(x + radius * np.cos(angles)).astype(int)
    rows = np.round(y + radius * np.sin(angles)).astype(int)
    inside = (rows >= 0) & (rows < out.shape[0]) & (columns >= 0) & (columns < out.shape[1])
    out[rows[inside], columns[inside]] = colour


def _curve(scene: Scene, width: int) -> Picture:
    out = np.full((_CURVE_PX, width, 3), 40, np.uint8)
    for share in (0.25, 0.5, 0.75):
        out[:, int(share * (width - 1))] = _GREY
        out[int(share * (_CURVE_PX - 1)), :] = _GREY
    record = scene.episodes.record(0)
    spent = record["spent"] / scene.episodes.field.budget
    out[:, : int(spent * (width - 1)) + 1] += np.uint8(10)
    curve = np.array(record["curve"]).reshape(-1, 2)
    if len(curve):
        shares = np.linspace(0, 1, width)
        scores = np.interp(shares, curve[:, 0], curve[:, 1], left=0.0)
        known = (shares <= spent + 1e-9) if record["ended"] is None else np.ones(width, dtype=bool)
        rows = np.round((1 - scores) * (_CURVE_PX - 1)).astype(int)
        columns = np.arange(width)[known]
        for offset in (0, 1):
            out[(rows[known] + offset).clip(0, _CURVE_PX - 1), columns] = _HERE
    return out
