"""Tests of a module lie where its name says: those of mpsim/studies/tune.py in tests/unit/studies/test_tune.py.

A second file adds what it is about: test_tune_scenes.py. What concerns the whole package lies in tests/unit itself.
"""

from pathlib import Path

import pytest
from support.script_server import PACKAGE_PARENT, TESTS

PACKAGE = PACKAGE_PARENT / "mpsim"
FILES = [path.relative_to(TESTS / "unit") for path in (TESTS / "unit").glob("*/**/test_*.py")]


def modules_of(file: Path) -> list[Path]:
    """Modules, and folders, that a file of tests may be named after."""
    name = file.stem.removeprefix("test_") + "_"
    folder = PACKAGE / file.parent
    return [path for path in folder.glob("[!_]*") if name.startswith(path.stem + "_")]


@pytest.mark.parametrize("file", FILES, ids=str)
def test_each_file_of_tests_is_named_after_a_module(file):
    assert modules_of(file), f"mpsim/{file.parent} has no module that {file.name} is named after"


def test_other_names_are_noticed():
    assert modules_of(Path("studies/test_tune.py")) == [PACKAGE / "studies" / "tune.py"]
    assert modules_of(Path("studies/test_tunes.py")) == modules_of(Path("no/test_tune.py")) == []
