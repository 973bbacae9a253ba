"""Trajectories as text: extended XYZ, which OVITO, ASE and others write and read; plain XYZ and LAMMPS are only read.

A frame of XYZ is the number of its discs, a line of keys, and a line for each disc. Numbers are written so that reading
them gives the same bits. A frame is complete if all its lines are there, each with its end; anything else at the end of
the file is left from a killed process, and is dropped.
"""

import contextlib
import gzip
import os
import re
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import accumulate, dropwhile
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
import orjson
from numpy.typing import NDArray

from mpsim.core import files
from mpsim.core.columns import IMAGE, IN_STATE, MASS, Column, ranges
from mpsim.errors import TrajectoryError, TrajectoryWarning, level_of_caller
from mpsim.kernels.output import join_rows
from mpsim.output.frames import ROUNDING, Frame, Given, kind_of

LONGEST_LINE = 2**20  # bytes of a line at most

PROPERTIES = "species:S:1:pos:R:3:radius:R:1:mass:R:1:masses:R:1:velo:R:3:momenta:R:3:id:I:1"
"""Columns that mpsim writes: mass and velo by the names that OVITO knows, masses and momenta by those of ASE."""

PART = 20_000  # discs whose lines are made at a time

_POSITION, _VELOCITY = Column("position", "centres", (2,)), Column("velocity", "velocities", (2,))
_MOMENTUM = Column("momentum", "momenta", (2,))

_NAMED: dict[str, Column] = {
    "pos": _POSITION,
    "velo": _VELOCITY,
    "vel": _VELOCITY,
    "velocity": _VELOCITY,
    "velocities": _VELOCITY,
    "radius": Column("radius", "radii"),
    "mass": MASS,
    "masses": MASS,
    "map_shift": IMAGE,
    "id": Column("ids", "numbers of the discs", integer=True),
}
"""Columns that go by the names that OVITO and ASE know; each bears the name of the attribute of a Frame that it is."""

_OF_STATES: dict[str, Column] = {
    next((name for name, known in _NAMED.items() if known == column), column.name): column for column in IN_STATE
}
"""Further columns of a state, by their names in a file: their own if OVITO and ASE have no name for them."""

NUMBER = re.compile(r"\d{1,17}")  # of a frame, or of the discs in one


class XyzWriter:
    """Appends frames to a file, which is new (mode "x") or continued ("a")."""

    def __init__(self, path: Path, mode: str):
        self._path = path
        self._file = path.open(f"{mode}b", buffering=0)

    def write(self, frame: Frame) -> None:
        """Append a frame, and pass it to the operating system; one that fails is cut off again."""
        begin = os.fstat(self._file.fileno()).st_size
        try:
            for part in text_of(frame):
                rest = memoryview(part)
                while rest:
                    rest = rest[self._file.write(rest) :]
        except BaseException:
            self._file.truncate(begin)
            self._file.seek(begin)
            raise

    def truncate(self, frames: int) -> None:
        """Cut the file after its first frames, and after the last complete one."""
        self._file.truncate(scan(self._path, XyzReader.skip)[0][frames])

    def close(self) -> None:
        """Close the file, after forcing its content to the disk."""
        if not self._file.closed:
            with self._file:
                os.fsync(self._file.fileno())


def text_of(frame: Frame) -> Iterator[Any]:
    """A frame as text, as bytes in parts: for ten million discs, the text is longer than all their arrays."""
    yield _head_of(frame)
    for first, last in ranges(len(frame.position), PART):
        yield _rows_of(_columns_of(frame, slice(first, last)), last - first).tobytes()


def _head_of(frame: Frame) -> bytes:
    (width, height), (left, low) = frame.box, frame.origin
    wraps = " ".join("T" if wrap else "F" for wrap in (*frame.periodic, False))
    further = [f":{name}:{kind_of(column)}" for name, column in _OF_STATES.items() if column.name in frame.known]
    return (
        f'{len(frame.position)}\nLattice="{width!r} 0.0 0.0 0.0 {height!r} 0.0 0.0 0.0 1.0" Origin="{left!r} {low!r} '
        f'0.0" Properties={PROPERTIES}{"".join(further)} Time={frame.time!r} pbc="{wraps}" Frame={frame.frame} '
        f"precision={frame.position.dtype}\n"
    ).encode()


