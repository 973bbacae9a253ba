"""Every public name with its signature, its attributes and its fields is pinned: none changes by accident.

public_face.txt has them. After one was changed on purpose:

    python -m pytest tests/contracts/test_public_face.py --renew
"""

import dataclasses
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

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


def test_another_name_parameter_or_field_is_another_face():
    """The control."""

    @dataclasses.dataclass
    class Kind:
        x: int

        def act(self, one, *, two=2):
            return one, two

    @dataclasses.dataclass
    class Other(Kind):
        y: int = 0

        def act(self, one, *, two):
            return one, two

    first, second = (list(members_of(kind, "Kind")) for kind in (Kind, Other))
    assert first == ["    Kind.act(self, one, *, two=...)", "    Kind.x"]
    assert second == ["    Kind.act(self, one, *, two)", "    Kind.x", "    Kind.y"]
