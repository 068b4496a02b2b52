"""The page of results, its tables, and the commands."""

from __future__ import annotations

import csv
import errno
import json
import os
import random
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import command

import stemworlds as sw
from stemworlds import bench
from stemworlds.bench.command import main

pytest.importorskip("scipy")

AGENTS = {"Nothing": "nothing", "Random": "heuristic", "Raster": "heuristic", "STEMAgent": "heuristic", "Raster+Oracle": "oracle"}
#: Agents of the scale from guessing to seeing, for tests that ask for them.
SCALE = {"Prior": "prior", "Ideal": "ideal"}
SKILL = {"Prior": 0.2, "Ideal": 0.9, "Nothing": 0.0, "Random": 0.1, "Raster": 0.4, "STEMAgent": 0.41, "Raster+Oracle": 1.0}


def row(agent: str, task: str, world: tuple[str, str], seed: int, budget: float = 5000.0) -> dict[str, Any]:
    """A result as the runner writes it."""
    noise = np.random.default_rng([seed, len(agent), len(task), len(world[1])])
    level = SKILL[agent] * (0.8 if world[1] == "hard" else 1.0) + (0.02 * float(noise.random()) if 0 < SKILL[agent] < 1 else 0.0)
    curve = [[share, round(level * min(1.0, 0.6 + share), 6)] for share in np.linspace(0.1, 1.0, 10).tolist()]
    area = bench.dec_auc(curve)
    metrics = {"dec_auc": area, "final_score": curve[-1][1], "time_to_threshold": 1 - level / 2, "early_weighted": 0.9 * area}
    metrics |= {"late_weighted": 1.1 * area, "half_budget": area / 2}
    return {
        "key": f"{agent} {task} {world} {seed} {budget}",
        "experiment": "made",
        "agent": agent,
        "task": task,
        "world": "-".join(world),
        "recipe": world[0],
        "difficulty": world[1],
        "seed": seed,
        "budget": budget,
        "specification": {"name": agent, "navigator": {"kind": "raster"}, "analyst": {"kind": {**AGENTS, **SCALE}[agent]}},
        "environment": {},
        "metrics": metrics,
        "curve": curve,
        "scores": {"paper": curve[-1][1], "strict": curve[-1][1] / 4, "columns": {"precision": 0.5, "recall": 0.25, "average_precision": None}},
        "grid": [4, 5],
        "tiles": [[0, 0], [0, 1], [3, 4]],
        "ended": "done",
        "unreadable": int(agent == "Random" and seed == 0),
        "notes": {"model_unparsable": 2} if agent == "STEMAgent" else {},
        "modes": [],
        "version": "1",
        "wall": {"seconds": 0.5 + seed, "seconds_per_tile": 0.01},
    }


def made(**less: Any) -> list[dict[str, Any]]:
    worlds = less.get("worlds", [("srtio3", "easy"), ("srtio3", "hard"), ("pt", "easy"), ("pt", "hard")])
    tasks, budgets, agents = less.get("tasks", ["defect-census", "targeted"]), less.get("budgets", [1000.0, 5000.0]), less.get("agents", AGENTS)
    return [row(a, t, w, s, b) for a in agents for t in tasks for w in worlds for s in range(less.get("seeds", 4)) for b in budgets]


def written(path: Path, rows: list[dict[str, Any]]) -> Path:
    path.write_text("".join(json.dumps(line) + "\n" for line in rows))
    return path


