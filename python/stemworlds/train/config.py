"""Reads configs of trainings from TOML. This module contains all defaults."""

from __future__ import annotations

import dataclasses
import os
import reprlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from ..bench.catalogue import unknown
from ..errors import FileMissing, FormatError, _invalid
from ..recipes import Recipe

__all__ = ["Config", "packaged_configs", "read_config"]

#: Names of the profiles of recordings, see docs/acquisition.md.
PROFILES = ("ideal", "routine", "poor")
_RECIPE_KEYS = {"recipe", "difficulty", "weight", "set", "grid"}
_Table = TypeVar("_Table")


@dataclass(frozen=True)
class StreamTable:
    """``[stream]``: the tiles.

    Attributes:
        recipes: names ``"srtio3:easy"``, or tables ``{recipe, difficulty, weight, set, grid}``. Paths are relative to the config.
        size: edge of a tile in pixels, a multiple of 16.
        pixel_nm: range of the edge of a pixel, with a uniform distribution of the logarithm.
        dose: range of the dose in electrons per square Angstrom, with a uniform distribution of the logarithm.
        profiles: weights of the profiles with which tiles are recorded.
        seed: seed of all tiles. Specimens have even seeds, as in the benchmark's training split.
        samples_per_specimen: number of tiles of a specimen, after which a new specimen of the recipe is laid out; 0 for one specimen.
        repeats: number of steps that use the same noise-free tiles. Doses, noise, profiles, rotations and reflections are drawn for each
            step.
    """

    recipes: tuple[Any, ...] = tuple(f"{material}:{tier}" for material in ("srtio3", "batio3", "sige", "gan") for tier in ("easy", "medium", "hard"))
    size: int = 128
    pixel_nm: tuple[float, float] = (0.0105, 0.034)
    dose: tuple[float, float] = (3e2, 1e6)
    profiles: Mapping[str, float] = field(default_factory=lambda: {"ideal": 0.7, "routine": 0.2, "poor": 0.1})
    seed: int = 2
    samples_per_specimen: int = 0
    repeats: int = 2


@dataclass(frozen=True)
class NetworkTable:
    """``[network]``: the size of the network.

    Attributes:
        channels: number of channels of each level. The first level has half of the tile's pixels along an edge, each further level half of
            the level before.
        blocks: number of residual blocks of each level on the way down. On the way up, each level except the last has as many again.
    """

    channels: tuple[int, ...] = (24, 48, 96, 128)
    blocks: tuple[int, ...] = (1, 1, 1, 1)


@dataclass(frozen=True)
class OptimiserTable:
    """``[optimiser]``: AdamW with one cycle of the learning rate.

    Attributes:
        steps: total number of steps. The cycle ends with the last step, so the number changes the result.
        batch: number of tiles in a step.
        rate: greatest learning rate.
        weight_decay: weight decay of AdamW.
        warm_up: share of the steps in which the learning rate rises. Then it falls as a cosine.
        clip: greatest norm of the gradient of a step.
        average: share of the averaged weights that is kept in a step.
        members: number of networks in the ensemble. They are trained on identical tiles, from different initial weights.
        seed: seed of weights, doses and noise.
    """

    steps: int = 30_000
    batch: int = 32
    rate: float = 1e-3
    weight_decay: float = 0.01
    warm_up: float = 0.1
    clip: float = 1.0
    average: float = 0.999
    members: int = 3
    seed: int = 1


@dataclass(frozen=True)
class RunTable:
    """``[run]``: settings that change results in the last digits at most.

    Attributes:
        processes: number of processes that make tiles; 0 makes them in the training process, -1 starts one less than there are processors.
        device: ``"auto"`` (a GPU if there is one), ``"cpu"``, ``"cuda"``.
        graph: on a GPU, record a step as a CUDA graph, and replay it.
        checkpoint_every: number of steps from one checkpoint to the next. A kill loses the steps after the last checkpoint.
        log_every: number of steps from one line of the log to the next.
    """

    processes: int = -1
    device: str = "auto"
    graph: bool = True
    checkpoint_every: int = 500
    log_every: int = 50


@dataclass(frozen=True)
class Config:
    """The complete, checked config of a training.

    Attributes:
        stream, network, optimiser, run: the tables of the file.
        folder: folder to which paths of recipes are relative.
    """

    stream: StreamTable = field(default_factory=StreamTable)
    network: NetworkTable = field(default_factory=NetworkTable)
    optimiser: OptimiserTable = field(default_factory=OptimiserTable)
    run: RunTable = field(default_factory=RunTable)
    folder: str = "."

    def __post_init__(self) -> None:
        _check(self)

    def recipes(self) -> list[tuple[Recipe, float]]:
        """Returns the recipes, with even seeds, and their weights."""
        return [_recipe(given, self.folder, self.stream.seed) for given in self.stream.recipes]

    def essence(self) -> dict[str, Any]:
        """Returns all values that determine the result, for checkpoints and models: the tables without ``[run]``, with complete recipes."""
        stream = {**dataclasses.asdict(self.stream), "recipes": [[recipe.toml, weight] for recipe, weight in self.recipes()]}
        return {"stream": stream, "network": dataclasses.asdict(self.network), "optimiser": dataclasses.asdict(self.optimiser)}


def packaged_configs() -> dict[str, str]:
    """Returns the names and the texts of the shipped configs."""
    folder = resources.files(__package__) / "configs"
    return {entry.name.removesuffix(".toml"): entry.read_text(encoding="utf-8") for entry in folder.iterdir() if entry.name.endswith(".toml")}


