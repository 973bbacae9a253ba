"""Trajectories of LAMMPS, as its dump styles atom and custom write them in text. They are only read."""

from typing import Any

import numpy as np

from mpsim.output.frames import ROUNDING, Frame
from mpsim.output.text_frames import LONGEST_NUMBER, LineError, Lines, TextReader, changed, real, table

PLACES = "", "s", "u", "su"
"""Endings of the columns x, y and z: "s" for fractions of the box, "u" for places without periodic borders."""

READ: dict[str, type] = {
    **dict.fromkeys((f"{axis}{ending}" for axis in "xyz" for ending in PLACES), float),
    **dict.fromkeys(("vx", "vy", "vz", "radius", "diameter", "mass", "omegaz"), float),
    **dict.fromkeys(("id", "ix", "iy"), int),
}
"""Columns that are read, and the kind of their numbers."""

MOST_LINES = 100
"""Lines of a frame before its discs at most."""


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
