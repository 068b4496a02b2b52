"""The simulations that worlds share, on disk."""

from __future__ import annotations

from dataclasses import dataclass

from . import _core


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
