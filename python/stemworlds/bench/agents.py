"""Agents: a navigator, an analyst and an optional planner that play an episode together."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..errors import _invalid
from .episodes import DONE
from .findings import Findings
from .protocols import Analyst, Look, Navigator, Planner, Seen
from .reconstruction import reconstructed

if TYPE_CHECKING:
    import gymnasium as gym

__all__ = ["Agent", "CompressedSensing", "Plays", "play", "random_of"]

#: Electrons per square Angstrom of an acquisition with zoom 1 and dose 1.
_REFERENCE_DOSE = 100.0
#: Number of steps that an acquisition and its declaration need.
_ROUND = 3


class Plays(Protocol):
    """An agent that :func:`play` accepts: an :class:`Agent`, or any object with a name and a method ``run``."""

    name: str

    def run(self, env: gym.Env[Any, Any], seed: int) -> dict[str, Any]:
        """Plays one episode. Returns entries that are added to the environment's record; the key ``record`` replaces that record."""


def random_of(seed: int, name: str) -> np.random.Generator:
    """Returns the random generator of an agent in an episode."""
    return np.random.default_rng([seed, int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")])


def play(env: gym.Env[Any, Any], agent: Plays, seed: int) -> dict[str, Any]:
    """Plays one episode.

    Returns:
        The record of the environment, with ``agent``, ``grid`` (rows and columns of tiles), ``notes`` (numbers from analyst and
        planner), ``modes`` (the plan of each acquisition) and ``wall`` (``seconds``, ``seconds_per_tile``). Another run with the same
        seed gives an identical record except for ``wall``.
    """
    began = time.perf_counter()
    more = agent.run(env, seed)
    seconds = time.perf_counter() - began
    world: Any = env.unwrapped
    record: dict[str, Any] = dict(more.pop("record", None) or world.record())
    record["grid"] = list(world.field.grid)
    tiles = len(record["acquisitions"])
    record.update({"agent": agent.name, "notes": {}, "modes": [], **more})
    record["wall"] = {"seconds": seconds, "seconds_per_tile": seconds / max(tiles, 1)}
    return record


class Agent:
    """A navigator and an analyst, and optionally a planner.

    Args:
        name: name of the agent in tables. It also seeds the agent's random numbers.
        declare_every: acquisitions from one declaration to the next. The agent also declares at the end. By default, the environment
            records a score every fifth acquisition.
    """

    def __init__(
        self, name: str, navigator: Navigator, analyst: Analyst, planner: Planner | None = None, *, declare_every: int = 5
    ) -> None:
        if declare_every < 1:
            raise _invalid("declare_every", f"declare_every = {declare_every}: expected 1 or more")
        for keyword, part, kind in (("navigator", navigator, Navigator), ("analyst", analyst, Analyst)):
            if not isinstance(part, kind):
                raise _invalid(keyword, f"{part!r} has not the methods of {kind.__name__}")
        self.name: str = name
        self.navigator: Navigator = navigator
        self.analyst: Analyst = analyst
        self.planner: Planner | None = planner
        self.declare_every: int = declare_every

    def __repr__(self) -> str:
        return f"Agent({self.name!r})"

    def run(self, env: gym.Env[Any, Any], seed: int) -> dict[str, Any]:
        """Plays one episode; see :func:`play`."""
        _, info = env.reset(seed=seed)
        world: Any = env.unwrapped
        episode = _Episode(world, info)
        seen = Seen(world.field)
        self._start(world, seen, seed)
        modes = []
        while not episode.over:
            seen.dose_left = episode.dose_left()
            if self.planner is not None:
                seen.plan = self.planner.plan(seen)
                if seen.plan.end:
                    break
            look = self.navigator.choose(seen)
            if look is None or not episode.has_room_for(look):
                break
            if not episode.acquire(look, seen):
                break
            modes.append("" if seen.plan is None else seen.plan.mode)
            seen.findings = self.analyst.findings(seen.tiles)
            episode.undeclared = seen.findings
            if len(seen.tiles) % self.declare_every == 0:
                episode.declare()
        if not episode.over:
            word = self.last_word(seen)
            if word is not seen.findings:
                episode.undeclared = word
            episode.finish()
        return {"notes": self._notes(), "modes": modes if any(modes) else [], "record": episode.record()}

    def last_word(self, seen: Seen) -> Findings | None:
        """Returns the findings to declare at the end of an episode; ``None`` for the analyst's latest findings."""
        return seen.findings

    def _start(self, world: Any, seen: Seen, seed: int) -> None:
        random = random_of(seed, self.name)
        parts: list[Any] = [self.navigator, self.analyst, *([] if self.planner is None else [self.planner])]
        for part in parts:
            if hasattr(part, "attach"):
                part.attach(world)
            part.start(world.field, random)
        seen.uncertainty_of = getattr(self.analyst, "uncertainty", None)
        seen.counts_of = getattr(self.analyst, "tile_counts", None)

    def _notes(self) -> dict[str, float]:
        notes: dict[str, float] = {}
        for part in (self.analyst, self.planner):
            tell = getattr(part, "notes", None)
            if tell is not None:
                notes.update(tell())
        return notes


class CompressedSensing(Agent):
    """Acquires a random mask of tiles. At the end it fills in the other tiles, and passes them to a second analyst.

    Args:
        second: the analyst of the filled-in tiles. It is a separate object, since acquired and filled-in tiles differ in intensity.
            ``None`` for analysts that know the truth.
    """

    def __init__(self, name: str, navigator: Navigator, analyst: Analyst, second: Analyst | None, *, declare_every: int = 5) -> None:
        super().__init__(name, navigator, analyst, declare_every=declare_every)
        if second is analyst:
            raise _invalid("second", "the analyst of the tiles that were filled in has to be another one than that of the acquired")
        self.second: Analyst | None = second

    def _start(self, world: Any, seen: Seen, seed: int) -> None:
        super()._start(world, seen, seed)
        if self.second is not None:
            self.second.start(world.field, random_of(seed, self.name + " second"))

    def last_word(self, seen: Seen) -> Findings | None:
        if self.second is None or seen.findings is None:
            return seen.findings
        return _merged(seen.findings, self.second.findings(reconstructed(seen.field, seen.tiles)))


class _Episode:
    """An episode in progress: its steps, and the findings that are not declared yet."""

    def __init__(self, world: Any, info: Mapping[str, Any]) -> None:
        self._world, self._info = world, info
        self._steps, self._steps_left = 0, float("inf")
        self.over = False
        self.undeclared: Findings | None = None

    def record(self) -> dict[str, Any] | None:
        """Returns the record of the episode from the last step; ``None`` if the episode is not over."""
        return self._info.get("record")

    def dose_left(self) -> float:
        return 1 - float(self._info["dose_spent"]) / float(self._info["budget"])

    def has_room_for(self, look: Look) -> bool:
        """Returns whether budget and horizon allow the acquisition and its declaration."""
        cost = _REFERENCE_DOSE * look.dose * look.zoom**2
        budget = float(self._info["budget"])
        return float(self._info["dose_spent"]) + cost <= budget * (1 + 1e-9) and self._steps_left >= _ROUND

    def acquire(self, look: Look, seen: Seen) -> bool:
        """Acquires a tile and adds it to ``seen``. Returns whether the tile was acquired."""
        self._took(self._world.acquire(look.row, look.column, zoom=look.zoom, dose=look.dose), 2)
        if "acquired" not in self._info:
            return False
        seen.tiles.append(self._info["acquired"])
        return True

    def declare(self) -> None:
        if self.undeclared is not None and not self.over:
            self._took(self._world.declare(self.undeclared), 1)
            self.undeclared = None

    def finish(self) -> None:
        self.declare()
        if not self.over:
            self._took(self._world.step({"type": DONE}), 1)

    def _took(self, returned: tuple[Any, ...], steps: int) -> None:
        observation, _, terminated, truncated, self._info = returned
        self.over = bool(terminated or truncated)
        self._steps += steps
        share = float(np.asarray(observation["step_fraction"]).ravel()[0])
        if share > 0:
            self._steps_left = round(self._steps * (1 - share) / share)


def _merged(first: Findings, second: Findings) -> Findings:
    """Merges two findings. Phases of the first come before phases of the second. Columns come from the first alone, since only acquired
    tiles have scores by column."""
    defects = dict(first.defects or {})
    for kind, places in (second.defects or {}).items():
        defects[kind] = np.concatenate([defects[kind], places]) if kind in defects else places
    phases = first.phases if second.phases is None else second.phases
    if first.phases is not None and second.phases is not None:
        phases = np.where(first.phases >= 0, first.phases, second.phases)
    return Findings(
        counts=None,
        defects=defects,
        phases=phases,
        particles=np.concatenate([_rows(first.particles), _rows(second.particles)]),
        morphologies=[*(first.morphologies or []), *(second.morphologies or [])],
        columns=_rows(first.columns),
    )


def _rows(table: Any) -> Any:
    return np.zeros((0, 3)) if table is None else np.asarray(table, dtype=np.float64).reshape(-1, 3)
