"""The environment: act in a world under a dose budget."""

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

#: Longest report that the action space holds. Longer ones are read too.
REPORT_CHARACTERS = 4096
_LARGEST_PIXEL_NM = 1e3
_REPORT_ALPHABET = frozenset(' "+,-.0123456789:[]_abcdefghijklmnopqrstuvwxyz{}')


def observation_space(field: FieldFacts) -> spaces.Dict:
    """The space of observations of a field."""

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
    """The space of actions."""
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
    """Puts an action of an environment where it belongs. What it lacks takes its default."""
    moves.kinds[slot] = kinds([type_of(action)])[0]
    x, y = np.asarray(action.get("position", (0.5, 0.5)), dtype=np.float64).reshape(2)
    moves.positions[slot] = (float(x), float(y))
    moves.zooms[slot] = float(np.asarray(action.get("zoom", 1.0)).reshape(-1)[0])
    moves.doses[slot] = float(np.asarray(action.get("dose", 1.0)).reshape(-1)[0])
    moves.reports[slot] = reported(action.get("report", ""))


class MicroscopeEnv(gym.Env[Observation, Action]):
    """A scanning microscope with a specimen and a dose budget.

    An action has a ``type``: 0 goes to ``position`` (x, y in fractions of the field), 1 acquires there with ``zoom`` and ``dose``, 2
    declares ``report`` (JSON, see :class:`Findings`), 3 ends the episode. Only acquisitions cost: 100 * dose * zoom**2 electrons per
    square Angstrom. ``zoom`` and ``dose`` beyond the limits of the action space are moved to these. One that does not fit the budget is refused and ends the episode. Scores are recorded after every fifth acquired
    tile, with what was declared last before the next one, from the first declaration on.

    Environments can be pickled and copied (:func:`copy.deepcopy`). A copy is in the same episode: what was done in it is done again, which takes
    about as long as the first time.

    Args:
        task: what is asked for.
        strict: places have to be right to 0.1 nm, not to the paper's 5 nm.
        world: a world file; or
        recipe: a recipe, of which each reset makes another specimen; with ``difficulty``, ``set``, ``unset``, ``grid``, ``seed``.
        damage: acquisitions change the specimen, as the table ``[damage]`` of the recipe says.
        split: of recipes: ``"train"`` (default) or ``"test"``: seeds of specimens that have none in common.
        budget: electrons per square Angstrom.
        horizon: number of steps; ``max_episode_steps`` of :func:`gymnasium.make` does the same.
        cadence: acquired tiles from one record of the score to the next.
        exposure: ``"tier"``: a pixel gets the dose of the world's tier times the multiplier; ``"physical"``: the dose that is paid for.
        noise: ``"poisson"`` counts electrons; ``"stored"`` shows the tiles of the file, and is what recorded data take.
        reward: ``"none"``; ``"score_gain"`` pays changes of the score, ``"sparse"`` the final score.
        target: the type of defect that targeted characterisation asks for, ``"vacancy"`` or ``"substitution"``; the world's commonest by default.
        overview: show the overview. Of a recipe it is made where one looks, which takes about as long as two or three tiles.
        phase_stride_px: phases are compared at every so many pixels.
        cache, threads, progress: as for :func:`stemworlds.build`; the first environment of a recipe fills its library, which takes minutes.
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
        #: What was done since the last reset, with it.
        self._done: list[Moves] = []
        self.render_mode = render_mode
        self.observation_space = cast("spaces.Space[Observation]", observation_space(self.field))
        self.action_space = cast("spaces.Space[Action]", action_space())
        self._seed: int | None = None
        self._number = 0
        self._seen: list[Acquired] = []
        self._last: Findings | None = None

    def __getstate__(self) -> dict[str, Any]:
        """What pickle and :func:`copy.deepcopy` take: options, and what was done in the episode."""
        state = dict(vars(self))
        del state["_episodes"]
        return state

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Makes the environment again, and does again what was done."""
        vars(self).update(state)
        self._episodes = Episodes(1, **self._made_of)
        for moves in self._done:
            self._episodes.step(moves)

    @property
    def field(self) -> FieldFacts:
        """What is known of the field before anything is looked at."""
        return self._episodes.field

    @property
    def recipe(self) -> Recipe | None:
        """The recipe of the world, of a file that of its build; ``None`` of recorded data and files of other programs."""
        return self._episodes.recipe

    def specimen(self) -> Recipe | None:
        """The recipe with the seed of the specimen of this episode: the truth, for agents that mark the ceiling of others."""
        return self._episodes.specimen(0)

    @property
    def episode_seed(self) -> tuple[int, int]:
        """Seed, and number of the episode under it."""
        return self._seed or 0, self._number

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Begins another episode. With a seed it is episode 0 of that seed; without, the next one."""
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
        """Takes the limit of a :class:`gymnasium.wrappers.TimeLimit` about this environment (``max_episode_steps`` makes one) for the horizon:
        the step that it cuts the episode at is then the last one here too, and pays."""
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
        """Does one thing. See the class for actions."""
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
        """The middle ``(x, y)`` of a tile in fractions of the field."""
        return self.field.centre_of(row, column)

    def declare(self, findings: Findings) -> Step:
        """A step that declares findings."""
        return self.step({"type": DECLARE, "report": findings})

    def acquire(self, row: int, column: int, zoom: float = 1.0, dose: float = 1.0) -> Step:
        """Two steps: goes to a tile, and acquires it. Returns what the last one did; rewards are added."""
        went = self.step({"type": NAVIGATE, "position": self.centre_of(row, column)})
        if went[2] or went[3]:
            return went
        seen, reward, terminated, truncated, info = self.step({"type": ACQUIRE, "zoom": zoom, "dose": dose})
        return seen, reward + went[1], terminated, truncated, info

    def truth_seen(self) -> Findings:
        """The truth of what was seen: for agents that mark the ceiling of others. It knows phases where it has looked only."""
        return self._episodes.truth_seen(0)

    def score(self) -> float:
        """The score of what was declared last, against what was seen so far."""
        return self._episodes.score(0)

    def record(self) -> dict[str, Any]:
        """What was done so far, and its scores: what results are made of."""
        return self._episodes.record(0)

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Which of the four types of actions are of use now."""
        record = self._episodes.record(0)
        going = record["ended"] is None
        fits = record["spent"] + 100.0 * DOSE[0] <= self.field.budget * (1 + 1e-9)
        return np.array([going, going and fits, going, going])

    def render(self) -> Any:
        """A picture (``rgb_array``) or a text (``ansi``) of overview, visited tiles, findings against the truth, and the dose curve."""
        scene = rendering.Scene(self._episodes, self._seen, self._last)
        if self.render_mode == "rgb_array":
            return rendering.picture(scene)
        if self.render_mode == "ansi":
            return rendering.text(scene)
        return None


def _caller(env: gym.Env[Any, Any]) -> Any:
    """The wrapper with a limit of steps that has called an environment, if one has: nothing else tells the environment of it."""
    frame = sys._getframe(1)
    while frame is not None:
        about = frame.f_locals.get("self") if frame.f_code.co_name == "reset" else None
        if isinstance(about, gym.wrappers.TimeLimit) and about.unwrapped is env:
            return about
        frame = frame.f_back  # type: ignore[assignment]
    return None
