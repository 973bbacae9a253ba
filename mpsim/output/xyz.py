"""Trajectories as extended XYZ, a text that OVITO, ASE and others read.

A frame is the number of its discs, a line of keys, and a line for each disc. Numbers are written so that reading them
gives the same bits. A frame is complete if all its lines are there, each with its end; anything else at the end of the
file is left from a killed process, and is dropped.
"""

import os
import re
from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from mpsim.core.chunks import ranges
from mpsim.core.columns import IMAGE, MASS, Column, in_state
from mpsim.core.joint_file import JointFile
from mpsim.core.team import Team, raise_first
from mpsim.kernels.text_rows import join_rows
from mpsim.output.frames import ROUNDING, Frame, kind_of
from mpsim.output.text_frames import (
    LONGEST_LINE,
    LONGEST_NUMBER,
    LineError,
    Lines,
    TextReader,
    changed,
    real,
    scan,
    table,
)

PROPERTIES = "species:S:1:pos:R:3:radius:R:1:mass:R:1:masses:R:1:velo:R:3:momenta:R:3:id:I:1"
"""Columns that mpsim writes: mass and velo by the names that OVITO knows, masses and momenta by those of ASE."""

PART = 20_000
"""Discs whose lines are made at a time."""

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
        self._file = path.open({"a": "ab", "x": "xb", "w": "wb"}[mode])

    def write(self, frame: Frame) -> None:
        """Append a frame, and pass it to the operating system."""
        for part in text_of(frame):
            self._file.write(part)
        self._file.flush()

    def truncate(self, frames: int) -> None:
        """Cut the file after its first frames, and after the last complete one."""
        self._file.truncate(scan(self._path, skip_frame).offsets[frames])

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
            with self._file:
                os.fsync(self._file.fileno())


class XyzReader(TextReader):
    """Reads frames at their positions in the file."""

    def number(self, index: int) -> int:
        """The frame of the simulation that is at an index; the index itself if the file does not say."""
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


_COLON = re.compile(r"\b(Timestep|Time): +")
"""What stands before a value in the plain XYZ of LAMMPS."""


def keys_of(comment: str) -> dict[str, str]:
    """Keys, in lower case, and values of the second line of a frame.

    Values are in quotes or brackets, or are words. Words without a key continue the value of `pbc=T T F`.

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
    """The columns that mpsim knows, by their names in mpsim."""
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
