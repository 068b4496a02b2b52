"""What a fork leaves in the child: memory as it was, but none of the threads that were about to let go of something.

Reads of world files are short: a fork waits for those of other threads. Recordings may take minutes: what another thread uses while the
process is forked is refused in the child, where nobody would ever let go of it.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from .errors import StemworldsError

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

#: Guards what is below. A handler of a signal may fork while its own thread has it.
_changed = threading.Condition(threading.RLock())
#: Reads that go on, by thread.
_reads: dict[int, int] = {}
#: Forks that wait for reads. No read begins meanwhile, or threads that read again and again would keep a fork waiting for ever.
_forks = 0


def reading(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """A function that reads a world file; the process is not forked meanwhile."""

    def read(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        me = threading.get_ident()
        with _changed:
            _changed.wait_for(lambda: not _forks or me in _reads)
            _reads[me] = _reads.get(me, 0) + 1
        try:
            return function(*args, **kwargs)
        finally:
            with _changed:
                left = _reads.pop(me, 1) - 1
                if left:
                    _reads[me] = left
                _changed.notify_all()

    return read


class Used:
    """Who is used in calls that may take long.

    Args:
        what: its name in messages.
        instead: how the child gets one of its own.
    """

    def __init__(self, what: str, instead: str) -> None:
        self._what, self._instead = what, instead
        self._calls = 0
        self._lost = False
        with _changed:
            _used.add(self)

    def by(self, function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
        """A function that uses it.

        Raises:
            StemworldsError: when it is called in a child of a fork, if another thread was using the same then.
        """

        def use(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
            with _changed:
                if self._lost:
                    raise StemworldsError(
                        f"{self._what} was in use by another thread when this process was forked, and stays so here: {self._instead}, fork while no "
                        "thread uses it, or start processes by multiprocessing.get_context('spawn')"
                    )
                self._calls += 1
            try:
                return function(*args, **kwargs)
            finally:
                with _changed:
                    self._calls -= 1

        return use

    def forked(self) -> None:
        """In the child of a fork."""
        self._lost = self._lost or self._calls > 0


_used: weakref.WeakSet[Used] = weakref.WeakSet()


def _before() -> None:
    global _forks
    _changed.acquire()
    _forks += 1
    me = threading.get_ident()
    _changed.wait_for(lambda: all(thread == me for thread in _reads))


def _in_parent() -> None:
    global _forks
    _forks -= 1
    _changed.notify_all()
    _changed.release()


def _in_child() -> None:
    global _changed, _forks
    # Threads that waited for the old one are not here.
    _changed = threading.Condition(threading.RLock())
    _forks = 0
    _reads.clear()
    for used in list(_used):
        used.forked()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_parent=_in_parent, after_in_child=_in_child)
