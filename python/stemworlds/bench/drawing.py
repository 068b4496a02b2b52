"""Draws the figures of the report page as SVG text, coloured by the page's style sheet."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.float64]

_WIDTH, _HEIGHT = 220, 132
_MOST_ABOVE = 4
_LEFT, _RIGHT, _TOP, _BOTTOM = 34, 6, 6, 20


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a panel: its heights at the common places, and a band around it."""

    name: str
    heights: Values
    low: Values | None = None
    high: Values | None = None
    role: str = "agent"


def panels(lines: Sequence[Line], places: Values, ticks: Mapping[str, float], about: str, identity: str) -> str:
    """Draws a panel for each line, with the other lines in grey. Floor and ceiling are dashed. A ceiling far above all lines is left out.

    Args:
        places: horizontal places of the heights, from 0 to 1.
        ticks: labels of the horizontal axis, and their places.
        identity: an identifier that is unique on the page.
    """
    top = _top(lines)
    lines = [line for line in lines if line.role != "ceiling" or float(np.nanmax(line.heights)) <= top]
    behind = "".join(f'<path class="{_kind(line)}" d="{_path(places, line.heights, top)}"/>' for line in lines)
    clip = f'<clipPath id="{identity}c"><rect x="{_LEFT}" y="{_TOP}" width="{_WIDTH - _LEFT - _RIGHT}" height="{_HEIGHT - _TOP - _BOTTOM}"/></clipPath>'
    scenery = f'<g id="{identity}">{_axes(ticks, top)}<g clip-path="url(#{identity}c)">{behind}</g></g>'
    shared = f'<svg class="shared" aria-hidden="true"><defs>{clip}{scenery}</defs></svg>'
    drawn = []
    for line in lines:
        band = ""
        if line.low is not None and line.high is not None:
            there, back = _points(places, line.low, top), _points(places[::-1], line.high[::-1], top)
            band = f'<path class="band" d="M{there}L{back}Z"/>'
        own = f'<g clip-path="url(#{identity}c)">{band}<path class="own" d="{_path(places, line.heights, top)}"/></g>'
        if len(places) < 12:
            dots = (f'<circle class="dot" cx="{x:.1f}" cy="{y:.1f}" r="2.5"/>' for x, y in _pixels(places, line.heights, top) if y > _TOP)
            own += "".join(dots)
        told = html.escape(f"{about}: {line.name}")
        picture = f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{told}"><use href="#{identity}"/>{own}</svg>'
        mark = "" if line.role == "agent" else f' <i class="role">{line.role}</i>'
        drawn.append(f"<figure><figcaption>{html.escape(line.name)}{mark}</figcaption>{picture}</figure>")
    return shared + f'<div class="panels">{"".join(drawn)}</div>'


def coverage(grid: tuple[int, int], visits: Values, name: str) -> str:
    """Draws a map of tiles. A darker tile was acquired in more episodes.

    Args:
        visits: share of the episodes that acquired each tile, (rows, columns).
    """
    rows, columns = grid
    paths = []
    for share in np.unique(visits[visits > 0]):
        squares = "".join(f"M{column} {row}h1v1h-1z" for row, column in np.argwhere(visits == share).tolist())
        paths.append(f'<path class="tile" fill-opacity="{0.15 + 0.85 * float(share):.2f}" d="{squares}"/>')
    field = f'<rect class="field" width="{columns}" height="{rows}"/>'
    told = html.escape(f"Tiles that {name} acquired")
    picture = f'<svg class="map" viewBox="0 0 {columns} {rows}" role="img" aria-label="{told}">{field}{"".join(paths)}</svg>'
    return f"<figure><figcaption>{html.escape(name)}</figcaption>{picture}</figure>"


def _kind(line: Line) -> str:
    return "other" if line.role == "agent" else line.role


def _top(lines: Sequence[Line]) -> float:
    """Returns a round height above all lines, except ceilings far above the others."""
    inside = [line for line in lines if line.role != "ceiling"]
    most = max((float(np.nanmax(line.heights if line.high is None else line.high)) for line in inside), default=0.0)
    highest = max(float(np.nanmax(line.heights)) for line in lines)
    # With a ceiling far above in the panel, the other lines would look flat.
    most = highest if highest <= _MOST_ABOVE * most or most <= 0 else most
    if most <= 0:
        return 1.0
    step = 10.0 ** math.floor(math.log10(most))
    return next(step * factor for factor in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if step * factor >= min(most * 1.02, 1.0) or factor == 10)


def _axes(ticks: Mapping[str, float], top: float) -> str:
    bottom, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT
    out = [f'<path class="axis" d="M{_LEFT} {_TOP}V{bottom}H{right}"/>']
    for share in (0.0, 0.5, 1.0):
        y = bottom - share * (bottom - _TOP)
        out.append(f'<path class="grid" d="M{_LEFT} {y:.1f}H{right}"/>')
        out.append(f'<text class="tick" x="{_LEFT - 4}" y="{y + 3:.1f}" text-anchor="end">{share * top:.3g}</text>')
    last = len(ticks) - 1
    for number, (label, place) in enumerate(ticks.items()):
        anchor = "start" if number == 0 and place < 0.05 else "end" if number == last and place > 0.95 else "middle"
        out.append(f'<text class="tick" x="{_LEFT + place * (right - _LEFT):.1f}" y="{_HEIGHT - 6}" text-anchor="{anchor}">{html.escape(label)}</text>')
    return "".join(out)


def _pixels(places: Values, heights: Values, top: float) -> list[tuple[float, float]]:
    bottom, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT
    return [
        (_LEFT + place * (right - _LEFT), bottom - height / top * (bottom - _TOP))
        for place, height in zip(places.tolist(), heights.tolist(), strict=True)
        if height == height
    ]


def _points(places: Values, heights: Values, top: float) -> str:
    return "L".join(f"{x:.1f} {y:.1f}" for x, y in _pixels(places, heights, top))


def _path(places: Values, heights: Values, top: float) -> str:
    return "M" + _points(places, heights, top)
