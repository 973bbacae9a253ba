"""Figures of the benchmark, of a report and of a run."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from mpsim.engine.report import Report
from mpsim.engine.solvers.methods import METHODS
from mpsim.kernels.records import PHASES
from mpsim.output.drawing import (
    COARSE,
    DISC_COLOUR,
    FINE,
    STYLE,
    draw,
    draw_discs,
    marker_of,
    new_figure,
    plain_ticks,
    save_figure,
)
from mpsim.output.frames import Frame
from mpsim.scene.scene import Scene
from mpsim.studies.benchmark import Fixed, Repeat, Timing

# --- Figure of a report: time of each frame, and of its phases for each worker

PHASE_COLOURS: dict[str, str] = dict(zip(PHASES, ("#0072B2", "#56B4E9", "#009E73", "#E69F00", "#CCCCCC"), strict=True))
"""Waiting is grey."""


def times(report: Report) -> Figure:
    """Above, the time of each frame; below, a bar for each worker, whose phases add up to a typical frame time."""
    frames = np.arange(1, report.frames + 1)
    means, compared = usual_phases(report), frames_of_the_workers(report)
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
        which = "all frames" if compared.all() else f"the {np.count_nonzero(compared)} frames by {word}"
        gap = " " if compared.all() else "\n"
        below.set(
            xlabel=f"phases, mean of the middle half of {which} [µs]:{gap}{left.max(initial=0.0):.3g} µs; "
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


def frames_of_the_workers(report: Report) -> NDArray[np.bool_]:
    """The frames in which as many workers took part as the report names, shape (frames,); all if there are none.

    While "auto" tries its candidates, there are frames of others.
    """
    working = sum(report.phase_seconds.values()) > np.zeros((report.frames, 1))
    chosen = np.count_nonzero(working, axis=1) == report.workers
    return chosen if chosen.any() else np.ones(report.frames, bool)


def usual_phases(report: Report) -> dict[str, NDArray[np.float64]]:
    """Time of each phase for each worker, shape (workers,): mean over the middle half of the frame times [s].

    Frames with another number of workers than the report names are left out. For each worker the phases add up to the
    mean time of these frames. Medians of phases would not, and means over all frames would be dominated by the few that
    were disturbed.

    >>> from mpsim import Scene, Simulation
    >>> with Simulation(Scene.random(count=50, packing=0.2, radius=0.5)) as sim:
    ...     report = sim.run(frames=20)
    >>> low, high = np.quantile(report.frame_seconds, [0.25, 0.75])
    >>> low <= sum(seconds[0] for seconds in usual_phases(report).values()) <= high
    np.True_
    """
    seconds, chosen = report.frame_seconds, frames_of_the_workers(report)
    if not len(seconds):
        return {name: np.zeros(each.shape[1]) for name, each in report.phase_seconds.items()}
    low, high = np.quantile(seconds[chosen], [0.25, 0.75], method="inverted_cdf")  # times of frames: one is between
    usual = chosen & (seconds >= low) & (seconds <= high)
    return {name: each[usual].mean(axis=0) for name, each in report.phase_seconds.items()}


# --- Figures of a run: energy, overlap and collision rate against time, and the final state

TALL, LOW = 1.25, 0.45
"""Ratio of height to width from which a box is drawn beside the curves, and below which it is drawn under them."""


def history(table: dict[str, NDArray[np.float64]], scene: Scene, last: Frame, title: str) -> Figure:
    """Four panels.

    Args:
        table: columns of measures.csv, see mpsim.output.recorder.
        scene: box and obstacles.
        last: the discs that are drawn.
        title: of the whole.
    """
    with matplotlib.rc_context(fname=STYLE):
        figure, energy, rate, overlap, place = _panels(scene.height / scene.width)
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
    """The last frame of a run as a picture, in the format of the path's ending.

    Raises:
        InputError, OutputError: as `save_figure`.
    """
    return save_figure(draw(last, scene), path)


def _panels(shape: float) -> tuple[Figure, Axes, Axes, Axes, Axes]:
    """A figure for a box with this ratio of height to width, with axes for three curves and for the box."""
    if shape > TALL:
        height = 8.4
        wide = max(height / shape, 1.6) + 1.6
        figure = new_figure(5.4 + wide, height)
        grid = figure.add_gridspec(3, 2, width_ratios=[5.4, wide])
        curves, place = [grid[row, 0] for row in range(3)], grid[:, 1]
    elif shape < LOW:
        low = max(11 * shape, 0.8) + 1.4
        figure = new_figure(11, 3 + low)
        grid = figure.add_gridspec(2, 3, height_ratios=[3, low])
        curves, place = [grid[0, column] for column in range(3)], grid[1, :]
    else:
        figure = new_figure(10, 6.4)
        grid = figure.add_gridspec(2, 2)
        curves, place = [grid[0, 0], grid[0, 1], grid[1, 0]], grid[1, 1]
    energy, rate, overlap = (figure.add_subplot(each) for each in curves)
    return figure, energy, rate, overlap, figure.add_subplot(place)


def _from_zero(axes: Axes, values: NDArray[np.float64], room: float = 1.15) -> None:
    """Start the axis at 0, so that the rounding errors of a constant do not look like a rough curve."""
    top = float(np.nanmax(values, initial=0.0))
    axes.set_ylim(0, room * top if top > 0 else 1.0)


# --- Figures of the benchmark

METHOD_COLOURS = {"naive": "#0072B2", "grid": "#D55E00", "parallel": "#009E73", "auto": "#CC79A7"}
ODD_ONE_OUT = "#D55E00"

WIDTH = 25
"""Frames of a running median."""

SPIKE = 2.0
"""Times the median, from which a frame is a dot of its own."""


def fixed(timings: Mapping[str, Timing], report_ms: Mapping[str, float], path: Path) -> None:
    """Distribution of frame times, a row for each method; the report's means are printed beside them."""
    times = {method: timing.frame_seconds[1:] * 1e6 for method, timing in timings.items()}
    low = min(float(each.min()) for each in times.values()) * 0.95
    high = max(float(np.quantile(each, 0.98)) for each in times.values()) * 1.15
    edges = np.geomspace(low, high, 80)
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 1.3 + 1.25 * len(times))
        panels = np.ravel(figure.subplots(len(times), 1, sharex=True))
        for axes, (method, found) in zip(panels, times.items(), strict=True):
            colour, median, mean = METHOD_COLOURS[method], float(np.median(found)), float(found.mean())
            axes.hist(found, edges, color=colour, alpha=0.55)
            axes.axvline(median, color=colour, linewidth=2)
            axes.axvline(mean, color=colour, linewidth=1.2, linestyle="--")
            beyond = found[found > high]
            slower = (
                f"; {len(beyond)} frame{'s' * (len(beyond) != 1)} slower, up to {_time(beyond.max() * 1e-6)}"
                if len(beyond)
                else ""
            )
            word = "threads" if method == "parallel" else method
            report = report_ms[method] * 1e3
            axes.set_title(
                f"{method}: median {_time(median * 1e-6)}, mean {_time(mean * 1e-6)}{slower}\n"
                f"report's {word}: mean {_time(report * 1e-6)}, {report / mean:,.0f} times as long",
                loc="left",
                fontsize=9,
                color=colour,
            )
            axes.set_ylabel("frames", fontsize=9)
            axes.grid(False, axis="y")
        panels[-1].set(xscale="log", xlim=(low, high))
        plain_ticks(panels[-1].xaxis, FINE if high < 10 * low else COARSE)
        number = len(next(iter(times.values())))
        words = f"frames 2 to {number + 1} (the first one has to sort the discs, and is left out)"
        panels[-1].set_xlabel(f"time of a frame of 100 discs [µs]; {words}")
        handles = [Line2D([], [], color="black", linewidth=2), Line2D([], [], color="black", ls="--", linewidth=1.2)]
        figure.legend(handles, ["median", "mean"], loc="outside upper right", ncols=2, fontsize=9)
        save_figure(figure, path)


