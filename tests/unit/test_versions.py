"""The versions that pyproject.toml allows are those that scripts/run_versions.py tests and that the pages name."""

import re
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from support.scripts import fixture_of

TOP = Path(__file__).parents[2]
HERE = f"{sys.version_info[0]}.{sys.version_info[1]}"


script = fixture_of("run_versions")


def rows_of_page():
    """Rows of the table in the docs, as dictionaries."""
    page = (TOP / "docs" / "contributing.md").read_text()
    block = re.search(r"<!-- run_versions: table -->\n(.*?)<!-- end -->", page, re.DOTALL)[1]
    head, _, *rows = [[word.strip() for word in line.split("|")[1:-1]] for line in block.splitlines() if "|" in line]
    return [dict(zip(head, row, strict=True)) for row in rows]


def wrong_rows(script):
    """Rows of the lowest versions that are not the bounds."""
    return [
        (row["Python"], name)
        for row in rows_of_page()
        if row[""] == "lowest"
        for name, bound in script.lower_bounds(row["Python"].rpartition(".")[0], extras=False).items()
        if Version(row[name]) != Version(bound)
    ]


def test_every_python_has_one_lower_bound_of_everything(script):
    names = [script.lower_bounds(python).keys() for python in script.pythons()]
    assert all(each == names[0] for each in names)
    assert {"numpy", "numba", "sphinx", "pytest", "gsd"} <= names[0]


def test_a_bound_that_is_stated_twice_or_not_at_all_is_refused(script, monkeypatch):
    """The control: markers that overlap, and a dependency of any version."""
    for wrong in (["numpy>=2.0", "numpy>=2.1; python_version >= '3.13'"], ["numpy<3"]):
        monkeypatch.setattr(script, "project", lambda wrong=wrong: {"name": "mpsim", "dependencies": wrong})
        with pytest.raises(ValueError, match=r"one lower bound of numpy for Python 3\.13"):
            script.lower_bounds("3.13", extras=False)


def test_the_lowest_environment_is_held_to_the_bounds(script):
    held = [Requirement(line) for line in script.constraints(HERE, "lowest")]
    bounds = script.lower_bounds(HERE)
    assert {each.name: str(each.specifier) for each in held} == (
        {name: f"=={bound}" for name, bound in bounds.items()} | script.COMPANIONS
    )
    assert not bounds.keys() & script.COMPANIONS.keys()
    assert script.constraints(HERE, "newest") == []


def test_what_is_installed_here_is_allowed(script):
    refused = [str(each) for each in script.requirements(HERE) if version(each.name) not in each.specifier]
    assert not refused


def test_the_page_shows_every_python_with_the_bounds(script, monkeypatch):
    shown = [(row["Python"].rpartition(".")[0], row[""]) for row in rows_of_page()]
    assert shown == [(python, kind) for python in script.pythons() for kind in script.KINDS]
    assert not wrong_rows(script)
    changed = script.project()["dependencies"][0].replace(">=", ">=1!")
    monkeypatch.setattr(script, "project", lambda: {"name": "mpsim", "dependencies": [changed]})
    assert wrong_rows(script), "the control: a bound that was changed and not tried"


def test_the_pythons_are_those_of_the_policy(script):
    assert script.project()["requires-python"] == f">={script.pythons()[0]}"
    *first, last = script.pythons()
    assert f"present {', '.join(first)} and {last}" in (TOP / "docs" / "policy.md").read_text()


def a_cell(python, numba, digest, **more):
    names = ("numpy", "numba", "matplotlib", "psutil", "rich", "pydantic", "click", "orjson")
    versions = dict.fromkeys(names, "1.0") | {"python": f"{python}.1", "numba": numba}
    scenes = {"starts": {"a scene": "start"}, "digests": {"a scene": digest}}
    counts = {"passed": 3, "failed": [], "skipped": 1, "exit_code": 0, "seconds": 60.0}
    asked = {"tests": ["tests/unit"], "long": False, "commit": "abc"}
    return {"python": python, "kind": "newest", "versions": versions, "scenes": scenes, **counts, **asked, **more}


def test_digests_that_differ_are_named_under_one_compiler_only(script):
    same = [a_cell("3.11", "0.61", "x"), a_cell("3.12", "0.61", "x")]
    assert script.disagreements(same) == []
    assert "All are the same" in script.table(same, [])
    other = [*same, a_cell("3.13", "0.68", "y")]
    assert script.disagreements(other) == []
    assert "All are the same" not in script.table(other, [])
    wrong = [*same, a_cell("3.13", "0.61", "y")]
    assert script.disagreements(wrong) == ["a scene with Numba 0.61"]
    assert "**Digests differ that must not**: a scene with Numba 0.61." in script.table(wrong, [])


def test_the_table_says_what_failed_what_does_not_run_and_what_is_missing(script):
    cells = [
        a_cell("3.11", "0.61", "x", failed=["test_one"], exit_code=1),
        a_cell("3.12", "0.61", "x", broken="pip\nno such version"),
    ]
    text = script.table(cells, ["3.13"])
    assert "| 3.11.1 | newest | 1.0 | 0.61 | 1.0 | 1.0 | 1.0 | 1.0 | 1.0 | 1.0 | 3 | 1 | 1 | 1.0 | A |" in text
    assert "| 3.12 | newest | does not run: no such version |" in text
    assert "Not found on this machine: Python 3.13." in text
    assert "Installed; no tests were run." in script.table([a_cell("3.11", "0.61", "x", tests=[])], [])
    assert [script.good(found) for found in [*cells, a_cell("3.13", "0.61", "x")]] == [False, False, True]
    assert len({line.count("|") for line in text.splitlines() if line.startswith("|")}) == 1
