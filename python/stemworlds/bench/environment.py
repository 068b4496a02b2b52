"""The Gymnasium environment: an agent controls a microscope under a dose budget."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any, cast

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ..errors import _invalid
from ..recipes import Recipe
from . import rendering
from .episodes import ACQUIRE, DECLARE, DOSE, NAVIGATE, OVERVIEW_PX, ZOOM, Acquired, Episodes, FieldFacts, Moves, Task, kinds, observation, reported, type_of
from .findings import Findings

Observation = dict[str, npt.NDArray[Any]]
Action = Mapping[str, Any]
Step = tuple[Observation, float, bool, bool, dict[str, Any]]

#: Longest report in the action space, in characters. :meth:`MicroscopeEnv.step` reads longer reports too.
REPORT_CHARACTERS = 4096
_LARGEST_PIXEL_NM = 1e3
_REPORT_ALPHABET = frozenset(' "+,-.0123456789:[]_abcdefghijklmnopqrstuvwxyz{}')


def observation_space(field: FieldFacts) -> spaces.Dict:
    """Returns the space of observations of a field."""

    def box(low: float, high: float, *shape: int) -> spaces.Box:
        return spaces.Box(low, high, shape, np.float32)

    return spaces.Dict(
        {
            "tile": box(0, 1, field.tile_px, field.tile_px),
            "overview": box(0, 1, OVERVIEW_PX, OVERVIEW_PX),
            "position": box(0, 1, 2),
            "dose_left": box(0, 1, 1),
            "visited": spaces.Box(0, 1, field.grid, np.int8),
            "step_fraction": box(0, 1, 1),
            "pixel_size_nm": box(0, _LARGEST_PIXEL_NM, 1),
            "action_mask": spaces.Box(0, 1, (4,), np.int8),
        }
    )


def action_space() -> spaces.Dict:
    """Returns the space of actions."""
    return spaces.Dict(
        {
            "type": spaces.Discrete(4),
            "position": spaces.Box(0, 1, (2,), np.float32),
            "zoom": spaces.Box(*ZOOM, (1,), np.float32),
            "dose": spaces.Box(*DOSE, (1,), np.float32),
            "report": spaces.Text(REPORT_CHARACTERS, min_length=0, charset=_REPORT_ALPHABET),
        }
    )


def fill(moves: Moves, slot: int, action: Action) -> None:
    """Writes the action of one environment into ``moves``. Missing keys take their defaults."""
    moves.kinds[slot] = kinds([type_of(action)])[0]
    x, y = np.asarray(action.get("position", (0.5, 0.5)), dtype=np.float64).reshape(2)
    moves.positions[slot] = (float(x), float(y))
    moves.zooms[slot] = float(np.asarray(action.get("zoom", 1.0)).reshape(-1)[0])
    moves.doses[slot] = float(np.asarray(action.get("dose", 1.0)).reshape(-1)[0])
    moves.reports[slot] = reported(action.get("report", ""))


class MicroscopeEnv(gym.Env[Observation, Action]):
    """A scanning microscope with a specimen and a dose budget.

    An action has a ``type``: 0 moves to ``position`` (x, y in fractions of the field), 1 acquires a tile there with ``zoom`` and ``dose``,
    2 declares ``report`` (JSON, see :class:`Findings`), 3 ends the episode. Only an acquisition costs dose: 100 * dose * zoom**2 electrons
    per square Angstrom. ``zoom`` and ``dose`` outside of the action space are set to its limits. An acquisition that does not fit the
    budget is refused and ends the episode.

    A score is recorded after every ``cadence`` acquired tiles, once there is a declaration. It uses the last declaration before the next
    acquisition.

    Environments can be pickled and copied (:func:`copy.deepcopy`). The copy is in the same state of the same episode. It repeats all
    actions of the episode, which costs about the time of the original.

    Args:
        task: name of the task.
        strict: use the strict form of the task. Places have to be correct to 0.1 nm, not to the paper's 5 nm.
        world: a world file. Pass either ``world`` or ``recipe``.
        recipe: a recipe. Each reset makes a new specimen. Accepts ``difficulty``, ``set``, ``unset``, ``grid`` and ``seed`` as well.
        damage: acquisitions change the specimen, as the table ``[damage]`` of the recipe specifies.
        split: ``"train"`` (default) or ``"test"``, for recipes. The two splits have no specimen seed in common.
        budget: dose budget in electrons per square Angstrom.
        horizon: largest number of steps. ``max_episode_steps`` of :func:`gymnasium.make` has the same effect.
        cadence: number of acquired tiles from one recorded score to the next.
        exposure: ``"tier"``: a pixel gets the dose of the world's tier times the action's ``dose``; ``"physical"``: it gets the dose that
            the budget pays.
        noise: ``"poisson"`` counts electrons; ``"stored"`` shows the tiles of the file. Recorded data use ``"stored"``.
        reward: ``"none"``; ``"score_gain"``, the changes of the score; or ``"sparse"``, the final score.
        target: the type of defect for targeted characterisation, ``"vacancy"`` or ``"substitution"``; by default the world's commonest.
        overview: show the overview. For a recipe it is simulated around the position, at the cost of two or three tiles.
        phase_stride_px: distance, in pixels, of the points at which phases are compared.
        cache, threads, progress: see :func:`stemworlds.build`. The first environment of a recipe computes its library, which takes minutes.
        render_mode: ``"rgb_array"`` or ``"ansi"``.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        "render_modes": ["rgb_array", "ansi"],
        "render_fps": 5,
    }
    observation_space: spaces.Space[Observation]
    action_space: spaces.Space[Action]

    def __init__(self, task: Task = "defect-census", strict: bool = False, *, render_mode: str | None = None, **options: Any) -> None:
        self._made_of: dict[str, Any] = {"task": task, "strict": strict, **options}
        self._episodes = Episodes(1, **self._made_of)
        #: All steps from the last reset on, including the reset.
        self._done: list[Moves] = []
        self.render_mode = render_mode
        self.observation_space = cast("spaces.Space[Observation]", observation_space(self.field))
        self.action_space = cast("spaces.Space[Action]", action_space())
        self._seed: int | None = None
        self._number = 0
        self._seen: list[Acquired] = []
        self._last: Findings | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Returns the state for pickle and :func:`copy.deepcopy`: the options, and the actions of the episode."""
        state = dict(vars(self))
        del state["_episodes"]
        return state

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Restores the environment, and repeats the actions of the episode."""
        vars(self).update(state)
        self._episodes = Episodes(1, **self._made_of)
        for moves in self._done:
            self._episodes.step(moves)

    @property
    def field(self) -> FieldFacts:
        """The facts of the field that are known before the first acquisition."""
        return self._episodes.field

    @property
    def recipe(self) -> Recipe | None:
        """The recipe of the world, for a file the recipe of its build. ``None`` for recorded data and files of other programs."""
        return self._episodes.recipe

    def specimen(self) -> Recipe | None:
        """Returns the recipe with the seed of this episode's specimen. It reveals the truth, for agents that serve as ceilings."""
        return self._episodes.specimen(0)

    @property
    def episode_seed(self) -> tuple[int, int]:
        """The seed, and the number of the episode since that seed was set."""
        return self._seed or 0, self._number

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode: episode 0 of ``seed``, or the next episode of the current seed if ``seed`` is ``None``."""
        super().reset(seed=seed)
        self._limit()
        if seed is not None:
            self._seed, self._number = seed, 0
        elif self._seed is None:
            self._seed, self._number = int(self.np_random.integers(2**62)), 0
        else:
            self._number += 1
        moves = Moves.none(1)
        moves.begin[0] = (self._seed, self._number)
        self._seen.clear()
        self._last = None
        self._done = []
        found = self._does(moves)
        return observation(found, 0, self.field.pixel_nm), self._info(found)

    def _does(self, moves: Moves) -> dict[str, Any]:
        found = self._episodes.step(moves)
        self._done.append(moves)
        return found

    def _limit(self) -> None:
        """Uses the limit of a :class:`gymnasium.wrappers.TimeLimit` around this environment as its horizon.

        ``max_episode_steps`` adds this wrapper. The last step before its limit is then the last step of the episode, and gives the reward.

        Raises:
            InvalidValue: if a wrapper in between executes several steps for one of its own steps, and the reward is ``"sparse"``.
        """
        limiter = _caller(self)
        if limiter is None:
            return
        limit = int(limiter._max_episode_steps)
        if limit >= self.field.horizon:
            return
        between = limiter.env
        while between is not self:
            if getattr(type(between), "several_steps", False):
                if self._made_of.get("reward") != "sparse":
                    return
                raise _invalid(
                    "horizon", f"max_episode_steps = {limit} counts steps of {type(between).__name__}, each of which is several here; say horizon=... instead"
                )
            between = between.env
        self._made_of["horizon"] = limit
        self._episodes = Episodes(1, **self._made_of)

    def step(self, action: Action) -> Step:
        """Executes one action. The class describes the actions."""
        moves = Moves.none(1)
        fill(moves, 0, action)
        found = self._does(moves)
        seen = observation(found, 0, self.field.pixel_nm)
        info = self._info(found)
        what = found["acquired"][0]
        if what is not None:
            info["acquired"] = self._episodes.acquired(what, seen["tile"])
            self._seen.append(info["acquired"])
        if moves.kinds[0] == DECLARE and found["fault"][0] is None:
            self._last = Findings.read(moves.reports[0] or "{}")
        ended = found["ended"][0]
        if ended is not None:
            info["refused"] = ended == "refused"
            info["record"] = self._episodes.record(0)
        return seen, float(found["reward"][0]), ended in ("done", "refused"), ended == "horizon", info

    def _info(self, found: Mapping[str, Any]) -> dict[str, Any]:
        info = {
            "dose_spent": found["spent"][0],
            "budget": self.field.budget,
            "tiles": found["tiles"][0],
            "unreadable": found["unreadable"][0],
        }
        if found["fault"][0] is not None:
            info["fault"] = found["fault"][0]
        return info

    def centre_of(self, row: int, column: int) -> tuple[float, float]:
        """Returns the centre ``(x, y)`` of a tile in fractions of the field."""
        return self.field.centre_of(row, column)

    def declare(self, findings: Findings) -> Step:
        """Declares findings, which is one step."""
        return self.step({"type": DECLARE, "report": findings})

    def acquire(self, row: int, column: int, zoom: float = 1.0, dose: float = 1.0) -> Step:
        """Moves to a tile and acquires it, which are two steps. Returns the result of the last step, with the sum of the rewards."""
        went = self.step({"type": NAVIGATE, "position": self.centre_of(row, column)})
        if went[2] or went[3]:
            return went
        seen, reward, terminated, truncated, info = self.step({"type": ACQUIRE, "zoom": zoom, "dose": dose})
        return seen, reward + went[1], terminated, truncated, info

    def truth_seen(self) -> Findings:
        """Returns the truth of the acquired tiles, for agents that serve as ceilings. Phases outside of the tiles are unknown."""
        return self._episodes.truth_seen(0)

    def score(self) -> float:
        """Returns the score of the last declaration, for the tiles acquired so far."""
        return self._episodes.score(0)

    def record(self) -> dict[str, Any]:
        """Returns the record of the episode so far, with its scores. Files of results consist of these records."""
        return self._episodes.record(0)

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Returns a mask of the four types of actions: whether each is possible now."""
        record = self._episodes.record(0)
        going = record["ended"] is None
        fits = record["spent"] + 100.0 * DOSE[0] <= self.field.budget * (1 + 1e-9)
        return np.array([going, going and fits, going, going])

    def render(self) -> Any:
        """Returns a picture (``rgb_array``) or a text (``ansi``) of overview, visited tiles, findings and truth, and dose curve."""
        scene = rendering.Scene(self._episodes, self._seen, self._last)
        if self.render_mode == "rgb_array":
            return rendering.picture(scene)
        if self.render_mode == "ansi":
            return rendering.text(scene)
        return None


def _caller(env: gym.Env[Any, Any]) -> Any:
    """Returns the wrapper with a limit of steps whose ``reset`` called the environment, or ``None``.

    It searches the call stack, since an environment has no reference to its wrappers.
    """
    frame = sys._getframe(1)
    while frame is not None:
        about = frame.f_locals.get("self") if frame.f_code.co_name == "reset" else None
        if isinstance(about, gym.wrappers.TimeLimit) and about.unwrapped is env:
            return about
        frame = frame.f_back  # type: ignore[assignment]
    return None
