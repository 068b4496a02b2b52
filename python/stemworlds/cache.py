"""The simulations that worlds share, on disk.

Those of the package's own crystalline recipes come along in ``stemworlds-library``, a package of data (``pip install
stemworlds[library]``); they are only read, and looked for first. The cache keeps what is simulated beside these.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec

from . import _core
from ._running import Progress, call, running
from .errors import _invalid
from .recipes import Difficulty, Recipe, RecipeLike


_data = find_spec("stemworlds_library")
if _data is not None and _data.submodule_search_locations:
    _core.set_library(_data.submodule_search_locations[0])


@dataclass(frozen=True)
class Holding:
    """What the cache, or the library that comes along, holds of a material."""

    material: str
    images: int
    bytes: int


@dataclass(frozen=True)
class Filling:
    """What was done to the simulations that worlds of a recipe share.

    Attributes:
        images: how many they are.
        simulated: of them, simulated by this call.
        lacking: of them, still to be simulated, by other parts.
    """

    images: int
    simulated: int
    lacking: int


@dataclass(frozen=True)
class CacheVerification:
    """Whether the simulations in the cache are whole, and what this version simulates.

    Attributes:
        sound: none is damaged, and those that were simulated again agree.
        images: number of images in the cache.
        supplied: number of those in the library that comes along, all whole.
        damaged: what is wrong with a file, by its path; remove it, and the next build simulates it again.
        recomputed: greatest difference of images that were simulated again, in parts of the brightest value, by their names.
    """

    sound: bool
    images: int
    supplied: int
    damaged: Mapping[str, str]
    recomputed: Mapping[str, float]


def path() -> str | None:
    """The folder: ``$STEMGEN_CACHE``, else ``stemgen`` in ``$XDG_CACHE_HOME`` or ``~/.cache``; ``None`` where neither is known."""
    folder = _core.cache_folder()
    return None if folder is None else str(folder)


def list() -> tuple[Holding, ...]:
    """What the cache holds, by material."""
    return tuple(Holding(*held) for held in _core.cache_list())


def library_path() -> str | None:
    """The folder of the library that comes along: ``$STEMGEN_LIBRARY`` (empty for none), else that of the package
    ``stemworlds-library`` or of the clone that this package was built in; ``None`` where there is none of these."""
    folder = _core.library_folder()
    return None if folder is None else str(folder)


def library() -> tuple[Holding, ...]:
    """What the library that comes along holds, by material."""
    return tuple(Holding(*held) for held in _core.library_list())


def clear(material: str | None = None) -> tuple[Holding, ...]:
    """Removes the simulations of a material, or all; returns what was removed. Nothing is lost with them but time."""
    return tuple(Holding(*held) for held in _core.cache_clear(material))


def fill(
    recipe: RecipeLike,
    difficulty: Difficulty | None = None,
    *,
    shard: tuple[int, int] = (0, 1),
    library: bool = True,
    threads: int | None = None,
    progress: Progress = False,
) -> Filling:
    """Simulates what the worlds of a recipe share, whatever their seed, before any of them is built.

    After Ctrl-C what is done is kept.

    Args:
        recipe: name, path, TOML, dict or :class:`~stemworlds.Recipe`.
        difficulty: the tier, where the recipe has some.
        shard: number of a part, from 0, and how many there are, for processes or machines that see the same cache.
        library: ``False`` simulates also what the library that comes along holds.

    Returns:
        What was done: all numbers are 0 where worlds of the recipe share nothing, as films do.

    Raises:
        InvalidValue: for the recipe and ``shard``.
    """
    toml = Recipe(recipe, difficulty).toml
    done = call(_core.cache_fill, toml, shard, library, running(threads, progress))
    return Filling(*done) if done else Filling(0, 0, 0)


def verify(
    material: str | None = None,
    *,
    recompute: int = 0,
    difficulty: Difficulty | None = None,
    seed: int = 1,
    threads: int | None = None,
    progress: Progress = False,
) -> CacheVerification:
    """Reads all simulations of a material, or of all, and simulates some of them again.

    Args:
        material: only this one.
        recompute: so many images of the recipe of this name, drawn by ``seed``, are simulated and compared.
        difficulty: the tier of that recipe.

    Raises:
        InvalidValue: where nothing is held of the material.
    """
    again = None
    if recompute:
        if material is None:
            raise _invalid("material", "material = None: recompute takes the name of a recipe")
        again = (Recipe(material, difficulty).toml, recompute, seed)
    images, supplied, damaged, compared = call(_core.cache_verify, material, again, running(threads, progress))
    agree = all(agrees for _, _, agrees in compared)
    return CacheVerification(
        sound=not damaged and agree,
        images=images,
        supplied=supplied,
        damaged={str(path): fault for path, fault in damaged},
        recomputed={name: difference for name, difference, _ in compared},
    )


def export_library(
    out: str | os.PathLike[str],
    material: str | None = None,
    *,
    overwrite: bool = False,
    threads: int | None = None,
    progress: Progress = False,
) -> Mapping[str, Holding]:
    """Writes the simulations of a material, or all, to one file for another machine; returns what it holds, by material.

    Raises:
        FileThere: unless ``overwrite``.
        FormatError: for a damaged simulation in the cache.
    """
    told = call(_core.cache_export, os.fspath(out), material, overwrite, running(threads, progress))
    return _holdings(told)


def import_library(
    path: str | os.PathLike[str], *, threads: int | None = None, progress: Progress = False
) -> Mapping[str, Holding]:
    """Takes the simulations of a file into the cache; returns what it holds, by material.

    Raises:
        FormatError: for a file that is damaged, of another version, or no library: then nothing is taken.
    """
    return _holdings(call(_core.cache_import, os.fspath(path), running(threads, progress)))


def _holdings(told: str) -> Mapping[str, Holding]:
    return {held["material"]: Holding(**held) for held in json.loads(told)["materials"]}
