"""A piston: a wall of the box that moves. Checked when made; immutable."""

# pyright: reportPrivateUsage=false, reportUnnecessaryIsInstance=false
# Names of Scene with an underscore are for all of mpsim; arguments are checked for callers without a type checker, too.

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.features.edges import EDGES, MovingWall, demand_wall
from mpsim.features.feature import AddedDiscs, Continuation, Feature, Floats, Invalidation, Shapes
from mpsim.features.properties import densest_packing
from mpsim.kernels.records import moving_wall_in

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene


@dataclass(frozen=True)
class Piston:
    """A wall of the box that moves at constant speed.

    Args:
        wall: "left", "right", "bottom" or "top".
        speed: along x or y [length/time]; a right wall with a negative speed compresses.
        stop: coordinate at which it comes to rest [length], in the box, in the direction of motion. All discs must
            still fit in the box there.
        start: coordinate at which it begins [length], from its wall to stop; at stop it is at rest. None: at its wall.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Piston("right", speed=-0.5, stop=3).stop
    3.0
    """

    wall: str
    speed: float
    stop: float
    start: float | None = None

    def __post_init__(self) -> None:
        checks.choice("wall of a Piston", self.wall, EDGES)
        speed = float(checks.finite_array("speed of a Piston", self.speed, (), "()"))
        if speed == 0 or (speed < 0) != (self.wall in ("right", "top")):
            raise InputError(
                f"speed of a Piston must point into the box, {'< 0' if self.wall in ('right', 'top') else '> 0'} for "
                f"the {self.wall} wall; got {speed:g}. Turn its sign, or leave the piston out."
            )
        object.__setattr__(self, "speed", speed)
        object.__setattr__(self, "stop", checks.positive("stop of a Piston", self.stop, "[length]"))
        if self.start is not None:
            start = checks.non_negative("start of a Piston", self.start, "[length]")
            if (self.stop - start) * speed < 0:
                side = "at or above" if speed < 0 else "at or below"
                raise InputError(
                    f"start of a Piston must lie {side} its stop, {self.stop:g}, to which it moves; got {start:g}. "
                    "Leave it out for a piston that starts at its wall."
                )
            object.__setattr__(self, "start", start)

    def __repr__(self) -> str:
        start = "" if self.start is None else f", start={self.start!r}"
        return f"Piston(wall={self.wall!r}, speed={self.speed!r}, stop={self.stop!r}{start})"


def check_piston(piston: Any, scene: Scene) -> Piston | None:
    """The piston, checked: it moves a wall, and stops in the box."""
    if piston is None:
        return None
    if not isinstance(piston, Piston):
        raise InputError(f"piston must be an mpsim.Piston; got {type(piston).__name__}.")
    demand_wall("piston", piston.wall, scene.boundary)
    if piston.wall in scene.absorbing:
        raise InputError(f"piston must not be an absorbing edge; got {piston.wall!r} for both. Choose one.")
    length = scene.width if piston.wall in ("left", "right") else scene.height
    if not 0 < piston.stop < length:
        raise InputError(f"stop of the piston must lie in the box, in (0, {length:g}); got {piston.stop:g}.")
    if piston.start is not None and piston.start > length:
        raise InputError(f"start of the piston must lie in the box, in [0, {length:g}]; got {piston.start:g}.")
    return piston


class PistonFeature(Feature):
    """The argument `piston`."""

    argument = "piston"
    kinds: ClassVar[tuple[type[Any], ...]] = (Piston,)
    several = False
    examples: ClassVar[tuple[Any, ...]] = (Piston("left", 1.0, stop=1.0), Piston("right", -1.0, stop=1.0))
    drives = "a piston"
    relief = "let a piston stop earlier"
    invalidates: ClassVar[tuple[Invalidation, ...]] = (
        Invalidation(
            ("pressure", "virial", "energy_drift"),
            "moving walls (a piston), which do work and change the box",
            "Run until the piston rests, and measure in a scene without it, made of sim.state, in a box of that size.",
        ),
    )

    def check(self, scene: Scene) -> None:
        piston: Piston = self.of(scene)
        largest = scene.largest_radius
        length = scene.width if piston.wall in ("left", "right") else scene.height
        left = piston.stop if piston.wall in ("right", "top") else length - piston.stop
        if 2 * largest > left:
            raise InputError(
                f"stop of the piston must leave room for the largest disc, of diameter {2 * largest:g}; got "
                f"{piston.stop:g}, which leaves {left:g}. Let it stop earlier."
            )
        ending = [emitter for emitter in scene.emitters if emitter.limit is not None]
        radii = np.array([emitter.radius or largest for emitter in ending], float)
        number = np.concatenate([np.ones(scene.count), np.array([emitter.limit for emitter in ending], float)])
        _demand_room(scene, "stop of the piston", np.concatenate([scene.radii, radii]), number)

    def check_room(self, scene: Scene, new: AddedDiscs) -> None:
        together = np.append(new.present, new.radius)
        _demand_room(scene, new.name, together, np.ones(len(together)))

    def moving_wall(self, scene: Scene) -> MovingWall:
        piston: Piston = self.of(scene)
        edge = EDGES.index(piston.wall)
        start = (0.0, scene.width, 0.0, scene.height)[edge] if piston.start is None else piston.start
        return MovingWall("piston", edge, start, piston.stop, piston.speed, scene._piston_began)

    def continued(self, scene: Scene, moment: Continuation) -> Piston | None:
        piston: Piston = self.of(scene)
        return check_piston(replace(piston, start=moment.box[EDGES.index(piston.wall)]), scene)

    def shapes(self, scene: Scene, capacity: int, real: np.dtype) -> Shapes:
        return {"piston": (moving_wall_in(real), ())}

    def fill(self, scene: Scene, arrays: dict[str, Any], margin: float) -> None:
        wall, record = self.moving_wall(scene), arrays["piston"]
        record.edge, record.start, record.stop, record.speed = wall[1:5]
        record.arrival, record.began = wall.arrival, wall.began
        record.margin = margin if wall.speed > 0 else -margin

    def begin(self, scene: Scene, arrays: dict[str, Any], dt: float, origin: tuple[int, float]) -> None:
        arrays["piston"].dt, arrays["piston"].origin = dt, origin[1]

    def description(self, scene: Scene) -> str:
        piston: Piston = self.of(scene)
        start = "" if piston.start is None else f"from {piston.start:g} "
        return f"the {piston.wall} wall, speed {piston.speed:g}, {start}to {piston.stop:g}"


PISTON = PistonFeature()


def _demand_room(scene: Scene, name: str, radius: Floats, number: Floats) -> None:
    """Refuse more discs, of the radii and numbers given, shape (K,), than fit in the box where the piston has stopped.

    name: of the argument.
    """
    wall = PISTON.moving_wall(scene)
    if scene.absorbing or not number.any():  # few enough discs may be left in the end
        return
    low, high = scene.walls_at(math.inf)
    length, across = (high - low)[[wall.axis, 1 - wall.axis]].tolist()
    area, radii = math.pi * float((number * radius**2).sum()), radius[number > 0]
    shortest = area / (densest_packing(float(radii.min()), float(radii.max())) * across)
    if length < shortest * (1 - 1e-12):
        raise InputError(
            f"{name} must leave room for all {number.sum():g} discs, a box at least {shortest:.4g} long and "
            f"{across:g} across: no arrangement of them is denser; got {wall.stop:g}, which leaves {length:g} (packing "
            f"{area / (length * across):.3g}). Let the piston stop earlier, or use fewer or smaller discs."
        )
