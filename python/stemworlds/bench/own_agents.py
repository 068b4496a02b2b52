"""Agents that are not of this package: ``"mypackage.module:Class"``, and objects from Python."""

from __future__ import annotations

import base64
import hashlib
import importlib
import importlib.util
import inspect
import pickle
import sys
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import StemworldsError, _invalid

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .agents import Plays

#: Keys of the tables of such agents. ``folder`` is where modules are looked for first, ``pickle`` an object in base64.
PYTHON_KEYS = ("name", "python", "options", "folder")


def is_path(given: str) -> bool:
    """Whether a text names something of a module: ``"package.module:Class"``."""
    module, colon, name = given.partition(":")
    return bool(colon) and all(part.isidentifier() for part in (*module.split("."), *name.split(".")))


def found_at(path: str, folder: str | None = None) -> Callable[..., Any]:
    """What ``"package.module:Class"`` names.

    Args:
        path: module and name.
        folder: where modules are looked for besides Python's own path.

    Raises:
        InvalidValue: if there is no such module, or nothing of that name in it.
    """
    module, _, name = path.partition(":")
    with _on_path(folder):
        try:
            found: Any = importlib.import_module(module)
        except ImportError as error:
            where = f", nor is it in {folder}" if folder else ""
            raise _invalid("agent", f"{path!r}: module {module!r} cannot be imported ({error}); install it{where}") from error
    for part in name.split("."):
        if not hasattr(found, part):
            raise _invalid("agent", f"{path!r}: module {module!r} has no {name!r}")
        found = getattr(found, part)
    if not callable(found):
        raise _invalid("agent", f"{path!r} is no class or function, but {type(found).__name__}")
    made: Callable[..., Any] = found
    return made


@contextmanager
def _on_path(folder: str | None) -> Iterator[None]:
    if folder is None or folder in sys.path:
        yield
        return
    sys.path.insert(0, folder)
    importlib.invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(folder)


def check_options(agent: str, path: str, maker: Callable[..., Any], options: Mapping[str, Any]) -> None:
    """Refuses options that a class or function does not take."""
    try:
        inspect.signature(maker).bind(**options)
    except TypeError as error:
        raise _invalid("agent", f"agent {agent!r}: {path!r}: {error}") from error
    except ValueError:
        # Of some classes nothing is known before they are called.
        return


def source_digest(path: str, folder: str | None = None) -> str:
    """Names what the module of ``path`` holds, so that another text is another agent; what that module imports is not looked at."""
    module = path.partition(":")[0]
    with _on_path(folder):
        try:
            spec = importlib.util.find_spec(module)
        except (ImportError, ValueError):
            spec = None
    origin = None if spec is None else spec.origin
    if origin is None or not Path(origin).is_file():
        return f"{module}, missing"
    return hashlib.sha256(Path(origin).read_bytes()).hexdigest()[:16]


def table_of(agent: Any) -> dict[str, Any]:
    """An agent object as a table that goes to other processes.

    Raises:
        InvalidValue: if it has no name or no method ``run``, or cannot be pickled.
    """
    kind = type(agent)
    name = getattr(agent, "name", None)
    if not isinstance(name, str) or not name or not callable(getattr(agent, "run", None)):
        raise _invalid("agent", f"agent {agent!r}: expected a name, a table, or an object with a name and a method run(env, seed), as bench.Agent")
    try:
        # A protocol of its own, so that the key of an episode does not depend on the version of Python.
        held = pickle.dumps(agent, protocol=4)
    except Exception as error:
        raise _invalid("agent", f"agent {name!r}: cannot be pickled, as other processes need it: {error}; define its classes in a module") from error
    return {"name": name, "object": f"{kind.__module__}.{kind.__qualname__}", "pickle": base64.b64encode(held).decode()}


def unpickled(table: Mapping[str, Any]) -> Plays:
    """The agent of :func:`table_of`."""
    try:
        made: Plays = pickle.loads(base64.b64decode(table["pickle"]))
    except Exception as error:
        advice = "define its classes in a module that other processes can import, or run with processes=1"
        raise StemworldsError(f"agent {table['name']!r}: {table['object']} cannot be made again in this process ({error}); {advice}") from error
    return made


def essence(table: Mapping[str, Any]) -> dict[str, Any]:
    """What makes an own agent, wherever it lies: for keys of episodes and rows of results."""
    kept = {key: value for key, value in table.items() if key not in ("folder", "pickle")}
    if "pickle" in table:
        kept["state"] = hashlib.sha256(table["pickle"].encode()).hexdigest()[:16]
    if "python" in table:
        kept["source"] = source_digest(table["python"], table.get("folder"))
    return kept
