"""Writes tables and pictures into pages of the docs."""

import re
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any


def fill_page(page: Path, tool: str, blocks: dict[str, str], pictures: dict[str, Path]) -> None:
    """`fill_blocks`, and files in the page's own folder.

    Args:
        page, tool, blocks: as for `fill_blocks`.
        pictures: files by the name that they have beside the page.
    """
    fill_blocks(page, tool, blocks)
    folder = page.with_suffix("")
    folder.mkdir(exist_ok=True)
    for name, source in pictures.items():
        shutil.copyfile(source, folder / name)


def begin_page(page: Path, tool: str, name: str) -> None:
    """Make a page with an empty block of that name, unless there is one."""
    if not page.exists():
        page.write_text(f"<!-- {tool}: {name} -->\n<!-- end -->\n")


def fill_blocks(page: Path, tool: str, blocks: dict[str, str]) -> None:
    """Renew what stands between `<!-- TOOL: NAME -->` and `<!-- end -->`.

    Args:
        page: a Markdown file.
        tool: the script that made the blocks, such as run_tradeoff.
        blocks: texts by NAME; what the page has no place for is left out, and what is not given stays.
    """

    def filled(match: re.Match[str]) -> str:
        return f"{match[1]}\n{blocks[match[2]]}\n{match[3]}" if match[2] in blocks else match[0]

    block = re.compile(rf"(<!-- {tool}: ([\w-]+) -->)\n.*?( *<!-- end -->)", re.DOTALL)
    page.write_text(block.sub(filled, page.read_text()))


def made_by(machine_now: dict[str, Any]) -> str:
    """Where, when and how the figures came about."""
    return (
        f"Made by `python {shlex.join(sys.argv)}` on {machine_now['usable_cores']} cores of "
        f"{machine_now['processor']}, {machine_now['date'][:10]}, commit {machine_now['commit']}."
    )
