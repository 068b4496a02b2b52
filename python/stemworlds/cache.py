"""Lists, fills and checks the cache of simulations that worlds share.

The simulations for the shipped crystals and layers are in the supplied library, the data package ``stemworlds-library`` (``pip install
stemworlds[library]``). It is read first, and never changed. The cache stores all other simulations.
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
    """Contents of the cache, or of the supplied library, for a material."""

    material: str
    images: int
    bytes: int


@dataclass(frozen=True)
class Filling:
    """Result of :func:`fill`, for the simulations that worlds of a recipe share.

    Attributes:
        images: number of images.
        simulated: number of images that this call simulated.
        lacking: number of images that other parts have still to simulate.
    """

    images: int
    simulated: int
    lacking: int


@dataclass(frozen=True)
class CacheVerification:
    """Result of :func:`verify`.

    Attributes:
        sound: whether no image is damaged, and all recomputed images agree.
        images: number of images in the cache.
        supplied: number of undamaged images in the supplied library.
        damaged: descriptions of the damage, by path of the file. Remove a damaged file, and the next build simulates it again.
        recomputed: greatest difference of each recomputed image, in units of its brightest value, by name.
    """

    sound: bool
    images: int
    supplied: int
    damaged: Mapping[str, str]
    recomputed: Mapping[str, float]


def path() -> str | None:
    """Returns the folder of the cache: ``$STEMGEN_CACHE``, or ``stemgen`` in ``$XDG_CACHE_HOME`` or ``~/.cache``; ``None`` if none is
    known."""
    folder = _core.cache_folder()
    return None if folder is None else str(folder)


def list() -> tuple[Holding, ...]:
    """Lists the contents of the cache, by material."""
    return tuple(Holding(*held) for held in _core.cache_list())


def library_path() -> str | None:
    """Returns the folder of the supplied library; ``None`` if there is none.

    It is ``$STEMGEN_LIBRARY`` (empty for no library), or the folder of the package ``stemworlds-library``, or of the source tree in which
    this package was built.
    """
    folder = _core.library_folder()
    return None if folder is None else str(folder)


def library() -> tuple[Holding, ...]:
    """Lists the contents of the supplied library, by material."""
    return tuple(Holding(*held) for held in _core.library_list())


def clear(material: str | None = None) -> tuple[Holding, ...]:
    """Removes the simulations of a material, or all, from the cache. Returns the removed ones. Later builds simulate them again."""
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
    """Simulates the images that all worlds of a recipe share, before any of these worlds is built.

    The images do not depend on the seed. After Ctrl-C, finished images are kept.

    Args:
        recipe: name, path, TOML, dict or :class:`~stemworlds.Recipe`.
        difficulty: the tier, if the recipe has tiers.
        shard: number of a part, from 0, and number of parts, for processes or machines that share the cache.
        library: ``False`` simulates the images of the supplied library as well.

    Returns:
        The numbers of images. All are 0 if worlds of the recipe share no images, for example for films.

    Raises:
        InvalidValue: for an invalid recipe or ``shard``.
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
    """Reads all simulations of a material, or of all materials, and recomputes some of them.

    Args:
        material: the material; all by default.
        recompute: number of images, drawn by ``seed``, that are simulated again and compared. They belong to the recipe with the name
            ``material``.
        difficulty: the tier of this recipe.

    Raises:
        InvalidValue: if the cache and the library contain no image of the material.
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
    """Writes the simulations of a material, or all, to one file for another machine. Returns its contents, by material.

    Raises:
        FileThere: if ``out`` exists, unless ``overwrite`` is set.
        FormatError: if a simulation in the cache is damaged.
    """
    told = call(_core.cache_export, os.fspath(out), material, overwrite, running(threads, progress))
    return _holdings(told)


def import_library(
    path: str | os.PathLike[str], *, threads: int | None = None, progress: Progress = False
) -> Mapping[str, Holding]:
    """Copies the simulations of a file into the cache. Returns the contents of the file, by material.

    Raises:
        FormatError: for a file that is damaged, of another version, or no library. The cache is then unchanged.
    """
    return _holdings(call(_core.cache_import, os.fspath(path), running(threads, progress)))


def _holdings(told: str) -> Mapping[str, Holding]:
    return {held["material"]: Holding(**held) for held in json.loads(told)["materials"]}
