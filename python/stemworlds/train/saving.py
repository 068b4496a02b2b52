"""Writes the files of a training so that a killed process leaves no incomplete file."""

from __future__ import annotations

import contextlib
import io
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from ..errors import FormatError, _invalid
from .config import Config

#: Version of checkpoints.
_VERSION = 1


def write_whole(path: Path, data: bytes) -> None:
    """Writes a file under a temporary name, and renames it when it is completely on the disk."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(beside, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise


def write_checkpoint(path: Path, config: Config, step: int, state: Mapping[str, Any]) -> None:
    """Saves the state from which a training can continue."""
    buffer = io.BytesIO()
    torch.save({"version": _VERSION, "essence": json.dumps(config.essence()), "step": step, "state": dict(state)}, buffer)
    write_whole(path, buffer.getvalue())


def read_checkpoint(path: Path, config: Config, device: torch.device) -> tuple[int, dict[str, Any]] | None:
    """Reads the number of finished steps, and their state; ``None`` without a checkpoint.

    Raises:
        FormatError: for a file that is no checkpoint.
        InvalidValue: for a checkpoint of another config. The message lists the differences.
    """
    if not path.exists():
        return None
    try:
        found = torch.load(path, map_location=device, weights_only=True)
        version, essence, step, state = (found[key] for key in ("version", "essence", "step", "state"))
    except Exception as error:
        raise FormatError(f"{path}: no checkpoint of a training: {error}; remove it to begin anew") from error
    if version != _VERSION:
        raise FormatError(f"{path}: version {version} of checkpoints, this program writes {_VERSION}; remove it to begin anew")
    if essence != json.dumps(config.essence()):
        differing = _differing(json.loads(essence), config.essence())
        raise _invalid("config", f"{path} is of another config: {differing}; take another folder, or remove it to begin anew")
    return int(step), state


def _differing(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Lists the keys in which two configs differ, as text."""
    new = json.loads(json.dumps(new))
    keys = [(table, key) for table in new for key in new[table] if old.get(table, {}).get(key) != new[table][key]]
    return ", ".join(f"[{table}] {key}" for table, key in keys) or "of another version of the program"


class Log:
    """A file of JSON lines, one for each row. A continued training removes the rows after its checkpoint."""

    def __init__(self, path: Path, step: int) -> None:
        kept = []
        if step and path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                with contextlib.suppress(ValueError, KeyError, TypeError):
                    if json.loads(line)["step"] <= step:
                        kept.append(line + "\n")
        write_whole(path, "".join(kept).encode())
        self._file = open(path, "a", encoding="utf-8")  # noqa: SIM115

    def row(self, **values: Any) -> None:
        """Appends a row, and waits until it is on the disk."""
        self._file.write(json.dumps(values) + "\n")
        self._file.flush()

    def close(self) -> None:
        self._file.close()
