"""Tasks that ask for the whole field: its truth, scores, the maps that agents make, and what they find."""

from __future__ import annotations

import json
import math
import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from bench_world import Lattice, acquired, facts
from conftest import RECIPE

import stemworlds as sw
from stemworlds import bench
from stemworlds.bench.columns import Columns, columns_of
from stemworlds.bench.count_maps import CountProcess
from stemworlds.bench.field_analysis import with_map
from stemworlds.bench.field_scores import map_bits, named_columns, rare_score
from stemworlds.bench.field_truth import FieldTruth, Grid, expected_counts, grid_of, rare_from
from stemworlds.bench.ideal import _count, _pull
from stemworlds.bench.prior import TRAINING_SEEDS, prior_of
from stemworlds.errors import InvalidValue, StemworldsError

stats = pytest.importorskip("scipy.stats")
processes = pytest.importorskip("sklearn.gaussian_process")
kernels = pytest.importorskip("sklearn.gaussian_process.kernels")

OPTIONS: dict[str, Any] = {"split": "test", "overview": False, "budget": 600.0, **RECIPE}


def field_of(counts: Any, apart_nm: float = 0.4, cell_nm: float = 2.0) -> FieldTruth:
    """A field with so many defects in each cell, one or more in the columns nearest to the cell's corner."""
    counts = np.asarray(counts)
    rows, columns = counts.shape
    each = round(cell_nm / apart_nm)
    y, x = np.mgrid[: rows * each, : columns * each]
    places = (np.column_stack([x.ravel(), y.ravel()]) + 0.5) * apart_nm
    numbers = np.zeros(len(places), dtype=np.int64)
    for (row, column), count in np.ndenumerate(counts):
        own = np.flatnonzero((y.ravel() // each == row) & (x.ravel() // each == column))
        for n in range(count):
            numbers[own[n % len(own)]] += 1
    grid = Grid(rows, columns, (columns * cell_nm, rows * cell_nm), 0.06)
    return FieldTruth.of(grid, Columns(places, np.zeros(len(places), dtype=np.int64), ("A",), np.column_stack([numbers, 0 * numbers])))


def test_cells_are_the_tiles_of_the_grid() -> None:
    field = facts((5, 6))
    grid = Grid(5, 6, (field.size_nm[1], field.size_nm[0]), field.overlap_px * field.pixel_nm)
    for row in range(5):
        for column in range(6):
            tile = acquired(np.ones((128, 128)), row, column)
            x, y = tile.centre_nm
            half = tile.size_nm / 2
            assert np.argwhere(grid.touched((x - half, y - half, x + half, y + half))).tolist() == [[row, column]]
            assert [int(n[0]) for n in grid.cells_of(np.array([tile.centre_nm]))] == [row, column]
    # A map in parts of any size holds as many defects.
    for shape in ((5, 6), (10, 12), (1, 1), (5, 1)):
        density = np.random.default_rng(0).random(shape)
        assert grid.per_cell(density).shape == (5, 6) and (shape != (5, 6) or np.allclose(grid.per_cell(density), density))
        assert grid.per_cell(np.ones(shape)).sum() == pytest.approx(math.prod(shape))


def test_rare_tiles_that_touch_are_one_cluster() -> None:
    counts = np.zeros((6, 8), dtype=int)
    counts[0, 0] = counts[1, 1] = counts[5, 7] = counts[4, 7] = counts[0, 7] = 40
    truth = field_of(counts)
    assert truth.total == 200 and np.array_equal(truth.counts, counts)
    assert truth.clusters.max() == 3 and truth.clusters[0, 0] == truth.clusters[1, 1] != truth.clusters[5, 7]
    # Chance alone makes no tile rare.
    even = np.random.default_rng(1).poisson(9.0, (30, 30))
    assert field_of(even, 0.2).clusters.max() == 0 and rare_from(9.0) == 39


def test_rare_claims_are_right_or_wrong_by_tile() -> None:
    counts = np.zeros((4, 4), dtype=int)
    counts[0, 0] = counts[3, 3] = 40
    truth, seen = field_of(counts), np.ones((4, 4), dtype=bool)
    assert rare_score(truth, [[1, 1], [7, 7]], seen) == (1.0, 2, 2, 2)
    # Twice in a tile is once; half of the claims and half of the clusters; a cluster where nobody looked is not found.
    assert rare_score(truth, [[1, 1], [1.5, 1], [3, 1]], seen)[0] == pytest.approx(0.5)
    seen[3, 3] = False
    assert rare_score(truth, [[1, 1], [7, 7]], seen) == (pytest.approx(2 / 3), 1, 2, 1)
    assert rare_score(truth, [], seen)[0] == 0.0
    without = field_of(np.ones((4, 4), dtype=int))
    assert rare_score(without, [], seen)[0] == 1.0 and rare_score(without, [[1, 1]], seen)[0] == 0.0


def test_named_columns_are_the_likeliest_hundred() -> None:
    random = np.random.default_rng(2)
    truth = field_of(random.poisson(3.0, (6, 6)))
    places, numbers = truth.columns.places_nm, truth.numbers
    best = int(np.sort(numbers)[::-1][:100].sum())
    order = np.argsort(-numbers, kind="stable")
    named = np.column_stack([places[order[:150]], np.arange(150, 0, -1)])
    assert named_columns(truth, named) == (int((numbers[order[:100]] > 0).sum()), best, best)
    # The order of the list does not matter, the numbers do; who is 0.2 nm off names nothing, and twice is once.
    assert named_columns(truth, random.permutation(named)) == named_columns(truth, named)
    assert named_columns(truth, named + [0.2, 0, 0])[:2] == (0, 0)
    once = named_columns(truth, named[:1])
    assert named_columns(truth, np.repeat(named[:1], 5, axis=0)) == once and once[1] == numbers.max()
    assert named_columns(truth, np.zeros((0, 3))) == (0, 0, best)


def test_maps_gain_bits_by_poissons_law() -> None:
    random = np.random.default_rng(3)
    rates = random.gamma(2.0, 4.0, (12, 12))
    seen = random.random((12, 12)) < 0.3
    gains = {name: 0.0 for name in ("rates", "doubled", "constant", "none")}
    for _ in range(40):
        truth = field_of(random.poisson(rates))
        told = {"rates": rates, "doubled": 2 * rates, "constant": np.full((1, 1), 8.0 * 144), "none": None}
        for name, density in told.items():
            gained, most = map_bits(truth, density, 8.0, seen)
            gains[name] += gained
            assert gained <= most
        exact = stats.poisson.logpmf(truth.counts[~seen], rates[~seen]) - stats.poisson.logpmf(truth.counts[~seen], 8.0)
        assert map_bits(truth, rates, 8.0, seen)[0] == pytest.approx(float(exact.sum()) / math.log(2))
    # The rates themselves are the best forecast in the mean.
    assert gains["rates"] > 0 > gains["doubled"] and gains["constant"] == pytest.approx(0) and gains["none"] == 0.0
    assert map_bits(field_of(np.full((3, 3), 8)), np.zeros((1, 1)), 8.0, np.zeros((3, 3), dtype=bool))[0] == pytest.approx(9 * (8 * math.log2(0.01) + 0.99 * 8 / math.log(2)))


def smooth_field(seed: int, shape: tuple[int, int] = (20, 20)) -> np.ndarray:
    """Rates with three hills."""
    random = np.random.default_rng([seed, 5])
    row, column = np.indices(shape)
    rates = np.full(shape, 4.0)
    for _ in range(3):
        y, x = random.random(2) * shape
        rates += 30 * np.exp(-((row - y) ** 2 + (column - x) ** 2) / (2 * 2.5**2))
    return rates


def test_processes_are_those_of_scikit_learn() -> None:
    random = np.random.default_rng(4)
    rates = smooth_field(1)
    tiles = random.choice(400, 40, replace=False)
    sigmas = random.uniform(2.0, 4.0, 40)
    counts = rates.ravel()[tiles] + sigmas * random.standard_normal(40)
    own = CountProcess((20, 20), np.full((20, 20), 9.0))
    own.fit(tiles, counts, sigmas)
    found = own.predict(tiles, counts, sigmas)
    # The mixture of ideas is that of as many processes of scikit-learn, with their own likelihoods.
    at, everywhere = (np.column_stack(np.divmod(n, 20)) for n in (tiles, np.arange(400)))
    likely, means, squares = [], [], []
    for idea in own._ideas:
        kernel = kernels.ConstantKernel(idea.variance) * kernels.Matern(idea.lengths, nu=1.5)
        model = processes.GaussianProcessRegressor(kernel, alpha=sigmas**2, optimizer=None).fit(at, counts - 9.0)
        likely.append(model.log_marginal_likelihood_value_)
        mean, deviation = model.predict(everywhere, return_std=True)
        means.append(mean)
        squares.append(deviation**2 + mean**2)
    weights = np.exp(np.array(likely) - max(likely))
    weights /= weights.sum()
    assert np.allclose(weights, [idea.weight for idea in own._ideas])
    assert np.allclose(found.mean.ravel(), 9.0 + weights @ means, atol=1e-6)
    assert np.allclose(found.deviation.ravel() ** 2, weights @ squares - (weights @ means) ** 2, atol=1e-5)
    # Numbers below 0 count as 0.
    draws = found.mean + found.deviation * random.standard_normal((4000, 20, 20))
    assert np.allclose(found.numbers(), np.maximum(draws, 0).mean(axis=0), atol=0.1 * float(found.deviation.max()))
    # And the map is nearer to the truth than what was expected.
    assert np.mean((found.mean - rates) ** 2) < 0.5 * np.mean((9.0 - rates) ** 2)


def test_noise_alone_leaves_the_map_as_it_was() -> None:
    random = np.random.default_rng(6)
    expected = np.linspace(5, 15, 400).reshape(20, 20)
    tiles = random.choice(400, 30, replace=False)
    off = []
    for known in (True, False):
        counts = expected.ravel()[tiles] + 20 * random.standard_normal(30)
        sigmas = np.full(30, 20.0 if known else math.nan)
        process = CountProcess((20, 20), expected)
        process.fit(tiles, counts, sigmas)
        off.append(float(np.abs(process.predict(tiles, counts, sigmas).mean - expected).mean()))
    # The mean of 30 counts is known to 3.7.
    assert max(off) < 4.0


def test_counts_of_a_tile_have_the_error_that_they_say() -> None:
    """Columns of two kinds, whose counts say little each; a tile with three times the usual number, one with none."""
    random = np.random.default_rng(7)
    prior = np.vstack([np.tile(stats.poisson.pmf(np.arange(8), mean), (300, 1)) for mean in (0.2, 0.8)])
    prior /= prior.sum(axis=1, keepdims=True)
    usual = float((prior @ np.arange(8)).sum())
    for times in (0.0, 1.0, 3.0):
        misses, sigmas = [], []
        for _ in range(200):
            numbers = np.concatenate([random.poisson(0.2 * times, 300), random.poisson(0.8 * times, 300)])
            curve = np.repeat([0.02, 0.01], 300)
            toward = numbers * curve + np.sqrt(curve) * random.standard_normal(600)
            count, sigma = _count(usual, [_pull(toward[:, None], curve[:, None, None], prior, "known")], 1.0)
            misses.append(count - times * usual)
            sigmas.append(sigma)
        assert abs(float(np.mean(misses))) < 4 * float(np.std(misses)) / math.sqrt(200)
        # The error is that of the usual number; hardly any of it comes from the number's own chance here.
        assert float(np.std(misses)) == pytest.approx(float(np.mean(sigmas)), rel=0.25)
    assert _count(10.0, [], 0.5) == (5.0, 5000.0)


class _Counting:
    """Knows the number of defects of each tile, with an error."""

    def __init__(self, rates: np.ndarray, sigma: float, seed: int) -> None:
        self._random, self._rates, self._sigma = np.random.default_rng([seed, 1]), rates, sigma
        self._counted: list[tuple[float, float]] = []

    def __call__(self, tiles: Any) -> np.ndarray:
        for tile in tiles[len(self._counted) :]:
            self._counted.append((float(self._rates[tile.row, tile.column]) + self._sigma * self._random.standard_normal(), self._sigma))
        return np.array(self._counted)


def looked(navigator: Any, rates: np.ndarray, sigma: float, seed: int, looks: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """Where a navigator looks, and what it is told there."""
    field = facts(rates.shape)  # type: ignore[arg-type]
    seen = bench.Seen(field, counts_of=_Counting(rates, sigma, seed))
    navigator.start(field, np.random.default_rng(seed))
    for _ in range(looks):
        chosen = navigator.choose(seen)
        seen.tiles.append(SimpleNamespace(row=chosen.row, column=chosen.column))  # type: ignore[arg-type]
    assert seen.counts_of is not None
    return seen.visited(), seen.counts_of(seen.tiles)


def test_a_closed_loop_finds_more_than_who_does_not_look_where_it_goes() -> None:
    """The error of a tile is as large as the field's spread: no single count tells much."""
    share: dict[str, list[float]] = {"raster": [], "random": [], "counts": []}
    for seed in range(8):
        rates = smooth_field(seed)
        for name, navigator in (("raster", bench.Raster()), ("random", bench.RandomTiles()), ("counts", bench.ByCounts(usual="flat"))):
            visited, _ = looked(navigator, rates, float(rates.std()), seed)
            share[name].append(float(rates[visited].sum() / rates.sum()))
    means = {name: float(np.mean(values)) for name, values in share.items()}
    assert means["counts"] > 1.5 * max(means["raster"], means["random"]), means


def test_maps_of_counts_find_rare_tiles() -> None:
    rates = np.full((12, 12), 2.0)
    rates[4:6, 7:9] = 60.0
    field = facts((12, 12))
    tiles = [acquired(np.ones((128, 128)), row, column) for row in range(0, 12, 2) for column in range(1, 12, 2)]
    counts = np.array([[rates[tile.row, tile.column], 1.0] for tile in tiles])
    said = with_map(bench.Findings(), field, tiles, counts, None)
    assert said.density is not None and said.density.shape == (12, 12) and said.density[4, 8] > 2 * said.density[0, 0]
    grid = Grid(12, 12, (field.size_nm[1], field.size_nm[0]), 0.08)
    assert [n.tolist() for n in grid.cells_of(said.rare)] == [[4], [7]]
    # Far too noisy a count is no claim.
    loud = with_map(bench.Findings(), field, tiles, counts * [1, 0] + [0, 500], np.full((12, 12), 2.0))
    assert len(loud.rare) == 0


def test_priors_of_a_part_of_the_field_are_those_of_its_columns() -> None:
    recipe = sw.Recipe("test", set=RECIPE["set"], grid=(1, 2))
    held = np.mean([columns_of(recipe.with_seed(seed).toml).defects.sum() for seed in TRAINING_SEEDS])
    height, width = recipe.fov_nm
    assert prior_of(recipe).size_nm == (width, height) and width < 8
    assert expected_counts(recipe, grid_of(recipe)).sum() == pytest.approx(held, rel=0.1)


def test_reports_carry_maps_and_rare_places() -> None:
    said = bench.Findings(density=np.array([[1.25, 0.0]]), rare=np.array([[1.0, 2.0]]))
    read = bench.Findings.read(said.report())
    assert read.density is not None and read.density.tolist() == [[1.25, 0.0]] and read.rare.tolist() == [[1.0, 2.0]]
    for wrong in ({"density": [1.0]}, {"density": [[-1.0]]}, {"density": [[]]}, {"rare": [[1.0, math.inf]]}, {"density": "a"}):
        with pytest.raises(InvalidValue):
            bench.Findings.read(json.dumps(wrong))


@pytest.fixture
def envs(own_cache: None) -> dict[str, Any]:
    return {name: gym.make(f"stemworlds/{name}-v0", **OPTIONS) for name in ("FieldRecall", "FieldRecallStrict", "DensityMap", "Rare")}


def test_recall_is_the_share_of_all_defects(envs: dict[str, Any]) -> None:
    env = envs["FieldRecall"].unwrapped
    env.reset(seed=1)
    columns = columns_of(env.specimen().toml)
    env.acquire(0, 1)
    env.acquire(1, 2, zoom=2.0, dose=0.5)
    assert env.score() == 0.0, "nothing was declared"
    env.declare(bench.Findings())
    held = np.zeros(len(columns.kinds), dtype=bool)
    x, y = columns.places_nm.T
    for tile in env._seen:
        half = tile.size_nm / 2
        held |= (np.abs(x - tile.centre_nm[0]) <= half) & (np.abs(y - tile.centre_nm[1]) <= half)
    assert env.score() == pytest.approx(columns.defects[held].sum() / columns.defects.sum()) and env.score() > 0
    # A second look finds nothing more; all tiles hold nearly all.
    before = env.score()
    env.acquire(0, 1)
    assert env.score() == before
    for row in range(2):
        for column in range(3):
            if env.record()["spent"] + 100 <= 600:
                env.acquire(row, column)
    assert before < env.score() <= 1.0


def test_agents_play_the_field(envs: dict[str, Any]) -> None:
    names = ("Nothing", "Raster", "Prior map", "GP counts", "Truth map")
    found = {task: {name: bench.play(env, bench.make_agent(name), 1) for name in names} for task, env in envs.items()}
    final = {task: {name: record["metrics"]["final_score"] for name, record in records.items()} for task, records in found.items()}
    # All six tiles are in the budget: recall depends on nothing else.
    assert all(score == pytest.approx(1.0, abs=0.02) for score in final["FieldRecall"].values())
    assert final["FieldRecallStrict"]["Nothing"] == 0.0 < final["FieldRecallStrict"]["Prior map"] < final["FieldRecallStrict"]["Truth map"] == 1.0
    assert all(record["unreadable"] == 0 for records in found.values() for record in records.values())
    # Where one looks first counts: the tiles that hold most.
    curves = {name: found["FieldRecall"][name]["curve"][0][1] for name in ("Raster", "Truth map")}
    assert curves["Raster"] <= curves["Truth map"]
    told = found["DensityMap"]["Truth map"]["scores"]["field"]
    assert told["recall"] == pytest.approx(1.0, abs=0.02) and told["defects_at_k"] == 1.0 and told["map_bits"] == told["map_bits_of_the_truth"]


def test_maps_are_scored_where_nobody_looked(envs: dict[str, Any]) -> None:
    env = envs["DensityMap"].unwrapped
    env.reset(seed=1)
    env.acquire(0, 0)
    env.declare(env.truth_seen())
    assert env.score() == 1.0
    recipe = env.recipe
    usual = expected_counts(recipe, grid_of(recipe))
    for density, least, most in ((None, 0.0, 0.0), (np.full((1, 1), usual.sum()), 0.0, 1e-9), (usual, 0.0, 0.999)):
        env.declare(bench.Findings(density=density))
        assert least <= env.score() <= most


def test_scores_of_the_field_are_paid_pickled_and_shared_by_many(envs: dict[str, Any]) -> None:
    options = {**OPTIONS, "reward": "score_gain"}
    env = gym.make("stemworlds/FieldRecall-v0", disable_env_checker=True, **options).unwrapped
    env.reset(seed=2)
    env.declare(bench.Findings())  # type: ignore[attr-defined]
    paid = sum(env.acquire(0, n)[1] for n in range(3))  # type: ignore[attr-defined]
    copy = pickle.loads(pickle.dumps(env))
    for one in (env, copy):
        _, reward, *_, info = one.step({"type": bench.DONE})
        final = info["record"]["metrics"]["final_score"]
        assert paid + reward == pytest.approx(final) and final > 0
        assert info["record"]["scores"]["field"]["recall"] == info["record"]["curve"][-1][1]
    many: Any = gym.make_vec("stemworlds/FieldRecall-v0", num_envs=2, vectorization_mode="vector_entry_point", **options)
    many.reset(seed=2)
    many.step({"type": [2, 2], "report": ["{}", "{}"]})
    many.step({"type": [0, 0], "position": [many.field.centre_of(0, 0), many.field.centre_of(1, 2)]})
    rewards = many.step({"type": [1, 1]})[1]
    single = gym.make("stemworlds/FieldRecall-v0", disable_env_checker=True, **options).unwrapped
    single.reset(seed=2)
    single.declare(bench.Findings())  # type: ignore[attr-defined]
    assert rewards[0] == single.acquire(0, 0)[1] > 0 and rewards[1] > 0  # type: ignore[attr-defined]
    # And with the wrappers for libraries of reinforcement learning.
    grid = bench.DiscreteGrid(gym.make("stemworlds/Rare-v0", disable_env_checker=True, **options), cells=3)
    grid.reset(seed=0)
    assert grid.step(1)[4]["acquired"].row == 0 and grid.step(2)[2]


def test_reports_that_cannot_be_read_change_nothing(envs: dict[str, Any]) -> None:
    env = envs["DensityMap"].unwrapped
    env.reset(seed=3)
    env.acquire(0, 0)
    env.declare(env.truth_seen())
    for wrong in ('{"density": [[-1]]}', '{"density": [1]}', '{"rare": [[0, 1, 2]]}', '{"columns": 3}', '{"densities": [[1]]}'):
        info = env.step({"type": bench.DECLARE, "report": wrong})[4]
        assert "fault" in info, wrong
    assert env.record()["unreadable"] == 5 and env.score() == 1.0


def test_what_has_no_field_is_refused(field_path: Path) -> None:
    assert "stemworlds/DensityMapStrict-v0" not in gym.registry and "stemworlds/FieldRecallStrict-v0" in gym.registry
    with pytest.raises(StemworldsError, match="one form"):
        bench.MicroscopeEnv("rare", strict=True, **OPTIONS)
    # A file that was built from a recipe has a field, too.
    env = bench.MicroscopeEnv("field-recall", world=str(field_path))
    env.reset(seed=0)
    env.declare(bench.Findings())
    env.acquire(0, 0)
    assert 0 < env.score() < 1
    with pytest.raises(InvalidValue, match="tile_counts"):
        navigator = bench.ByCounts(usual="flat")
        navigator.start(env.field, np.random.default_rng(0))
        navigator.choose(bench.Seen(env.field))


def test_the_lattice_has_no_prior_to_go_by() -> None:
    for navigator in (bench.ByPrior(), bench.ByTruth(), bench.ByCounts()):
        navigator.attach(Lattice())
        with pytest.raises(InvalidValue, match="no recipe"):
            navigator.start(facts(), np.random.default_rng(0))


EXPERIMENT = """
tasks = ["field-recall", "density-map"]
seeds = 3
budgets = [300]
agents = ["Raster", "Prior map", "Truth map"]
worlds = [{name = "small", recipe = "test", set = {"field.thickness_nm" = 0.4}}]
"""


@pytest.mark.long
def test_experiments_and_reports_of_the_field(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text(EXPERIMENT)
    out = tmp_path / "e.jsonl"
    summary = bench.run_experiment(bench.read_experiment(tmp_path / "e.toml"), out, processes=1, progress=lambda _line: None)
    assert not summary.failed and summary.done == 18
    lines = {line["agent"]: line for line in bench.leaderboard(out)[0]["agents"]}
    assert lines["Truth map"]["role"] == "ceiling" and lines["Prior map"]["role"] == "blind" and lines["Raster"]["rank"] == 1
    page = bench.write_report(out, tmp_path / "e.html")[0].read_text()
    assert "<h2>The field</h2>" in page and "density-map, small" in page and "recall over raster" in page
    for text, words in (('tasks = ["rare"]\nstrict = true\n', "one form"), ('tasks = ["recall"]\n', "field-recall")):
        (tmp_path / "w.toml").write_text(text + EXPERIMENT.split("\n", 2)[2])
        with pytest.raises(InvalidValue, match=words):
            bench.read_experiment(tmp_path / "w.toml")
    # Who names no tasks means the paper's.
    (tmp_path / "n.toml").write_text(EXPERIMENT.split("\n", 2)[2])
    assert {episode.task for episode in bench.read_experiment(tmp_path / "n.toml")} == {"defect-census", "phase-mapping", "targeted", "particle-census"}
    packaged = bench.read_experiment("field")
    assert {episode.task for episode in packaged} == {"field-recall", "density-map", "rare"}
    for world in packaged.worlds:
        sw.Recipe(world["recipe"], world["difficulty"], set=world.get("set"))
