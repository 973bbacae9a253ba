"""Rules of the keys of a scene file: Python arguments, arrays from files, sizes; and values as TOML."""

import csv
import io
import json
import logging
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, BinaryIO, ClassVar

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import PlainValidator, ValidationInfo

from mpsim.core import checks, files
from mpsim.core.archive import REAL, read_array
from mpsim.core.machine import garbage_collection_paused
from mpsim.errors import InputError, is_of_the_system

# --- Largest scene file and arrays that are read
#
# They bound what is processed item by item in Python; long arrays of numbers belong in .npy files.

MOST_BYTES = 2**20
"""Bytes of the scene file itself: about 20,000 lines."""

MOST_TABLES = 10_000
"""Tables of one kind: [[discs]], or those of a feature. One table may hold very many, as arrays."""

MOST_PARTS = 16
"""Parts of a dotted key. No key of a scene file has more than two; a parser's time grows with their square."""

MOST_PROBLEMS = 100
"""Problems of one file that are reported."""

MOST_ARRAY_BYTES = 2**33
"""Bytes of all array files of a scene together: enough for the largest scene."""

MOST_CSV = 2**23
"""Bytes of a .csv file, which is read cell by cell."""


# --- Arrays of a scene file: numbers in the file itself, or a .npy or .csv file beside it

logger: logging.Logger = logging.getLogger("mpsim")

INLINE = 64
"""Number of rows up to which an array is saved in the scene file itself, where a person can read it."""


@dataclass
class Source:
    """Where the arrays of a scene file may come from.

    Attributes:
        folder: that of the scene file; arrays lie in it or below.
        read: array files read so far.
        length: size of all of them [bytes].
        emitters: number of emitters in the tables checked so far.
    """

    folder: Path
    read: list[Path] = field(default_factory=list)
    length: int = 0
    emitters: int = 0

    def note(self, name: str, path: Path, length: int) -> None:
        """Add an array file, if all of them together are not too large."""
        self.read.append(path)
        self.length += length
        if self.length > MOST_ARRAY_BYTES:
            raise InputError(
                f"{name} must leave the array files of a scene at most {MOST_ARRAY_BYTES:,} bytes together; got "
                f"{self.length:,} with {path.name}. Use fewer or smaller arrays."
            )


def array(
    name: str, value: Any, shapes: tuple[tuple[int | None, ...], ...], meaning: str, source: Source
) -> NDArray[np.float64]:
    """Numbers, or those of a file given by name, as a float64 array of one of the shapes (None: any length).

    Raises:
        InputError: naming the rule and the value received.
    """
    if isinstance(value, str):
        numbers = from_file(name, value, source)
    else:
        demand_numbers(name, value)
        numbers = _array_of(name, value, meaning)
    fitting = [shape for shape in shapes if len(shape) == numbers.ndim]
    # An empty list has lost its axes: the shape of most axes is taken.
    return checks.finite_array(name, numbers, fitting[0] if fitting and numbers.size else shapes[-1], meaning)


def from_file(name: str, path: str, source: Source) -> NDArray[Any]:
    """The array in a .npy or .csv file in the scene file's folder or below.

    Raises:
        InputError: if there is none, or if it cannot be read without executing code.
    """
    full, shown = source.folder / path, checks.brief(path)
    suffix = full.suffix.lower()
    if suffix not in (".npy", ".csv"):
        raise InputError(f"{name} must be numbers or the name of a .npy or .csv file; got {shown}.")
    try:
        inside = full.resolve().is_relative_to(source.folder.resolve())
    except (OSError, ValueError, RuntimeError):  # too long a name, a null byte, a loop of links
        inside = False
    if not inside or Path(path).is_absolute():
        raise InputError(
            f"{name} must be a file in the folder of the scene file, or below; got {shown}, which is not. "
            "Move the file there, or make the scene in Python."
        )
    logger.info("mpsim: reading %s", full)
    try:
        with files.opened(full) as file:
            length = os.fstat(file.fileno()).st_size
            source.note(name, full, length)
            return _from_npy(name, full.name, file, length) if suffix == ".npy" else _from_csv(name, full)
    except FileNotFoundError:
        raise InputError(f"{name} must be a file that exists; got {shown}: no such file in {source.folder}.") from None
    except IsADirectoryError:
        raise InputError(f"{name} must be a file that exists; got {shown}: a folder in {source.folder}.") from None
    except OSError as error:
        if not is_of_the_system(error):
            raise
        raise InputError(f"{name} must be a file that can be read; got {shown} ({error.strerror}).") from None


def _from_npy(name: str, label: str, file: BinaryIO, length: int) -> NDArray[Any]:
    try:
        return read_array(file, length, label, REAL)  # which refuses pickles, as they could execute code
    except ValueError as error:
        raise InputError(
            f"{name} must be an array of real numbers as numpy.save writes it; {label} is not ({error!s:.200}). "
            "Save it anew."
        ) from None


