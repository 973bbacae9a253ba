"""Sums over discs in chunks, and differences of positions."""

import functools
import math
import operator
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.columns import equal_sizes
from mpsim.core.state import Box, Discs, State, count_of, parts_of, present_in
from mpsim.errors import InputError
from mpsim.features.energy import is_heated
from mpsim.scene import placement
from mpsim.scene.scene import Scene

# --- Sums over discs in float64, in chunks, so that no process has to hold all discs
#
# The sums of the chunks are added in the order of the discs' numbers, so the result has the same bits wherever the
# discs are. If all discs fit in one chunk, it has the bits of a single sum. Only discs that are present count.

Floats = NDArray[np.float64]


class Chunk(NamedTuple):
    """Consecutive discs: the rows of their numbers, and their state. Properties are those of the K present ones."""

    rows: slice
    state: State

    @property
    def number(self) -> int:
        """K."""
        return int(np.count_nonzero(self.state.present))

    @property
    def position(self) -> Floats:
        """Positions, checked to be finite, shape (K, 2) [length]."""
        return checked_positions(self.state.position)[present_in(self.state)]

    @property
    def velocity(self) -> Floats:
        """Velocities, checked to be finite, shape (K, 2) [length/time]."""
        shape = len(self.state.present), 2
        return checks.finite_array("state.velocity", self.state.velocity, shape, "(N, 2)")[present_in(self.state)]

    @property
    def spin(self) -> Floats:
        """Angular velocities of discs that spin, checked to be finite, shape (K,) [1/time]."""
        shape = (len(self.state.present),)
        return checks.finite_array("state.spin", self.state.spin, shape, "(N,)")[present_in(self.state)]

    def of(self, each: Floats) -> Floats:
        """Their rows of an array of all discs, shape (K, ...)."""
        return np.ascontiguousarray(each[self.rows])[present_in(self.state)]


def parts(discs: Discs) -> Iterator[Chunk]:
    """The discs in the order of their numbers, a chunk at a time; at least one part."""
    return (Chunk(*each) for each in parts_of(discs))


def total(discs: Discs, term: Callable[[Chunk], Any]) -> Any:
    """The sum of a term over all parts; the term gives numbers, or arrays of one shape.

    >>> total(State(np.zeros((3, 2)), np.ones((3, 2))), lambda part: part.velocity.sum(axis=0)).tolist()
    [3.0, 3.0]
    """
    return functools.reduce(operator.add, map(term, parts(discs)))  # not `sum`, which rounds as its version of Python


def checked_positions(position: NDArray[np.floating]) -> Floats:
    """Positions, a copy, checked to be finite, shape (N, 2) [length]."""
    return checks.finite_array("state.position", position, (None, 2), "(N, 2)")


SAME_BOX = 1e-4
"""Difference of two boxes, as a fraction of a side, that may come from a file."""


def demand_scene(scene: object, *states: Discs) -> None:
    """Refuse, naming it, what is no scene, such as a state, and a scene in whose box the states are not."""
    if not isinstance(scene, Scene):
        raise InputError(
            f"scene must be a Scene; got {type(scene).__name__}. Use sim.scene of a Simulation; the state comes first."
        )
    moving = {wall.axis for wall in scene._moving_walls}
    for box in filter(None, (getattr(state, "box", None) for state in states)):
        sides = (box[1] - box[0]) / scene.width, (box[3] - box[2]) / scene.height
        fixed = [side for axis, side in enumerate(sides) if axis not in moving]
        if any(abs(side - 1) > SAME_BOX for side in fixed):
            raise InputError(
                f"scene must be that of the state, whose box is {_sides(box)}; got one of {_sides(scene.box)}. "
                "Use the scene of the simulation that the state comes from."
            )


def placed(discs: Any, scene: Scene) -> Any:
    """The discs in the coordinates of their scene, in its box: see `placement.placed`. Those of ranks are there.

    Raises:
        InputError: as `demand_scene`; if a disc that is present is not between the walls.
    """
    count_of(discs)  # which refuses what is no state
    demand_scene(scene, discs)
    if not isinstance(discs, State):
        return discs
    found = placement.placed(discs, scene)
    beyond = np.abs(found.position / (scene.width, scene.height) - 0.5).max(axis=1) > 0.5 + SAME_BOX
    if (beyond & found.present).any():
        disc = int(np.flatnonzero(beyond & found.present)[0])
        raise InputError(
            f"the discs of a state must be in its box, {_sides(scene.box)}; got disc {disc} at "
            f"{tuple(found.position[disc].tolist())} in it. Use a box that holds every disc: by the Lattice and "
            "Origin of a file, by State(..., box=...), or a periodic one."
        )
    return found


def _sides(box: Sequence[float]) -> str:
    return f"{box[1] - box[0]:g} x {box[3] - box[2]:g}"


def masses_of(name: str, scene: Scene, discs: Discs) -> Floats:
    """Mass of each disc, shape (N,) [mass], as `one_of_each`. It includes discs that were added if all masses are 1."""
    demand_scene(scene, discs)
    if scene.mass is None and all(emitter.mass in (None, 1.0) for emitter in scene.emitters):
        return equal_sizes(1.0, count_of(discs))
    return one_of_each(name, "mass", scene.masses, discs)


