"""The points of a sweep: combinations of the values of a grid, and the seed of each.

The text of a point is JSON of its values, sorted by name, and contains nothing else. So neither the order of names and
values nor other values of the grid change the seed of a point, or its row in a file.
"""

import dataclasses
import hashlib
import itertools
import json
import math
import numbers
from collections.abc import Iterable, Iterator, Mapping, Sized
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePath
from typing import Any

import numpy as np

from mpsim.core import checks
from mpsim.core.state import State
from mpsim.errors import InputError
from mpsim.scene.scene import Scene

MOST_POINTS = 10_000_000
"""More runs than this are taken for a mistake: their rows would not fit into memory."""

MOST_SEEDS = 1_000_000

VALUES = "None, True or False, numbers, texts, or tuples, lists, dictionaries and dataclasses of these"
"""What a grid may hold, in words."""


@dataclass(frozen=True)
class Point:
    """One run of a sweep.

    Attributes:
        values: by the names of the grid, as they were given.
        plain: the same as plain values, which identify the point.
        run: number of the run at this point; 0 without seeds.
        seed: derived from both; None without seeds.
    """

    values: dict[str, Any]
    plain: dict[str, Any]
    run: int
    seed: int | None

    @property
    def key(self) -> tuple[str, int]:
        """What distinguishes the run from all others."""
        return text_of(self.plain), self.run


def text_of(plain: Mapping[str, Any]) -> str:
    """Plain values by name as a text, the same for every order of the names.

    >>> text_of({"packing": 0.1, "count": 2})
    '{"count":2,"packing":0.1}'
    """
    return json.dumps(plain, sort_keys=True, separators=(",", ":"))


def seed_of(plain: Mapping[str, Any], run: int) -> int:
    """The seed of a run: the first 63 bits of BLAKE2b of the point's text, a space, and the number of the run.

    >>> seed_of({"packing": 0.1}, 0), seed_of({"packing": 0.1}, 1)
    (1570410355820327519, 8174789766741869874)
    """
    digest = hashlib.blake2b(f"{text_of(plain)} {run}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") >> 1


def points_of(grid: Any, seeds: Any) -> list[Point]:
    """All runs of a grid: every combination of its values, the last name changing fastest, and each of its seeds.

    Raises:
        InputError: if the grid or the seeds break a rule.
    """
    values = checked_grid(grid)
    plain = {name: [canonical(f"grid[{name!r}]", each) for each in values[name]] for name in values}
    for name in values:
        _demand_different(name, values[name], plain[name])
    runs = _checked_seeds(seeds)
    number = math.prod(map(len, values.values())) * len(runs or (0,))
    if number > MOST_POINTS:
        raise InputError(
            f"grid must have at most {MOST_POINTS:,} runs, those of all seeds together; got {number:,}. "
            "Sweep over fewer values, or over some of the parameters at a time."
        )
    return list(_combined(values, plain, runs))


def _combined(values: dict[str, list[Any]], plain: dict[str, list[Any]], runs: list[int] | None) -> Iterator[Point]:
    given, texts = itertools.product(*values.values()), itertools.product(*plain.values())
    for combination, text in zip(given, texts, strict=True):
        here, there = dict(zip(values, combination, strict=True)), dict(zip(plain, text, strict=True))
        if runs is None:
            yield Point(here, there, 0, None)
        else:
            yield from (Point(here, there, run, seed_of(there, run)) for run in runs)


def checked_grid(grid: Any) -> dict[str, list[Any]]:
    """A grid as lists of values by name.

    Raises:
        InputError: if it is empty, or is not a mapping from names to lists.
    """
    if not isinstance(grid, Mapping):
        raise InputError(
            f"grid must be a dictionary of lists by the name of a parameter; got {checks.brief(grid)}. "
            "Write {'packing': [0.1, 0.3]}."
        )
    if not grid:
        raise InputError("grid must hold at least one parameter; got none. Write {'packing': [0.1, 0.3]}.")
    return {_checked_name(name): _listed(name, values) for name, values in grid.items()}


def _checked_name(name: Any) -> str:
    if not isinstance(name, str) or not name.isidentifier():
        raise InputError(f"grid must have names of parameters as its keys; got {checks.brief(name)}.")
    return name