def table(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


class Page(HTMLParser):
    """Checks that elements are closed in their order, and collects addresses and texts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.headings: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("h2", "h3"):
            self.headings.append(data)


def test_the_page_has_every_section_that_the_results_support(tmp_path: Path) -> None:
    failed = {**row("Random", "targeted", ("srtio3", "easy"), 77), "error": "Random, seed 77: <no beam>"}
    path = written(tmp_path / "r.jsonl", [*made(), *made(agents=SCALE), failed])
    files = bench.write_report(path, tmp_path / "page.html")
    assert [file.name for file in files] == ["page.html", "page-agents.csv", "page-episodes.csv", "page-pairs.csv"]
    text = files[0].read_text()
    page = Page(text)
    sections = [heading for heading in page.headings if heading not in ("defect-census", "targeted")]
    assert sections[:2] == ["Seeing and guessing", "Agents and tasks"] and len(sections) == 13
    # All but the section of tasks that are not played here; test_bench_field.py looks at that one.
    assert "Left out, since these results do not hold what they need: the field (needs tasks that ask for the field)." in text
    # Nothing is fetched from anywhere.
    assert all(address.startswith("#") for address in page.addresses) and "http" not in text and "@import" not in text and "url(#" in text
    for words in ("paper 0.052 ± 0.038", "paper 0.278 ± 0.120*", "prefers-color-scheme:dark", "&lt;no beam&gt;", "model unparsable 128", "paper 0.097"):
        assert words in text, words


def test_the_same_results_give_the_same_bytes(tmp_path: Path) -> None:
    rows = made()
    first = [path.read_bytes() for path in bench.write_report(written(tmp_path / "a.jsonl", rows), tmp_path / "page.html")]
    random.Random(1).shuffle(rows)
    half = [written(tmp_path / "b.jsonl", rows[:50]), written(tmp_path / "c.jsonl", rows[50:])]
    assert [path.read_bytes() for path in bench.write_report(half, tmp_path / "page.html")] == first


def test_tables_hold_the_numbers(tmp_path: Path) -> None:
    rows = made()
    _, agents, episodes, pairs = bench.write_report(written(tmp_path / "r.jsonl", rows), tmp_path / "page.html")
    areas = [r["metrics"]["dec_auc"] for r in rows if (r["agent"], r["task"], r["budget"]) == ("Raster", "targeted", 5000)]
    [line] = [r for r in table(agents) if (r["agent"], r["task"], r["budget"]) == ("Raster", "targeted", "5000")]
    assert int(line["episodes"]) == 16 and float(line["dec_auc_mean"]) == pytest.approx(np.mean(areas), rel=1e-5)
    assert float(line["dec_auc_std"]) == pytest.approx(np.std(areas, ddof=1), rel=1e-5)
    assert (float(line["ci95_low"]), float(line["ci95_high"])) == pytest.approx(bench.bootstrap_interval(areas), abs=0.002)
    assert line["paper_mean"] == "0" and {r["paper_mean"] for r in table(agents) if r["budget"] == "1000"} == {""}
    assert len(table(episodes)) == len(rows)
    found = {(r["task"], r["a"], r["b"]): r for r in table(pairs)}
    assert len(found) == 12
    far, near = found["defect-census", "Random", "Raster"], found["defect-census", "Raster", "STEMAgent"]
    assert float(far["p_wilcoxon"]) < 0.001 and far["equivalent"] == "no" and near["equivalent"] == "yes"
    assert float(near["mean_difference"]) == pytest.approx(-0.008, abs=0.01)


@pytest.mark.parametrize(
    ("less", "missing", "there"),
    [
        ({"budgets": [5000.0]}, ["budgets (needs"], ["Strict scores"]),
        ({"worlds": [("srtio3", "easy")]}, ["world by world", "easy, medium, hard"], ["Where agents looked"]),
        ({"agents": ["Raster"], "seeds": 1}, ["which agents differ", "other metrics"], ["Agents and tasks"]),
    ],
)
def test_sections_without_data_are_left_out_and_named(tmp_path: Path, less: dict[str, Any], missing: list[str], there: list[str]) -> None:
    text = bench.write_report(written(tmp_path / "r.jsonl", made(**less)), tmp_path / "page.html")[0].read_text()
    page = Page(text)
    left = text[text.index("Left out") :]
    for words in missing:
        assert words in left and words.split(" (")[0].capitalize() not in page.headings
    assert set(there) <= set(page.headings)


def test_results_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    first = made(agents=["Raster"])
    other = [{**line, "key": line["key"] + "2", "specification": {"name": "Raster", "analyst": {"kind": "oracle"}}} for line in first]
    with pytest.raises(sw.InvalidValue, match="agent 'Raster' is of two kinds"):
        bench.leaderboard([written(tmp_path / "a.jsonl", first), written(tmp_path / "b.jsonl", other)])
    other = [{**line, "key": line["key"] + "2", "environment": {"cadence": 2}} for line in first]
    with pytest.raises(sw.InvalidValue, match="different options"):
        bench.leaderboard([written(tmp_path / "a.jsonl", first), written(tmp_path / "b.jsonl", other)])
    with pytest.raises(sw.InvalidValue, match="ends in .html"):
        bench.write_report(tmp_path / "a.jsonl", tmp_path / "page")


def test_agents_are_ranked_in_what_all_played(tmp_path: Path) -> None:
    rows = made()
    tables = bench.leaderboard(written(tmp_path / "r.jsonl", rows))
    assert [(table["task"], table["budget"]) for table in tables] == [(t, b) for t in ("defect-census", "targeted") for b in (1000, 5000)]
    lines = {line["agent"]: line for line in tables[1]["agents"]}
    assert [lines[name]["rank"] for name in ("STEMAgent", "Raster", "Random", "Nothing", "Raster+Oracle")] == [1, 2, 3, None, None]
    floor, ceiling = lines["Nothing"]["mean"], lines["Raster+Oracle"]["mean"]
    assert lines["Raster"]["of_the_way"] == pytest.approx((lines["Raster"]["mean"] - floor) / (ceiling - floor))
    # Random lacks the hard worlds: all others are compared without them.
    fewer = [r for r in rows if r["agent"] != "Random" or r["difficulty"] == "easy"]
    second = bench.leaderboard(written(tmp_path / "f.jsonl", fewer))
    lines = {line["agent"]: line for line in second[1]["agents"]}
    assert {line["episodes"] for line in lines.values()} == {8} and "of 16 worlds and seeds the 8" in second[1]["note"]
    apart = [r for r in rows if (r["agent"] == "Raster") == (r["difficulty"] == "easy")]
    assert "in common" in bench.leaderboard(written(tmp_path / "g.jsonl", apart))[1]["note"]


def test_what_results_say_is_text_and_nothing_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Results may come from strangers: neither pages, spreadsheets nor terminals do what they say."""
    evil = {"Random": "=HYPERLINK(\"http://x\")", "Raster": "@SUM(A1)", "STEMAgent": "<script>x</script>", "Nothing": "-2\x1b[2J\r\nrank"}
    rows = made()
    for line in rows:
        line["agent"] = evil.get(line["agent"], line["agent"])
        line["world"] = "+" + line["world"]
        line["notes"] = {"<img src=x onerror=y>": 2}
        line["experiment"], line["version"] = "<b>", "<i>"
    failed = {**rows[0], "key": "failed", "error": "x: <u>\x1b[2J"}
    path = written(tmp_path / "r.jsonl", [*rows, failed])
    page, *tables = bench.write_report(path, tmp_path / "page.html")
    text = page.read_text()
    Page(text)
    assert not any(tag in text for tag in ("<script", "<img", "<b>;", "<i>.", "<u>")) and "&lt;img src=x" in text
    for one in tables:
        for line in table(one):
            for name, value in line.items():
                # Numbers stay numbers, the negative ones too.
                numbers = name in ("mean_difference", "dec_auc", "ci95_low") or not value.startswith(("=", "+", "-", "@", "\t", "\r"))
                assert numbers, (name, value)
    names = {line["agent"] for line in table(tables[0])}
    assert names == {"'=HYPERLINK(\"http://x\")", "'@SUM(A1)", "<script>x</script>", "'-2\x1b[2J\r\nrank", "Raster+Oracle"}
    assert any(float(line["mean_difference"]) < 0 for line in table(tables[2]))
    assert main(["leaderboard", str(path)]) == 0
    said = capsys.readouterr().out
    assert all(line.isprintable() for line in said.split("\n")) and "-2\\x1b[2J\\r\\nrank" in said
    (tmp_path / "odd.jsonl").write_text('{"key": "\\u001b[2J"}\n')
    assert main(["leaderboard", str(tmp_path / "odd.jsonl")]) == 1
    assert capsys.readouterr().err.removesuffix("\n").isprintable()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("agent", 5),
        ("task", "=1"),
        ("world", None),
        ("seed", "=1+1"),
        ("seed", -1),
        ("budget", "5000"),
        ("budget", 10**400),
        ("metrics", {"dec_auc": "=1"}),
        ("curve", [[0, "x"]]),
        ("curve", [[0]]),
        ("grid", [10**9, 10**9]),
        ("grid", ["4", 5]),
        ("tiles", [[9, 0]]),
        ("tiles", 3),
        ("notes", {"x": "<b>"}),
        ("wall", {"seconds": "=1"}),
        ("scores", {"strict": "=1"}),
        ("scores", {"columns": 3}),
        ("specification", {"analyst": 5}),
        ("unreadable", "="),
    ],
)
def test_rows_of_another_kind_are_no_results(tmp_path: Path, key: str, value: Any) -> None:
    rows = made(agents=["Raster"], seeds=1)
    rows[2][key] = value
    with pytest.raises(sw.FormatError, match=r"r\.jsonl:3: no result of an episode: ."):
        bench.leaderboard(written(tmp_path / "r.jsonl", rows))


