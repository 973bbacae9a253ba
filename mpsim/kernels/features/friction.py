"""Friction: contacts change the spin of discs, by the law of Walton and Braun (J. Rheol. 30, 949, 1986).

At a contact the surfaces of two discs slip past each other at the speed s. The tangential impulse turns that speed
round times beta_0, the tangential restitution (a contact that sticks), but is at most mu times the normal impulse (one
that slides). Uniform discs have the moment of inertia m a^2 / 2, so an impulse J changes s by 3 J / m_eff, and

    |J| = min((1 + beta_0) m_eff |s| / 3, mu J_n)      spin: each disc by -2 J / (m a)

with m_eff = m m' / (m + m') of two discs, m of a disc and a wall. Angular momentum about the point of contact is kept.
"""

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.acceleration import acceleration_of
from mpsim.kernels.features.images import confined, count_flight, wrapped
from mpsim.kernels.features.masses import mass_fraction
from mpsim.kernels.layout import BOTTOM, IMPACT, LEFT, RIGHT, TOP
from mpsim.kernels.optional import value_or
from mpsim.kernels.records import real

FIELDS = {"friction": "friction", "wall_friction": "wall_friction", "spin": "spin"}
"""friction, wall_friction: shape (SIZE,), of two discs, and of a disc with walls and capsules; elements as follows.
spin: shape (capacity,), by id, counter-clockwise [1/time]."""

COEFFICIENT = 0  # mu [1]
STICKING = 1  # what a contact that sticks changes the tangential velocity by, over the slip [1]
SIZE = 2


@inlined
def tangential_change(law, slip, pressed):
    """Change of the tangential velocity by a contact that slips and has changed the normal velocity by `pressed`."""
    most = law[COEFFICIENT] * pressed
    return min(max(law[STICKING] * slip, -most), most)


@inlined
def between_discs(friction, discs, i, j, nx, ny, exchanged, features, parameters):
    """Friction of two discs in contact along the unit vector n from i to j.

    exchanged: normal velocity that they exchange, to be multiplied by their `mass_fraction`, < 0 if they approach.
    """
    if friction is not None:  # noqa: SIM102 - a test of its own, which the compiler drops
        if exchanged < 0:
            one, two = real(parameters, 1), real(parameters, 2)
            vx, vy, spin, disc, other = discs.vx, discs.vy, features.spin, discs.id[i], discs.id[j]
            radius_i = value_or(discs.radius, i, parameters.diameter / two)
            radius_j = value_or(discs.radius, j, parameters.diameter / two)
            slip = (vy[j] - vy[i]) * nx - (vx[j] - vx[i]) * ny - (radius_i * spin[disc] + radius_j * spin[other])
            change = tangential_change(friction, slip, -exchanged)
            change_i = change * mass_fraction(features.mass, disc, other, one)
            change_j = change * mass_fraction(features.mass, other, disc, one)
            vx[i] -= change_i * ny
            vy[i] += change_i * nx
            vx[j] += change_j * ny
            vy[j] -= change_j * nx
            spin[disc] += two * change_i / radius_i
            spin[other] += two * change_j / radius_j


@inlined
def on_fixed(friction, discs, i, nx, ny, pressed, time, features, parameters):
    """Friction of a disc on what stands still, along the unit vector n from there to the disc.

    pressed: what the contact has changed its velocity along n by. time: since the contact; the disc is moved as far as
    the change of its velocity leads it from there on [time].
    """
    if friction is not None:  # noqa: SIM102 - a test of its own, which the compiler drops
        if pressed > 0:
            zero, two, disc = real(parameters, 0), real(parameters, 2), discs.id[i]
            time = min(time, parameters.dt)
            radius = value_or(discs.radius, i, parameters.diameter / two)
            vx = discs.vx[i] - acceleration_of(features.gravity, features.acceleration, 0, disc, zero) * time
            vy = discs.vy[i] - acceleration_of(features.gravity, features.acceleration, 1, disc, zero) * time
            change = tangential_change(friction, vy * nx - vx * ny - radius * features.spin[disc], pressed)
            discs.vx[i] += change * ny
            discs.vy[i] -= change * nx
            discs.x[i] += change * ny * time
            discs.y[i] -= change * nx * time
            features.spin[disc] += two * change / radius


@compiled
def on_walls(friction, discs, i, change_x, change_y, time_x, time_y, wraps, features, parameters):
    """`between_disc_and_walls` for one that has met a wall."""
    zero, one = real(parameters, 0), real(parameters, 1)
    side_x = one if change_x > zero else -one
    side_y = one if change_y > zero else -one
    on_fixed(friction, discs, i, side_x, zero, abs(change_x), time_x, features, parameters)
    on_fixed(friction, discs, i, zero, side_y, abs(change_y), time_y, features, parameters)
    margin = value_or(discs.radius, i, zero)
    x = confined(discs.x[i], parameters.limit[LEFT], parameters.limit[RIGHT], margin, features.wrap_x)
    y = confined(discs.y[i], parameters.limit[BOTTOM], parameters.limit[TOP], margin, features.wrap_y)
    discs.x[i], discs.y[i] = x, y
    if wraps is not None:
        x, y = wrapped(x, features.wrap_x), wrapped(y, features.wrap_y)
        count_flight(discs, i, x, y, zero, zero, features)
        discs.x[i], discs.y[i] = x, y


@inlined
def between_disc_and_walls(
    wall_friction, discs, i, change_x, change_y, time_x, time_y, wraps, features, parameters, control
):
    """Friction of a disc on the walls that have changed its velocity by (change_x, change_y).

    time_x, time_y: since then [time]; contact `push` lets the law act where the frame has ended. wraps: None while
    contacts are resolved, when coordinates along periodic axes are left alone.
    """
    if wall_friction is not None:  # noqa: SIM102 - a test of its own, which the compiler drops
        if (change_x != 0) | (change_y != 0):
            zero = real(parameters, 0)
            if control.contact != IMPACT:
                time_x, time_y = zero, zero
            on_walls(wall_friction, discs, i, change_x, change_y, time_x, time_y, wraps, features, parameters)
