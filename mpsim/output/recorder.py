"""The table of a run: energy, overlap and collisions against time."""

import csv
import io
import math
import os
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks, files
from mpsim.core.checks import refusal
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError, reason_of
from mpsim.measure.moments import energy_of_rotation, energy_of_translation
from mpsim.measure.observables import overlap
from mpsim.output.frames import Ownership

MOST_BYTES = 2**30  # bytes of a table at most: some ten million rows

COLUMNS: tuple[str, ...] = (
    "frame",
    "time",
    "discs",
    "kinetic_energy",
    "overlap_mean",
    "overlap_largest",
    "collision_rate",
)
"""Time [time], energy [mass length^2/time^2], depth of the overlaps at that moment [length], and contacts resolved
per disc and time since the row before, or since the run was continued [1/time], each counting for both discs: the
`collisions` of a report. The measures `collision_rate` and `contact_rate` leave out contacts that changed no velocity.
Absorbed discs are not counted."""


class Recorder:
    """An observer that writes a table row by row, flushing each; it belongs to its simulation.

    A table of the same run is continued; rows later than the simulation's frame are written again.
    """

    def __init__(self, path: str | os.PathLike[str], every: int, sim: Simulation):
        self.every: int = checks.whole("every", every, 1, 10**12, "1 writes a row for every frame.")
        self._path = Path(path)
        self._ownership = Ownership("table", self._path, "Make a Recorder for each, with a file of its own.")
        self._ownership.bind_or_check(sim)
        self._since = sim.frame
        self._collisions = 0
        self._last = self._open(sim.frame)

    def _open(self, frame: int) -> int:
        """Cut the table back to a frame, and open it. Returns the frame of its last row; -1: there is none."""
        kept = [row for row in _rows(self._path) if int(row[0]) <= frame]
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([COLUMNS, *kept])
        with files.writable("the table of a run", self._path):
            files.write_text(self._path, text.getvalue())
            # Row by row: a kill costs the last one.
            self._file: TextIO = self._path.open("a", newline="", encoding="utf-8")
        return int(kept[-1][0]) if kept else -1

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Write a row for the present frame, unless the table has it."""
        self._ownership.bind_or_check(sim)
        frames, met = sim.frame - self._since, collisions - self._collisions
        self._since, self._collisions = sim.frame, collisions
        if sim.frame <= self._last:
            return
        self._last = sim.frame
        csv.writer(self._file, lineterminator="\n").writerow(row_of(sim, sim.state, frames, met))
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._ownership.close("To write more rows, make another Recorder for it.")
        self._file.close()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def row_of(sim: Simulation, state: State, frames: int, met: int) -> list[float]:
    """The row of a state, in the order of COLUMNS; met: contacts resolved in the frames since the row before."""
    here = state.present
    radii = sim.radii[here]
    energy = energy_of_translation(state, sim.masses) + energy_of_rotation(state, sim.masses, sim.radii)
    depth = overlap(State(state.position[here], state.velocity[here]), sim.scene, radii)
    count = len(radii)
    rate = 2 * met / (count * frames * sim.settings.dt) if count and frames > 0 else math.nan
    return [sim.frame, sim.time, count, energy, depth.mean, depth.largest, rate]


def read_table(path: str | os.PathLike[str]) -> dict[str, NDArray[np.float64]]:
    """Columns of a table by name, each of shape (rows,)."""
    rows = _rows(Path(path))
    try:
        values = np.array([[float(value) for value in row] for row in rows]).reshape(len(rows), len(COLUMNS))
    except ValueError as error:
        reason = str(error)[:120]
        raise InputError(f"{os.fspath(path)!r} must be a table of numbers that a run has written; {reason}.") from None
    return dict(zip(COLUMNS, values.T, strict=True))


def _rows(path: Path) -> list[list[str]]:
    """Complete rows of a file, without the head; none if there is no file."""
    if not path.exists():
        return []
    try:
        text = files.content(path, MOST_BYTES).decode("utf-8", "replace")
    except OSError as error:
        rule = "be a table that a run has written"
        raise refusal(repr(str(path)), rule, f"a file that cannot be read, {reason_of(error)}") from None
    head, *rows = (line.split(",") for line in text.rpartition("\n")[0].split("\n"))
    if tuple(head) != COLUMNS:
        if head == [""]:
            return []
        raise refusal(repr(str(path)), f"begin with the columns {','.join(COLUMNS)}", repr(",".join(head)[:80]))
    for number, row in enumerate(rows, start=2):
        if len(row) != len(COLUMNS) or not row[0].isdecimal():
            rule = f"be a row of {len(COLUMNS)} numbers that a run has written"
            instead = "Remove the file: the run continues without what it held."
            raise refusal(f"line {number} of {str(path)!r}", rule, repr(",".join(row)[:80]), instead)
    return rows
