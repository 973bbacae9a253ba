"""The rules of the keys of a scene file: those that mpsim has for arguments in Python, and arrays from files."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import PlainValidator, ValidationInfo

from mpsim.core import checks
from mpsim.core.errors import InputError
from mpsim.scene.scenefile import arrays

Numbers = NDArray[np.float64]
Check = Callable[[str, Any, ValidationInfo], Any]


def checked(check: Check) -> PlainValidator:
    """The key goes through one of mpsim's own checks, which raise InputError with a text."""

    def validate(value: Any, info: ValidationInfo) -> Any:
        return check(str(info.field_name), value, info)

    return PlainValidator(validate)


def plain(check: Callable[..., Any], *rule: Any) -> PlainValidator:
    """The key goes through a check that needs nothing but its name, its value and the rest of the rule."""
    return checked(lambda name, value, _: check(name, value, *rule))


def as_in(*examples: Any, words: bool = False, numbers: bool = True) -> PlainValidator:
    """The rule that a class of mpsim has for this argument: see `_rule_of`."""
    return checked(_rule_of(*examples, words=words, numbers=numbers and not words))


def _rule_of(*examples: Any, words: bool = False, numbers: bool = True) -> Check:
    """The rule that a class of mpsim has for this argument.

    It is asked by making the class with this one argument exchanged in arguments that are right. Where an argument is
    right only beside some values of another there are several examples, and one that accepts it will do.
    words: whether it is a word or a list of words.
    numbers: whether a list is to hold numbers; else the class says what is wrong with one.
    """

    def check(name: str, value: Any, _: ValidationInfo) -> Any:
        if words and not isinstance(value, str | list):
            raise InputError(f"{name} must be a word or a list of words; got {checks.brief(value)}.")
        if isinstance(value, list) and numbers:
            arrays.demand_numbers(name, value)
        refused = None
        for kind, arguments in examples:
            try:
                return getattr(kind(**{**arguments, name: value}), name)
            except InputError as error:
                refused = refused or error
        assert refused is not None
        raise refused

    return check


def one_or_many(*examples: Any, row: tuple[int, ...] = ()) -> Any:
    """The rule of a class for this argument; or an array of such arguments, one each, of numbers or in a file."""
    one = _rule_of(*examples)

    def check(name: str, value: Any, info: ValidationInfo) -> Any:
        listed = isinstance(value, list) and (not row or any(isinstance(part, list) for part in value))
        if not listed and not isinstance(value, str):
            return one(name, value, info)
        shape = (None, *row)
        return arrays.array(name, value, (shape,), str(shape).replace("None", "K"), source_of(info))

    return checked(check)


def array(*shapes: tuple[int | None, ...], meaning: str, unit: str | None = None) -> PlainValidator:
    """Numbers, or a file of them; > 0 in a unit, if one is given."""

    def check(name: str, value: Any, info: ValidationInfo) -> Any:
        if unit is not None and isinstance(value, int | float):
            return checks.positive(name, value, unit)
        numbers = arrays.array(name, value, shapes, meaning, source_of(info))
        if unit is not None:
            arrays.positive(name, numbers, unit)
        return float(numbers) if numbers.ndim == 0 else numbers

    return checked(check)


def source_of(info: ValidationInfo) -> arrays.Source:
    """Where arrays may come from: what the file is validated with."""
    assert isinstance(info.context, arrays.Source)
    return info.context


class Table(pydantic.BaseModel):
    """A table of a scene file: no key but its own, no conversion of one type into another."""

    model_config: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(
        extra="forbid", strict=True, frozen=True, arbitrary_types_allowed=True
    )


def _region(name: str, value: Any, info: ValidationInfo) -> tuple[float, float, float, float]:
    numbers = arrays.array(name, value, ((4,),), "(4,): x_low, y_low, x_high, y_high", source_of(info)).tolist()
    if numbers[0] > numbers[2] or numbers[1] > numbers[3]:
        raise InputError(f"{name} must be [x_low, y_low, x_high, y_high], low before high; got {numbers}.")
    return tuple(numbers)


Positive = Annotated[float, plain(checks.positive, "[length]")]
Region = Annotated[tuple[float, float, float, float], checked(_region)]
Spacing = Annotated[float, plain(checks.positive, "[length]")]