def read_config(source: str | os.PathLike[str]) -> Config:
    """Reads a config from a TOML file, or a shipped config by its name.

    Raises:
        FileMissing: if there is neither a file nor a config of this name.
        FormatError: if the file is no TOML.
        InvalidValue: for unknown keys, values of a wrong type, values out of their limits, and invalid recipes.
    """
    path, packaged = Path(source), packaged_configs()
    if path.is_file():
        text, folder = path.read_text(encoding="utf-8"), str(path.parent)
    elif str(source) in packaged:
        text, folder = packaged[str(source)], "."
    else:
        raise FileMissing(f"{source}: there is no such file, and no config of that name; those of the package are {', '.join(sorted(packaged))}")
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FormatError(f"{source}: no TOML: {error}") from error
    kinds = {"stream": StreamTable, "network": NetworkTable, "optimiser": OptimiserTable, "run": RunTable}
    for name in tables:
        if name not in kinds:
            raise _invalid("config", f"{source}: table [{name}]: {unknown(name, kinds)}")
    made: dict[str, Any] = {name: _table(str(source), name, kind, tables.get(name, {})) for name, kind in kinds.items()}
    return Config(**made, folder=folder)


def _table(source: str, name: str, kind: type[_Table], given: Any) -> _Table:
    if not isinstance(given, Mapping):
        raise _invalid("config", f"{source}: {name} = {reprlib.repr(given)}: expected a table [{name}]")
    types = get_type_hints(kind)
    for key in given:
        if key not in types:
            raise _invalid("config", f"{source}: [{name}] {key}: {unknown(key, types)}")
    return kind(**{key: _value(f"{source}: [{name}] {key}", types[key], value) for key, value in given.items()})


def _value(where: str, kind: Any, value: Any) -> Any:
    """Converts a value of TOML to the type of its field."""
    if get_origin(kind) is tuple:
        items = get_args(kind)
        if isinstance(value, list) and (items[-1] is Ellipsis or len(value) == len(items)):
            return tuple(_value(where, items[0], item) for item in value)
        raise _invalid("config", f"{where} = {reprlib.repr(value)}: expected a list of {'some' if items[-1] is Ellipsis else len(items)} values")
    if get_origin(kind) is not None:
        if isinstance(value, Mapping):
            return {str(key): _value(where, float, item) for key, item in value.items()}
        raise _invalid("config", f"{where} = {reprlib.repr(value)}: expected a table of numbers")
    if kind is Any:
        return value
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise _invalid("config", f"{where} = {reprlib.repr(value)}: expected a value of type {kind.__name__}")
    return value


def _check(config: Config) -> None:
    stream, network, optimiser, run = config.stream, config.network, config.optimiser, config.run
    depth = len(network.channels)
    rising = (("pixel_nm", stream.pixel_nm), ("dose", stream.dose))
    faults = [
        (not stream.recipes, "recipes: there is none"),
        (stream.size < 16 or stream.size % 2**depth > 0, f"size = {stream.size}: expected a multiple of {2**depth} (two for each level), 16 at least"),
        *((not 0 < low <= high, f"{key} = {low}, {high}: expected numbers above 0, the lower first") for key, (low, high) in rising),
        (set(stream.profiles) - set(PROFILES) != set(), f"profiles: {', '.join(stream.profiles)}: known are {', '.join(PROFILES)}"),
        (min(stream.profiles.values(), default=0) < 0 or not sum(stream.profiles.values()) > 0, "profiles: expected weights, not all 0"),
        (stream.seed < 0 or stream.seed % 2 == 1, f"seed = {stream.seed} of [stream]: expected an even number; odd ones are for tests"),
        (stream.samples_per_specimen < 0 or stream.repeats < 1, "samples_per_specimen or repeats: expected 0 or more, and 1 or more"),
        (depth < 1 or len(network.blocks) != depth, "channels and blocks: expected as many of each, one at least"),
        (min((*network.channels, *network.blocks), default=0) < 1, "channels and blocks: expected whole numbers above 0"),
        (min(optimiser.steps, optimiser.batch, optimiser.members) < 1, "steps, batch, members: expected whole numbers above 0"),
        (not optimiser.rate > 0 or not optimiser.clip > 0 or optimiser.weight_decay < 0, "rate, clip, weight_decay: expected numbers above 0"),
        (not 0 <= optimiser.warm_up <= 1 or not 0 <= optimiser.average < 1, "warm_up, average: expected numbers from 0 to 1"),
        (run.device not in ("auto", "cpu", "cuda"), f"device = {run.device!r}: expected auto, cpu or cuda"),
        (run.processes < -1 or run.checkpoint_every < 1 or run.log_every < 1, "processes, checkpoint_every, log_every: expected whole numbers"),
    ]
    for wrong, words in faults:
        if wrong:
            raise _invalid("config", f"config: {words}")


def _recipe(given: Any, folder: str, seed: int) -> tuple[Recipe, float]:
    """Reads a recipe and its weight."""
    table = given
    if isinstance(given, str):
        name, _, tier = given.partition(":")
        table = {"recipe": name, **({"difficulty": tier} if tier else {})}
    if not isinstance(table, Mapping) or not isinstance(table.get("recipe"), str):
        raise _invalid("config", f"config: recipes: {reprlib.repr(given)}: expected a name, or a table with the key recipe")
    for key in table:
        if key not in _RECIPE_KEYS:
            raise _invalid("config", f"config: recipes: {key}: {unknown(key, _RECIPE_KEYS)}")
    path = Path(folder) / table["recipe"]
    source: Any = path if path.is_file() else table["recipe"]
    grid = None if "grid" not in table else tuple(table["grid"])
    weight = table.get("weight", 1.0)
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not weight > 0:
        raise _invalid("config", f"config: recipes: weight = {reprlib.repr(weight)}: expected a number above 0")
    return Recipe(source, table.get("difficulty"), set=table.get("set"), grid=grid, seed=seed), float(weight)
