"""Trajectories as text: extended XYZ, and LAMMPS dumps; where each frame lies in a file."""

import codecs
import contextlib
import functools
import gzip
import os
import re
import sys
import warnings
import weakref
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import accumulate, islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
import orjson
from numpy.typing import NDArray

from mpsim.core import files
from mpsim.core.columns import IMAGE, MASS, Column, in_state, ranges
from mpsim.errors import TrajectoryError, TrajectoryWarning, level_of_caller
from mpsim.kernels.output import join_rows
from mpsim.output.frames import ROUNDING, Frame, Given, kind_of

# --- Text files of frames, compressed by gzip or not: where each frame lies, and the numbers in its lines

LONGEST_LINE = 2**20  # bytes of a line at most
MOST_BYTES = 2**31  # bytes of a frame in a compressed file at most, which may unpack to a thousand times its size
LONGEST_NUMBER = 17  # digits of the number of a frame, or of the number of its discs, at most


class LineError(Exception):
    """The index of a line in its frame, and what is wrong with it, in words that follow the name of the line."""


class Lines:
    """The lines of a file that is scanned for frames."""

    def __init__(self, file: BinaryIO):
        self._file = file
        self._row = 0
        self.begin: int = 0  # offset of the line that `first` found
        self.unended: bool = False  # the file ended in the last line, before its newline
        self.even: bool = True  # that line has as many words as the one before it

    def first(self) -> bytes:
        """The next line that is not blank, or its beginning if it is too long; empty at the end of the file."""
        while (line := self._file.readline(LONGEST_LINE)) and not line.strip():
            pass
        self._row, self.begin = 1, self._file.tell() - len(line)
        self.unended = not line.endswith(b"\n") if line else self.unended
        return line.removeprefix(codecs.BOM_UTF8)

    def next(self, count: int = 1) -> bytes:
        """Read that many lines. Returns the last one.

        Raises:
            EOFError: if the file ends before it.
            LineError: if one is too long.
        """
        line, end = b"", self._row + count
        lines = iter(functools.partial(self._file.readline, LONGEST_LINE), b"")
        for each in islice(lines, min(count, sys.maxsize)):
            if not each.endswith(b"\n"):  # as only the last line of a file may
                self.unended, self.even = True, not line or len(each.split()) == len(line.split())
                if len(each) == LONGEST_LINE:
                    if b"\0" in each:  # as it is where ranks were killed as they wrote
                        raise EOFError
                    raise LineError(self._row, f"must have less than {LONGEST_LINE:,} bytes; it has more.")
            self._row += 1
            line = each
        if self._row < end:
            raise EOFError
        return line


class Scan(NamedTuple):
    """Where each complete frame of a file begins, and where the last one ends."""

    offsets: list[int]
    lost: int  # bytes of an incomplete frame at the end
    unended: bool  # whether the last line of the last frame is the end of the file, without a newline


Skip = Callable[[Lines, bytes], bool]
"""Skips a frame whose first line is given. Returns whether its last line may lack its newline.

It raises EOFError if the file ends within the frame, LineError if that is no frame.
"""


def scan(path: Path, skip: Skip, known: Sequence[int] = (0,)) -> Scan:
    """Find the frames of a file, which is streamed; known: offsets from an earlier scan, which is not done again."""
    with _opened(path) as file:
        offsets = [offset for offset in known if offset <= os.fstat(file.fileno()).st_size]
        file.seek(offsets[-1])
        lines = Lines(file)
        try:
            while head := lines.first():
                if not skip(lines, head) and lines.unended:
                    raise EOFError
                offsets.append(file.tell())
        except EOFError:
            return Scan(offsets, file.tell() - offsets[-1], False)
        except LineError as error:
            if lines.unended and len(offsets) > 1:  # cut off in a line that says how the frame goes on
                return Scan(offsets, file.tell() - offsets[-1], False)
            raise _located(error, path, len(offsets) - 1, lines.begin) from None
        except DAMAGED as error:
            raise _damaged(path, len(offsets) - 1, error) from None
    return Scan(offsets, 0, lines.unended and len(offsets) > 1)


def _is_compressed(path: Path) -> bool:
    return path.suffix.lower() == ".gz"


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """The content of a file, open for reading."""
    with files.opened(path) as file:
        if not _is_compressed(path):
            yield file
            return
        with gzip.GzipFile(fileobj=file) as content:
            yield cast(BinaryIO, content)


