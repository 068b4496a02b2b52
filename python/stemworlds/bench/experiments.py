"""Reads experiments from TOML files: agents, tasks and worlds."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import itertools
import json
import math
import os
import reprlib
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from ..errors import FileError, FileMissing, FormatError, InvalidValue, _invalid
from . import own_agents, registration
from .catalogue import agent_specification, unknown
from .episodes import ONE_FORM
from .field_truth import FIELD_TASKS

__all__ = ["Episode", "Experiment", "packaged_experiments", "read_experiment"]

#: Names of the tasks in experiments, and the names of their environments.
TASKS = {str(task): name for name, task in registration.TASKS.items()}
#: Tasks of an experiment or world that names none: the tasks of the STEMGym paper.
_USUAL_TASKS = [task for task in TASKS if task not in FIELD_TASKS]
_KEYS = {"name", "about", "tasks", "strict", "seeds", "budgets", "agents", "worlds", "environment"}
_WORLD_KEYS = {"name", "file", "recipe", "difficulty", "grid", "set", "live", "split", "tasks"}
#: Keys of agents that name files of networks.
_NETWORKS = (("analyst", "models"), ("policy", "model"))
#: Options of the environment that change no result.
OF_THE_MACHINE = {"cache", "threads"}
_OPTIONS = {"horizon", "cadence", "exposure", "noise", "damage", "target", "cache", "threads", "reward"}
#: Most steps that an acquisition needs, with its navigation and declaration.
_STEPS_A_TILE = 4
_REFERENCE_DOSE = 100.0
#: Most seeds, and most episodes. An experiment of this size takes years, but its list of episodes fits into memory.
_MOST_SEEDS, _MOST_EPISODES = 100_000, 1_000_000


@dataclass(frozen=True)
class Episode:
    """One combination of an experiment.

    Attributes:
        agent: table of the agent, see :func:`agent_specification`.
        task: a name of :data:`TASKS`, with the suffix ``-strict`` for a strict form.
        world: table of the world.
        seed, budget: seed of the episode, and its budget in electrons per square Angstrom.
        environment: further keywords of the environment.
    """

    agent: Mapping[str, Any]
    task: str
    world: Mapping[str, Any]
    seed: int
    budget: float
    environment: Mapping[str, Any]

    @property
    def key(self) -> str:
        """The key of the combination in files of results: 16 digits of a hash of all its values."""
        options = {key: value for key, value in self.environment.items() if key not in OF_THE_MACHINE}
        parts = [_agent_essence(self.agent), self.task, _essence(self.world), self.seed, float(self.budget), options]
        return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]

    @property
    def specimen(self) -> str:
        """A name of the specimen. Episodes with equal names may share its images."""
        return json.dumps([self.world, self.seed], sort_keys=True, default=str)

    @property
    def environment_id(self) -> str:
        task, strict = self.task.removesuffix("-strict"), self.task.endswith("-strict")
        return f"stemworlds/{TASKS[task]}{'Strict' if strict else ''}-v0"

    @property
    def environment_options(self) -> dict[str, Any]:
        """The keywords of :func:`gymnasium.make`."""
        given = {key: value for key, value in self.world.items() if key not in ("name", "file", "tasks")}
        if "file" in self.world:
            # A file cannot change its difficulty, which is only a label in the report.
            given = {"world": self.world["file"]}
        if "grid" in given:
            given["grid"] = tuple(given["grid"])
        horizon = max(200, _STEPS_A_TILE * math.ceil(self.budget / _REFERENCE_DOSE))
        return {"horizon": horizon, **given, **self.environment, "budget": float(self.budget)}


@dataclass(frozen=True)
class Experiment:
    """An experiment, read by :func:`read_experiment`. Iteration yields its episodes, grouped by world, and by seed within a world."""

    name: str
    about: str
    tasks: tuple[str, ...]
    seeds: tuple[int, ...]
    budgets: tuple[float, ...]
    agents: tuple[Mapping[str, Any], ...]
    worlds: tuple[Mapping[str, Any], ...]
    environment: Mapping[str, Any]

    def with_agents(self, agents: Iterable[Any]) -> Experiment:
        """Returns a copy with further agents: names, tables, or objects with a name and a method ``run``, for example an :class:`Agent`."""
        every = (*self.agents, *(agent_specification(agent) for agent in agents))
        _apart("agent", [agent["name"] for agent in every])
        return dataclasses.replace(self, agents=every)

    def __iter__(self) -> Iterator[Episode]:
        for world in self.worlds:
            tasks = [task for task in self.tasks if task.removesuffix("-strict") in world.get("tasks", TASKS)]
            for seed, budget, agent, task in itertools.product(self.seeds, self.budgets, self.agents, tasks):
                yield Episode(agent, task, world, seed, budget, self.environment)


def packaged_experiments() -> dict[str, str]:
    """Returns the names of the experiments in the package, and the purpose of each."""
    return {name: read_experiment(name).about for name in _packaged()}


def _packaged() -> dict[str, str]:
    folder = resources.files(__package__) / "experiments"
    files = sorted((entry for entry in folder.iterdir() if entry.name.endswith(".toml")), key=lambda entry: entry.name)
    return {entry.name.removesuffix(".toml"): entry.read_text(encoding="utf-8") for entry in files}


def read_experiment(source: str | os.PathLike[str]) -> Experiment:
    """Reads the TOML file of an experiment, or an experiment of the package by its name. Paths of worlds are relative to the file.

    Raises:
        FileMissing: if there is neither a file nor an experiment of that name.
        FileError: if the file cannot be read.
        FormatError: if the file is no TOML.
        InvalidValue: for unknown keys, agents, tasks and worlds.
    """
    path = Path(source)
    packaged = _packaged()
    if not path.is_file():
        if str(source) not in packaged:
            raise FileMissing(f"{source}: no such file, and no experiment of the package: {', '.join(packaged)}")
        text, folder = packaged[str(source)], Path()
    else:
        try:
            text, folder = path.read_text(encoding="utf-8"), path.parent
        except UnicodeDecodeError as error:
            raise FormatError(f"{source}: not TOML: its bytes are no text in UTF-8") from error
        except OSError as error:
            raise FileError(f"{source}: cannot be read: {error.strerror}") from error
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FormatError(f"{source}: not TOML: {error}") from error
    except RecursionError:
        raise FormatError(f"{source}: not TOML of an experiment: its tables or lists are nested too deeply") from None
    try:
        return _experiment(table, folder, path.stem)
    except InvalidValue as error:
        raise InvalidValue(f"{source}: {error}") from error


def _experiment(table: Mapping[str, Any], folder: Path, stem: str) -> Experiment:
    _known("experiment", table, _KEYS)
    tasks = [_task(name) for name in _listed(table, "tasks", list(_USUAL_TASKS))]
    strict = table.get("strict", False)
    if not isinstance(strict, bool):
        raise _invalid("strict", f"strict = {strict!r}: expected true or false")
    single = [task for task in tasks if task in ONE_FORM]
    if strict and single:
        raise _invalid("strict", f"strict = true: {single[0]} has one form, which asks for seeing; put it into another experiment")
    options = table.get("environment", {})
    _known("environment", options, _OPTIONS)
    agents = [_located(agent_specification(given, str(folder.resolve())), folder) for given in _listed(table, "agents", None)]
    worlds = [_world(given, folder) for given in _listed(table, "worlds", None)]
    for kind, names in (("agent", [agent["name"] for agent in agents]), ("world", [world["name"] for world in worlds])):
        _apart(kind, names)
    for key in ("name", "about"):
        _text(key, table.get(key, ""))
    made = Experiment(
        name=table.get("name", stem),
        about=table.get("about", ""),
        tasks=tuple(f"{task}-strict" if strict else task for task in tasks),
        seeds=_seeds(table.get("seeds", 10)),
        budgets=tuple(_budget(value) for value in _listed(table, "budgets", [5000.0])),
        agents=tuple(agents),
        worlds=tuple(worlds),
        environment=dict(options),
    )
    most = len(made.worlds) * len(made.seeds) * len(made.budgets) * len(made.agents) * len(made.tasks)
    if most > _MOST_EPISODES:
        raise _invalid("seeds", f"{most} episodes: expected {_MOST_EPISODES} at most; take fewer seeds, or several experiments")
    return made


def _apart(kind: str, names: list[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise _invalid(f"{kind}s", f"{kind} {twice[0]!r} is there twice: give each a name of its own")


def _text(key: str, given: Any) -> str:
    if not isinstance(given, str):
        raise _invalid(key, f"{key} = {reprlib.repr(given)}: expected a text")
    return given


def _listed(table: Mapping[str, Any], key: str, default: list[Any] | None) -> list[Any]:
    given = table.get(key, default)
    if not isinstance(given, list) or not given:
        raise _invalid(key, f"{key}: expected a list with one entry or more")
    return given


def _known(where: str, table: Any, keys: set[str]) -> None:
    if not isinstance(table, Mapping):
        raise _invalid(where, f"{where}: expected a table")
    for key in table:
        if key not in keys:
            raise _invalid(where, f"{where}: key {key!r}: {unknown(key, keys)}")


def _task(name: Any) -> str:
    if not isinstance(name, str) or name not in TASKS:
        raise _invalid("tasks", f"task {reprlib.repr(name)}: {unknown(str(name), TASKS)}")
    return name


def _seeds(given: Any) -> tuple[int, ...]:
    """Checks the seeds: a list of seeds, or the number of seeds, which then begin at 0."""
    counted = isinstance(given, int) and not isinstance(given, bool)
    if counted and not 0 < given <= _MOST_SEEDS or isinstance(given, list) and len(given) > _MOST_SEEDS:
        raise _invalid("seeds", f"seeds = {reprlib.repr(given)}: expected 1 to {_MOST_SEEDS} of them")
    seeds = list(range(given)) if counted else given
    good = isinstance(seeds, list) and seeds and all(isinstance(s, int) and not isinstance(s, bool) and 0 <= s < 2**32 for s in seeds)
    if not good or len(set(seeds)) < len(seeds):
        raise _invalid("seeds", f"seeds = {reprlib.repr(given)}: expected their number, or a list of different whole numbers from 0 on")
    return tuple(seeds)


def _budget(given: Any) -> float:
    number = isinstance(given, int | float) and not isinstance(given, bool)
    if not number or not 0 < given <= sys.float_info.max:
        raise _invalid("budgets", f"budget {reprlib.repr(given)}: expected electrons per square Angstrom, above 0")
    return float(given)


def _world(given: Any, folder: Path) -> dict[str, Any]:
    """Returns the complete, checked table of a world from the path of a file, or from a table with ``file`` or ``recipe``."""
    table = {"file": given} if isinstance(given, str) else given
    _known("worlds", table, _WORLD_KEYS)
    if ("file" in table) == ("recipe" in table):
        raise _invalid("worlds", f"world {reprlib.repr(dict(table))}: expected either file or recipe")
    for key in ("name", "file", "recipe", "difficulty", "split"):
        if key in table:
            _text(f"{key} of a world", table[key])
    for key, kind, expected in (("live", bool, "true or false"), ("set", dict, "a table"), ("tasks", list, "a list of tasks"), ("grid", list, "rows and columns")):
        if not isinstance(table.get(key, kind()), kind):
            raise _invalid("worlds", f"{key} of a world = {reprlib.repr(table[key])}: expected {expected}")
    grid = table.get("grid", [1, 1])
    if len(grid) != 2 or not all(isinstance(n, int) and not isinstance(n, bool) and 0 < n < 2**31 for n in grid):
        raise _invalid("worlds", f"grid of a world = {reprlib.repr(grid)}: expected rows and columns, as [4, 4]")
    for task in table.get("tasks", []):
        _task(task)
    made = dict(table)
    if "file" in table:
        path = folder / table["file"]
        if not _is_file(path):
            raise _invalid("worlds", f"world {table['file']!r}: there is no such file in {folder.resolve()}")
        made["file"] = str(path)
        made.setdefault("name", path.stem)
        return made
    if _is_file(folder / table["recipe"]):
        made["recipe"] = str(folder / table["recipe"])
    made.setdefault("name", "-".join([Path(table["recipe"]).stem, *([table["difficulty"]] if "difficulty" in table else [])]))
    made.setdefault("live", True)
    if made["live"]:
        made.setdefault("split", "test")
    return made


def _is_file(path: Path) -> bool:
    """Returns whether a path is a file. A text that is no valid path gives false, not an error."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _located(agent: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Returns an agent with the paths of its networks made relative to the folder of the experiment."""

    def at(path: Any) -> Any:
        return [at(one) for one in path] if isinstance(path, list) else str(folder / str(path))

    for part, key in _NETWORKS:
        if key in agent.get(part, {}):
            agent = {**agent, part: {**agent[part], key: at(agent[part][key])}}
    return agent


def _agent_essence(agent: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the identity of an agent. It contains the contents of networks instead of their paths."""
    if "python" in agent or "pickle" in agent:
        return own_agents.essence(agent)
    kept = dict(agent)
    for part, key in _NETWORKS:
        if key in kept.get(part, {}):
            given = kept[part][key]
            kept[part] = {**kept[part], key: [_contents(path) for path in (given if isinstance(given, list) else [given])]}
    return kept


def _contents(path: str) -> str:
    """Returns a hash of the contents of a file."""
    try:
        about = os.stat(path)
    except OSError:
        return f"{Path(path).name}, missing"
    return _digest(path, about.st_size, about.st_mtime_ns)


@functools.lru_cache(maxsize=64)
def _digest(path: str, _size: int, _changed_ns: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def _essence(world: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the identity of a world. It contains the name and size of a world file, or a hash of a recipe file, without their folders."""
    kept = {key: value for key, value in world.items() if key != "tasks"}
    if "file" in world:
        path = Path(world["file"])
        kept["file"] = [path.name, path.stat().st_size if path.exists() else 0]
    elif Path(world["recipe"]).is_file():
        kept["recipe"] = _contents(world["recipe"])
    return kept
