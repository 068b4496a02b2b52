"""Makes the sources of the site: copies the pages, runs their Python, and puts what it shows below it.

    python docs/site/pages.py OUT [PAGE ...]          # runs some pages only: docs/tour.md
    python docs/site/pages.py OUT --changed           # runs those only whose Python is not listed in ran.json

ran.json lists the Python of each page, as a digest, as it was when the page ran last. `STEMGEN_UPDATE=1` renews the list once all pages, or
all changed pages, have run.

Each page is a notebook of its own: its blocks of Python run one after the other in a new kernel and an empty folder. A block that fails
ends the build, with page and line. Comments above a block say more about it:

    <!-- needs: torch -->          run only where this is installed; said aloud where it is not
    <!-- not run: the reason -->   only compiled
    <!-- picture: a title -->      what it draws stands on the front page too
    <!-- aside: abtem -->          another program's way to do what the next block does: set beside it, and run, where that is installed, with
                                   the other asides of the page
"""

from __future__ import annotations

import base64
import hashlib
import html
import importlib.util
import json
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

ROOT = Path(__file__).resolve().parents[2]
#: Pages that are no part of docs/, and their names on the site.
ELSEWHERE = {
    "worlds/README.md": "repository/world-files.md",
    "generate/README.md": "repository/recipes.md",
    "library/README.md": "repository/library.md",
    "benches/README.md": "repository/benchmarks.md",
    "CONTRIBUTING.md": "repository/contributing.md",
    "CHANGELOG.md": "repository/changelog.md",
}
#: Digests of the Python of all pages, as it ran last.
RAN = Path(__file__).parent / "ran.json"
#: Seconds after which a block, or the start of a kernel, hangs. However slow the machine is, nothing else depends on time.
LONGEST_S = 1800
#: Pages that run at the same time.
AT_ONCE = 2

_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
_MARK = re.compile(r"<!-- *(needs|not run|picture|aside): *(.*?) *-->")
_ERROR_LINE = re.compile(r"Cell In\[\d+\], line (\d+)")
_PROGRAMS = {"abtem": "abTEM"}
_NOTHING_TO_SEE = ("<Axes", "<matplotlib.", "[<matplotlib.", "Text(", "array([<Axes", "<Figure")


class PageError(Exception):
    """A page is wrong; the message begins with page and line."""


@dataclass
class Block:
    """A piece of a page: text, or Python that runs."""

    line: int
    text: str
    code: bool = False
    needs: str = ""
    not_run: str = ""
    picture: str = ""
    aside: str = ""
    shown: list[str] = field(default_factory=list)

    @property
    def missing(self) -> bool:
        wanted = self.needs or self.aside
        return bool(wanted) and importlib.util.find_spec(wanted) is None

    @property
    def runs(self) -> bool:
        return self.code and not self.not_run and not self.missing


@dataclass
class Page:
    """A page: its path in the repository, its name on the site, and its pieces."""

    path: str
    target: str
    blocks: list[Block]

    @property
    def slug(self) -> str:
        return self.target.removesuffix(".md").replace("/", "-")

    @property
    def digest(self) -> str:
        """Stands for the Python of the page."""
        return hashlib.sha256("\0".join(block.text for block in self.blocks if block.code).encode()).hexdigest()

    @property
    def has_notebook(self) -> bool:
        return self.path == "docs/tour.md" or self.path.startswith("docs/tutorials/")