def _columns_of(frame: Frame, part: slice) -> list[NDArray[Any] | str]:
    """The columns of some of the discs: numbers, float64 or int64 of shape (K,), or a text for all discs."""
    # A float32 is written as the float64 of the same value: its own shortest text might be rounded twice when read.
    mass, velocity = frame.mass[part], frame.velocity[part].astype(np.float64)
    x, y = frame.position[part].T.astype(np.float64)
    vx, vy = velocity.T
    px, py = (vx, vy) if (mass == 1).all() else (mass * vx, mass * vy)
    zero = "0.0"
    columns: list[NDArray[Any] | str] = ["X", x, y, zero, frame.radius[part], mass, mass, vx, vy, zero, px, py, zero]
    columns.append(frame.ids[part])
    for column in _OF_STATES.values():
        if column.name in frame.known:
            values = frame.known[column.name][part]
            columns += [*np.atleast_2d(values.T).astype(column.dtype(np.dtype(np.float64)))]
            columns += ["0" if column.integer else zero] if column.components else []
    return columns


def _rows_of(columns: list[NDArray[Any] | str], rows: int) -> Any:
    """A line for each disc, as bytes. A column that occurs twice, such as a momentum for mass 1, is converted once."""
    texts = {id(column): _entries_of(column) for column in columns}
    begins = dict(zip(texts, accumulate(map(len, texts.values()), initial=0), strict=False))
    at = np.array([begins[id(column)] for column in columns])
    steps = np.array([texts[id(column)].index(b",") < len(texts[id(column)]) - 1 for column in columns])
    room = sum(len(texts[id(column)]) * (1 if step else rows) for column, step in zip(columns, steps, strict=True))
    out = np.empty(room, np.uint8)
    join_rows(np.frombuffer(b"".join(texts.values()), np.uint8), at, steps, rows, out)
    return out


def _entries_of(column: NDArray[Any] | str) -> bytes:
    """The entries of a column, each followed by a comma; one entry if all are the same."""
    if isinstance(column, str):
        return f"{column},".encode()
    bits = column.view(np.int64)
    if (bits == bits[0]).all():  # not the numbers: -0.0 has another text than 0.0
        column = column[:1]
    if column.dtype.kind == "f" and not np.isfinite(column).all():  # JSON has no text for them
        return "".join(f"{value!r}," for value in column.tolist()).encode()
    return orjson.dumps(np.ascontiguousarray(column), option=orjson.OPT_SERIALIZE_NUMPY)[1:-1] + b","


# --- Reading text, of which a format tells how a frame is skipped, and what is in it


def refusal(where: str, line: int, words: str) -> TrajectoryError:
    """The error in a line of a frame, whose first line is line 1."""
    return TrajectoryError(f"{where}, its line {line}, {words}")


class TextReader:
    """Reads frames at their positions in a file; given: what its frames may lack."""

    def __init__(self, path: Path, given: Given):
        self._path, self._given = path, given
        self._held = contextlib.ExitStack()
        self._content: BinaryIO | None = None  # of a compressed file
        weakref.finalize(self, self._held.close)
        self._offsets, lost, ended = scan(path, self.skip)
        if lost or not ended:
            words = (
                f"in the middle of a frame, as after a kill; the last {lost} bytes are not read. Its {len(self)} "
                "complete frames can be read."
                if lost
                else "without the end of a line. Its last frame is read; if its writer was killed, the last number may "
                "be cut short."
            )
            text = f"the trajectory {str(path)!r} ends {words}"
            warnings.warn(text, TrajectoryWarning, stacklevel=level_of_caller())

    @staticmethod
    def skip(file: BinaryIO, where: str) -> bool | None:
        """Skip a frame, as `scan` asks."""
        raise NotImplementedError

    def _frame(self, where: str, index: int, lines: list[str]) -> Frame:
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self._offsets) - 1

    def refresh(self) -> None:
        """Look for frames written since the last call; if the file has been replaced, for all frames."""
        self.close()
        try:
            self._offsets = scan(self._path, self.skip, (0,) if _is_compressed(self._path) else self._offsets)[0]
        except TrajectoryError:
            self._offsets = scan(self._path, self.skip)[0]

    def read(self, index: int) -> Frame:
        """One frame, or raise a TrajectoryError that names what the file lacks."""
        start, end = self._offsets[index : index + 2]
        if _is_compressed(self._path):  # opened once: it is read from its start each time
            self._content = self._content or self._held.enter_context(_opened(self._path))
        with contextlib.nullcontext(self._content) if self._content else _opened(self._path) as file:
            file.seek(start)
            lines = file.read(end - start).lstrip().decode("utf-8-sig", "replace").split("\n")
        return self._frame(f"frame {index} of {str(self._path)!r}", index, lines)

    def close(self) -> None:
        """Close the file; one that is not compressed is open only while a frame is read."""
        self._content = None
        self._held.close()


