"""The code blocks of a page of the docs, for tests and notebooks."""

import re
from dataclasses import dataclass

EXECUTED = ("python", "console", "sh", "toml")
DRAWING = "text"

FENCE = re.compile(
    r"(?:<!-- *(?:not run: *(?P<why>.+?)|(?P<long>long)) *-->\n+)?"
    r"^(?P<ticks>`{3,})(?P<language>[^\n`]*)\n(?P<code>.*?)^(?P=ticks) *$",
    re.DOTALL | re.MULTILINE,
)
COMMAND = re.compile(r"^\$ (?P<command>(?:.*\\\n)*.*)\n(?P<output>(?:(?!\$ ).*\n)*)", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """One fenced block: language, text, the line on which the text begins, counted from 0, and why it is not run."""

    language: str
    code: str
    line: int
    why: str | None = None
    long: bool = False

    @property
    def file(self) -> str | None:
        """Name of the file that a block of Python or a scene is kept in; None if it is executed."""
        match = re.match(r"# (\S+\.(?:py|toml))\n", self.code)
        if self.language == "toml":
            return match[1] if match else "scene.toml"
        return match[1] if match and self.language == "python" else None


def block_of(match: re.Match[str], text: str) -> Block:
    """The block that FENCE found in a text."""
    line = text.count("\n", 0, match.start("code"))
    return Block(match["language"].strip(), match["code"], line, match["why"], bool(match["long"]))


def blocks_of(text: str) -> list[Block]:
    """All fenced blocks but directives of the pages' generator, such as tables of contents."""
    found = [block_of(match, text) for match in FENCE.finditer(text)]
    return [block for block in found if not block.language.startswith("{")]
