"""Experiments are read, run, interrupted, and go on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from bench_world import Lattice, lattice_of

import stemworlds as sw
from stemworlds import bench
from stemworlds.errors import FileMissing, FormatError, OutputLocked

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


def start(asked: Path, out: Path, *words: str) -> subprocess.Popen[str]:
    program = str(Path(sys.executable).with_name("stemworlds"))
    # Its own group: a signal of the terminal goes to all of it.
    return subprocess.Popen(
        [program, "bench", "run", str(asked), "--out", str(out), *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )


def wait_for_rows(out: Path, count: int) -> None:
    for _ in range(600):
        if out.exists() and out.read_bytes().count(b"\n") >= count:
            return
        time.sleep(0.05)
    raise AssertionError("no rows came")


@pytest.mark.parametrize(("how", "processes"), [(signal.SIGKILL, "2"), (signal.SIGINT, "2")])
def test_a_run_goes_on_after_its_end(field_path: Path, tmp_path: Path, how: signal.Signals, processes: str) -> None:
    asked = tmp_path / "e.toml"
    asked.write_text(f'seeds = 30\nbudgets = [500]\ntasks = ["targeted"]\nagents = ["Random", "GP-UCB"]\nworlds = ["{field_path}"]\n')
    out = tmp_path / "out.jsonl"
    process = start(asked, out, "--processes", processes)
    wait_for_rows(out, 3)
    # Ctrl-C reaches the whole group, a kill the first process alone.
    (os.killpg if how == signal.SIGINT else os.kill)(process.pid, how)
    said, errors = process.communicate(timeout=30)
    if how == signal.SIGINT:
        assert process.returncode == 130 and "goes on" in errors and "Traceback" not in errors, errors
    there = len(bench.read_results(out))
    assert 3 <= there < 60
    # A last line that was cut off in the writing.
    with open(out, "ab") as file:
        file.write(b'{"key": "0123')
    done = start(asked, out, "--processes", "2", "--json")
    said, errors = done.communicate(timeout=120)
    summary = json.loads(said)
    assert done.returncode == 0, errors
    assert (summary["skipped"], summary["done"], summary["episodes"], summary["failed"]) == (there, 60 - there, 60, [])
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    assert len({line["key"] for line in lines}) == len(lines) == 60
    env = sw.bench.runner._environment(next(iter(bench.read_experiment(asked))))
    fresh = bench.play(env, bench.make_agent("GP-UCB"), 29)
    [same] = [line for line in lines if (line["agent"], line["seed"]) == ("GP-UCB", 29)]
    assert same["curve"] == fresh["curve"] and same["metrics"] == fresh["metrics"]


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
    assert {episode.environment_id for episode in bench.read_experiment("strict")} == {f"stemworlds/{task}Strict-v0" for task in bench.TASKS}


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
    ],
)
def test_wrong_experiments_are_told(tmp_path: Path, text: str, words: str) -> None:
    whole = {"seeds": "seeds = 2", "agents": 'agents = ["Raster"]', "worlds": 'worlds = [{recipe = "test"}]'}
    whole[text.partition(" ")[0]] = text
    (tmp_path / "e.toml").write_text("\n".join(whole.values()))
    with pytest.raises(sw.StemworldsError, match=words) as told:
        bench.read_experiment(tmp_path / "e.toml")
    assert str(tmp_path / "e.toml") in str(told.value)


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
