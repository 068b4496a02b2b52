"""What can be known of a specimen: priors, ideal observer, scores of forecasts, and the scale between them."""

from __future__ import annotations

import json
import math
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from bench_world import acquired, few_tiles
from conftest import RECIPE

import stemworlds as sw
from stemworlds import bench
from stemworlds.bench.blind import fresh_areas_nm2
from stemworlds.bench.columns import Columns, columns_of
from stemworlds.bench.command import main
from stemworlds.bench.forecasts import average_precision, nearest_columns
from stemworlds.bench.ideal import evidence, log_likelihood
from stemworlds.bench.prior import _best_axis, _counted, prior_of
from stemworlds.bench.templates import _template
from stemworlds.errors import InvalidValue

__all__ = ["few_tiles"]
metrics = pytest.importorskip("sklearn.metrics")
stats = pytest.importorskip("scipy.stats")


def test_average_precision_is_that_of_scikit_learn() -> None:
    for seed in range(20):
        random = np.random.default_rng(seed)
        there = random.random(60) < 0.3
        sure = random.integers(0, 12, 60) / 12
        if there.any():
            assert average_precision(there, sure) == pytest.approx(metrics.average_precision_score(there, sure))


def test_places_belong_to_the_nearest_column_once() -> None:
    columns = np.array([[0.0, 0.0], [0.15, 0.0], [5.0, 5.0]])
    said = np.array([[0.06, 0.0], [0.02, 0.0], [5.0, 5.099], [5.2, 5.0], [-0.05, 0.0]])
    assert nearest_columns(said, columns).tolist() == [1, 0, 2, -1, -1]
    # By all pairs: each is nearer than any that is free.
    random = np.random.default_rng(1)
    columns, said = random.random((80, 2)), random.random((90, 2))
    owner = nearest_columns(said, columns)
    apart = np.hypot(*(said[:, None] - columns[None]).transpose(2, 0, 1))
    own = apart[np.arange(90), owner]
    for n, m in zip(*np.nonzero(apart <= 0.1), strict=True):
        holder = np.flatnonzero(owner == m)
        assert (owner[n] >= 0 and own[n] <= apart[n, m]) or (len(holder) == 1 and own[holder[0]] <= apart[n, m])


def forecasts(rows: list[list[float]]) -> bench.Findings:
    return bench.Findings(forecasts=np.array(rows))


def test_bits_are_gained_over_the_prior() -> None:
    places, counts = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([2, 0])
    prior = np.array([[0.5, 0.25, 0.25], [0.8, 0.1, 0.1]])
    whole = bench.score_forecasts(forecasts([[0, 0, 0, 0, 1], [1, 0, 1, 0, 0]]), places, counts, prior)
    assert whole.share == 1.0 and whole.bits == whole.prior_bits == pytest.approx(2 - math.log2(0.8))
    assert whole.average_precision == 1.0 and whole.count_error == pytest.approx(0) and whole.count_sigma == 0.0
    # Who says nothing of columns, says the prior, or speaks of other places gains nothing.
    for said in (None, bench.Findings(), forecasts([[0, 0, 0.5, 0.25, 0.25]]), forecasts([[3, 3, 0, 1]])):
        score = bench.score_forecasts(said, places, counts, prior)
        assert score.bits == pytest.approx(0) and score.share == pytest.approx(0)
    # "None, or some": within "some" the prior stands, so one of two bits is gained.
    some = bench.score_forecasts(forecasts([[0, 0, 0, 1]]), places, counts, prior)
    assert some.bits == pytest.approx(1)
    # Being wrong and sure costs, but not infinitely.
    wrong = bench.score_forecasts(forecasts([[0, 0, 1, 0, 0]]), places, counts, prior)
    assert wrong.bits == pytest.approx(2 - 20) and wrong.share == 0.0
    # Chances need not sum to 1, and claims where no column is spoil the precision.
    same = bench.score_forecasts(forecasts([[0, 0, 0, 0, 7], [1, 0, 3, 0, 0], [3, 3, 0, 1, 0]]), places, counts, prior)
    assert same.bits == pytest.approx(whole.bits) and same.average_precision == pytest.approx(0.5)


