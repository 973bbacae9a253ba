"""What the gallery draws over the discs of a scene: trails, counts and curves."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes

import mpsim
from mpsim.studies.promises import Cooling, Galton, Hopper, Promise

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


def _curve(axes: Axes, times: Any, found: Any, law: tuple[Any, Any], label: str, end: float) -> Sequence[Artist]:
    inset = axes.inset_axes((0.58, 0.68, 0.4, 0.3), zorder=9)
    inset.plot(*law, color=LAW, linewidth=1, linestyle="--")
    inset.plot(times, found, color=INK, linewidth=1.5)
    inset.set(xlim=(0, end), xticks=[], yscale="log")
    inset.tick_params(left=False, labelleft=False, which="both")
    inset.set_title(label, fontsize=7, y=0.68, pad=0)
    inset.grid(False)
    inset.set_facecolor("#FFFFFFFF")
    return [inset]


def haff(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """The temperature, and Haff's law."""
    times, found = promise.series
    end = promise.scene.duration or 1.0
    law = np.linspace(0, end, 200)
    return _curve(
        axes,
        times,
        found,
        (law, found[0] / (1 + law / cast(Cooling, promise).haff_time) ** 2),
        "log T; dashed: Haff",
        end,
    )


MARKS: dict[str, Mark] = {
    "brownian": trail,
    "cooling": haff,
    "galton": heap,
    "hopper": passed,
    "pi": collisions,
    "rough-hopper": passed,
}
"""By the name of the scene."""
