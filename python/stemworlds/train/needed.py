"""Imports PyTorch and ONNX, which only the training needs."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

from ..errors import StemworldsError

_HOW = """training needs PyTorch, onnx and onnxscript:
  pip install 'stemworlds[train]'
On Linux PyTorch then brings 3 GB for GPUs. Without a GPU install its wheel for processors (CPU, 200 MB) before: pytorch.org/get-started/locally gives
the command where "CPU" is chosen."""


def check() -> None:
    """Checks that PyTorch and ONNX are installed, before the training begins.

    Raises:
        StemworldsError: if a package is missing. The message names the command that installs it.
    """
    for module in ("torch", "onnx", "onnxscript"):
        _module(module)


def onnx() -> Any:
    """Imports the module onnx."""
    return _module("onnx")


def _module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise StemworldsError(f"{name} is not installed ({error}); {_HOW}") from error