DAMAGED = EOFError, zlib.error, gzip.BadGzipFile  # errors of a compressed file that is damaged or cut off


def _damaged(path: Path, index: int, error: Exception) -> TrajectoryError:
    return TrajectoryError(
        f"a trajectory that ends in .gz must be compressed by gzip; frame {index} of {str(path)!r} cannot be read "
        f"({error!s:.120}). If it was copied, copy it again."
    )


def _located(error: LineError, path: Path, index: int, begin: int) -> TrajectoryError:
    """The error in a line of a frame that begins at an offset, with the number of the line in the file."""
    line, words = error.args
    with _opened(path) as file, contextlib.suppress(*DAMAGED):
        while piece := file.read(min(begin, LONGEST_LINE)):
            line += piece.count(b"\n")
            begin -= len(piece)
    return TrajectoryError(f"frame {index} of {str(path)!r}, line {line + 1}, {words}")


class TextReader:
    """Reads frames at their positions in a file; given: what its frames may lack."""

    def __init__(self, path: Path, given: Given | None = None):
        self._path = path
        self._given = given or Given()
        self._held = contextlib.ExitStack()
        weakref.finalize(self, self._held.close)
        self._content: BinaryIO | None = None  # of a compressed file, which is not opened anew for each frame
        self._offsets, lost, unended = scan(path, self._skip)
        name = f"the trajectory {str(path)!r}"
        if lost:
            warnings.warn(
                f"{name} ends in the middle of a frame, as after a kill; the last {lost} bytes are not read. Its "
                f"{len(self)} complete frames can be read.",
                TrajectoryWarning,
                stacklevel=level_of_caller(),
            )
        if unended:
            warnings.warn(
                f"{name} ends without the end of a line. Its last frame is read; if its writer was killed, the last "
                "number may be cut short.",
                TrajectoryWarning,
                stacklevel=level_of_caller(),
            )

    def _skip(self, lines: Lines, head: bytes) -> bool:
        raise NotImplementedError

    def _frame(self, where: str, index: int, lines: list[str]) -> Frame:
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self._offsets) - 1

    def refresh(self) -> None:
        """Look for frames written since the last call; if the file has been replaced, for all frames."""
        self.close()
        known = [0] if _is_compressed(self._path) else self._offsets
        try:
            self._offsets = scan(self._path, self._skip, known).offsets
        except TrajectoryError:
            self._offsets = scan(self._path, self._skip).offsets

    def number(self, index: int) -> int:
        """The frame of the simulation that is at an index; the index itself if the file does not say."""
        return self.read(index).frame

    def read(self, index: int) -> Frame:
        """One frame, or raise a TrajectoryError that names what the file lacks."""
        start, end = self._offsets[index : index + 2]
        begin, where = start, f"frame {index} of {str(self._path)!r}"
        try:
            content = self._bytes(start, end)
            begin += len(content) - len(content.lstrip())
            return self._frame(where, index, content.lstrip().decode("utf-8-sig", "replace").split("\n"))
        except DAMAGED as error:
            raise _damaged(self._path, index, error) from None
        except LineError as error:
            raise _located(error, self._path, index, begin) from None

    def _bytes(self, start: int, end: int) -> bytes:
        if not _is_compressed(self._path):
            with _opened(self._path) as file:
                file.seek(start)
                return file.read(end - start)
        if end - start > MOST_BYTES:
            raise LineError(0, f"must begin a frame of at most {MOST_BYTES:,} bytes; it has {end - start:,}.")
        if self._content is None:
            self._content = self._held.enter_context(_opened(self._path))
        self._content.seek(start)
        return self._content.read(end - start)

    def close(self) -> None:
        """Close the file; one that is not compressed is open only while a frame is read."""
        self._content = None
        self._held.close()


def changed(line: str) -> LineError:
    """The error for a frame that is not where it was."""
    return LineError(
        0,
        f"must be where it was when the file was opened; its first line is {line!r:.80} now. The file has been "
        "changed: open it again.",
    )


_FORTRAN = re.compile(r"(\d\.?)[dD]([+-]?\d)")


