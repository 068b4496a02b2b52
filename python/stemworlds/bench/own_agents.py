"""Agents from outside this package: ``"mypackage.module:Class"``, and Python objects."""

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

#: Keys of the tables of agents from outside. ``folder`` is searched for modules first. The key ``pickle`` holds an object in base64.
PYTHON_KEYS = ("name", "python", "options", "folder")


def is_path(given: str) -> bool:
    """Returns whether a text has the form ``"package.module:Class"``."""
    module, colon, name = given.partition(":")
    return bool(colon) and all(part.isidentifier() for part in (*module.split("."), *name.split(".")))


def found_at(path: str, folder: str | None = None) -> Callable[..., Any]:
    """Imports the class or function ``"package.module:Class"``.

    Args:
        path: module and name.
        folder: a folder that is searched for modules before Python's path.

    Raises:
        InvalidValue: if the module cannot be imported, or contains no class or function of this name.
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
    """Checks options against the parameters of a class or function.

    Raises:
        InvalidValue: for an option that the class or function does not accept.
    """
    try:
        inspect.signature(maker).bind(**options)
    except TypeError as error:
        raise _invalid("agent", f"agent {agent!r}: {path!r}: {error}") from error
    except ValueError:
        # Some classes of compiled modules have no signature, so their options cannot be checked.
        return


def source_digest(path: str, folder: str | None = None) -> str:
    """Returns a hash of the source of the module of ``path``. A changed source is therefore another agent.

    Modules that it imports do not change the hash.
    """
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
    """Converts an agent object to a table that can be sent to other processes.

    Raises:
        InvalidValue: if it has no name or no method ``run``, or cannot be pickled.
    """
    kind = type(agent)
    name = getattr(agent, "name", None)
    if not isinstance(name, str) or not name or not callable(getattr(agent, "run", None)):
        raise _invalid("agent", f"agent {agent!r}: expected a name, a table, or an object with a name and a method run(env, seed), as bench.Agent")
    try:
        # The protocol is fixed, so that the key of an episode does not depend on the version of Python.
        held = pickle.dumps(agent, protocol=4)
    except Exception as error:
        raise _invalid("agent", f"agent {name!r}: cannot be pickled, as other processes need it: {error}; define its classes in a module") from error
    return {"name": name, "object": f"{kind.__module__}.{kind.__qualname__}", "pickle": base64.b64encode(held).decode()}


def unpickled(table: Mapping[str, Any]) -> Plays:
    """Restores the agent from a table of :func:`table_of`."""
    try:
        made: Plays = pickle.loads(base64.b64decode(table["pickle"]))
    except Exception as error:
        advice = "define its classes in a module that other processes can import, or run with processes=1"
        raise StemworldsError(f"agent {table['name']!r}: {table['object']} cannot be made again in this process ({error}); {advice}") from error
    return made


def essence(table: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the identity of an agent, without the folder of its files, for keys of episodes and rows of results."""
    kept = {key: value for key, value in table.items() if key not in ("folder", "pickle")}
    if "pickle" in table:
        kept["state"] = hashlib.sha256(table["pickle"].encode()).hexdigest()[:16]
    if "python" in table:
        kept["source"] = source_digest(table["python"], table.get("folder"))
    return kept
