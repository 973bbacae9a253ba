"""The record of a run as pictures: energy, overlap, collision rate along the run, and the final state."""

import math
import os
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mpsim.output.colour_scale import scale_of
from mpsim.output.drawing import MOST_DISCS, STYLE, closed_off, draw_discs, marker_of, new_figure, save_figure
from mpsim.output.frames import Frame
from mpsim.scene.scene import Scene

TALL: dict[str, Any] = {"location": "right", "shrink": 0.7, "aspect": 30}
"""Where the colour bar of a box lies that is not flat."""


def history(table: dict[str, NDArray[np.float64]], scene: Scene, last: Frame, title: str) -> Figure:
    """Four panels.

    Args:
        table: columns of measures.csv, see mpsim.output.recorder.
        scene: box and what stands in it.
        last: the discs that are drawn.
        title: of the whole.
    """
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(10, 6.4)
        panels = figure.subplots(2, 2)
        energy, rate, overlap, place = panels.flat
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
        draw_frame(place, last, scene)
        figure.suptitle(title)
    return figure


def draw_frame(axes: Axes, frame: Frame, scene: Scene) -> None:
    """The discs of a frame, coloured by speed."""
    step = max(math.ceil(len(frame.position) / MOST_DISCS), 1)
    discs = draw_discs(axes, frame.position[::step], scene, radii=frame.radius[::step])
    speeds = np.hypot(*frame.velocity[::step].astype(np.float64).T)
    discs.set_array(speeds)
    discs.set_cmap("viridis")
    scale = scale_of(speeds)
    discs.set_clim(scale.low, scale.high)
    closed = closed_off(scene, frame.time)
    if closed is not None:
        axes.add_patch(closed)
    where: dict[str, Any] = (
        {"location": "bottom", "shrink": 0.6, "aspect": 40} if scene.width > 2.5 * scene.height else TALL
    )
    figure = axes.figure.figure  # the whole one, where the axes are in one of its subfigures
    figure.colorbar(discs, ax=axes, label="speed [length/time]", extend=scale.outside, **where)
    shown = f"{len(speeds):,} of " if step > 1 else ""
    axes.set_title(f"time {frame.time:.4g}, {shown}{len(frame.position):,} discs")


def final_picture(scene: Scene, last: Frame, path: str | os.PathLike[str]) -> Path:
    """The last frame of a run as a PNG.

    Raises:
        OutputError: if it cannot be written.
    """
    with matplotlib.rc_context(fname=STYLE):
        longer = max(scene.width, scene.height)
        figure = new_figure(max(6 * scene.width / longer, 2) + 1.2, max(6 * scene.height / longer, 1) + 0.9)
        draw_frame(figure.add_subplot(), last, scene)
    return save_figure(figure, path)


def _from_zero(axes: Axes, values: NDArray[np.float64], room: float = 1.15) -> None:
    """Begin at 0: a curve that looks rough must not be the rounding of a constant."""
    top = float(np.nanmax(values, initial=0.0))
    axes.set_ylim(0, room * top if top > 0 else 1.0)
