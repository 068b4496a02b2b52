"""Trained networks that come with the package. docs/training.md says what each was trained on, how good it is, and where it ends."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["packaged_networks"]


def packaged_networks() -> dict[str, Path]:
    """Returns the names of the shipped networks, with the paths of their files."""
    return {path.stem: path for path in sorted(Path(__file__).parent.glob("*.onnx"))}


def path_of(model: str | os.PathLike[str]) -> str:
    """Returns the path of a network, which is given as a path or as the name of a shipped one. An existing file comes first."""
    given = os.fspath(model)
    shipped = packaged_networks().get(given)
    return given if shipped is None or os.path.exists(given) else os.fspath(shipped)