def _listed(name: str, values: Any) -> list[Any]:
    if isinstance(values, str | bytes | Mapping | Scene) or not isinstance(values, Iterable):
        raise InputError(
            f"grid[{name!r}] must be a list of values; got {checks.brief(values)}. Write [value] for a single one."
        )
    too_many = isinstance(values, Sized) and len(values) > MOST_POINTS
    found: list[Any] = [] if too_many else list(itertools.islice(values, MOST_POINTS + 1))
    if too_many or len(found) > MOST_POINTS:
        raise InputError(f"grid[{name!r}] must have at most {MOST_POINTS:,} values; got more. Sweep over fewer.")
    if not found:
        raise InputError(f"grid[{name!r}] must hold at least one value; got none. Give one, or leave the name out.")
    return found


def _demand_different(name: str, values: list[Any], plain: list[Any]) -> None:
    texts = [text_of({"value": each}) for each in plain]
    if len(set(texts)) < len(texts):
        index = next(index for index, text in enumerate(texts) if text in texts[:index])
        raise InputError(
            f"grid[{name!r}] must hold different values; got {checks.brief(values[index])} more than once (numbers "
            "that are equal count as one, as do lists and tuples). Leave one out, or ask for more seeds."
        )


def _checked_seeds(seeds: Any) -> list[int] | None:
    """Numbers of the runs at each point; None without seeds."""
    if seeds is None:
        return None
    remedy = "4 makes four runs at each point, 0 to 3."
    if isinstance(seeds, str | bytes | Mapping) or not isinstance(seeds, Iterable):
        return list(range(checks.whole("seeds", seeds, 1, MOST_SEEDS, remedy)))
    found = [checks.whole("a number in seeds", each, 0, 2**63 - 1, remedy) for each in seeds]
    if not found or len(set(found)) < len(found):
        raise InputError(
            f"seeds must be a number of runs, or different numbers of them; got {checks.brief(found)}. {remedy}"
        )
    return found


def canonical(name: str, value: Any) -> Any:
    """A value as JSON can hold it, the same for values that are equal: 1 and 1.0, a list and a tuple.

    Fields of a dataclass that have their default are left out, so that a new one changes no point.

    Args:
        name: of the value, for the error.
        value: one of VALUES, a NumPy array or scalar, a member of an enumeration, a path, a Scene or a State.

    Raises:
        InputError: if it is something else.

    >>> canonical("x", (1.0, np.float32(0.5), True, None, float("inf")))
    [1, 0.5, True, None, {'float': 'inf'}]
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, Enum):
        return {"enum": f"{_name_of_type(value)}.{value.name}"}
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, float):
        return _of_float(value)
    if isinstance(value, str):
        return str(value)
    return _of_compound(name, value)


def _of_float(value: float) -> Any:
    if not math.isfinite(value):
        return {"float": repr(float(value))}
    return int(value) if value == int(value) else float(value)


def _of_compound(name: str, value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [canonical(name, each) for each in value]  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, Mapping) and all(isinstance(each, str) for each in value):
        return {"dict": {each: canonical(name, part) for each, part in value.items()}}
    if isinstance(value, PurePath):
        return {"path": str(value)}
    if isinstance(value, Scene | State):
        return {type(value).__name__: value.digest()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [each for each in dataclasses.fields(value) if each.compare]
        parts = {each.name: canonical(name, getattr(value, each.name)) for each in fields}
        defaults = {each.name: canonical(name, each.default) for each in fields if _has_default(each)}
        return {
            "dataclass": _name_of_type(value),
            **{each: part for each, part in parts.items() if each not in defaults or defaults[each] != part},
        }
    raise InputError(
        f"{name} must hold {VALUES}; got {checks.brief(value)}, a {type(value).__name__}. Sweep over its name or "
        "number, and make the object in the function."
    )


def _has_default(field: "dataclasses.Field[Any]") -> bool:
    return field.default is not dataclasses.MISSING


def _name_of_type(value: object) -> str:
    return f"{type(value).__module__}.{type(value).__qualname__}"
