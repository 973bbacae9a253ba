"""The files of the page, as they are sent: read once from the package; no name from outside ever becomes a path."""

from dataclasses import dataclass
from functools import cache
from importlib import resources

KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
"""Types of the files, by their ending."""


@dataclass(frozen=True)
class PageFile:
    """One file: its content, and its type as HTTP says it."""

    content: bytes
    kind: str


@cache
def page_files() -> dict[str, PageFile]:
    """All files of the page, by the name that a browser asks for; the page itself has the empty name.

    >>> " ".join(sorted(page_files()))
    ' common.js decode.js discs.js gauges.js hands.js keep.js link.js page.css page.js sliders.js stage.js'
    """
    found = {}
    for file in resources.files("mpsim.viewer").joinpath("page").iterdir():
        ending = file.name.rpartition(".")[2]
        if ending in KINDS:
            name = "" if file.name == "index.html" else file.name
            found[name] = PageFile(file.read_bytes(), f"{KINDS[ending]}; charset=utf-8")
    return found
