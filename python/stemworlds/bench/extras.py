"""Imports optional packages at their first use."""

from __future__ import annotations

import importlib
from typing import Any

from ..errors import StemworldsError

#: The extra of this package that installs each optional package.
_EXTRAS = {
    "scipy": "agents",
    "sklearn": "agents",
    "skimage": "agents",
    "matplotlib": "agents",
    "onnxruntime": "analyst",
    "stable_baselines3": "rl",
    "sb3_contrib": "rl",
}


def needed(module: str) -> Any:
    """Imports a module of an optional package. If it is missing, the error names the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        extra = _EXTRAS.get(package, "agents")
        raise StemworldsError(f"{package} is not installed ({error}); pip install 'stemworlds[{extra}]' brings it") from error
