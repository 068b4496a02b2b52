"""Trains networks that see columns and what they hold, on the endless stream of tiles.

``stemworlds train`` is its command, docs/training.md its page. It needs ``pip install 'stemworlds[train]'``; PyTorch is imported when
something is trained, and not before.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from .config import Config, NetworkTable, OptimiserTable, RunTable, StreamTable, packaged_configs, read_config

if TYPE_CHECKING:
    from .training import TrainingSummary

__all__ = ["Config", "NetworkTable", "OptimiserTable", "RunTable", "StreamTable", "export", "packaged_configs", "read_config", "train"]


def train(
    config: Config | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    progress: Callable[[str], object] | None = None,
    until: float | None = None,
) -> TrainingSummary:
    """Trains what a config (or its file) says in the folder ``out``; the same call goes on where it was.

    Args:
        config: a :class:`Config`, the path of a TOML file, or the name of a config of the package.
        out: the folder of checkpoint, log and networks; it is made.
        progress: is told how far it is; by default lines on standard error.
        until: stop after so many seconds, with a checkpoint.

    Raises:
        StemworldsError: without PyTorch, onnx and onnxscript; it says how to install them.
        InvalidValue: for the config, and where the folder holds a checkpoint of another one.
    """
    whole, training = _ready(config)
    summary: TrainingSummary = training.train(whole, out, progress=progress, until=until)
    return summary


def export(config: Config | str | os.PathLike[str], out: str | os.PathLike[str]) -> list[str]:
    """Writes ``member-0.onnx`` ... of the last checkpoint in the folder ``out``, for who does not wait for the end.

    Raises:
        StemworldsError: without PyTorch, onnx and onnxscript.
        InvalidValue: where the checkpoint is of another config.
        FileMissing: without a checkpoint.
    """
    whole, training = _ready(config)
    networks: list[str] = training.export(whole, out)
    return networks


def _ready(config: Config | str | os.PathLike[str]) -> tuple[Config, Any]:
    """The config, checked, and the module that needs PyTorch."""
    whole = config if isinstance(config, Config) else read_config(config)
    from . import needed

    needed.check()
    from . import training

    return whole, training