def table(
    lines: list[str], first: int, columns: Sequence[tuple[str, int]], kinds: Mapping[str, type], says: str
) -> dict[str, NDArray[Any]]:
    """The numbers of some columns, by name, each of shape (N, width).

    Args:
        lines: of the discs; first: index in the frame of the first one.
        columns: names and widths of all columns in a line; kinds: float or int, of those that are read.
        says: what in the frame names the columns, and a verb, for error texts.
    """
    dtype = np.dtype([(f"{i}", kinds.get(name, "U1"), (width,)) for i, (name, width) in enumerate(columns)])
    found = np.zeros(0, dtype)
    for text in (lines, None):
        rows = [_FORTRAN.sub(r"\1e\2", line) for line in lines] if text is None else text
        try:
            found = np.atleast_1d(np.loadtxt(rows, dtype, comments=None)) if lines else found
            break
        except ValueError as error:
            if text is None:
                raise _wrong(rows, first, columns, kinds, says, str(error)) from None
    if len(found) < len(lines):
        raise _wrong(lines, first, columns, kinds, says, "blank lines")
    values = {name: found[f"{i}"] for i, (name, _) in enumerate(columns) if name in kinds}
    for name, array in values.items():
        infinite = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if len(infinite):
            row = infinite[0]
            raise LineError(first + int(row), f"must hold finite numbers in its column {name}; got {array[row]}.")
    return values


def _wrong(
    rows: list[str], first: int, columns: Sequence[tuple[str, int]], kinds: Mapping[str, type], says: str, error: str
) -> LineError:
    """What is wrong with the first line that is not as it should be; `error` if that is not found."""
    names = [name for name, width in columns for _ in range(width)]
    for line, text in enumerate(rows, first):
        words = text.split()
        if len(words) != len(names):
            return LineError(
                line,
                f"must have {len(names)} columns, as its {says}; got a line with {len(words)}: "
                f"{' '.join(words)!r:.80}. The file is damaged, or another program has written it wrongly.",
            )
    for line, text in enumerate(rows, first):
        for name, word in zip(names, text.split(), strict=True):
            try:
                np.array(kinds.get(name, str)(word), kinds.get(name))
            except (ValueError, OverflowError):
                whole = ", whole ones of at most 64 bits" * (kinds[name] is int)
                return LineError(line, f"must hold numbers in its column {name}{whole}; got {word!r:.80}.")
    return LineError(first, f"and the next ones must be a table of numbers; got this error: {error:.120}.")


def real(text: str, key: str, line: int) -> float:
    """A finite number under a key."""
    try:
        value = float(_FORTRAN.sub(r"\1e\2", text))
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise LineError(line, f"must hold finite numbers under {key}; got {text!r:.80}.")
    return value


# --- Trajectories of LAMMPS, as its dump styles atom and custom write them in text. They are only read

PLACES = "", "s", "u", "su"
"""Endings of the columns x, y and z: "s" for fractions of the box, "u" for places without periodic borders."""

READ: dict[str, type] = {
    **dict.fromkeys((f"{axis}{ending}" for axis in "xyz" for ending in PLACES), float),
    **dict.fromkeys(("vx", "vy", "vz", "radius", "diameter", "mass", "omegaz"), float),
    **dict.fromkeys(("id", "ix", "iy"), int),
}
"""Columns that are read, and the kind of their numbers."""

MOST_LINES = 100  # lines of a frame before its discs at most


