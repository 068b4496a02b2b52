"""A guest in the process: interrupts, threads, progress, warnings, and no handlers of signals."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import logging
import os
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import LONGEST_S, TINY, command, until

import stemworlds as sw


def computing() -> bool:
    """Whether a thread of the library runs in this process."""
    names = []
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            names.append((task / "comm").read_text())
    return any(name.startswith("stemworlds") for name in names)


def interrupted(work: Callable[[], Any], when: Callable[[], Any]) -> None:
    """A call that another thread of Python interrupts with Ctrl-C when something has happened."""

    def interrupt() -> None:
        until(when)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            work()
    finally:
        thread.join()


def test_ctrl_c_ends_a_simulation_while_other_threads_run(silicon: Any) -> None:
    """The simulation would take days, and the thread that interrupts it runs Python meanwhile."""
    until(lambda: not computing())
    counted: list[int] = []

    def begun() -> bool:
        if computing():
            counted.append(len(counted))
        return len(counted) == 100

    interrupted(lambda: sw.simulate(silicon, phonons=4096, sigma=0.08, scan=sw.Scan(points=(512, 512))), begun)
    # Nothing is left of it: its threads end, and the next call works.
    until(lambda: not computing())
    assert sw.simulate(silicon, scan=sw.Scan(points=(2, 2))).array.shape == (2, 2)


def test_ctrl_c_loses_nothing_of_a_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    slow: dict[str, Any] = {"grid": (1, 1), "subtile_nm": 0.8, "subtile_overlap_nm": 0.1, "audit": 0, "cache": False, "engine": "window"}
    slow["set"] = {"field.thickness_nm": 0.8, "phonons.configurations": 2}
    seen: list[tuple[str, int]] = []

    def build(out: str) -> sw.World:
        return sw.build("test", out=out, progress=lambda stage, unit, done, total: seen.append((stage, done)), **slow)

    # A build that is at its end when Ctrl-C is heard proves nothing: then another one is interrupted.
    for number in itertools.count():
        out = f"{number}.h5"
        work = Path(f"{out}.work")
        interrupted(lambda out=out: build(out), lambda work=work: len([path for path in work.rglob("*") if path.is_file()]) > 4)
        until(lambda: not computing())
        if not Path(out).exists():
            break
        assert number < 20, "no build can be interrupted"
    assert work.is_dir()
    world = build(out)
    assert world.summary is not None and world.summary["subtiles_resumed"] > 0
    assert not work.exists()
    whole = sw.build("test", out="whole.h5", **slow)
    assert whole.image().array.tobytes() == world.image().array.tobytes()
    assert seen and seen[-1][1] > 0


def test_no_thread_and_no_handler_stays(tmp_path: Path) -> None:
    program = f"""
    import os, signal, time
    import stemworlds as sw
    tasks = lambda: sorted(open(f"/proc/self/task/{{t}}/comm").read() for t in os.listdir("/proc/self/task"))
    handlers = lambda: [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    caught = lambda: [line for line in open("/proc/self/status") if line.startswith("SigCgt")]
    before = (tasks(), handlers(), caught())
    options = {TINY!r}
    world = sw.build("test", out={str(tmp_path / "w.h5")!r}, audit=1, png=True, **options)
    sw.plan("test", **options); sw.specimen_arrays("test", **options); sw.view(world, out={str(tmp_path / "v.html")!r})
    sw.acquire(world, region_nm=(1.2, 1.2, 1.5, 1.5)); sw.audit(world, regions=1, size_nm=0.3, configurations=1)
    sw.specimen_arrays("pt", difficulty="easy", grid=(1, 1)); sw.Recipe("pt", "easy"); sw.compare(world.path, world.path)
    world.columns, world.sites, world.phase_map, world.truth_table(), world.image().to_hspy({str(tmp_path / "i.hspy")!r})
    # Threads end soon after their call.
    while tasks() != before[0]:
        time.sleep(0.01)
    assert (handlers(), caught()) == before[1:], (handlers(), caught(), before)
    print("ok")
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], text=True, capture_output=True, cwd=tmp_path, timeout=LONGEST_S)
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


def test_bars_with_tqdm(silicon: Any, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("tqdm")
    sw.simulate(silicon, scan=sw.Scan(points=(8, 8)), progress=True)
    assert "simulating" in capfd.readouterr().err


def test_lines_without_tqdm(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now = [100.0]
    monkeypatch.setattr("stemworlds._running.time.monotonic", lambda: now[0])
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    told = sw._running.running(None, True)["progress"]
    assert told is not None
    for seconds, done in ((101.0, 1), (102.0, 2), (105.0, 3), (110.0, 4)):
        now[0] = seconds
        told("simulating", "probe", done, 8)
    # The first after two seconds, the next eight seconds later.
    assert capsys.readouterr().err == "simulating: 25 %, 2 of 8 probes\nsimulating: 50 %, 4 of 8 probes\n"


def test_the_package_installs_the_program_and_its_own_commands(tmp_path: Path) -> None:
    assert command("--version", cwd=tmp_path).stdout == f"stemgen {sw.__version__}\n"
    help_text = command("build", "--help", cwd=tmp_path).stdout
    assert "stemgen build srtio3" in help_text and "stemworlds" not in help_text
    own = Path(sys.executable).with_name("stemworlds")
    told = subprocess.run([own, "--help"], text=True, capture_output=True, cwd=tmp_path)
    assert told.returncode == 0 and "bench" in told.stdout and "serve" in told.stdout and "`stemgen`" in told.stdout
    bad = command("build", "srtio", cwd=tmp_path, check=False)
    assert bad.returncode == 1 and "did you mean `srtio3`" in bad.stderr
    usage = command("simulate", "--nothing", cwd=tmp_path, check=False)
    assert usage.returncode == 2 and "stemgen simulate" in usage.stderr
    module = subprocess.run([sys.executable, "-m", "stemworlds", "list", "test"], text=True, capture_output=True, cwd=tmp_path)
    assert module.returncode == 0 and "test" in module.stdout


def test_the_command_line_ends_at_ctrl_c(tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("stemgen")
    # Minutes of work on any machine, and a file of it early.
    words = [str(program), "build", "test", "--set", "field.thickness_nm=8", "--set", "phonons.configurations=16", "--no-cache", "--audit", "0"]
    running = subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    try:
        until(lambda: list(tmp_path.glob("worlds/*.work/**/*")), running)
        running.send_signal(signal.SIGINT)
        _, told = running.communicate(timeout=LONGEST_S)
    finally:
        running.kill()
    assert running.returncode == 130 and "Traceback" not in told, told