def _is_compressed(path: Path) -> bool:
    return path.suffix.lower() == ".gz"


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """The content of a file, open for reading."""
    with files.opened(path) as file:
        if _is_compressed(path):
            with gzip.GzipFile(fileobj=file) as content:
                yield cast(BinaryIO, content)
        else:
            yield file


def scan(
    path: Path, skip: Callable[[BinaryIO, str], bool | None], known: Sequence[int] = (0,)
) -> tuple[list[int], int, bool]:
    """Find the frames of a file, which is streamed.

    Args:
        skip: skips a frame of this name. Returns whether its last line has its end, which other programs may omit; None
            if there is no frame. Raises EOFError if the file ends within the frame.
        known: offsets from an earlier scan, which is not done again.

    Returns:
        Where each complete frame begins, and the last one ends; bytes of an incomplete one behind it; whether the last
        line has its end.
    """
    ended = True
    with _opened(path) as file:
        offsets = [offset for offset in known if offset <= os.fstat(file.fileno()).st_size]
        file.seek(offsets[-1])
        try:
            while (found := skip(file, f"frame {len(offsets) - 1} of {str(path)!r}")) is not None:
                ended = found
                offsets.append(file.tell())
        except EOFError:
            return offsets, file.tell() - offsets[-1], True
    return offsets, 0, ended


def lines_from(file: BinaryIO) -> Iterator[bytes]:
    """The lines of a file from its first one that is not blank."""
    return dropwhile(lambda line: not line.strip(), iter(partial(file.readline, LONGEST_LINE), b""))


def skip_rows(lines: Iterator[bytes], before: bytes, count: int, where: str, number: int) -> bool:
    """Skip the lines of the discs. Returns and raises as `scan` asks.

    before: the line before them; number: of that line in the frame.
    """
    head = previous = last = before
    for row in range(count):
        if len(last) == LONGEST_LINE:
            raise refusal(where, number + row, f"must have less than {LONGEST_LINE:,} bytes; it has more.")
        if not last.endswith(b"\n"):
            raise EOFError
        previous, last = last, next(lines, b"")
    if last.endswith(b"\n"):
        return True
    if last is head or b"precision=" in head:  # mpsim ends each line
        raise EOFError
    if previous is not head and len(last.split()) < len(previous.split()):
        raise EOFError
    return False


_FORTRAN = re.compile(r"(\d\.?)[dD]([+-]?\d)")


def numbers_of(where: str, line: int, name: str, text: str, count: int) -> list[float]:
    """The finite numbers of a text, at least so many; name: under which it stands in this line of a frame."""
    try:
        numbers = [float(word) for word in _FORTRAN.sub(r"\1e\2", text).split()]
    except ValueError:
        numbers = []
    if len(numbers) < count or not np.isfinite(numbers).all():
        raise refusal(where, line, f"must hold {count} finite numbers under {name}; got {text!r:.80}.")
    return numbers


def table(
    where: str, rows: list[str], first: int, columns: Sequence[tuple[str, int]], kinds: dict[str, type], says: str
) -> dict[str, NDArray[Any]]:
    """The numbers of some columns, by name, each of shape (N, width).

    Args:
        rows: the lines of the discs; first: number of the first one in the frame, behind the one that names columns.
        columns: names and widths of all in a line; kinds: float or int, of those that are read.
        says: what tells the columns, and a verb, for errors.
    """
    widths = {name if name in kinds else f"{at}": width for at, (name, width) in enumerate(columns)}
    if len(widths) < len(columns):
        names = " ".join(name for name, _ in columns)
        raise refusal(where, first - 1, f"must name each column once; got {names!r:.80}.")
    kinds = {name: kinds[name] for name in widths if name in kinds}
    dtype = np.dtype([(name, kinds.get(name, "U1"), (width,)) for name, width in widths.items()])
    found = np.zeros(0, dtype)
    for text in (rows, (_FORTRAN.sub(r"\1e\2", row) for row in rows)) if rows else ():
        with contextlib.suppress(ValueError):
            found = np.atleast_1d(np.loadtxt(text, dtype, comments=None))
            break
    if len(found) < len(rows):
        raise _wrong_row(where, rows, first, widths, kinds, says)
    for name in kinds:
        if len(infinite := np.flatnonzero(~np.isfinite(found[name]).all(axis=1))):
            words = f"must hold finite numbers in its column {name}; got {found[name][infinite[0]]}."
            raise refusal(where, first + int(infinite[0]), words)
    return {name: found[name] for name in kinds}


