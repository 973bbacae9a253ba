"""The files of the page. They are read once from the package; no name from a request becomes a path."""

import base64
import json
import re
from dataclasses import dataclass
from functools import cache
from importlib import resources

KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
"""Media types of the files, by extension."""

WIDGET = "widget.js"
"""The only file that is used in notebooks alone."""

_FOLDER = resources.files("mpsim.viewer").joinpath("page")

_IMPORT, _BARE = re.compile(r'\b(import|from) "\./([\w-]+\.js)"'), r'\1 "mpsim/\2"'
"""How a module imports another module of the page, and how it does so with an import map."""

_INDENT = re.compile(r"^ +", re.MULTILINE)
"""Indentation, which is removed to make notebooks smaller."""


@dataclass(frozen=True)
class PageFile:
    """One file: its content and its media type."""

    content: bytes
    kind: str


@cache
def page_files() -> dict[str, PageFile]:
    """All files of the page, by the name that a browser requests; the page itself has the empty name.

    >>> [name in page_files() for name in ("", "page.css", "page.js", "index.html", "widget.js")]
    [True, True, True, False, False]
    """
    found = {}
    for file in _FOLDER.iterdir():
        ending = file.name.rpartition(".")[2]
        if ending in KINDS and file.name != WIDGET:
            name = "" if file.name == "index.html" else file.name
            found[name] = PageFile(file.read_bytes(), f"{KINDS[ending]}; charset=utf-8")
    return found


@cache
def page_in_one() -> str:
    """The page as a single HTML text for a notebook. It contains the style sheet, and the modules in an import map.

    >>> text = page_in_one()
    >>> 'data-place="notebook"' in text, 'src="page.js"' in text, "mpsim/stage.js" in text
    (True, False, True)
    """
    files = {name: _INDENT.sub("", file.content.decode()) for name, file in page_files().items()}
    modules = {
        f"mpsim/{name}": f"data:text/javascript;base64,{_base64(_IMPORT.sub(_BARE, text))}"
        for name, text in files.items()
        if name.endswith(".js")
    }
    imports = json.dumps({"imports": modules})
    script = f'<script type="importmap">{imports}</script>\n<script type="module">import "mpsim/page.js";</script>'
    text = files[""]
    for found, instead in (
        ('<html lang="en">', '<html lang="en" data-place="notebook">'),
        ('<link rel="stylesheet" href="page.css">', f"<style>{files['page.css']}</style>"),
        ('<script type="module" src="page.js"></script>', script),
    ):
        assert text.count(found) == 1, found  # the page has been changed
        text = text.replace(found, instead)
    return text


def widget_module() -> str:
    """The JavaScript module of the widget that shows the page in a notebook."""
    return f"{_FOLDER.joinpath(WIDGET).read_text()}\nconst PAGE = {json.dumps(page_in_one())};\n"


def _base64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()
