"""Figures of the benchmark: the same colour for a method everywhere, units on every axis, readable without the text."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

from mpsim.output.drawing import DISC_COLOUR, STYLE, draw_discs, new_figure, save_figure
from mpsim.studies.benchmark import Fixed, Repeat, Timing

METHOD_COLOURS = {"naive": "#0072B2", "grid": "#D55E00", "parallel": "#009E73", "auto": "#CC79A7"}
ODD_ONE_OUT = "#D55E00"


def frame_times(
    timings: Mapping[str, Timing], report_ms: Mapping[str, float], title: str, x_label: str, path: Path
) -> None:
    """Frame time against frame, logarithmic; dashed, the means of the term-project report."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 4.8)
        axes = figure.add_subplot()
        for method, timing in timings.items():
            colour = METHOD_COLOURS[method]
            microseconds = timing.frame_seconds * 1e6
            frames = np.arange(1, len(microseconds) + 1)
            axes.plot(frames, microseconds, color=colour, alpha=0.25, linewidth=0.7)
            axes.plot(frames, _running_median(microseconds), color=colour, label=f"{method}: mean {_time(timing.mean)}")
            report = report_ms[method] * 1e3
            axes.axhline(report, color=colour, linestyle="--", linewidth=1)
            word = "threads" if method == "parallel" else method
            axes.annotate(
                f"report's {word}: {_time(report * 1e-6)}",
                (0.995, report),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="bottom",
                color=colour,
                fontsize=9,
            )
        axes.set(
            yscale="log",
            xlabel=x_label,
            ylabel="time of a frame [µs]",
            title=title,
            xlim=(0, max(len(timing.frame_seconds) for timing in timings.values())),
        )
        axes.set_ylim(top=max(report_ms.values()) * 1e3 * 2.5)
        figure.legend(loc="outside lower center", ncols=3)
        save_figure(figure, path)


def repeat(result: Repeat, frames: int, path: Path) -> None:
    """Final states of repeated parallel runs, guarded above, unguarded below; what differs from run 1 is marked."""
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
    """The start and each method's final state side by side, coloured by disc so that one can be followed."""
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
            method: sorted((t.discs, t.nanoseconds_per_disc, t.workers) for t in timings if t.method == method)
            for method in METHOD_COLOURS
        }
        for method, points in curves.items():
            if points:
                discs, cost, workers = zip(*points, strict=True)
                label = f"{method}, {max(workers)} workers" if method == "parallel" else method
                marks = {"marker": "x", "linestyle": ":"} if method == "auto" else {"marker": "o"}
                above.plot(discs, cost, color=METHOD_COLOURS[method], label=label, **marks)
        above.set(xscale="log", yscale="log", ylabel="ns per disc and frame", title="Cost of a frame, packing 0.4")
        above.legend()
        grid, parallel = dict(p[:2] for p in curves["grid"]), dict(p[:2] for p in curves["parallel"])
        common = sorted(grid.keys() & parallel.keys())
        speed_up = [grid[discs] / parallel[discs] for discs in common]
        below.plot(common, speed_up, color=METHOD_COLOURS["parallel"], marker="o")
        below.axhline(1, color="black", linewidth=1)
        if crossover is not None:
            for axes in (above, below):
                axes.axvline(crossover, color="#555555", linestyle="--", linewidth=1)
            side = "left" if crossover**2 < common[0] * common[-1] else "right"  # of the text, which stays inside
            text = f" parallel faster from {crossover:,} discs on "
            below.annotate(text, (crossover, 0.15), color="#555555", horizontalalignment=side)
        below.set(ylabel="speed-up of the workers\n(grid / parallel)", xlabel="discs", ylim=(0, max([2.2, *speed_up])))
        save_figure(figure, path)


def _running_median(values: NDArray[np.float64], width: int = 25) -> NDArray[np.float64]:
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)


def _time(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.3g} µs"
