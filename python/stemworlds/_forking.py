"""Makes objects safe to use in a process that forks.

A forked child gets a copy of the memory, but none of the other threads. An object that another thread was using would stay in use for ever.

Reads of world files are short, so a fork waits until other threads have finished theirs. Recordings may take minutes, so a fork does not
wait: the child refuses every object that another thread was using when the process was forked.
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

#: Guards the two variables below. It is re-entrant, since a signal handler may fork while its own thread holds it.
_changed = threading.Condition(threading.RLock())
#: Number of unfinished reads of each thread.
_reads: dict[int, int] = {}
#: Number of forks that wait for reads. No read begins meanwhile, since threads that read repeatedly would delay a fork for ever.
_forks = 0


def reading(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Wraps a function that reads a world file. The process is not forked while the function runs."""

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
    """Records whether an object is in use by calls that may take minutes.

    Args:
        what: name of the object in messages.
        instead: how a child process gets an object that it can use, for messages.
    """

    def __init__(self, what: str, instead: str) -> None:
        self._what, self._instead = what, instead
        self._calls = 0
        self._lost = False
        with _changed:
            _used.add(self)

    def by(self, function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
        """Wraps a function that uses the object.

        Raises:
            StemworldsError: if it is called in a forked child, and another thread was using the object when the process was forked.
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
        """Marks the object as lost if it was in use. The child calls this after a fork."""
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
    # The old condition lists waiting threads, which do not exist in the child.
    _changed = threading.Condition(threading.RLock())
    _forks = 0
    _reads.clear()
    for used in list(_used):
        used.forked()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_parent=_in_parent, after_in_child=_in_child)
