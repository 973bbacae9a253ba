"""Values in scene files: arrays in the file itself or in .npy and .csv files beside it, and values as TOML."""

import dataclasses
import io
import json
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks, files
from mpsim.core.archive import REAL, read_array
from mpsim.errors import InputError, is_of_the_system
from mpsim.features.feature import chosen

logger: logging.Logger = logging.getLogger("mpsim")

Numbers = NDArray[np.float64]

MOST_ARRAY_BYTES = 2**33
"""Bytes of all array files of a scene together: enough for the largest scene."""

MOST_CSV = 2**23
"""Bytes of a .csv file, which is read as text."""

INLINE = 64
"""Number of rows up to which an array is saved in the scene file itself, where a person can read it."""

# --- Reading: numbers, or the name of a file of them


class ArrayFiles:
    """The array files of one scene file, in its folder or below.

    Attributes: read (paths, in the order of reading).
    """

    def __init__(self, folder: Path):
        self.read: list[Path] = []
        self._folder = folder
        self._bytes = 0

    def array(self, name: str, value: Any, shapes: tuple[tuple[int | None, ...], ...], meaning: str) -> Numbers:
        """Numbers, or those of a file, as a float64 array of one of the shapes (None: any length)."""
        if isinstance(value, np.ndarray):
            numbers = value
        else:
            numbers = self.content(name, value) if isinstance(value, str) else _numbers(name, value, meaning)
        fitting = [shape for shape in shapes if len(shape) == numbers.ndim]
        # An empty list has lost its axes: the shape of most axes is taken.
        return checks.finite_array(name, numbers, fitting[0] if fitting and numbers.size else shapes[-1], meaning)

    def content(self, name: str, path: str) -> NDArray[Any]:
        """The array in a .npy or .csv file.

        Raises:
            InputError: if there is none, or if it cannot be read without executing code.
        """
        full, shown = self._folder / path, checks.brief(path)
        if not names_array_file(path):
            raise InputError(f"{name} must be numbers or the name of a .npy or .csv file; got {shown}.")
        try:
            inside = full.resolve().is_relative_to(self._folder.resolve())
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
                self._count(name, full, length)
                return _from_csv(name, full) if full.suffix.lower() == ".csv" else _from_npy(name, full, file, length)
        except (FileNotFoundError, IsADirectoryError) as error:
            what = "a folder" if isinstance(error, IsADirectoryError) else "no such file"
            raise InputError(f"{name} must be a file that exists; got {shown}: {what} in {self._folder}.") from None
        except OSError as error:
            if not is_of_the_system(error):
                raise
            raise InputError(f"{name} must be a file that can be read; got {shown} ({error.strerror}).") from None

    def _count(self, name: str, path: Path, length: int) -> None:
        """Add a file, if all of them together are not too large."""
        self.read.append(path)
        self._bytes += length
        if self._bytes > MOST_ARRAY_BYTES:
            raise InputError(
                f"{name} must leave the array files of a scene at most {MOST_ARRAY_BYTES:,} bytes together; got "
                f"{self._bytes:,} with {path.name}. Use fewer or smaller arrays."
            )


def names_array_file(text: str) -> bool:
    """Whether a text ends as the name of an array file does."""
    return Path(text).suffix.lower() in (".npy", ".csv")


def _from_npy(name: str, path: Path, file: BinaryIO, length: int) -> NDArray[Any]:
    try:
        return read_array(file, length, path.name, REAL)  # which refuses pickles, as they could execute code
    except ValueError as error:
        raise InputError(
            f"{name} must be an array of real numbers as numpy.save writes it; {path.name} is not ({error!s:.200}). "
            "Save it anew."
        ) from None


