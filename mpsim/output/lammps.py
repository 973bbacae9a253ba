"""Trajectories of LAMMPS, as its dump styles atom and custom write them in text. They are only read."""

import re
from typing import Any, BinaryIO

import numpy as np

from mpsim.output.frames import ROUNDING, Frame
from mpsim.output.xyz import NUMBER, TextReader, lines_from, numbers_of, refusal, skip_rows, table

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
        low, size, periodic = _box(where, *_item(where, header, "BOX BOUNDS"))
        # columns that are not read may share a name
        widths = {name if name in READ else f"{at}": 1 for at, name in enumerate(map(str.lower, names))}
        columns = table(where, lines[head : head + count], head + 1, widths, READ, "ITEM: ATOMS says")
        found = {name: values[:, 0] for name, values in columns.items()}
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
        if "ITEM: TIME\n" in header:
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


def _box(where: str, line: int, words: list[str], text: str) -> tuple[Any, Any, tuple[bool, bool] | None]:
    """Lowest corner and sides of the box, and which axes are periodic; None if the frame, as old ones, does not say."""
    numbers = numbers_of(where, line + 1, "ITEM: BOX BOUNDS", text, 6)
    rows = np.reshape(numbers[: len(numbers) // 3 * 3], (3, -1))
    low, size, tilts = rows[:, 0], rows[:, 1] - rows[:, 0], rows[:, 2:]
    if len(numbers) not in (6, 9) or min(size[:2]) <= 0 or np.abs(tilts).max(initial=0) > ROUNDING * min(size[:2]):
        rule = "must begin an upright rectangular box, with a lower and a higher bound in each line, and tilts of 0"
        raise refusal(where, line, f"{rule}; got {text!r:.80}.")
    flags = [word for word in words if re.fullmatch("[pfsm]{2}", word)]
    return low, size, (flags[0] == "pp", flags[1] == "pp") if len(flags) == 3 else None
