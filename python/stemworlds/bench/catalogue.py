"""Makes agents from names, or from tables of a TOML file."""

from __future__ import annotations

import difflib
import inspect
import reprlib
from collections.abc import Callable, Mapping
from typing import Any

from ..errors import InvalidValue, _invalid
from .agents import Agent, CompressedSensing, Plays
from .analysts import Heuristic, Nothing, Oracle
from .blind import Usual
from .endpoint import Endpoint
from .field_navigators import ByCounts, ByPrior, ByTruth
from .ideal import Ideal
from .navigators import GaussianProcess, RandomMask, RandomTiles, Raster
from .neural import NeuralAnalyst
from .onnx import OnnxAnalyst
from .own_agents import PYTHON_KEYS, check_options, found_at, is_path, table_of, unpickled
from .planners import LanguageModelPlanner, ModePlanner, NoPlanner, PlannerLimits
from .vlm import VisionLanguageAnalyst

__all__ = ["agent_names", "agent_specification", "make_agent"]

Table = Mapping[str, Any]

_ENDPOINT = ("url", "model", "key_variable", "temperature", "max_tokens", "retries", "timeout_s", "pause_s")


def _vlm(**options: Any) -> VisionLanguageAnalyst:
    return VisionLanguageAnalyst(_endpoint(options))


def _language_model(**options: Any) -> LanguageModelPlanner:
    endpoint = _endpoint(options)
    return LanguageModelPlanner(endpoint, **options)


def _endpoint(options: dict[str, Any]) -> Endpoint:
    return Endpoint(**{name: options.pop(name) for name in _ENDPOINT if name in options})


def _modes(**limits: Any) -> ModePlanner:
    return ModePlanner(PlannerLimits(**limits))


def _rules(**limits: Any) -> ModePlanner:
    rules = PlannerLimits.rules()
    return ModePlanner(PlannerLimits(**{**vars(rules), **limits}))


_NAVIGATORS: dict[str, Callable[..., Any]] = {
    "random": RandomTiles,
    "raster": Raster,
    "gp": GaussianProcess,
    "mask": RandomMask,
    "counts": ByCounts,
    "prior": ByPrior,
    "truth": ByTruth,
}
_ANALYSTS: dict[str, Callable[..., Any]] = {
    "nothing": Nothing,
    "oracle": Oracle,
    "prior": Usual,
    "ideal": Ideal,
    "heuristic": Heuristic,
    "neural": NeuralAnalyst,
    "onnx": OnnxAnalyst,
    "vlm": _vlm,
}
_PLANNERS: dict[str, Callable[..., Any]] = {"none": NoPlanner, "modes": ModePlanner, "rules": _rules, "llm": _language_model}
#: Functions with ``**options``, and the options that each accepts.
_SIGNATURES: dict[Callable[..., Any], set[str]] = {
    _vlm: set(_ENDPOINT),
    _language_model: {*_ENDPOINT, "every"},
    _modes: set(vars(PlannerLimits())),
    _rules: set(vars(PlannerLimits())),
}
_PLANNERS["modes"] = _modes

_KEYS = ("name", "navigator", "analyst", "planner", "policy", "declare_every")