def radii_of(name: str, scene: Scene, discs: Discs) -> Floats:
    """Radius of each disc, shape (N,) [length], as `one_of_each`."""
    demand_scene(scene, discs)
    if isinstance(scene.radius, float) and scene.smallest_radius == scene.largest_radius:
        return equal_sizes(scene.radius, count_of(discs))
    return one_of_each(name, "radius", scene.radii, discs)


def one_of_each(name: str, what: str, values: Floats, discs: Discs) -> Floats:
    """Values of the scene, one for each disc; an InputError that names the caller for another number of them."""
    if len(values) != (count := count_of(discs)):
        raise InputError(
            f"{name} needs one {what} of the scene per disc; got {len(values)} and {count} discs. "
            f"Make a scene that holds all discs, with the {what} of each."
        )
    return values


def any_present(discs: Discs) -> bool:
    """Whether any disc has not left."""
    return any(part.number for part in parts(discs))


def any_spin(discs: Discs) -> bool:
    """Whether the discs have angular velocities."""
    return next(parts(discs)).state.spin is not None


def any_moves(discs: Discs) -> bool:
    """Whether any disc has a velocity."""
    return any(part.velocity.any() for part in parts(discs))


def mass_and_momentum(discs: Discs, masses: Floats) -> tuple[float, Floats]:
    """Sums of m [mass] and of m v, shape (2,) [mass length/time]; masses: shape (N,)."""

    def term(part: Chunk) -> Floats:
        mass = part.of(masses)
        return np.array([mass.sum(), *(mass[:, None] * part.velocity).sum(axis=0)])

    mass, *momentum = total(discs, term)
    return float(mass), np.array(momentum)


def number_and_squares(discs: Discs, masses: Floats, drift: Any = 0.0) -> tuple[int, float]:
    """Number of discs, and the sum of m (v - drift)^2, twice their energy of translation [mass length^2/time^2]."""

    def term(part: Chunk) -> Floats:
        squares = part.velocity - drift
        np.square(squares, out=squares)
        squares *= part.of(masses)[:, None]
        return np.array([len(squares), squares.sum()])

    number, squares = total(discs, term).tolist()
    return int(number), squares


def energy_of_translation(discs: Discs, masses: Floats) -> float:
    """Sum of m v^2 / 2 [mass length^2/time^2]; masses: shape (N,)."""
    return 0.5 * number_and_squares(discs, masses)[1]


def energy_of_rotation(discs: Discs, masses: Floats, radii: Floats) -> float:
    """Sum of m a^2 spin^2 / 4 [mass length^2/time^2], 0 of discs that do not spin; masses, radii: shape (N,)."""

    def term(part: Chunk) -> float:
        if part.state.spin is None:
            return 0.0
        return float((part.of(masses) * (part.of(radii) * part.spin) ** 2).sum())

    return 0.25 * total(discs, term)


def momenta(discs: Discs, masses: Floats) -> float:
    """Sum of m |v| [mass length/time]; masses: shape (N,)."""
    return total(discs, lambda part: float((part.of(masses) * np.hypot(*part.velocity.T)).sum()))


def number_and_speed(discs: Discs) -> tuple[int, float]:
    """Number of discs, and the root mean square of one velocity component [length/time], 0 without discs."""
    number, squares = number_and_squares(discs, equal_sizes(1.0, count_of(discs)))
    return number, math.sqrt(squares / (2 * number)) if number else 0.0


def flow_of_momentum(discs: Discs, scene: Scene) -> tuple[float, float, float]:
    """Sums of m v_x v_x, m v_y v_y, m v_x v_y [mass length^2/time^2], without a mean flow that nothing changes.

    That is the flow along periodic axes; but a heat bath changes the momentum of the whole gas, which then is one more
    thermal motion, not a flow.
    """
    masses = masses_of("pressure", scene, discs)
    mass, flow = mass_and_momentum(discs, masses)
    kept = (False, False) if is_heated(scene) else scene.periodic
    drift = flow * kept / max(mass, 1e-300)

    def squares(part: Chunk) -> Floats:
        mass, (x, y) = part.of(masses), (part.velocity - drift).T
        # no BLAS: its bits follow its threads
        return np.array([(mass * x * x).sum(), (mass * y * y).sum(), (mass * x * y).sum()])

    xx, yy, xy = total(discs, squares).tolist()
    return xx, yy, xy


# --- Periodic boxes


def sides_of(scene: Scene, box: Box | None = None) -> tuple[float, float]:
    """Width and height of a scene, or those of the box of a state of it [length]."""
    return (scene.width, scene.height) if box is None else (box[1] - box[0], box[3] - box[2])


def to_nearest_image(difference: Floats, scene: Scene, box: Box | None = None) -> Floats:
    """Differences of positions, shape (..., 2), to the nearest image along each periodic axis of a scene, or a box."""
    sides = np.array(sides_of(scene, box))
    return difference - np.where(scene.periodic, np.round(difference / sides), 0.0) * sides
