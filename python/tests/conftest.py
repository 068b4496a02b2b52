"""What the tests share: a small world, atoms, and the command line of the same wheel."""

from __future__ import annotations

import faulthandler
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import stemworlds as sw

HERE = Path(__file__).parent
SOURCES = HERE.parent
ROOT = SOURCES.parent

#: Seconds after which a test hangs. Nothing else in these tests may depend on how long something takes.
LONGEST_S = 1800

#: Changes of a thin specimen of one grain that loses oxygen fast; its library is shared.
DYING: dict[str, Any] = {"damage.radiolysis_barn.O": 60, "field.thickness_nm": 0.4, "boundaries.count": 0}
#: A thin specimen of one grain for environments.
RECIPE: dict[str, Any] = {"recipe": "test", "set": {"field.thickness_nm": 0.4, "boundaries.count": 0}}
#: A field of a tile and a thin specimen: seconds to build.
TINY: dict[str, Any] = {"set": {"field.thickness_nm": 0.4, "phonons.configurations": 2, "boundaries.count": 0}, "grid": (1, 2), "seed": 5}


def pytest_configure() -> None:
    """The wheel is tested, never the source tree."""
    # A shell that starts this in the background has SIGINT ignored, and Python then leaves it so.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    assert not Path(sw.__file__).is_relative_to(SOURCES), f"{sw.__file__} is no installed package"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long tests are run by `sh tests/run.sh --all`, which sets STEMWORLDS_LONG."""
    if os.environ.get("STEMWORLDS_LONG"):
        return
    for item in items:
        if item.get_closest_marker("long"):
            item.add_marker(pytest.mark.skip(reason="long: sh tests/run.sh --all runs it"))


@pytest.fixture(scope="session")
def standard_error() -> Iterator[Any]:
    """Standard error as it is outside of tests."""
    with os.fdopen(os.dup(sys.__stderr__.fileno() if sys.__stderr__ is not None else 2), "w") as file:
        yield file


@pytest.fixture(autouse=True)
def no_hang(standard_error: Any) -> Iterator[None]:
    """A test that hangs ends the run, and says where it was."""
    faulthandler.dump_traceback_later(LONGEST_S, exit=True, file=standard_error)
    yield
    faulthandler.cancel_dump_traceback_later()


def until(happened: Callable[[], Any], process: subprocess.Popen[Any] | None = None) -> Any:
    """Waits for what another thread or process does, and returns it; fails where that process ends without."""
    while not (found := happened()):
        assert process is None or process.poll() is None, f"the process has ended with {process.returncode}"
        time.sleep(0.01)
    return found


def ended(pid: int) -> bool:
    """Whether a process is gone, or has ended and waits for its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return True


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """All tests share a cache that is none of the user's. Where a test compares with something else, that is made without."""
    monkeypatch.setenv("STEMGEN_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))
    yield


@pytest.fixture(scope="session")
def world_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("worlds") / "tiny.h5"
    sw.build("test", out=path, keep_clean=True, audit=0, **TINY).close()
    return path


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The folder of the libraries of live worlds."""
    return str(tmp_path_factory.mktemp("library"))


@pytest.fixture(scope="session")
def field_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2 x 3 tiles for agents."""
    path = tmp_path_factory.mktemp("fields") / "w.h5"
    sw.build("test", out=path, keep_clean=True, audit=0, set=RECIPE["set"]).close()
    return path


@pytest.fixture(scope="session")
def silicon() -> Any:
    """Silicon along [001], 16.3 x 16.3 x 10.9 A."""
    from ase.build import bulk

    return bulk("Si", cubic=True) * (3, 3, 2)


def command(*arguments: object, cwd: Path, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Runs a program that the package installs: that of its own commands, or `stemgen`."""
    own = arguments and arguments[0] in ("bench", "serve")
    program = Path(sys.executable).with_name("stemworlds" if own else "stemgen")
    words = [str(program), *map(str, arguments)]
    return subprocess.run(words, cwd=cwd, check=check, text=True, capture_output=True, timeout=LONGEST_S)
