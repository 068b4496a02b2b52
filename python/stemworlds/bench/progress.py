"""Prints the progress of a run, and its estimated end."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from .._text import printable

_SECONDS_BETWEEN_LINES = 10.0
_SECONDS_BETWEEN_CHANGES = 0.2
#: Number of episodes before the first estimate of the end.
_LEAST_FOR_A_PACE = 4


class Progress:
    """Prints one changing line on a terminal, and occasional lines elsewhere. The end is estimated from the pace so far."""

    def __init__(self, episodes: int, skipped: int, say: Callable[[str], object] | None) -> None:
        self._episodes, self._say = episodes, say
        self._terminal = say is None and sys.stderr.isatty()
        self._done = self._failed = 0
        self._began = self._last = time.monotonic()
        #: The end of the first episode. The time before it, for example for a library, is not repeated, so the pace excludes it.
        self._first: float | None = None
        self._errors: set[str] = set()
        if skipped:
            self._line(f"{skipped} episodes are done already, {episodes} are left")

    def step(self, what: str) -> None:
        """Counts one more episode."""
        self._done += 1
        self._show(printable(what))

    def note(self, text: str) -> None:
        """Prints the work before the first episode."""
        text = printable(text)
        if self._terminal:
            sys.stderr.write("\r\x1b[K" + text[:150])
            sys.stderr.flush()
        else:
            self._line(text)

    def failed(self, error: str) -> None:
        """Counts an episode that ended with an error. Errors of one kind are printed once."""
        self._failed += 1
        kind = error.partition(": ")[2]
        if kind not in self._errors:
            self._errors.add(kind)
            self._line(f"error: {printable(error)}")
        self._show("an error")

    def close(self) -> None:
        if self._terminal:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()

    def _show(self, what: str) -> None:
        now = time.monotonic()
        if self._first is None:
            self._first = now
        between = _SECONDS_BETWEEN_CHANGES if self._terminal else _SECONDS_BETWEEN_LINES
        over = self._done + self._failed == self._episodes
        if now - self._last < between and not over:
            return
        self._last = now
        text = f"{self._done + self._failed} of {self._episodes}, {self._left(now)}; {what}"
        if self._terminal:
            sys.stderr.write("\r\x1b[K" + text[:150])
            sys.stderr.flush()
        else:
            self._line(text)

    def _left(self, now: float) -> str:
        done = self._done + self._failed
        left = self._episodes - done
        if left == 0:
            return f"{in_words(now - self._began)} in all"
        if done < _LEAST_FOR_A_PACE or self._first is None:
            return f"{in_words(now - self._began)} so far"
        return f"about {in_words((now - self._first) / (done - 1) * left)} left"

    def _line(self, text: str) -> None:
        if self._say is not None:
            self._say(text)
            return
        if self._terminal:
            sys.stderr.write("\r\x1b[K")
        print(text, file=sys.stderr, flush=True)


def in_words(seconds: float) -> str:
    """Returns a time with a unit for readers."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
