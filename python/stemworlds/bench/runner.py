"""Runs the episodes of experiments in several processes. Finished episodes are not repeated."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import itertools
import json
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from ..errors import StemworldsError, _invalid
from . import own_agents
from .agents import play
from .catalogue import make_agent
from .experiments import OF_THE_MACHINE, Episode, Experiment
from .progress import Progress
from .results import ResultFile

if TYPE_CHECKING:
    import gymnasium as gym

__all__ = ["RunSummary", "run_experiment"]

Row = dict[str, Any]
Make: TypeAlias = "Callable[[Episode], gym.Env[Any, Any]]"
#: Number of queued episodes of a process. It plays the second while the row of the first is written.
_AT_ONCE = 2
#: The end of notes about libraries.
_LIBRARY_TAKES = "takes minutes if it is neither installed nor in the cache"
#: Option of Linux: this process gets a signal when its parent ends.
_PR_SET_PDEATHSIG = 1


@dataclass
class RunSummary:
    """Summary of a run.

    Attributes:
        episodes: number of episodes of the experiment.
        skipped: number of episodes that were in the file before.
        done: number of episodes played.
        failed: messages of the episodes that ended with an error. They are noted in the file. The next run of the experiment plays them
            again.
        interrupted: whether Ctrl-C ended the run.
        seconds: duration of the run.
    """

    episodes: int
    skipped: int = 0
    done: int = 0
    failed: list[str] = field(default_factory=list)
    interrupted: bool = False
    seconds: float = 0.0


def run_experiment(
    experiment: Experiment,
    out: str | os.PathLike[str],
    *,
    processes: int | None = None,
    progress: Callable[[str], object] | None = None,
    make: Callable[[Episode], gym.Env[Any, Any]] | None = None,
) -> RunSummary:
    """Plays the episodes of an experiment that are not in the file of results yet, and appends each result.

    The rows do not depend on the number of processes, except for their order and their times, ``wall``.

    Args:
        out: the file of results (JSON lines).
        processes: number of processes; by default the number of processors.
        progress: function that receives lines of progress; by default they are printed on standard error, on a terminal as one changing
            line.
        make: function that makes the environment of an episode; by default from its task and world. It has to be a function of a module.
    """
    if processes is not None and not 1 <= processes <= 4096:
        raise _invalid("processes", f"processes = {processes}: expected a whole number from 1 to 4096")
    began = time.monotonic()
    every = list(experiment)
    if not every:
        raise _invalid("tasks", f"{experiment.name}: no world is for any of its tasks, so there are no episodes")
    with ResultFile(out) as file:
        finished = file.finished()
        open_episodes = [episode for episode in every if episode.key not in finished]
        summary = RunSummary(len(every), skipped=len(every) - len(open_episodes))
        shown = Progress(len(open_episodes), summary.skipped, progress)
        count = min(processes or _processors(), max(len(open_episodes), 1))
        try:
            if make is None:
                if count > 1:
                    _fill_libraries(open_episodes, shown)
                elif any("recipe" in episode.world for episode in open_episodes):
                    shown.note(f"first episode: its library {_LIBRARY_TAKES}")
            for row in _played(open_episodes, count, experiment.name, make or _environment):
                if "error" in row:
                    summary.failed.append(row["error"])
                    file.append(row)
                    shown.failed(row["error"])
                else:
                    file.append(row)
                    summary.done += 1
                    shown.step(f"{row['agent']}, {row['task']}, {row['world']}, seed {row['seed']}: {row['metrics']['dec_auc']:.3f}")
        except KeyboardInterrupt:
            summary.interrupted = True
        shown.close()
    summary.seconds = time.monotonic() - began
    return summary


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _played(episodes: Sequence[Episode], processes: int, name: str, make: Make) -> Iterator[Row]:
    """Yields the rows of the episodes in the order of their ends."""
    if processes == 1:
        player = _Player(name, make)
        try:
            for episode in episodes:
                yield player.row(episode)
        finally:
            player.close()
        return
    # New processes are spawned, since forks of a process with threads may hang.
    spawn = multiprocessing.get_context("spawn")
    begin = (os.getpid(), name, make, max(_processors() // processes, 1))
    # There is a pool for each process, since _Deal assigns episodes to particular processes.
    pools = [ProcessPoolExecutor(1, spawn, _begin_process, begin) for _ in range(processes)]
    deal = _Deal(episodes, processes)
    waiting: dict[Future[Row], int] = {}
    finished = False

    def give(process: int) -> None:
        episode = deal.next_of(process)
        if episode is not None:
            waiting[pools[process].submit(_play_one, episode)] = process

    try:
        # A pool starts its process at the first episode, so these are submitted while __main__ is hidden.
        with _importable_main():
            for process in [*range(processes)] * _AT_ONCE:
                give(process)
        while waiting:
            ended, _ = wait(waiting, timeout=1.0, return_when=FIRST_COMPLETED)
            for future in ended:
                give(waiting.pop(future))
                yield future.result()
        finished = True
    except BrokenProcessPool as error:
        raise StemworldsError("a process ended by itself: too little memory? fewer processes take less of it") from error
    finally:
        workers = [worker for pool in pools for worker in (getattr(pool, "_processes", None) or {}).values()]
        for pool in pools:
            pool.shutdown(wait=finished, cancel_futures=True)
        if not finished:
            for worker in workers:
                worker.terminate()


class _Deal:
    """Assigns episodes to processes.

    One process plays all episodes of a specimen, so that its images are simulated once. At the end, idle processes take episodes of others.
    """

    def __init__(self, episodes: Sequence[Episode], processes: int) -> None:
        self._specimens = deque(deque(group) for _, group in itertools.groupby(episodes, lambda episode: episode.specimen))
        self._own: list[deque[Episode]] = [deque() for _ in range(processes)]

    def next_of(self, process: int) -> Episode | None:
        """Returns the next episode of a process; ``None`` if none is left."""
        if not self._own[process] and self._specimens:
            self._own[process] = self._specimens.popleft()
        if self._own[process]:
            return self._own[process].popleft()
        most = max(self._own, key=len)
        return most.pop() if most else None


@contextmanager
def _importable_main() -> Iterator[None]:
    """Hides the main script from new processes, which would otherwise run it again. They need nothing from it."""
    main = sys.modules["__main__"]
    kept = {key: main.__dict__.pop(key) for key in ("__file__",) if key in main.__dict__}
    spec, main.__spec__ = main.__spec__, None
    try:
        yield
    finally:
        main.__dict__.update(kept)
        main.__spec__ = spec


_player: _Player | None = None
#: Number of threads of an environment; None for the number of processors.
_threads: int | None = None


def _begin_process(parent: int, name: str, make: Make, threads: int) -> None:
    """Prepares a new process with its share of the processors. It ignores Ctrl-C, which the first process handles."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with(parent)
    global _player, _threads
    _threads = threads
    _player = _Player(name, make)


