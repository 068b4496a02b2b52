"""Estimates the duration of an experiment from the times of finished episodes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .experiments import Episode, Experiment
from .progress import in_words
from .results import Row, _rows
from .runner import _processors

_REFERENCE_BUDGET = 5000.0


@dataclass(frozen=True)
class TimeLeft:
    """The rest of an experiment.

    Attributes:
        left: number of episodes that are not in the file of results.
        seconds: estimated duration with all processes busy; ``None`` if the file contains no episode of the remaining agents.
        guessed: agents without an episode in the file. They get the mean time of the others.
    """

    left: int
    seconds: float | None
    guessed: tuple[str, ...]

    def __str__(self) -> str:
        if not self.left:
            return "all are there"
        if self.seconds is None:
            return f"{self.left} are left; how long they take is known when one episode of each agent was played (seeds = 1 in a copy of the experiment)"
        unknown = f" ({', '.join(self.guessed)}: taken for as slow as the others)" if self.guessed else ""
        return f"{self.left} are left, about {in_words(self.seconds)} by the times of those that are there{unknown}; libraries that have to be made come on top"


def forecast_of_time(experiment: Experiment, out: str | os.PathLike[str], processes: int | None) -> TimeLeft:
    """Counts the remaining episodes, and estimates their time.

    The estimate for an episode is the median time of its agent in its task and world, or of its agent in all of them, in proportion to the
    budget.
    """
    rows = [row for row in _rows(Path(out)) if "error" not in row] if Path(out).is_file() else []
    known = {row["key"] for row in rows}
    left = [episode for episode in experiment if episode.key not in known]
    times = _times(rows)
    agents = {episode.agent["name"] for episode in left}
    guessed = tuple(sorted(agent for agent in agents if (agent,) not in times))
    if not left or guessed == tuple(sorted(agents)):
        return TimeLeft(len(left), 0.0 if not left else None, guessed if left else ())
    usual = float(np.mean([times[agent,] for agent in agents if (agent,) in times]))
    total = sum(_of(episode, times, usual) * episode.budget / _REFERENCE_BUDGET for episode in left)
    return TimeLeft(len(left), total / min(processes or _processors(), len(left)), guessed)


def _times(rows: list[Row]) -> Mapping[tuple[str, ...], float]:
    """Returns the median seconds of an episode at the reference budget, by agent, and by agent, task and world."""
    found: dict[tuple[str, ...], list[float]] = {}
    for row in rows:
        if row.get("wall"):
            seconds = float(row["wall"]["seconds"]) * _REFERENCE_BUDGET / float(row["budget"])
            for key in ((row["agent"],), (row["agent"], row["task"], row["world"])):
                found.setdefault(key, []).append(seconds)
    return {key: float(np.median(values)) for key, values in found.items()}


def _of(episode: Episode, times: Mapping[tuple[str, ...], float], usual: float) -> float:
    agent = episode.agent["name"]
    return times.get((agent, episode.task, episode.world["name"]), times.get((agent,), usual))
