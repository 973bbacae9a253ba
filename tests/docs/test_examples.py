"""Every Python block of README.md and docs/*.md runs and prints what it says; every link to a file leads to one.

Blocks fenced as ```python are taken: those with prompts (>>>) as doctests, others as programs. The blocks of one file
share their names and run in order, in an empty folder. A block is left out only if the line before it says why:

    <!-- not run: needs a display -->
"""

import doctest
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])

BLOCK = re.compile(
    r"(?:<!-- *not run: *(?P<why>.+?) *-->\n+)?^```python *\n(?P<code>.*?)^``` *$", re.DOTALL | re.MULTILINE
)
LINK = re.compile(r"\]\((?!https?:|mailto:|#)(?P<target>[^)#\s]+)")


@dataclass(frozen=True)
class Block:
    """One fenced block: its text, and the line on which it begins, counted from 0."""

    code: str
    line: int


def blocks_of(text: str) -> list[Block]:
    """The Python blocks that are to be run."""
    return [
        Block(match["code"], text.count("\n", 0, match.start("code")))
        for match in BLOCK.finditer(text)
        if not match["why"]
    ]


def run_blocks(name: str, blocks: list[Block]) -> int:
    """Run blocks in one namespace; returns how many there were. A failure shows file, line, expected and got."""
    names: dict = {"__name__": "__main__"}
    for block in blocks:
        if ">>>" in block.code:
            test = doctest.DocTestParser().get_doctest(block.code, names, name, name, block.line)
            report: list[str] = []
            runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
            runner.run(test, out=report.append, clear_globs=False)
            assert not runner.failures, "".join(report)
            names = test.globs
        else:
            exec(compile("\n" * block.line + block.code, name, "exec"), names)
    return len(blocks)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_python_blocks_of_a_page_do_what_they_say(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_blocks(str(page), blocks_of(page.read_text()))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_to_files_lead_to_files(page):
    missing = [target for target in LINK.findall(page.read_text()) if not (page.parent / target).exists()]
    assert not missing, f"{page.name} links to {missing}, which do not exist"


def test_the_readme_shows_how_to_use_the_library():
    assert blocks_of((ROOT / "README.md").read_text()), "README.md has no Python block that is run"


SAMPLE = """
# Title

```python
>>> a = 1
>>> a + 1
2
```

```sh
exit 1
```

```python
b = a + 41
```

<!-- not run: a display is needed -->
```python
raise SystemExit
```

```python
>>> b
{answer}
```
"""


def test_blocks_share_their_names_and_run_in_order():
    assert run_blocks("sample", blocks_of(SAMPLE.format(answer=42))) == 3


def test_a_wrong_answer_in_a_block_is_noticed_with_its_line():
    """Negative control."""
    text = SAMPLE.format(answer=43)
    line = text.splitlines().index(">>> b") + 1
    with pytest.raises(AssertionError, match=rf"line {line}, in sample(.|\n)*Expected:\s*43\s*Got:\s*42"):
        run_blocks("sample", blocks_of(text))


def test_a_block_that_raises_is_noticed():
    with pytest.raises(ZeroDivisionError):
        run_blocks("sample", [Block("1 / 0\n", 0)])