class DumpReader(TextReader):
    """Reads frames at their positions in the file."""

    def _skip(self, lines: Lines, head: bytes) -> bool:
        count, item, line = None, b"", head
        for index in range(MOST_LINES):
            if line.startswith(b"ITEM:"):
                item = line[5:].strip()
            elif not index:
                raise LineError(0, f"must begin with ITEM: TIMESTEP, as a dump of LAMMPS; got {line[:60]!r}.")
            elif item == b"NUMBER OF ATOMS":
                if not line.strip().isdigit() or len(line.strip()) > LONGEST_NUMBER:
                    raise LineError(index, f"must give the number of atoms; got {line[:60]!r}.")
                count = int(line)
            if item.startswith(b"ATOMS") and count is not None:
                lines.next(count)
                return lines.even
            line = lines.next()
        raise LineError(0, "must begin a frame with ITEM: NUMBER OF ATOMS, and then ITEM: ATOMS; it does not.")

    def _frame(self, where: str, index: int, lines: list[str]) -> Frame:
        items = {line[5:].strip(): at + 1 for at, line in enumerate(lines[:MOST_LINES]) if line.startswith("ITEM:")}
        header = next((item for item in items if item.startswith("ATOMS")), "")
        bounds = next((item for item in items if item.startswith("BOX BOUNDS")), "")
        if not {"NUMBER OF ATOMS", header, bounds} <= items.keys() or len(lines) < items[bounds] + 3:
            raise LineError(0, "must begin a frame with ITEM: NUMBER OF ATOMS, BOX BOUNDS and ATOMS; it does not.")
        first, names, number = items[header], header.lower().split()[1:], lines[items["NUMBER OF ATOMS"]]
        rows = [line for line in lines[first:] if line.strip()]
        if number.strip() != f"{len(rows)}":
            raise changed(lines[0])
        low, size, periodic = _box_of_dump(bounds, lines, items[bounds])
        columns = table(rows, first, [(name, 1) for name in names], READ, "ITEM: ATOMS says")
        found = {name: values[:, 0] for name, values in columns.items()}
        ending = next((each for each in PLACES if {f"x{each}", f"y{each}"} <= found.keys()), None)
        if ending is None:
            raise LineError(first - 1, f"must name columns x and y, or xs, xu or xsu; got {' '.join(names)!r:.80}.")
        place = np.column_stack([found[f"{axis}{ending}"] for axis in "xyz" if f"{axis}{ending}" in found])
        if "s" in ending:
            place = place * size[: place.shape[1]] + low[: place.shape[1]]
        known: dict[str, Any] = {}
        if "u" in ending:
            known["image"] = np.zeros((len(place), 2), np.int64)
        elif {"ix", "iy"} <= found.keys():
            known["image"] = np.column_stack([found["ix"], found["iy"]])
        if {"vx", "vy"} <= found.keys():
            known["velocity"] = np.column_stack([found[name] for name in ("vx", "vy", "vz") if name in found])
        if "diameter" in found:
            known["radius"] = found["diameter"] / 2
        ours = {"radius": "radius", "mass": "mass", "id": "ids", "omegaz": "spin"}
        known |= {name: found[theirs] for theirs, name in ours.items() if theirs in found}
        if "TIME" in items:
            known["time"] = real(lines[items["TIME"]].strip(), "ITEM: TIME", items["TIME"])
        step = lines[items["TIMESTEP"]].strip() if "TIMESTEP" in items else ""
        number = int(step) if step.isdecimal() and len(step) <= LONGEST_NUMBER else index
        box, origin = (float(size[0]), float(size[1])), (float(low[0]), float(low[1]))
        return self._given.frame(where, number, box, origin, periodic, place, self._path, known)


def _box_of_dump(bounds: str, lines: list[str], at: int) -> tuple[Any, Any, tuple[bool, bool] | None]:
    """Lowest corner and sides of the box, and which axes are periodic; None if the frame, as old ones, does not say."""
    numbers = [[real(word, "ITEM: BOX BOUNDS", at + row) for word in lines[at + row].split()] for row in range(3)]
    wide = {len(row) for row in numbers}
    ends = np.array([row[:2] for row in numbers]) if wide in ({2}, {3}) else np.zeros((3, 2))
    low, size = ends[:, 0], ends[:, 1] - ends[:, 0]
    tilts = [abs(tilt) for row in numbers for tilt in row[2:]]
    if "abc" in bounds or min(size[:2]) <= 0 or max(tilts, default=0.0) > ROUNDING * min(size[:2]):
        raise LineError(
            at - 1,
            "must begin an upright rectangular box, with a lower and a higher bound in each line, and tilts of 0; got "
            f"{bounds!r}, {numbers}.",
        )
    flags = [word for word in bounds.split()[2:] if len(word) == 2 and set(word) <= set("pfsm")]
    return low, size, (flags[0] == "pp", flags[1] == "pp") if len(flags) == 3 else None


# --- Trajectories as extended XYZ, a text that OVITO, ASE and others read
#
# A frame is the number of its discs, a line of keys, and a line for each disc. Numbers are written so that reading
# them gives the same bits. A frame is complete if all its lines are there, each with its end; anything else at the end
# of the file is left from a killed process, and is dropped.

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

_BLANK = " \t,;[]{}"
_BETWEEN = re.compile(r"[\s,;\[\]{}]+")


class XyzWriter:
    """Appends frames to a file that is open for it."""

    def __init__(self, path: Path, mode: str):
        self._path = path
        self._file = path.open({"a": "ab", "x": "xb", "w": "wb"}[mode], buffering=0)

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
        self._file.truncate(scan(self._path, skip_frame).offsets[frames])

    def close(self) -> None:
        """Close the file, after forcing its content to the disk."""
        if not self._file.closed:
            with self._file:
                os.fsync(self._file.fileno())


