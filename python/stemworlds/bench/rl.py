"""Trains and runs policies with stable-baselines3, which has to be installed (``stemworlds[rl]``)."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..errors import FileMissing, _invalid
from .agents import random_of
from .extras import needed
from .protocols import Analyst

if TYPE_CHECKING:
    import gymnasium as gym

    from .episodes import Acquired, FieldFacts
    from .findings import Findings

__all__ = ["PolicyAgent", "train_policy"]

Algorithm = Literal["DQN", "PPO", "SAC"]

#: The STEMGym paper's settings.
_SETTINGS: dict[str, dict[str, Any]] = {
    "DQN": {"learning_rate": 1e-4, "buffer_size": 50_000, "batch_size": 64, "exploration_fraction": 0.3, "gamma": 0.99},
    "PPO": {"learning_rate": 3e-4, "n_steps": 2048, "n_epochs": 10, "clip_range": 0.2, "ent_coef": 0.01, "gae_lambda": 0.95},
    "SAC": {"learning_rate": 3e-4, "buffer_size": 50_000, "batch_size": 64, "tau": 0.005, "ent_coef": "auto"},
}


def train_policy(
    algorithm: Algorithm,
    environments: Sequence[Callable[[], gym.Env[Any, Any]]],
    *,
    analyst: Callable[[], Analyst],
    steps: int = 50_000,
    seed: int = 0,
    settings: dict[str, Any] | None = None,
) -> Any:
    """Trains a policy in several worlds at once, by default with the STEMGym paper's settings.

    DQN and PPO choose among 8 x 8 places and 3 actions (:class:`DiscreteGrid`), SAC chooses a place (:class:`TargetBox`).

    Args:
        environments: functions that make one environment each: ``lambda: gym.make("stemworlds/DefectCensus-v0", recipe="srtio3",
            split="train", reward="score_gain")``. With ``reward="none"`` a policy learns nothing.
        analyst: function that makes an analyst. It is called once for each environment.
        steps: number of steps, summed over all environments.
        settings: settings of the algorithm that replace the paper's.

    Returns:
        The model of stable-baselines3. ``model.save("dqn.zip")`` saves it for :class:`PolicyAgent`.

    Images are converted to bytes (:class:`ByteImages`) for the convolutional network. The replay buffers of DQN and SAC hold 50 000 steps
    with two observations of 20 kB each, which are 2 GB. A policy works only in fields with as many tiles as in its training.
    """
    if algorithm not in _SETTINGS:
        raise _invalid("algorithm", f"algorithm = {algorithm!r}: expected one of {', '.join(_SETTINGS)}")
    if not environments:
        raise _invalid("environments", "environments: expected one or more")
    library, vectors = needed("stable_baselines3"), needed("stable_baselines3.common.vec_env")
    made = vectors.DummyVecEnv([_Wrapped(make, algorithm, analyst) for make in environments])
    chosen = {**_SETTINGS[algorithm], **(settings or {})}
    if algorithm == "PPO" and settings is None:
        # A rollout has 2048 steps, summed over all environments.
        chosen["n_steps"] = max(chosen["n_steps"] // len(environments), 2)
    model = getattr(library, algorithm)("MultiInputPolicy", made, seed=seed, **chosen)
    model.learn(total_timesteps=steps)
    return model


class _Wrapped:
    """Makes an environment with the action space of an algorithm."""

    def __init__(self, make: Callable[[], gym.Env[Any, Any]], algorithm: str, analyst: Callable[[], Analyst]) -> None:
        self._make, self._algorithm, self._analyst = make, algorithm, analyst

    def __call__(self) -> gym.Env[Any, Any]:
        env = self._make()
        acting: gym.Env[Any, Any] = _with_actions(env, self._algorithm, _Analysing(self._analyst(), env.unwrapped, lambda: np.random.default_rng(0)))
        return acting


class _Analysing:
    """Adapts an analyst to the interface of the wrappers."""

    def __init__(self, analyst: Analyst, world: Any, random: Callable[[], np.random.Generator]) -> None:
        self._analyst, self._random = analyst, random
        if hasattr(analyst, "attach"):
            analyst.attach(world)

    def __deepcopy__(self, memo: dict[int, Any]) -> _Analysing:
        """Returns the object unchanged. Wrappers copy their arguments for their specification, and a copy would duplicate the world."""
        return self

    def reset(self, field: FieldFacts) -> None:
        self._analyst.start(field, self._random())

    def analyse(self, seen: Sequence[Acquired]) -> Findings:
        return self._analyst.findings(seen)


def _with_actions(env: gym.Env[Any, Any], algorithm: str, analyst: _Analysing) -> Any:
    from .wrappers import ByteImages, DiscreteGrid, TargetBox

    return ByteImages(TargetBox(env, analyst=analyst) if algorithm == "SAC" else DiscreteGrid(env, analyst=analyst))


class PolicyAgent:
    """Plays a trained policy.

    Args:
        name: name of the agent.
        algorithm: ``"DQN"``, ``"PPO"`` or ``"SAC"``.
        model: file of a saved model from :func:`train_policy`.
        analyst: the analyst, which declares the findings.
        deterministic: choose the best action instead of a random one.
    """

    def __init__(
        self, name: str, *, algorithm: Algorithm, model: str | os.PathLike[str], analyst: Analyst, deterministic: bool = True
    ) -> None:
        if algorithm not in _SETTINGS:
            raise _invalid("algorithm", f"algorithm = {algorithm!r}: expected one of {', '.join(_SETTINGS)}")
        path = os.fspath(model)
        if not os.path.exists(path):
            raise FileMissing(f"{path}: there is no such policy; stemworlds.bench.train_policy makes one")
        self.name: str = name
        self.algorithm: Algorithm = algorithm
        self.analyst: Analyst = analyst
        self.deterministic: bool = deterministic
        self._model = getattr(needed("stable_baselines3"), algorithm).load(path, device="cpu")

    def run(self, env: gym.Env[Any, Any], seed: int) -> dict[str, Any]:
        """Plays one episode; see :func:`play`."""
        acting = _with_actions(env, self.algorithm, _Analysing(self.analyst, env.unwrapped, lambda: random_of(seed, self.name)))
        needed("stable_baselines3.common.utils").set_random_seed(seed)
        observation, _ = acting.reset(seed=seed)
        over = False
        info: dict[str, Any] = {}
        while not over:
            action, _ = self._model.predict(observation, deterministic=self.deterministic)
            observation, _, terminated, truncated, info = acting.step(action)
            over = bool(terminated or truncated)
        tell = getattr(self.analyst, "notes", None)
        return {"notes": {} if tell is None else tell(), "record": info.get("record")}