def read(path: str, target: str) -> Page:
    """Takes a page apart."""
    blocks: list[Block] = []
    text: list[str] = []
    code: list[str] | None = None
    marks: dict[str, str] = {}
    start = fence = 1
    for number, line in enumerate((ROOT / path).read_text().splitlines(), 1):
        mark = _MARK.fullmatch(line.strip())
        if code is not None:
            if line.rstrip() != "```":
                code.append(line)
                continue
            more = {mark.replace(" ", "_"): said for mark, said in marks.items()}
            blocks.append(Block(fence + 1, "\n".join(code), code=True, **more))
            code, marks, start = None, {}, number + 1
        elif mark:
            marks[mark[1]] = mark[2]
        elif line.rstrip() == "```python":
            blocks.append(Block(start, "\n".join(text)))
            text, code, fence = [], [], number
        else:
            if marks and line.strip():
                raise PageError(f"{path}:{number}: a comment on how Python runs stands above a block of Python")
            text.append(line)
    if code is not None:
        raise PageError(f"{path}:{fence}: the block does not end")
    blocks.append(Block(start, "\n".join(text)))
    for block in blocks:
        if block.code:
            _compiled(path, block)
    return Page(path, target, blocks)


def _compiled(path: str, block: Block) -> None:
    try:
        compile(block.text, path, "exec")
    except SyntaxError as error:
        raise PageError(f"{path}:{block.line + (error.lineno or 1) - 1}: {error.msg}") from None


def all_pages() -> list[Page]:
    """The pages of docs/ and its folders, and those from elsewhere."""
    own = sorted(path.relative_to(ROOT) for path in (ROOT / "docs").rglob("*.md") if path.parent.name != "site")
    named = {str(path): str(path.relative_to("docs")) for path in own}
    return [read(path, target) for path, target in {**named, **ELSEWHERE}.items()]


def notebook(page: Page, *, every: bool, asides: bool = False) -> Any:
    """The page as a notebook; only blocks that run here, or every block. Asides are a notebook of their own."""
    book = nbformat.v4.new_notebook()
    book.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    for number, block in enumerate(page.blocks):
        if block.code and bool(block.aside) != asides:
            continue
        if block.runs or (every and block.code):
            cell = nbformat.v4.new_code_cell(block.text, id=f"block-{number}")
        elif every and block.text.strip():
            cell = nbformat.v4.new_markdown_cell(_LINK.sub(lambda link: link[2], block.text).strip(), id=f"block-{number}")
        else:
            continue
        book.cells.append(cell)
    return book


def run(page: Page, out: Path) -> str:
    """Runs a page, and keeps what its blocks show; returns a line that says how long it took."""
    begun = time.monotonic()
    asides, book = notebook(page, every=False, asides=True), notebook(page, every=False)
    if asides.cells:
        _execute(page, asides)
    if not book.cells:
        return ""
    _execute(page, book)
    pictures = 0
    for cell in book.cells:
        block = page.blocks[int(cell.id.removeprefix("block-"))]
        for shown, picture in _shown(page, block, cell.outputs):
            if picture is not None:
                pictures += 1
                name = f"{page.slug}-{pictures}.png"
                (out / "made" / name).write_bytes(picture)
                up = "../" * page.target.count("/")
                alt = block.picture or "What the code above draws"
                # Pictures of Jupyter, not of matplotlib, fill the page if they may.
                width = "" if block.code and "plt." in block.text or "plot(" in block.text else "{width=22em}"
                shown = f"![{alt}]({up}made/{name}){width}"
                if block.picture:
                    (out / "made" / f"{_slug(block.picture)}.png").write_bytes(picture)
            block.shown.append(shown)
    return f"{page.path}: {len(book.cells)} blocks, {pictures} pictures, {time.monotonic() - begun:.1f} s"


