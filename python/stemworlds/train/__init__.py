"""Trains networks that find columns and their defects, on an endless stream of tiles.

The command is ``stemworlds train``; docs/training.md explains it. It needs ``pip install 'stemworlds[train]'``. PyTorch is imported when a
training begins.
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
    """Trains the networks of a config in the folder ``out``. An identical call continues an interrupted training.

    Args:
        config: a :class:`Config`, the path of a TOML file, or the name of a config of the package.
        out: the folder of checkpoint, log and networks. It is created if it does not exist.
        progress: function that receives lines of progress; by default they are printed on standard error.
        until: seconds after which the training stops, with a checkpoint.

    Raises:
        StemworldsError: if PyTorch, onnx or onnxscript is missing. The message names the command that installs them.
        InvalidValue: for an invalid config, and if the folder contains a checkpoint of another config.
    """
    whole, training = _ready(config)
    summary: TrainingSummary = training.train(whole, out, progress=progress, until=until)
    return summary


def export(config: Config | str | os.PathLike[str], out: str | os.PathLike[str]) -> list[str]:
    """Writes the networks of the last checkpoint, ``member-0.onnx`` ..., in the folder ``out``, before the end of the training.

    Raises:
        StemworldsError: if PyTorch, onnx or onnxscript is missing.
        InvalidValue: if the checkpoint belongs to another config.
        FileMissing: if there is no checkpoint.
    """
    whole, training = _ready(config)
    networks: list[str] = training.export(whole, out)
    return networks


def _ready(config: Config | str | os.PathLike[str]) -> tuple[Config, Any]:
    """Returns the checked config, and the module that needs PyTorch."""
    whole = config if isinstance(config, Config) else read_config(config)
    from . import needed

    needed.check()
    from . import training

    return whole, training
