"""A scene as a picture: discs at true radius, their images at periodic edges, what stands in it, walls that move."""

import os
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from numpy.typing import ArrayLike, NDArray

from mpsim.core import atomic
from mpsim.core.errors import OutputError
from mpsim.scene.scene import Scene

STYLE = Path(__file__).with_name("mpsim.mplstyle")

DISC_COLOUR = "#56B4E9"
SOLID_COLOUR = "#444444"
MOST_DISCS = 50_000
"""Discs that a still shows at most: more would take long, and be smaller than its pixels."""

BEHIND_COLOUR = "#BBBBBB"


def marker_of(points: int) -> str:
    """Matplotlib's marker for a line through so many points: few are drawn too, as a line through one is nothing."""
    return "." if points <= 100 else ""


def new_figure(width: float, height: float) -> Figure:
    """A figure of the given size [inch] in mpsim's style, bound to no window."""
    with matplotlib.rc_context(fname=STYLE):
        return Figure(figsize=(width, height))


def with_images(position: ArrayLike, scene: Scene) -> NDArray[np.float64]:
    """Centres and their images beyond the nearer periodic edges, the centres first: shape (N, 2), (2 N, 2) or (4 N, 2).

    The images of discs in the middle lie outside the box, where nothing is drawn.

    >>> scene = Scene(width=4, height=4, position=[[0.25, 1]], velocity=[[0, 0]], radius=0.5, boundary="periodic")
    >>> with_images(scene.position, scene).tolist()
    [[0.25, 1.0], [4.25, 1.0], [0.25, 5.0], [4.25, 5.0]]
    """
    places = np.array(position, dtype=np.float64).reshape(-1, 2)
    for axis, length in enumerate((scene.width, scene.height)):
        if scene.periodic[axis]:
            other = places.copy()
            other[:, axis] += np.where(places[:, axis] < length / 2, length, -length)
            places = np.concatenate([places, other])
    return places


def draw_discs(
    axes: Axes, position: ArrayLike, scene: Scene, colours: Any = DISC_COLOUR, radii: NDArray[np.float64] | None = None
) -> EllipseCollection:
    """Discs at true radius in their box, with what stands in it; no ticks, the frame is dotted where it is periodic.

    Args:
        axes: where to draw.
        position: of the discs, shape (N, 2) [length].
        scene: box, what stands in it, and radii where none are given.
        colours: one, or one for each disc.
        radii: shape (N,) [length].

    Returns:
        The discs, to be moved: `set_offsets(with_images(position, scene))`.
    """
    if not axes.collections:
        _draw_box(axes, scene)
    diameters = 2 * np.asarray(scene.radii if radii is None else radii)
    # Sizes and colours repeat, so that each image has those of its disc.
    discs = EllipseCollection(
        diameters,
        diameters,
        np.zeros(len(diameters)),
        units="xy",
        offsets=with_images(position, scene),
        offset_transform=axes.transData,
    )
    discs.set_facecolor(colours)
    discs.set_edgecolor("#00000060")
    discs.set_linewidth(0.3)
    axes.add_collection(discs)
    return discs


def _draw_box(axes: Axes, scene: Scene) -> None:
    axes.set(xlim=(0, scene.width), ylim=(0, scene.height), aspect="equal", xticks=[], yticks=[])
    axes.grid(False)
    for side, axis in (("left", 0), ("right", 0), ("bottom", 1), ("top", 1)):
        axes.spines[side].set_visible(True)
        axes.spines[side].set_linestyle(":" if scene.periodic[axis] else "-")
    shifts = [
        (0.0, -length, length) if wraps else (0.0,)
        for length, wraps in zip((scene.width, scene.height), scene.periodic, strict=True)
    ]
    shapes: list[Any] = []
    for (ax, ay, bx, by, radius), (x, y) in product(scene.capsules.tolist(), product(*shifts)):
        a, b = np.array([ax + x, ay + y]), np.array([bx + x, by + y])
        shapes += [Circle((float(end[0]), float(end[1])), radius) for end in (a, b)]
        length = float(np.hypot(*(b - a)))
        if length:
            across = radius / length * np.array([ay - by, bx - ax])
            shapes.append(Polygon([a - across, b - across, b + across, a + across]))
    if shapes:
        # The line is what remains of a wall without thickness.
        axes.add_collection(PatchCollection(shapes, facecolor=SOLID_COLOUR, edgecolor=SOLID_COLOUR, linewidth=1))


def closed_off(scene: Scene, time: float) -> Rectangle | None:
    """The region of the box behind a moving wall at a time, as a shape to be drawn; None if all walls are at rest.

    >>> half = {"width": 4, "height": 2, "position": [[1, 1]], "velocity": [[0, 0]], "radius": 0.5}
    >>> closed_off(Scene(**half), time=9.0) is None
    True
    """
    wall = scene.moving_wall
    if wall is None:
        return None
    low, high = (0.0, wall.at(time)) if wall.speed > 0 else (wall.at(time), (scene.width, scene.height)[wall.axis])
    if wall.axis == 0:
        return Rectangle((low, 0), high - low, scene.height, color=BEHIND_COLOUR)
    return Rectangle((0, low), scene.width, high - low, color=BEHIND_COLOUR)


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write a figure in mpsim's style, in the format of the path's ending.

    Raises:
        OutputError: if it cannot be written.
    """
    target = Path(path)
    try:
        with matplotlib.rc_context(fname=STYLE), atomic.atomic_write(target) as file:
            figure.savefig(file.name, format=target.suffix.removeprefix("."))
    except (OSError, ValueError) as error:  # ValueError: an ending that matplotlib cannot write
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"a picture must be a file that can be written, such as a .png; got {str(target)!r} ({reason}). "
            "Choose another place."
        ) from error
    return target
