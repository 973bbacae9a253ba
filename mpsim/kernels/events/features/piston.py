"""A wall of the box that moves at constant speed until it stops. `side` of an impact on it is MOVING_WALL.

Its place follows from the time since the start of the run. All other times here are counted from the start of the lap;
`since_start` converts them.
"""

from typing import Any, NamedTuple

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.features.gravity import component
from mpsim.kernels.events.features.properties import radius_of
from mpsim.kernels.events.flight import time_to_limit
from mpsim.kernels.events.records import MOVING_WALL


class Wall(NamedTuple):
    """edge: LEFT, ...; start, stop: coordinates [length]; speed [length/time]; arrival: when it stops [time]."""

    edge: int
    start: float
    stop: float
    speed: float
    arrival: float


def moving_wall_of(scene: Any) -> Wall | None:
    """The moving wall of a scene."""
    wall = scene.moving_wall
    if wall is None:
        return None
    start, stop, speed = float(wall.start), float(wall.stop), float(wall.speed)
    return Wall(int(wall.edge), start, stop, speed, (stop - start) / speed)


FIELDS = {"moving_wall": moving_wall_of, "crushing_speed": None}
"""crushing_speed: above it [length/time] a disc that leaves the wall has no room left, or None if nobody asks: between
the wall and what stands against it a disc meets both ever faster, without end."""


@inlined
def is_crushed(wall, crushing_speed, disc):
    """Whether a disc leaves the wall so fast that it has been crushed."""
    if wall is None or crushing_speed is None:
        return False
    return abs(disc.velocity[wall.edge >> 1]) > crushing_speed


@inlined
def since_start(t, store):
    """The time since the start of the run, from one that is counted from the start of the lap [time]."""
    return store.clock.origin + t


@inlined
def time_to_wall(wall, disc, radius, gravity, store):
    """Time from its last event until a disc meets the wall, moving or at rest [time]."""
    axis = wall.edge >> 1
    inward = -1.0 if wall.edge & 1 else 1.0
    place, speed, pull = disc.position[axis], inward * disc.velocity[axis], inward * component(gravity, axis)
    present = since_start(disc.last_update, store)
    left = wall.arrival - present
    if left <= 0.0:
        return time_to_limit(inward * (place - wall.stop) - radius, speed, pull)
    ahead = inward * (place - (wall.start + wall.speed * present)) - radius
    t = time_to_limit(ahead, speed - inward * wall.speed, pull)
    if t < left:
        return t
    # A disc on which the wall stops is on it, or beyond it by rounding.
    ahead = inward * (place - wall.stop) - radius + left * (speed + 0.5 * pull * left)
    return left + time_to_limit(ahead, speed + pull * left, pull)


@inlined
def before_border(wall, i, store, box, features):
    """Predict the impact of disc i, whose stored state is current, on the wall before it leaves its cell."""
    if wall is not None:
        disc = store.disc[i]
        t = disc.last_update + time_to_wall(wall, disc, radius_of(i, box, features), features.gravity, store)
        if t <= disc.crossing_time:
            disc.crossing_time = t
            store.event[i].side = MOVING_WALL


@inlined
def surface(wall, i, now, store, box, features):
    """The wall that disc i, whose stored state is current, has hit; see `hooks.surface`."""
    if wall is None:
        return False, 0.0, 0.0, 0.0, 0.0, -1
    axis = wall.edge >> 1
    inward = -1.0 if wall.edge & 1 else 1.0
    present = since_start(now, store)
    place, speed = wall.stop, 0.0
    if present < wall.arrival:
        place, speed = wall.start + wall.speed * present, inward * wall.speed
    depth = radius_of(i, box, features) - inward * (store.disc[i].position[axis] - place)
    return True, (inward if axis == 0 else 0.0), (inward if axis == 1 else 0.0), depth, speed, wall.edge
