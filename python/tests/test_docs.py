"""What the README shows of the package runs. The pages of docs/ run when their site is built: docs/build.sh."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from conftest import ROOT


def snippets(page: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def test_the_readme_shows_the_python_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "structures", tmp_path / "structures")
    [snippet] = [text for text in snippets(ROOT / "README.md") if "stemworlds" in text]
    assert 'sw.build("srtio3", difficulty="easy", grid=(1, 1)' in snippet
    # A stand-in for the world, in seconds.
    snippet = snippet.replace('"srtio3", difficulty="easy"', '"test"').replace(", phonons=4", ", phonons=1")
    names: dict[str, object] = {}
    exec(compile(snippet, "README.md", "exec"), names)
    assert (tmp_path / "worlds/mine.h5").exists()
