"""What the README shows of the package runs. The pages of docs/ run when their site is built: docs/build.sh."""

from __future__ import annotations

import importlib.util
import re
import shutil
import sys
from pathlib import Path
from typing import Any

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
    snippet = snippet.replace('"srtio3", difficulty="easy"', '"test", set={"field.thickness_nm": 0.4, "boundaries.count": 0}').replace(", phonons=4", ", phonons=1")
    names: dict[str, object] = {}
    exec(compile(snippet, "README.md", "exec"), names)
    assert (tmp_path / "worlds/mine.h5").exists()


@pytest.fixture
def pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module that runs the pages, for a repository of its own."""
    for needed in ("nbclient", "nbformat", "ipykernel"):
        pytest.importorskip(needed)
    spec = importlib.util.spec_from_file_location("pages", ROOT / "docs/site/pages.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "pages", module)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "ROOT", tmp_path)
    for folder in ("docs", "out/made"):
        (tmp_path / folder).mkdir(parents=True)
    return module


GOOD = "# A page\n\nText.\n\n```python\na = 2\nprint(f'{a + 1} electrons')\n```\n\nMore.\n"


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("```python\nb = a\nb.missing\n```\n", r"docs/x\.md:13: the example fails[^$]*AttributeError"),
        ("```python\na = = 2\n```\n", r"docs/x\.md:12: invalid syntax"),
        ("```python\nimport warnings\nwarnings.warn('old')\n```\n", r"docs/x\.md:12: the example warns"),
        ("```python\na\n", r"docs/x\.md:11: the block does not end"),
        ("<!-- needs: torch -->\nText.\n", r"docs/x\.md:12: a comment"),
    ],
)
def test_a_page_that_fails_is_named_with_its_line(pages: Any, tmp_path: Path, more: str, said: str) -> None:
    (tmp_path / "docs/x.md").write_text(GOOD + more)
    with pytest.raises(pages.PageError, match=said):
        pages.run(pages.read("docs/x.md", "x.md"), tmp_path / "out")


def test_a_page_shows_what_its_examples_print(pages: Any, tmp_path: Path) -> None:
    asks = "<!-- needs: no_such_module -->\n```python\nimport no_such_module\n```\n\n[on](docs/y.md) [out](src)\n"
    (tmp_path / "docs/x.md").write_text(GOOD + asks.replace("docs/y.md", "y.md").replace("(src)", "(../src)"))
    (tmp_path / "docs/y.md").write_text("# Another\n")
    (tmp_path / "src").mkdir()
    page = pages.read("docs/x.md", "x.md")
    assert pages.run(page, tmp_path / "out").startswith("docs/x.md: 1 blocks")
    text = pages.written(page, {"docs/x.md": "x.md", "docs/y.md": "y.md"}, tmp_path / "out")
    assert "3 electrons" in text and "no_such_module was not installed" in text
    assert "[on](y.md) out" in text
    cells = pages.notebook(page, every=True).cells
    assert [cell.cell_type for cell in cells] == ["markdown", "code", "markdown", "code", "markdown"] and not cells[1].outputs
