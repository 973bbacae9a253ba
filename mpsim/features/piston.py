"""Pistons: walls of the box that move, in and out or along themselves. Checked when made; immutable."""

# pyright: reportPrivateUsage=false, reportUnnecessaryIsInstance=false
# Names of Scene with an underscore are for all of mpsim; arguments are checked for callers without a type checker, too.

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.errors import InputError
from mpsim.features.edges import EDGES, MovingWall, demand_wall
from mpsim.features.feature import AddedDiscs, Continuation, Feature, chosen
from mpsim.features.motions import MOTIONS, Movement, Rotation, Translation, check_kind
from mpsim.features.properties import densest_packing, has_radii
from mpsim.kernels.features.bodies import MOTION, moving_wall_in, pose_at

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene


@dataclass(frozen=True)
class Piston:
    """A wall of the box that moves: by a motion, or in the short form at constant speed until it stops, or as a belt.

    Args:
        wall: "left", "right", "bottom" or "top".
        speed: along x or y [length/time], into the box; a right wall with a negative speed compresses.
        stop: coordinate at which it comes to rest [length], in the box, in the direction of motion. All discs must
            still fit in the box there.
        start: coordinate at which it is without displacement [length]; with a speed from its wall to stop, and at stop
            it is at rest. None: at its wall.
        motion: instead of speed and stop: a Translation, an Oscillation or a Path at right angles to the wall, in and
            out as it likes. It must stay in the box, and all discs must fit where it is farthest in.
        surface_velocity: at which the wall runs along itself, along x or y, acting through wall_friction, as in a shear
            cell [length/time]; alone or with one of the others. 0: the wall is at rest.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Piston("right", speed=-0.5, stop=3).stop
    3.0
    >>> Piston("top", surface_velocity=2)
    Piston(wall='top', surface_velocity=2.0)
    """

    wall: str
    speed: float | None = None
    stop: float | None = None
    start: float | None = None
    motion: Movement | None = None
    surface_velocity: float | None = None

    def __post_init__(self) -> None:
        checks.choice("wall of a Piston", self.wall, EDGES)
        ways = [name for name in ("speed", "stop", "motion") if getattr(self, name) is not None]
        if ways not in (["speed", "stop"], ["motion"]) and (ways or self.surface_velocity is None):
            raise InputError(
                "a Piston must have either a speed and a stop, or a motion, or a surface_velocity alone; got "
                f"{' and '.join(ways) or 'none of them'}. Give those of one way."
            )
        checks.keep_fields(self, start=partial(checks.non_negative, unit="[length]"), speed=checks.finite)
        checks.keep_fields(self, surface_velocity=checks.finite)
        if not ways:
            return
        if (speed := self.speed) is None:
            self._check_motion()
            return
        if speed == 0 or (speed < 0) != (self.wall in ("right", "top")):
            raise InputError(
                f"speed of a Piston must point into the box, {'< 0' if self.wall in ('right', 'top') else '> 0'} for "
                f"the {self.wall} wall; got {speed:g}. Turn its sign, or leave the piston out."
            )
        checks.keep_fields(self, stop="[length]")
        stop: Any = self.stop
        if self.start is not None and (stop - self.start) * speed < 0:
            side = "at or above" if speed < 0 else "at or below"
            raise InputError(
                f"start of a Piston must lie {side} its stop, {stop:g}, to which it moves; got {self.start:g}. "
                "Leave it out for a piston that starts at its wall."
            )

    def _check_motion(self) -> None:
        """Refuse what does not move a wall, or moves it along itself."""
        motion: Any = self.motion
        if isinstance(motion, Rotation):
            raise InputError("motion of a Piston must not be a Rotation: a wall cannot turn. Take a Polyline instead.")
        check_kind("motion of a Piston", motion, tuple(kind for kind in MOTIONS if kind is not Rotation))
        low, high = motion.swept(np.zeros((1, 2)))
        axis = EDGES.index(self.wall) // 2
        if low[1 - axis] or high[1 - axis] or low[axis] == high[axis]:
            raise InputError(
                f"motion of a Piston must be along {'xy'[axis]} alone, at right angles to the {self.wall} wall; got "
                f"{motion!r}. Give it (x, 0) for a left or right wall, (0, y) for the others."
            )

    def __repr__(self) -> str:
        return f"Piston({', '.join(f'{name}={each!r}' for name, each in chosen(self).items())})"


def check_piston(piston: Any, scene: Scene) -> Piston | tuple[Piston, ...] | None:
    """One piston, or several of different walls, checked: they move walls, and stay in the box."""
    if piston is None:
        return None
    each_of: tuple[Any, ...] = (piston,) if not isinstance(piston, Iterable) else tuple(cast(Any, piston))
    for each in each_of:
        if not isinstance(each, Piston):
            raise InputError(f"piston must be an mpsim.Piston, or a list of them; got {type(each).__name__}.")
        _check_one(each, scene)
    walls = [each.wall for each in each_of]
    if twice := [wall for wall in EDGES if walls.count(wall) > 1]:
        raise InputError(f"piston must have at most one Piston for each wall; got more for {twice[0]!r}. Leave one.")
    return each_of[0] if len(each_of) == 1 else each_of or None


