"""The simulations that worlds share, on disk."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass

from . import _core
from ._running import Progress, call, running


@dataclass(frozen=True)
class Holding:
    """What the cache holds of a material."""

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
