"""Wrappers for reinforcement-learning libraries, which do not accept dicts of actions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from .environment import MicroscopeEnv, Observation, Step
from .episodes import ACQUIRE, DONE, Acquired
from .findings import Findings

#: Returns the findings in all tiles acquired so far.
Analyse = Callable[[Sequence[Acquired]], Findings]

#: Zooms, and doses in units of the reference dose, that :class:`GridChoice` offers.
ZOOMS = (1.0, 2.0, 4.0)
DOSES = (0.5, 1.0, 2.0)


def _nothing(seen: Sequence[Acquired]) -> Findings:
    return Findings()


class _Deciding(gym.Wrapper[Observation, Any, Observation, Any], RecordConstructorArgs):
    """An environment in which the agent chooses the places, and an analyst declares its findings after every ``declare_every``
    acquisitions.

    ``analyst`` is a function of all tiles acquired in the episode, or an object with the method ``analyse``.
    """

    #: One step of the agent consists of several steps of the environment.
    several_steps = True

    def __init__(self, env: gym.Env[Any, Any], analyst: Any, declare_every: int, **others: Any) -> None:
        # Gymnasium needs the recorded arguments to make the environment again from its specification.
        RecordConstructorArgs.__init__(self, analyst=analyst, declare_every=declare_every, **others)
        gym.Wrapper.__init__(self, env)
        self._analyst = analyst
        self._analyse: Analyse = _nothing if analyst is None else getattr(analyst, "analyse", analyst)
        self._every = declare_every
        self._seen: list[Acquired] = []

    @property
    def microscope(self) -> MicroscopeEnv:
        """The wrapped environment."""
        inside = self.unwrapped
        assert isinstance(inside, MicroscopeEnv)
        return inside

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Begins another episode. Calls the analyst's method ``reset``, if it has one."""
        self._seen.clear()
        out = super().reset(seed=seed, options=options)
        tell = getattr(self._analyst, "reset", None)
        if tell is not None:
            tell(self.microscope.field)
        return out

    def _do(self, action: dict[str, Any]) -> Step:
        """Executes one step of the wrapped environment."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        return seen, float(reward), terminated, truncated, info

    def _acquire(self, position: npt.ArrayLike, zoom: float = 1.0, dose: float = 1.0) -> Step:
        """Moves to a place, acquires a tile, and declares if a declaration is due."""
        went = self._do({"type": 0, "position": np.asarray(position, dtype=np.float32)})
        if went[2] or went[3]:
            return went
        out = self._do({"type": ACQUIRE, "zoom": zoom, "dose": dose})
        rewards = float(went[1]) + float(out[1])
        what = out[4].get("acquired")
        if what is not None:
            self._seen.append(what)
            if not (out[2] or out[3]) and len(self._seen) % self._every == 0:
                said = self.microscope.declare(self._analyse(self._seen))
                info = {**said[4], "acquired": what}
                return said[0], rewards + said[1], said[2], said[3], info
        return out[0], rewards, out[2], out[3], out[4]


class DiscreteGrid(_Deciding):
    """The STEMGym paper's 192 actions: moving, acquiring, or ending the episode, for each of 8 x 8 cells.

    An action is ``3 * cell + what``. ``what`` = 0 moves to the centre of the cell, 1 acquires there and declares the analyst's findings, 2
    ends the episode.

    Args:
        env: a :class:`MicroscopeEnv`, wrapped or not.
        analyst: function of all acquired tiles that returns :class:`Findings`, or an object with this function as its method ``analyse``.
        cells: cells along each axis.
        declare_every: acquisitions from one declaration to the next.
    """

    def __init__(self, env: gym.Env[Any, Any], analyst: Any = None, cells: int = 8, declare_every: int = 1) -> None:
        super().__init__(env, analyst, declare_every, cells=cells)
        self._cells = cells
        self.action_space = spaces.Discrete(3 * cells * cells)

    def _centre(self, cell: int) -> npt.NDArray[np.float32]:
        row, column = divmod(cell, self._cells)
        return np.array([(column + 0.5) / self._cells, (row + 0.5) / self._cells], dtype=np.float32)

    def step(self, action: Any) -> Step:
        """Executes one of the actions."""
        cell, what = divmod(int(action), 3)
        if what == 2:
            return self._do({"type": DONE})
        if what == 1:
            return self._acquire(self._centre(cell))
        return self._do({"type": 0, "position": self._centre(cell)})

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Returns a mask of the useful actions for MaskablePPO. Each cell is acquired once."""
        go, acquire, _, end = self.microscope.action_masks()
        fits = self.microscope.field.budget - self.microscope.record()["spent"] >= 100.0
        visited = {tuple(self._cell_of(what)) for what in self._seen}
        cells = [divmod(cell, self._cells) for cell in range(self._cells**2)]
        free = np.array([cell not in visited for cell in cells])
        return np.stack([np.full(len(cells), go), free & acquire & fits, np.full(len(cells), end)], axis=1).reshape(-1)

    def _cell_of(self, what: Acquired) -> tuple[int, int]:
        height, width = self.microscope.field.size_nm
        x, y = what.centre_nm
        return min(int(y / height * self._cells), self._cells - 1), min(int(x / width * self._cells), self._cells - 1)


