"""Prints the progress of a training, and its estimated end."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping

from ..bench.progress import in_words

_SECONDS_BETWEEN_LINES = 10.0
#: Number of lines before the first estimate of the end, since the first steps are slower.
_LEAST_LINES = 2


class Progress:
    """Prints occasional lines. The remaining time is estimated from the steps of this call after its first line."""

    def __init__(self, steps: int, say: Callable[[str], object] | None) -> None:
        self._steps = steps
        self._say = say if say is not None else lambda text: print(text, file=sys.stderr, flush=True)
        self._first: tuple[int, float] | None = None
        self._lines = 0
        self._last = -float("inf")

    def note(self, text: str) -> None:
        """Prints a note about other work than steps."""
        self._say(text)

    def step(self, done: int, losses: Mapping[str, float]) -> None:
        """Reports the number of finished steps."""
        now = time.monotonic()
        self._lines += 1
        if self._first is None:
            self._first = (done, now)
        if now - self._last < _SECONDS_BETWEEN_LINES and done < self._steps:
            return
        self._last = now
        said = ", ".join(f"{name} {value:.3f}" for name, value in losses.items())
        self._say(f"step {done} of {self._steps}{self._left(done, now)}; {said}")

    def close(self) -> None:
        """Ends the output."""

    def _left(self, done: int, now: float) -> str:
        assert self._first is not None
        step, began = self._first
        if self._lines < _LEAST_LINES or done == self._steps or done == step:
            return ""
        return f", about {in_words((now - began) / (done - step) * (self._steps - done))} left"
