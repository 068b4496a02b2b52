"""The package and the examples are typed, and the examples run."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import LONGEST_S, ROOT, SOURCES

EXAMPLES = sorted((SOURCES / "examples").glob("*.py"))


@pytest.fixture(scope="module")
def mypy(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., None]:
    """Runs mypy, and keeps what it finds of other packages for the next run."""
    pytest.importorskip("mypy")
    folder = tmp_path_factory.mktemp("mypy")

    def run(*words: object) -> None:
        program = [sys.executable, "-m", "mypy", "--cache-dir", str(folder), *map(str, words)]
        done = subprocess.run(program, text=True, capture_output=True, cwd=folder, timeout=LONGEST_S)
        assert done.returncode == 0, done.stdout

    return run


def test_mypy_is_content_with_the_package(mypy: Callable[..., None]) -> None:
    mypy("--config-file", SOURCES / "pyproject.toml", "-p", "stemworlds")


def test_mypy_is_content_with_the_examples(mypy: Callable[..., None]) -> None:
    mypy("--strict", *EXAMPLES)


#: ASE's own types are partly unknown.
STUBS = {
    "ase/__init__.pyi": "",
    "ase/build.pyi": "from typing import Any\ndef bulk(name: str, *, cubic: bool = ...) -> Any: ...\n",
    "ase/io.pyi": "from typing import Any\ndef write(name: str, atoms: Any) -> None: ...\n",
}


def pyright(folder: Path, *words: str, **rules: Any) -> dict[str, Any]:
    """What Pyright says of the files of a folder."""
    pytest.importorskip("basedpyright")
    for name, text in STUBS.items():
        (folder / "stubs" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "stubs" / name).write_text(text)
    rules = {"pythonVersion": "3.11", "stubPath": "stubs", "reportMissingTypeStubs": False, **rules}
    (folder / "pyrightconfig.json").write_text(json.dumps(rules))
    program = [sys.executable, "-m", "basedpyright", "--pythonpath", sys.executable, "--outputjson", *words]
    # It looks for packages where the first Python of the path has them.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(program, text=True, capture_output=True, cwd=folder, env={**os.environ, "PATH": path}, timeout=LONGEST_S)
    assert done.returncode in (0, 1), done.stderr + done.stdout
    said: dict[str, Any] = json.loads(done.stdout)
    return said


def errors(said: dict[str, Any]) -> list[str]:
    found = (item for item in said["generalDiagnostics"] if item["severity"] == "error")
    return [f"{Path(item['file']).name}:{item['range']['start']['line'] + 1}: {item['message']}" for item in found]


def test_pyright_is_content_with_the_examples(tmp_path: Path) -> None:
    for example in EXAMPLES:
        (tmp_path / example.name).write_text(example.read_text())
    # Beside them something that is wrong, which it has to find.
    (tmp_path / "wrong.py").write_text("import stemworlds as sw\nsw.Scan(points=3)\nsw.World('a').til(0, 0)\n")
    said = pyright(tmp_path, typeCheckingMode="strict")
    found = errors(said)
    assert said["summary"]["filesAnalyzed"] > len(EXAMPLES) and [text for text in found if not text.startswith("wrong.py:")] == []
    assert {text.split(":")[1] for text in found} >= {"2", "3"}


def test_the_public_types_are_complete(tmp_path: Path) -> None:
    said = pyright(tmp_path, "--verifytypes", "stemworlds", "--ignoreexternal")
    symbols = said["typeCompleteness"]["symbols"]
    assert len(symbols) > 400
    unknown = [symbol["name"] for symbol in symbols if symbol["isExported"] and not symbol["isTypeKnown"]]
    # PyTorch, of which these are made, is not installed.
    assert [name for name in unknown if not name.startswith(("stemworlds.torch.", "stemworlds.train."))] == []


def test_pyright_is_content_with_the_pages(tmp_path: Path) -> None:
    """Loosely: they are notebooks, and run when the site is built."""
    pages = sorted((ROOT / "docs").rglob("*.md"))
    for page in pages:
        blocks = re.findall(r"(<!-- .*? -->\n)?^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
        code = "\n".join(text for mark, text in blocks if "aside" not in mark and "not run" not in mark)
        if "sw." in code:
            (tmp_path / f"{page.stem.replace('-', '_')}_page.py").write_text(code)
    # A dict of options may hold any of them, which Pyright takes as all.
    off = {"reportCallIssue": False, "reportOptionalMemberAccess": False, "reportOptionalOperand": False, "reportMissingImports": False}
    said = pyright(tmp_path, typeCheckingMode="standard", **off)
    assert said["summary"]["filesAnalyzed"] >= 12 and errors(said) == []


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(example: Path, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, str(example)], text=True, capture_output=True, cwd=tmp_path, timeout=LONGEST_S)
    assert done.returncode == 0, done.stderr
    assert done.stdout
