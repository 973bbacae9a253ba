"""docs/scenes.md lists every scene and every key as they are. Run with --renew to write both lists anew."""

import re
import tomllib
from pathlib import Path

import pytest

from mpsim.scene import scenefile
from mpsim.scene.scenefile import schema

PAGE = Path(__file__).parents[2] / "docs" / "scenes.md"


def names_table() -> str:
    rows = [f"| `{name}` | {title} |" for name, title in scenefile.titles().items()]
    return "\n".join(["| name | what it is |", "|---|---|", *rows])


LISTS = {"names": names_table, "keys": schema.reference}


@pytest.mark.parametrize("name", LISTS)
def test_a_list_of_the_page_is_up_to_date(name, request):
    pattern = re.compile(f"(?<=<!-- {name} -->\n).*(?=<!-- /{name} -->)", re.DOTALL)
    wanted = f"\n{LISTS[name]().strip()}\n\n"
    text = PAGE.read_text()
    if request.config.getoption("--renew"):
        PAGE.write_text(pattern.sub(lambda _: wanted, text))
    else:
        (found,) = pattern.findall(text)
        assert found == wanted, "docs/scenes.md is stale: run this test with --renew"


def test_the_example_of_the_page_is_a_scene(tmp_path):
    (example,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (tmp_path / "example.toml").write_text(example)
    file = scenefile.load(tmp_path / "example.toml")
    assert file.scene.count == tomllib.loads(example)["discs"][0]["count"]