def _check_one(piston: Piston, scene: Scene) -> None:
    demand_wall("piston", piston.wall, scene.boundary)
    if piston.wall in scene.absorbing:
        raise InputError(f"piston must not be an absorbing edge; got {piston.wall!r} for both. Choose one.")
    edge, _, low, high = _way(piston, scene)
    length = (scene.width, scene.height)[edge // 2]
    if piston.stop is not None and not 0 < piston.stop < length:
        raise InputError(f"stop of the piston must lie in the box, in (0, {length:g}); got {piston.stop:g}.")
    if piston.start is not None and piston.start > length:
        raise InputError(f"start of the piston must lie in the box, in [0, {length:g}]; got {piston.start:g}.")
    if low < -1e-9 * length or high > (1 + 1e-9) * length:
        raise InputError(
            f"the motion of the piston must keep the {piston.wall} wall in the box, in [0, {length:g}]; got "
            f"[{low:g}, {high:g}]. Give a Translation a stop, an Oscillation a start inside, or move less far."
        )


def _way(piston: Piston, scene: Scene) -> tuple[int, float, float, float]:
    """Its edge, its coordinate without displacement, and the least and the largest one at any time [length]."""
    edge = EDGES.index(piston.wall)
    at_rest = (0.0, scene.width, 0.0, scene.height)[edge]
    home = next(each for each in (scene._piston_from[1], piston.start, at_rest) if each is not None)
    if piston.stop is not None:
        return edge, home, min(home, piston.stop), max(home, piston.stop)
    if piston.motion is None:
        return edge, home, home, home
    low, high = piston.motion.swept(np.full((1, 2), home))
    return edge, home, float(low[edge // 2]), float(high[edge // 2])


class PistonFeature(Feature):
    """The argument `piston`."""

    argument = "piston"
    kinds: ClassVar[tuple[type[Any], ...]] = (Piston,)
    within: ClassVar[tuple[type[Any], ...]] = MOTIONS
    several: ClassVar[bool | None] = None
    examples: ClassVar[tuple[Any, ...]] = (Piston("left", 1.0, stop=1.0), Piston("right", -1.0, stop=1.0))
    drives = "a piston"
    relief = "let a piston stop earlier"

    def pistons(self, scene: Scene) -> tuple[Piston, ...]:
        """All that the scene has."""
        value: Any = self.of(scene)
        return (value,) if isinstance(value, Piston) else value

    def check(self, scene: Scene) -> None:
        largest = scene.largest_radius
        for piston, wall in zip(self.pistons(scene), self.moving_walls(scene), strict=True):
            if piston.surface_velocity and not scene.wall_friction:
                rule = "be 0 in a scene without wall_friction, through which it acts"
                instead = "Give the scene a wall_friction > 0, or leave it out."
                name = f"surface_velocity of the {wall.name}"
                raise checks.refusal(name, rule, f"{piston.surface_velocity:g}", instead)
            left = scene._smallest_sides()[wall.axis]
            if 2 * largest > left:
                raise InputError(
                    f"{_limit(piston)} of the {wall.name} must leave room for the largest disc, of diameter "
                    f"{2 * largest:g}; got {wall.innermost:g}, which leaves {left:g}. Put it farther out."
                )
        ending = [emitter for emitter in scene.emitters if emitter.limit is not None]
        radii = np.array([emitter.radius or largest for emitter in ending], float)
        number = np.concatenate([np.ones(scene.count), np.array([emitter.limit for emitter in ending], float)])
        name = f"{_limit(self.pistons(scene)[0])} of the piston"
        _demand_room(scene, name, np.concatenate([scene.radii, radii]), number)

    def check_room(self, scene: Scene, new: AddedDiscs) -> None:
        together = np.append(new.present, new.radius)
        _demand_room(scene, new.name, together, np.ones(len(together)))

    def moving_walls(self, scene: Scene) -> tuple[MovingWall, ...]:
        return tuple(self._moving_wall(each, scene) for each in self.pistons(scene))

    def _moving_wall(self, piston: Piston, scene: Scene) -> MovingWall:
        (edge, home, low, high), motion = _way(piston, scene), piston.motion
        length = (scene.width, scene.height)[edge // 2]
        record = np.zeros(1, moving_wall_in(np.float64))[0]
        record.home, record.low, record.high = home, max(low, 0.0), min(high, length)
        record.running, record.end, knots = piston.surface_velocity or 0.0, home, np.zeros((0, 3))
        name = "piston" if piston is self.of(scene) else f"{piston.wall} piston"
        if motion is piston.speed is None:
            return MovingWall(name, edge, record, knots)
        if motion is None:
            velocity = np.array([piston.speed, 0.0] if edge < 2 else [0.0, piston.speed])
            motion = Translation(velocity, start=scene._piston_from[0])
        body, knots = motion.body()
        for field, *_ in MOTION:
            record[field] = body[field]
        if piston.stop is not None and piston.speed is not None:
            record.stop = (piston.stop - home) / piston.speed
        record.moves, record.end = 1, home if piston.stop is None else piston.stop
        if piston.stop is None and math.isfinite(record.stop):
            pose = pose_at(record, knots, record.start + record.stop)
            record.end = min(max(home + (pose.x + pose.y), record.low), record.high)
        return MovingWall(name, edge, record, knots)

    def walls(self, scene: Scene, real: Any) -> dict[str, NDArray[Any]]:
        """The arrays of `MovingWalls`, in the precision of a run."""
        walls, tables = np.zeros(4, moving_wall_in(real)), [np.zeros((0, 3))]
        for each in scene._moving_walls:
            wall = walls[each.edge]
            for name in each.record.dtype.names:
                wall[name] = each.record[name]
            wall.knots[:] += sum(map(len, tables))
            tables.append(each.knots)
        margin = 0.0 if has_radii(scene) else scene.largest_radius
        walls["margin"] = margin, -margin, margin, -margin
        return {"wall": walls, "knots": np.concatenate(tables)}

    def running_speed(self, scene: Scene) -> float:
        return max((abs(wall.record.running) for wall in self.moving_walls(scene)), default=0.0)

    def works(self, scene: Scene) -> tuple[int | str, ...]:
        return tuple(EDGES[wall.edge] for wall in self.moving_walls(scene) if wall.speed or wall.record.running)

    def continued(self, scene: Scene, moment: Continuation) -> Any:
        found: list[Piston] = []
        for piston, wall in zip(self.pistons(scene), self.moving_walls(scene), strict=True):
            place = moment.box[wall.edge]
            if piston.motion is None:
                found.append(replace(piston, start=place))
                continue
            if abs(wall.place(moment.time) - place) > 1e-4 * max(scene.width, scene.height):
                raise InputError(
                    f"time must be that of the state, in which the {wall.name} is at {place:g}; got {moment.time:g}, "
                    f"when it is at {wall.place(moment.time):g}. Give scene.starting_from(state, sim.time)."
                )
            found.append(replace(piston, motion=piston.motion.seen_from(moment.time)))
        return check_piston(found, scene)

    def arrays(self, scene: Scene, real: np.dtype) -> dict[str, NDArray[Any]]:
        return {f"moving_wall.{name}": each for name, each in self.walls(scene, real).items()}

    def begin(self, scene: Scene, arrays: dict[str, Any], dt: float, origin: tuple[int, float]) -> None:
        arrays["moving_wall.wall"]["dt"], arrays["moving_wall.wall"]["origin"] = dt, origin[1]

    def description(self, scene: Scene) -> str:
        return "; ".join(f"the {each.wall} wall, {', '.join(_way_in_words(each))}" for each in self.pistons(scene))


PISTON = PistonFeature()


def _way_in_words(piston: Piston) -> Iterator[str]:
    if piston.speed is not None:
        start = "" if piston.start is None else f"from {piston.start:g} "
        yield f"speed {piston.speed:g}, {start}to {piston.stop:g}"
    if piston.motion is not None:
        yield repr(piston.motion)
    if piston.surface_velocity:
        yield f"surface velocity {piston.surface_velocity:g}"


def _limit(piston: Piston) -> str:
    return "motion" if piston.motion is not None else "stop" if piston.stop is not None else "start"


def _demand_room(scene: Scene, name: str, radius: Floats, number: Floats) -> None:
    """Refuse more discs, of the radii and numbers given, shape (K,), than fit in the box where it is smallest.

    name: of the argument.
    """
    wall = scene._moving_walls[0]
    if scene.absorbing or not number.any():  # few enough discs may be left in the end
        return
    length, across = (scene._smallest_sides()[axis] for axis in (wall.axis, 1 - wall.axis))
    area, radii = math.pi * float((number * radius**2).sum()), radius[number > 0]
    shortest = area / (densest_packing(float(radii.min()), float(radii.max())) * across)
    if length < shortest * (1 - 1e-12):
        raise InputError(
            f"{name} must leave room for all {number.sum():g} discs, a box at least {shortest:.4g} long and "
            f"{across:g} across: no arrangement of them is denser; got {wall.innermost:g}, which leaves {length:g} "
            f"(packing {area / (length * across):.3g}). Let the piston stop earlier, or use fewer or smaller discs."
        )
