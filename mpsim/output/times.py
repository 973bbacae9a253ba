"""Figure of a report: time of each frame, and of its phases for each worker."""

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mpsim.engine.report import Report
from mpsim.engine.solvers.methods import METHODS
from mpsim.kernels.layout import PHASES
from mpsim.output.drawing import STYLE, marker_of, new_figure

PHASE_COLOURS: dict[str, str] = dict(zip(PHASES, ("#0072B2", "#56B4E9", "#009E73", "#E69F00", "#CCCCCC"), strict=True))
"""Waiting is grey."""


def times(report: Report) -> Figure:
    """Above, the time of each frame; below, a bar for each worker, whose phases add up to a typical frame time."""
    frames = np.arange(1, report.frames + 1)
    workers = report.phase_seconds[PHASES[0]].shape[1]
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
        word = f"{report.method}, {report.workers} worker{'s' * (report.workers > 1)}"
        above.set(xlabel="frame of the run", ylabel="time of a frame [µs]", title=f"{report.frames} frames by {word}")
        left = np.zeros(workers)
        means = usual_phases(report)
        for name, label in phases_of(report).items():
            parts = means[name] * 1e6
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


def phases_of(report: Report) -> dict[str, str]:
    """The phases that took any time, and their names for this method."""
    words = METHODS[report.method].phases
    return {name: words.get(name, name) for name in PHASES if report.phase_seconds[name].any()}


def usual_phases(report: Report) -> dict[str, NDArray[np.float64]]:
    """Time of each phase for each worker, shape (workers,): mean over the middle half of the frame times [s].

    For each worker the phases add up to the mean time of these frames. Medians of phases would not, and means over all
    frames would be dominated by the few that were disturbed.

    >>> from mpsim import Scene, Simulation
    >>> with Simulation(Scene.random(count=50, packing=0.2, radius=0.5)) as sim:
    ...     report = sim.run(frames=20)
    >>> low, high = np.quantile(report.frame_seconds, [0.25, 0.75])
    >>> low <= sum(seconds[0] for seconds in usual_phases(report).values()) <= high
    np.True_
    """
    seconds = report.frame_seconds
    if not len(seconds):
        return {name: np.zeros(each.shape[1]) for name, each in report.phase_seconds.items()}
    low, high = np.quantile(seconds, [0.25, 0.75], method="inverted_cdf")  # times of frames, so that one is between
    usual = (seconds >= low) & (seconds <= high)
    return {name: each[usual].mean(axis=0) for name, each in report.phase_seconds.items()}
