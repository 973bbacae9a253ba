"""Makes a Jupyter notebook from each page of the tutorial.

python scripts/make_notebooks.py                       all pages of the tutorial, under results/notebooks/
python scripts/make_notebooks.py docs/howto/sweeps.md  other pages
python scripts/make_notebooks.py --out FOLDER

Text becomes text, with its pictures inside the file; examples become cells without their output, commands become
cells that call the shell, and files become cells that write them. What is not run on the page is text here.
"""

import argparse
import base64
import doctest
import hashlib
import json
import re
import sys
from pathlib import Path
from typing import Any

from page_blocks import COMMAND, DRAWING, FENCE, Block, block_of

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "tutorial"

COMMENT = re.compile(r"<!--.*?-->\n*", re.DOTALL)
PICTURE = re.compile(r"!\[(?P<says>[^\]]*)\]\((?P<path>[^)\s]+\.(?P<kind>png|gif))\)")
PAGE_LINK = re.compile(r"(?<!!)\[(?P<text>[^\]]+)\]\((?!https?:)[^)\s]+\)")

KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def notebook_of(page: Path) -> dict[str, Any]:
    """A page as the JSON of a notebook, format 4.5.

    Args:
        page: a Markdown file of the docs.

    Raises:
        FileNotFoundError: there is no such page, or a picture that it shows.
    """
    text = page.read_text()
    cells: list[dict[str, Any]] = []
    end = 0
    for match in FENCE.finditer(text):
        cells += words(text[end : match.start()], page.parent)
        cells += cells_of(block_of(match, text))
        end = match.end()
    cells += words(text[end:], page.parent)
    for number, cell in enumerate(cells):
        cell["id"] = hashlib.sha256(f"{page.stem} {number}".encode()).hexdigest()[:8]
    return {"cells": cells, "metadata": {"kernelspec": KERNEL}, "nbformat": 4, "nbformat_minor": 5}


def words(text: str, folder: Path) -> list[dict[str, Any]]:
    """Text between two blocks: comments left out, pictures inside the file, links between pages as plain words."""
    text = PAGE_LINK.sub(lambda match: match["text"], COMMENT.sub("", text)).strip()
    attachments: dict[str, dict[str, str]] = {}

    def attached(match: re.Match[str]) -> str:
        path = folder / match["path"]
        attachments[path.name] = {f"image/{match['kind']}": base64.b64encode(path.read_bytes()).decode()}
        return f"![{' '.join(match['says'].split())}](attachment:{path.name})"

    text = PICTURE.sub(attached, text)
    if not text:
        return []
    cell = {"cell_type": "markdown", "metadata": {}, "source": text}
    return [cell | {"attachments": attachments} if attachments else cell]


def cells_of(block: Block) -> list[dict[str, Any]]:
    """The cells of one block, with the tags `long`, and `raises-exception` where the page shows an error."""
    if block.why or block.language == DRAWING:
        return [{"cell_type": "markdown", "metadata": {}, "source": f"```{block.language}\n{block.code}```"}]
    return [
        {
            "cell_type": "code",
            "execution_count": None,
            "metadata": {"tags": tags} if tags else {},
            "outputs": [],
            "source": source.rstrip(),
        }
        for source, fails in sources(block)
        for tags in [["long"] * block.long + ["raises-exception"] * fails]
    ]


def sources(block: Block) -> list[tuple[str, bool]]:
    """What the cells of a block that is run contain, and whether each ends with an error, as the page shows it.

    A cell shows its last value, so it ends where the page shows one.
    """
    if block.file:
        return [(f"%%writefile {block.file}\n{block.code}", False)]
    if block.language == "sh":
        return [(f"%%bash\nset -e\n{block.code}", False)]
    if block.language == "console":
        return [(f"!{match['command']}", False) for match in COMMAND.finditer(block.code)]
    if ">>>" not in block.code:
        return [(block.code, False)]
    found, begun = [], ""
    for example in doctest.DocTestParser().get_examples(block.code):
        begun += example.source
        if example.want:
            found.append((begun, example.exc_msg is not None))
            begun = ""
    return [*found, (begun, False)] if begun else found


def write(pages: list[Path], folder: Path) -> list[Path]:
    """Write the notebooks of pages into a folder, which is made; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for page in pages:
        path = folder / f"{page.stem}.ipynb"
        path.write_text(json.dumps(notebook_of(page), indent=1, ensure_ascii=False) + "\n")
        written.append(path)
    return written


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="*", type=Path, help="Markdown files; default: the tutorial")
    parser.add_argument("--out", type=Path, default=Path("results/notebooks"))
    options = parser.parse_args()
    try:
        written = write(options.pages or sorted(PAGES.glob("*.md")), options.out)
    except FileNotFoundError as error:
        print(f"make_notebooks: there is no file {error.filename}; give pages of the docs", file=sys.stderr)
        return 2
    for path in written:
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