def _wrong_row(
    where: str, rows: list[str], first: int, widths: dict[str, int], kinds: dict[str, type], says: str
) -> TrajectoryError:
    """What is wrong with the first row that is not as it should be."""
    names = [name for name, width in widths.items() for _ in range(width)]
    for line, words in enumerate(map(str.split, rows), first):
        if len(words) != len(names):
            return refusal(where, line, f"must have {len(names)} columns, as {says}; got a line with {len(words)}.")
        for name, word in zip(names, words, strict=True):
            try:
                np.array(kinds.get(name, str)(_FORTRAN.sub(r"\1e\2", word)), kinds.get(name))
            except (ValueError, OverflowError):
                whole = ", whole ones of at most 64 bits" * (kinds[name] is int)
                return refusal(where, line, f"must hold numbers in its column {name}{whole}; got {word!r:.80}.")
    return refusal(where, first, f"and the next ones must be a table of numbers; got {rows[0]!r:.80}.")


# --- Reading XYZ


class XyzReader(TextReader):
    """Reads extended and plain XYZ."""

    @staticmethod
    def skip(file: BinaryIO, where: str) -> bool | None:
        lines = lines_from(file)
        head = next(lines, b"")
        if not head:
            return None
        count = head.decode("utf-8-sig", "replace").strip()
        if not NUMBER.fullmatch(count):
            words = "must give the number of discs where a frame begins;"
            raise refusal(where, 1, f"{words} got {head[:80]!r}. Give a file of extended XYZ.")
        return skip_rows(lines, next(lines, b""), int(count), where, 2)

    def _frame(self, where: str, index: int, lines: list[str]) -> Frame:
        head = lines[0].strip()
        count = int(head) if NUMBER.fullmatch(head) else len(lines)
        if count > len(lines) - 2 or any(map(str.strip, lines[count + 2 :])):
            raise refusal(where, 1, f"has changed since the file was opened, to {head!r:.80}. Open it again.")
        keys, rows = keys_of(lines[1]), lines[2 : 2 + count]
        # a file without names of columns may have more of them than those of the format
        further = f":_:S:{max(len(rows[0].split()) - 4, 0) if rows else 0}"
        says = "its Properties say" if "properties" in keys else "each line of plain XYZ has (name, x, y, z, ...)"
        known = _columns(where, rows, keys.get("properties", f"species:S:1:pos:R:3{further}"), says)
        position = known.pop("position")
        if "float32" in keys.get("precision", ""):
            position = position.astype(np.float32)
            reals = ("velocity", *(column.name for column in IN_STATE if not column.integer))
            known |= {name: known[name].astype(np.float32) for name in reals if name in known}
        if "time" in keys:
            known["time"] = numbers_of(where, 2, "Time", keys["time"], 1)[0]
        box, periodic, origin = _box(where, keys), _periodic(where, keys), (0.0, 0.0)
        if "origin" in keys:
            left, low, *_ = numbers_of(where, 2, "Origin", keys["origin"], 2)
            origin = left, low
        number = keys.get("frame", keys.get("timestep", ""))  # the time step of LAMMPS
        number = int(number) if NUMBER.fullmatch(number) else index
        return self._given.frame(where, number, box, origin, periodic, position, self._path, known)


_QUOTED = r'"(?:[^"\\]|\\.)*"|\'(?:[^\'\\]|\\.)*\''

_KEY = re.compile(rf"({_QUOTED}|[^\s=]+)(?:\s*=\s*({_QUOTED}|\S*))?")


