"""Reads and writes files of results. Each line is a JSON object, appended at the end of an episode."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from ..errors import DiskFull, FileError, FileMissing, FormatError, OutputLocked
from .experiments import TASKS

__all__ = ["ResultFile", "read_failures", "read_results"]

Row = dict[str, Any]
#: Metrics that every result has.
METRICS = ("dec_auc", "final_score", "time_to_threshold", "early_weighted", "late_weighted", "half_budget")
_TEXTS = {"key", "agent", "task", "world"}
#: More rows or columns of tiles than any world has.
_LARGEST_GRID = 10_000
#: The first bytes of each line.
_BEGINNING = b'{"key"'


class ResultFile:
    """A file of results, opened for appending by one process at a time. An incomplete last line is removed.

    Raises:
        FormatError: if the file exists and contains no results. It is not changed.
        FileError: if the file cannot be opened for writing.
        OutputLocked: if another run is writing the file.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path: Path = Path(path)
        self._file: io.FileIO | None = None

    def __enter__(self) -> ResultFile:
        import fcntl

        try:
            # Without a buffer, a failed write is reported at once, and is not repeated when the file is closed.
            self._file = open(self.path, "a+b", buffering=0)
        except OSError as error:
            raise FileError(f"{self.path}: cannot be written: {error.strerror}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise OutputLocked(f"{self.path}: another run writes it; wait for its end, or give another file") from None
        try:
            self._cut_off()
        except BaseException:
            self._file.close()
            raise
        return self

    def _cut_off(self) -> None:
        """Removes an incomplete last line, if the file contains results and nothing else."""
        assert self._file is not None, "the file is not open"
        self._file.seek(0)
        told = self._file.readall()
        whole = told.rfind(b"\n") + 1
        rest = told[whole:]
        for _ in _rows(self.path):
            pass
        if not rest.startswith(_BEGINNING[: len(rest)]):
            raise FormatError(f"{self.path}: holds no results, and stays as it is; give another file")
        if rest:
            self._file.truncate(whole)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._file is not None:
            self._file.close()

    def finished(self) -> set[str]:
        """Returns the keys of the combinations in the file, without the combinations that ended with an error."""
        return {row["key"] for row in _rows(self.path) if "error" not in row}

    def append(self, row: Row) -> None:
        """Appends a row, and waits until it is on the disk.

        Raises:
            DiskFull, FileError: if the row cannot be written. The file then contains the complete earlier rows.
        """
        assert self._file is not None, "the file is not open"
        line = json.dumps(row, separators=(",", ":"), allow_nan=False).encode() + b"\n"
        before = os.fstat(self._file.fileno()).st_size
        try:
            left = memoryview(line)
            while left:
                left = left[self._file.write(left) :]
            _through(self._file.fileno())
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.truncate(before)
            full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
            kind, advice = (DiskFull, "make room") if full else (FileError, "see to the disk")
            raise kind(
                f"{self.path}: cannot be written: {error.strerror}; all rows before are kept: {advice}, and run the same command again to go on"
            ) from error


def _through(descriptor: int) -> None:
    """Flushes a file to the disk. Targets that cannot be flushed, for example pipes, are accepted."""
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EROFS, errno.ENOTSUP):
            raise


def read_results(path: str | os.PathLike[str]) -> list[Row]:
    """Returns the rows of a file of results. If a combination occurs twice, the last row counts.

    Raises:
        FileMissing: if the file does not exist.
        FormatError: if a line is no result; the message names the line.
    """
    if not Path(path).is_file():
        raise FileMissing(f"{path}: there is no such file of results; stemworlds bench run writes one")
    rows = {row["key"]: row for row in _rows(Path(path)) if "error" not in row}
    if not rows:
        raise FormatError(f"{path}: no results in it yet; stemworlds bench run EXPERIMENT --out {path} goes on with it")
    return list(rows.values())