def growth(timings: Mapping[str, Timing], report_ms: Mapping[str, float], path: Path) -> None:
    """Frame time against the number of discs: running median and middle 80 %; frames far outside are dots."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 5.2)
        axes = figure.add_subplot()
        for method, timing in timings.items():
            colour, times = METHOD_COLOURS[method], timing.frame_seconds[1:] * 1e6
            discs = np.arange(2, len(times) + 2)
            low, median, high = (_running(times, each) for each in (0.1, 0.5, 0.9))
            spikes = times > SPIKE * median
            axes.fill_between(discs, low, high, color=colour, alpha=0.3, linewidth=0)
            axes.plot(discs[spikes], times[spikes], color=colour, linestyle="", marker=".", markersize=3, alpha=0.6)
            word = "threads" if method == "parallel" else method
            report = _time(report_ms[method] * 1e-3)
            label = f"{method}: mean {_time(times.mean() * 1e-6)} (report's {word}: {report})"
            axes.plot(discs, median, color=colour, label=label)
        most = max(len(timing.frame_seconds) for timing in timings.values())
        axes.set(
            yscale="log",
            xlim=(0, most),
            xlabel="discs",
            ylabel="time of a frame [µs]",
            title=f"Growth from 1 disc to {most:,}: one more after every frame",
        )
        plain_ticks(axes.yaxis)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        axes.legend(loc="upper left", fontsize=9)
        caption = f"line: running median of {WIDTH} frames; band: the middle 80 % of them\n"
        caption += f"dots: frames that took more than {SPIKE:g} times the median; the first frame is left out"
        figure.supxlabel(caption, fontsize=9)
        save_figure(figure, path)


def repeat(result: Repeat, frames: int, path: Path) -> None:
    """Final states of repeated parallel runs, guarded above, unguarded below; differences from run 1 are marked."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(11, 6.6)
        rows = {"odd/even passes": result.guarded, "columns unguarded": result.unguarded}
        axes = figure.subplots(len(rows), len(result.guarded))
        for row, (word, states) in zip(axes, rows.items(), strict=True):
            for run, (panel, state) in enumerate(zip(row, states, strict=True), start=1):
                differs = (state.position != states[0].position).any(axis=1)
                colours = [ODD_ONE_OUT if d else DISC_COLOUR for d in differs]
                draw_discs(panel, state.position, result.scene, colours)
                panel.set_title(f"run {run}: {state.digest()[:8]}", fontsize=10)
                panel.set_xlabel(f"{int(differs.sum())} discs differ from run 1", fontsize=9)
            row[0].set_ylabel(word)
        figure.suptitle(f"Four parallel runs of one start, after {frames} frames, with their digests")
        save_figure(figure, path)