class TargetBox(_Deciding):
    """The STEMGym paper's continuous actions: acquires at a place in ``[0, 1]^2``, and declares the analyst's findings.

    Args:
        env, analyst, declare_every: see :class:`DiscreteGrid`.
    """

    def __init__(self, env: gym.Env[Any, Any], analyst: Any = None, declare_every: int = 1) -> None:
        super().__init__(env, analyst, declare_every)
        self.action_space = spaces.Box(0.0, 1.0, (2,), np.float32)

    def step(self, action: npt.ArrayLike) -> Step:
        """Acquires at a place (x, y in fractions of the field)."""
        return self._acquire(np.clip(np.asarray(action, dtype=np.float64), 0.0, 1.0))


class GridChoice(_Deciding):
    """``MultiDiscrete`` actions: row and column of a grid of places, and indices into :data:`ZOOMS` and :data:`DOSES`.

    Args:
        env, analyst, cells, declare_every: see :class:`DiscreteGrid`.
    """

    def __init__(self, env: gym.Env[Any, Any], analyst: Any = None, cells: int = 8, declare_every: int = 1) -> None:
        super().__init__(env, analyst, declare_every, cells=cells)
        self._cells = cells
        self.action_space = spaces.MultiDiscrete([cells, cells, len(ZOOMS), len(DOSES)])

    def step(self, action: npt.ArrayLike) -> Step:
        """Acquires at a place, with a zoom and a dose."""
        row, column, zoom, dose = (int(v) for v in np.asarray(action).reshape(4))
        place = [(column + 0.5) / self._cells, (row + 0.5) / self._cells]
        return self._acquire(place, ZOOMS[zoom], DOSES[dose])


class ByteImages(gym.ObservationWrapper[Observation, Any, Observation], RecordConstructorArgs):
    """Converts tile and overview to uint8 with one channel, ``(rows, columns, 1)``, the image format of convolutional policies."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        inside = env.observation_space
        assert isinstance(inside, spaces.Dict)
        kept = dict(inside.spaces)
        for name in ("tile", "overview"):
            kept[name] = spaces.Box(0, 255, (*(kept[name].shape or ()), 1), np.uint8)
        self.observation_space = cast("spaces.Space[Observation]", spaces.Dict(kept))

    def observation(self, observation: Observation) -> Observation:
        """Returns the observation with images as bytes."""
        out = dict(observation)
        for name in ("tile", "overview"):
            out[name] = np.round(255 * out[name][..., None]).astype(np.uint8)
        return out
