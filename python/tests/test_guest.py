"""A guest in the process: interrupts, threads, progress, warnings, and no handlers of signals."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from conftest import TINY

import stemworlds as sw


def interrupted_after(seconds: float, work: Any) -> float:
    """How long after Ctrl-C a call ends with KeyboardInterrupt."""
    sent = []

    def send() -> None:
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(seconds, send)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        work()
    took = time.monotonic() - sent[0]
    timer.join()
    return took


def test_ctrl_c_ends_a_simulation_within_a_second(silicon: Any) -> None:
    large = silicon * (2, 2, 10)
    assert interrupted_after(1.0, lambda: sw.simulate(large, phonons=64, sigma=0.08)) < 1.0
    # Nothing is left of it: the next call works.
    assert sw.simulate(silicon, scan=sw.Scan(points=(2, 2))).array.shape == (2, 2)


def test_ctrl_c_loses_nothing_of_a_build(tmp_path: Path) -> None:
    slow = {"set": {"field.thickness_nm": 1.2, "phonons.configurations": 2}, "grid": (1, 1), "subtile_nm": 1.2, "audit": 0, "cache": False}
    out = tmp_path / "w.h5"
    seen: list[tuple[str, int]] = []

    def build() -> sw.World:
        return sw.build("test", out=out, progress=lambda stage, unit, done, total: seen.append((stage, done)), **slow)

    def until_some_is_done() -> None:
        timer = threading.Thread(target=lambda: (wait_for(lambda: len(list((tmp_path / "w.h5.work").glob("**/*"))) > 4), os.kill(os.getpid(), signal.SIGINT)))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            build()
        timer.join()

    until_some_is_done()
    assert not out.exists() and (tmp_path / "w.h5.work").is_dir()
    world = build()
    assert world.summary is not None and world.summary["subtiles_resumed"] > 0
    whole = sw.build("test", out=tmp_path / "whole.h5", **slow)
    assert whole.image().array.tobytes() == world.image().array.tobytes()
    assert seen and seen[-1][1] > 0


def wait_for(done: Any) -> None:
    end = time.monotonic() + 60
    while not done() and time.monotonic() < end:
        time.sleep(0.01)


def test_other_threads_run_meanwhile(silicon: Any) -> None:
    ticks = []
    stop = threading.Event()

    def tick() -> None:
        while not stop.wait(0.02):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    begun = time.monotonic()
    sw.simulate(silicon, phonons=2, sigma=0.08, scan=sw.Scan(points=(24, 24)))
    took = time.monotonic() - begun
    stop.set()
    thread.join()
    assert took > 0.2 and len(ticks) > took / 0.02 / 4, (took, len(ticks))


def test_no_thread_and_no_handler_stays(tmp_path: Path) -> None:
    program = f"""
    import os, signal, threading
    import stemworlds as sw
    tasks = lambda: sorted(open(f"/proc/self/task/{{t}}/comm").read() for t in os.listdir("/proc/self/task"))
    handlers = lambda: [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    caught = lambda: [line for line in open("/proc/self/status") if line.startswith("SigCgt")]
    before = (tasks(), handlers(), caught())
    options = {TINY!r}
    world = sw.build("test", out={str(tmp_path / "w.h5")!r}, cache=False, audit=1, png=True, **options)
    sw.plan("test", **options); sw.specimen_arrays("test", **options); sw.view(world, out={str(tmp_path / "v.html")!r})
    sw.acquire(world, region_nm=(1.2, 1.2, 1.5, 1.5)); sw.audit(world, regions=1, size_nm=0.3, configurations=1)
    sw.specimen_arrays("pt", difficulty="easy", grid=(1, 1)); sw.Recipe("pt", "easy"); sw.compare(world.path, world.path)
    world.columns, world.sites, world.phase_map, world.truth_table(), world.image().to_hspy({str(tmp_path / "i.hspy")!r})
    assert (tasks(), handlers(), caught()) == before, (tasks(), handlers(), caught(), before)
    print("ok")
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], text=True, capture_output=True, cwd=tmp_path)
    assert done.stdout == "ok\n", done.stderr


def test_progress_is_told(silicon: Any) -> None:
    told: list[tuple[str, str, int, int]] = []
    sw.simulate(silicon, scan=sw.Scan(points=(8, 8)), progress=lambda *event: told.append(event))
    assert {event[0] for event in told} == {"simulating"} and told[-1][2:] == (64, 64)
    assert all(0 <= done <= total for _, _, done, total in told)


def test_warnings_are_logged(silicon: Any, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, logger="stemworlds"):
        sw.simulate(silicon, scan=sw.Scan(start=(-0.1, 0), end=(0.1, 0.1), points=(2, 2)))
    assert "the cell again" in caplog.text


def test_bars_without_and_with_tqdm(silicon: Any, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("tqdm")
    sw.simulate(silicon, scan=sw.Scan(points=(8, 8)), progress=True)
    assert "simulating" in capfd.readouterr().err


def test_the_command_line_follows_its_name(tmp_path: Path) -> None:
    from conftest import command

    assert command("--version", cwd=tmp_path).stdout == f"stemworlds {sw.__version__}\n"
    help_text = command("build", "--help", cwd=tmp_path).stdout
    assert "stemworlds build srtio3" in help_text and "stemgen build" not in help_text
    bad = command("build", "srtio", cwd=tmp_path, check=False)
    assert bad.returncode == 1 and "did you mean `srtio3`" in bad.stderr
    usage = command("simulate", "--nothing", cwd=tmp_path, check=False)
    assert usage.returncode == 2 and "stemworlds simulate" in usage.stderr
    module = subprocess.run([sys.executable, "-m", "stemworlds", "list", "test"], text=True, capture_output=True, cwd=tmp_path)
    assert module.returncode == 0 and "test" in module.stdout


def test_the_command_line_ends_at_ctrl_c(tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("stemworlds")
    words = [str(program), "build", "test", "--set", "field.thickness_nm=8", "--set", "phonons.configurations=16", "--no-cache"]
    running = subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    wait_for(lambda: list(tmp_path.glob("worlds/*.work/**/*")))
    running.send_signal(signal.SIGINT)
    _, told = running.communicate(timeout=10)
    assert running.returncode == 130 and "Traceback" not in told, told
