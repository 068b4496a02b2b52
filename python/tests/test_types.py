"""The examples are typed, and run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import SOURCES

EXAMPLES = sorted((SOURCES / "examples").glob("*.py"))


def test_mypy_is_content_with_the_examples(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    words = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path), *map(str, EXAMPLES)]
    done = subprocess.run(words, text=True, capture_output=True, cwd=tmp_path)
    assert done.returncode == 0, done.stdout


def test_mypy_is_content_with_the_package(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    words = [sys.executable, "-m", "mypy", "--config-file", str(SOURCES / "pyproject.toml")]
    done = subprocess.run([*words, "--cache-dir", str(tmp_path), "-p", "stemworlds"], text=True, capture_output=True, cwd=tmp_path)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(example: Path, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, str(example)], text=True, capture_output=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout
