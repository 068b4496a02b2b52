"""Navigators, analysts, planners and agents, on a lattice of NumPy and in worlds."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from bench_world import PAPER_TASKS, PIXEL_NM, Lattice, acquired, facts, few_tiles
from conftest import RECIPE

import stemworlds as sw
from stemworlds import bench
from stemworlds.errors import FileMissing, FormatError

pytest.importorskip("sklearn")
pytest.importorskip("skimage")

__all__ = ["few_tiles"]


def seen_of(tiles: list[bench.Acquired], grid: tuple[int, int] = (5, 6), **more: Any) -> bench.Seen:
    return bench.Seen(facts(grid), tiles, **more)


def visits(navigator: bench.Navigator, grid: tuple[int, int], seed: int = 0) -> list[tuple[int, int]]:
    """All tiles that a navigator wants to see."""
    field = facts(grid)
    navigator.start(field, np.random.default_rng(seed))
    seen, out = bench.Seen(field), []
    while (look := navigator.choose(seen)) is not None:
        out.append((look.row, look.column))
        seen.tiles.append(acquired(np.ones((128, 128)), look.row, look.column))
    return out


def told(record: dict[str, Any]) -> str:
    return json.dumps({key: value for key, value in record.items() if key != "wall"}, sort_keys=True)


@pytest.mark.parametrize("name", bench.agent_names())
def test_all_agents_play_worlds_and_repeat_themselves(field_path: Path, name: str) -> None:
    env = gym.make("stemworlds/DefectCensus-v0", world=field_path, budget=500.0)
    agent = bench.make_agent(name)
    record = bench.play(env, agent, 3)
    assert record["ended"] == "done" and record["spent"] <= 500 and record["unreadable"] == 0
    assert 1 <= len(record["acquisitions"]) <= 5 and record["declared"] >= 1
    assert record["agent"] == name and record["grid"] == [2, 3] and record["wall"]["seconds_per_tile"] > 0
    # The same agent again, and another that is made the same way.
    assert told(bench.play(env, agent, 3)) == told(record)
    assert told(bench.play(env, bench.make_agent(name), 3)) == told(record)


def test_agents_play_recipes_and_all_tasks() -> None:
    for task in PAPER_TASKS:
        env = gym.make(f"stemworlds/{task}-v0", split="test", overview=False, **RECIPE)
        records = {name: bench.play(env, bench.make_agent(name), 1) for name in ("Nothing", "STEMAgent", "Raster+Oracle")}
        scores = {name: record["metrics"]["final_score"] for name, record in records.items()}
        assert scores["Nothing"] <= scores["Raster+Oracle"] == 1.0 and scores["STEMAgent"] <= 1.0
        assert records["STEMAgent"]["modes"][0] == "SURVEY"
        assert len({record["world"] for record in records.values()}) == 1


def test_floor_and_ceiling(field_path: Path) -> None:
    env = gym.make("stemworlds/DefectCensus-v0", world=field_path, budget=600.0)
    names = ("Nothing", "Raster", "Raster+Oracle")
    scores = {name: bench.play(env, bench.make_agent(name), 0)["metrics"]["dec_auc"] for name in names}
    assert scores["Nothing"] == 0.0 < scores["Raster"] < scores["Raster+Oracle"]


def test_raster_goes_row_by_row_and_random_everywhere() -> None:
    assert visits(bench.Raster(), (2, 3)) == [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]
    first, again, other = (visits(bench.RandomTiles(), (4, 5), seed) for seed in (1, 1, 2))
    assert first == again != other and sorted(first) == visits(bench.Raster(), (4, 5)) == sorted(other)


@pytest.mark.parametrize("share", [0.1, 0.2, 0.3])
def test_masks_hold_their_share_of_the_tiles(share: float) -> None:
    chosen = visits(bench.RandomMask(share), (20, 20))
    assert len(chosen) == len(set(chosen)) == 400 * share
    assert np.ptp([row for row, _ in chosen]) > 15


def gp_tiles() -> list[bench.Acquired]:
    """Tiles with more variance to the right."""
    random = np.random.default_rng(5)
    places = [(0, 0), (4, 1), (2, 2), (1, 4), (3, 5), (0, 3)]
    return [acquired(1 + (0.1 + 0.1 * column) * random.random((128, 128)), row, column) for row, column in places]


def reference(tiles: list[bench.Acquired]) -> tuple[Any, Any, Any, Any]:
    """Free places, mean, deviation and best target of scikit-learn's process, written down once more."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import Matern, WhiteKernel

    every = np.array([(row, column) for row in range(5) for column in range(6)])
    there = np.array([(tile.row, tile.column) for tile in tiles])
    target = np.array([(tile.image.astype(float) * tile.scale).var() for tile in tiles])
    target = (target - target.mean()) / target.std()
    model = GaussianProcessRegressor(Matern(0.2, (0.02, 2.0), nu=2.5) + WhiteKernel(0.1, (1e-4, 2.0)), alpha=1e-8)
    free = every[[not (place == there).all(axis=1).any() for place in every]]
    model.fit((there + 0.5) / 6, target)
    mean, deviation = model.predict((free + 0.5) / 6, return_std=True)
    return free, mean, deviation, target.max()


