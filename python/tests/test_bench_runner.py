"""Experiments are read, run, interrupted, and go on."""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import os
import resource
import signal
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from bench_world import PAPER_TASKS, Lattice, lattice_of
from conftest import LONGEST_S, ended, until

import stemworlds as sw
from stemworlds import bench
from stemworlds.errors import DiskFull, FileMissing, FormatError, OutputLocked

pytest.importorskip("sklearn")

AGENTS = ["Nothing", "Random", "GP-UCB", "STEMAgent"]


def experiment(folder: Path, text: str = "", worlds: str = '["w.h5"]', seeds: int = 2) -> bench.Experiment:
    (folder / "w.h5").touch()
    path = folder / "e.toml"
    path.write_text(f'tasks = ["defect-census"]\nseeds = {seeds}\nbudgets = [600]\nworlds = {worlds}\nagents = {json.dumps(AGENTS)}\n{text}')
    return bench.read_experiment(path)


def rows(path: Path) -> dict[str, dict[str, Any]]:
    found = {row["key"]: row for row in bench.read_results(path)}
    for row in found.values():
        assert row.pop("wall")["seconds"] > 0
    return found


def test_any_number_of_processes_gives_the_same_rows(tmp_path: Path) -> None:
    asked = experiment(tmp_path)
    said: list[str] = []
    one = bench.run_experiment(asked, tmp_path / "one.jsonl", processes=1, make=lattice_of, progress=said.append)
    two = bench.run_experiment(asked, tmp_path / "two.jsonl", processes=2, make=lattice_of, progress=said.append)
    assert (one.done, one.skipped, one.failed) == (two.done, two.skipped, two.failed) == (8, 0, [])
    first = rows(tmp_path / "one.jsonl")
    assert len(first) == 8 and first == rows(tmp_path / "two.jsonl")
    row = next(iter(first.values()))
    assert row["world"] == "w" and row["budget"] == 600 and row["experiment"] == "e" and len(row["tiles"]) == len(row["dose"]) > 0
    assert "8 of 8" in said[-1] and "in all" in said[-1]
    again = bench.run_experiment(asked, tmp_path / "one.jsonl", processes=1, make=lattice_of, progress=said.append)
    assert (again.done, again.skipped) == (0, 8) and "8 episodes are done already" in said[-1]
    more = bench.run_experiment(experiment(tmp_path, seeds=3), tmp_path / "one.jsonl", processes=1, make=lattice_of, progress=said.append)
    assert (more.done, more.skipped) == (4, 8)


def test_a_process_plays_all_episodes_in_a_specimen(tmp_path: Path) -> None:
    asked = list(experiment(tmp_path, seeds=3))
    assert [episode.seed for episode in asked] == [0] * 4 + [1] * 4 + [2] * 4
    deal = bench.runner._Deal(asked, 2)
    # The first process is quick; the other plays one episode.
    played = [deal.next_of(0), deal.next_of(1)]
    assert [episode.seed for episode in played if episode is not None] == [0, 1]
    quick = [deal.next_of(0) for _ in range(11)]
    assert [None if episode is None else episode.seed for episode in quick] == [0] * 3 + [2] * 4 + [1] * 3 + [None]
    found = [episode.key for episode in [*played, *quick] if episode is not None]
    assert sorted(found) == sorted(episode.key for episode in asked)