def keys_of(comment: str) -> dict[str, str]:
    """Keys, in lower case, and values of the second line of a frame; words without a value are left out.

    >>> keys_of("Lattice='1 0 0 0 2 0 0 0 1' relaxed Time=0.5")
    {'lattice': '1 0 0 0 2 0 0 0 1', 'time': '0.5'}
    """
    pairs = (match.groups() for match in _KEY.finditer(comment))
    return {key.lower(): value[1:-1] if value[:1] in ("'", '"') else value for key, value in pairs if value is not None}


def _columns(where: str, rows: list[str], properties: str, says: str) -> dict[str, Any]:
    """The quantities of a frame, by the names of the attributes that they are."""
    parts = properties.split(":")
    if len(parts) % 3 or not all(re.fullmatch(r"\d{1,4}", width) for width in parts[2::3]):
        words = f"must name its columns as name:type:width, again and again; got Properties={properties:.80}."
        raise refusal(where, 2, words)
    columns = [(name.lower(), int(width)) for name, width in zip(parts[::3], parts[2::3], strict=True)]
    widths = dict(columns)
    known = {**_NAMED, **_OF_STATES}
    if "momenta" in widths and not any(known.get(name) == _VELOCITY for name in widths):
        known["momenta"] = _MOMENTUM
    if "pos" not in widths:
        raise refusal(where, 2, f"must have the column pos:R:3, the places; its Properties are {properties:.80}.")
    for name, width in columns:
        least = len(known[name].components) + 1 if name in known else 0
        if width < least:
            raise refusal(where, 2, f"must have a column {name} of {least} numbers or more; got {width}.")
    found = dict[str, Any]()
    kinds: dict[str, type] = {name: int if column.integer else float for name, column in known.items()}
    for name, values in table(where, rows, 3, columns, kinds, says).items():
        column = known[name]
        wide = values if column.name in ("position", "velocity", "momentum") else values[:, :2]
        found[column.name] = np.ascontiguousarray(wide) if column.components else values[:, 0]
    momentum = found.pop("momentum", None)
    if momentum is not None and "mass" in found and (found["mass"] > 0).all():
        found["velocity"] = momentum / found["mass"][:, None]
    return found


def _box(where: str, keys: dict[str, str]) -> tuple[float, float] | None:
    """Width and height; None if there is no box, or one of zeros, which stands for none."""
    numbers = numbers_of(where, 2, "Lattice", keys["lattice"], 9) if "lattice" in keys else []
    if not any(numbers):
        return None
    width, height, slanted = numbers[0], numbers[4], max(abs(numbers[index]) for index in (1, 2, 3, 5, 6, 7))
    if min(width, height) <= 0 or slanted > ROUNDING * min(width, height):
        words = "must have an upright rectangular box with sides above 0, Lattice='width 0 0 0 height 0 0 0 z'; got "
        raise refusal(where, 2, f"{words}{keys['lattice']!r:.80}.")
    return width, height


def _periodic(where: str, keys: dict[str, str]) -> tuple[bool, bool] | None:
    """Whether x, and whether y, is periodic; None if the frame does not say."""
    if "pbc" not in keys:
        return None
    words = keys["pbc"].upper().split()
    if len(words) != 3 or not {*words} <= {"T", "F"}:
        raise refusal(where, 2, f"must say which axes are periodic, such as pbc='T T F'; got {keys['pbc']!r:.80}.")
    return words[0] == "T", words[1] == "T"


# --- Reading dumps of LAMMPS, of the styles atom and custom

PLACES = "", "s", "u", "su"
"""Endings of the columns x, y and z: "s" for fractions of the box, "u" for places without periodic borders."""

READ: dict[str, type] = {
    **dict.fromkeys((f"{axis}{ending}" for axis in "xyz" for ending in PLACES), float),
    **dict.fromkeys(("vx", "vy", "vz", "radius", "diameter", "mass", "omegaz"), float),
    **dict.fromkeys(("id", "ix", "iy"), int),
}
"""Columns that are read, and the kind of their numbers."""

OURS = {"radius": "radius", "mass": "mass", "id": "ids", "omegaz": "spin"}

MOST_LINES = 100  # lines of a frame before its discs at most


