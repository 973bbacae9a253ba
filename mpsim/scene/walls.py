"""Where the walls of a scene's box are, and whether discs are between them; states of boxes that lie elsewhere."""

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State, moved_into
from mpsim.errors import InputError
from mpsim.features import FEATURES
from mpsim.features.edges import MovingWall, kinds_of
from mpsim.features.feature import SceneLike


def the_moving_wall(scene: SceneLike) -> MovingWall | None:
    """The wall that a feature of the scene moves; None if all are at rest.

    Raises:
        InputError: if there are several.
    """
    walls = [wall for feature in FEATURES if (wall := feature.moving_wall(scene)) is not None]
    if len(walls) > 1:
        names = " and ".join(wall.name for wall in walls)
        raise InputError(f"a scene must have at most one wall that moves; got {names}. Leave one of them out.")
    return walls[0] if walls else None


def placed(state: State, scene: SceneLike) -> State:
    """A state in the coordinates of its scene, each disc at its image in the box.

    A state of a file has a box of its own, which may begin anywhere, and discs that other programs have not wrapped.
    Walls at rest coincide. A state without a box has that of the scene.

    >>> from mpsim import Scene
    >>> scene = Scene(width=4, height=4, position=[[1, 1]], velocity=[[0, 0]], radius=0.5, boundary="periodic")
    >>> placed(State(np.array([[-1.0, 11.0]]), np.zeros((1, 2)), box=(-2, 2, 2, 6)), scene).position.tolist()
    [[1.0, 1.0]]
    """
    box = scene.box if state.box is None else state.box
    corner, wall = [box[0], box[2]], the_moving_wall(scene)
    if wall is not None and wall.edge % 2 == 0:
        corner[wall.axis] = box[wall.edge + 1] - (scene.width, scene.height)[wall.axis]
    return moved_into(state, box, scene.periodic, (corner[0], corner[1]))


def limits_at(
    scene: SceneLike, radius: float | NDArray[np.float64], time: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Smallest and largest centre coordinates of discs of a radius at a time, shapes (2,) or (N, 2) [length]."""
    low, high = scene.walls_at(time)
    walls = np.array([kind.has_walls for kind in kinds_of(scene.boundary)])
    margin = np.multiply.outer(np.asarray(radius), walls)
    return low + margin, high - margin


def check_inside(
    scene: SceneLike, name: str, position: NDArray[np.float64], radius: float | NDArray[np.float64], time: float
) -> None:
    """Refuse discs that are not in the box: see `Scene.check_inside`."""
    low, high = limits_at(scene, radius, time)
    # A centre may touch the wall to within rounding of the box's own coordinates.
    slack = 4 * np.finfo(np.float64).eps * max(scene.width, scene.height)
    outside = np.argwhere(((position < low - slack) | (position > high + slack)).any(axis=1))
    if len(outside):
        index = int(outside[0, 0])
        wall = the_moving_wall(scene)
        now = f", the {wall.name}'s place at time {time:g} included" if wall is not None and time > 0 else ""
        shape = position.shape
        (x_low, y_low), (x_high, y_high) = (np.broadcast_to(limit, shape)[index] for limit in (low, high))
        raise InputError(
            f"{name}[{index}] must lie in [{x_low:g}, {x_high:g}] x [{y_low:g}, {y_high:g}] (one "
            f"radius from the walls{now}); got {tuple(position[index].tolist())} (discs outside: {len(outside)}). "
            "Move the disc or enlarge the box."
        )