def _execute(page: Page, book: Any) -> None:
    """Runs a notebook in an empty folder, in which only the crystals and recipes of the repository lie."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("structures", "generate", "examples"):
            os.symlink(ROOT / name, Path(folder, name))
        # Without these two limits of their own, a kernel that starts late ends the build, and output that comes late is lost.
        limits = {"timeout": LONGEST_S, "startup_timeout": LONGEST_S, "iopub_timeout": LONGEST_S, "raise_on_iopub_timeout": True}
        client = NotebookClient(book, kernel_name="python3", resources={"metadata": {"path": folder}}, **limits)
        # The history would grow in the user's folder.
        client.extra_arguments = ["--IPKernelApp.log_level=40", "--HistoryManager.enabled=False"]
        try:
            client.execute()
        except CellExecutionError as error:
            raise PageError(_told(page, book, str(error))) from None
        except (CellTimeoutError, DeadKernelError) as error:
            raise PageError(f"{page.path}: {error}") from None


def _told(page: Page, book: Any, error: str) -> str:
    for cell in book.cells:
        if any(output.output_type == "error" for output in cell.outputs):
            block = page.blocks[int(cell.id.removeprefix("block-"))]
            plain = re.sub(r"\x1b\[[0-9;]*m", "", error)
            within = _ERROR_LINE.search(plain)
            line = block.line + (int(within[1]) - 1 if within else 0)
            return f"{page.path}:{line}: the example fails\n{plain}"
    return f"{page.path}: {error}"


def _shown(page: Page, block: Block, outputs: list[Any]) -> Iterator[tuple[str, bytes | None]]:
    """What a block shows: text of the page, or a picture."""
    text = ""
    for output in outputs:
        if output.output_type == "stream" and output.name == "stdout":
            text += output.text
        elif output.output_type == "stream" and "Warning" in output.text.replace("TqdmWarning", ""):
            raise PageError(f"{page.path}:{block.line}: the example warns\n{output.text}")
        elif output.output_type in ("display_data", "execute_result"):
            data = output.data
            if "image/png" in data:
                yield "", base64.b64decode(data["image/png"])
            elif "text/html" in data:
                yield '<div class="shown">' + " ".join(data["text/html"].split("\n")) + "</div>", None
            elif not data["text/plain"].startswith(_NOTHING_TO_SEE):
                text += data["text/plain"] + "\n"
    if text:
        yield f"```{{code-block}} text\n:class: shown\n\n{text.rstrip()}\n```", None


def _slug(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def written(page: Page, targets: dict[str, str], out: Path) -> str:
    """The page for Sphinx."""
    parts: list[str] = []
    beside = False
    for number, block in enumerate(page.blocks):
        if not block.code:
            text = _links(page, block.text, targets, out)
            if number == 0 and page.has_notebook:
                up = "../" * page.target.count("/")
                offer = f'<p class="notebook"><a href="{up}notebooks/{page.slug}.ipynb" download>This page as a notebook</a></p>'
                title, _, rest = text.partition("\n")
                text = f"{title}\n\n{offer}\n{rest}"
            parts.append(text)
            continue
        shown = "\n\n".join(block.shown)
        if block.missing:
            shown = f"*Not run when this page was made: {block.needs} was not installed.*"
        if block.aside:
            parts.append(f'<div class="sides"><div>\n\n*{_PROGRAMS.get(block.aside, block.aside)}*\n\n```python\n{block.text}\n```\n\n</div>\n')
        elif beside:
            parts.append(f'<div>\n\n*stemworlds*\n\n```python\n{block.text}\n```\n\n</div></div>\n')
        else:
            parts.append(f"```python\n{block.text}\n```\n\n{shown}\n")
        beside = bool(block.aside)
    return "\n".join(parts)


def _links(page: Page, text: str, targets: dict[str, str], out: Path) -> str:
    """Links to pages and files of the repository become links within the site; those to anything else become text."""

    def link(found: re.Match[str]) -> str:
        mark, label, target = found[1], found[2], found[3]
        path, _, heading = target.partition("#")
        if not path or "://" in path:
            return found[0]
        place = Path(os.path.normpath(Path(page.path).parent / path))
        up = "../" * page.target.count("/")
        if str(place) in targets:
            return f"{mark}[{label}]({up}{targets[str(place)]}{'#' + heading if heading else ''})"
        if place.suffix == ".md":
            raise PageError(f"{page.path}: {target} is no page of the site; name it in ELSEWHERE of docs/site/pages.py, and in front.md")
        if (ROOT / place).is_file():
            name = str(place).replace("/", "-")
            shutil.copy(ROOT / place, out / "made" / name)
            return f"{mark}[{label}]({up}made/{name})"
        if not (ROOT / place).exists():
            raise PageError(f"{page.path}: no {target}")
        return label

    fenced = re.split(r"(^ *```.*?^ *```)", text, flags=re.MULTILINE | re.DOTALL)
    plain = [part if part.lstrip().startswith("```") else _LINK.sub(link, part) for part in fenced]
    # Pygments does not know these.
    return re.sub(r"^( *)```cif$", r"\1```text", "".join(plain), flags=re.MULTILINE)


def _gallery(pages: list[Page]) -> str:
    """The pictures of the front page, each a link to the code that draws it."""
    items = []
    for page in pages:
        for block in page.blocks:
            if not block.picture:
                continue
            if not block.shown:
                raise PageError(f"{page.path}:{block.line}: draws no picture")
            title, name = html.escape(block.picture), _slug(block.picture)
            where = page.target.removesuffix(".md") + ".html"
            items.append(f'<a href="{where}"><img src="_static/gallery/{name}.png" alt="{title}"><span>{title}</span></a>')
    return '<div class="gallery">' + "".join(items) + "</div>"


def changed(pages: list[Page]) -> list[Page]:
    """The pages whose Python is not that which ran last."""
    ran = json.loads(RAN.read_text())
    return [page for page in pages if any(block.code for block in page.blocks) and ran.get(page.path) != page.digest]


def record(pages: list[Page]) -> None:
    """Keeps what ran."""
    digests = {page.path: page.digest for page in pages if any(block.code for block in page.blocks)}
    RAN.write_text(json.dumps(dict(sorted(digests.items())), indent=1) + "\n")


def make(out: Path, only: list[str]) -> None:
    """Writes the sources of the whole site; runs all pages, or some."""
    shutil.rmtree(out, ignore_errors=True)
    for name in ("made", "static/gallery", "extra/notebooks"):
        (out / name).mkdir(parents=True)
    pages = all_pages()
    for page in pages:
        for needs in sorted({block.needs or block.aside for block in page.blocks if block.missing}):
            print(f"SKIPPED: {page.path}: {needs} is not installed; what needs it does not run", file=sys.stderr)
    if only == ["--changed"]:
        chosen = changed(pages)
        print(f"pages: {len(chosen)} run, whose Python changed; the others are compiled only", flush=True)
    else:
        chosen = [page for page in pages if not only or page.path in only]
    # The gallery makes the library that other pages share.
    first = [page for page in chosen if page.path == "docs/gallery.md"]
    rest = [page for page in chosen if page not in first]
    for some in (first, rest):
        with ThreadPoolExecutor(AT_ONCE) as pool:
            for line in filter(None, pool.map(lambda page: run(page, out), some)):
                print(line, flush=True)
    if only in ([], ["--changed"]) and os.environ.get("STEMGEN_UPDATE"):
        record(pages)
    targets = {page.path: page.target for page in pages}
    for page in pages:
        place = out / page.target
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(written(page, targets, out))
        if page.has_notebook:
            nbformat.write(notebook(page, every=True), out / "extra/notebooks" / f"{page.slug}.ipynb")
    here = Path(__file__).parent
    for picture in (_slug(block.picture) for page in pages for block in page.blocks if block.picture and block.shown):
        shutil.move(out / "made" / f"{picture}.png", out / "static/gallery")
    front = (here / "front.md").read_text()
    (out / "index.md").write_text(front if only else front.replace("<!-- gallery -->", _gallery(pages)))
    shutil.copytree(here / "reference", out / "reference")
    shutil.copy(here / "style.css", out / "static/style.css")
    shutil.copy(here / "conf.py", out / "conf.py")


def main() -> int:
    out, *only = sys.argv[1:]
    os.environ.setdefault("STEMGEN_CACHE", str(Path(out).resolve().parent / "cache"))
    os.environ["MATPLOTLIBRC"] = str(Path(__file__).parent / "matplotlibrc")
    try:
        make(Path(out), only)
    except PageError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
