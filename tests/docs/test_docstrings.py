"""Every public name says what it is: its arguments by name, their dimensions, what it raises, an example.

Public are the names in `__all__` of mpsim and mpsim.measure, their public methods and properties, and what the two
modules of closed forms and published values define. Examples are run by --doctest-modules, with the rest of the tests.
"""

import inspect
import re
from collections.abc import Iterator
from types import FunctionType, ModuleType
from typing import Any

import pytest

import mpsim
from mpsim import measure
from mpsim.measure import reference, reference_motion

MADE_BY = {
    "Report": mpsim.Simulation,
    "Tradeoff": mpsim.tradeoff,
    "Tuned": mpsim.tune,
    "Equilibration": measure.equilibration,
    "HexaticCorrelation": measure.hexatic_correlation,
    "HexaticOrder": measure.hexatic_order,
    "Overlap": measure.overlap,
    "PairCorrelation": measure.pair_correlation,
    "Predictability": measure.predictability,
    "SpeedDistribution": measure.speed_distribution,
    "StructureFactor": measure.structure_factor,
    "TrajectoryDeviation": measure.trajectory_error,
    "ClosedBox": reference.closed_box,
    "TwoDiscs": reference.two_discs,
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
    for module in (mpsim, measure, reference, reference_motion)
    for name, value in members(module).items()
    if not isinstance(value, ModuleType)
}
PUBLIC = {name: value for name, value in PUBLIC.items() if isinstance(value, type | FunctionType) or callable(value)}


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


def arguments(value: Any) -> list[str]:
    """Names of the arguments of a function, a method or a class."""
    function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
    return [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]


def problems(name: str, value: Any) -> list[str]:
    """What the docstring of a public name lacks."""
    text, found = text_of(value), []
    if not text:
        return [f"{name} has no docstring"]
    if is_exception(value):
        return []
    result = isinstance(value, type) and value.__name__ in MADE_BY
    record = isinstance(value, type) and "Attributes:" in text  # which checks nothing
    if ">>>" not in text and not result:
        found.append(f"{name} has no example")
    if result and ">>>" not in text_of(MADE_BY[value.__name__]):
        found.append(f"{name} is made by something that has no example")
    missing = [each for each in arguments(value) if not re.search(rf"\b{each}\b", text)]
    if missing:
        found.append(f"{name} does not say what {', '.join(missing)} are")
    if arguments(value) and not record and "Raises:" not in text:
        found.append(f"{name} does not say what it raises")
    if not re.search(r"\[\w[^\]]*\]", text):
        found.append(f"{name} gives no dimension")
    return found


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_says_what_it_is(name):
    assert problems(name, PUBLIC[name]) == []


@pytest.mark.parametrize("name", [name for name, value in PUBLIC.items() if isinstance(value, type)])
def test_public_methods_say_what_they_do(name):
    owner = PUBLIC[name]
    for part, value in parts(owner):
        text = text_of(value)
        assert text, f"{name}.{part} has no docstring"
        if not isinstance(value, property):
            missing = [each for each in arguments(value) if not re.search(rf"\b{each}\b", text)]
            assert missing == [], f"{name}.{part} does not say what {', '.join(missing)} are"


@pytest.mark.parametrize("module", [reference, reference_motion], ids=lambda module: module.__name__)
def test_what_is_known_names_its_source(module):
    silent = [name for name, value in members(module).items() if callable(value) and "ource" not in text_of(value)]
    assert silent == []


@pytest.mark.parametrize(
    "name",
    [name for name, value in PUBLIC.items() if not is_exception(value)],
)
def test_signatures_are_short(name):
    """Types are shown as they are written: ArrayLike is not spelled out."""
    owner = PUBLIC[name]
    doors = [owner, *(value for _, value in parts(owner))] if isinstance(owner, type) else [owner]
    shown = [
        str(inspect.signature(getattr(each, "__func__", each))) for each in doors if not isinstance(each, property)
    ]
    assert [each for each in shown if re.search(r"numpy\.|_typing|collections\.abc|mpsim\.", each)] == []


def test_a_bad_docstring_is_noticed():
    """Negative control."""

    def bare(width):
        return width

    def half(width, height):
        """Double the width.

        >>> half(1, 2)
        2
        """

    assert problems("bare", bare) == ["bare has no docstring"]
    assert problems("half", half) == [
        "half does not say what height are",
        "half does not say what it raises",
        "half gives no dimension",
    ]


def test_the_public_face_is_small():
    """A new name is a promise: raise this number on purpose."""
    assert len(mpsim.__all__) <= 58
