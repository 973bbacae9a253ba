"""Drawings of discs at true radius, with images, obstacles and walls; and one picture of anything."""

from __future__ import annotations

import contextlib
import io
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import EllipseCollection, PatchCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, Normalize, is_color_like
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Circle, Polygon, Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from mpsim.core import checks, files
from mpsim.core.state import Box, State
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError
from mpsim.features.capsules import polygons
from mpsim.features.edges import boundary_of
from mpsim.kernels.geometry import RADIUS
from mpsim.measure.observables import placed
from mpsim.output.frames import Frame
from mpsim.scene.scene import Scene

# --- Colour scales from the numbers in a picture, with arrows for values outside

PERCENTILES = (2.0, 98.0)  # percentiles of the values at the two ends of the scale
SAMPLE = 5_000  # discs of one picture that enter the scale of a run at most
SPEED = "speed [length/time]"  # words of a colour bar

SCALES = ("linear", "log")

ScaleName = Literal["linear", "log"]


class ColourScale(NamedTuple):
    """Ends of a colour bar; outside: where values lie beyond them, as in matplotlib; log: whether it is logarithmic."""

    low: float
    high: float
    outside: Literal["neither", "both", "min", "max"] = "neither"
    log: bool = False


def percentile_scale(values: ArrayLike, kind: ScaleName = "linear") -> ColourScale:
    """The scale from the 2nd to the 98th percentile of values, of any shape; NaN is left out.

    Its ends are two of the values; for 50 values or fewer, the least and the greatest.

    If these percentiles are equal, it spans all values; if all values are equal, it begins or ends at 0. The ends of a
    logarithmic scale come from the values > 0; if these are fewer than two different ones, the scale is linear.

    >>> percentile_scale([*range(101)])
    ColourScale(low=2.0, high=98.0, outside='both', log=False)
    >>> percentile_scale([3.0, 3.0])
    ColourScale(low=0.0, high=3.0, outside='neither', log=False)
    >>> percentile_scale([0.0, 0.1, 10.0], "log")
    ColourScale(low=0.1, high=10.0, outside='min', log=True)
    """
    found = np.asarray(values, np.float64).ravel()
    found = found[np.isfinite(found)]
    if kind == "log" and len(np.unique(found[found > 0])) > 1:
        scale = percentile_scale(found[found > 0])
        below = scale.outside in ("both", "min") or float(found.min()) <= 0
        above = scale.outside in ("both", "max")
        return ColourScale(scale.low, scale.high, _outside(below, above), log=True)
    if not len(found):
        return ColourScale(0.0, 1.0)
    least, most = float(found.min()), float(found.max())
    low, high = (
        float(np.percentile(found, each, method=method))
        for each, method in zip(PERCENTILES, ("lower", "higher"), strict=True)
    )
    if low == high:
        low, high = least, most
    if low == high:
        low, high = min(low, 0.0), max(high, 0.0)
    high = high if high > low else 1.0
    return ColourScale(low, high, _outside(least < low, most > high))


def _outside(below: bool, above: bool) -> Literal["neither", "both", "min", "max"]:
    return "both" if below and above else "min" if below else "max" if above else "neither"


def speeds_of(velocity: NDArray[np.floating]) -> NDArray[np.float64]:
    """Speeds from velocities of shape (N, 2), in float64, shape (N,) [length/time]."""
    return np.hypot(*velocity.astype(np.float64).T)


