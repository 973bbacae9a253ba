"""How Sphinx makes these pages: `sphinx-build -W docs docs/_build`. Nothing is fetched from elsewhere."""

from typing import Any

import mpsim

project = "mpsim"
author = "the mpsim developers"
version = release = mpsim.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_click"]
exclude_patterns = ["_build"]
default_role = "py:obj"  # names in docstrings lead to what they name, where that is documented
myst_heading_anchors = 3  # links such as accuracy.md#the-frontier
suppress_warnings = ["myst.header"]  # pages that scripts write in parts begin below the first level

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"mpsim {release}"
html_copy_source = False
html_show_sphinx = False


def name_tables(_: Any, page: str, source: list[str]) -> None:
    """Give a page that is a table and no more a title. Links lead to it, but no table of contents."""
    if not source[0].lstrip().startswith("#"):
        title = page.rsplit("/", maxsplit=1)[-1].replace("-", " ").replace("_", " ").capitalize()
        source[0] = f"---\norphan: true\n---\n\n# {title}\n\n{source[0]}"


def keep_bars(_app: Any, _what: str, _name: str, _of: Any, _options: Any, lines: list[str]) -> None:
    """Let |v| in a docstring be the size of v; reStructuredText would take it for a substitution."""
    example = False
    for number, line in enumerate(lines):
        example = bool(line.strip()) and (example or line.lstrip().startswith(">>>"))
        if not example:
            lines[number] = line.replace("|", r"\|")


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", keep_bars)
    app.connect("source-read", name_tables)