class DumpReader(TextReader):
    """Reads text dumps of LAMMPS."""

    @staticmethod
    def skip(file: BinaryIO, where: str) -> bool | None:
        lines, header = lines_from(file), b""
        for number, line in enumerate(lines, 1):
            if not line.endswith(b"\n"):
                raise EOFError
            header += line
            if line.startswith(b"ITEM: ATOMS") or number == MOST_LINES:
                return skip_rows(lines, line, _count(where, header.decode("utf-8", "replace")), where, number)
        if header:
            raise EOFError
        return None

    def _frame(self, where: str, index: int, lines: list[str]) -> Frame:
        header = "\n".join(lines[:MOST_LINES])
        (head, names, _), count = _item(where, header, "ATOMS"), _count(where, header)
        if any(map(str.strip, lines[head + count :])):
            raise refusal(where, 1, "has changed since the file was opened. Open it again.")
        low, size, periodic = _bounds(where, *_item(where, header, "BOX BOUNDS"))
        columns = [(name.lower(), 1) for name in names]
        numbers = table(where, lines[head : head + count], head + 1, columns, READ, "its ITEM: ATOMS says")
        found = {name: values[:, 0] for name, values in numbers.items()}
        ending = next((each for each in PLACES if {f"x{each}", f"y{each}"} <= found.keys()), None)
        if ending is None:
            raise refusal(where, head, f"must name columns x and y, or xs, xu or xsu; got {' '.join(names)!r:.80}.")
        place = np.column_stack([found[f"{axis}{ending}"] for axis in "xyz" if f"{axis}{ending}" in found])
        if "s" in ending:
            place = place * size[: place.shape[1]] + low[: place.shape[1]]
        known: dict[str, Any] = {name: found[theirs] for theirs, name in OURS.items() if theirs in found}
        if "diameter" in found:
            known["radius"] = found["diameter"] / 2
        if {"vx", "vy"} <= found.keys():
            known["velocity"] = np.column_stack([found[name] for name in ("vx", "vy", "vz") if name in found])
        if "u" in ending:
            known["image"] = np.zeros((len(place), 2), np.int64)
        elif {"ix", "iy"} <= found.keys():
            known["image"] = np.column_stack([found["ix"], found["iy"]])
        if "ITEM: TIME" in map(str.strip, lines[:head]):
            line, _, text = _item(where, header, "TIME")
            known["time"] = numbers_of(where, line + 1, "ITEM: TIME", text, 1)[0]
        step = _item(where, header, "TIMESTEP")[2]
        number = int(step) if NUMBER.fullmatch(step) else index
        box, origin = (float(size[0]), float(size[1])), (float(low[0]), float(low[1]))
        return self._given.frame(where, number, box, origin, periodic, place, self._path, known)


def _item(where: str, header: str, name: str) -> tuple[int, list[str], str]:
    """Number of the line that names an item, the words behind its name, and the text below it."""
    match = re.search(rf"^ITEM: {name}\b(.*)\n((?:(?!ITEM:).*\n)*)", header, re.MULTILINE)
    if not match or not header.startswith("ITEM:"):
        items = "ITEM: TIMESTEP, NUMBER OF ATOMS, BOX BOUNDS and ATOMS"
        raise refusal(where, 1, f"must begin a frame of a LAMMPS dump with {items}; got {header!r:.120}.")
    return header.count("\n", 0, match.end(1)) + 1, match[1].split(), match[2].strip()


def _count(where: str, header: str) -> int:
    line, _, text = _item(where, header, "NUMBER OF ATOMS")
    if not NUMBER.fullmatch(text):
        raise refusal(where, line + 1, f"must give the number of atoms; got {text!r:.60}.")
    return int(text)


def _bounds(where: str, line: int, words: list[str], text: str) -> tuple[Any, Any, tuple[bool, bool] | None]:
    """Lowest corner and sides of the box, and which axes are periodic; None if the frame, as old ones, does not say."""
    numbers = numbers_of(where, line + 1, "ITEM: BOX BOUNDS", text, 6)
    rows = np.reshape(numbers[: len(numbers) // 3 * 3], (3, -1))
    low, size, tilts = rows[:, 0], rows[:, 1] - rows[:, 0], rows[:, 2:]
    if len(numbers) not in (6, 9) or min(size[:2]) <= 0 or np.abs(tilts).max(initial=0) > ROUNDING * min(size[:2]):
        rule = "must begin an upright rectangular box, with a lower and a higher bound in each line, and tilts of 0"
        raise refusal(where, line, f"{rule}; got {text!r:.80}.")
    flags = [word for word in words if re.fullmatch("[pfsm]{2}", word)]
    return low, size, (flags[0] == "pp", flags[1] == "pp") if len(flags) == 3 else None