def final_states(result: Fixed, frames: int, path: Path) -> None:
    """The start and each method's final state side by side, coloured by disc so that a disc can be followed."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(11, 3.7)
        panels = {"initial": result.scene.position} | {name: state.position for name, state in result.states.items()}
        hues = matplotlib.colormaps["viridis"](np.linspace(0, 1, max(result.scene.count, 1)))
        order = np.argsort(np.argsort(result.scene.position[:, 0]))
        grid = result.states["grid"].position
        for panel, (name, position) in zip(figure.subplots(1, len(panels)), panels.items(), strict=True):
            draw_discs(panel, position, result.scene, hues[order])
            panel.set_title(name)
            if name != "initial":
                gap = float(np.hypot(*(position - grid).T).max(initial=0)) / (2 * result.scene.largest_radius)
                panel.set_xlabel("reference" if name == "grid" else f"largest distance to grid:\n{gap:.3g} diameters")
        figure.suptitle(f"After {frames} frames (colour: place at the start, from left to right)")
        save_figure(figure, path)


def scaling(timings: Sequence[Timing], crossover: int | None, path: Path) -> None:
    """Nanoseconds per disc and frame against the number of discs, and the speed-up of the workers."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 6.6)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        curves = {
            method: sorted(
                (t.discs, t.nanoseconds_per_disc, *_spread(t), t.workers) for t in timings if t.method == method
            )
            for method in METHOD_COLOURS
        }
        for method, points in curves.items():
            if points:
                discs, cost, low, high, workers = zip(*points, strict=True)
                label = f"{method}, {max(workers)} workers" if method == "parallel" else method
                marks = {"marker": "x", "linestyle": ":"} if method == "auto" else {"marker": "o"}
                bars = np.abs(np.array([low, high]) - cost)
                above.errorbar(discs, cost, bars, color=METHOD_COLOURS[method], label=label, capsize=2, **marks)
        above.set(
            xscale="log",
            yscale="log",
            ylabel="ns per disc and frame",
            title="Cost of a frame at packing 0.4: median, and the middle half of the frames",
        )
        plain_ticks(above.yaxis)
        above.legend()
        grid, parallel = ({discs: row for discs, *row in curves[name]} for name in ("grid", "parallel"))
        common = sorted(grid.keys() & parallel.keys())
        speed_up = np.array([_ratio(grid[discs], parallel[discs]) for discs in common]).reshape(-1, 3)
        bars = np.abs(speed_up[:, 1:].T - speed_up[:, 0])
        below.errorbar(common, speed_up[:, 0], bars, color=METHOD_COLOURS["parallel"], marker="o", capsize=2)
        below.axhline(1, color="black", linewidth=1)
        _mark_crossover([above, below], crossover, common)
        below.set(ylabel="speed-up of the workers\n(grid / parallel)", xlabel="discs")
        below.set_ylim(0, max(2.2, float(speed_up.max(initial=0.0)) * 1.05))
        below.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        save_figure(figure, path)