#: Agents by name: no network and no service is needed for these.
_PRESETS: dict[str, Table] = {
    "Nothing": {"navigator": "raster", "analyst": "nothing"},
    "Prior": {"navigator": "raster", "analyst": "prior"},
    "Prior places": {"navigator": "raster", "analyst": {"kind": "prior", "places": True}},
    "Random": {"navigator": "random", "analyst": "heuristic"},
    "Raster": {"navigator": "raster", "analyst": "heuristic"},
    "GP-UCB": {"navigator": "gp", "analyst": "heuristic"},
    "GP-EI": {"navigator": {"kind": "gp", "acquisition": "ei"}, "analyst": "heuristic"},
    "GP-TS": {"navigator": {"kind": "gp", "acquisition": "thompson"}, "analyst": "heuristic"},
    "GP-UCB closed loop": {"navigator": {"kind": "gp", "interest": "uncertainty"}, "analyst": "heuristic"},
    "PF GP-BO": {"navigator": {"kind": "gp", "interest": "features"}, "analyst": "heuristic"},
    "CS-10": {"navigator": {"kind": "mask", "share": 0.1}, "analyst": "heuristic"},
    "CS-20": {"navigator": {"kind": "mask", "share": 0.2}, "analyst": "heuristic"},
    "CS-30": {"navigator": {"kind": "mask", "share": 0.3}, "analyst": "heuristic"},
    "STEMAgent": {"navigator": "gp", "analyst": "heuristic", "planner": "modes"},
    "STEMAgent without planner": {"navigator": "gp", "analyst": "heuristic", "planner": "none"},
    "STEMAgent rule planner": {"navigator": "gp", "analyst": "heuristic", "planner": "rules"},
    "Ideal": {"navigator": "raster", "analyst": "ideal"},
    "Ideal mixture": {"navigator": "raster", "analyst": {"kind": "ideal", "grade": "mixture"}},
    "Ideal known image": {"navigator": "raster", "analyst": {"kind": "ideal", "grade": "known"}},
    "GP counts": {"navigator": "counts", "analyst": "heuristic"},
    "Prior map": {"navigator": "prior", "analyst": "prior"},
    "Random+Ideal": {"navigator": "random", "analyst": "ideal"},
    "GP-UCB+Ideal": {"navigator": "gp", "analyst": "ideal"},
    "Ideal closed loop": {"navigator": "counts", "analyst": "ideal"},
    "Truth map": {"navigator": "truth", "analyst": "oracle"},
    "Random+Oracle": {"navigator": "random", "analyst": "oracle"},
    "Raster+Oracle": {"navigator": "raster", "analyst": "oracle"},
    "GP-UCB+Oracle": {"navigator": "gp", "analyst": "oracle"},
    "STEMAgent+Oracle": {"navigator": "gp", "analyst": "oracle", "planner": "modes"},
}


def agent_names() -> list[str]:
    """Returns the names of the agents that :func:`make_agent` knows."""
    return list(_PRESETS)


def agent_specification(given: str | Table | Plays, folder: str | None = None) -> dict[str, Any]:
    """Returns the complete, checked table of an agent: ``{"name": "Raster", "navigator": {"kind": "raster"}, ...}``.

    Args:
        given: a name; ``"package.module:Class"``, which is called without arguments and returns an agent; a table; or an agent.
        folder: a folder that is searched for modules in addition to Python's path.

    Raises:
        InvalidValue: for unknown names, keys and options, and modules that cannot be imported.
    """
    if not isinstance(given, str | Mapping):
        return table_of(given)
    if isinstance(given, str) and is_path(given):
        given = {"name": given, "python": given}
    if isinstance(given, Mapping) and "python" in given:
        return _python_agent(given, folder)
    if isinstance(given, str):
        if given not in _PRESETS:
            raise _invalid("agent", f"agent {given!r}: {unknown(given, _PRESETS)}")
        given = {"name": given, **_PRESETS[given]}
    for key in given:
        if key not in _KEYS:
            raise _invalid("agent", f"agent {given.get('name', '?')!r}: key {key!r}: {unknown(key, _KEYS)}")
    name = given.get("name")
    if not isinstance(name, str) or not name:
        raise _invalid("agent", f"an agent has no name: {reprlib.repr(dict(given))}")
    every = given.get("declare_every", 1)
    if not isinstance(every, int) or isinstance(every, bool) or every < 1:
        raise _invalid("agent", f"agent {name!r}: declare_every = {reprlib.repr(every)}: expected a whole number above 0")
    if "policy" in given and not isinstance(given["policy"], Mapping):
        raise _invalid("agent", f"agent {name!r}: policy = {reprlib.repr(given['policy'])}: expected a table")
    if "policy" in given:
        return {"name": name, "policy": dict(given["policy"]), "analyst": _part(name, "analyst", given.get("analyst", "nothing"), _ANALYSTS)}
    whole: dict[str, Any] = {"name": name}
    for part, kinds in (("navigator", _NAVIGATORS), ("analyst", _ANALYSTS), ("planner", _PLANNERS)):
        if part in given:
            whole[part] = _part(name, part, given[part], kinds)
        elif part != "planner":
            raise _invalid("agent", f"agent {name!r}: {part} is missing: one of {', '.join(kinds)}")
    if "declare_every" in given:
        whole["declare_every"] = given["declare_every"]
    return whole


