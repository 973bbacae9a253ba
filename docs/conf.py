"""How Sphinx makes these pages: `sphinx-build -W docs docs/_build`. Nothing is fetched from elsewhere."""

import inspect
import sys
from pathlib import Path
from typing import Any

import mpsim

sys.path.append(str(Path(mpsim.__file__).parents[1] / "scripts"))

import make_notebooks

project = "mpsim"
author = "the mpsim developers"
version = release = mpsim.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_click",
    "sphinx_copybutton",
]
exclude_patterns = ["_build"]
default_role = "py:obj"  # names in docstrings lead to what they name, where that is documented
smartquotes = False  # --dt stays --dt, also in help texts
myst_heading_anchors = 3  # links such as accuracy.md#the-frontier
suppress_warnings = ["myst.header"]  # pages that scripts write in parts begin below the first level

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"mpsim {release}"
html_copy_source = False
html_show_sphinx = False

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
copybutton_only_copy_prompt_lines = True  # commands without their output

TUTORIAL = "tutorial/"
"""Pages that are also notebooks."""


def name_tables(_: Any, page: str, source: list[str]) -> None:
    """Give a page that is a table and no more a title. Links lead to it, but no table of contents."""
    if not source[0].lstrip().startswith("#"):
        title = page.rsplit("/", maxsplit=1)[-1].replace("-", " ").replace("_", " ").capitalize()
        source[0] = f"---\norphan: true\n---\n\n# {title}\n\n{source[0]}"


def offer_notebook(_: Any, page: str, source: list[str]) -> None:
    """Put a link to its notebook under the title of a page of the tutorial."""
    if page.startswith(TUTORIAL):
        name = f"{page.removeprefix(TUTORIAL)}.ipynb"
        link = f'<p><a class="reference download" href="{name}" download>Download this page as a notebook</a></p>'
        title, _newline, rest = source[0].partition("\n")
        source[0] = f"{title}\n\n```{{raw}} html\n{link}\n```\n{rest}"


def write_notebooks(app: Any, failure: Exception | None) -> None:
    """Make the notebooks beside the pages of the tutorial."""
    pages = sorted((Path(app.srcdir) / TUTORIAL).glob("*.md"))
    if failure is None and app.builder.format == "html" and pages:
        make_notebooks.write(pages, Path(app.outdir) / TUTORIAL)


def keep_bars(_app: Any, _what: str, _name: str, _of: Any, _options: Any, lines: list[str]) -> None:
    """Let |v| in a docstring be the size of v; reStructuredText would take it for a substitution."""
    example = False
    for number, line in enumerate(lines):
        example = bool(line.strip()) and (example or line.lstrip().startswith(">>>"))
        if not example:
            lines[number] = line.replace("|", r"\|")


class Written(str):
    """A type as it is written in the source, which signatures show without quotes."""

    def __repr__(self) -> str:
        return str(self)


def shorten_signature(
    _app: Any, what: str, _name: str, of: Any, _options: Any, signature: str | None, returns: str | None
) -> tuple[str | None, str | None] | None:
    """Show types as they are written, such as ArrayLike, instead of spelled out."""
    if what not in ("class", "function", "method") or not signature:
        return None
    found = inspect.signature(of)
    given = [each for each in found.parameters.values() if each.name not in ("self", "cls")]
    shown = [
        each.replace(annotation=Written(each.annotation)) if isinstance(each.annotation, str) else each
        for each in given
    ]
    if isinstance(found.return_annotation, str) and what != "class":
        returns = found.return_annotation
    return str(found.replace(parameters=shown, return_annotation=inspect.Signature.empty)), returns


def keep_examples(_app: Any, _command: Any, lines: list[str]) -> None:
    """Show the examples of a command as literal text, to be copied."""
    if lines:
        kept = [line.removeprefix("| ") for line in lines if line.strip() != "|"]
        lines[:] = [
            "Examples:",
            "",
            ".. code-block:: text",
            "",
            *(f"   {line}" for line in kept if line.strip() != "Examples:"),
        ]


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", keep_bars)
    app.connect("autodoc-process-signature", shorten_signature)
    app.connect("sphinx-click-process-epilog", keep_examples)
    app.connect("source-read", name_tables)
    app.connect("source-read", offer_notebook)
    app.connect("build-finished", write_notebooks)