class XyzReader(TextReader):
    """Reads frames at their positions in the file."""

    def number(self, index: int) -> int:
        start, end = self._offsets[index : index + 2]
        head = self._bytes(start, min(end, start + 2 * LONGEST_LINE)).lstrip().decode("utf-8", "replace")
        return _number_of(keys_of("".join(head.split("\n")[1:2])), index)

    def _skip(self, lines: Lines, head: bytes) -> bool:
        return skip_frame(lines, head)

    def _frame(self, where: str, index: int, lines: list[str]) -> Frame:
        head = lines[0].strip()
        count = int(head) if head.isdecimal() and len(head) <= LONGEST_NUMBER else -1
        if not 0 <= count <= len(lines) - 2 or any(map(str.strip, lines[count + 2 :])):
            raise changed(lines[0])
        comment, keys = lines[1], keys_of(lines[1])
        rows = lines[2 : 2 + count]
        # a file without names of columns may have more of them than those of the format
        further = f":_:S:{max(len(rows[0].split()) - 4, 0) if rows else 0}"
        known = _columns(rows, keys.get("properties", f"species:S:1:pos:R:3{further}"))
        position = known.pop("position")
        if "float32" in keys.get("precision", ""):
            position = position.astype(np.float32)
            reals = ("velocity", *(column.name for column in in_state() if not column.integer))
            known |= {name: known[name].astype(np.float32) for name in reals if name in known}
        if "time" in keys:
            known["time"] = real(keys["time"], "Time", 1)
        box, periodic, origin = _box(keys), _periodic(keys), (0.0, 0.0)
        if box is None and self._given.box is None:
            raise LineError(
                1,
                f"must hold the box, the key Lattice of extended XYZ; it is {comment.strip()!r:.80}. Have the program "
                "that wrote it write extended XYZ, or give box=(width, height).",
            )
        if "origin" in keys:
            numbers = _numbers(keys["origin"], "Origin")
            if len(numbers) < 2:
                raise LineError(
                    1, f"must have the corner of its box under Origin, 'x y z'; got {keys['origin']!r:.80}."
                )
            origin = numbers[0], numbers[1]
        number = _number_of(keys, index)
        return self._given.frame(where, number, box, origin, periodic, position, self._path, known)


def text_of(frame: Frame) -> Iterator[Any]:
    """A frame as text, as bytes in parts: for ten million discs, the text is longer than all their arrays."""
    yield _head_of(frame)
    for first, last in ranges(len(frame.position), PART):
        yield _rows_of(_columns_of(frame, slice(first, last)), last - first).tobytes()


def _head_of(frame: Frame) -> bytes:
    (width, height), (left, low) = frame.box, frame.origin
    wraps = " ".join("T" if wrap else "F" for wrap in (*frame.periodic, False))
    further = [f":{name}:{kind_of(column)}" for name, column in _of_states().items() if column.name in frame.known]
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
    for column in _of_states().values():
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


def skip_frame(lines: Lines, head: bytes) -> bool:
    """Skip a frame, as `text_frames.Skip`; a frame that mpsim wrote is incomplete without its last newline."""
    if not head.strip().isdigit() or len(head.strip()) > LONGEST_NUMBER:
        raise LineError(
            0, f"must give the number of discs where a frame begins; got {head[:80]!r}. Give a file of extended XYZ."
        )
    if lines.unended:
        raise EOFError
    comment = lines.next()
    lines.next(int(head))
    return lines.even and b"precision=" not in comment


_QUOTED = r'"(?:[^"\\]|\\.)*"|\'(?:[^\'\\]|\\.)*\''

_KEY = re.compile(rf"({_QUOTED}|[^\s=]+)(?:\s*=\s*({_QUOTED}|\{{[^}}]*\}}|\[\[.*?\]\s*\]|\[[^\]]*\]|\S*))?")


_COLON = re.compile(r"\b(Timestep|Time): +")  # what stands before a value in the plain XYZ of LAMMPS


