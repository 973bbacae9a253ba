"""scripts/make_notebooks.py: cells of a page, and the notebooks of the tutorial as Jupyter runs them."""

import json
import os
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from support.pages import ROOT
from support.scripts import fixture_of

script = fixture_of("make_notebooks")

TUTORIAL = sorted((ROOT / "docs" / "tutorial").glob("*.md"))
CHEAP = "3-inside-a-frame"

SAMPLE = """# Title

See [the other page](other.md#part) and [elsewhere](https://example.org).

<!-- made by a script -->
![A dot
of ink](dot.png)

```python
>>> a = 1
>>> for k in range(2):
...     a += k
>>> a
2
>>> 1 / 0
Traceback (most recent call last):
    ...
ZeroDivisionError: division by zero
>>> b = a
```

<!-- not run: it would end the tests -->
```sh
exit 1
```

```console
$ echo one
one
$ echo two; \\
  echo three
two
three
```

<!-- long -->
```sh
echo four
```

```toml
# box.toml
schema = 1
```

```python
# half.py
print(1)
```
"""

PIXEL = bytes.fromhex("89504e470d0a1a0a")


@pytest.fixture
def sample(tmp_path):
    (tmp_path / "dot.png").write_bytes(PIXEL)
    page = tmp_path / "page.md"
    page.write_text(SAMPLE)
    return page


def test_blocks_become_cells_that_do_the_same(script, sample):
    cells = script.notebook_of(sample)["cells"]
    assert [cell["source"] for cell in cells if cell["cell_type"] == "code"] == [
        "a = 1\nfor k in range(2):\n    a += k\na",
        "1 / 0",
        "b = a",
        "!echo one",
        "!echo two; \\\n  echo three",
        "%%bash\nset -e\necho four",
        "%%writefile box.toml\n# box.toml\nschema = 1",
        "%%writefile half.py\n# half.py\nprint(1)",
    ]
    assert [cell["source"] for cell in cells if "long" in cell["metadata"].get("tags", [])] == [
        "%%bash\nset -e\necho four"
    ]
    assert [cell["source"] for cell in cells if "raises-exception" in cell["metadata"].get("tags", [])] == ["1 / 0"]
    assert "```sh\nexit 1\n```" in [cell["source"] for cell in cells if cell["cell_type"] == "markdown"]


def test_text_keeps_its_words_and_pictures_and_loses_what_leads_to_other_pages(script, sample):
    first = script.notebook_of(sample)["cells"][0]
    assert first["source"] == (
        "# Title\n\nSee the other page and [elsewhere](https://example.org).\n\n![A dot of ink](attachment:dot.png)"
    )
    assert first["attachments"] == {"dot.png": {"image/png": "iVBORw0KGgo="}}


def test_the_notebooks_of_all_pages_are_valid_and_hold_all_their_blocks(script, tmp_path):
    for path in script.write(TUTORIAL, tmp_path):
        notebook = nbformat.read(path, as_version=4)
        nbformat.validate(notebook)
        assert [cell for cell in notebook.cells if cell.cell_type == "code"], path.name


def test_a_page_that_is_missing_is_named(script, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["make_notebooks", "no.md", "--out", str(tmp_path)])
    assert script.main() == 2
    assert capsys.readouterr().err == "make_notebooks: there is no file no.md; give pages of the docs\n"


def execute(notebook: dict, folder: Path) -> nbformat.NotebookNode:
    """The notebook with its outputs, run in a folder with the programs of this Python."""
    node = nbformat.reads(json.dumps(notebook), as_version=4)
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
    }
    client = NotebookClient(node, timeout=170, resources={"metadata": {"path": str(folder)}})
    return client.execute(env=environment)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[] if page.stem == CHEAP else [pytest.mark.long, pytest.mark.timeout(900)])
        for page in TUTORIAL
    ],
    ids=lambda page: page.stem,
)
def test_the_notebook_of_a_page_runs(script, page, tmp_path):
    done = execute(script.notebook_of(page), tmp_path)
    assert [cell for cell in done.cells if cell.cell_type == "code" and cell.outputs]


@pytest.mark.long
def test_a_cell_that_fails_is_an_error(script, sample, tmp_path):
    """Negative control."""
    sample.write_text("# T\n\n```sh\nexit 3\n```\n")
    with pytest.raises(CellExecutionError, match="exit status 3"):
        execute(script.notebook_of(sample), tmp_path)
