"""Figures of a report and of a run."""

import os
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mpsim.engine.report import Report
from mpsim.kernels.records import PHASES
from mpsim.output.drawing import (
    COARSE,
    FINE,
    STYLE,
    draw,
    marker_of,
    new_figure,
    plain_ticks,
    save_figure,
)
from mpsim.output.frames import Frame
from mpsim.output.tables import phases_of
from mpsim.scene.scene import Scene

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


# --- Figures of a run: energy, overlap and collision rate against time, and the final state


def history(table: dict[str, NDArray[np.float64]], scene: Scene, last: Frame, title: str) -> Figure:
    """Four panels: curves of a table of `mpsim.output.recorder`, and the last discs in the box of the scene."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(10, 6.4)
        (energy, rate), (overlap, place) = figure.subplots(2, 2)
        time = table["time"]
        line: dict[str, Any] = {"marker": marker_of(len(time))}
        energy.plot(time, table["kinetic_energy"], color="#0072B2", **line)
        energy.set(ylabel="[mass length²/time²]", title="Kinetic energy")
        _from_zero(energy, table["kinetic_energy"])
        rate.plot(time, table["collision_rate"], color="#0072B2", **line)
        rate.set(ylabel="[1/time]", title="Collisions per disc and time")
        _from_zero(rate, table["collision_rate"])
        overlap.plot(time, table["overlap_largest"], color="#D55E00", label="largest", **line)
        overlap.plot(time, table["overlap_mean"], color="#0072B2", ls="--", label="mean of those that overlap", **line)
        overlap.set(ylabel="[length]", title="Depth of overlaps at that moment")
        _from_zero(overlap, table["overlap_largest"], room=1.45)
        overlap.legend(loc="upper left", fontsize=9)
        for axes in (energy, rate, overlap):
            axes.set_xlabel("time")
        draw(last, scene, ax=place)
        figure.suptitle(title)
    return figure


def final_picture(scene: Scene, last: Frame, path: str | os.PathLike[str]) -> Path:
    """The last frame of a run as a picture, in the format of the path's ending."""
    return save_figure(draw(last, scene), path)


def _from_zero(axes: Axes, values: NDArray[np.float64], room: float = 1.15) -> None:
    """Start the axis at 0, so that the rounding errors of a constant do not look like a rough curve."""
    top = float(np.nanmax(values, initial=0.0))
    axes.set_ylim(0, room * top if top > 0 else 1.0)
