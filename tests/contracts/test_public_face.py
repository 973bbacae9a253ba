"""Every public name with its signature, its attributes and its fields is pinned: none changes by accident.

public_face.txt has them. After one was changed on purpose:

    python -m pytest tests/contracts/test_public_face.py --renew
"""

import dataclasses
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from packaging.version import Version

import mpsim

FILE = Path(__file__).parent / "public_face.txt"


def face_of(module: Any) -> Iterator[str]:
    """One line for each public name, and for each public attribute of a class."""
    kinds = [name for name, each in vars(module).items() if inspect.isclass(each) and issubclass(each, BaseException)]
    for name in sorted(getattr(module, "__all__", kinds), key=str.lower):
        value, path = getattr(module, name), f"{module.__name__}.{name}"
        if inspect.ismodule(value):
            yield f"{path}: a module"
        elif inspect.isclass(value) and issubclass(value, BaseException):
            yield f"{path}({', '.join(each.__name__ for each in value.__bases__)})"
        elif inspect.isclass(value):
            yield f"{path}{signature_of(value)}"
            yield from members_of(value, path)
        else:
            yield f"{path}{signature_of(value)}" if callable(value) else f"{path} = {value!r}"


def members_of(kind: type, path: str) -> Iterator[str]:
    """Methods, properties and fields of a class, with what it inherits from mpsim."""
    fields = [each.name for each in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else []
    for name in sorted({*dir(kind), *fields} - set(dir(object)), key=str.lower):
        if not name.startswith("_"):
            value = inspect.getattr_static(kind, name, None)
            inner = value.__func__ if isinstance(value, classmethod | staticmethod) else value
            yield f"    {path}.{name}{signature_of(inner) if inspect.isfunction(inner) else ''}"


def signature_of(value: Any) -> str:
    """Names of the parameters, which of them have a default, and where names are demanded: not types or values."""
    words, by_name = [], False
    for each in inspect.signature(value).parameters.values():
        if each.kind is each.KEYWORD_ONLY and not by_name:
            words.append("*")
        by_name |= each.kind in (each.KEYWORD_ONLY, each.VAR_POSITIONAL)
        stars = {each.VAR_POSITIONAL: "*", each.VAR_KEYWORD: "**"}.get(each.kind, "")
        words.append(f"{stars}{each.name}{'' if each.default is each.empty else '=...'}")
    return f"({', '.join(words)})"


def test_the_public_face_is_the_pinned_one(request):
    found = [line for module in (mpsim, mpsim.errors, mpsim.measure) for line in face_of(module)]
    if request.config.getoption("--renew"):
        FILE.write_text("\n".join(found) + "\n")
    assert found == FILE.read_text().splitlines(), "on purpose? see the top of this file"


# --- versions

TOP = Path(__file__).parents[2]


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


def test_the_pages_show_every_python_with_its_one_lower_bound_of_everything(monkeypatch):
    monkeypatch.syspath_prepend(TOP / "scripts")
    script = importlib.import_module("run_versions")
    shown = [(row["Python"].rpartition(".")[0], row[""]) for row in rows_of_page()]
    assert shown == [(python, kind) for python in script.pythons() for kind in script.KINDS]
    assert not wrong_rows(script)
    assert all(
        {"numpy", "sphinx", "pytest", "gsd"} <= script.lower_bounds(python).keys() for python in script.pythons()
    )
    assert script.project()["requires-python"] == f">={script.pythons()[0]}"
    *first, last = script.pythons()
    assert f"present {', '.join(first)} and {last}" in (TOP / "docs" / "policy.md").read_text()
    changed = script.project()["dependencies"][0].replace(">=", ">=1!")
    monkeypatch.setattr(script, "project", lambda: {"name": "mpsim", "dependencies": [changed]})
    assert wrong_rows(script), "the control: a bound that was changed and not tried"