def test_no_blind_forecast_gains_on_average() -> None:
    """The log score is proper: whatever is said without looking, the prior is better by the divergence of the two."""
    random = np.random.default_rng(3)
    prior = np.tile([0.6, 0.3, 0.1], (4_000, 1))
    counts = random.choice(3, 4_000, p=prior[0])
    places = np.column_stack([np.arange(4_000.0), np.zeros(4_000)])
    for said in ([0.8, 0.1, 0.1], [0.3, 0.6, 0.1], [0.98, 0.01, 0.01]):
        bits = bench.score_forecasts(bench.Findings(forecasts=np.column_stack([places, np.tile(said, (4_000, 1))])), places, counts, prior).bits
        assert bits / 4_000 == pytest.approx(-stats.entropy(prior[0], said, base=2), abs=0.15) and bits < 0


@pytest.mark.parametrize(
    ("wrong", "words"),
    [([[0, 0, 1]], "shape"), ([[0, 0, -1, 2]], "not negative"), ([[0, 0, 0, 0]], "not all 0"), ([[math.nan, 0, 1, 0]], "finite")],
)
def test_odd_forecasts_are_refused(wrong: list[list[float]], words: str) -> None:
    with pytest.raises(InvalidValue, match=words):
        bench.Findings(forecasts=np.array(wrong, dtype=float)).report()


def test_columns_are_those_of_the_file(field_path: Path) -> None:
    with sw.World(field_path) as world:
        own, there = columns_of(world.recipe.toml), world.columns
        assert len(own.kinds) == len(there) and set(own.names) == {"O", "O Ti", "Sr"}
        order, other = (np.lexsort(np.round(table, 3).T) for table in (own.places_nm, np.column_stack([there["x_nm"], there["y_nm"]])))
        assert np.allclose(own.places_nm[order, 0], there["x_nm"][other], atol=1e-4)
        assert np.array_equal(own.defects[order, 0], there["vacancies"][other]) and own.defects.sum() > 0
        part = columns_of(world.recipe.toml, (1.0, 2.0, 3.0, 4.0))
        inside = own.within(1.0, 2.0, 3.0, 4.0)
        assert 0 < len(part.kinds) == len(inside.kinds) and part.counts("vacancy").sum() == inside.counts(None).sum()


def test_priors_are_counted_on_specimens_for_training() -> None:
    recipe = sw.Recipe("test", set=RECIPE["set"], seed=7)
    prior = prior_of(recipe)
    assert all(np.allclose(table.sum(axis=-1), 1) and (table > 0).all() for table in prior.chances.values())
    held = sum(int(columns_of(recipe.with_seed(seed).toml).defects.sum()) for seed in (2, 4, 6, 8))
    everywhere = prior.expected([[x, 3.0] for x in (np.arange(64) + 0.5) / 64 * prior.size_nm[0]], np.full(64, prior.size_nm[0] * prior.size_nm[1] / 64))
    assert everywhere["vacancy"] == pytest.approx(held / 4, rel=0.15 if prior.axis == 1 else 1e-9)
    # Splits keep to even seeds for training and odd ones for tests.
    for split, odd in (("train", 0), ("test", 1)):
        env = gym.make("stemworlds/DefectCensus-v0", split=split, overview=False, **RECIPE)
        env.reset(seed=1)
        world: Any = env.unwrapped
        specimen = world.specimen()
        assert specimen["seed"] % 2 == odd


def test_priors_depend_on_place_where_specimens_do() -> None:
    random = np.random.default_rng(0)

    def field(slope: float) -> Columns:
        places = random.random((3000, 2)) * 10
        counts = (random.random(3000) < 0.3 + slope * (places[:, 0] - 5)).astype(np.int64)
        return Columns(places, np.zeros(3000, dtype=np.int64), ("A",), np.column_stack([counts, 0 * counts]))

    for slope, axis in ((0.0, None), (0.04, 0)):
        assert _best_axis(_counted([field(slope) for _ in range(4)], ("A",), (10.0, 10.0), None)) == axis


def test_area_is_counted_once() -> None:
    one, beside, again = (acquired(np.ones((128, 128)), 0, column) for column in (0, 1, 0))
    areas = np.array(fresh_areas_nm2([one, beside, again])) / one.size_nm**2
    assert areas == pytest.approx([1, 124 / 128, 0], abs=1e-9)