def keys_of(comment: str) -> dict[str, str]:
    """Keys, in lower case, and values of the second line of a frame. Words without a key continue `pbc=T T F`.

    >>> keys_of("Lattice='1 0 0 0 2 0 0 0 1' Time=0.5 PBC=[T, F, F]")
    {'lattice': '1 0 0 0 2 0 0 0 1', 'time': '0.5', 'pbc': 'T, F, F'}
    """
    keys, open_key = dict[str, str](), ""
    for match in _KEY.finditer(_COLON.sub(r"\1=", comment)):
        name, value = match.groups()
        if value is None:
            if open_key:
                keys[open_key] += f" {name}"
            continue
        name = name.strip("\"'").lower()
        bare = value[:1] not in "\"'{["
        open_key = name if bare and name in ("pbc", "lattice", "origin") else ""
        keys[name] = value if bare else value[1:-1]
    return keys


def _number_of(keys: dict[str, str], index: int) -> int:
    """The frame of the simulation, or the time step of LAMMPS; the index of a frame whose second line does not say."""
    text = keys.get("frame", keys.get("timestep", ""))
    return int(text) if text.isdecimal() and len(text) <= LONGEST_NUMBER else index


def _columns(rows: list[str], properties: str) -> dict[str, Any]:
    parts = properties.split(":")
    if len(parts) % 3 or not all(width.isdecimal() and len(width) < 5 for width in parts[2::3]):
        raise LineError(
            1, f"must name its columns as name:type:width, again and again; got Properties={properties:.80}."
        )
    columns = [(name.lower(), int(width)) for name, width in zip(parts[::3], parts[2::3], strict=True)]
    widths, known = dict(columns), {**_NAMED, **_of_states()}
    if "momenta" in widths and not any(known.get(name) == _VELOCITY for name in widths):
        known["momenta"] = _MOMENTUM
    for name, width in widths.items():
        least = len(known[name].components) + 1 if name in known else 0
        if width < least:
            raise LineError(1, f"must have a column {name} of {least} numbers or more; got {width}.")
    if "pos" not in widths:
        raise LineError(1, f"must have the column pos:R:3, the places; its Properties are {properties:.80}.")
    kinds = {name: int if known[name].integer else float for name in widths if name in known}
    found = dict[str, Any]()
    for name, values in table(rows, 2, columns, kinds, "Properties say").items():
        column = known[name]
        wide = values if column.name in ("position", "velocity", "momentum") else values[:, :2]
        found[column.name] = np.ascontiguousarray(wide) if column.components else values[:, 0]
    momentum = found.pop("momentum", None)
    if momentum is not None and "mass" in found and (found["mass"] > 0).all():
        found["velocity"] = momentum / found["mass"][:, None]
    return found


def _of_states() -> dict[str, Column]:
    """Further columns of a state, by their names in a file: their own if OVITO and ASE have no name for them."""
    names = {column: name for name, column in _NAMED.items()}
    return {names.get(column, column.name): column for column in in_state()}


def _box(keys: dict[str, str]) -> tuple[float, float] | None:
    """Width and height; None if there is no box, or one of zeros, which stands for none."""
    if "lattice" not in keys:
        return None
    numbers = _numbers(keys["lattice"], "Lattice")
    if len(numbers) == 3:
        numbers = [numbers[0], 0, 0, 0, numbers[1], 0, 0, 0, numbers[2]]
    if not any(numbers):
        return None
    slanted = max((abs(numbers[index]) for index in (1, 2, 3, 5, 6, 7)), default=0.0) if len(numbers) == 9 else 1.0
    if len(numbers) != 9 or min(numbers[0], numbers[4]) <= 0 or slanted > ROUNDING * min(numbers[0], numbers[4]):
        raise LineError(
            1,
            "must have an upright rectangular box with sides above 0, Lattice='width 0 0 0 height 0 0 0 z'; got "
            f"{keys['lattice']!r:.80}.",
        )
    return numbers[0], numbers[4]


def _periodic(keys: dict[str, str]) -> tuple[bool, bool] | None:
    """Whether x, and whether y, is periodic; None if the frame does not say."""
    words = _BETWEEN.split(keys.get("pbc", "").strip(_BLANK).lower())
    if "pbc" not in keys:
        return None
    values = [{"t": True, "true": True, "1": True, "f": False, "false": False, "0": False}.get(word) for word in words]
    if None in values or len(values) > 3:
        raise LineError(1, f"must say under pbc which axes are periodic, such as pbc='T T F'; got {keys['pbc']!r:.80}.")
    return bool(values[0]), bool(values[:2][-1])


def _numbers(text: str, key: str) -> list[float]:
    return [real(word, key, 1) for word in _BETWEEN.split(text.strip(_BLANK)) if word]
