"""Settings of Sphinx. docs/build.sh copies this file beside the pages that docs/site/pages.py has written."""

from __future__ import annotations

import re
from typing import Any

from docutils.nodes import SkipNode
from docutils.utils.math.latex2mathml import tex2mathml

import stemworlds
import stemworlds.bench
import stemworlds.serving

project = "stemgen and stemworlds"
author = "the authors of stemgen"
copyright = author
release = stemworlds.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["extra", "static"]
myst_enable_extensions = ["dollarmath", "deflist", "attrs_inline"]
myst_dmath_double_inline = True
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]

html_theme = "furo"
html_title = "stemgen"
html_static_path = ["static"]
html_extra_path = ["extra"]
html_css_files = ["style.css"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
html_show_sourcelink = False
html_math_renderer = "mathml"
pygments_style = "friendly"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_mock_imports = ["torch"]
autodoc_type_aliases = {"RecipeLike": "RecipeLike", "FieldLike": "FieldLike", "Atoms": "Atoms", "Progress": "Progress"}
autodoc_preserve_defaults = True
maximum_signature_line_length = 90
python_use_unqualified_type_names = True
add_module_names = False
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_custom_sections = [(name, "params_style") for name in ("Test", "Defect", "Specimen", "Microscope", "Results", "Numerics", "Running", "Recipe", "Image")]


def _inline(writer: Any, node: Any) -> None:
    writer.body.append(tex2mathml(node.astext()))
    raise SkipNode


def _displayed(writer: Any, node: Any) -> None:
    writer.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise SkipNode


def _plain(_app: Any, _what: str, _name: str, _object: Any, _options: Any, signature: str, returned: str) -> tuple[str, str]:
    """Names of our own types in unions, as they are written."""
    names = (re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) if text else text for text in (signature, returned))
    return next(names), next(names)


def _apart(_app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Fields told together, ``a, b: text``, apart: Sphinx takes ``a,`` for the type of ``b``, and links it."""
    apart: list[str] = []
    place = 0
    while place < len(lines):
        end = place + 1
        if together := re.match(r"( +)(\w+(?:, \w+)+)(:.*)", lines[place]):
            indent, names, rest = together.groups()
            while end < len(lines) and lines[end].startswith(indent + " "):
                end += 1
            for name in names.split(", "):
                apart += [indent + name + rest, *lines[place + 1 : end]]
        else:
            apart.append(lines[place])
        place = end
    lines[:] = apart


def _whole(app: Any, error: Exception | None) -> None:
    """Every public name of the package stands in the reference."""
    if error is not None or app.builder.name != "html":
        return
    told = {name.rpartition(".")[2] for name in app.env.domaindata["py"]["objects"]}
    public = {*stemworlds.__all__, *stemworlds.bench.__all__, *stemworlds.serving.__all__}
    untold = sorted(public - told - {"__version__"})
    if untold:
        raise RuntimeError(f"docs/site/reference lacks {', '.join(untold)}")


def setup(app: Any) -> None:
    app.add_html_math_renderer("mathml", (_inline, None), (_displayed, None))
    app.connect("autodoc-process-docstring", _apart, priority=400)
    app.connect("autodoc-process-signature", _plain)
    app.connect("build-finished", _whole)
