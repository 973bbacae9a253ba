"""Walls that move, and edges that absorb discs."""

from typing import Any, NamedTuple

from mpsim.kernels import geometry as motion
from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.features.properties import component, radius_of
from mpsim.kernels.events.flight import time_to_limit
from mpsim.kernels.events.records import MOVING_WALL

# --- Edges that absorb discs: a disc that touches one stays there, at rest, in no cell, and has no further event

EDGES = ("left", "right", "bottom", "top")


def absorbing_of(scene: Any) -> tuple[bool, ...] | None:
    """For each edge (LEFT, ...), whether it absorbs; None for a scene without such edges."""
    return tuple(edge in scene.absorbing for edge in EDGES) if scene.absorbing else None


@inlined
def is_absent(exits, i):
    """Whether disc i has been absorbed."""
    if exits is None:
        return False
    return exits[i, 0] != 0.0


@inlined
def lets_out(absorbing, side):
    """Whether the wall at `side` absorbs discs."""
    if absorbing is None:
        return False
    return absorbing[side]


@inlined
def leave(exits, disc, i):
    """Disc i, whose stored state is current, is absorbed where it is."""
    if exits is not None:
        exits[i, 0], exits[i, 1], exits[i, 2] = 1.0, disc.position[0], disc.position[1]
        disc.velocity[0], disc.velocity[1] = 0.0, 0.0


# --- A wall of the box that moves at constant speed until it stops. `side` of an impact on it is MOVING_WALL
#
# Its place follows from the time since it began. All other times here are counted from the start of the lap;
# `since_it_began` converts them.


class Wall(NamedTuple):
    """A wall as `moving_wall.py` has it, its edge (LEFT, ...), and when it began on the clock of the solver [time]."""

    edge: int
    start: float
    stop: float
    speed: float
    arrival: float
    began: float = 0.0


@inlined
def is_crushed(wall, crushing_speed, disc):
    """Whether a disc leaves the wall so fast that it has been crushed."""
    if wall is None or crushing_speed is None:
        return False
    return abs(disc.velocity[wall.edge >> 1]) > crushing_speed


@inlined
def since_it_began(wall, t, store):
    """The time since the wall began, from one that is counted from the start of the lap [time]."""
    return store.clock.origin + t - wall.began


@inlined
def time_to_wall(wall, disc, radius, gravity, store):
    """Time from its last event until a disc meets the wall, moving or at rest [time]."""
    axis = wall.edge >> 1
    inward = -1.0 if wall.edge & 1 else 1.0
    place, speed, pull = disc.position[axis], inward * disc.velocity[axis], inward * component(gravity, axis)
    present = since_it_began(wall, disc.last_update, store)
    left = wall.arrival - present
    if left <= 0.0:
        return time_to_limit(inward * (place - wall.stop) - radius, speed, pull)
    ahead = inward * (place - motion.place(wall, present)) - radius
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
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, -1
    axis = wall.edge >> 1
    inward = -1.0 if wall.edge & 1 else 1.0
    present = since_it_began(wall, now, store)
    speed = inward * motion.velocity(wall, present)
    depth = radius_of(i, box, features) - inward * (store.disc[i].position[axis] - motion.place(wall, present))
    return True, (inward if axis == 0 else 0.0), (inward if axis == 1 else 0.0), depth, speed, 0.0, wall.edge


FIELDS = {"absorbing": absorbing_of, "exits": None, "moving_wall": None, "crushing_speed": None}
