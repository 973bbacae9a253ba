"""The pages are made without a warning, and load nothing from elsewhere."""

import inspect
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.pages import ROOT

import mpsim

pytestmark = pytest.mark.slow

LOADED = re.compile(r"""<(?:script|img|link|iframe|source)\b[^>]*?\b(?:src|href)=["'](?:https?:)?//[^"']+""")
LOADED_BY_STYLE = re.compile(r"""(?:@import|url\()\s*["']?(?:https?:)?//[^"')]+""")


def build(pages: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """Sphinx as the checks call it: warnings are errors."""
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(pages), str(out)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=170)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("site")
    done = build(ROOT / "docs", out)
    assert done.returncode == 0, done.stderr
    return out


def loaded_from_elsewhere(site: Path) -> list[str]:
    """What a browser would fetch from another machine to show a page. Links that a reader may follow do not count."""
    found = [match for page in site.rglob("*.html") for match in LOADED.findall(page.read_text())]
    return found + [match for style in site.rglob("*.css") for match in LOADED_BY_STYLE.findall(style.read_text())]


def test_the_map_of_the_modules_leaves_none_out():
    page = (ROOT / "docs" / "architecture.md").read_text()
    paths = list((ROOT / "mpsim").rglob("[!_]*.py"))
    assert [str(path) for path in paths if not re.search(rf"\b{path.stem}\b", page)] == []


def test_the_site_is_made_without_warnings_and_loads_nothing_from_elsewhere(site):
    assert loaded_from_elsewhere(site) == []


def test_what_is_loaded_from_elsewhere_is_seen(tmp_path):
    """Negative control."""
    (tmp_path / "a.html").write_text('<a href="https://a.org">go</a> <link rel="x" href="https://b.org/c.css">')
    (tmp_path / "a.css").write_text("@import url(//fonts.org/a); body { background: url(here.png) }")
    assert [re.sub(r"\W", "", found)[-7:] for found in loaded_from_elsewhere(tmp_path)] == ["borgccss"[-7:], "ntsorga"]


@pytest.mark.parametrize(
    ("module", "page"), [(mpsim, "library"), (mpsim.measure, "measure")], ids=["mpsim", "mpsim.measure"]
)
def test_every_public_name_is_in_the_reference(module, page, site):
    text = (site / "reference" / f"{page}.html").read_text()
    names = [f"{module.__name__}.{name}" for name in module.__all__ if not inspect.ismodule(getattr(module, name))]
    assert [name for name in names if f'id="{name}"' not in text] == []


def test_every_exception_is_in_the_reference(site):
    text = (site / "reference" / "library.html").read_text()
    kinds = [kind for kind in vars(mpsim.errors).values() if inspect.isclass(kind) and kind.__module__[:5] == "mpsim"]
    assert len(kinds) > 25
    assert [kind for kind in kinds if f'id="{kind.__module__}.{kind.__name__}"' not in text] == []


def test_signatures_show_types_as_they_are_written(site):
    text = re.sub(r"<[^>]+>", "", (site / "reference" / "library.html").read_text())
    assert "position: ArrayLike, velocity: ArrayLike" in " ".join(text.split())


def test_each_page_of_the_tutorial_offers_its_notebook(site):
    pages = sorted((site / "tutorial").glob("*.html"))
    assert len(pages) == len(list((ROOT / "docs" / "tutorial").glob("*.md")))
    for page in pages:
        (name,) = re.findall(r'href="([^"]+[.]ipynb)"', page.read_text())
        assert (page.parent / name).is_file(), name


def test_examples_of_commands_are_literal_text(site):
    text = (site / "reference" / "commands.html").read_text()
    literal = re.findall(r"<pre>(.*?)</pre>", text, re.DOTALL)
    assert any("mpsim run gas --until 50 --out run      " in re.sub("<.*?>", "", block) for block in literal)


def test_pages_that_lead_nowhere_are_errors(tmp_path):
    """Negative control."""
    shutil.copy(ROOT / "docs" / "conf.py", tmp_path)
    (tmp_path / "index.md").write_text("# A\n\n[b](b.md)\n\n```{eval-rst}\n.. autofunction:: mpsim.nothing\n```\n")
    done = build(tmp_path, tmp_path / "out")
    assert done.returncode != 0
    assert "cross-reference target not found: 'b.md'" in done.stderr
    assert "failed to import 'nothing'" in done.stderr
