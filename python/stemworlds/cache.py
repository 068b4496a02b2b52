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


_data = find_spec("stemworlds_library")
if _data is not None and _data.submodule_search_locations:
    _core.set_library(_data.submodule_search_locations[0])


@dataclass(frozen=True)
class Holding:
    """What the cache, or the library that comes along, holds of a material."""

    material: str
    images: int
    bytes: int


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