def _from_csv(name: str, path: Path) -> Numbers:
    """One row per line, after an optional line of headings."""
    lines: dict[int, str] = {}
    try:
        every = files.content(path, MOST_CSV).decode("utf-8-sig").splitlines()
        lines = {number: line for number, line in enumerate(every, 1) if line.strip(" ,\t")}
        if (first := next(iter(lines), 0)) and not any(map(_is_number, lines[first].split(","))):
            del lines[first]
        rows = [*lines.values()]
        numbers = np.loadtxt(rows, delimiter=",", quotechar='"', comments=None, ndmin=2) if rows else np.zeros((0, 1))
    except ValueError as error:  # of bytes that are no text, too
        why = _wrong_line(lines) or str(error)
        raise InputError(
            f"{name} must be lines of numbers with commas between them, as many in each; {path.name} is not: {why}."
        ) from None
    return numbers[:, 0] if numbers.shape[1] == 1 else numbers


def _wrong_line(lines: dict[int, str]) -> str:
    """What is wrong in the first line, of those by number, that differs from the others; "" if none does."""
    widths = {number: line.count(",") + 1 for number, line in lines.items()}
    for number, line in lines.items():
        wrong = next((cell for cell in line.split(",") if not _is_number(cell.strip(' "'))), None)
        if wrong is not None:
            return f"line {number} has {checks.brief(wrong)}"
        if widths[number] != (usual := next(iter(widths.values()))):
            return f"line {number} has {widths[number]}, and line {next(iter(widths))} has {usual}"
    return ""


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _numbers(name: str, value: Any, meaning: str) -> Numbers:
    demand_numbers(name, value)
    try:
        return np.array(value, dtype=np.float64)
    except ValueError:
        lengths = sorted({len(row) if isinstance(row, list) else 0 for row in value})
        raise InputError(
            f"{name} must be numbers of shape {meaning}; got rows of different lengths, {lengths[0]} to {lengths[-1]}."
        ) from None


def demand_numbers(name: str, value: Any) -> None:
    """Refuse texts, truth values and dates in place of numbers: numpy would convert some of them."""
    if isinstance(value, list):
        for index, part in enumerate(value):
            if type(part) is not float:
                demand_numbers(f"{name}[{index}]", part)
        return
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} must be a number; got {checks.brief(value)}.")
    try:
        float(value)
    except OverflowError:
        raise InputError(f"{name} must be finite in float64; got {checks.brief(value)}.") from None


# --- Writing: values as lines of TOML, large arrays as files beside it

Files = list[tuple[Path, Callable[[BinaryIO], object]]]
"""Files to write, each with the function that writes it."""


def text(value: Any) -> str:
    """A value as TOML, from which the same bits are read; a dataclass, or values by name, as a table in the line."""
    if isinstance(value, str):
        # JSON's escapes are valid in TOML, which requires one more.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list | np.ndarray):
        return f"[{', '.join(map(text, value))}]"
    if dataclasses.is_dataclass(value):
        value = chosen(value)
    if isinstance(value, dict):
        return f"{{ {', '.join(pairs(value))} }}"
    return repr(int(value)) if isinstance(value, int | np.integer) else repr(float(value))


def pairs(values: dict[str, Any]) -> list[str]:
    """A line for each value that is not None."""
    return [f"{name} = {text(value)}" for name, value in values.items() if value is not None]


def array_lines(arrays: dict[str, Any], target: Path, prefix: str, files: Files) -> list[str]:
    """Arrays by name as lines of a table. Large ones become files beside the target, named by prefix and name."""
    lines: list[str] = []
    for name, value in arrays.items():
        numbers = np.asarray(value, dtype=np.float64)
        if numbers.ndim == 0 or len(numbers) <= INLINE:
            rows = numbers.tolist()
            one_line = numbers.ndim < 2 or len(rows) < 2
            lines.append(f"{name} = {text(rows)}" if one_line else f"{name} = [")
            lines += [] if one_line else [*(f"    {text(row)}," for row in rows), "]"]
            continue
        file = target.with_name(f"{target.stem}.{prefix}{name}.npy")
        content = io.BytesIO()  # numpy itself does not say why a file on a disk cannot be written
        np.save(content, numbers.astype("<f8"), allow_pickle=False)
        files.append((file, lambda out, content=content: out.write(content.getbuffer())))
        lines.append(f"{name} = {text(file.name)}")
    return lines
