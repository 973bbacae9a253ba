"""Figures of the comparison, one for each table."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from mpsim.output.drawing import STYLE, new_figure, save_figure
from peers import tables
from peers.registry import PEERS
from peers.study import LIMITS

COLOURS = {
    "cpp": "#000000",
    "numba": "#777777",
    "mpsim-push": "#0072B2",
    "mpsim": "#56B4E9",
    "mpsim-event": "#0072B2",
    "numpy": "#CC79A7",
    "pymunk": "#E69F00",
    "box2d": "#D55E00",
    "rapier": "#8C564B",
    "taichi": "#009E73",
    "warp": "#7CAE00",
    "lammps": "#7A4FBF",
}
DASHES = {1: "-", 2: "--"}


def plain(title: str) -> str:
    """A title without marks of Markdown."""
    return title.replace("`", "")


def frames(record: dict[str, Any], path: Path) -> None:
    """Nanoseconds per disc and frame against the number of discs, with quartiles, at the main packing and step."""
    kinds = [(cell["packing"], cell["step"]) for cell in record["cells"]]
    cells = [cell for cell in record["cells"] if (cell["packing"], cell["step"]) == kinds[0]]
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(9.5, 5.6)
        axes = figure.add_subplot()
        for name, found in record["peers"].items():
            for threads in PEERS[name].threads if PEERS[name].steps and not found["missing"] else ():
                _line(axes, cells, name, threads)
        axes.set(xscale="log", yscale="log", xlabel="discs", ylabel="cost of a disc and frame [ns]")
        axes.set_title(f"packing {kinds[0][0]:g}, v·dt = {kinds[0][1]:g} diameters; bars: quartiles of the turns")
        figure.legend(loc="outside right center", fontsize=9)
        save_figure(figure, path)


def _line(axes: Axes, cells: list[dict[str, Any]], name: str, threads: int) -> None:
    timed = [(cell["count"], tables.timing_of(cell, f"{name}/{threads}")) for cell in cells]
    costs = {count: tables.nanoseconds(timing, count) for count, timing in timed if timing}
    if costs:
        low, middle, high = np.array(list(costs.values())).T
        style: dict[str, Any] = {"color": COLOURS[name], "linestyle": DASHES[threads], "marker": "o"}
        label = plain(tables.title_of(f"{name}/{threads}"))
        axes.errorbar(list(costs), middle, [middle - low, high - middle], label=label, **style)


def errors(record: dict[str, Any], path: Path) -> None:
    """Error of the pressure against the step, and what a disc costs per unit of time at each limit."""
    kept = record["accuracy"]
    exact = tables.exact_of(record)
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(11, 5.4)
        left, right = figure.subplots(1, 2)
        for name, all_series in kept["series"].items():
            for series, marker in zip(all_series, "os", strict=False):
                points = tables.points_of(series)
                if points:
                    label = PEERS[name].title + PEERS[name].effort(points[0].knob)
                    low = [max(abs(each.error(exact)), 1e-4) for each in points]
                    steps, bars = [each.dt for each in points], [each.uncertainty(exact) for each in points]
                    line = "-" if marker == "o" else ":"
                    style: dict[str, Any] = {"color": COLOURS[name], "marker": marker, "linestyle": line}
                    left.errorbar(steps, low, bars, label=plain(label), **style)
        for limit in LIMITS:
            left.axhline(limit, color="#444444", linestyle="--", linewidth=1)
        left.set(xscale="log", yscale="log", ylim=(1e-3, 1.5))
        left.set(xlabel="v·dt [diameters]", ylabel="error of the pressure, absolute and relative")
        _costs(right, record)
        figure.legend(loc="outside lower center", ncols=4, fontsize=8)
        save_figure(figure, path)


def _costs(axes: Axes, record: dict[str, Any]) -> None:
    names = [name for name in record["accuracy"]["series"] if PEERS[name].steps]
    for row, name in enumerate(reversed(names)):
        for limit, marker in zip(LIMITS, ("o", "D"), strict=True):
            had = tables.answer(record, name, limit)
            if had:
                full = COLOURS[name] if limit == min(LIMITS) else "white"
                axes.plot(had[1] / 1e3, row, marker, color=COLOURS[name], markerfacecolor=full, markersize=8)
        if not tables.answer(record, name, min(LIMITS)):
            place = {"xy": (0.02, row), "xycoords": ("axes fraction", "data"), "ha": "left", "va": "center"}
            axes.annotate("1 %: not reached", **place, fontsize=8)
    axes.set_yticks(range(len(names)), [plain(PEERS[name].title) for name in reversed(names)], fontsize=9)
    axes.set(xscale="log", xlabel="cost of a disc and unit of time [µs]", title="full: at 1 %, open: at 10 %")
    axes.set_ylim(-0.6, len(names) - 0.4)
