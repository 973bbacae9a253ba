"""Trajectories as extended XYZ, a text that OVITO, ASE and others read.

A frame is the number of its discs, a line of keys, and a line for each disc. Numbers are written so that reading them
gives the same bits. A frame is complete if all its lines are there, each with its end; anything else at the end of the
file is left from a killed process, and is dropped.
"""

import functools
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from itertools import accumulate, islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import orjson
from numpy.typing import NDArray

from mpsim.core import untrusted
from mpsim.core.chunks import ranges
from mpsim.core.columns import IMAGE, MASS, Column, in_state
from mpsim.core.errors import TrajectoryError, TrajectoryWarning, level_of_caller
from mpsim.core.joint_file import JointFile
from mpsim.core.team import Team, raise_first
from mpsim.kernels.text_rows import join_rows
from mpsim.output.frames import Frame, kind_of

PROPERTIES = "species:S:1:pos:R:3:radius:R:1:mass:R:1:masses:R:1:velo:R:3:momenta:R:3:id:I:1"
"""Columns that mpsim writes: mass and velo by the names that OVITO knows, masses and momenta by those of ASE."""

PART = 20_000
"""Discs whose lines are made at a time."""

_KEY = re.compile(r'([A-Za-z_][\w-]*)\s*=\s*(?:"([^"]*)"|\{([^}]*)\}|(\S+))')

_POSITION, _VELOCITY = Column("position", "centres", (2,)), Column("velocity", "velocities", (2,))

_NAMED: dict[str, Column] = {
    "pos": _POSITION,
    "velo": _VELOCITY,
    "vel": _VELOCITY,
    "radius": Column("radius", "radii"),
    "mass": MASS,
    "masses": MASS,
    "map_shift": IMAGE,
    "id": Column("ids", "numbers of the discs", integer=True),
}
"""Columns that go by the names that OVITO and ASE know; each bears the name of the attribute of a Frame that it is."""

_LONGEST_COUNT = 18
"""Bytes of the line that holds the number of discs at most: a longer one is no trajectory."""

_LONGEST_LINE = 2**20
"""Bytes of any other line at most."""


class XyzWriter:
    """Appends frames to a file that is open for it."""

    def __init__(self, path: Path, mode: str):
        self._path = path
        self._file = path.open({"a": "ab", "x": "xb", "w": "wb"}[mode])

    def write(self, frame: Frame) -> None:
        """Append a frame, and pass it to the operating system."""
        for part in text_of(frame):
            self._file.write(part)
        self._file.flush()

    def truncate(self, frames: int) -> None:
        """Cut the file after its first frames, and after the last complete one."""
        offsets, _ = scan(self._path)
        self._file.truncate(offsets[frames])

    @property
    def end(self) -> int:
        """The end of the file, where the next frame begins."""
        return os.fstat(self._file.fileno()).st_size

    def cut(self, end: int) -> None:
        """Cut off the remains of a failed frame."""
        self._file.truncate(end)

    def close(self) -> None:
        """Close the file, after forcing its content to the disk."""
        if not self._file.closed:
            os.fsync(self._file.fileno())
            self._file.close()


class XyzReader:
    """Reads frames at their positions in the file."""

    def __init__(self, path: Path):
        self._path = path
        self._offsets, lost = scan(path)
        if lost:
            warnings.warn(
                f"the trajectory {str(path)!r} ends in the middle of a frame, as after a kill; the last {lost} "
                f"bytes are not read. Its {len(self)} complete frames can be read.",
                TrajectoryWarning,
                stacklevel=level_of_caller(),
            )

    def __len__(self) -> int:
        return len(self._offsets) - 1

    def refresh(self) -> None:
        """Look for frames written since the last call; if the file has been replaced, for all frames."""
        try:
            self._offsets, _ = scan(self._path, self._offsets)
        except TrajectoryError:
            self._offsets, _ = scan(self._path)

    def number(self, index: int) -> int:
        """The frame of the simulation that is at an index; the index itself if the file does not say."""
        with self._path.open("rb") as file:
            file.seek(self._offsets[index])
            file.readline()
            keys = keys_of(file.readline().decode("utf-8", "replace"))
        return self._number(keys, index)

    def read(self, index: int) -> Frame:
        """One frame.

        Raises:
            TrajectoryError: naming what the file lacks.
        """
        start, end = self._offsets[index : index + 2]
        with self._path.open("rb") as file:
            file.seek(start)
            lines = file.read(end - start).decode("utf-8", "replace").split("\n")
        where = f"frame {index} of {str(self._path)!r}"
        if not lines[0].strip().isdecimal() or len(lines) != int(lines[0]) + 3:  # the last line ends, too
            raise TrajectoryError(
                f"{where} must be where it was when the file was opened; its first line is {lines[0]!r:.80} now. "
                "The file has been changed: open it again."
            )
        count, keys = int(lines[0]), keys_of(lines[1])
        if "Lattice" not in keys:
            raise TrajectoryError(
                f"{where} must hold the box, the key Lattice of extended XYZ; its second line is {lines[1]!r:.80}. "
                "Have the program that wrote it write extended XYZ."
            )
        known: dict[str, Any] = _columns(lines[2 : 2 + count], keys.get("Properties", "species:S:1:pos:R:3"), where)
        position = known.pop("position")
        if "float32" in keys.get("precision", ""):
            position = position.astype(np.float32)
            reals = ("velocity", *(column.name for column in in_state() if not column.integer))
            known |= {name: known[name].astype(np.float32) for name in reals if name in known}
        for key in ("Time", "time"):
            if key in keys:
                known["time"] = _number(keys[key], where, key)
        wraps = keys.get("pbc", "T T T").split()
        periodic = wraps[0] in ("T", "1", "True"), wraps[1:2] in (["T"], ["1"], ["True"])
        box, origin = _box(keys["Lattice"], where), _origin(keys.get("Origin", "0 0"), where)
        return Frame(self._number(keys, index), box, origin, periodic, position, self._path, known)

    def close(self) -> None:
        """Do nothing: the file is open only while a frame is read."""

    def _number(self, keys: dict[str, str], index: int) -> int:
        text = keys.get("Frame", "")
        return int(text) if text.isdecimal() and len(text) < _LONGEST_COUNT else index


