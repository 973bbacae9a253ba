"""scripts/make_notebooks.py: a page of the tutorial as a notebook, and notebooks as Jupyter runs them."""

import json
import subprocess
import sys

import pytest
from support.pages import ROOT

pytestmark = pytest.mark.compiled

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


def make(*pages, out):
    """The script, as somebody calls it."""
    command = [sys.executable, ROOT / "scripts" / "make_notebooks.py", *pages, "--out", out]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


def test_blocks_become_cells_that_do_the_same_and_text_keeps_its_words_and_pictures(tmp_path):
    (tmp_path / "dot.png").write_bytes(bytes.fromhex("89504e470d0a1a0a"))
    (tmp_path / "page.md").write_text(SAMPLE)
    done = make(tmp_path / "page.md", out=tmp_path)
    assert done.returncode == 0, done.stderr
    cells = json.loads((tmp_path / "page.ipynb").read_text())["cells"]
    texts = ["".join(cell["source"]) for cell in cells]
    kinds = [cell["cell_type"] for cell in cells]
    tags = [cell["metadata"].get("tags", []) for cell in cells]
    assert [text for text, kind in zip(texts, kinds, strict=True) if kind == "code"] == [
        "a = 1\nfor k in range(2):\n    a += k\na",
        "1 / 0",
        "b = a",
        "!echo one",
        "!echo two; \\\n  echo three",
        "%%bash\nset -e\necho four",
        "%%writefile box.toml\n# box.toml\nschema = 1",
        "%%writefile half.py\n# half.py\nprint(1)",
    ]
    assert [text for text, each in zip(texts, tags, strict=True) if "long" in each] == ["%%bash\nset -e\necho four"]
    assert [text for text, each in zip(texts, tags, strict=True) if "raises-exception" in each] == ["1 / 0"]
    assert "```sh\nexit 1\n```" in texts
    assert texts[0] == (
        "# Title\n\nSee the other page and [elsewhere](https://example.org).\n\n![A dot of ink](attachment:dot.png)"
    )
    assert cells[0]["attachments"] == {"dot.png": {"image/png": "iVBORw0KGgo="}}
    missing = make("no.md", out=tmp_path)
    assert (missing.returncode, missing.stderr) == (
        2,
        "make_notebooks: there is no file no.md; give pages of the docs\n",
    )
