"""Environments of the benchmark, with Gymnasium's own checks."""

from __future__ import annotations

import copy
import pickle
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from bench_world import PAPER_TASKS
from conftest import RECIPE
from gymnasium.utils.env_checker import check_env

import stemworlds as sw
from stemworlds import bench


def same(a: Any, b: Any) -> bool:
    return set(a) == set(b) and all(np.array_equal(a[name], b[name]) for name in a)


@pytest.mark.parametrize("name", sorted(name for name in gym.registry if name.startswith("stemworlds/")))
def test_gymnasium_accepts_all_environments(field_path: Path, name: str) -> None:
    env = gym.make(name, world=field_path, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Zoom and dose have their own units.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        check_env(env.unwrapped)


@pytest.mark.long
def test_gymnasium_accepts_wrapped_environments(field_path: Path) -> None:
    def make() -> gym.Env[Any, Any]:
        return gym.make("stemworlds/DefectCensus-v0", world=field_path).unwrapped

    for wrapped in (bench.DiscreteGrid(make()), bench.TargetBox(make()), bench.GridChoice(make()), bench.ByteImages(make())):
        check_env(wrapped, skip_render_check=True)


def test_specimens_of_recipes_are_new_at_each_reset() -> None:
    env = gym.make("stemworlds/DefectCensus-v0", **RECIPE).unwrapped
    assert isinstance(env, bench.MicroscopeEnv)

    def look() -> tuple[Any, sw.bench.Findings]:
        seen = env.acquire(0, 1)
        return seen[0]["tile"], env.truth_seen()

    env.reset(seed=3)
    first, truth = look()
    env.reset()
    other, _ = look()
    assert not np.array_equal(first, other)
    env.reset(seed=3)
    again, true_again = look()
    assert np.array_equal(first, again)
    assert truth.report() == true_again.report()
    tested = gym.make("stemworlds/DefectCensus-v0", split="test", **RECIPE).unwrapped
    assert isinstance(tested, bench.MicroscopeEnv)
    tested.reset(seed=3)
    tested.acquire(0, 1)
    assert tested.truth_seen().report() != truth.report()
    # Another environment of the same kind tells the same.
    twin = gym.make("stemworlds/DefectCensus-v0", **RECIPE).unwrapped
    assert isinstance(twin, bench.MicroscopeEnv)
    twin.reset(seed=3)
    assert np.array_equal(twin.acquire(0, 1)[0]["tile"], first)


def test_many_environments_do_what_single_ones_do(field_path: Path) -> None:
    for options in ({"world": field_path}, RECIPE):
        many = gym.make_vec("stemworlds/Targeted-v0", num_envs=3, vectorization_mode="vector_entry_point", horizon=4, **options)
        single = [gym.make("stemworlds/Targeted-v0", horizon=4, **options).unwrapped for _ in range(3)]
        seen, _ = many.reset(seed=7)
        for n, env in enumerate(single):
            assert same(env.reset(seed=7 + n)[0], {name: values[n] for name, values in seen.items()})
        rng = np.random.default_rng(1)
        over = np.zeros(3, dtype=bool)
        episodes = 0
        for step in range(11):
            action: dict[str, Any] = {
                "type": rng.integers(0, 3, 3),
                "position": rng.random((3, 2), dtype=np.float32),
                "zoom": rng.uniform(1, 3, (3, 1)),
                "dose": rng.uniform(0.5, 2, (3, 1)),
                "report": ["{}", '{"defects": {"vacancy": [[1, 2]]}}', "no report"],
            }
            seen, reward, terminated, truncated, _ = many.step(action)
            for n, env in enumerate(single):
                if over[n]:
                    mine, paid, ended, cut = env.reset()[0], 0.0, False, False
                else:
                    mine, paid, ended, cut, _ = env.step({name: values[n] for name, values in action.items()})
                assert same(mine, {name: values[n] for name, values in seen.items()}), (step, n)
                assert (paid, ended, cut) == (reward[n], terminated[n], truncated[n])
            over = terminated | truncated
            episodes += int(over.sum())
        # The horizon is four steps, and the next one begins the next episode.
        assert episodes == 6


def looks_of(env: Any, seed: int) -> list[Any]:
    """What an environment shows and pays in some steps of an episode."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(4):
        seen, paid, *_, info = env.acquire(*(int(n) for n in rng.integers(0, 2, 2)))
        out += [*seen.values(), paid, info["dose_spent"]]
        out += [env.declare(env.truth_seen())[1], env.score()]
    return out


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
@pytest.mark.parametrize(
    "options",
    [{}, pytest.param({**RECIPE, "damage": True, "reward": "score_gain"}, marks=pytest.mark.long)],
    ids=["file", "damage"],
)
def test_a_copy_is_in_the_same_episode(field_path: Path, copied: Any, options: dict[str, Any]) -> None:
    made = gym.make("stemworlds/Targeted-v0", **(options or {"world": field_path}), overview=False)
    # Before the first reset.
    env = copied(made)
    for one in (made, env):
        one.reset(seed=4)
        one.step({"type": bench.ACQUIRE, "zoom": 2.0, "dose": 2.0})
        one.step({"type": bench.DECLARE, "report": '{"defects": {"vacancy": [[1, 2]]}}'})
    twin = copied(env)
    assert twin.unwrapped.record() == env.unwrapped.record() == made.unwrapped.record()
    wanted = looks_of(made.unwrapped, 1)
    for one in (env, twin):
        assert all(np.array_equal(a, b) for a, b in zip(looks_of(one.unwrapped, 1), wanted, strict=True))
    # The next episodes are the same, and neither knows of the other.
    assert same(twin.reset()[0], env.reset()[0])
    env.step({"type": bench.DONE})
    assert not twin.step({"type": bench.ACQUIRE})[2]


def test_copies_of_many_environments(field_path: Path) -> None:
    many = bench.MicroscopeVectorEnv(3, "targeted", world=field_path, horizon=5, overview=False)
    assert pickle.loads(pickle.dumps(many)).num_envs == 3
    many.reset(seed=1)
    rng = np.random.default_rng(2)

    def action() -> dict[str, Any]:
        kinds = rng.choice([0, 1, 1, 2, 3], 3)
        return {"type": kinds, "position": rng.random((3, 2), dtype=np.float32), "dose": rng.uniform(0.5, 2, (3, 1))}

    # Their episodes end at different steps, and the next ones begin.
    for _ in range(8):
        many.step(action())
    twin = copy.deepcopy(many)
    for _ in range(6):
        doing = action()
        for one, other in zip(many.step(doing), twin.step(doing), strict=True):
            if isinstance(one, dict):
                assert one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one if name not in ("acquired", "record"))
            else:
                assert np.array_equal(one, other)
    assert [many.record(n) for n in range(3)] == [twin.record(n) for n in range(3)]


def test_a_limit_of_steps_is_a_horizon(field_path: Path) -> None:
    def paid(env: gym.Env[Any, Any]) -> tuple[list[float], Any]:
        env.reset(seed=0)
        rewards = []
        for number in range(10):
            step = env.step({"type": 1} if number % 2 == 0 else {"type": 2, "report": env.unwrapped.truth_seen()})  # type: ignore[attr-defined]
            rewards.append(float(step[1]))
        assert step[2:4] == (False, True)
        return rewards, step[4]["record"]

    options: dict[str, Any] = {"world": field_path, "reward": "sparse", "overview": False}
    by_horizon = paid(gym.make("stemworlds/DefectCensus-v0", horizon=10, **options))
    assert by_horizon[0] == [0.0] * 9 + [1.0] and by_horizon[1]["ended"] == "horizon"
    assert paid(gym.make("stemworlds/DefectCensus-v0", max_episode_steps=10, **options)) == by_horizon
    assert paid(gym.wrappers.TimeLimit(gym.make("stemworlds/DefectCensus-v0", **options), 10)) == by_horizon
    # The lesser one counts.
    assert paid(gym.make("stemworlds/DefectCensus-v0", max_episode_steps=20, horizon=10, **options)) == by_horizon
    many = gym.make_vec("stemworlds/DefectCensus-v0", 2, vectorization_mode="vector_entry_point", max_episode_steps=3, **options)
    many.reset(seed=0)
    assert [many.step({"type": [0, 0]})[3].tolist() for _ in range(3)] == [[False] * 2, [False] * 2, [True] * 2]
    # Steps of an agent that are several of the environment cannot be counted so.
    grid = gym.wrappers.TimeLimit(bench.DiscreteGrid(gym.make("stemworlds/DefectCensus-v0", **options).unwrapped), 10)
    with pytest.raises(sw.InvalidValue, match="max_episode_steps = 10 counts steps of DiscreteGrid.*say horizon="):
        grid.reset()
    options["reward"] = "score_gain"
    gym.wrappers.TimeLimit(bench.DiscreteGrid(gym.make("stemworlds/DefectCensus-v0", **options).unwrapped), 10).reset()


def test_an_oracle_gets_the_paper_s_ceiling(field_path: Path) -> None:
    for task in PAPER_TASKS:
        env = gym.make(f"stemworlds/{task}-v0", world=field_path).unwrapped
        assert isinstance(env, bench.MicroscopeEnv)
        env.reset(seed=0)
        rows, columns = env.field.grid
        for n in range(50):
            env.acquire(n // columns % rows, n % columns)
            if n % 5 == 4:
                env.declare(env.truth_seen())
        *_, terminated, truncated, info = env.step({"type": bench.DONE})
        assert (terminated, truncated) == (True, False)
        record = info["record"]
        assert record["ended"] == "done" and len(record["curve"]) == 10
        assert record["metrics"]["dec_auc"] == pytest.approx(0.90816, abs=5e-6)
        # Defects are scored strictly by forecasts alone.
        strict = {"DefectCensus": None, "Targeted": None}.get(task, pytest.approx(1.0))
        assert record["scores"]["strict"] == strict and record["scores"].get("close", 1.0) == pytest.approx(1.0)


def test_what_does_not_fit_the_budget_ends_the_episode(field_path: Path) -> None:
    env = gym.make("stemworlds/DefectCensus-v0", world=field_path, budget=250.0).unwrapped
    assert isinstance(env, bench.MicroscopeEnv)
    env.reset(seed=0)
    assert env.acquire(0, 0)[4]["acquired"].cost == 100.0
    assert list(env.action_masks()) == [True] * 4
    *_, terminated, _, info = env.acquire(0, 1, dose=2.0)
    assert terminated and info["refused"] and info["dose_spent"] == 100.0
    assert list(env.action_masks()) == [False] * 4
    with pytest.raises(sw.InvalidValue, match="has ended"):
        env.step({"type": bench.NAVIGATE})


def test_actions_of_no_kind_are_refused(field_path: Path) -> None:
    env = gym.make("stemworlds/Targeted-v0", world=field_path).unwrapped
    assert isinstance(env, bench.MicroscopeEnv)
    env.reset(seed=0)
    for action in ({}, {"type": 4}, {"type": -1}, {"type": 1.5}, {"type": "acquire"}):
        with pytest.raises(sw.InvalidValue, match="1 acquires"):
            env.step(action)
    many = bench.MicroscopeVectorEnv(2, "targeted", world=field_path)
    many.reset(seed=0)
    for actions in ({}, {"type": [0, 7]}):
        with pytest.raises(sw.InvalidValue, match="1 acquires"):
            many.step(actions)
    # The episodes go on.
    assert not env.step({"type": bench.ACQUIRE, "zoom": 1.0, "dose": 1e9})[2]
    with pytest.raises(sw.StemworldsError, match="vacancy"):
        gym.make("stemworlds/Targeted-v0", world=field_path, target="vacancies")


def test_reports_that_cannot_be_read_are_counted(field_path: Path) -> None:
    env = gym.make("stemworlds/DefectCensus-v0", world=field_path).unwrapped
    assert isinstance(env, bench.MicroscopeEnv)
    env.reset(seed=0)
    env.acquire(0, 0)
    env.declare(env.truth_seen())
    info = env.step({"type": bench.DECLARE, "report": "I see atoms"})[4]
    assert info["unreadable"] == 1 and "JSON" in info["fault"]
    assert env.score() == 1.0


def test_findings_come_back() -> None:
    findings = bench.Findings(
        defects={"vacancy": np.array([[1.0, 2.0]]), "substitution": np.zeros((0, 2))},
        phases=np.array([[0, 1, bench.NO_PHASE]]),
        particles=np.array([[1.0, 2.0, 3.0]]),
        morphologies=["wulff"],
        columns=np.array([[0.0, 1.0, -2.0]]),
    )
    assert bench.Findings.read(findings.report()).report() == findings.report()
    with pytest.raises(sw.InvalidValue, match="shape"):
        bench.Findings(defects={"vacancy": np.zeros((3, 3))}).report()
    with pytest.raises(sw.InvalidValue, match="no report"):
        bench.Findings.read("[")


def test_pictures_show_the_episode(field_path: Path) -> None:
    env = gym.make("stemworlds/DefectCensus-v0", world=field_path, render_mode="rgb_array").unwrapped
    assert isinstance(env, bench.MicroscopeEnv)
    env.reset(seed=0)
    empty = env.render()
    # The overview of the file lies below, half as bright.
    field = np.asarray(empty)[8:264, 8:392]
    assert 10 < field.std() and field.max() <= 127
    env.acquire(1, 2)
    env.declare(env.truth_seen())
    full = env.render()
    assert full.shape == empty.shape and full.dtype == np.uint8 and (full != empty).mean() > 0.05
    text = gym.make("stemworlds/DefectCensus-v0", world=field_path, render_mode="ansi").unwrapped
    assert isinstance(text, bench.MicroscopeEnv)
    text.reset(seed=0)
    text.acquire(1, 2)
    lines = str(text.render()).splitlines()
    assert lines[:2] == ["...", "..@"] and "1 tiles, 100 of 5000" in lines[2]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "either a world file"),
        ({"world": "w.h5", "recipe": "test"}, "either a world file"),
        ({"world": "w.h5", "difficulty": "easy"}, "difficulty"),
        ({"recipe": "test", "split": "both"}, "train"),
        ({"recipe": "test", "budget": -1.0, "cache": True}, "budget"),
        ({"recipe": "test", "live": False}, "live"),
        ({"world": "w.h5", "split": "test"}, "split"),
    ],
)
def test_bad_options_are_told(options: dict[str, Any], words: str) -> None:
    if options.get("recipe"):
        options = {**RECIPE, **options}
    with pytest.raises(sw.StemworldsError, match=words):
        gym.make("stemworlds/DefectCensus-v0", **options)


def test_recorded_data_are_shown_as_they_are(tmp_path: Path) -> None:
    y, x = np.mgrid[:260, :390]
    noise = np.random.default_rng(1).normal(scale=20, size=x.shape)
    np.save(tmp_path / "recorded.npy", 1000 + 50 * (np.cos(2 * np.pi * x / 16) + np.cos(2 * np.pi * y / 16)) + noise)
    world = sw.import_image(tmp_path / "recorded.npy", out=tmp_path / "replay.h5", pixel_nm=0.026)
    env = gym.make("stemworlds/DefectCensus-v0", world=world.path).unwrapped
    assert isinstance(env, bench.MicroscopeEnv)
    for seed in (0, 1):
        env.reset(seed=seed)
        seen, _, _, _, info = env.acquire(1, 2, dose=2.0)
        assert np.array_equal(seen["tile"], world.tile(1, 2).array)
        assert info["dose_spent"] == 200 and info["acquired"].electrons_per_pixel == 0
    with pytest.raises(sw.InvalidValue, match="contain noise already"):
        gym.make("stemworlds/DefectCensus-v0", world=world.path, noise="poisson").reset()