@pytest.mark.parametrize("when", ["write", "replace"])
def test_a_report_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str) -> None:
    path = written(tmp_path / "r.jsonl", made(agents=["Raster"]))
    before = {file: file.read_bytes() for file in bench.write_report(path, tmp_path / "page.html")}
    written(path, made(agents=["Random"]))

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, {"write": "fsync", "replace": "replace"}[when], full)
    with pytest.raises(sw.errors.DiskFull, match=r"page\.html: cannot be written: No space left"):
        bench.write_report(path, tmp_path / "page.html")
    assert {file: file.read_bytes() for file in tmp_path.iterdir() if file != path} == before
    with pytest.raises(sw.errors.DiskFull):
        bench.write_report(path, tmp_path / "new.html")
    assert list(tmp_path.glob("*new*")) == []


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("sklearn")
    path = written(tmp_path / "r.jsonl", made())
    assert main(["leaderboard", str(path)]) == 0
    said = capsys.readouterr().out
    assert "1 STEMAgent" in said and "ceiling" in said and "defect-census, 5000 e/A2" in said
    assert main(["leaderboard", str(path), "--json"]) == 0 and len(json.loads(capsys.readouterr().out)) == 4
    assert main(["report", str(path), "-o", str(tmp_path / "p.html"), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["written"]) == 4
    assert main(["experiments"]) == 0 and "main " in capsys.readouterr().out
    assert main(["run", "main", "--out", str(tmp_path / "o"), "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 7200
    assert main([]) == 0 and "examples:" in capsys.readouterr().out
    for words, said in (
        (["leaderboard", str(tmp_path / "none.jsonl")], "no such file of results"),
        (["report", str(path), "-o", str(tmp_path / "no/p.html")], "cannot be written"),
        (["run", "nothing", "--out", str(tmp_path / "o")], "no experiment of the package: ablations"),
        (["run", "quick", "--out", str(tmp_path / "o"), "--processes", "0"], "processes = 0"),
    ):
        assert main(words) == 1
        error = capsys.readouterr().err
        assert error.startswith("error: ") and said in error and error.count("\n") == 1
    for word in ("run", "report", "leaderboard"):
        with pytest.raises(SystemExit) as ended:
            main([word, "--help"])
        assert ended.value.code == 0 and "examples:" in capsys.readouterr().out


def test_the_program_knows_its_commands(tmp_path: Path) -> None:
    assert "leaderboard" in command("bench", "--help", cwd=tmp_path).stdout
    failed = command("bench", "leaderboard", "none.jsonl", cwd=tmp_path, check=False)
    assert failed.returncode == 1 and failed.stderr.startswith("error: none.jsonl: ") and failed.stdout == ""
    assert command("bench", "fly", cwd=tmp_path, check=False).returncode == 2
