"""Runs long calls of the extension with a number of threads and progress."""

from __future__ import annotations

import importlib.util
import sys
import time
from collections.abc import Callable
from typing import Any, ParamSpec, TypedDict, TypeVar

from .errors import _invalid, _wrong_type

#: Is called with the name of the stage, its unit, the number of units done, and their total number.
ProgressCallback = Callable[[str, str, int, int], object]
Progress = bool | ProgressCallback | None

_SECONDS_BETWEEN_LINES = 8.0

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def call(function: Callable[_Arguments, _Result], *args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
    """Calls a function of the extension; options of a wrong type become an error of the package."""
    try:
        return function(*args, **kwargs)
    except TypeError as error:
        # An error that a callback raised has a longer traceback, and is passed on unchanged.
        own = error.__traceback__ is not None and error.__traceback__.tb_next is None
        if not own or not str(error).startswith(("argument '", "failed to extract")):
            raise
        raise _wrong_type(error) from None


class Running(TypedDict):
    """Threads and progress of a call, in the extension's form."""

    threads: int | None
    progress: ProgressCallback | None


def running(threads: int | None, progress: Progress) -> Running:
    """Checks threads and progress of a call. ``threads=None`` uses all processors.

    Raises:
        InvalidValue: for a wrong number of threads, or a ``progress`` that is no function.
    """
    if threads is not None and (not isinstance(threads, int) or not 1 <= threads <= 4096):
        raise _invalid("threads", f"threads = {threads!r}: expected a whole number from 1 to 4096")
    if progress is True:
        return {"threads": threads, "progress": _bar()}
    if progress is None or progress is False:
        return {"threads": threads, "progress": None}
    if not callable(progress):
        raise _invalid("progress", f"progress = {progress!r}: expected True, False or a function")
    return {"threads": threads, "progress": progress}


def _bar() -> ProgressCallback:
    return _Tqdm() if importlib.util.find_spec("tqdm") else _Lines()


class _Tqdm:
    """Shows progress as one tqdm bar for each stage, in terminals and notebooks."""

    def __init__(self) -> None:
        self._bar: Any = None

    def __call__(self, stage: str, unit: str, done: int, total: int) -> None:
        from tqdm.auto import tqdm

        if done == 0 and total > 0 and (self._bar is None or self._bar.n > 0):
            self._close()
            self._bar = tqdm(desc=stage, unit=f" {unit}", total=total)
        if self._bar is not None:
            self._bar.update(done - self._bar.n)
            if done >= total:
                self._close()

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


class _Lines:
    """Prints progress as lines on standard error, if tqdm is not installed."""

    def __init__(self) -> None:
        self._next = time.monotonic() + 2.0

    def __call__(self, stage: str, unit: str, done: int, total: int) -> None:
        now = time.monotonic()
        if now >= self._next and total > 0:
            self._next = now + _SECONDS_BETWEEN_LINES
            percent = 100 * done / total
            print(f"{stage}: {percent:.0f} %, {done} of {total} {unit}s", file=sys.stderr)
