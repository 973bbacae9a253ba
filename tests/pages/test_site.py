"""The site is made without a warning, loads nothing from elsewhere, and holds every public name."""

import inspect
import re
import subprocess
import sys

import pytest
from support.pages import ROOT

import mpsim

pytestmark = pytest.mark.slow

LOADED = re.compile(r"""<(?:script|img|link|iframe|source)\b[^>]*?\b(?:src|href)=["'](?:https?:)?//[^"']+""")
LOADED_BY_STYLE = re.compile(r"""(?:@import|url\()\s*["']?(?:https?:)?//[^"')]+""")


def test_the_site(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(ROOT / "docs"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=280)
    assert done.returncode == 0, done.stderr
    for kind, loaded in (("html", LOADED), ("css", LOADED_BY_STYLE)):  # links that a reader may follow do not count
        assert [match for page in tmp_path.rglob(f"*.{kind}") for match in loaded.findall(page.read_text())] == []
    library, commands = ((tmp_path / "reference" / f"{name}.html").read_text() for name in ("library", "commands"))
    for module, text in ((mpsim, library), (mpsim.measure, (tmp_path / "reference" / "measure.html").read_text())):
        names = [f"{module.__name__}.{name}" for name in module.__all__ if not inspect.ismodule(getattr(module, name))]
        assert [name for name in names if f'id="{name}"' not in text] == []
    kinds = [kind for kind in vars(mpsim.errors).values() if inspect.isclass(kind) and kind.__module__[:5] == "mpsim"]
    assert len(kinds) > 25
    assert [kind for kind in kinds if f'id="{kind.__module__}.{kind.__name__}"' not in library] == []
    words = " ".join(re.sub(r"<[^>]+>", "", library).split())
    assert "position: ArrayLike, velocity: ArrayLike" in words, "types are shown as they are written"
    literal = re.findall(r"<pre>(.*?)</pre>", commands, re.DOTALL)
    assert any("mpsim run gas --until 50 --out run      " in re.sub("<.*?>", "", block) for block in literal)
    pages = sorted((tmp_path / "tutorial").glob("*.html"))
    assert len(pages) == len(list((ROOT / "docs" / "tutorial").glob("*.md")))
    for page in pages:
        (name,) = re.findall(r'href="([^"]+[.]ipynb)"', page.read_text())
        assert (page.parent / name).is_file(), "each page of the tutorial offers its notebook"