def _end_with(parent: int) -> None:
    """Makes this process end when the first process ends for any reason."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    # If the first process ended before the call above, there is no signal.
    if os.getppid() != parent:
        os._exit(1)
    threading.Thread(target=_watch, daemon=True).start()


def _watch() -> None:
    """Ends this process when the pipe from the first process is closed. This works on all systems."""
    first = multiprocessing.parent_process()
    if first is not None:
        multiprocessing.connection.wait([first.sentinel])
        os._exit(1)


def _play_one(episode: Episode) -> Row:
    assert _player is not None, "the process has begun"
    return _player.row(episode)


def _environment(episode: Episode) -> gym.Env[Any, Any]:
    """Makes the environment of an episode from its task and world."""
    import gymnasium

    return gymnasium.make(episode.environment_id, disable_env_checker=True, **{"threads": _threads, **episode.environment_options})


def _fill_libraries(episodes: Sequence[Episode], shown: Progress) -> None:
    """Makes each world of a recipe once, on all processors. Otherwise each process would simulate the library."""
    worlds = {json.dumps(episode.world, sort_keys=True): episode for episode in episodes if "recipe" in episode.world}
    for number, episode in enumerate(worlds.values(), 1):
        shown.note(f"library of {episode.world['name']}, {number} of {len(worlds)}: it {_LIBRARY_TAKES}")
        # If a world cannot be made, its episodes report the error.
        with contextlib.suppress(Exception):
            _environment(episode).close()


class _Player:
    """Plays episodes. It keeps agents, and the environments of the current world, for the next episodes."""

    def __init__(self, experiment: str, make: Make) -> None:
        self._experiment, self._make = experiment, make
        self._world: Mapping[str, Any] | None = None
        self._open: dict[str, Any] = {}
        self._agents: dict[str, Any] = {}

    def close(self) -> None:
        for env in self._open.values():
            env.close()
        self._open.clear()

    def row(self, episode: Episode) -> Row:
        """Plays an episode. Returns its row of results, or a row with the error."""
        try:
            with _one_thread():
                record = play(self._environment(episode), self._agent(episode), episode.seed)
            return row_of(episode, record, self._experiment)
        except Exception as error:
            what = f"{episode.agent['name']}, {episode.task}, {episode.world['name']}, seed {episode.seed}"
            return {**_combination(episode, self._experiment), "error": f"{what}: {_told(error)}"}

    def _agent(self, episode: Episode) -> Any:
        name = json.dumps(episode.agent, sort_keys=True)
        if name not in self._agents:
            self._agents[name] = make_agent(episode.agent)
        return self._agents[name]

    def _environment(self, episode: Episode) -> Any:
        """Returns the environment of an episode. The environments of one world stay open, since they share the images of a specimen."""
        if self._world != episode.world:
            self.close()
            self._world = episode.world
        name = json.dumps([episode.environment_id, episode.environment_options], sort_keys=True)
        if name not in self._open:
            self._open[name] = self._make(episode)
        return self._open[name]


def _told(error: Exception) -> str:
    """Returns the message of an error. For errors from outside this package it contains file and line too."""
    if isinstance(error, StemworldsError):
        return str(error)
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({frame.filename}:{frame.lineno})"


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limits linear algebra to one thread. Results are then identical on all machines, and processes do not compete for processors."""
    try:
        threadpool_limits = importlib.import_module("threadpoolctl").threadpool_limits
    except ImportError:
        yield
        return
    with threadpool_limits(1):
        yield


