"""Reads and changes recipes, which describe the specimen and the microscope of a world."""

from __future__ import annotations

import html
import json
import math
import os
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal

import numpy as np

from . import _core
from ._running import call
from .errors import _invalid

Difficulty = Literal["easy", "medium", "hard"]
Acquisition = Literal["ideal", "routine", "poor"]

#: Endings of files of atoms, from which a recipe can be made.
_ATOMS = (".xyz", ".extxyz", ".cif", ".vasp", ".poscar", ".contcar")


class Recipe(Mapping[str, Any]):
    """The description of a specimen and its microscope, resolved and checked.

    It reads as a dict, also with dotted keys: ``recipe["vacancies.rate"]``. It is immutable; :meth:`set` and :meth:`unset` return changed
    copies.

    Args:
        source: name of a shipped recipe (:func:`recipes`), path of a TOML file or of a file of atoms (``.xyz``, ``.extxyz``, ``.cif``,
            ``.vasp``, ``.poscar``), TOML text, a dict, or another recipe.
        difficulty: the tier, if the recipe has tiers.
        set: values to change, ``{"vacancies.rate": 0.02}``; ``None`` removes a key.
        unset: keys or tables to remove.
        grid: build the central tiles only, ``(rows, columns)``.
        seed: seed of all random numbers.
        acquisition: profile of a microscope whose errors the recording has: ``"ideal"``, ``"routine"``, ``"poor"``.

    Raises:
        InvalidValue: for a value out of its limits, an unknown key (the message names the most similar one), or a missing tier.
        FormatError, FileError: if the file of the recipe cannot be read.
    """

    def __init__(
        self,
        source: RecipeLike,
        difficulty: Difficulty | None = None,
        *,
        set: Mapping[str, Any] | None = None,
        unset: Iterable[str] = (),
        grid: tuple[int, int] | None = None,
        seed: int | None = None,
        acquisition: Acquisition | None = None,
    ) -> None:
        changes = [*unset, *(_assignment(key, value) for key, value in (set or {}).items())]
        if isinstance(unset, str):
            raise _invalid("unset", f"unset = {unset!r}: expected a list of keys")
        made: _core.RecipeChanges = {
            "set": changes,
            "grid": None if grid is None else _grid(grid),
            "seed": seed,
            "acquisition": acquisition,
        }
        #: The resolved recipe as TOML, from which an equal recipe can be read.
        self.toml: str = call(_core.resolve_recipe, _source(source, difficulty), made)
        self._values: dict[str, Any] = tomllib.loads(self.toml)
        self._facts: dict[str, Any] = json.loads(_core.describe_recipe(self.toml))

    def set(self, changes: Mapping[str, Any] | str, value: Any = None) -> Recipe:
        """Returns a copy with changed values: ``set("vacancies.rate", 0.02)`` or ``set({"vacancies.rate": 0.02, ...})``."""
        return Recipe(self, set={changes: value} if isinstance(changes, str) else changes)

    def unset(self, *keys: str) -> Recipe:
        """Returns a copy without some keys or tables."""
        return Recipe(self, unset=keys)

    def with_grid(self, rows: int, columns: int) -> Recipe:
        """Returns a copy that builds the central tiles only."""
        return Recipe(self, grid=(rows, columns))

    def with_seed(self, seed: int) -> Recipe:
        """Returns a copy with another seed of all random numbers."""
        return Recipe(self, seed=seed)

    def __getitem__(self, key: str) -> Any:
        found: Any = self._values
        for part in key.split("."):
            if not isinstance(found, dict) or part not in found:
                raise KeyError(key)
            found = found[part]
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Recipe) and self.toml == other.toml

    def __hash__(self) -> int:
        return hash(self.toml)

    def __reduce__(self) -> tuple[type[Recipe], tuple[str]]:
        return Recipe, (self.toml,)

    @property
    def id(self) -> str:
        """The identifier of the material."""
        return str(self._facts["id"])

    @property
    def tier(self) -> str | None:
        """The tier; ``None`` for a recipe without tiers."""
        tier: str | None = self._facts["tier"]
        return tier

    @property
    def seed(self) -> int:
        """Seed of all random numbers."""
        return int(self._facts["seed"])

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of tiles that are built."""
        rows, columns = self._facts["grid"]
        return rows, columns

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the built field in pixels."""
        height, width = self._facts["shape"]
        return height, width

    @property
    def pixel_nm(self) -> float:
        """Edge of a pixel in nm."""
        return float(self._facts["pixel_nm"])

    @property
    def fov_nm(self) -> tuple[float, float]:
        """Height and width of the built field in nm."""
        height, width = self._facts["fov_nm"]
        return height, width

    @property
    def dose(self) -> float:
        """Electrons per square Angstrom."""
        return float(self._facts["dose_electrons_per_angstrom2"])

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Writes the resolved recipe as TOML."""
        _core.write_file(os.fspath(path), self.toml.encode(), overwrite)

    def __repr__(self) -> str:
        tier = f", {self.tier}" if self.tier else ""
        rows, columns = self.grid
        return f"<Recipe {self.id}{tier}: {rows} x {columns} tiles, seed {self.seed}>"

    def _repr_html_(self) -> str:
        return f"<details><summary>{html.escape(repr(self))}</summary><pre>{html.escape(self.toml)}</pre></details>"


#: The sources of a recipe, see :class:`Recipe`.
RecipeLike = Recipe | Mapping[str, Any] | str | os.PathLike[str]


def recipes() -> dict[str, tuple[str, ...]]:
    """Returns the names of the shipped recipes, and the tiers of each."""
    return {name: tuple(tiers) for name, tiers in _core.recipes()}


def _source(source: RecipeLike, difficulty: Difficulty | None) -> _core.RecipeSource:
    out: _core.RecipeSource = {"name": None, "path": None, "text": None, "difficulty": difficulty}
    if isinstance(source, Recipe):
        if difficulty is not None:
            raise _invalid("difficulty", "the recipe has been resolved; leave the difficulty out")
        out["text"] = source.toml
    elif isinstance(source, Mapping):
        out["text"] = "".join(f"{_key(key)} = {_toml(key, value)}\n" for key, value in source.items())
    elif isinstance(source, os.PathLike):
        out["path"] = os.fspath(source)
    elif not isinstance(source, str):
        raise _invalid("recipe", f"recipe = {type(source).__name__}: expected a name, a path, TOML, a dict or a Recipe")
    elif "\n" in source or "=" in source:
        out["text"] = source
    elif source.lower().endswith((".toml", *_ATOMS)):
        out["path"] = source
    else:
        out["name"] = source
    return out


def _grid(grid: Any) -> tuple[int, int]:
    try:
        rows, columns = grid
        return int(rows), int(columns)
    except (TypeError, ValueError):
        raise _invalid("grid", f"grid = {grid!r}: expected (rows, columns)") from None


def _assignment(key: str, value: Any) -> str:
    return key if value is None else f"{key}={_toml(key, value)}"


def _key(key: str) -> str:
    plain = key.replace("_", "").replace("-", "")
    return key if plain.isascii() and plain.isalnum() else json.dumps(key)


def _toml(key: str, value: Any) -> str:
    """Writes a value as TOML on one line."""
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else str(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, Mapping):
        inner = (f"{_key(name)} = {_toml(name, item)}" for name, item in value.items() if item is not None)
        return "{ " + ", ".join(inner) + " }"
    if isinstance(value, Iterable):
        return "[" + ", ".join(_toml(key, item) for item in value) + "]"
    raise _invalid("set", f"{key} = {value!r}: no value of a recipe is a {type(value).__name__}")