@pytest.mark.filterwarnings("ignore")
def test_the_gaussian_process_chooses_as_scikit_learn_does() -> None:
    from scipy.stats import norm

    tiles = gp_tiles()
    free, mean, deviation, best = reference(tiles)

    def choice(navigator: bench.GaussianProcess, plan: bench.Plan | None = None) -> tuple[int, int]:
        navigator.start(facts(), np.random.default_rng(0))
        look = navigator.choose(seen_of(tiles, plan=plan))
        assert look is not None
        return look.row, look.column

    for beta in (0.0, 2.0, 50.0):
        assert choice(bench.GaussianProcess(beta=beta)) == tuple(free[np.argmax(mean + beta * deviation)])
        # The planner's comes first.
        assert choice(bench.GaussianProcess(), bench.Plan("X", beta)) == tuple(free[np.argmax(mean + beta * deviation)])
    assert len({choice(bench.GaussianProcess(beta=beta)) for beta in (0.0, 50.0)}) == 2
    z = (mean - best) / deviation
    expected = (mean - best) * norm.cdf(z) + deviation * norm.pdf(z)
    assert choice(bench.GaussianProcess("ei")) == tuple(free[np.argmax(expected)])
    navigator = bench.GaussianProcess("thompson")
    drawn = []
    for seed in range(40):
        navigator.start(facts(), np.random.default_rng(seed))
        look = navigator.choose(seen_of(tiles))
        assert look is not None
        drawn.append(look.column)
    assert np.mean(drawn) > free[:, 1].mean() + 0.5


def test_the_process_starts_at_random_and_covers_the_field() -> None:
    navigator = bench.GaussianProcess()
    assert visits(navigator, (3, 3), 1)[:4] == visits(navigator, (3, 3), 1)[:4] != visits(navigator, (3, 3), 2)[:4]
    assert sorted(visits(navigator, (3, 3))) == visits(bench.Raster(), (3, 3))


def test_a_navigator_goes_where_the_analyst_is_uncertain() -> None:
    tiles = gp_tiles()
    doubts = np.array([5.0 if tile.row >= 3 else 0.0 for tile in tiles])
    navigator = bench.GaussianProcess(beta=0.0, interest="uncertainty")
    navigator.start(facts(), np.random.default_rng(0))
    look = navigator.choose(seen_of(tiles, uncertainty_of=lambda _: doubts))
    assert look is not None and look.row >= 3
    with pytest.raises(sw.InvalidValue, match="does not say how uncertain"):
        navigator.choose(seen_of(tiles))


def test_features_of_a_tile() -> None:
    from stemworlds.bench.navigators import tile_features

    env = Lattice()
    env.reset(seed=0)
    for row, column in ((0, 0), (1, 1)):
        env.acquire(row, column)
        tile = env.acquired[-1]
        variance, density, dispersion = tile_features(tile)
        assert variance == pytest.approx((tile.image.astype(float) * tile.scale).var())
        assert density == pytest.approx(64 / tile.size_nm**2, rel=0.2) and 0.02 < dispersion < 0.5


