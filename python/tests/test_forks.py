"""Processes that are forked while other threads work."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DYING, LONGEST_S

import stemworlds as sw
from stemworlds import _forking, bench

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here"),
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),
]

PLACE = (1.2, 1.2, 2.4, 2.2)


def in_a_fork(work: Callable[[], Any]) -> str:
    """What a child of a fork says."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            signal.alarm(LONGEST_S)
            try:
                told = str(work())
            except Exception as error:
                told = f"{type(error).__name__}: {error}"
            os.write(writer, told.encode())
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as file:
        told = file.read().decode()
    os.waitpid(child, 0)
    return told


@pytest.fixture
def beside() -> Iterator[Callable[[Callable[[], Any]], None]]:
    """Runs something in other threads, again and again until the test is over."""
    over = threading.Event()
    threads: list[threading.Thread] = []

    def run(work: Callable[[], Any]) -> None:
        begun = threading.Event()

        def again() -> None:
            while not over.is_set():
                work()
                begun.set()

        threads.append(threading.Thread(target=again))
        threads[-1].start()
        begun.wait()

    yield run
    over.set()
    for thread in threads:
        thread.join()


def test_children_read_a_world_that_another_thread_reads(world_path: Path, beside: Any) -> None:
    world, other = sw.World(world_path), sw.World(world_path)
    expected = str(float(world.image().array.sum()))
    beside(world.image)
    beside(other.truth_table)
    for _ in range(20):
        assert in_a_fork(lambda: str(float(world.image().array.sum()))) == expected
    assert in_a_fork(lambda: str(float(sw.World(world_path).image().array.sum()))) == expected


def test_a_fork_waits_for_reads_of_other_threads() -> None:
    reads, go_on, done = threading.Event(), threading.Event(), []

    def read() -> None:
        reads.set()
        go_on.wait()
        done.append("read")

    thread = threading.Thread(target=_forking.reading(read))
    thread.start()
    reads.wait()
    # A read of its own is none to wait for; the other goes on when the fork waits.
    waiting = threading.Thread(target=lambda: (until_it_waits(), go_on.set()))
    waiting.start()
    assert _forking.reading(in_a_fork)(lambda: (done, _forking._reads)) == "(['read'], {})"
    thread.join()
    waiting.join()
    assert _forking._reads == {}


def until_it_waits() -> None:
    """Until a fork waits: it then waits at the condition that all others take to begin or end."""
    while not _forking._changed._waiters:  # type: ignore[attr-defined]
        os.sched_yield()


def recording(live: sw.LiveWorld, work: Callable[[], str]) -> str:
    """What happens while another thread uses a live world; a recording itself may have nothing to simulate, and be over."""
    records, go_on = threading.Event(), threading.Event()

    def use() -> None:
        records.set()
        go_on.wait()

    thread = threading.Thread(target=live._used.by(use))
    thread.start()
    records.wait()
    try:
        return work()
    finally:
        go_on.set()
        thread.join()


@pytest.mark.long
def test_a_live_world_that_another_thread_uses_is_refused_in_a_child(library: str) -> None:
    options: dict[str, Any] = {"grid": (1, 1), "set": DYING, "seed": 3, "most_dose": 5e5, "cache": library}
    live, free = sw.LiveWorld("test", **options), sw.LiveWorld("test", **options)
    live.acquire(region_nm=PLACE, dose=1e4)
    uses: tuple[Callable[[], Any], ...] = (lambda: live.look(PLACE), lambda: live.acquire(region_nm=PLACE, dose=1e3), lambda: live.history, live.snapshot)
    for use in uses:
        told = recording(live, lambda use=use: in_a_fork(use))
        assert told.startswith("StemworldsError: this live world was in use by another thread") and "get_context('spawn')" in told
    # The world that nobody used works, and so does this one where nobody uses it.
    assert recording(live, lambda: in_a_fork(lambda: str(free.dose(PLACE)))) == "0.0"
    assert in_a_fork(lambda: str(live.dose(PLACE))) == str(live.dose(PLACE)) != "0.0"
    assert len(live.history) == 1


def test_an_environment_that_another_thread_uses_is_refused_in_a_child(field_path: Path) -> None:
    env, free = (bench.MicroscopeEnv(world=field_path, overview=False) for _ in range(2))
    env.reset(seed=0)
    free.reset(seed=0)
    steps, go_on = threading.Event(), threading.Event()

    def step() -> None:
        steps.set()
        go_on.wait()

    thread = threading.Thread(target=env._episodes._used.by(step))
    thread.start()
    steps.wait()
    assert in_a_fork(lambda: str(env.acquire(0, 0))).startswith("StemworldsError: this environment was in use")
    told = in_a_fork(lambda: str(free.acquire(0, 0)[0]["tile"].sum()))
    go_on.set()
    thread.join()
    assert told == str(np.sum(free.acquire(0, 0)[0]["tile"]))
