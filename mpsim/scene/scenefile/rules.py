"""Rules for the keys of a scene file: those for the Python arguments, and arrays from files."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import PlainValidator, ValidationInfo

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.scene.scenefile import arrays

Numbers = NDArray[np.float64]
Check = Callable[[str, Any, ValidationInfo], Any]


def checked(check: Check) -> PlainValidator:
    """A validator that calls one of mpsim's own checks, which raise InputError."""

    def validate(value: Any, info: ValidationInfo) -> Any:
        return check(str(info.field_name), value, info)

    return PlainValidator(validate)


def plain(check: Callable[..., Any], *rule: Any) -> PlainValidator:
    """A validator that calls a check with name, value and the given further arguments."""
    return checked(lambda name, value, _: check(name, value, *rule))


def as_in(*examples: Any, words: bool = False, numbers: bool = True) -> PlainValidator:
    """A validator with the rule of a class of mpsim for this argument: see `_rule_of`."""
    return checked(_rule_of(*examples, words=words, numbers=numbers and not words))


def _rule_of(*examples: Any, words: bool = False, numbers: bool = True) -> Check:
    """The rule of a class of mpsim for this argument.

    It is applied by making an instance with this argument replaced in otherwise valid ones. Where validity depends on
    another argument there are several examples, of which one must accept the value.
    words: whether the value is a word or a list of words.
    numbers: whether a list must hold numbers; else the class checks it.
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
    """The rule of a class for this argument; or an array with a value each, as numbers or in a file."""
    one = _rule_of(*examples)

    def check(name: str, value: Any, info: ValidationInfo) -> Any:
        listed = isinstance(value, list) and (not row or any(isinstance(part, list) for part in value))
        if not listed and not isinstance(value, str):
            return one(name, value, info)
        shape = (None, *row)
        return arrays.array(name, value, (shape,), str(shape).replace("None", "K"), source_of(info))

    return checked(check)


def array_of(*shapes: tuple[int | None, ...], meaning: str, unit: str | None = None) -> PlainValidator:
    """Numbers, or a file of them; > 0 if a unit is given."""

    def check(name: str, value: Any, info: ValidationInfo) -> Any:
        if unit is not None and isinstance(value, int | float):
            return checks.positive(name, value, unit)
        numbers = arrays.array(name, value, shapes, meaning, source_of(info))
        if unit is not None:
            arrays.positive(name, numbers, unit)
        return float(numbers) if numbers.ndim == 0 else numbers

    return checked(check)


def source_of(info: ValidationInfo) -> arrays.Source:
    """Where arrays may come from: the context of the validation."""
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