def write_jointly(file: JointFile, team: Team, frame: Frame, begin: int) -> None:
    """Write a frame at a position; all processes call it, and those that write make the lines of some discs at a time.

    frame: read in chunks, by all at once, each its own, so that none has to hold the text of its share.

    Raises:
        Exception: on all processes, the one that any of them gets while it writes.
    """
    at, parts, order, failed = begin, ranges(len(frame.position), PART), sorted(file.writers), list[Exception]()
    own, head = order.index(team.rank) if team.rank in order else len(parts), _head_of(frame)
    team.once(lambda: file.write(head, begin))  # before all lines: killed at any moment, they leave the head of a frame
    at += len(head)
    for turn in range(file.rounds(len(parts))):
        text = b""
        if (part := own + turn * len(order)) < len(parts):
            text = _text_of_rows(frame, *parts[part])
        else:  # the others read now; and what is asked for again would not be read again
            frame.position[turn + 1 : turn + 1]
        lengths = team.all_of(len(text))
        try:
            file.write(text, at + sum(lengths[: team.rank]))
        except Exception as error:  # the others go on to read
            failed.append(error)
        at += sum(lengths)
    team.on_all(lambda: raise_first(failed))


def text_of(frame: Frame) -> Iterator[Any]:
    """A frame as text, as bytes in parts: for ten million discs, the text is longer than all their arrays."""
    yield _head_of(frame)
    yield from (_text_of_rows(frame, *rows) for rows in ranges(len(frame.position), PART))


def _text_of_rows(frame: Frame, first: int, last: int) -> bytes:
    """A line for each disc of a range."""
    return _rows_of(_columns_of(frame, slice(first, last)), last - first).tobytes()


def _head_of(frame: Frame) -> bytes:
    """Its first two lines."""
    (width, height), (left, low) = frame.box, frame.origin
    wraps = " ".join("T" if wrap else "F" for wrap in (*frame.periodic, False))
    return (
        f'{len(frame.position)}\nLattice="{width!r} 0.0 0.0 0.0 {height!r} 0.0 0.0 0.0 1.0" Origin="{left!r} {low!r} '
        f'0.0" Properties={_properties_of(frame)} Time={frame.time!r} pbc="{wraps}" Frame={frame.frame} '
        f"precision={frame.position.dtype}\n"
    ).encode()


def _properties_of(frame: Frame) -> str:
    """The names of the columns, their kinds and widths."""
    further = (f":{name}:{kind_of(column)}" for name, column in _of_states().items() if column.name in frame.known)
    return "".join([PROPERTIES, *further])


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


def scan(path: Path, known: Sequence[int] = (0,)) -> tuple[list[int], int]:
    """Where each complete frame begins, where the last one ends, and how many bytes follow it.

    The file is streamed, not held.

    Args:
        path: of the file.
        known: the result of an earlier scan of it; that part is not read again.

    Raises:
        TrajectoryError: if it is no XYZ file.
    """
    with untrusted.opened(path) as file:
        size = file.seek(0, os.SEEK_END)
        offsets = [offset for offset in known if offset <= size]
        file.seek(offsets[-1])
        while offsets[-1] < size:
            head = file.readline(_LONGEST_COUNT + 1)
            if not head.strip() and not file.read(_LONGEST_COUNT).strip() and file.tell() == size:
                return offsets, 0  # blank lines at the end, as some programs leave them
            if not head.endswith(b"\n") and file.tell() == size and head.strip().isdigit():
                break
            if not head.strip().isdigit() or len(head) > _LONGEST_COUNT:
                raise TrajectoryError(
                    f"a trajectory in XYZ must give the number of discs where a frame begins; {str(path)!r} holds "
                    f"{head!r} at byte {offsets[-1]}, frame {len(offsets) - 1}. Give a file of extended XYZ."
                )
            lines = 1 + int(head)
            if not _skipped(file, lines, path):
                break
            offsets.append(file.tell())
    return offsets, size - offsets[-1]