def row_of(episode: Episode, record: Row, experiment: str) -> Row:
    """Returns the row of results of an episode."""
    from .. import __version__

    return {
        **_combination(episode, experiment),
        "specimen": record.get("world"),
        "metrics": _plain(record["metrics"]),
        "curve": _plain(record["curve"]),
        "scores": _plain(record.get("scores")),
        "grid": _plain(record.get("grid")),
        "tiles": [_plain(acquired["tile"]) for acquired in record["acquisitions"]],
        "dose": [_plain(acquired["cost"]) for acquired in record["acquisitions"]],
        "ended": record.get("ended"),
        "steps": record.get("steps"),
        "unreadable": _plain(record.get("unreadable", 0)),
        "notes": _plain(record["notes"]),
        "modes": record["modes"],
        "version": __version__,
        "wall": _plain(record["wall"]),
    }


def _combination(episode: Episode, experiment: str) -> Row:
    """Returns the values that identify an episode in a file of results."""
    facts = {key: Path(value).stem if key == "recipe" else value for key, value in episode.world.items() if key in ("recipe", "difficulty")}
    return {
        "key": episode.key,
        "experiment": experiment,
        "agent": episode.agent["name"],
        "task": episode.task,
        "world": episode.world["name"],
        **facts,
        "seed": episode.seed,
        "budget": episode.budget,
        "specification": _plain(own_agents.essence(episode.agent) if {"python", "pickle"} & episode.agent.keys() else dict(episode.agent)),
        "environment": _plain({key: value for key, value in episode.environment.items() if key not in OF_THE_MACHINE}),
    }


def _plain(value: Any) -> Any:
    """Converts NumPy numbers and arrays to Python numbers and lists. Numbers that are not finite become None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value