@garbage_collection_paused()
def _from_csv(name: str, path: Path) -> NDArray[np.float64]:
    """One row per line, after an optional line of headings."""
    try:
        text = io.StringIO(files.content(path, MOST_CSV).decode("utf-8-sig"), newline="")
        lines = [(number, row) for number, row in enumerate(csv.reader(text), 1) if any(map(str.strip, row))]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{name} must be a text file of numbers; {path.name} is not ({error}).") from None
    if lines and not any(_is_number(cell) for cell in lines[0][1]):
        del lines[0]
    width = len(lines[0][1]) if lines else 0
    for number, row in lines:
        if len(row) != width:
            raise InputError(
                f"{name} must have as many numbers in every row; line {number} of {path.name} has {len(row)}, and "
                f"line {lines[0][0]} has {width}."
            )
    try:
        numbers = np.fromiter((float(cell) for _, row in lines for cell in row), np.float64)
    except ValueError:
        number, cell = next((number, cell) for number, row in lines for cell in row if not _is_number(cell))
        raise InputError(f"{name} must be numbers; line {number} of {path.name} has {checks.brief(cell)}.") from None
    return numbers if width == 1 else numbers.reshape(-1, width) if width else numbers


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def demand_numbers(name: str, value: Any) -> None:
    """Refuse texts, truth values and dates in place of numbers: numpy would convert some of them."""
    if isinstance(value, list):
        for index, part in enumerate(value):
            demand_numbers(f"{name}[{index}]", part)
        return
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} must be a number; got {checks.brief(value)}.")
    try:
        float(value)
    except OverflowError:
        raise InputError(f"{name} must be finite in float64; got {checks.brief(value)}.") from None


def _array_of(name: str, value: Any, meaning: str) -> NDArray[np.float64]:
    try:
        return np.array(value, dtype=np.float64)
    except ValueError:
        lengths = sorted({len(row) if isinstance(row, list) else 0 for row in value})
        raise InputError(
            f"{name} must be numbers of shape {meaning}; got rows of different lengths, {lengths[0]} to {lengths[-1]}."
        ) from None


def positive(name: str, numbers: NDArray[np.float64], unit: str) -> NDArray[np.float64]:
    """The array, checked to be > 0 everywhere."""
    bad = np.flatnonzero(numbers <= 0)
    if len(bad):
        at = f"[{bad[0]}]" if numbers.ndim else ""
        raise InputError(f"{name} must be > 0 {unit}; {name}{at} is {float(numbers.flat[bad[0]])!r}.")
    return numbers


def text_of(numbers: NDArray[np.float64]) -> str:
    """An array as TOML, from which the same bits are read."""
    if numbers.ndim == 0:
        return repr(float(numbers))
    if numbers.ndim == 1:
        return f"[{', '.join(map(repr, numbers.tolist()))}]"
    if len(numbers) <= 1:
        return f"[{', '.join(map(text_of, numbers))}]"
    return "[\n" + "".join(f"    {text_of(row)},\n" for row in numbers) + "]"


def is_small(numbers: NDArray[np.float64]) -> bool:
    """Whether an array is written into the scene file itself."""
    return numbers.ndim == 0 or len(numbers) <= INLINE


# --- Values as lines of TOML, large arrays as files beside it

Files = list[tuple[Path, Callable[[BinaryIO], object]]]
"""Files to write, each with the function that writes it."""


def array_lines(arrays: dict[str, Any], target: Path, prefix: str, files: Files) -> list[str]:
    """Arrays by name as lines of a table. Large ones become files beside the target, named by prefix and name."""
    lines: list[str] = []
    for name, value in arrays.items():
        numbers = np.asarray(value, dtype=np.float64)
        if is_small(numbers):
            lines.append(f"{name} = {text_of(numbers)}")
            continue
        file = target.with_name(f"{target.stem}.{prefix}{name}.npy")
        content = io.BytesIO()  # numpy itself does not say why a file on a disk cannot be written
        np.save(content, numbers.astype("<f8"), allow_pickle=False)
        files.append((file, lambda out, content=content: out.write(content.getbuffer())))
        lines.append(f"{name} = {text(file.name)}")
    return lines


def pairs(values: dict[str, Any]) -> list[str]:
    """A line for each value that is not None."""
    return [f"{name} = {text(value)}" for name, value in values.items() if value is not None]


def text(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, str):
        # JSON's escapes are valid in TOML, which requires one more.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list | np.ndarray):
        return f"[{', '.join(map(text, value))}]"
    return repr(int(value)) if isinstance(value, int | np.integer) else repr(float(value))


# --- Rules for the keys of a scene file: those for the Python arguments, and arrays from files

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
            demand_numbers(name, value)
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
        return array(name, value, (shape,), str(shape).replace("None", "K"), source_of(info))

    return checked(check)


def array_of(*shapes: tuple[int | None, ...], meaning: str, unit: str | None = None) -> PlainValidator:
    """Numbers, or a file of them; > 0 if a unit is given."""

    def check(name: str, value: Any, info: ValidationInfo) -> Any:
        if unit is not None and isinstance(value, int | float):
            return checks.positive(name, value, unit)
        numbers = array(name, value, shapes, meaning, source_of(info))
        if unit is not None:
            positive(name, numbers, unit)
        return float(numbers) if numbers.ndim == 0 else numbers

    return checked(check)


def source_of(info: ValidationInfo) -> Source:
    """Where arrays may come from: the context of the validation."""
    assert isinstance(info.context, Source)
    return info.context


class Table(pydantic.BaseModel):
    """A table of a scene file: no key but its own, no conversion of one type into another."""

    model_config: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(
        extra="forbid", strict=True, frozen=True, arbitrary_types_allowed=True
    )


def _region(name: str, value: Any, info: ValidationInfo) -> tuple[float, float, float, float]:
    numbers = array(name, value, ((4,),), "(4,): x_low, y_low, x_high, y_high", source_of(info)).tolist()
    if numbers[0] > numbers[2] or numbers[1] > numbers[3]:
        raise InputError(f"{name} must be [x_low, y_low, x_high, y_high], low before high; got {numbers}.")
    return tuple(numbers)


Positive = Annotated[float, plain(checks.positive, "[length]")]
Region = Annotated[tuple[float, float, float, float], checked(_region)]
Spacing = Annotated[float, plain(checks.positive, "[length]")]
