"""Friction: contacts change the spin of discs, by the law of Walton and Braun (J. Rheol. 30, 949, 1986).

At a contact, the surfaces of two discs slip past each other at the speed s. The tangential impulse reverses that speed,
times the tangential restitution beta_0 (a sticking contact), but is at most mu times the normal impulse (a sliding
one). Uniform discs have the moment of inertia m a^2 / 2, so an impulse J changes s by 3 J / m_eff, and

    |J| = min((1 + beta_0) m_eff |s| / 3, mu J_n)      spin: each disc by -2 J / (m a)

with m_eff = m m' / (m + m') of two discs, m of a disc and a wall. Angular momentum about the point of contact is kept.
"""

from mpsim.kernels.compiling import inlined, linked, value_or
from mpsim.kernels.features.edges import put_inside, wrap_disc
from mpsim.kernels.features.properties import accelerations_of, mass_fraction
from mpsim.kernels.records import BOTTOM, IMPACT, LEFT, RIGHT, TOP, real

# The elements of `friction` and `wall_friction`.
COEFFICIENT = 0  # mu [1]
STICKING = 1  # change of the tangential velocity by a sticking contact, over the slip [1]


@inlined
def tangential_change(law, slip, normal_change):
    """Change of the tangential velocity by a contact with this slip that has changed the normal velocity by so much."""
    most = law[COEFFICIENT] * normal_change
    return min(max(law[STICKING] * slip, -most), most)


@inlined
def between_discs(friction, discs, i, j, nx, ny, normal_change, features, parameters):
    """Friction of two discs in contact: see `laws.elastic`. Returns the impulse on i along (-ny, nx)."""
    if friction is not None:  # noqa: SIM102 - see compiling.py
        if normal_change < 0:
            one, two = real(parameters, 1), real(parameters, 2)
            vx, vy, spin, disc, other = discs.vx, discs.vy, features.spin, discs.id[i], discs.id[j]
            radius_i = value_or(discs.radius, i, parameters.diameter / two)
            radius_j = value_or(discs.radius, j, parameters.diameter / two)
            slip = (vy[j] - vy[i]) * nx - (vx[j] - vx[i]) * ny - (radius_i * spin[disc] + radius_j * spin[other])
            change = tangential_change(friction, slip, -normal_change)
            change_i = change * mass_fraction(features.mass, disc, other, one)
            change_j = change * mass_fraction(features.mass, other, disc, one)
            vx[i] -= change_i * ny
            vy[i] += change_i * nx
            vx[j] += change_j * ny
            vy[j] -= change_j * nx
            spin[disc] += two * change_i / radius_i
            spin[other] += two * change_j / radius_j
            return change_i * value_or(features.mass, disc, one)
    return discs.vx.dtype.type(0)


@inlined
def running_of(moving_wall, edge, zero):
    """Velocity at which the wall at an edge (LEFT, ...) runs past the discs, along y or along x [length/time]."""
    if moving_wall is None:
        return zero
    return moving_wall.wall[edge].running


@inlined
def on_surface(friction, discs, i, nx, ny, normal_change, time, surface, features, parameters):
    """Friction of a disc on a surface, along the unit vector n from there to the disc.

    normal_change: of its velocity along n. time: since the contact; the disc is moved by the change of its tangential
    velocity times this [time]. surface: speed of the surface along (-ny, nx) [length/time].
    Returns the change of the tangential velocity, along (ny, -nx).
    """
    if friction is not None:  # noqa: SIM102 - see compiling.py
        if normal_change > 0:
            two, disc = real(parameters, 2), discs.id[i]
            time = min(time, parameters.dt + (nx - nx))  # in the type of n, in plain Python too
            radius = value_or(discs.radius, i, parameters.diameter / two)
            ax, ay = accelerations_of(discs, i, features)
            vx, vy = discs.vx[i] - ax * time, discs.vy[i] - ay * time
            slip = vy * nx - vx * ny - radius * features.spin[disc] - surface
            change = tangential_change(friction, slip, normal_change)
            discs.vx[i] += change * ny
            discs.vy[i] -= change * nx
            discs.x[i] += change * ny * time
            discs.y[i] -= change * nx * time
            features.spin[disc] += two * change / radius
            return change
    return nx - nx


@linked
def on_walls_met(friction, discs, i, x, y, in_flight, features, parameters, control):
    """`on_walls` for a disc that has hit a wall: along each axis at most one, which has changed its velocity inward.

    Returns the changes of its velocity along the wall met along x, and along that met along y.
    """
    zero, one = real(parameters, 0), real(parameters, 1)
    side_x = one if x.low_change > zero else -one
    side_y = one if y.low_change > zero else -one
    time_x, time_y = x.time, y.time
    if control.contact != IMPACT:
        time_x, time_y = zero, zero
    met_x, met_y = max(x.low_change, x.high_change), max(y.low_change, y.high_change)
    along_x = side_x * running_of(features.moving_wall, LEFT if x.low_change > zero else RIGHT, zero)
    along_y = -side_y * running_of(features.moving_wall, BOTTOM if y.low_change > zero else TOP, zero)
    sliding_x = -side_x * on_surface(friction, discs, i, side_x, zero, met_x, time_x, along_x, features, parameters)
    sliding_y = side_y * on_surface(friction, discs, i, zero, side_y, met_y, time_y, along_y, features, parameters)
    put_inside(discs, i, discs.x[i], discs.y[i], features, parameters)
    if in_flight is not None:
        wrap_disc(discs, i, features)
    return sliding_x, sliding_y


@inlined
def on_walls(wall_friction, discs, i, x, y, in_flight, features, parameters, control):
    """Friction of a disc on the walls that have changed its velocity: arguments as in `collisions`.

    Under contact `push`, it acts at the position at the end of the frame. Returns what `on_walls_met` does.
    """
    if wall_friction is not None:  # noqa: SIM102 - see compiling.py
        if (x.low_change != x.high_change) | (y.low_change != y.high_change):
            return on_walls_met(wall_friction, discs, i, x, y, in_flight, features, parameters, control)
    zero = real(parameters, 0)
    return zero, zero
