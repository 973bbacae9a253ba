"""Every block of README.md and the docs runs and prints what it says; every link to a file leads to one.

How each kind of block is run, and how one is left out, is written in support/pages.py.
"""

import re

import pytest
from support.pages import DRAWING, EXECUTED, PAGES, ROOT, Block, blocks_of, run_blocks
from support.selection import slow_but

FIRST = [ROOT / "README.md", ROOT / "docs" / "tutorial" / "1-first-run.md"]
"""Pages whose blocks are run by default."""

LINK = re.compile(r"\]\((?!https?:|mailto:|#)(?P<target>[^)#\s]+)")


@pytest.mark.parametrize("page", slow_but(PAGES, *FIRST), ids=lambda page: str(page.relative_to(ROOT)))
def test_the_blocks_of_a_page_do_what_they_say(page, tmp_path, monkeypatch, request):
    monkeypatch.chdir(tmp_path)
    run_blocks(str(page), blocks_of(page.read_text()), request.config.getoption("--long"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_block_of_a_page_escapes(page):
    """Each block is of a kind that is run, or says why not; drawings hold neither commands nor prompts."""
    blocks = blocks_of(page.read_text())
    commands = "".join(block.code for block in blocks if block.language in ("sh", "console") and not block.why)
    for block in blocks:
        assert block.language in (*EXECUTED, DRAWING), f"line {block.line}: nobody runs {block.language!r}"
        if block.language == "python" and block.file:
            assert block.file in commands, f"line {block.line}: no command runs {block.file}"
        if block.language == DRAWING:
            assert not re.search(r"^(>>>|\$) ", block.code, re.MULTILINE), f"line {block.line}: commands in a drawing"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_to_files_lead_to_files(page):
    missing = [target for target in LINK.findall(page.read_text()) if not (page.parent / target).exists()]
    assert not missing, f"{page.name} links to {missing}, which do not exist"


def test_the_readme_shows_how_to_use_the_library():
    assert any(block.language == "python" for block in blocks_of((ROOT / "README.md").read_text()))


SAMPLE = """
# Title

```python
>>> a = 1
>>> a + 1
2
```

<!-- not run: it would end the tests -->
```sh
exit 1
```

```python
b = a + 41
```

```text
a --> b
```

```{{toctree}}
page
```

```console
$ echo one; \\
  echo two
one
...
$ python -c "print(6 * 7)"
{answer}
```

<!-- long -->
```sh
exit 1
```

```toml
# box.toml
schema = 1
width = 4.0
height = 4.0
```

```sh
mpsim show box.toml
```

```python
# half.py
print({answer} // 2)
```

```console
$ python half.py
21
```

```python
>>> b
{answer}
```
"""


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_blocks_share_their_names_and_their_folder_and_run_in_order():
    assert run_blocks("sample", blocks_of(SAMPLE.format(answer=42))) == 8


def test_a_wrong_answer_in_a_block_is_noticed_with_its_line():
    """Negative control."""
    text = SAMPLE.format(answer=42).replace(">>> b\n42", ">>> b\n43")
    line = text.splitlines().index(">>> b") + 1
    with pytest.raises(AssertionError, match=rf"line {line}, in sample(.|\n)*Expected:\s*43\s*Got:\s*42"):
        run_blocks("sample", blocks_of(text))


def test_a_wrong_output_of_a_command_is_noticed():
    with pytest.raises(AssertionError, match=r"line \d+: \$ python(.|\n)*Expected:\s*43\s*Got:\s*42"):
        run_blocks("sample", blocks_of(SAMPLE.format(answer=43)))


@pytest.mark.parametrize(
    ("block", "error"),
    [
        (Block("python", "1 / 0\n", 0), ZeroDivisionError),
        (Block("sh", "false\necho on\n", 0), AssertionError),
        (Block("console", "no command\n", 0), AssertionError),
        (Block("toml", "schema = 2\n", 0), ValueError),
        (Block("perl", "1", 0), AssertionError),
    ],
    ids=lambda value: getattr(value, "language", ""),
)
def test_a_block_that_fails_is_noticed(block, error):
    with pytest.raises(error):
        run_blocks("sample", [block])


def test_under_long_what_takes_long_runs_too():
    with pytest.raises(AssertionError):
        run_blocks("sample", blocks_of(SAMPLE.format(answer=42)), long=True)