def _skipped(file: BinaryIO, lines: int, path: Path) -> bool:
    """Skip so many lines; False if the file ends before that.

    Raises:
        TrajectoryError: for a line that is longer than any line of a trajectory.
    """
    for line in islice(iter(functools.partial(file.readline, _LONGEST_LINE), b""), lines):
        if not line.endswith(b"\n"):  # as only the last line of a file may
            if len(line) == _LONGEST_LINE and b"\0" not in line:  # as it is where ranks were killed as they wrote
                raise TrajectoryError(
                    f"a trajectory in XYZ must have lines of less than {_LONGEST_LINE:,} bytes; "
                    f"{str(path)!r} has a longer one at byte {file.tell() - len(line)}. Give a file of extended XYZ."
                )
            return False
        lines -= 1
    return not lines


def keys_of(comment: str) -> dict[str, str]:
    """Keys and values of the second line of a frame.

    >>> keys_of('Lattice="1 0 0 0 2 0 0 0 1" Time=0.5 pbc="T F F"')
    {'Lattice': '1 0 0 0 2 0 0 0 1', 'Time': '0.5', 'pbc': 'T F F'}
    """
    return {name: next(filter(None, values), "") for name, *values in _KEY.findall(comment)}


def _columns(lines: list[str], properties: str, where: str) -> dict[str, Any]:
    """The columns that mpsim knows, by their names in mpsim."""
    parts = properties.split(":")
    if len(parts) % 3 or not all(width.isdecimal() and len(width) < 5 for width in parts[2::3]):
        raise TrajectoryError(
            f"{where} must name its columns as name:type:width, again and again; got Properties={properties:.80}."
        )
    widths = [int(width) for width in parts[2::3]]
    tokens = [line.split() for line in lines]
    if any(len(row) != sum(widths) for row in tokens):
        row = next(row for row in tokens if len(row) != sum(widths))
        raise TrajectoryError(
            f"{where} must have {sum(widths)} columns, as its Properties say; got a line with {len(row)}: "
            f"{' '.join(row)!r:.80}. The file is damaged, or another program has written it wrongly."
        )
    known, found, first = {**_NAMED, **_of_states()}, {}, 0
    for name, width in zip(parts[::3], widths, strict=True):
        if name in known:
            found[known[name].name] = _read_columns(tokens, slice(first, first + width), name, known[name], where)
        first += width
    if "position" not in found:
        raise TrajectoryError(f"{where} must have the column pos:R:3, the places; its Properties are {properties:.80}.")
    return found


def _of_states() -> dict[str, Column]:
    """Further columns of a state, by their names in a file: their own if OVITO and ASE have no name for them."""
    names = {column: name for name, column in _NAMED.items()}
    return {names.get(column, column.name): column for column in in_state()}


def _read_columns(tokens: list[list[str]], which: slice, name: str, column: Column, where: str) -> NDArray[Any]:
    """Numbers of shape (N,), or (N, 2) for vectors, of which z is left out."""
    wide = column.components == (2,)
    try:
        values = [(int if column.integer else float)(value) for row in tokens for value in row[which]]
        table = np.array(values, column.dtype(np.dtype(np.float64)))
    except (ValueError, OverflowError) as error:
        raise TrajectoryError(
            f"{where} must hold numbers in its column {name}; got this error: {error!s:.120}."
        ) from None
    shape = (len(tokens), which.stop - which.start)
    table = table.reshape(shape)
    if shape[1] < (2 if wide else 1):
        raise TrajectoryError(f"{where} must have a column {name} of 2 numbers or 3; got {shape[1]}.")
    return np.ascontiguousarray(table[:, :2]) if wide else table[:, 0]


def _box(lattice: str, where: str) -> tuple[float, float]:
    numbers = [_number(text, where, "Lattice") for text in lattice.split()]
    if len(numbers) != 9 or any(numbers[index] for index in (1, 2, 3, 5, 6, 7)):
        raise TrajectoryError(
            f"{where} must have an upright rectangular box, Lattice='width 0 0 0 height 0 0 0 z'; got {lattice!r:.80}."
        )
    return numbers[0], numbers[4]


def _origin(corner: str, where: str) -> tuple[float, float]:
    numbers = [_number(text, where, "Origin") for text in corner.split()]
    if len(numbers) < 2:
        raise TrajectoryError(f"{where} must have the corner of its box under Origin, 'x y z'; got {corner!r:.80}.")
    return numbers[0], numbers[1]


def _number(text: str, where: str, key: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise TrajectoryError(f"{where} must hold numbers under {key}; got {text!r:.80}.") from None
