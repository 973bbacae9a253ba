"""Trajectories as extended XYZ, a text that OVITO, ASE and others read.

A frame is the number of its discs, a line of keys, and a line for each disc. Numbers are written so that reading them
gives the same bits. A frame is complete if all its lines are there, each with its end; anything else at the end of the
file is left from a killed process, and is dropped.
"""

import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import orjson
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks, files
from mpsim.core.columns import IMAGE, MASS, Column, in_state, ranges
from mpsim.errors import InputError, TrajectoryError, TrajectoryWarning, level_of_caller
from mpsim.features.edges import check_boundary, wraps_of
from mpsim.kernels.output import join_rows
from mpsim.output.frames import Frame, kind_of

PROPERTIES = "species:S:1:pos:R:3:radius:R:1:mass:R:1:masses:R:1:velo:R:3:momenta:R:3:id:I:1"
"""Columns that mpsim writes: mass and velo by the names that OVITO knows, masses and momenta by those of ASE."""

PART = 20_000  # discs whose lines are made at a time
LONGEST_LINE = 2**20  # bytes of a line at most
LONGEST_NUMBER = 17  # digits of the number of a frame, or of the number of its discs, at most

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


def _of_states() -> dict[str, Column]:
    """Further columns of a state, by their names in a file: their own if OVITO and ASE have no name for them."""
    names = {column: name for name, column in _NAMED.items()}
    return {names.get(column, column.name): column for column in in_state()}


# --- Where each frame lies in a file


class LineError(Exception):
    """The index of a line in its frame, and what is wrong with it, in words that follow the name of the line."""


def scan(path: Path, known: Sequence[int] = (0,)) -> tuple[list[int], int]:
    """Find the frames of a file, which is streamed.

    known: offsets from an earlier scan, which is not done again.

    Returns:
        Where each complete frame begins, and where the last one ends; the bytes of an incomplete frame behind it.
    """
    with files.opened(path) as file:
        offsets = [offset for offset in known if offset <= os.fstat(file.fileno()).st_size]
        file.seek(offsets[-1])
        try:
            while _skip(file, first=len(offsets) == 1):
                offsets.append(file.tell())
        except LineError as error:
            raise _located(error, path, len(offsets) - 1) from None
        begin = offsets[-1]
        file.seek(begin)
        while line := file.readline(LONGEST_LINE):
            if line.strip():
                return offsets, os.fstat(file.fileno()).st_size - begin
    return offsets, 0


def _skip(file: BinaryIO, first: bool) -> bool:
    """Skip a frame; False if it is incomplete, or there is none."""
    while (head := file.readline(LONGEST_LINE)).isspace():
        pass
    if not head.strip().isdigit() or len(head.strip()) > LONGEST_NUMBER:
        if not head or not (first or head.endswith(b"\n")):
            return False
        raise LineError(
            0, f"must give the number of discs where a frame begins; got {head[:80]!r}. Give a file of extended XYZ."
        )
    for index in range(1, int(head) + 2):
        line = file.readline(LONGEST_LINE)
        if not line.endswith(b"\n"):
            if len(line) == LONGEST_LINE:
                raise LineError(index, f"must have less than {LONGEST_LINE:,} bytes; it has more.")
            return False
    return head.endswith(b"\n")


def _located(error: LineError, path: Path, index: int) -> TrajectoryError:
    line, words = error.args
    return TrajectoryError(f"frame {index} of {str(path)!r}, line {line + 1} of it, {words}")


# --- Writes


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
        self._file.truncate(scan(self._path)[0][frames])

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


# --- Reads

ROUNDING = 1e-9  # largest component of an upright box off its axes, relative to its sides

FLAT = 1e-6
"""Largest difference of z among discs in a plane, relative to the box; of their velocities, relative to the largest."""


class Given(NamedTuple):
    """What a reader is told about frames that do not say it themselves; None: nothing.

    Attributes:
        box: its width and height, and its lower left corner [length].
        boundary: whether x, and whether y, is periodic; both are if nobody says.
        radius: of all discs [length].
    """

    box: tuple[tuple[float, float], tuple[float, float]] | None = None
    boundary: tuple[bool, bool] | None = None
    radius: float | None = None

    @classmethod
    def of(cls, box: object, boundary: object, radius: object) -> "Given":
        """From arguments of the user."""
        found: Any = None
        if box is not None:
            rule = "(width, height) or (x_low, x_high, y_low, y_high)"
            numbers = checks.finite_array("box", box, (None,), rule).tolist()
            walls = (0.0, numbers[0], 0.0, numbers[1]) if len(numbers) == 2 else tuple(numbers)
            if len(walls) != 4 or not (walls[0] < walls[1] and walls[2] < walls[3]):
                raise checks.refusal("box", f"be {rule}, with sides above 0", checks.brief(box))
            x_low, x_high, y_low, y_high = walls
            found = (x_high - x_low, y_high - y_low), (x_low, y_low)
        wraps = None if boundary is None else wraps_of(check_boundary(boundary))
        return cls(found, wraps, None if radius is None else checks.positive("radius", radius, "[length]"))


