"""The boundaries of an axis: walls reflect discs, periodic borders let them through, absorbing edges keep them."""

from typing import Any, NamedTuple

import numpy as np

from mpsim.kernels.compiling import compiled, inlined, linked, value_or
from mpsim.kernels.features.properties import accelerations_of
from mpsim.kernels.geometry import bounce_back
from mpsim.kernels.records import ALONG_X, ALONG_Y, BOTTOM, IMPACT, LEFT, RIGHT, TOP, real

# --- Edges that absorb discs. An absorbed disc keeps its number, stays at rest where it left, and meets no disc


@inlined
def is_absent(exits, disc):
    """Whether a disc has left, by its id."""
    if exits is None:
        return False
    return exits[0, disc] != 0


@inlined
def lets_out(exits, control, edge):
    """Whether an edge (LEFT, ...) absorbs discs."""
    if exits is None:
        return False
    return control.absorbing[edge] != 0


@linked
def absorb(exits, discs, low, high, features, parameters, control):
    """Absorb the discs of a slice that this step would bring to an absorbing edge; they stand still in it."""
    if exits is None:
        return
    edges, dt = control.absorbing, parameters.dt
    zero, two = discs.x.dtype.type(0), discs.x.dtype.type(2)
    # Under impact a flight follows its parabola, whose mean velocity is v + a dt / 2; under push it is v + a dt.
    late = dt / two if control.contact == IMPACT else zero
    for i in range(low, high):
        disc = discs.id[i]
        margin = value_or(discs.radius, i, zero)
        ax, ay = accelerations_of(discs, i, features)
        x = discs.x[i] + (discs.vx[i] + ax * (dt - late)) * dt
        y = discs.y[i] + (discs.vy[i] + ay * (dt - late)) * dt
        left = edges[LEFT] != 0 and x < parameters.limit[LEFT] + margin
        right = edges[RIGHT] != 0 and x > parameters.limit[RIGHT] - margin
        bottom = edges[BOTTOM] != 0 and y < parameters.limit[BOTTOM] + margin
        top = edges[TOP] != 0 and y > parameters.limit[TOP] - margin
        if (left or right or bottom or top) and exits[0, disc] == 0:
            exits[0, disc], exits[1, disc], exits[2, disc] = 1, discs.x[i], discs.y[i]


@linked
def put_back_absorbed(exits, discs, low, high, spin):
    """Undo what a step has done to the absorbed discs of a slice: they stay at rest where they left."""
    if exits is None:
        return
    zero = discs.x.dtype.type(0)
    for i in range(low, high):
        disc = discs.id[i]
        if exits[0, disc] != 0:
            discs.x[i], discs.y[i] = exits[1, disc], exits[2, disc]
            discs.vx[i], discs.vy[i] = zero, zero
            if spin is not None:
                spin[disc] = zero


@inlined
def after_binning(exits, discs, low, high, control):
    """Bin the absorbed discs of a slice in a cell beyond the grid, where no neighbours are looked for."""
    if exits is not None:
        cell = (control.columns + 1) * (control.rows + 2) + 1
        for i in range(low, high):
            if exits[0, discs.id[i]] != 0:
                discs.cell[i] = cell


# --- What the boundary of an axis does to discs: walls reflect them, a periodic border lets them through
#
# An axis is periodic if it has a length in `wrap`; otherwise it ends at walls. The kernels pass `wrap` on to this
# file, and ask at most whether there is one; giants also ask for the distance of images. An image is the
# disc shifted by one length along an axis, in position only. `engine/feature_arrays.py` writes the lengths. A disc's
# count of periods changes where its coordinate is wrapped, and only the worker that moves it changes it, so that
# displacements can be unwrapped.


MOST_PERIODS = 2.0**53
"""Periods of one flight that are counted at most: below, they are whole numbers in float64."""


# --- walls --------------------------------------------------------------------------------------------------------


class Walls(NamedTuple):
    """The walls of an axis: least and largest coordinate of a centre, speeds, and accelerations."""

    low: Any
    high: Any
    low_speed: Any
    high_speed: Any
    low_acceleration: Any
    high_acceleration: Any


class WallContact(NamedTuple):
    """The result of a motion along an axis.

    position [length], velocity [length/time]: now. low_change, high_change: changes of the velocity by the low and the
    high wall, inwards. time: since then; 0 if no wall has reflected the disc [time]. sliding: change of the velocity
    along that wall, by the wall.
    """

    position: Any
    velocity: Any
    low_change: Any
    high_change: Any
    time: Any
    sliding: Any


@inlined
def no_contact(p, v, zero):
    """The `WallContact` of a disc that has touched no wall."""
    return WallContact(p, v, zero, zero, zero, zero)


@inlined
def reach_wall(p, v, walls, parameters):
    """The wall rule for a straight motion that has led to p: position, velocity and time of a `WallContact`."""
    low, high, low_speed, high_speed, _, _ = walls
    bounce, restitution = parameters.wall_bounce, parameters.wall_restitution
    time = low - low
    if p < low:
        if v < low_speed:
            time = (low - p) / (low_speed - v)
            v = low_speed - (v - low_speed) * restitution
        p = min(low + bounce * (low - p), high)
    elif p > high:
        if v > high_speed:
            time = (p - high) / (v - high_speed)
            v = high_speed - (v - high_speed) * restitution
        p = max(high + bounce * (high - p), low)
    return p, v, time


