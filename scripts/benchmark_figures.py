"""Figures of the benchmark."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from benchmark import Fixed, Repeat, Timing
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mpsim.output.drawing import COARSE, DISC_COLOUR, FINE, STYLE, draw_discs, new_figure, plain_ticks, save_figure

METHOD_COLOURS = {"naive": "#0072B2", "grid": "#D55E00", "parallel": "#009E73", "auto": "#CC79A7"}
ODD_ONE_OUT = "#D55E00"

WIDTH = 25
"""Frames of a running median."""

SPIKE = 2.0
"""Times the median, from which a frame is a dot of its own."""

WHOLE = "{x:,.0f}"
"""Numbers of discs on an axis."""


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
            beyond, words = found[found > high], f"{method}: median {_time(median)}, mean {_time(mean)}"
            if len(beyond):
                words += f"; {len(beyond)} frame{'s' * (len(beyond) != 1)} slower, up to {_time(beyond.max())}"
            report = report_ms[method] * 1e3
            words += f"\nreport's {_word(method)}: mean {_time(report)}, {report / mean:,.0f} times as long"
            axes.set_title(words, loc="left", fontsize=9, color=colour)
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
            report = _time(report_ms[method] * 1e3)
            label = f"{method}: mean {_time(times.mean())} (report's {_word(method)}: {report})"
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
        axes.xaxis.set_major_formatter(WHOLE)
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
        rows: dict[str, dict[int, NDArray[np.float64]]] = {}
        for method, colour in METHOD_COLOURS.items():
            of = sorted((t for t in timings if t.method == method), key=lambda t: t.discs)
            if of:
                rows[method] = {t.discs: np.quantile(t.frame_seconds, [0.5, 0.25, 0.75]) * 1e9 / t.discs for t in of}
                label = f"{method}, {max(t.workers for t in of)} workers" if method == "parallel" else method
                marks = {"marker": "x", "linestyle": ":"} if method == "auto" else {"marker": "o"}
                _bars(above, rows[method], color=colour, label=label, **marks)
        above.set(
            xscale="log",
            yscale="log",
            ylabel="ns per disc and frame",
            title="Cost of a frame at packing 0.4: median, and the middle half of the frames",
        )
        plain_ticks(above.yaxis)
        above.legend()
        grid, parallel = rows["grid"], rows["parallel"]
        common = sorted(grid.keys() & parallel.keys())
        speed_up = {discs: grid[discs] / parallel[discs][[0, 2, 1]] for discs in common}
        _bars(below, speed_up, color=METHOD_COLOURS["parallel"], marker="o")
        below.axhline(1, color="black", linewidth=1)
        _mark_crossover([above, below], crossover, common)
        below.set(ylabel="speed-up of the workers\n(grid / parallel)", xlabel="discs")
        below.set_ylim(0, max(2.2, 1.05 * max(float(ratio.max()) for ratio in speed_up.values())))
        below.xaxis.set_major_formatter(WHOLE)
        save_figure(figure, path)


def _bars(axes: Axes, rows: Mapping[int, NDArray[np.float64]], **style: Any) -> None:
    """Points with bars; rows: median, low and high by number of discs."""
    middle, low, high = np.array(list(rows.values())).T
    axes.errorbar(list(rows), middle, [middle - low, high - middle], capsize=2, **style)


def _mark_crossover(panels: Sequence[Axes], crossover: int | None, sizes: Sequence[int]) -> None:
    """Shade the sizes between which parallel becomes faster than grid, and stays so at all larger measured sizes."""
    if crossover is None:
        return
    before = max((size for size in sizes if size < crossover), default=crossover)
    for axes in panels:
        axes.axvspan(before, crossover, color="#999999", alpha=0.2, linewidth=0)
    words = f"at every measured size from {crossover:,} discs on\nparallel is faster than grid"
    words += f"; at {before:,} it is not" if before < crossover else ""
    side, shift = ("left", 6) if crossover**2 < sizes[0] * sizes[-1] else ("right", -6)  # the text stays inside
    place = {"xytext": (shift, 0), "textcoords": "offset points", "ha": side}
    panels[-1].annotate(words, (crossover, 0.12), color="#555555", fontsize=9, **place)


def _running(values: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """A running quantile, as long as the values."""
    padded = np.pad(values, (WIDTH // 2, WIDTH - 1 - WIDTH // 2), mode="edge")
    return np.quantile(np.lib.stride_tricks.sliding_window_view(padded, WIDTH), part, axis=1)


def _word(method: str) -> str:
    """The report's name of a method."""
    return "threads" if method == "parallel" else method


def _time(microseconds: float) -> str:
    return f"{microseconds / 1e3:.3g} ms" if microseconds >= 1e3 else f"{microseconds:.3g} µs"