class XyzReader:
    """Reads frames at their positions in a file, which is open only meanwhile."""

    def __init__(self, path: Path, given: Given):
        self._path = path
        self._given = given
        self._offsets, lost = scan(path)
        if lost:
            warnings.warn(
                f"the trajectory {str(path)!r} ends in the middle of a frame, as after a kill; the last {lost} bytes "
                f"are not read. Its {len(self)} complete frames can be read.",
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
        start, end = self._offsets[index : index + 2]
        lines = self._text(start, min(end, start + 2 * LONGEST_LINE)).split("\n", 2)
        return _number_of(keys_of("".join(lines[1:2])), index)

    def read(self, index: int) -> Frame:
        """One frame, or raise a TrajectoryError that names what the file lacks."""
        try:
            return self._frame(index, self._text(*self._offsets[index : index + 2]).split("\n"))
        except LineError as error:
            raise _located(error, self._path, index) from None

    def close(self) -> None:
        """Nothing is open."""

    def _text(self, start: int, end: int) -> str:
        with files.opened(self._path) as file:
            file.seek(start)
            return file.read(end - start).lstrip().decode("utf-8", "replace")

    def _frame(self, index: int, lines: list[str]) -> Frame:
        head = lines[0].strip()
        count = int(head) if head.isdecimal() and len(head) <= LONGEST_NUMBER else -1
        if not 0 <= count <= len(lines) - 2 or any(map(str.strip, lines[count + 2 :])):
            raise LineError(
                0,
                f"must be where it was when the file was opened; its first line is {lines[0]!r:.80} now. The file has "
                "been changed: open it again.",
            )
        keys, rows = keys_of(lines[1]), lines[2 : 2 + count]
        # a file without names of columns may have more of them than those of the format
        further = f":_:S:{max(len(rows[0].split()) - 4, 0) if rows else 0}"
        known = _columns(rows, keys.get("properties", f"species:S:1:pos:R:3{further}"))
        position = known.pop("position")
        if "float32" in keys.get("precision", ""):
            position = position.astype(np.float32)
            reals = ("velocity", *(column.name for column in in_state() if not column.integer))
            known |= {name: known[name].astype(np.float32) for name in reals if name in known}
        if "time" in keys:
            known["time"] = _real(keys["time"], "Time")
        own = Given(_box(keys), _periodic(keys), known.get("radius"))
        for name, given in self._given._asdict().items():
            if given is not None and getattr(own, name) is not None:
                raise InputError(
                    f"{name} can be given only for frames that do not hold it; frame {index} of {str(self._path)!r} "
                    f"holds {checks.brief(getattr(own, name))}. Leave it out."
                )
        if self._given.radius is not None:
            known["radius"] = np.full(len(position), self._given.radius)
        place = own.box or self._given.box
        if place is None:
            raise LineError(
                1,
                f"must hold the box, the key Lattice of extended XYZ; it is {lines[1].strip()!r:.80}. Have the program "
                "that wrote it write extended XYZ, or give box=(width, height).",
            )
        box, origin = place
        for name in ("radius", "mass"):
            if name in known and (known[name] < 0).any():
                raise LineError(2, f"and those below must hold no {name} below 0; got {known[name].min()}.")
        if "ids" in known:
            order = np.argsort(known["ids"], kind="stable")
            twice = np.flatnonzero(np.diff(known["ids"][order]) == 0)
            if len(twice):
                number = known["ids"][order[twice[0]]]
                raise LineError(2, f"and those below must hold each id once; got {number} twice.")
            position = position[order]
            known = {name: value if np.ndim(value) == 0 else value[order] for name, value in known.items()}
        position = _in_plane("position", position, position[:1, 2:], max(box))
        if "velocity" in known:
            speed = known["velocity"]
            known["velocity"] = _in_plane("velocity", speed, 0.0, np.abs(speed).max(initial=0.0))
        periodic = own.boundary or self._given.boundary or (True, True)
        return Frame(_number_of(keys, index), box, origin, periodic, position, self._path, known)


def _in_plane(name: str, vectors: NDArray[Any], z: ArrayLike, scale: float) -> NDArray[Any]:
    """Vectors of shape (N, 2), from some of shape (N, 2) or (N, 3) whose last component must be `z`."""
    off = np.flatnonzero(np.abs(vectors[:, 2:] - z) > FLAT * scale)
    if len(off):
        raise LineError(
            2,
            "and those below must be two-dimensional, with the same z for all discs, and no velocity along z; got a "
            f"{name} with z = {vectors[off[0], 2]:g} of disc {off[0]}, not {np.max(z):g}. Write one layer: mpsim has "
            "no third dimension.",
        )
    return np.ascontiguousarray(vectors[:, :2])


_QUOTED = r'"(?:[^"\\]|\\.)*"|\'(?:[^\'\\]|\\.)*\''

_KEY = re.compile(rf"({_QUOTED}|[^\s=]+)(?:\s*=\s*({_QUOTED}|\{{[^}}]*\}}|\[\[.*?\]\s*\]|\[[^\]]*\]|\S*))?")

_BLANK = " \t,;[]{}"
_BETWEEN = re.compile(r"[\s,;\[\]{}]+")


def keys_of(comment: str) -> dict[str, str]:
    """Keys, in lower case, and values of the second line of a frame. Words without a key continue `pbc=T T F`.

    >>> keys_of("Lattice='1 0 0 0 2 0 0 0 1' Time=0.5 PBC=[T, F, F]")
    {'lattice': '1 0 0 0 2 0 0 0 1', 'time': '0.5', 'pbc': 'T, F, F'}
    """
    keys, open_key = dict[str, str](), ""
    for match in _KEY.finditer(comment):
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
    """The frame of the simulation; the index of a frame whose second line does not say."""
    text = keys.get("frame", "")
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
    for name, values in _table(rows, columns, kinds).items():
        column = known[name]
        wide = values if column.name in ("position", "velocity", "momentum") else values[:, :2]
        found[column.name] = np.ascontiguousarray(wide) if column.components else values[:, 0]
    momentum = found.pop("momentum", None)
    if momentum is not None and "mass" in found and (found["mass"] > 0).all():
        found["velocity"] = momentum / found["mass"][:, None]
    return found


def _table(lines: list[str], columns: Sequence[tuple[str, int]], kinds: Mapping[str, type]) -> dict[str, NDArray[Any]]:
    """The numbers of some columns, by name, each of shape (N, width).

    columns: names and widths of all columns in a line; kinds: float or int, of those that are read.
    """
    dtype = np.dtype([(f"{i}", kinds.get(name, "U1"), (width,)) for i, (name, width) in enumerate(columns)])
    try:
        found = np.atleast_1d(np.loadtxt(lines, dtype, comments=None)) if lines else np.zeros(0, dtype)
        if len(found) < len(lines):
            raise ValueError("a blank line")
    except ValueError as error:
        width = sum(width for _, width in columns)
        raise LineError(
            2,
            f"and those below must have {width} columns, as its Properties say, with numbers in those that are read; "
            f"got {error!s:.150}. The file is damaged, or another program has written it wrongly.",
        ) from None
    values = {name: found[f"{i}"] for i, (name, _) in enumerate(columns) if name in kinds}
    for name, array in values.items():
        infinite = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if len(infinite):
            row = infinite[0]
            raise LineError(2 + int(row), f"must hold finite numbers in its column {name}; got {array[row]}.")
    return values


def _real(text: str, key: str) -> float:
    """A finite number under a key."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise LineError(1, f"must hold finite numbers under {key}; got {text!r:.80}.")
    return value


def _box(keys: dict[str, str]) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """As of `Given`; None if there is no box, or one of zeros, which stands for none."""
    numbers = _numbers(keys.get("lattice", ""), "Lattice")
    if not any(numbers):
        return None
    slanted = max(abs(numbers[index]) for index in (1, 2, 3, 5, 6, 7)) if len(numbers) == 9 else 1.0
    if len(numbers) != 9 or min(numbers[0], numbers[4]) <= 0 or slanted > ROUNDING * min(numbers[0], numbers[4]):
        raise LineError(
            1,
            "must have an upright rectangular box with sides above 0, Lattice='width 0 0 0 height 0 0 0 z'; got "
            f"{keys['lattice']!r:.80}.",
        )
    corner = _numbers(keys.get("origin", "0 0"), "Origin")
    if len(corner) < 2:
        raise LineError(1, f"must have the corner of its box under Origin, 'x y z'; got {keys['origin']!r:.80}.")
    return (numbers[0], numbers[4]), (corner[0], corner[1])


def _periodic(keys: dict[str, str]) -> tuple[bool, bool] | None:
    """Whether x, and whether y, is periodic; None if the frame does not say."""
    if "pbc" not in keys:
        return None
    words = _BETWEEN.split(keys["pbc"].strip(_BLANK).lower())
    values = [{"t": True, "true": True, "1": True, "f": False, "false": False, "0": False}.get(word) for word in words]
    if None in values or len(values) > 3:
        raise LineError(1, f"must say under pbc which axes are periodic, such as pbc='T T F'; got {keys['pbc']!r:.80}.")
    return bool(values[0]), bool(values[:2][-1])


def _numbers(text: str, key: str) -> list[float]:
    return [_real(word, key) for word in _BETWEEN.split(text.strip(_BLANK)) if word]