@inlined
def reach_wall_on_parabola(p, v, acceleration, walls, parameters):
    """`reach_wall` for an accelerated motion, of the disc or of the wall: in the frame of the wall."""
    low, high, low_speed, high_speed, low_acceleration, high_acceleration = walls
    if p < low:
        inside, inward, time = bounce_back(low - p, low_speed - v, -(acceleration - low_acceleration), parameters)
        return min(low + inside, high), low_speed + inward, time
    if p > high:
        inside, inward, time = bounce_back(p - high, v - high_speed, acceleration - high_acceleration, parameters)
        return max(high - inside, low), high_speed - inward, time
    return p, v, low - low


@inlined
def reach_boundary(p, v, acceleration, accelerated, walls, wrap, parameters):
    """The `WallContact` of a disc that its motion has led to p, with v; `accelerated` is None for straight motion.

    Along a periodic axis, the disc is left unchanged until the next step begins.
    """
    zero = real(parameters, 0)
    if wrap is not None:
        return no_contact(p, v, zero)
    if accelerated is None:
        if (walls.low_acceleration if p < walls.low else walls.high_acceleration) == zero:
            place, turned, time = reach_wall(p, v, walls, parameters)
        else:
            place, turned, time = reach_wall_on_parabola(p, v, acceleration, walls, parameters)
    else:
        place, turned, time = reach_wall_on_parabola(p, v, acceleration, walls, parameters)
    low_change = turned - v if p < walls.low else zero
    high_change = v - turned if p > walls.high else zero
    return WallContact(place, turned, low_change, high_change, time, zero)


@inlined
def is_between(p, walls, wrap):
    """Whether p is not beyond a wall. True if p is not a number."""
    if wrap is not None:
        return True
    return not ((p < walls.low) | (p > walls.high))


@inlined
def confined(p, edges, margin, wrap, parameters):
    """A coordinate limited to the range between the walls of the axis with these edges, if it has any."""
    if wrap is not None:
        return p
    return min(max(p, parameters.limit[edges[0]] + margin), parameters.limit[edges[1]] - margin)


@inlined
def put_inside(discs, i, x, y, features, parameters):
    """Put disc i at (x, y), or at the wall if that is beyond one."""
    margin = value_or(discs.radius, i, discs.x.dtype.type(0))
    discs.x[i] = confined(x, ALONG_X, margin, features.wrap_x, parameters)
    discs.y[i] = confined(y, ALONG_Y, margin, features.wrap_y, parameters)


# --- periodic borders ---------------------------------------------------------------------------------------------


@inlined
def wrapped(coordinate, wrap):
    """A coordinate brought into [0, length) along a periodic axis. Doing it twice changes nothing."""
    if wrap is None:
        return coordinate
    coordinate -= wrap[0] * np.floor(coordinate / wrap[0])
    # Just below 0, the sum rounds to the length itself, and a flight of many lengths leaves rounding of either sign.
    if (coordinate < 0) | (coordinate >= wrap[0]):
        return wrap[0] - wrap[0]
    return coordinate


@inlined
def count_periods(image, axis, disc, taken, wrap):
    """Count the periods that wrapping has taken off a coordinate: `taken` is that length [length].

    So coordinate + image * length has no jump, even if `wrapped` puts a disc just below 0 at 0. A flight that is not
    finite, or so long that the place in the box has no digit left, is not counted.
    """
    if wrap is not None:  # noqa: SIM102 - see compiling.py
        if taken != 0:
            periods = np.rint(taken / wrap[0])
            if abs(periods) < MOST_PERIODS:
                image[axis, disc] += np.int64(periods)


@inlined
def count_flight(discs, i, x, y, flight_x, flight_y, features):
    """Count the periods of the disc in slot i, which a flight from its stored place has brought to (x, y)."""
    disc = discs.id[i]
    if not is_absent(features.exits, disc):  # it will be put back
        count_periods(features.image, 0, disc, discs.x[i] + flight_x - x, features.wrap_x)
        count_periods(features.image, 1, disc, discs.y[i] + flight_y - y, features.wrap_y)


@inlined
def wrap_disc(discs, i, features):
    """Bring disc i back into the box along periodic axes."""
    x, y, zero = wrapped(discs.x[i], features.wrap_x), wrapped(discs.y[i], features.wrap_y), discs.x.dtype.type(0)
    count_flight(discs, i, x, y, zero, zero, features)
    discs.x[i], discs.y[i] = x, y


@compiled
def wrap_places(places, image, axis, wrap):
    """`wrapped` for each of many coordinates along an axis, in place; image, shape (2, N), is counted on."""
    for i in range(places.shape[0]):
        before = places[i]
        places[i] = wrapped(before, wrap)
        count_periods(image, axis, i, before - places[i], wrap)


# --- discs seen through a border ----------------------------------------------------------------------------------


@inlined
def images(wrap):
    """By how much a disc is shifted when seen through the high and the low border of a periodic axis [length]."""
    return wrap[0], -wrap[0]


@inlined
def period_of(wrap, zero):
    """Distance of one image from the next [length]; zero if there are none."""
    if wrap is None:
        return zero
    return wrap[0]


@inlined
def seen_from(coordinate, image):
    """A coordinate as seen by discs beyond a border, shifted by one of the `images`; None: not through a border."""
    if image is None:
        return coordinate
    return coordinate - image


@inlined
def is_near_border(coordinate, wrap, parameters):
    """Whether the image of a disc, outside the box along a periodic axis, is near enough to touch discs inside."""
    return (coordinate > -parameters.diameter) & (coordinate < wrap[0] + parameters.diameter)