def read_failures(path: str | os.PathLike[str]) -> list[Row]:
    """Returns the episodes that ended with an error and have no later result: key, agent, task, world, seed, budget, error."""
    last = {row["key"]: row for row in _rows(Path(path))}
    return [row for row in last.values() if "error" in row]


def _rows(path: Path) -> Iterator[Row]:
    with open(path, "rb") as lines:
        for number, line in enumerate(lines, 1):
            if not line.endswith(b"\n"):
                # The last line is incomplete: writing was interrupted, or is in progress.
                return
            try:
                row = json.loads(line.decode())
            except (ValueError, RecursionError) as error:
                raise FormatError(f"{path}:{number}: no JSON: {error}") from error
            fault = "no table" if not isinstance(row, dict) else _fault(row)
            if fault:
                raise FormatError(f"{path}:{number}: no result of an episode: {fault}")
            yield row


def _fault(row: Row) -> str:
    """Returns a description of a missing or wrong value of a row; an empty text for a valid row."""
    missing = sorted(name for name in _TEXTS | {"seed", "budget"} if name not in row)
    if missing:
        return f"{missing[0]} is missing"
    wrong = [name for name in _TEXTS if not isinstance(row[name], str)]
    seed, budget = row["seed"], row["budget"]
    if wrong or not _whole(seed, 0, 2**32 - 1) or not _number(budget) or budget <= 0:
        return f"{sorted(wrong)[0]} is no text" if wrong else "seed or budget is no number within its limits"
    if row["task"].removesuffix("-strict") not in TASKS:
        return "its task is unknown"
    if "error" in row:
        return "" if isinstance(row["error"], str) else "error is no text"
    curve, metrics = row.get("curve"), row.get("metrics")
    if not isinstance(curve, list) or not all(isinstance(at, list) and len(at) == 2 and all(map(_number, at)) for at in curve):
        return "curve is no list of pairs of numbers"
    if not isinstance(metrics, dict) or not all(_number(metrics.get(name)) for name in METRICS):
        return f"metrics are no numbers by the names {', '.join(METRICS)}"
    return _fault_of_the_rest(row)


def _fault_of_the_rest(row: Row) -> str:
    """Returns a description of a wrong optional value of a row; an empty text if there is none."""
    for name in ("specification", "environment", "notes", "wall", "scores"):
        if not isinstance(row.get(name) or {}, dict):
            return f"{name} is no table"
    if not isinstance(row.get("specification", {}).get("analyst", {}), dict):
        return "the analyst of its specification is no table"
    if not all(_number(count) for name in ("notes", "wall") for count in (row.get(name) or {}).values()):
        return "notes or wall hold something else than numbers"
    if row.get("wall") and not {"seconds", "seconds_per_tile"} <= row["wall"].keys():
        return "wall has not seconds and seconds_per_tile"
    scores = dict(row.get("scores") or {})
    parts = [scores.pop(name, None) or {} for name in ("columns", "forecasts", "field")]
    tables = all(isinstance(part, dict) for part in parts)
    if not tables or not all(score is None or _number(score) for part in (scores, *parts) for score in part.values()):
        return "scores hold something else than numbers"
    if not _whole(row.get("unreadable", 0), 0, 2**53):
        return "unreadable is no number"
    grid, tiles = row.get("grid"), row.get("tiles") or []
    if grid is not None and not (isinstance(grid, list) and len(grid) == 2 and all(_whole(n, 1, _LARGEST_GRID) for n in grid)):
        return "grid is no pair of numbers"
    limits = grid or [_LARGEST_GRID] * 2
    pairs = isinstance(tiles, list) and all(isinstance(tile, list) and len(tile) == 2 for tile in tiles)
    if not pairs or not all(_whole(n, 0, most - 1) for tile in tiles for n, most in zip(tile, limits, strict=True)):
        return "tiles are no places in the grid"
    return ""


def _whole(value: Any, least: int, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most


def _number(value: Any) -> bool:
    """Returns whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