def _python_agent(given: Table, folder: str | None) -> dict[str, Any]:
    """Returns the checked table of an agent from another package."""
    whole = {"name": given["python"], **given} if folder is None else {"name": given["python"], "folder": folder, **given}
    for key in whole:
        if key not in PYTHON_KEYS:
            raise _invalid("agent", f"agent {whole['name']!r}: key {key!r}: {unknown(key, PYTHON_KEYS)}")
    path, options = whole["python"], whole.get("options", {})
    if not isinstance(whole["name"], str) or not whole["name"]:
        raise _invalid("agent", f"an agent has no name: {reprlib.repr(dict(given))}")
    if not isinstance(path, str) or not is_path(path):
        raise _invalid("agent", f"agent {whole['name']!r}: python = {reprlib.repr(path)}: expected 'package.module:Class'")
    if not isinstance(options, Mapping):
        raise _invalid("agent", f"agent {whole['name']!r}: options = {reprlib.repr(options)}: expected a table")
    check_options(whole["name"], path, found_at(path, whole.get("folder")), options)
    return {**whole, "options": dict(options)}


def _python_made(whole: Table) -> Plays:
    made: Plays = found_at(whole["python"], whole.get("folder"))(**whole["options"])
    if not callable(getattr(made, "run", None)):
        raise _invalid("agent", f"agent {whole['name']!r}: {whole['python']!r} gave {made!r}, which has no method run(env, seed)")
    return made


def make_agent(given: str | Table | Plays) -> Plays:
    """Makes an agent from its name, or from a table in the form of the experiments' TOML files.

    >>> agent = make_agent("GP-UCB")
    >>> agent = make_agent({"name": "mine", "navigator": {"kind": "gp", "beta": 1.0}, "analyst": "heuristic"})
    """
    if isinstance(given, Mapping) and "pickle" in given:
        # An experiment in memory may hold a pickled agent; a TOML file cannot.
        return unpickled(given)
    if not isinstance(given, str | Mapping):
        return given
    whole = agent_specification(given)
    name = whole["name"]
    if "python" in whole:
        return _python_made(whole)
    if "policy" in whole:
        from .rl import PolicyAgent

        return PolicyAgent(name, analyst=_made(name, "analyst", whole["analyst"], _ANALYSTS), **whole["policy"])
    parts = {part: _made(name, part, whole[part], kinds) for part, kinds in _KINDS.items() if part in whole}
    every = {"declare_every": whole["declare_every"]} if "declare_every" in whole else {}
    if isinstance(parts["navigator"], RandomMask) and "planner" not in parts:
        oracle = whole["analyst"]["kind"] == "oracle"
        second = None if oracle else _made(name, "analyst", whole["analyst"], _ANALYSTS)
        return CompressedSensing(name, parts["navigator"], parts["analyst"], second, **every)
    return Agent(name, **parts, **every)


_KINDS = {"navigator": _NAVIGATORS, "analyst": _ANALYSTS, "planner": _PLANNERS}


def _part(agent: str, part: str, given: Any, kinds: Mapping[str, Callable[..., Any]]) -> dict[str, Any]:
    """Returns a part of an agent as a table with its kind. The names of its options are checked."""
    table = {"kind": given} if isinstance(given, str) else given
    if not isinstance(table, Mapping) or not isinstance(table.get("kind"), str):
        raise _invalid("agent", f"agent {agent!r}: {part} = {reprlib.repr(given)}: expected a name, or a table with a kind")
    kind = table["kind"]
    if kind not in kinds:
        raise _invalid("agent", f"agent {agent!r}: {part} {kind!r}: {unknown(kind, kinds)}")
    maker = kinds[kind]
    known = _SIGNATURES.get(maker) or set(inspect.signature(maker).parameters)
    for option in table:
        if option != "kind" and option not in known:
            raise _invalid("agent", f"agent {agent!r}: {part} {kind!r}: option {option!r}: {unknown(option, known)}")
    return dict(table)


def _made(agent: str, part: str, table: Table, kinds: Mapping[str, Callable[..., Any]]) -> Any:
    options = {key: value for key, value in table.items() if key != "kind"}
    try:
        return kinds[table["kind"]](**options)
    except InvalidValue as error:
        raise _invalid("agent", f"agent {agent!r}: {part} {table['kind']!r}: {error}") from error
    except TypeError as error:
        raise _invalid("agent", f"agent {agent!r}: {part} {table['kind']!r}: {error}") from error


def unknown(name: str, known: Any) -> str:
    """Returns the message about an unknown name, with similar known names."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    if near:
        return f"unknown; did you mean {near[0]!r}?"
    return f"unknown; known are {', '.join(names)}" if names else "unknown; there are no options"
