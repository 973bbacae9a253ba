"""Walls that move, and edges that absorb discs."""

import numpy as np

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.events.features.bodies import MOST_STEPS, TOUCH, next_jump, step_to_contact
from mpsim.kernels.events.features.properties import component, radius_of
from mpsim.kernels.events.flight import INFINITY, time_to_limit
from mpsim.kernels.events.records import LOOK, MOVING_WALL
from mpsim.kernels.features.bodies import OSCILLATION, place_of_wall, velocity_of_wall

# --- Edges that absorb discs: a disc that touches one stays there, at rest, in no cell, and has no further event


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


# --- Walls of the box that move. `side` of an impact on one is MOVING_WALL and its edge
#
# The place of a wall follows from the time since it began. All other times here are counted from the start of the lap;
# `since_it_began` converts them. Wherever the velocity of a wall is constant, the time of an impact is a closed form.
# That on a wall that oscillates is found as on a body (`bodies.py`), by steps that cannot pass it.


@inlined
def is_moving_wall(moving_wall, side):
    """Whether `side` of an event is a wall that moves."""
    if moving_wall is None:
        return False
    return (side >= MOVING_WALL) & (side < LOOK)


@inlined
def is_crushed(crushing_speed, disc):
    """Whether a disc leaves a surface so fast that surfaces that move crush it, or drive it: no solver can follow."""
    if crushing_speed is None:
        return False
    return disc.velocity[0] ** 2 + disc.velocity[1] ** 2 > crushing_speed * crushing_speed


@inlined
def since_it_began(wall, t, store):
    """The time since the wall began, from one that is counted from the start of the lap [time]."""
    return store.clock.origin + t - wall.origin


@linked
def time_to_wall(wall, knots, axis, inward, disc, radius, gravity, within, store):
    """(time from its last event until a disc meets a wall, True), or (time up to which it does not, False).

    within: the longest time that is asked for [time].
    """
    place, speed, pull = disc.position[axis], inward * disc.velocity[axis], inward * component(gravity, axis)
    began = since_it_began(wall, disc.last_update, store)
    time, t, bend = began, 0.0, max(wall.bend - pull, 0.0)
    for _ in range(MOST_STEPS):
        jump = next_jump(wall, knots, time)
        opening = speed + pull * t - inward * velocity_of_wall(wall, knots, time)
        # A disc on which the wall stops or turns is on it, or beyond it by rounding.
        gap = inward * (place - place_of_wall(wall, knots, time)) - radius + t * (speed + 0.5 * pull * t)
        if wall.kind != OSCILLATION:
            met = time_to_limit(gap, opening, pull)
            if met < jump - time:
                return t + met, True
            time, t = jump, jump - began
        else:
            if gap <= TOUCH * (radius + abs(place)):
                if opening < 0.0 or (opening == 0.0 and bend > 0.0):
                    return t, True
                gap = 0.0
            t += max(min(step_to_contact(gap, opening, bend), jump - time), np.spacing(time))
            time = began + t
        if t > within or t == INFINITY:
            return INFINITY, False
    return t, False


@inlined
def before_border(moving_wall, i, store, box, features):
    """Predict the impact of disc i, whose stored state is current, on a wall before it leaves its cell."""
    if moving_wall is not None:
        disc, radius = store.disc[i], radius_of(i, box, features)
        for edge in range(4):
            if moving_wall.wall[edge].moves != 0:
                wall, inward = moving_wall.wall[edge], 1.0 - 2.0 * (edge & 1)
                within, rest = disc.crossing_time - disc.last_update, (radius, features.gravity)
                t, met = time_to_wall(wall, moving_wall.knots, edge >> 1, inward, disc, *rest, within, store)
                t += disc.last_update
                if t <= disc.crossing_time:
                    disc.crossing_time = t
                    store.event[i].side = MOVING_WALL + edge if met else LOOK


@inlined
def surface(moving_wall, i, side, now, store, box, features):
    """The wall that disc i, whose stored state is current, has hit; see `hooks.surface`."""
    if moving_wall is None:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, -1
    edge = side - MOVING_WALL
    wall, axis, inward = moving_wall.wall[edge], edge >> 1, 1.0 - 2.0 * (edge & 1)
    present = since_it_began(wall, now, store)
    speed = inward * velocity_of_wall(wall, moving_wall.knots, present)
    ahead = inward * (store.disc[i].position[axis] - place_of_wall(wall, moving_wall.knots, present))
    depth = radius_of(i, box, features) - ahead
    along = (inward if axis == 0 else -inward) * wall.running
    return True, (inward if axis == 0 else 0.0), (inward if axis == 1 else 0.0), depth, speed, along, edge
