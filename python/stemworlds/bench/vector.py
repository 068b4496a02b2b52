"""Steps many environments in one call of the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ..errors import _invalid
from .environment import action_space, observation_space
from .episodes import Acquired, Episodes, FieldFacts, Moves, Task, kinds, reported, type_of
from .findings import Findings

Arrays = dict[str, npt.NDArray[Any]]


class MicroscopeVectorEnv(gym.vector.VectorEnv[Arrays, Mapping[str, Any], npt.NDArray[Any]]):
    """Steps many environments in threads. Each gives the results of a single :class:`MicroscopeEnv` with its seed.

    After the end of an episode, the next step begins another one in its place (``AutoresetMode.NEXT_STEP``).

    Args:
        num_envs: number of environments.
        max_episode_steps: largest number of steps, as ``horizon``; the smaller one counts.
        **options: options of :class:`MicroscopeEnv`.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012 (as Gymnasium declares it)
    observation_space: spaces.Space[Arrays]
    action_space: spaces.Space[Mapping[str, Any]]
    single_observation_space: spaces.Space[Arrays]
    single_action_space: spaces.Space[Mapping[str, Any]]

    def __init__(
        self,
        num_envs: int = 1,
        task: Task = "defect-census",
        strict: bool = False,
        *,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        **options: Any,
    ) -> None:
        if num_envs < 1:
            raise _invalid("num_envs", f"num_envs = {num_envs}: expected a whole number above 0")
        self.num_envs = num_envs
        if max_episode_steps is not None:
            # gymnasium.make_vec passes this argument.
            options["horizon"] = min(max_episode_steps, options.get("horizon", max_episode_steps))
        self._made_of: dict[str, Any] = {"count": num_envs, "task": task, "strict": strict, **options}
        self._episodes = Episodes(**self._made_of)
        #: The steps in the current episode of each environment.
        self._done: list[list[tuple[Any, ...]]] = [[] for _ in range(num_envs)]
        self.render_mode = render_mode
        single = observation_space(self.field)
        self._seen_names = [name for name in single.spaces if name != "pixel_size_nm"]
        self.single_observation_space = cast("spaces.Space[Arrays]", single)
        self.single_action_space = cast("spaces.Space[Mapping[str, Any]]", action_space())
        self.observation_space = cast("spaces.Space[Arrays]", batch_space(self.single_observation_space, num_envs))
        self.action_space = cast("spaces.Space[Mapping[str, Any]]", batch_space(self.single_action_space, num_envs))
        self._seeds: list[tuple[int, int] | None] = [None] * num_envs
        self._over = np.zeros(num_envs, dtype=bool)

    @property
    def field(self) -> FieldFacts:
        """The facts of the field that are known before the first acquisition."""
        return self._episodes.field

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None) -> tuple[Arrays, dict[str, Any]]:
        """Begins an episode in each environment. With a single seed, environment ``n`` gets the seed ``seed + n``."""
        seeds = [None if seed is None else seed + n for n in range(self.num_envs)] if seed is None or isinstance(seed, int) else list(seed)
        if len(seeds) != self.num_envs:
            raise _invalid("seed", f"{len(seeds)} seeds for {self.num_envs} environments")
        if isinstance(seed, int):
            super().reset(seed=seed)
        moves = Moves.none(self.num_envs)
        for n, own in enumerate(seeds):
            self._begin(n, own)
            moves.begin[n] = self._seeds[n]
        self._over[:] = False
        found = self._does(moves)
        return self._observations(found), self._info(found)

    def __getstate__(self) -> dict[str, Any]:
        """Returns the state for pickle: options, and the steps of the current episodes."""
        state = dict(vars(self))
        del state["_episodes"]
        return state

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        vars(self).update(state)
        self._episodes = Episodes(**self._made_of)
        if None in self._seeds:
            # No episode has begun, so there is nothing to repeat.
            return
        most = max(map(len, self._done))
        for step in range(most + 1):
            moves = Moves.none(self.num_envs)
            for n, own in enumerate(self._done):
                # All environments finish at the same step, so shorter episodes begin later.
                at = step - (most - len(own)) - 1
                if at < 0:
                    moves.begin[n] = self._seeds[n]
                else:
                    moves.kinds[n], moves.positions[n], moves.zooms[n], moves.doses[n], moves.reports[n] = own[at]
            self._episodes.step(moves)

    def _does(self, moves: Moves) -> dict[str, Any]:
        found = self._episodes.step(moves)
        for n, own in enumerate(self._done):
            if moves.begin[n] is not None:
                own.clear()
            else:
                own.append((moves.kinds[n], moves.positions[n], moves.zooms[n], moves.doses[n], moves.reports[n]))
        return found

    def _begin(self, n: int, seed: int | None) -> None:
        known = self._seeds[n]
        if seed is not None:
            self._seeds[n] = (int(seed), 0)
        elif known is None:
            self._seeds[n] = (int(self.np_random.integers(2**62)), 0)
        else:
            self._seeds[n] = (known[0], known[1] + 1)

    def step(self, actions: Mapping[str, Any]) -> tuple[Arrays, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Executes one action in each environment.

        ``actions`` holds arrays (``type``, ``position``, ``zoom``, ``dose``) and a list ``report``. Missing keys take their defaults.
        """
        count = self.num_envs
        moves = Moves.none(count)
        moves.kinds = kinds(np.asarray(type_of(actions)).reshape(count).tolist())
        if "position" in actions:
            moves.positions = [(x, y) for x, y in np.asarray(actions["position"], dtype=np.float64).reshape(count, 2).tolist()]
        for name, target in (("zoom", moves.zooms), ("dose", moves.doses)):
            if name in actions:
                target[:] = np.asarray(actions[name], dtype=np.float64).reshape(count).tolist()
        for n, report in enumerate(actions.get("report", ())):
            moves.reports[n] = reported(report)
        for over in np.flatnonzero(self._over).tolist():
            self._begin(over, None)
            moves.begin[over] = self._seeds[over]
        found = self._does(moves)
        ended: list[str | None] = found["ended"]
        terminated = np.array([how in ("done", "refused") for how in ended])
        truncated = np.array([how == "horizon" for how in ended])
        self._over = terminated | truncated
        return self._observations(found), found["reward"], terminated, truncated, self._info(found)

    def _observations(self, found: Mapping[str, Any]) -> Arrays:
        seen = {name: found[name] for name in self._seen_names}
        seen["pixel_size_nm"] = np.full((self.num_envs, 1), self.field.pixel_nm, dtype=np.float32)
        return seen

    def _info(self, found: Mapping[str, Any]) -> dict[str, Any]:
        info: dict[str, Any] = {
            "dose_spent": np.array(found["spent"]),
            "tiles": np.array(found["tiles"]),
            "unreadable": np.array(found["unreadable"]),
        }
        acquired = np.array([what is not None for what in found["acquired"]])
        if acquired.any():
            made: list[Acquired | None] = [
                None if what is None else self._episodes.acquired(what, image) for what, image in zip(found["acquired"], found["tile"], strict=True)
            ]
            info["acquired"] = _objects(made)
            info["_acquired"] = acquired
        over = np.array([how is not None for how in found["ended"]])
        if over.any():
            info["record"] = _objects([self._episodes.record(n) if there else None for n, there in enumerate(over)])
            info["_record"] = over
        return info

    def truth_seen(self, n: int) -> Findings:
        """Returns the truth of the tiles that environment ``n`` has acquired."""
        return self._episodes.truth_seen(n)

    def record(self, n: int) -> dict[str, Any]:
        """Returns the record of the episode of environment ``n`` so far, with its scores."""
        return self._episodes.record(n)


def _objects(values: Sequence[Any]) -> npt.NDArray[np.object_]:
    out = np.empty(len(values), dtype=object)
    out[:] = values
    return out
