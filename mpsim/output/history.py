"""Figures of a run: energy, overlap and collision rate against time, and the final state."""

import os
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mpsim.output.drawing import STYLE, marker_of, new_figure, save_figure
from mpsim.output.frames import Frame
from mpsim.output.still import draw
from mpsim.scene.scene import Scene

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