def _spread(timing: Timing) -> tuple[float, float]:
    """Range of the cost per disc in the middle half of the frames [ns]."""
    low, high = np.quantile(timing.frame_seconds, [0.25, 0.75]) * 1e9 / max(timing.discs, 1)
    return float(low), float(high)


def _ratio(one: Sequence[float], other: Sequence[float]) -> tuple[float, float, float]:
    """The ratio of two costs, each given as median, low and high, and its ends if either is at its low or high."""
    return one[0] / other[0], one[1] / other[2], one[2] / other[1]


def _mark_crossover(panels: Sequence[Axes], crossover: int | None, sizes: Sequence[int]) -> None:
    """Shade the sizes between which parallel becomes faster than grid, and stays so at all larger measured sizes."""
    if crossover is None:
        return
    before = max((size for size in sizes if size < crossover), default=crossover)
    for axes in panels:
        axes.axvspan(before, crossover, color="#999999", alpha=0.2, linewidth=0)
    words = f"at every measured size from {crossover:,} discs on\nparallel is faster than grid"
    words += f"; at {before:,} it is not" if before < crossover else ""
    side = "left" if crossover**2 < sizes[0] * sizes[-1] else "right"  # of the text, which stays inside
    panels[-1].annotate(
        words,
        (crossover, 0.12),
        xytext=(6 if side == "left" else -6, 0),
        textcoords="offset points",
        color="#555555",
        fontsize=9,
        ha=side,
    )


def _running(values: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """A running quantile, as long as the values."""
    padded = np.pad(values, (WIDTH // 2, WIDTH - 1 - WIDTH // 2), mode="edge")
    return np.quantile(np.lib.stride_tricks.sliding_window_view(padded, WIDTH), part, axis=1)


def _time(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.3g} µs"