class Model:
    """A language model that answers so many times, and then holds all that ask until it is told to go on."""

    def __init__(self, answers: int) -> None:
        self.held, self.go_on = threading.Event(), threading.Event()
        asked = itertools.count(1)
        model = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                self.rfile.read(int(self.headers["Content-Length"]))
                if next(asked) > answers and not model.go_on.is_set():
                    model.held.set()
                    model.go_on.wait()
                with contextlib.suppress(OSError):
                    self.send_response(200)
                    self.end_headers()
                    self.wfile.write(b'{"choices": [{"message": {"content": "{\\"defects\\": []}"}}]}')

            def log_message(self, *_: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self.url = f"http://127.0.0.1:{self._server.server_port}"

    def __enter__(self) -> Model:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.go_on.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def start(asked: Path, out: Path, *words: str) -> subprocess.Popen[str]:
    program = str(Path(sys.executable).with_name("stemworlds"))
    # Its own group: a signal of the terminal goes to all of it.
    return subprocess.Popen(
        [program, "bench", "run", str(asked), "--out", str(out), *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )


def rows_in(out: Path) -> int:
    return out.read_bytes().count(b"\n") if out.exists() else 0


def children(pid: int) -> list[int]:
    """Processes that a process has made."""
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        return [int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()]
    return []


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_run_goes_on_after_its_end(field_path: Path, tmp_path: Path, how: signal.Signals) -> None:
    asked, out = tmp_path / "e.toml", tmp_path / "out.jsonl"
    # Two agents that play by themselves, and one that cannot go on when the model is silent: so the run cannot end before it is ended.
    with Model(answers=2) as model:
        analyst = f'{{kind = "vlm", url = "{model.url}", model = "m", timeout_s = {LONGEST_S}}}'
        agents = f'["Random", "GP-UCB", {{name = "asking", navigator = "raster", analyst = {analyst}}}]'
        asked.write_text(f'seeds = 6\nbudgets = [200]\ntasks = ["targeted"]\nagents = {agents}\nworlds = ["{field_path}"]\n')
        process = start(asked, out, "--processes", "2")
        until(lambda: model.held.is_set() and rows_in(out) >= 3, process)
        workers = children(process.pid)
        assert len(workers) >= 2
        # Ctrl-C reaches the whole group, all else the first process alone.
        (os.killpg if how == signal.SIGINT else os.kill)(process.pid, how)
        _, errors = process.communicate(timeout=LONGEST_S)
        if how == signal.SIGINT:
            assert process.returncode == 130 and "goes on" in errors and "Traceback" not in errors, errors
        # Though each of them waits for the model, they end too.
        until(lambda: all(map(ended, workers)))
        there = len(bench.read_results(out))
        assert 3 <= there < 18
        # A last line that was cut off in the writing.
        with open(out, "ab") as file:
            file.write(b'{"key": "0123')
        model.go_on.set()
        done = start(asked, out, "--processes", "2", "--json")
        said, errors = done.communicate(timeout=LONGEST_S)
    summary = json.loads(said)
    assert done.returncode == 0, errors
    assert (summary["skipped"], summary["done"], summary["episodes"], summary["failed"]) == (there, 18 - there, 18, [])
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    assert len({line["key"] for line in lines}) == len(lines) == 18
    env = sw.bench.runner._environment(next(iter(bench.read_experiment(asked))))
    fresh = bench.play(env, bench.make_agent("GP-UCB"), 5)
    [same] = [line for line in lines if (line["agent"], line["seed"]) == ("GP-UCB", 5)]
    assert same["curve"] == fresh["curve"] and same["metrics"] == fresh["metrics"]


#: A module of a user. Its workers stop while they import it, before they have done anything of the runner's, and say so.
SLOW = """
import os, pathlib, time
from bench_world import lattice_of

HERE = pathlib.Path(__file__).parent
if os.environ["FIRST"] != str(os.getpid()):
    (HERE / f"{os.getpid()}.starting").touch()
    while not (HERE / "go").exists():
        time.sleep(0.01)


def make(episode):
    return lattice_of(episode)
"""
STARTS = """
import os, sys
os.environ["FIRST"] = str(os.getpid())
sys.path[:0] = sys.argv[1:3]
import slow
from stemworlds import bench
bench.run_experiment(bench.read_experiment(sys.argv[1] + "/e.toml"), sys.argv[1] + "/o.jsonl", processes=2, make=slow.make)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_workers_that_start_end_with_the_first_process(tmp_path: Path, how: signal.Signals) -> None:
    experiment(tmp_path)
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "starts.py").write_text(STARTS)
    words = [sys.executable, str(tmp_path / "starts.py"), str(tmp_path), str(Path(__file__).parent)]
    process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
    starting = until(lambda: len(found := list(tmp_path.glob("*.starting"))) == 2 and found, process)
    process.send_signal(how)
    assert process.wait(LONGEST_S) == -how
    # Only now they may go on, and find that nobody is there.
    (tmp_path / "go").touch()
    until(lambda: all(ended(int(path.stem)) for path in starting))
    assert rows_in(tmp_path / "o.jsonl") == 0


def test_a_full_disk_is_one_line_and_loses_nothing(field_path: Path, tmp_path: Path) -> None:
    asked, out = tmp_path / "e.toml", tmp_path / "out.jsonl"
    asked.write_text(f'seeds = 3\nbudgets = [200]\ntasks = ["targeted"]\nagents = ["Raster"]\nworlds = ["{field_path}"]\n')
    words = [str(Path(sys.executable).with_name("stemworlds")), "bench", "run", str(asked), "--out", str(out), "--processes", "1"]

    def run(room: int) -> subprocess.CompletedProcess[str]:
        """With so many bytes for a file."""

        def limit() -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))

        return subprocess.run(words, text=True, capture_output=True, timeout=LONGEST_S, preexec_fn=limit)

    # The first row fits, and half of the second.
    assert run(1 << 30).returncode == 0
    whole = out.read_bytes().splitlines(keepends=True)
    out.unlink()
    full = run(len(whole[0]) + len(whole[1]) // 2)
    assert full.returncode == 1 and full.stderr.count("\n") == 1, full.stderr
    assert full.stderr.startswith(f"error: {out}: cannot be written: File too large; all rows before are kept: make room, and run the same command again")
    assert [row["seed"] for row in bench.read_results(out)] == [0] and rows_in(out) == 1 and out.read_bytes().endswith(b"\n")
    assert run(1 << 30).returncode == 0
    assert [row["seed"] for row in bench.read_results(out)] == [0, 1, 2]


def test_a_disk_that_fails_leaves_whole_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, out = experiment(tmp_path), tmp_path / "o.jsonl"
    synced: list[int] = []

    def full(descriptor: int) -> None:
        synced.append(descriptor)
        if len(synced) == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DiskFull, match=r"o\.jsonl: cannot be written: No space left on device; all rows before are kept"):
        bench.run_experiment(asked, out, processes=1, make=lattice_of)
    assert len(bench.read_results(out)) == rows_in(out) == 2
    assert bench.run_experiment(asked, out, processes=1, make=lattice_of).done == 6


class Broken(Lattice):
    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        if seed == 1:
            raise ValueError("no beam")
        return super().reset(seed=seed)


def broken(episode: bench.Episode) -> Lattice:
    return Broken(budget=episode.budget)


def test_failures_are_noted_and_tried_again(tmp_path: Path) -> None:
    asked, out = experiment(tmp_path), tmp_path / "o.jsonl"
    said: list[str] = []
    summary = bench.run_experiment(asked, out, processes=1, make=broken, progress=said.append)
    assert summary.done == 4 and len(summary.failed) == 4 and "seed 1: ValueError: no beam" in summary.failed[0]
    # One kind of error is told once.
    assert sum("no beam" in line for line in said) == 1
    assert len(bench.read_results(out)) == 4 and {row["seed"] for row in bench.read_failures(out)} == {1}
    again = bench.run_experiment(asked, out, processes=1, make=lattice_of, progress=said.append)
    assert (again.skipped, again.done) == (4, 4) and bench.read_failures(out) == []


def test_one_run_writes_a_file_at_a_time(tmp_path: Path) -> None:
    with bench.ResultFile(tmp_path / "o.jsonl"), pytest.raises(OutputLocked, match="another run writes it"):
        bench.run_experiment(experiment(tmp_path), tmp_path / "o.jsonl", processes=1, make=lattice_of)


def test_the_experiments_of_the_package_are_whole() -> None:
    known = bench.packaged_experiments()
    assert {"main", "budgets", "ablations", "metrics", "strict"} <= known.keys() and all(known.values())
    main = bench.read_experiment("main")
    assert len(list(main)) == len(main.agents) * 4 * 15 * 10
    assert {world["split"] for world in main.worlds} == {"test"} and main.budgets == (5000.0,) and main.seeds == tuple(range(10))
    for name in known:
        episodes = list(bench.read_experiment(name))
        assert len({episode.key for episode in episodes}) == len(episodes)
        for world in bench.read_experiment(name).worlds:
            sw.Recipe(world["recipe"], world.get("difficulty"), set=world.get("set"))
    assert {episode.environment_id for episode in bench.read_experiment("strict")} == {f"stemworlds/{task}Strict-v0" for task in PAPER_TASKS}


def test_a_combination_has_the_same_name_wherever_it_lies(tmp_path: Path) -> None:
    keys = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        keys.append([episode.key for episode in experiment(folder, f"environment = {{threads = {len(keys)}}}")])
    assert keys[0] == keys[1] and len(set(keys[0])) == 8
    (tmp_path / "b/w.h5").write_bytes(b"another")
    assert not set(keys[0]) & {episode.key for episode in experiment(tmp_path / "b")}
    network = '[{name = "n", policy = {algorithm = "DQN", model = "m.zip"}}]'
    named = []
    for content in (b"1", b"22", b"22"):
        (tmp_path / "m.zip").write_bytes(content)
        text = f'seeds = 1\nagents = {network}\nworlds = [{{recipe = "test"}}]\ntasks = ["targeted"]\n'
        (tmp_path / "p.toml").write_text(text)
        [episode] = bench.read_experiment(tmp_path / "p.toml")
        assert episode.agent["policy"]["model"] == str(tmp_path / "m.zip")
        named.append(episode.key)
    assert named[0] != named[1] == named[2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seed = 3", "did you mean 'seeds'"),
        ("agents = []", "agents: expected a list"),
        ('agents = ["Nobody"]', "agent 'Nobody': unknown"),
        ('agents = ["Raster", "Raster"]', "'Raster' is there twice"),
        ('worlds = ["none.h5"]', "no such file"),
        ('worlds = [{recipe = "test", file = "w.h5"}]', "either file or recipe"),
        ('worlds = [{recipe = "test", dificulty = "easy"}]', "did you mean 'difficulty'"),
        ('tasks = ["census"]', "task 'census'"),
        ("budgets = [-5]", "budget -5"),
        ("seeds = [1, 1]", "different whole numbers"),
        ("strict = 1", "expected true or false"),
        ("environment = {horizn = 3}", "did you mean 'horizon'"),
        ("seeds = ", "not TOML"),
        ("seeds = 1000000000000", "expected 1 to 100000"),
        ("seeds = 0", "expected 1 to 100000"),
        ("seeds = -3", "expected 1 to 100000"),
        ("seeds = 100000\nbudgets = [1,2,3,4,5,6,7,8,9,10,11]", "4400000 episodes: expected 1000000 at most"),
        ('tasks = [["defect-census"]]', "task .'defect-census'.: unknown"),
        ("agents = [5]", "agent 5: expected a name, a table, or an object"),
        ('agents = [{name = "x", policy = 5}]', "policy = 5: expected a table"),
        ('agents = [{name = "x", navigator = "gp", analyst = "nothing", declare_every = "x"}]', "declare_every = 'x': expected a whole number"),
        ('worlds = [{recipe = "test", tasks = 5}]', "tasks of a world = 5: expected a list"),
        ('worlds = [{recipe = "test", grid = 3}]', "grid of a world = 3: expected rows and columns"),
        ('worlds = [{recipe = "test", difficulty = ["easy"]}]', "difficulty of a world = .'easy'.: expected a text"),
        ("name = 5", "name = 5: expected a text"),
        (f"seeds = {'[' * 50_000}", "not TOML"),
    ],
)
def test_wrong_experiments_are_told(tmp_path: Path, text: str, words: str) -> None:
    whole = {"seeds": "seeds = 2", "agents": 'agents = ["Raster"]', "worlds": 'worlds = [{recipe = "test"}]'}
    whole[text.partition(" ")[0]] = text
    (tmp_path / "e.toml").write_text("\n".join(whole.values()))
    with pytest.raises(sw.StemworldsError, match=words) as told:
        bench.read_experiment(tmp_path / "e.toml")
    assert str(tmp_path / "e.toml") in str(told.value)


#: What TOML can hold.
NONSENSE = [5, -1, 1.5, float("nan"), True, "x", "\0", [], [[]], [5], [["x"]], {}, {"x": 1}, {"name": "x"}, [{"x": []}], [{"name": "x"}], 10**400]


@pytest.mark.parametrize(
    "where",
    [
        *([key] for key in ("name", "about", "tasks", "strict", "seeds", "budgets", "agents", "worlds", "environment")),
        *(["agents", 0, key] for key in ("name", "navigator", "analyst", "planner", "policy", "declare_every")),
        *(["worlds", 0, key] for key in ("name", "recipe", "file", "difficulty", "grid", "live", "split", "tasks")),
        *([key, 0] for key in ("tasks", "seeds", "budgets", "agents", "worlds")),
        ["agents", 0, "navigator", "kind"],
    ],
    ids=lambda where: ".".join(map(str, where)),
)
def test_nonsense_is_an_error_of_its_own_or_an_experiment(tmp_path: Path, where: list[Any]) -> None:
    path = tmp_path / "e.toml"
    path.touch()
    for value in NONSENSE:
        table: dict[str, Any] = {"tasks": ["targeted"], "seeds": [0], "budgets": [5]}
        table |= {"agents": [{"name": "x", "navigator": {"kind": "gp"}, "analyst": "nothing"}], "worlds": [{"recipe": "test"}]}
        inner: Any = table
        for key in where[:-1]:
            inner = inner[key]
        inner[where[-1]] = value
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("tomllib.loads", lambda text, table=table: table)
            try:
                episodes = list(bench.read_experiment(path))
            except sw.StemworldsError as error:
                assert str(error).startswith(str(path)) and len(str(error)) < 1000
            else:
                assert all(episode.key and episode.environment_options for episode in episodes)


def test_wrong_files_of_results_are_told(tmp_path: Path) -> None:
    with pytest.raises(FileMissing, match="bench run writes one"):
        bench.read_results(tmp_path / "none.jsonl")
    for text, words in (("", "no results in it yet"), ("no JSON\n", ":1: no JSON"), ('{"key": 1}\n', ":1: no result of an episode")):
        (tmp_path / "o.jsonl").write_text(text)
        with pytest.raises(FormatError, match=words):
            bench.read_results(tmp_path / "o.jsonl")
    with pytest.raises(FileMissing, match="no experiment of the package"):
        bench.read_experiment("nothing-of-the-kind")
    (tmp_path / "o.jsonl").write_bytes(b"\xff\xfe\n")
    with pytest.raises(FormatError, match=":1: no JSON"):
        bench.read_results(tmp_path / "o.jsonl")
    with pytest.raises(FormatError, match="no text in UTF-8"):
        bench.read_experiment(tmp_path / "o.jsonl")


def test_files_that_hold_something_else_stay_as_they_are(tmp_path: Path) -> None:
    asked = experiment(tmp_path)
    for held in (b"my notes, without an end", b"a line\nand no end", b"\x89HDF\r\n\x1a\nabc", b'{"name": "of my own"}', b'{"key":1}\n{"key":"'):
        out = tmp_path / "notes.txt"
        out.write_bytes(held)
        with pytest.raises(FormatError, match=r"notes\.txt"):
            bench.run_experiment(asked, out, processes=1, make=lattice_of)
        assert out.read_bytes() == held
    out = tmp_path / "cut.jsonl"
    out.write_bytes(b'{"key":"half of a li')
    assert bench.run_experiment(asked, out, processes=1, make=lattice_of).done == 8


def test_times_left_are_told_when_there_is_a_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    from stemworlds.bench.progress import Progress

    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    said: list[str] = []
    progress = Progress(100, 0, said.append)
    # The first takes long: it fills a library.
    for seconds in (600, 620, 640, 660, 680):
        now[0] = seconds
        progress.step("x")
    assert "10 min so far" in said[0] and "about" not in said[1]
    assert "5 of 100, about 32 min left" in said[-1]