def spots(counts: np.ndarray, pattern: np.ndarray, half: int = 9) -> np.ndarray:
    """Images about columns: a Gaussian, dimmer by a tenth for each defect, wider or narrower by a pattern of its own."""
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    radius = np.hypot(x, y)[None]
    width = 3.0 * (1 + 0.03 * pattern[:, None, None])
    return 0.02 + 0.1 * (1 - 0.1 * counts[:, None, None]) * np.exp(-(radius**2) / (2 * width**2))


def observed(template: Any, images: np.ndarray, electrons: float, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Evidence of recordings of columns in the middle of their images."""
    random = np.random.default_rng(seed)
    found = []
    for image in images:
        seen = random.poisson(image * electrons) / electrons
        tile = acquired(seen)
        tile = bench.Acquired(**{**vars(tile), "electrons_per_pixel": electrons, "pixel_nm": 0.02, "size_nm": 0.02 * len(image)})
        toward, sharpness = evidence(tile, np.array([tile.centre_nm]), template)
        found.append((toward[0], sharpness[0]))
    return found


def test_posteriors_are_those_of_counted_electrons() -> None:
    random = np.random.default_rng(5)
    learned = random.choice(3, 600, p=[0.6, 0.3, 0.1])
    template = _template(spots(learned, random.standard_normal(600)), learned, 0.02, 0.14)
    counts, electrons = random.choice(3, 800, p=[0.6, 0.3, 0.1]), 300.0
    images = spots(counts, random.standard_normal(800))
    seen = observed(template, images, electrons, 1)
    prior, number = np.array([0.6, 0.3, 0.1]), np.arange(3.0)
    said = {}
    for grade in ("linear", "mixture"):
        logs = np.array([log_likelihood(t, s, template, number, grade) for t, s in seen])  # type: ignore[arg-type]
        chances = prior * np.exp(logs - logs.max(axis=1, keepdims=True))
        said[grade] = chances / chances.sum(axis=1, keepdims=True)
        # Calibrated: as many defects as are said, to four standard deviations.
        for k in range(3):
            spread = math.sqrt(float((said[grade][:, k] * (1 - said[grade][:, k])).sum()))
            assert abs(float(said[grade][:, k].sum()) - float((counts == k).sum())) < 4 * spread
    # The Hotelling observer of others, trained on the same kind of recordings, orders columns no better.
    analysis = pytest.importorskip("sklearn.discriminant_analysis")
    noisy = np.random.default_rng(2).poisson(images * electrons).reshape(len(images), -1)
    other = analysis.LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto").fit(noisy[:400], counts[:400] > 0).decision_function(noisy[400:])
    theirs = metrics.roc_auc_score(counts[400:] > 0, other)
    ours = {grade: metrics.roc_auc_score(counts[400:] > 0, 1 - chances[400:, 0]) for grade, chances in said.items()}
    assert 0.75 < theirs - 0.03 < ours["linear"] and theirs - 0.03 < ours["mixture"], (theirs, ours)
    # More electrons tell more.
    more = np.array([log_likelihood(t, s, template, number, "linear")[1] for t, s in observed(template, images[:150], 10 * electrons, 3)])
    few = np.array([log_likelihood(t, s, template, number, "linear")[1] for t, s in seen[:150]])
    assert metrics.roc_auc_score(counts[:150] > 0, more) > metrics.roc_auc_score(counts[:150] > 0, few)


def test_known_images_are_judged_by_poissons_law() -> None:
    """Without modes the likelihood ratio is Poisson's, whose logarithm is exact; that of the line in the number of defects is within 5 %."""
    random = np.random.default_rng(6)
    learned = random.choice(3, 400)
    template = _template(spots(learned, np.zeros(400)), learned, 0.02, 0.14)
    counts = random.choice(2, 200)
    electrons, images, (clean, less) = 200.0, spots(counts, np.zeros(200)), spots(np.array([0, 1]), np.zeros(2))
    found = observed(template, images, electrons, 4)
    y, x = np.mgrid[-9:10, -9:10] * 0.02
    disc = np.hypot(x, y) <= 0.14
    exact, ours = [], []
    draw = np.random.default_rng(4)
    for image, (toward, sharpness) in zip(images, found, strict=True):
        seen = draw.poisson(image * electrons)[disc]
        exact.append(float((stats.poisson.logpmf(seen, less[disc] * electrons) - stats.poisson.logpmf(seen, clean[disc] * electrons)).sum()))
        ours.append(float(log_likelihood(toward, sharpness, template, np.array([0.0, 1.0]), "known")[1]))
    assert np.corrcoef(exact, ours)[0, 1] > 0.99 and np.std(np.subtract(exact, ours)) < 0.15 * np.std(exact)


def test_guessing_gains_nothing_and_seeing_does() -> None:
    env = gym.make("stemworlds/DefectCensusStrict-v0", split="test", overview=False, budget=600.0, **RECIPE)
    records = {name: bench.play(env, bench.make_agent(name), 1) for name in ("Nothing", "Prior", "Prior places", "Raster", "Ideal", "Ideal mixture", "Raster+Oracle")}
    scores = {name: record["metrics"]["dec_auc"] for name, record in records.items()}
    assert scores["Nothing"] == scores["Prior"] == scores["Prior places"] == scores["Raster"] == 0.0
    # Columns of an atom or two at 1e5 electrons: nearly all is seen, and what is said is right.
    final = {name: record["scores"]["strict"] for name, record in records.items()}
    assert 0.5 < final["Ideal"] < final["Raster+Oracle"] == 1.0 and abs(final["Ideal"] - final["Ideal mixture"]) < 0.15
    said = records["Ideal"]["scores"]["forecasts"]
    assert abs(said["count_error"]) < 5 * said["count_sigma"] + 3 and said["average_precision_gain"] > 0.3
    assert records["Prior"]["scores"]["paper"] > 0.8


def test_blind_agents_play_all_tasks_without_a_pixel() -> None:
    for task in bench.TASKS:
        env = gym.make(f"stemworlds/{task}-v0", split="test", overview=False, budget=300.0, **RECIPE)
        world: Any = env.unwrapped
        analyst = bench.Usual()
        analyst.attach(world)
        env.reset(seed=1)
        tiles = [world.acquire(0, n)[-1]["acquired"] for n in range(2)]
        said = []
        for images in (tiles, [bench.Acquired(**{**vars(tile), "image": 0 * tile.image}) for tile in tiles]):
            analyst.start(world.field, np.random.default_rng(0))
            said.append(analyst.findings(images).report())
        assert said[0] == said[1]
        assert bench.play(env, bench.make_agent("Ideal"), 1)["unreadable"] == 0


def test_worlds_without_a_recipe_have_no_prior() -> None:
    analyst = bench.Usual()
    analyst.attach(object())
    with pytest.raises(InvalidValue, match="no recipe"):
        analyst.start(gym.make("stemworlds/DefectCensus-v0", overview=False, **RECIPE).unwrapped.field, np.random.default_rng(0))  # type: ignore[attr-defined]


def test_strict_scores_are_paid_recorded_and_pickled() -> None:
    options: dict[str, Any] = {"split": "test", "overview": False, "budget": 600.0, "reward": "score_gain", **RECIPE}
    env = gym.make("stemworlds/TargetedStrict-v0", disable_env_checker=True, **options)
    world: Any = env.unwrapped
    env.reset(seed=2)
    paid = 0.0
    for n in range(5):
        paid += world.acquire(0, n % 3)[1]
        paid += world.declare(world.truth_seen())[1] if n > 1 else world.step({"type": 2, "report": '{"counts": {"vacancy": 3}}'})[1]
    copy = pickle.loads(pickle.dumps(world))
    for one in (world, copy):
        _, reward, *_, info = one.step({"type": bench.DONE})
        record = info["record"]
        assert paid + reward == pytest.approx(record["metrics"]["final_score"]) == 1.0
        assert [share for share, _ in record["curve"]] == [pytest.approx(5 / 6), pytest.approx(5 / 6)][: len(record["curve"])]
    # A report is text too, and forecasts that are none are told as any other fault.
    env.reset(seed=2)
    world.acquire(0, 0)
    text = world.truth_seen().report()
    assert "forecasts" in json.loads(text)
    assert world.step({"type": bench.DECLARE, "report": text})[-1].get("fault") is None and world.score() == 1.0
    assert "forecasts" in world.step({"type": bench.DECLARE, "report": '{"forecasts": [[0, 0, -1, 2]]}'})[-1]["fault"]
    assert world.score() == 1.0 and world.record()["unreadable"] == 1
    many = bench.MicroscopeVectorEnv(2, "targeted", True, **options)
    many.reset(seed=2)
    many.step({"type": [0, 0], "position": [world.centre_of(0, 0), world.centre_of(0, 1)]})
    many.step({"type": [1, 1]})
    _, rewards, *_ = many.step({"type": [2, 2], "report": [many.truth_seen(0), "{}"]})
    assert rewards.tolist() == [1.0, 0.0]


def results_of(path: Path, levels: dict[str, tuple[str, float]], task: str = "defect-census-strict") -> Path:
    """Results of agents (kind of analyst, score), a little different in each of six cases."""
    rows = []
    for agent, (kind, level) in levels.items():
        for seed in range(6):
            score = level * (1 + 0.1 * seed)
            metrics_of = dict.fromkeys(("dec_auc", "final_score", "time_to_threshold", "early_weighted", "late_weighted", "half_budget"), score)
            row = {"key": f"{agent} {seed} {task}", "agent": agent, "task": task, "world": "w", "seed": seed, "budget": 5000.0, "metrics": metrics_of, "curve": [[1.0, score]]}
            rows.append({**row, "specification": {"name": agent, "analyst": {"kind": kind}}, "environment": {}})
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


def test_the_report_begins_with_blind_and_ideal(tmp_path: Path) -> None:
    levels = {"Prior": ("prior", 0.1), "Ideal": ("ideal", 0.3), "mine": ("heuristic", 0.15), "worse": ("heuristic", 0.05)}
    path = results_of(tmp_path / "a.jsonl", levels)
    lines = {line["agent"]: line for line in bench.leaderboard(path)[0]["agents"]}
    assert lines["mine"]["skill"] == pytest.approx(0.25) and lines["worse"]["skill"] == pytest.approx(-0.25)
    assert lines["Prior"]["skill"] == 0.0 and lines["Ideal"]["skill"] == 1.0 and lines["Ideal"]["rank"] is None
    page = bench.write_report(path, tmp_path / "a.html")[0].read_text()
    first = page[page.index("<h1>") :]
    assert "blind 0.125 (Prior), ideal 0.375 (Ideal). Of the way from blind to ideal: mine 25%, worse -25%." in first
    assert first.index("Of the way") < first.index("<section") and "Seeing and guessing" in first
    # A score that the blind agent gets as well as anybody has no room for skill.
    same = results_of(tmp_path / "b.jsonl", {**levels, "Ideal": ("ideal", 0.101)})
    assert all(line["skill"] is None for line in bench.leaderboard(same)[0]["agents"])
    assert "does not tell seeing from guessing" in bench.write_report(same, tmp_path / "b.html")[0].read_text()
    without = results_of(tmp_path / "c.jsonl", {"mine": ("heuristic", 0.15)})
    assert "Add both to the experiment" in bench.write_report(without, tmp_path / "c.html")[0].read_text()


OWN = '''
class Lazy:
    """Looks at nothing."""

    def __init__(self, word: str = "lazy") -> None:
        self.name = word

    def run(self, env, seed):
        env.reset(seed=seed)
        return {"notes": {}, "record": env.step({"type": 3})[-1].get("record")}
'''
EXPERIMENT = """
tasks = ["defect-census"]
seeds = 1
budgets = [300]
agents = ["Nothing", "mine_of_test:Lazy", {name = "second", python = "mine_of_test:Lazy", options = {word = "b"}}]
worlds = [{name = "small", recipe = "test", set = {"field.thickness_nm" = 0.4}}]
"""


def test_agents_of_other_packages_take_part(tmp_path: Path) -> None:
    (tmp_path / "mine_of_test.py").write_text(OWN)
    (tmp_path / "e.toml").write_text(EXPERIMENT)
    experiment = bench.read_experiment(tmp_path / "e.toml")
    whole = experiment.with_agents([bench.Agent("object", bench.Raster(), bench.Nothing())])
    summary = bench.run_experiment(whole, tmp_path / "e.jsonl", processes=1, progress=lambda _line: None)
    assert not summary.failed and summary.done == 4
    rows = {row["agent"]: row for row in bench.read_results(tmp_path / "e.jsonl")}
    assert rows.keys() == {"Nothing", "mine_of_test:Lazy", "second", "object"}
    assert "pickle" not in rows["object"]["specification"] and rows["object"]["specification"]["object"] == "stemworlds.bench.agents.Agent"
    assert str(tmp_path) not in json.dumps(rows["second"])
    assert {line["agent"] for line in bench.leaderboard(tmp_path / "e.jsonl")[0]["agents"]} == rows.keys()
    # Played once: the same agents are skipped, and another text of the module is another agent.
    again = bench.run_experiment(whole, tmp_path / "e.jsonl", processes=1, progress=lambda _line: None)
    assert again.skipped == 4
    (tmp_path / "mine_of_test.py").write_text(OWN + "# changed\n")
    assert len({episode.key for episode in experiment} - {row["key"] for row in rows.values()}) == 2


def test_a_dry_run_tells_the_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = 'tasks = ["defect-census"]\nseeds = 3\nbudgets = [1000]\nagents = ["Nothing", "Raster", "Prior"]\nworlds = [{recipe = "test"}]\n'
    (tmp_path / "e.toml").write_text(text)
    out, words = tmp_path / "r.jsonl", ["run", str(tmp_path / "e.toml"), "--processes", "2", "--dry-run", "--out", str(tmp_path / "r.jsonl")]
    main(words)
    assert "9 are left; how long they take is known when" in capsys.readouterr().out and not out.exists()
    rows = []
    for episode in bench.read_experiment(tmp_path / "e.toml"):
        if episode.seed < 2 and episode.agent["name"] != "Prior":
            seconds = {"Nothing": 2.0, "Raster": 10.0}[episode.agent["name"]] + episode.seed
            row = {"key": episode.key, "agent": episode.agent["name"], "task": episode.task, "world": "test", "seed": episode.seed, "budget": 1000.0}
            numbers = dict.fromkeys(("dec_auc", "final_score", "time_to_threshold", "early_weighted", "late_weighted", "half_budget"), 0.5)
            rows.append({**row, "metrics": numbers, "curve": [], "wall": {"seconds": seconds, "seconds_per_tile": 0.1}})
    out.write_text("".join(json.dumps(row) + "\n" for row in rows))
    main([*words, "--json"])
    told = json.loads(capsys.readouterr().out)
    # One of 2.5 s, one of 10.5 s, and three as slow as the two are on average, on two processes.
    assert told["left"] == 5 and told["seconds"] == pytest.approx((2.5 + 10.5 + 3 * 6.5) / 2) and told["guessed"] == ["Prior"]


@pytest.mark.parametrize(
    ("agent", "words"),
    [
        ('"no_such_module_here:A"', "cannot be imported"),
        ('"json:NoClass"', "has no 'NoClass'"),
        ('"json:__doc__"', "no class or function"),
        ('{name = "a", python = "json:JSONDecoder", options = {wrong = 1}}', "wrong"),
        ('{name = "a", python = "json"}', "package.module:Class"),
        ('{name = "a", python = "json:dumps", analyst = "nothing"}', "unknown"),
        ('{name = "a", pickle = "gASVAAAAAAAAAAA="}', "unknown"),
    ],
)
def test_odd_agents_of_others_are_told(tmp_path: Path, agent: str, words: str) -> None:
    (tmp_path / "e.toml").write_text(f'agents = [{agent}]\nworlds = [{{recipe = "test"}}]\n')
    with pytest.raises(InvalidValue, match=words):
        bench.read_experiment(tmp_path / "e.toml")


def test_gymnasium_imports_the_package_by_itself() -> None:
    # The library of this recipe is there already.
    program = "import gymnasium; print(gymnasium.make('stemworlds.bench:stemworlds/TargetedStrict-v0', recipe='test', set={'field.thickness_nm': 0.4}).unwrapped.field.strict)"
    assert subprocess.run([sys.executable, "-c", program], check=True, text=True, capture_output=True).stdout.strip() == "True"