def sampled(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """At most SAMPLE of the values of one picture, evenly spread, for the scale of many pictures."""
    return values[:: max(-(-len(values) // SAMPLE), 1)]


COARSE, FINE = (1.0, 2.0, 5.0), (1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0)
"""Numbers that are written in each decade of an axis: of several decades, or of a part of one."""

STYLE = Path(__file__).with_name("mpsim.mplstyle")

DISC_COLOUR = "#56B4E9"
MOST_DISCS = 50_000  # discs that a still shows at most: more would take long, and be smaller than its pixels

NO_VALUE = "#CCCCCC"
"""Of a disc whose number is NaN."""

FLAT = 2.5  # ratio of width to height from which the colour bar lies below the box

ENDINGS = (".png", ".pdf", ".svg", ".eps", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
"""Of files that pictures are written to."""


@dataclass(frozen=True)
class Theme:
    """Colours of everything except discs."""

    ground: str
    ink: str  # of lines and words
    solid: str  # of obstacles
    behind: str  # of the region behind a moving wall
    edge: str  # around each disc

    @property
    def style(self) -> dict[Any, Any]:
        """Matplotlib's names for the first two."""
        grounds = dict.fromkeys(("figure.facecolor", "axes.facecolor", "savefig.facecolor"), self.ground)
        inks = ("text.color", "axes.edgecolor", "axes.labelcolor", "axes.titlecolor", "xtick.color", "ytick.color")
        return grounds | dict.fromkeys(inks, self.ink)


LIGHT = Theme(ground="white", ink="black", solid="#444444", behind="#BBBBBB", edge="#00000060")
DARK = Theme(ground="#15181E", ink="#E6E6E6", solid="#8C929E", behind="#343A46", edge="#FFFFFF50")
PAGE = Theme(ground="#ffffff", ink="#16191d", solid="#3a3f45", behind="#9aa3ad", edge="none")
"""The colours of the live view, in its films and on its page."""

ThemeName = Literal["light", "dark"]

THEMES: dict[str, Theme] = {"light": LIGHT, "dark": DARK}


class ShownFigure(Figure):
    """A figure that a notebook shows without a backend."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png")
        return file.getvalue()


def marker_of(points: int) -> str:
    """Matplotlib's marker for a line through so many points: few are drawn too, as a line through one is invisible."""
    return "." if points <= 100 else ""


def new_figure(width: float, height: float, theme: Theme = LIGHT) -> Figure:
    """A figure of the given size [inch] in mpsim's style, bound to no window; a notebook shows it."""
    with matplotlib.rc_context(theme.style, fname=STYLE):
        return ShownFigure(figsize=(width, height))


def _is_flat(scene: Scene) -> bool:
    return scene.width > FLAT * scene.height


def figure_around(
    scene: Scene,
    size: tuple[float, float],
    beside: tuple[float, float],
    below: tuple[float, float],
    theme: Theme = LIGHT,
) -> Figure:
    """A figure for a box of this size, and what title and colour bar add beside it, or below a flat one [inch]."""
    more = below if _is_flat(scene) else beside
    return new_figure(size[0] + more[0], size[1] + more[1], theme)


def with_images(position: ArrayLike, scene: Scene) -> NDArray[np.float64]:
    """Centres and their images beyond the nearer periodic edges, the centres first: shape (N, 2), (2 N, 2) or (4 N, 2).

    Images of discs far from an edge lie outside the box, where nothing is drawn.
    """
    places = np.array(position, dtype=np.float64).reshape(-1, 2)
    for axis, length in enumerate((scene.width, scene.height)):
        if scene.periodic[axis]:
            other = places.copy()
            other[:, axis] += np.where(places[:, axis] < length / 2, length, -length)
            places = np.concatenate([places, other])
    return places


def draw_discs(
    axes: Axes,
    position: ArrayLike,
    scene: Scene,
    colours: Any = DISC_COLOUR,
    radii: NDArray[np.floating] | None = None,
    corner: tuple[float, float] = (0.0, 0.0),
    time: float = 0.0,
) -> EllipseCollection:
    """Draw discs at true radius in their box, with obstacles; periodic edges are dotted.

    position: shape (N, 2) [length]. colours: one, or one for each disc. radii: shape (N,) [length]; None: those of the
    scene. corner: where the axes have the lower left corner of the box, which has no obstacles if that is not (0, 0).
    time: at which the obstacles are shown [time]. `set_offsets(with_images(position, scene))` moves the discs.
    """
    if not axes.collections:
        _draw_box(axes, scene, corner)
        draw_obstacles(axes, scene, scene._capsules_at(time), LIGHT)
    radii = np.asarray(scene.radii if radii is None else radii)
    return ellipses(axes, with_images(position, scene) + corner, radii, colours, LIGHT)


def ellipses(
    axes: Axes, places: NDArray[np.float64], radii: NDArray[np.floating], colours: Any, theme: Theme
) -> EllipseCollection:
    """Discs at their places, images included: sizes and colours repeat, so that each image has those of its disc."""
    diameters = 2 * radii
    discs = EllipseCollection(
        diameters, diameters, np.zeros(len(radii)), units="xy", offsets=places, offset_transform=axes.transData
    )
    discs.set_facecolor(colours)
    discs.set_edgecolor(theme.edge)
    discs.set_linewidth(0.3)
    axes.add_collection(discs)
    return discs


def _draw_box(axes: Axes, scene: Scene, corner: tuple[float, float]) -> None:
    left, low = corner
    limits = {"xlim": (left, left + scene.width), "ylim": (low, low + scene.height)}
    axes.set(**limits, aspect="equal", xticks=[], yticks=[])
    axes.grid(False)
    for side, axis in (("left", 0), ("right", 0), ("bottom", 1), ("top", 1)):
        axes.spines[side].set_visible(True)
        axes.spines[side].set_linestyle(":" if scene.periodic[axis] else "-")


def obstacle_colours(capsules: NDArray[np.float64], theme: Theme) -> list[str]:
    """Colour of each capsule, in figures, in films and on the page."""
    return [theme.solid] * len(capsules)


def draw_obstacles(axes: Axes, scene: Scene, capsules: NDArray[np.float64], theme: Theme) -> PatchCollection | None:
    """Obstacles, from `Scene._capsules_at`, with their periodic images, below all discs; None: there are none."""
    shifts = [
        (0.0, -length, length) if wraps else (0.0,)
        for length, wraps in zip((scene.width, scene.height), scene.periodic, strict=True)
    ]
    shapes, colours = list[Any](), obstacle_colours(capsules, theme)
    for (ax, ay, bx, by, radius), colour in zip(capsules[:, : RADIUS + 1].tolist(), colours, strict=True):
        for x, y in product(*shifts):
            a, b = np.array([ax + x, ay + y]), np.array([bx + x, by + y])
            if radius < 0:  # a container, solid from its circle to beyond the box
                far = scene.width + scene.height
                shapes += [Annulus((ax, ay), far, far + radius, color=colour)] * (x == y == 0)
                continue
            shapes += [Circle((float(end[0]), float(end[1])), radius, color=colour) for end in (a, b)]
            if length := float(np.hypot(*(b - a))):
                across = radius / length * np.array([ay - by, bx - ax])
                shapes.append(Polygon([a - across, b - across, b + across, a + across], color=colour))
    shapes += [Polygon(capsules[part, :2], color=colours[part.start]) for part in polygons(capsules)]
    if not shapes:
        return None
    # The line is what remains of a wall without thickness.
    drawn = PatchCollection(shapes, match_original=True, linewidth=1, zorder=0.9)
    axes.add_collection(drawn)
    return drawn


def colour_discs(discs: EllipseCollection, values: NDArray[Any], scale: ColourScale) -> None:
    """Colour discs by numbers, one each, shape (N,), on a scale; NaN: no number, which is grey."""
    discs.set_cmap(matplotlib.colormaps["viridis"].with_extremes(bad=NO_VALUE))
    discs.set_norm((LogNorm if scale.log else Normalize)(scale.low, scale.high))
    discs.set_array(on_scale(values, scale))


def on_scale(values: NDArray[Any], scale: ColourScale) -> Any:
    """Numbers as a collection takes them: on a logarithmic scale, 0 becomes a number below its lower end."""
    return np.ma.masked_invalid(np.maximum(values, scale.low / 2) if scale.log else values)


def colour_bar(
    axes: Axes, discs: EllipseCollection, scene: Scene, label: str, outside: Literal["neither", "both", "min", "max"]
) -> Colorbar:
    """The colour bar of discs, beside the box, or below it if the box is flat."""
    where: dict[str, Any] = {"location": "right", "shrink": 0.8, "aspect": 25}
    if _is_flat(scene):
        where = {"location": "bottom", "shrink": 0.6, "aspect": 40}
    figure = axes.figure.figure  # the whole one, where the axes are in one of its subfigures
    return figure.colorbar(discs, ax=axes, label=label, extend=outside, **where)


def closed_off(scene: Scene, walls: Box | None, theme: Theme = LIGHT) -> list[Rectangle]:
    """The regions of the box behind moving walls, as shapes to be drawn; [] if all walls are at rest, or unknown."""
    shapes: list[Rectangle] = []
    if walls is None:
        return shapes
    for wall in scene._moving_walls:
        edges = [0.0, scene.width, 0.0, scene.height]
        edges[wall.edge ^ 1] = walls[wall.edge]  # it is the other edge of the region behind it
        x_low, x_high, y_low, y_high = edges
        shapes.append(Rectangle((x_low, y_low), x_high - x_low, y_high - y_low, color=theme.behind))
    return shapes


class MovingDiscs:
    """Discs in their box, with obstacles and walls, which move from one picture of a film to the next.

    They begin at these positions. scale: of the numbers that colour the discs; None: one colour.
    """

    def __init__(
        self,
        axes: Axes,
        scene: Scene,
        position: NDArray[np.floating],
        radii: NDArray[np.floating],
        scale: ColourScale | None = None,
        theme: Theme = LIGHT,
    ):
        self._axes, self._scene, self._scale, self._theme = axes, scene, scale, theme
        self._capsules = scene._capsules_at(0.0)
        _draw_box(axes, scene, (0.0, 0.0))
        self._obstacles = draw_obstacles(axes, scene, self._capsules, theme)
        self.discs: EllipseCollection = self._draw(position, radii)
        self._closed = closed_off(scene, scene.box, theme)
        for shape in self._closed:
            axes.add_patch(shape)

    def _draw(self, position: NDArray[np.floating], radii: NDArray[np.floating]) -> EllipseCollection:
        """New discs: the sizes of a collection cannot change."""
        self._radii = radii
        discs = ellipses(self._axes, with_images(position, self._scene), radii, DISC_COLOUR, self._theme)
        if self._scale is not None:
            colour_discs(discs, np.zeros(len(radii)), self._scale)
        return discs

    def show(
        self,
        position: NDArray[np.floating],
        radii: NDArray[np.floating],
        values: NDArray[Any],
        walls: Box,
        capsules: NDArray[np.float64],
    ) -> None:
        """Show a moment: discs, NaN where absent, numbers to colour them by, walls, and `Scene._capsules_at`."""
        if capsules is not self._capsules:
            self._capsules = capsules
            if self._obstacles is not None:
                self._obstacles.remove()
            self._obstacles = draw_obstacles(self._axes, self._scene, capsules, self._theme)
        if len(radii) != len(self._radii) or not np.allclose(radii, self._radii):
            self.discs.remove()
            self.discs = self._draw(position, radii)
        self.discs.set_offsets(with_images(position, self._scene))
        if self._scale is not None:
            self.discs.set_array(on_scale(values, self._scale))
        for shape, now in zip(self._closed, closed_off(self._scene, walls), strict=False):  # [] where walls are unknown
            shape.set_bounds(*now.get_bbox().bounds)


def checked_picture(path: str | os.PathLike[str]) -> Path:
    """The path of a picture, or raise InputError if its ending is that of no format that can be written."""
    target = Path(path)
    if target.suffix.lower() not in ENDINGS:
        instead = f"Use {target.stem}.png, or {target.stem}.pdf for print."
        raise checks.refusal("a picture's path", f"end in one of {', '.join(ENDINGS)}", repr(str(target)), instead)
    return target


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write a figure in mpsim's style, in the format of the path's ending."""
    target = checked_picture(path)
    with (
        files.writable("a picture", target, "be a file that can be written, such as a .png"),
        matplotlib.rc_context(fname=STYLE),
        files.atomic_write(target) as file,
    ):
        figure.savefig(file.name, format=target.suffix.lower().removeprefix("."))
    return target


def plain_ticks(axis: Axis, digits: Sequence[float] = COARSE) -> None:
    """Numbers such as 0.5, 20 and 10,000 on a logarithmic axis, without powers of ten; digits: those of each decade."""
    axis.set_major_locator(LogLocator(subs=digits))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.12g}"))
    axis.set_minor_formatter(NullFormatter())


# --- One picture of a state, a frame of a trajectory, a simulation or a scene

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.


INCHES = 6.0  # longer side of the box in a figure of its own


@dataclass(frozen=True)
class Shown:
    """What a picture shows: discs in the order of their numbers, of which absorbed ones are left out."""

    state: State
    scene: Scene  # box and obstacles
    radius: NDArray[np.floating]
    mass: NDArray[np.floating]
    time: float | None = None  # None: unknown
    corner: tuple[float, float] = (0.0, 0.0)  # where the picture has the lower left corner of the box


KINDS: dict[str, tuple[str, Callable[[Shown], Any]]] = {
    "speed": (SPEED, lambda shown: speeds_of(shown.state.velocity) if "velocity" in vars(shown.state) else None),
    "radius": ("radius [length]", lambda shown: shown.radius),
    "mass": ("mass [mass]", lambda shown: shown.mass),
    "spin": ("angular velocity [1/time]", lambda shown: shown.state.spin),
}
"""What discs can be coloured by, with the words of the colour bar."""


def draw(
    state: State | Frame | Simulation | Scene,
    scene: Scene | None = None,
    *,
    colour: str | ArrayLike | None = "speed",
    colour_label: str | None = None,
    scale: ScaleName = "linear",
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
        ax: Axes to draw in; None: a new figure.

    Returns:
        The whole matplotlib Figure, bound to no window. A notebook shows it; `savefig` writes it; its `axes[0]` is the
        box, in coordinates of the scene [length].

    Raises:
        InputError: for a State without a scene, or where obstacles move; a wrong length of an array; an unknown word.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=5, packing=0.2, radius=0.5, seed=1)
    >>> figure = mpsim.draw(scene, colour=[0, 1, 2, 3, 4], colour_label="number")
    >>> for number, (x, y) in enumerate(scene.position):
    ...     text = figure.axes[0].text(x, y, number, ha="center", va="center")
    >>> figure.axes[0].get_title()
    '5 discs'
    """
    shown = _shown_by(state, scene)
    scale = checks.choice("scale", scale, SCALES)  # pyright: ignore[reportAssignmentType]
    values, words = _numbers(colour, shown)
    if ax is not None and not isinstance(ax, Axes):
        raise checks.refusal("ax", "be an Axes of matplotlib", type(ax).__name__, "Leave it out, or make one.")
    here = np.flatnonzero(shown.state.present)
    step = max(math.ceil(len(here) / MOST_DISCS), 1)
    these = here[::step]
    with contextlib.nullcontext() if ax is not None else matplotlib.rc_context(fname=STYLE):
        axes = _own_axes(shown.scene) if ax is None else ax
        places, radii = shown.state.position[these], shown.radius[these]
        discs = draw_discs(axes, places, shown.scene, radii=radii, corner=shown.corner, time=shown.time or 0.0)
        if values is not None:
            found = percentile_scale(values[these], scale)
            colour_discs(discs, values[these], found)
            words = words if colour_label is None else str(colour_label)
            colour_bar(axes, discs, shown.scene, words, found.outside)
        elif isinstance(colour, str):
            discs.set_facecolor(colour)
        for shape in closed_off(shown.scene, shown.state.box):
            axes.add_patch(shape)
        number = f"{len(these):,} of {len(here):,}" if step > 1 else f"{len(here):,}"
        time = "" if shown.time is None else f"time {shown.time:.4g}, "
        axes.set_title(f"{time}{number} disc{'s' * (len(here) != 1)}")
    return axes.figure.figure


def _own_axes(scene: Scene, longer: float = INCHES) -> Axes:
    """Axes in a figure of their own; longer: side of the box [inch]."""
    width, height = (longer * side / max(scene.width, scene.height) for side in (scene.width, scene.height))
    size = max(width, 1.6), max(height, 0.5)
    return figure_around(scene, size, beside=(1.3, 0.6), below=(0.0, 1.4)).add_subplot()


def _shown_by(state: object, scene: object) -> Shown:
    if scene is not None and not isinstance(scene, Scene):
        raise checks.refusal("scene", "be an mpsim.Scene", type(scene).__name__, "Use Scene.load, or Scene(...).")
    if isinstance(state, Scene | Simulation) and scene is not None:
        raise checks.refusal("scene", f"be left out with a {type(state).__name__}, which has its own", repr(scene))
    if isinstance(state, Scene):
        start = State(state.position, state.velocity, spin=state.spin, box=state.box)
        return Shown(placed(start, state), state, state.radii, state.masses)
    if isinstance(state, Simulation):
        return Shown(placed(state.state, state.scene), state.scene, state.radii, state.masses, state.time)
    if isinstance(state, Frame):
        return _moment_of(state, scene)
    if not isinstance(state, State):
        rule = "be a State, a frame of a Trajectory, a Simulation or a Scene"
        raise checks.refusal("state", rule, type(state).__name__, "Use sim.state.")
    if scene is None:
        instead = "Use draw(state, scene), or draw(sim) while the simulation is open."
        raise checks.refusal("scene", "be given with a State, which has no radii", f"{state!r} alone", instead)
    if len(state.position) != scene.count:
        known = "Discs that were added or entered are known to the simulation"
        rule, got = "have as many discs as the state", f"{scene.count} and {len(state.position)}"
        raise checks.refusal("scene", rule, got, f"{known}: use draw(sim), or a frame of a Trajectory.")
    if scene._obstacles_move:
        instead = "Use draw(sim), or a frame of a Trajectory."
        raise checks.refusal("state", "have a time where obstacles move", "a State, which has none", instead)
    return Shown(placed(state, scene), scene, scene.radii, scene.masses)


def _moment_of(frame: Frame, scene: Scene | None) -> Shown:
    """The discs of a frame, which may hold less than a state: what it lacks is an error only if it is needed."""
    corner = (0.0, 0.0)
    if scene is None:  # its box, with nothing in it
        (width, height), corner, none = frame.box, frame.origin, np.zeros((0, 2))
        small, boundary = min(width, height) / 4, boundary_of(frame.periodic)
        scene = Scene(width=width, height=height, position=none, velocity=none, radius=small, boundary=boundary)
    mass = frame.known.get("mass", np.ones(len(frame.position)))
    return Shown(placed(frame.state, scene), scene, frame.radius, mass, frame.known.get("time"), corner)


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
    count = len(shown.state.position)
    try:
        given = np.asarray(colour, np.float64)
    except (TypeError, ValueError, OverflowError):
        given = np.zeros(())
    if given.shape != (count,):
        words = f"{', '.join(map(repr, KINDS))}, a colour of matplotlib, or an array of {count} numbers"
        raise checks.refusal("colour", f"be one of {words}, one for each disc", checks.brief(colour))
    return given, ""


# --- A still of a scene, for a notebook

STILL = 3.0  # longer side of the box in a still
STILL_COLOURS = 48  # colours of a still: more hardly show, and fewer make it small


def scene_png(scene: Scene) -> bytes:
    """A scene as `draw` shows it, as a PNG of less than 100 kB."""
    with matplotlib.rc_context(fname=STYLE):
        axes = _own_axes(scene, STILL)
        figure, file, small = draw(scene, ax=axes), io.BytesIO(), io.BytesIO()
        axes.set_title(f"{axes.get_title()}, packing {scene.packing:.3g}", fontsize=9)
        figure.savefig(file, dpi=90, format="png")
    with Image.open(file) as picture:
        picture.convert("RGB").quantize(STILL_COLOURS).save(small, format="PNG", optimize=True)
    return small.getvalue()
