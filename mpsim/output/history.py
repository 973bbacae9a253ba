"""The table of a run: energy, overlap and collisions against time; figures of it and of a report."""

import csv
import io
import math
import os
from pathlib import Path
from typing import Any, TextIO

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mpsim.core import files
from mpsim.core.checks import Closable, refusal
from mpsim.core.state import State
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError, reason_of
from mpsim.kernels.records import PHASES
from mpsim.measure.observables import energy_of_rotation, energy_of_translation, overlap
from mpsim.output.drawing import COARSE, FINE, STYLE, draw, marker_of, new_figure, plain_ticks
from mpsim.output.frames import Frame
from mpsim.output.tables import phases_of
from mpsim.scene.scene import Scene

# --- The table of a run

MOST_BYTES = 2**30  # bytes of a table at most: some ten million rows

COLUMNS = ("frame", "time", "discs", "kinetic_energy", "overlap_mean", "overlap_largest", "collision_rate")
"""Time [time], energy [mass length^2/time^2], depth of the overlaps at that moment [length], and contacts resolved
per disc and time since the row before, or since the run was continued [1/time], each counting for both discs: the
`collisions` of a report. The measures `collision_rate` and `contact_rate` leave out contacts that changed no velocity.
Absorbed discs are not counted."""


class Recorder(Closable):
    """An observer of one simulation that writes a table row by row, flushing each.

    A table of the same run is continued; rows later than the simulation's frame are written again.
    """

    def __init__(self, path: Path, every: int, sim: Simulation):
        self.every: int = every
        self._since = sim.frame
        self._collisions = 0
        kept = [row for row in _rows(path) if int(row[0]) <= sim.frame]
        self._last = int(kept[-1][0]) if kept else -1
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([COLUMNS, *kept])
        with files.writable("the table of a run", path):
            files.write_text(path, text.getvalue())
            # Row by row: a kill costs the last one.
            self._file: TextIO = path.open("a", newline="", encoding="utf-8")

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Write a row for the present frame, unless the table has it."""
        frames, met = sim.frame - self._since, collisions - self._collisions
        self._since, self._collisions = sim.frame, collisions
        if sim.frame <= self._last:
            return
        self._last = sim.frame
        csv.writer(self._file, lineterminator="\n").writerow(row_of(sim, sim.state, frames, met))
        self._file.flush()

    def close(self) -> None:
        self._file.close()


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


# --- Figures of a run: energy, overlap and collision rate against time, and the final state


def history(table: dict[str, NDArray[np.float64]], scene: Scene, last: Frame, title: str) -> Figure:
    """Four panels: curves of the table of a run, and the last discs in the box of the scene."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(10, 6.4)
        (energy, rate), (depth, place) = figure.subplots(2, 2)
        time = table["time"]
        line: dict[str, Any] = {"marker": marker_of(len(time))}
        energy.plot(time, table["kinetic_energy"], color="#0072B2", **line)
        _label(energy, "Kinetic energy", "[mass length²/time²]", table["kinetic_energy"])
        rate.plot(time, table["collision_rate"], color="#0072B2", **line)
        _label(rate, "Collisions per disc and time", "[1/time]", table["collision_rate"])
        depth.plot(time, table["overlap_largest"], color="#D55E00", label="largest", **line)
        depth.plot(time, table["overlap_mean"], color="#0072B2", ls="--", label="mean of those that overlap", **line)
        _label(depth, "Depth of overlaps at that moment", "[length]", table["overlap_largest"], room=1.45)
        depth.legend(loc="upper left", fontsize=9)
        draw(last, scene, ax=place)
        figure.suptitle(title)
    return figure


def _label(axes: Axes, title: str, unit: str, values: NDArray[np.float64], room: float = 1.15) -> None:
    """Label a panel. It starts at 0, so that the rounding errors of a constant do not look like a rough curve."""
    top = float(np.nanmax(values, initial=0.0))
    axes.set(title=title, xlabel="time", ylabel=unit, ylim=(0, room * top if top > 0 else 1.0))


# --- Figure of a report: time of each frame, and of its phases for each worker

PHASE_COLOURS: dict[str, str] = dict(zip(PHASES, ("#0072B2", "#56B4E9", "#009E73", "#E69F00", "#CCCCCC"), strict=True))
"""Waiting is grey."""


def times(report: Report) -> Figure:
    """Above, the time of each frame; below, a bar for each worker, whose phases add up to a typical frame time."""
    frames = np.arange(1, report.frames + 1)
    means = usual_phases(report)
    workers = max(np.count_nonzero(sum(means.values())), 1)
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 4.4 + 0.3 * workers)
        above, below = figure.subplots(2, 1, height_ratios=[3, 1.4 + 0.3 * workers])
        microseconds = report.frame_seconds * 1e6
        # On a scale of ratios a frame that the system disturbed does not press all others to the floor.
        above.plot(frames, microseconds, color="#0072B2", linewidth=0.7, marker=marker_of(report.frames))
        if report.frames:
            median = float(np.median(microseconds))
            above.axhline(median, color="#D55E00", linewidth=1.2, label=f"median {median:.3g} µs")
            above.legend(loc="upper right")
            above.set(yscale="log", xlim=(0, report.frames + 1))
            plain_ticks(above.yaxis, FINE if microseconds.max() < 10 * microseconds.min() else COARSE)
        word = f"{report.method}, {report.workers} worker{'s' * (report.workers > 1)}"
        above.set(xlabel="frame of the run", ylabel="time of a frame [µs]", title=f"{report.frames} frames by {word}")
        left = np.zeros(workers)
        for name, label in phases_of(report).items():
            parts = means[name][:workers] * 1e6
            below.barh(np.arange(workers), parts, left=left, color=PHASE_COLOURS[name], label=label, height=0.7)
            left += parts
        waiting = 100 * means["wait"].sum() * 1e6 / (left.sum() or 1.0)
        below.set(
            xlabel=f"phases, mean of the middle half of all frames [µs]: {left.max(initial=0.0):.3g} µs; "
            f"{waiting:.0f} % is waiting for others",
            ylabel="worker",
            yticks=np.arange(workers),
            ylim=(workers - 0.4, -0.6),
        )
        below.grid(False, axis="y")
        if report.frames:
            figure.legend(*below.get_legend_handles_labels(), loc="outside lower center", ncols=len(PHASES), fontsize=9)
    return figure


def usual_phases(report: Report) -> dict[str, NDArray[np.float64]]:
    """Time of each phase for each worker, shape (workers,): mean over the middle half of the frame times [s].

    For each worker the phases add up to the mean time of these frames. Medians of phases would not, and means over all
    frames would be dominated by the few that were disturbed.
    """
    seconds = report.frame_seconds
    if not len(seconds):
        return {name: np.zeros(each.shape[1]) for name, each in report.phase_seconds.items()}
    low, high = np.quantile(seconds, [0.25, 0.75], method="inverted_cdf")  # times of frames: one is between
    usual = (seconds >= low) & (seconds <= high)
    return {name: each[usual].mean(axis=0) for name, each in report.phase_seconds.items()}
