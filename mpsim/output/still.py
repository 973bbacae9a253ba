"""One picture of a state, a frame of a trajectory, a simulation or a scene."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import is_color_like
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.state import Box, State, present_in
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError
from mpsim.features.edges import boundary_of
from mpsim.measure.moments import placed
from mpsim.output.drawing import (
    MOST_DISCS,
    SCALES,
    SPEED,
    STYLE,
    ScaleName,
    closed_off,
    colour_bar,
    colour_discs,
    draw_discs,
    figure_around,
    percentile_scale,
    speeds_of,
)
from mpsim.output.frames import Frame
from mpsim.scene.scene import Scene

INCHES = 6.0
"""Longer side of the box in a figure of its own."""

MOST_LABELS = 2_000
"""Discs with labels at most: more could not be read."""

LUMINANCE, DARK_BELOW = np.array([0.299, 0.587, 0.114]), 0.5
"""Weights of red, green and blue in the luminance of a colour, and the luminance below which its label is white."""

FONT_SIZES = (4.0, 11.0)
"""Smallest and largest labels [points]."""


@dataclass(frozen=True)
class Shown:
    """The discs that a picture shows, in the order of their numbers. Absorbed discs are not among them.

    Attributes:
        scene: box and obstacles.
        corner: where the coordinates of the picture have the lower left corner of that box [length].
        walls: where the walls are; None: unknown.
        time: of the moment [time]; None: unknown.
        here: which discs of the state these are: an index of arrays of one row per disc.
        number: their numbers, shape (N,).
        position, velocity: shape (N, 2) [length], [length/time]; no velocity: unknown.
        radius, mass: shape (N,) [length], [mass].
        spin: shape (N,) [1/time]; None: smooth discs.
        given: discs that the state has, absorbed ones included.
    """

    scene: Scene
    corner: tuple[float, float]
    walls: Box | None
    time: float | None
    here: Any
    number: NDArray[np.int64]
    position: NDArray[np.floating]
    velocity: NDArray[np.floating] | None
    radius: NDArray[np.float64]
    mass: NDArray[np.float64]
    spin: NDArray[np.floating] | None
    given: int


KINDS: dict[str, tuple[str, Callable[[Shown], Any]]] = {
    "speed": (SPEED, lambda shown: None if shown.velocity is None else speeds_of(shown.velocity)),
    "radius": ("radius [length]", lambda shown: shown.radius),
    "mass": ("mass [mass]", lambda shown: shown.mass),
    "spin": ("angular velocity [1/time]", lambda shown: shown.spin),
}
"""What discs can be coloured by, with the words of the colour bar."""


@checks.known_names()
def draw(
    state: State | Frame | Simulation | Scene,
    scene: Scene | None = None,
    *,
    colour: str | ArrayLike | None = "speed",
    colour_label: str | None = None,
    scale: ScaleName = "linear",
    labels: bool | Sequence[object] | NDArray[Any] = False,
    ax: Axes | None = None,
) -> Figure:
    """Draw discs at true radius in their box, with obstacles and moving walls, by matplotlib.

    Absorbed discs are not drawn. If there are more than 50,000 discs, only every second, third, ... one is drawn, and
    the title says so.

    Args:
        state: what is drawn: a State; a frame of a Trajectory; a Simulation, as it is now; or a Scene, as it starts.
        scene: the scene of a State, which gives radii and obstacles. For a frame it is optional: without it, the box is
            drawn without obstacles. Leave it out for a Simulation or a Scene.
        colour: "speed", "radius", "mass" or "spin"; a number for each disc, shape (N,), NaN where a disc has none; a
            colour of matplotlib, such as "tab:blue", for all discs; None: one colour for all.
        colour_label: text beside the colour bar; None: what the colour stands for, and nothing for an array.
        scale: "linear" or "log": how numbers become colours. The ends of the colour bar are the 2nd and the 98th
            percentile of what is drawn, and arrows show that values lie outside.
        labels: True: the number of each disc; or a text or number for each disc, N of them; at most 2,000.
        ax: Axes to draw in; None: a new figure.

    Returns:
        The whole matplotlib Figure, bound to no window. A notebook shows it; `savefig` writes it; its `axes[0]` is the
        box, in coordinates of the scene [length].

    Raises:
        InputError: for a State without a scene, an array or labels of the wrong length, or an unknown word.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=5, packing=0.2, radius=0.5, seed=1)
    >>> figure = mpsim.draw(scene, colour=[0, 1, 2, 3, 4], colour_label="number", labels=True)
    >>> [text.get_text() for text in figure.axes[0].texts]
    ['0', '1', '2', '3', '4']
    """
    shown = _shown_by(state, scene)
    scale = checks.choice("scale", scale, SCALES)  # pyright: ignore[reportAssignmentType]
    values, words = _numbers(colour, shown)
    texts = _texts(labels, shown)
    if ax is not None and not isinstance(ax, Axes):
        raise InputError(f"ax must be an Axes of matplotlib; got {type(ax).__name__}. Leave it out, or make one.")
    with contextlib.nullcontext() if ax is not None else matplotlib.rc_context(fname=STYLE):
        axes = _own_axes(shown.scene) if ax is None else ax
        step = max(math.ceil(len(shown.number) / MOST_DISCS), 1)
        discs = draw_discs(axes, shown.position[::step], shown.scene, radii=shown.radius[::step], corner=shown.corner)
        if values is not None:
            found = percentile_scale(values[::step], scale)
            colour_discs(discs, values[::step], found)
            words = words if colour_label is None else str(colour_label)
            colour_bar(axes, discs, shown.scene, words, found.outside)
        elif isinstance(colour, str):
            discs.set_facecolor(colour)
        closed = closed_off(shown.scene, shown.walls)
        if closed is not None:
            axes.add_patch(closed)
        axes.set_title(_title(shown, step))
        if texts is not None:
            _write(axes, shown, discs, texts)
    return axes.figure.figure


def _own_axes(scene: Scene) -> Axes:
    """Axes in a figure of their own, of the shape of the box."""
    longer = max(scene.width, scene.height)
    width, height = (INCHES * side / longer for side in (scene.width, scene.height))
    size = max(width, 1.6), max(height, 0.5)
    return figure_around(scene, size, beside=(1.3, 0.6), below=(0.0, 1.4)).add_subplot()


def _title(shown: Shown, step: int) -> str:
    number = len(shown.number)
    words = f"{number:,} discs" if step == 1 else f"{math.ceil(number / step):,} of {number:,} discs"
    words = "1 disc" if number == 1 else words
    return words if shown.time is None else f"time {shown.time:.4g}, {words}"


def _shown_by(state: object, scene: object) -> Shown:
    """The discs to be drawn, from what was given."""
    if scene is not None and not isinstance(scene, Scene):
        raise InputError(f"scene must be an mpsim.Scene; got {type(scene).__name__}. Use Scene.load, or Scene(...).")
    if isinstance(state, Scene | Simulation):
        if scene is not None:
            raise InputError(f"scene must be left out with a {type(state).__name__}, which has its own; got {scene!r}.")
        return _start_of(state) if isinstance(state, Scene) else _now_of(state)
    if isinstance(state, Frame):
        return _moment_of(state, scene)
    if not isinstance(state, State):
        raise InputError(
            "state must be a State, a frame of a Trajectory, a Simulation or a Scene; "
            f"got {type(state).__name__}. Use sim.state."
        )
    if scene is None:
        raise InputError(
            f"scene must be given with a State, which has no radii; got {state!r} alone. Use draw(state, scene), or "
            "draw(sim) while the simulation is open."
        )
    if len(state.position) != scene.count:
        raise InputError(
            f"scene must have as many discs as the state; got {scene.count} and {len(state.position)}. Discs that were "
            "added or entered are known to the simulation: use draw(sim), or a frame of a Trajectory."
        )
    return _of(state, scene, scene.radii, scene.masses, None)


def _of(state: State, scene: Scene, radius: Any, mass: Any, time: float | None) -> Shown:
    state = placed(state, scene)
    here, given = present_in(state), len(state.position)
    spin, velocity = (None if array is None else array[here] for array in (state.spin, vars(state).get("velocity")))
    return Shown(
        scene, (0.0, 0.0), state.box, time, here, np.arange(given)[here], state.position[here], velocity,
        np.asarray(radius)[here], np.asarray(mass)[here], spin, given,
    )  # fmt: skip


def _start_of(scene: Scene) -> Shown:
    state = State(scene.position, scene.velocity, spin=scene.spin, box=scene.box)
    return _of(state, scene, scene.radii, scene.masses, None)


def _now_of(sim: Simulation) -> Shown:
    return _of(sim.state, sim.scene, sim.radii, sim.masses, sim.time)


def _moment_of(frame: Frame, scene: Scene | None) -> Shown:
    """The discs of a frame, which may hold less than a state: what it lacks is an error only if it is needed."""
    known, corner = frame.known, (0.0, 0.0)
    if scene is None:  # its box, with nothing in it
        (width, height), corner, none = frame.box, frame.origin, np.zeros((0, 2))
        small, boundary = min(width, height) / 4, boundary_of(frame.periodic)
        scene = Scene(width=width, height=height, position=none, velocity=none, radius=small, boundary=boundary)
    mass = known.get("mass", np.ones(len(frame.position)))
    shown = _of(frame.state, scene, frame.radius, mass, known.get("time"))
    return replace(shown, number=frame.ids, corner=corner)


def _numbers(colour: Any, shown: Shown) -> tuple[NDArray[np.float64] | None, str]:
    """The number by which each disc is coloured, and its name; None: all discs have one colour."""
    if colour is None or (isinstance(colour, str) and colour not in KINDS and is_color_like(colour)):
        return None, ""
    if isinstance(colour, str):
        label, numbers = KINDS[checks.choice("colour", colour, KINDS)]
        values = numbers(shown)
        if values is None:
            what = "discs whose velocities are unknown" if colour == "speed" else "smooth discs, which do not spin"
            raise InputError(f"colour must not be {colour!r} of {what}. Use 'radius', or None.")
        return np.asarray(values, np.float64), label
    try:
        given = np.asarray(colour, np.float64)
    except (TypeError, ValueError, OverflowError):
        given = np.zeros(())
    if given.shape != (shown.given,):
        raise InputError(
            f"colour must be one of {', '.join(map(repr, KINDS))}, a colour of matplotlib, or an array of "
            f"{shown.given} numbers, one for each disc; got {checks.brief(colour)}."
        )
    return given[shown.here], ""


def _texts(labels: Any, shown: Shown) -> list[str] | None:
    """The label of each disc that is shown."""
    if labels is False or labels is None:
        return None
    rule = f"True, or {shown.given} texts or numbers, one for each disc"
    if labels is not True and (isinstance(labels, str) or not isinstance(labels, Sequence | np.ndarray)):
        raise InputError(f"labels must be {rule}; got {checks.brief(labels)}.")
    if labels is not True and len(labels) != shown.given:
        raise InputError(f"labels must be {rule}; got {len(labels)}.")
    if len(shown.number) > MOST_LABELS:
        raise InputError(
            f"labels must be for at most {MOST_LABELS:,} discs; got {len(shown.number):,}. Leave them out, or label "
            "the discs of a smaller scene."
        )
    if labels is True:
        return [str(number) for number in shown.number.tolist()]
    return [str(labels[row]) for row in np.arange(shown.given)[shown.here]]


def _write(axes: Axes, shown: Shown, discs: EllipseCollection, texts: list[str]) -> None:
    """Write labels on discs, in black or white, as large as fits the smaller ones."""
    figure = axes.figure.figure
    figure.draw_without_rendering()  # which finds the colours, and the size of the box
    luminance = np.resize(np.asarray(discs.get_facecolor())[:, :3] @ LUMINANCE, len(texts))
    points = 72 / figure.dpi * axes.bbox.width / shown.scene.width * 2 * float(np.median(shown.radius, axis=0))
    size = float(np.clip(1.4 * points / max(2, 2, *map(len, texts)), *FONT_SIZES))
    for (x, y), text, light in zip((shown.position + shown.corner).tolist(), texts, luminance, strict=True):
        ink = "white" if light < DARK_BELOW else "black"
        axes.text(x, y, text, color=ink, fontsize=size, ha="center", va="center", clip_on=True)
