"""Draws worlds and recipes as pictures and pages."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, Literal

from . import _core
from ._fields import FieldLike, world_path
from ._running import call, running
from .errors import _invalid
from .recipes import Recipe
from .worlds import World

Overlay = Literal["defects", "phases", "boundaries", "particles", "columns"]


def view(
    field: FieldLike,
    *,
    out: str | os.PathLike[str],
    region_nm: tuple[float, float, float, float] | None = None,
    clean: bool = False,
    colormap: Literal["gray", "viridis", "inferno", "magma"] = "gray",
    contrast: tuple[float, float] = (0.1, 99.9),
    overlays: Sequence[Overlay] = (),
    size: int = 1600,
    overwrite: bool = False,
    threads: int | None = None,
    **recipe: Any,
) -> str:
    """Draws a world or a part of it as a picture, or as a page for the browser. For a recipe it draws the projected specimen.

    Args:
        field: a :class:`World`, its path, or a recipe.
        out: a picture (``.png``), or a page (``.html``) that zooms to single atoms and needs no network.
        region_nm: the drawn region, left, upper, right and lower edge. A page shows it first.
        clean: draw the noise-free image, for a world built with ``keep_clean=True``.
        contrast: percentiles of the image that become the first and the last colour.
        overlays: the parts of the truth that are drawn over the image.
        size: longest side of a picture in pixels.
        **recipe: ``difficulty``, ``set``, ``unset``, ``grid``, ``seed`` of a recipe.

    Returns:
        The path of the file.
    """
    path = os.fspath(out)
    html = path.lower().endswith((".html", ".htm"))
    if not html and not path.lower().endswith(".png"):
        raise _invalid("out", f"{path}: a picture ends in .png, a page in .html")
    run = running(threads, False)
    world = world_path(field)
    if world is None:
        if html or region_nm is not None or clean:
            raise _invalid("field", "of a recipe the specimen is drawn as a whole, as PNG; build the world for more")
        assert not isinstance(field, World)
        difficulty = recipe.pop("difficulty", None)
        if os.path.exists(path) and not overwrite:
            _core.write_file(path, b"", False)
        call(_core.draw_recipe, Recipe(field, difficulty, **recipe).toml, path, run)
        return path
    if recipe:
        name = sorted(recipe)[0]
        raise _invalid(name, f"{world}: a world has its recipe; leave {name} out")
    options: _core.ViewOptions = {
        "world": world,
        "out": path,
        "html": html,
        "region_nm": region_nm,
        "clean": clean,
        "colormap": colormap,
        "contrast": contrast,
        "overlays": [overlays] if isinstance(overlays, str) else list(overlays),
        "size": size,
        "overwrite": overwrite,
    }
    call(_core.view_world, options, run)
    return path
