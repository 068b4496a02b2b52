"""Converts fields, which are worlds or recipes, for the extension."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from . import _core
from .errors import _invalid
from .recipes import Recipe, RecipeLike, _assignment
from .worlds import World

#: A world, its path, or a recipe.
FieldLike = World | RecipeLike

_WORLDS = (".h5", ".hdf5")


def world_path(field: FieldLike) -> str | None:
    """Returns the path of a world; ``None`` for a recipe."""
    if isinstance(field, World):
        return field.path
    if isinstance(field, (str, os.PathLike)) and os.fspath(field).lower().endswith(_WORLDS):
        return os.fspath(field)
    return None


def field_options(
    field: FieldLike, changes: Mapping[str, Any], acquisition: Mapping[str, Any] | None = None
) -> _core.FieldOptions:
    """Returns a field in the extension's form. ``changes`` are changes of a recipe; ``acquisition`` changes values of the recording."""
    recording = [_assignment(f"acquisition.{key}", value) for key, value in (acquisition or {}).items()]
    world = world_path(field)
    if world is not None:
        if changes:
            name = sorted(changes)[0]
            raise _invalid(name, f"{world}: a world has its recipe; leave {name} out")
        return {"toml": None, "world": world, "acquisition": recording}
    assert not isinstance(field, World)
    difficulty = changes.get("difficulty")
    more = {key: value for key, value in changes.items() if key != "difficulty"}
    return {"toml": Recipe(field, difficulty, **more).toml, "world": None, "acquisition": recording}
