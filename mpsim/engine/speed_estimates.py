"""How fast the discs of a state are, or will be, for what they may be: the estimates that the watch acts on."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.features.packing_bounds import densest_packing
from mpsim.scene.scene import Scene

DENSE = 0.7
"""Packing from which on discs are taken for a crystal."""


@dataclass(frozen=True)
class Pace:
    """How fast the discs of a state are, for what they may be.

    Attributes:
        disc: index of the one whose displacement in a step is the largest fraction of what it may be; -1: there is
            none, or it is still to come.
        speed: of it, or its component between two walls [length/time].
        limit: displacement that it may make in a step: its radius, or its free distance between walls; infinite where
            there is no disc [length].
        between: "" or the axis between whose walls that is.
        meetings: collisions of a disc with others, estimated [1/time].
        mean_speed: root mean square [length/time].
        smallest: radius of the smallest disc [length].
        when: "" now; or, in words, when discs are, were or will be so fast.
    """

    disc: int = -1
    speed: float = 0.0
    limit: float = math.inf
    between: str = ""
    meetings: float = 0.0
    mean_speed: float = 0.0
    smallest: float = math.inf
    when: str = ""

    def part(self, dt: float) -> float:
        """Displacement of the fastest disc in a step of length dt, as a fraction of what it may be."""
        return self.speed * dt / self.limit

    def or_faster(self, other: "Pace | None") -> "Pace":
        """This one, with the fastest disc of a moment before, unless that was slower (but for rounding)."""
        if other is None or other.part(1 + 1e-5) < self.part(1.0):
            return self
        return replace(other, meetings=self.meetings, mean_speed=self.mean_speed, smallest=self.smallest)


def pace_of(
    velocity: NDArray[Any],
    radius: NDArray[np.float64],
    scene: Scene,
    time: float = 0.0,
    present: NDArray[np.bool_] | None = None,
) -> Pace:
    """How fast discs are.

    Args:
        velocity: shape (N, 2), in the order of the scene's discs, so that no sum depends on another one [length/time].
        radius: shape (N,) [length].
        scene: whose box it is.
        time: at which it is looked at: a wall may have moved [time].
        present: which discs have not left, shape (N,); None: all are there.
    """
    if present is not None:
        index = np.flatnonzero(present)
        found = pace_of(velocity[index], radius[index], scene, time)
        return replace(found, disc=int(index[found.disc])) if found.disc >= 0 else found
    if not len(velocity):
        return Pace()
    vx, vy = velocity.astype(np.float64).T
    squares = vx * vx + vy * vy
    speed = np.sqrt(squares)
    mean_speed = math.sqrt(float(squares.mean()))
    worst = int((speed / radius).argmax())
    found = Pace(worst, float(speed[worst]), float(radius[worst]))
    sides = sides_at(scene, time)
    for axis, (v, length) in enumerate(zip((vx, vy), sides, strict=True)):
        free = length - 2 * radius
        if scene.periodic[axis] or (free >= radius).all():
            continue
        # Where there is no room at all, or rounding's worth of it, a disc stands between the walls as it should.
        free = np.where(free > 1e-6 * length, free, np.inf)
        worst = int((np.abs(v) / free).argmax())
        between = Pace(worst, float(abs(v[worst])), float(free[worst]), "xy"[axis])
        found = max(found, between, key=lambda pace: pace.part(1.0))
    meetings = _meetings(radius, mean_speed, sides)
    return replace(found, meetings=meetings, mean_speed=mean_speed, smallest=float(radius.min()))


def sides_at(scene: Scene, time: float) -> tuple[float, float]:
    """Width and height of the box at a time [length]."""
    low, high = scene.walls_at(time)
    width, height = (high - low).tolist()
    return width, height


def _meetings(radius: NDArray[np.float64], speed: float, sides: tuple[float, float]) -> float:
    """Collisions of a disc with others per time, as in a gas without structure: 2 sqrt(pi) n sigma g sqrt(kT/m).

    g, the density of neighbours in touch: of a fluid (Henderson 1975), or above packing 0.7 of a crystal by its free
    volume, (Z - 1) / (2 packing) with Z = 2 / (1 - packing / densest).
    """
    area = sides[0] * sides[1]
    packing = math.pi * float((radius * radius).sum()) / area
    if speed == 0 or len(radius) < 2:
        return 0.0
    densest = densest_packing(float(radius.min()), float(radius.max()))
    if packing >= densest:
        return math.inf
    if packing <= DENSE:
        crowding = (1 - 7 * packing / 16) / (1 - packing) ** 2
    else:
        crowding = (2 / (1 - packing / densest) - 1) / (2 * packing)
    density = (len(radius) - 1) / area
    return 2 * math.sqrt(math.pi) * density * 2 * float(radius.mean()) * crowding * speed / math.sqrt(2)


# --- what is still to come


def pull_of(scene: Scene) -> float:
    """Largest acceleration of a disc [length/time^2]."""
    pulls = [0.0] if scene.gravity is None else [float(np.hypot(*scene.gravity))]
    if scene.acceleration is not None and scene.count:
        pulls.append(float(np.hypot(*scene.acceleration.T).max()))
    return sum(pulls)


def pace_after_fall(pace: Pace, scene: Scene) -> Pace:
    """How fast the fastest disc is where acceleration has taken it through the box: of no discs, that of an emitter."""
    fall = math.sqrt(2 * pull_of(scene) * max(sides_at(scene, 0.0)))
    if not fall:
        return pace
    pace = pace if scene.count else pace_of_emitters(scene)
    return replace(pace, speed=math.hypot(pace.speed, fall), when="after a fall through the box")


def pace_in_equilibrium(pace: Pace, scene: Scene) -> Pace:
    """How fast discs become whose masses differ: collisions give each the same energy, so light ones become fast.

    With E = <m v^2> the mean square of a disc's speed is E / m, and the fastest of N is sqrt(ln N) times faster:
    speeds in two dimensions exceed s with probability exp(-s^2 m / E).
    """
    if scene.mass is None or scene.count < 2:
        return pace
    squares = (scene.velocity**2).sum(axis=1)
    energy = float((scene.mass * squares).mean())
    speed = np.sqrt(energy / scene.mass * max(math.log(scene.count), 1.0))
    worst = int((speed / scene.radii).argmax())
    mean_speed = math.sqrt(energy * float((1 / scene.mass).mean()))
    return replace(
        pace,
        disc=worst,
        speed=float(speed[worst]),
        limit=float(scene.radii[worst]),
        between="",
        meetings=_meetings(scene.radii, mean_speed, sides_at(scene, 0.0)),
        mean_speed=mean_speed,
        when="once collisions have shared the energy out",
    )


def pace_of_emitters(scene: Scene) -> Pace:
    """How fast the fastest disc of an emitter enters, for what it may be."""
    if not scene.emitters:
        return Pace()
    common = scene.largest_radius
    limits = [common if emitter.radius is None else emitter.radius for emitter in scene.emitters]
    velocities: Any = [emitter.velocity for emitter in scene.emitters]
    speeds = [math.hypot(*velocity) for velocity in velocities]
    index = int((np.array(speeds) / limits).argmax())
    return Pace(speed=speeds[index], limit=limits[index], when=f"from emitters[{index}]")


def pace_of_the_pushed(pace: Pace, scene: Scene) -> Pace:
    """How fast the smallest disc is when a moving wall has met it at rest: without loss twice as fast as the wall."""
    wall = scene.moving_wall
    if wall is None or not scene.count:
        return Pace()
    speed = (1 + scene.wall_restitution) * abs(wall.speed)
    return Pace(speed=speed, limit=pace.smallest, when=f"pushed by the {wall.name}")