def test_the_heuristic_finds_the_defects_of_a_lattice() -> None:
    env = Lattice()
    env.reset(seed=1)
    analyst = bench.Heuristic()
    analyst.start(env.field, np.random.default_rng(0))
    for tile in range(10):
        env.acquire(tile // 6, tile % 6)
    found, truth = analyst.findings(env.acquired), env.truth_seen()
    assert found.defects is not None and truth.defects is not None
    for kind in ("vacancy", "substitution"):
        places, true = np.asarray(found.defects[kind]), np.asarray(truth.defects[kind])
        apart = np.hypot(*(true[:, None] - places[None]).transpose(2, 0, 1)).min(axis=1)
        assert (apart < 0.05).mean() > 0.8, kind
    assert found.phases is None and len(found.particles) == 0
    # Vacancies of the lattice are dark, so a stricter threshold finds fewer.
    strict = bench.Heuristic(3.0)
    strict.start(env.field, np.random.default_rng(0))
    fewer = strict.findings(env.acquired).defects
    assert fewer is not None
    assert sum(map(len, fewer.values())) < sum(map(len, found.defects.values()))
    assert len(analyst.uncertainty(env.acquired)) == len(env.acquired)
    # Another history: from the start.
    again = analyst.findings(env.acquired[:2])
    fresh = bench.Heuristic()
    fresh.start(env.field, np.random.default_rng(0))
    assert again.report() == fresh.findings(env.acquired[:2]).report()


def test_running_scores_are_those_of_all_peaks_so_far() -> None:
    from stemworlds.bench.peaks import find_peaks

    env = Lattice()
    env.reset(seed=1)
    analyst = bench.Heuristic()
    analyst.start(env.field, np.random.default_rng(0))
    env.acquire(0, 0)
    env.acquire(3, 3)
    columns = analyst.findings(env.acquired).columns
    peaks = [find_peaks(tile.image.astype(float) * tile.scale, tile.pixel_nm).intensity for tile in env.acquired]
    last = (peaks[1] - np.concatenate(peaks).mean()) / np.concatenate(peaks).std()
    assert columns[len(peaks[0]) :, 2] == pytest.approx(np.abs(last))
    first = (peaks[0] - peaks[0].mean()) / peaks[0].std()
    assert columns[: len(peaks[0]), 2] == pytest.approx(np.abs(first))


def test_phases_are_split_where_there_are_two() -> None:
    for bright_from, expected in ((None, None), (3, {0, 1})):
        env = Lattice(bright_from=bright_from)
        env.reset(seed=1)
        for row in range(2):
            for column in (0, 1, 4, 5):
                env.acquire(row, column)
        analyst = bench.Heuristic()
        analyst.start(env.field, np.random.default_rng(0))
        phases = analyst.findings(env.acquired).phases
        if expected is None:
            assert phases is None
        else:
            assert phases is not None and set(phases[phases >= 0].tolist()) == expected
            assert (phases[:2, 4] == 1).all() and (phases[:2, 0] == 0).all() and (phases[2:] == bench.NO_PHASE).all()


def test_particles_are_found_where_they_are_asked_for() -> None:
    y, x = np.mgrid[:128, :128]
    image = 0.02 + 0.2 * (np.hypot(x - 40, y - 70) < 25) + 0.01 * np.random.default_rng(0).random((128, 128))
    tile = acquired(image, 1, 2)
    analyst = bench.Heuristic(particles=True)
    analyst.start(facts(), np.random.default_rng(0))
    found = analyst.findings([tile])
    assert found.particles.shape == (1, 3) and list(found.morphologies) == ["unknown"]
    x_nm, y_nm, diameter_nm = found.particles[0]
    assert x_nm == pytest.approx((2 * 124 + 40) * PIXEL_NM, abs=0.05) and y_nm == pytest.approx((124 + 70) * PIXEL_NM, abs=0.05)
    assert diameter_nm == pytest.approx(50 * PIXEL_NM, rel=0.08)


def test_defects_in_overlapping_tiles_are_one() -> None:
    from stemworlds.bench.analysts import PlacedDefects

    places = PlacedDefects()
    places.add("vacancy", np.array([[1.0, 1.0], [2.0, 2.0]]))
    places.add("vacancy", np.array([[1.05, 1.05], [2.0, 2.09], [-1.0, 0.0]]))
    places.add("substitution", np.array([[1.0, 1.0]]))
    found = places.arrays()
    assert found["vacancy"].tolist() == [[1, 1], [2, 2], [2, 2.09], [-1, 0]] and len(found["substitution"]) == 1


def test_modes_follow_coverage_defects_and_dose() -> None:
    planner = bench.ModePlanner()
    planner.start(facts(), np.random.default_rng(0))
    tiles = [acquired(np.ones((128, 128)), n // 6, n % 6) for n in range(5)]
    two = bench.Findings(counts={"vacancy": 1, "substitution": 1})

    def plan(count: int, dose_left: float, findings: bench.Findings | None = None) -> bench.Plan:
        return planner.plan(seen_of(tiles[:count], findings=findings, dose_left=dose_left))

    assert plan(0, 1.0) == bench.Plan("SURVEY", 3.0)
    assert plan(4, 0.9).mode == "SURVEY"
    # 15 % of 30 tiles.
    assert plan(5, 0.8) == bench.Plan("INVESTIGATE", 2.0)
    assert plan(5, 0.7, two) == bench.Plan("CHARACTERIZE", 0.5)
    assert plan(5, 0.19, two) == bench.Plan("CENSUS", 1.0)
    assert plan(5, 0.04, two).end
    planner.start(facts(), np.random.default_rng(0))
    assert plan(0, 1.0).mode == "SURVEY"


def test_agents_stop_before_they_are_refused() -> None:
    env = Lattice(budget=1050.0)
    record = bench.play(env, bench.make_agent("Raster"), 0)
    assert not env.refused and env.ended == "done" and len(record["acquisitions"]) == 10
    assert env.declarations == [5, 10]
    # The horizon leaves room for a last declaration.
    short = Lattice(horizon=14)
    bench.play(short, bench.make_agent("Raster"), 0)
    assert short.declarations[-1] == len(short.acquired) >= 4


def test_missing_tiles_are_filled_in_for_a_second_analyst() -> None:
    from stemworlds.bench.reconstruction import inpaint, reconstructed

    y, x = np.mgrid[:64, :64]
    smooth = np.sin(x / 20) + y / 40
    known = np.random.default_rng(0).random((64, 64)) < 0.3
    filled = inpaint(np.where(known, smooth, 0.0), known)
    assert np.array_equal(filled[known], smooth[known])
    assert np.abs(filled - smooth)[~known].mean() < 0.15 * smooth.std()
    env = Lattice()
    env.reset(seed=0)
    for row, column in ((0, 0), (2, 2), (4, 5)):
        env.acquire(row, column)
    tiles = reconstructed(env.field, env.acquired)
    assert len(tiles) == 27 and (0, 0) not in {(tile.row, tile.column) for tile in tiles}
    assert tiles[0].image.shape == (128, 128) and tiles[0].centre_nm[0] == pytest.approx((124 + 63.5) * PIXEL_NM)
    with pytest.raises(sw.InvalidValue, match="another one"):
        one = bench.Heuristic()
        bench.CompressedSensing("CS", bench.RandomMask(), one, one)


def test_an_agent_of_a_few_lines() -> None:
    class Diagonal:
        def start(self, field: bench.FieldFacts, random: np.random.Generator) -> None:
            self.next = iter(range(min(field.grid)))

        def choose(self, seen: bench.Seen) -> bench.Look | None:
            at = next(self.next, None)
            return None if at is None else bench.Look(at, at, dose=0.5)

    env = Lattice()
    record = bench.play(env, bench.Agent("diagonal", Diagonal(), bench.Nothing(), declare_every=2), 0)
    assert [place["tile"] for place in record["acquisitions"]] == [[n, n] for n in range(5)]
    assert record["acquisitions"][0]["cost"] == 50 and env.declarations == [2, 4, 5]
    with pytest.raises(sw.InvalidValue, match="has not the methods of Analyst"):
        bench.Agent("wrong", Diagonal(), Diagonal())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("Rastr", "did you mean 'Raster'"),
        ({"name": "x", "navigator": "gp"}, "analyst is missing"),
        ({"name": "x", "navigator": "gpp", "analyst": "nothing"}, "did you mean 'gp'"),
        ({"name": "x", "navigator": {"kind": "gp", "bta": 1}, "analyst": "nothing"}, "did you mean 'beta'"),
        ({"name": "x", "navigator": {"kind": "mask", "share": 2.0}, "analyst": "nothing"}, "share = 2.0"),
        ({"name": "x", "navigator": "gp", "analyst": "nothing", "planner": {"kind": "modes", "survey_coverage": 7}}, "survey_coverage = 7"),
        ({"name": "x", "navigator": "gp", "analyst": "vlm"}, "url"),
        ({"navigator": "gp"}, "no name"),
    ],
)
def test_wrong_agents_are_told(given: Any, words: str) -> None:
    with pytest.raises(sw.StemworldsError, match=words):
        bench.make_agent(given)


def network(path: Path, classes: int = 4, bias: Sequence[float] = (10, 0, -5, -32)) -> Path:
    """A network of one layer: pixels above 0.25 are atoms, above 0.8 substitutions."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    helper = onnx.helper
    weights = np.array([-40, 0, 0, 40], dtype=np.float32)[:classes].reshape(classes, 1, 1, 1)
    made = [onnx.numpy_helper.from_array(array, name) for array, name in ((weights, "w"), (np.array(bias, dtype=np.float32)[:classes], "b"))]
    shape = [1, 1, 128, 128]
    graph = helper.make_graph(
        [helper.make_node("Conv", ["tile", "w", "b"], ["scores"])],
        "threshold",
        [helper.make_tensor_value_info("tile", onnx.TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("scores", onnx.TensorProto.FLOAT, [1, classes, 128, 128])],
        made,
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def test_networks_are_run(tmp_path: Path) -> None:
    path = network(tmp_path / "n.onnx")
    y, x = np.mgrid[:128, :128]
    image = sum(height * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 18) for cx, cy, height in ((30, 40, 1.0), (90, 40, 0.6), (60, 100, 0.6)))
    tile = acquired(np.asarray(image), 1, 0)
    analyst = bench.OnnxAnalyst([path, path])
    analyst.start(facts(), np.random.default_rng(0))
    found = analyst.findings([tile])
    assert found.defects is not None
    assert np.asarray(found.defects["substitution"]) == pytest.approx(np.array([[30, 124 + 40]]) * PIXEL_NM, abs=0.02)
    assert len(np.asarray(found.defects["vacancy"])) == 0 and len(found.columns) == 3
    assert found.columns[found.columns[:, 2].argmax(), :2] == pytest.approx(np.array([30, 164]) * PIXEL_NM, abs=0.02)
    assert analyst.uncertainty([tile])[0] > 0
    agent = bench.make_agent({"name": "net", "navigator": {"kind": "gp", "interest": "uncertainty"}, "analyst": {"kind": "onnx", "models": str(path)}})
    assert bench.play(Lattice(), agent, 0)["metrics"]["final_score"] > 0
    wrong = bench.OnnxAnalyst(network(tmp_path / "three.onnx", classes=3))
    wrong.start(facts(), np.random.default_rng(0))
    with pytest.raises(sw.InvalidValue, match="expected 4 classes"):
        wrong.findings([tile])
    for number in (float("nan"), float("inf")):
        unsound = bench.OnnxAnalyst(network(tmp_path / "unsound.onnx", bias=(number, 0, 0, 0)))
        unsound.start(facts(), np.random.default_rng(0))
        with pytest.raises(sw.InvalidValue, match="a score that is no number"):
            unsound.findings([tile])
    # A class that is never there is a number all the same.
    never = bench.OnnxAnalyst(network(tmp_path / "never.onnx", bias=(10, 0, -np.inf, -32)))
    never.start(facts(), np.random.default_rng(0))
    assert len(never.findings([tile]).columns) == 3
    with pytest.raises(sw.InvalidValue, match="it has scores"):
        bench.OnnxAnalyst(path, output="mask")
    with pytest.raises(FileMissing):
        bench.OnnxAnalyst(tmp_path / "none.onnx")
    (tmp_path / "bad.onnx").write_bytes(b"no network")
    with pytest.raises(FormatError, match="cannot read this network"):
        bench.OnnxAnalyst(tmp_path / "bad.onnx")


SMALL: dict[str, dict[str, Any]] = {
    "DQN": {"buffer_size": 40, "learning_starts": 4, "batch_size": 4},
    "PPO": {"n_steps": 4, "batch_size": 8, "n_epochs": 1},
    "SAC": {"buffer_size": 40, "learning_starts": 4, "batch_size": 4},
}


@pytest.mark.parametrize("algorithm", ["DQN", "PPO", "SAC"])
def test_policies_are_trained_and_play(algorithm: Any, tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")

    def make() -> gym.Env[Any, Any]:
        return gym.make("stemworlds/DefectCensus-v0", reward="score_gain", horizon=8, overview=False, **RECIPE)

    model = bench.train_policy(algorithm, [make, make], analyst=bench.Oracle, steps=12, settings=SMALL[algorithm])
    model.save(tmp_path / "policy.zip")
    agent = bench.make_agent(
        {"name": algorithm, "policy": {"algorithm": algorithm, "model": str(tmp_path / "policy.zip")}, "analyst": "oracle"}
    )
    record = bench.play(make(), agent, 0)
    assert record["steps"] > 0 and record["agent"] == algorithm
    assert told(bench.play(make(), agent, 0)) == told(record)
    with pytest.raises(FileMissing, match="train_policy"):
        bench.PolicyAgent("x", algorithm=algorithm, model=tmp_path / "none.zip", analyst=bench.Nothing())
