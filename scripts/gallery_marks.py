"""Trails, counters and curves that the gallery draws over the discs."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes

import mpsim
from mpsim.studies.findings import Compression, Cooling, Galton, Hopper, Promise

INK, LAW = "#D55E00", "#000000"
PLAIN = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5}

Mark = Callable[[Axes, mpsim.Simulation, Promise], Sequence[Artist]]
"""Draws on the axes of the box, from the simulation and what was seen so far; returns what it drew."""


def _words(axes: Axes, text: str) -> Artist:
    return axes.text(0.03, 0.97, text, transform=axes.transAxes, va="top", fontsize=8, bbox=PLAIN, zorder=9)


def trail(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """The path of the large disc."""
    _, path = promise.series
    return axes.plot(*path.reshape(-1, 2).T, color=INK, linewidth=1.2, zorder=8)


def heap(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """The binomial curve of as many balls as lie in the bins, as high as they would stand, and their number."""
    galton = cast(Galton, promise)
    x = galton.binned(sim)
    words = [_words(axes, f"{len(x)} balls in the bins")]
    if len(x) < 10:
        return words
    _, curve = galton.heap(x)
    ball = np.pi * sim.scene.largest_radius**2 / 0.8  # area, with the gaps between balls
    middles = np.arange(len(curve)) + 0.5
    inner = 1 - 0.1  # width of a bin between its walls
    return [*axes.plot(middles, curve * ball / inner, color=INK, linewidth=1.5, zorder=8), *words]


def passed(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """Grains that have come through the gap."""
    times, numbers = promise.series
    late = times >= Hopper.STEADY
    if np.count_nonzero(late) < 2:
        return []
    flow = (numbers[-1] - numbers[late][0]) / (times[-1] - times[late][0])
    return [_words(axes, f"{numbers[-1]:.0f} passed\n{flow:.0f} per unit of time")]


def collisions(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """Collisions so far, in the title: the box is too low for words."""
    axes.set_title(f"time {sim.time:.2f}, {len(promise.observers[0].table)} collisions")
    return []


def _curve(
    axes: Axes,
    found: tuple[Any, Any],
    law: tuple[Any, Any],
    name: str,
    place: tuple[float, float, float, float],
    scale: str,
    corner: Literal["upper left", "upper right"],
) -> Sequence[Artist]:
    """An inset with what was found, and the law, dashed, over the whole duration; name: of the law."""
    inset = axes.inset_axes(place, zorder=9)
    inset.plot(*law, color=LAW, linewidth=1, linestyle="--", label=name)
    inset.plot(*found, color=INK, linewidth=1.5, label="temperature")
    inset.set(xlim=(0, law[0][-1]), xticks=[], yscale=scale)
    inset.tick_params(left=False, labelleft=False, which="both")
    # In the corner that the curves do not come to.
    inset.legend(loc=corner, fontsize=6, handlelength=1.2, borderaxespad=0.2, labelspacing=0.2, handletextpad=0.4)
    inset.grid(False)
    inset.set_facecolor("#FFFFFFFF")
    return [inset]


def haff(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """The temperature, and Haff's law."""
    times, found = promise.series
    moments = np.linspace(0, promise.scene.duration or 1.0, 200)
    law = found[0] / (1 + moments / cast(Cooling, promise).haff_time) ** 2
    return _curve(axes, (times, found), (moments, law), "Haff's law", (0.55, 0.68, 0.44, 0.31), "log", "upper right")


def adiabat(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """The temperature, and that of a slow compression, on the region behind the piston."""
    times, found = promise.series
    moments = np.linspace(0, promise.scene.duration or 1.0, 100)
    law = [cast(Compression, promise).adiabat(each) for each in moments.tolist()]
    if sim.state.box is None or promise.scene.width - sim.state.box[1] < 0.36 * promise.scene.width:
        return []  # there is no room behind it yet
    return _curve(axes, (times, found), (moments, law), "adiabat", (0.68, 0.15, 0.29, 0.7), "linear", "upper left")


MARKS: dict[str, Mark] = {
    "brownian": trail,
    "cooling": haff,
    "galton": heap,
    "hopper": passed,
    "pi": collisions,
    "piston": adiabat,
    "rough-hopper": passed,
}
"""By the name of the scene."""
