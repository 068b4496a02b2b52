"""Files of results: a JSON object a line, appended as episodes end."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from ..errors import FileError, FileMissing, FormatError, OutputLocked

__all__ = ["ResultFile", "read_failures", "read_results"]

Row = dict[str, Any]
_NEEDED = {"key", "agent", "task", "world", "seed", "budget"}
#: What each line begins with.
_BEGINNING = b'{"key"'


class ResultFile:
    """A file of results that is written to, by one process at a time. A last line that was cut off in the writing is removed.

    Raises:
        FormatError: if the file is there and holds something else; it stays as it is.
        OutputLocked: if another run writes it.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path: Path = Path(path)
        self._file: IO[bytes] | None = None

    def __enter__(self) -> ResultFile:
        import fcntl

        try:
            self._file = open(self.path, "a+b")
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
        """Removes a last line without its end, if the file holds results and nothing else."""
        assert self._file is not None, "the file is not open"
        self._file.seek(0)
        told = self._file.read()
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
        """Keys of the combinations that are there; not of those that ended with an error."""
        return {row["key"] for row in _rows(self.path) if "error" not in row}

    def append(self, row: Row) -> None:
        """Writes a row through to the disk."""
        assert self._file is not None, "the file is not open"
        self._file.write(json.dumps(row, separators=(",", ":"), allow_nan=False).encode() + b"\n")
        self._file.flush()
        with contextlib.suppress(OSError):
            os.fsync(self._file.fileno())


def read_results(path: str | os.PathLike[str]) -> list[Row]:
    """The rows of a file of results; of a combination that is there twice, the last.

    Raises:
        FileMissing: if it is not there.
        FormatError: if a line is no result; the message names the line.
    """
    if not Path(path).is_file():
        raise FileMissing(f"{path}: there is no such file of results; stemworlds bench run writes one")
    rows = {row["key"]: row for row in _rows(Path(path)) if "error" not in row}
    if not rows:
        raise FormatError(f"{path}: no results in it yet; stemworlds bench run EXPERIMENT --out {path} goes on with it")
    return list(rows.values())


def read_failures(path: str | os.PathLike[str]) -> list[Row]:
    """The episodes of a file of results that ended with an error, and were not played since: key, agent, task, world, seed, budget, error."""
    last = {row["key"]: row for row in _rows(Path(path))}
    return [row for row in last.values() if "error" in row]


def _rows(path: Path) -> Iterator[Row]:
    with open(path, "rb") as lines:
        for number, line in enumerate(lines, 1):
            if not line.endswith(b"\n"):
                # Cut off in the writing, or still being written.
                return
            try:
                row = json.loads(line.decode())
            except (ValueError, RecursionError) as error:
                raise FormatError(f"{path}:{number}: no JSON: {error}") from error
            if not isinstance(row, dict) or not _NEEDED <= row.keys() or not ("error" in row or {"curve", "metrics"} <= row.keys()):
                raise FormatError(f"{path}:{number}: no result of an episode")
            yield row
