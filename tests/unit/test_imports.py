"""Imports by name, which the import checker cannot see."""

import ast
from pathlib import Path

import pytest

import mpsim

PACKAGE = Path(mpsim.__file__).parent

OTHERS = {"core/interpreter.py", "core/optional_packages.py", "engine/solvers/mpi_ranks.py"}
"""Modules that look up modules of others, which may be missing."""


def imports_by_name(source):
    """Lines on which something is called that imports a module by its name."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    return [c.lineno for c in calls if ast.unparse(c.func).split(".")[-1] in ("import_module", "__import__")]


def test_only_the_package_itself_looks_up_its_modules_by_name():
    found = {str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*.py") if imports_by_name(path.read_text())}
    assert found == {"__init__.py"} | OTHERS
    assert [name for name in OTHERS if '"mpsim.' in (PACKAGE / name).read_text()] == []


@pytest.mark.parametrize("line", ["importlib.import_module('mpsim.cli')", "import_module(name)", "__import__('mpsim')"])
def test_an_import_by_name_is_seen(line):
    assert imports_by_name(f"import importlib\n{line}") == [2]
