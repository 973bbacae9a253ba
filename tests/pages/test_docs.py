"""The docs: every block runs and prints what it says, links lead somewhere, docstrings and lists are complete.

How each kind of block is run, and how one is left out, is written in support/pages.py.
"""

import inspect
import re
from collections.abc import Iterator
from types import FunctionType, ModuleType
from typing import Any

import pytest
from support.commands import mpsim_command
from support.pages import DRAWING, EXECUTED, PAGES, ROOT, blocks_of, run_blocks

import mpsim
from mpsim import measure
from mpsim.measure import reference
from mpsim.scene import scenefile

pytestmark = pytest.mark.compiled

LONG = ["collisions.md", "correlations.md", "dense-starts.md"]
"""Pages of `howto` whose blocks compile for half a minute."""

SELECTED = [
    pytest.param(
        page, marks=() if page.name == "README.md" else pytest.mark.long if page.name in LONG else pytest.mark.slow
    )
    for page in PAGES
]

LINK = re.compile(r"\]\((?!https?:|mailto:|#)(?P<target>[^)#\s]+)")


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


# --- blocks of pages


@pytest.mark.parametrize("page", SELECTED, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_blocks_of_a_page_do_what_they_say(page, request):
    run_blocks(str(page), blocks_of(page.read_text()), request.config.getoption("--long"))


def test_no_block_of_a_page_escapes_and_links_to_files_lead_to_files():
    """Each block is of a kind that is run, or says why not; drawings hold neither commands nor prompts."""
    for page in PAGES:
        text, wrong = page.read_text(), f"{page.relative_to(ROOT)}, line {{}}: "
        blocks = blocks_of(text)
        commands = "".join(block.code for block in blocks if block.language in ("sh", "console") and not block.why)
        for block in blocks:
            here = wrong.format(block.line)
            assert block.language in (*EXECUTED, DRAWING), f"{here}nobody runs {block.language!r}"
            assert not (block.language == "python" and block.file) or block.file in commands, f"{here}nobody runs it"
            assert block.language != DRAWING or not re.search(r"^(>>>|\$) ", block.code, re.MULTILINE), here
        missing = [target for target in LINK.findall(text) if not (page.parent / target).exists()]
        assert not missing, f"{page.name} links to {missing}, which do not exist"


def test_a_block_that_does_not_do_what_it_says_is_found():
    for block in ("python\n>>> 6 * 7\n41\n", "console\n$ echo one\ntwo\n", "sh\nexit 1\n", "python\nassert 0\n"):
        with pytest.raises(AssertionError):
            run_blocks("sample", blocks_of(f"```{block}```\n"))


# --- lists on pages


def test_the_list_of_scenes_is_up_to_date(request):
    """Run with --renew to write it anew."""
    page, names = ROOT / "docs" / "scenes.md", mpsim_command("scenes").output
    rows = [f"| `{name}` | {title} |\n" for name, title in re.findall(r"^([\w-]+) {2,}(\S.*)$", names, re.MULTILINE)]
    wanted = f"\n| name | what it is |\n|---|---|\n{''.join(rows)}\n"
    pattern = re.compile("(?<=<!-- names -->\n).*(?=<!-- /names -->)", re.DOTALL)
    if request.config.getoption("--renew"):
        page.write_text(pattern.sub(lambda _: wanted, page.read_text()))
    assert pattern.findall(page.read_text()) == [wanted], "docs/scenes.md is stale: run this test with --renew"


def test_the_page_has_every_key_of_a_scene_file_and_no_other():
    _, _, text = (ROOT / "docs" / "scenes.md").read_text().partition("## All keys")
    listed = {}
    for section in text.split("\n### "):
        if found := re.match(r"The file itself()|`\[+(\w+)\]+`", section):
            first = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
            listed.setdefault(found[2] or "", set()).update(re.findall(r"`(\w+)`", " ".join(first)))
    assert listed == {table: set(scenefile.keys_of(table)) for table in listed}
    assert {*listed} == {*scenefile.KEYS, *scenefile.PARTS} - {"settings"}


def test_the_map_of_the_modules_leaves_none_out():
    page = (ROOT / "docs" / "architecture.md").read_text()
    paths = list((ROOT / "mpsim").rglob("[!_]*.py"))
    assert [str(path) for path in paths if not re.search(rf"\b{path.stem}\b", page)] == []


# --- docstrings of public names, whose examples --doctest-modules runs

MADE_BY = {
    "Report": mpsim.Simulation,
    "Tradeoff": mpsim.tradeoff,
    "Tuned": mpsim.tune,
    "Equilibration": measure.equilibration,
    "Overlap": measure.overlap,
    "SpeedDistribution": measure.speed_distribution,
    "TrajectoryDeviation": measure.trajectory_error,
    "TwoDiscs": reference.two_discs,
    "View": mpsim.view,
}
"""Results, which nobody makes by hand, and whose example shows one."""


def members(module: ModuleType) -> dict[str, Any]:
    """Public names of a module and what they stand for."""
    names = getattr(module, "__all__", None) or [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ]
    return {f"{module.__name__}.{name}": getattr(module, name) for name in names}


PUBLIC = {
    name: value
    for module in (mpsim, measure, reference)
    for name, value in members(module).items()
    if callable(value) and not isinstance(value, ModuleType)
}


def parts(owner: type) -> Iterator[tuple[str, Any]]:
    """Public methods and properties that a class defines itself."""
    for name, value in vars(owner).items():
        if not name.startswith("_") and isinstance(value, FunctionType | property | classmethod | staticmethod):
            yield name, value


def is_exception(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, BaseException)


def text_of(value: Any) -> str:
    """The docstring, if somebody wrote one: a dataclass without makes its own."""
    text = inspect.getdoc(value) or ""
    return "" if text.startswith(f"{getattr(value, '__name__', '')}(") else text


def unnamed(value: Any) -> list[str]:
    """Arguments that the docstring does not name."""
    function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
    names = [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]
    return [each for each in names if not re.search(rf"\b{each}\b", text_of(value))]


def problems(name: str, value: Any) -> list[str]:
    """What the docstring of a public name lacks."""
    text, found = text_of(value), []
    if not text:
        return [f"{name} has no docstring"]
    if is_exception(value):
        return []
    result = isinstance(value, type) and value.__name__ in MADE_BY
    record = isinstance(value, type) and "Attributes:" in text  # which checks nothing
    in_reference = value.__module__ == reference.__name__  # whose docstring says what all of them raise
    if ">>>" not in (text_of(MADE_BY[value.__name__]) if result and ">>>" not in text else text):
        found.append(f"{name} has no example")
    if missing := unnamed(value):
        found.append(f"{name} does not say what {', '.join(missing)} are")
    if inspect.signature(value).parameters and not record and "Raises:" not in text and not in_reference:
        found.append(f"{name} does not say what it raises")
    if not re.search(r"\[\w[^\]]*\]", text):
        found.append(f"{name} gives no dimension")
    return found


def test_every_public_name_says_what_it_is():
    """Its arguments by name, their dimensions, what it raises, an example; types are shown as they are written."""
    found = [problem for name, value in PUBLIC.items() for problem in problems(name, value)]
    for name, owner in PUBLIC.items():
        of_class = list(parts(owner)) if isinstance(owner, type) else []
        for part, value in of_class:
            if not text_of(value):
                found.append(f"{name}.{part} has no docstring")
            elif not isinstance(value, property) and unnamed(value):
                found.append(f"{name}.{part} does not say what {unnamed(value)} are")
        if not is_exception(owner):
            doors = [owner, *(value for _, value in of_class if not isinstance(value, property))]
            shown = [str(inspect.signature(getattr(each, "__func__", each))) for each in doors]
            found += [each for each in shown if re.search(r"numpy\.|_typing|collections\.abc|mpsim\.", each)]
    functions = {name: value for name, value in members(reference).items() if inspect.isfunction(value)}
    found += [f"{name} names no source" for name, value in functions.items() if "ource" not in text_of(value)]
    assert found == []
