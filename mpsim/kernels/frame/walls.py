"""Walls of the box: where they are, what they do to discs, and discs that an impact has moved beyond them."""

import numpy as np

from mpsim.kernels.compiling import any_present, inlined, linked, value_or
from mpsim.kernels.features.acceleration import accelerations_of
from mpsim.kernels.features.boundary import Walls, is_between, no_contact, reach_boundary
from mpsim.kernels.features.contact_hooks import leave_walls, on_walls
from mpsim.kernels.features.hooks import is_absent, lets_out, wall_place, wall_speed
from mpsim.kernels.records import ALONG_X, ALONG_Y, BOTTOM, LEFT, RIGHT, TOP, real


@inlined
def walls_of_step(edges, margin, features, parameters):
    """The walls at these edges at the end of a step, as a flight meets them."""
    limit = parameters.limit
    low, high = limit[edges[0]] + margin, limit[edges[1]] - margin
    return Walls(low, high, wall_speed(edges[0], features, parameters), wall_speed(edges[1], features, parameters))


@inlined
def walls_at_contacts(edges, margin, features, parameters):
    """The same while contacts are resolved, when the limits are already those of the next step."""
    low, high = wall_place(edges[0], features, parameters) + margin, wall_place(edges[1], features, parameters) - margin
    return Walls(low, high, wall_speed(edges[0], features, parameters), wall_speed(edges[1], features, parameters))


@inlined
def count_impulses(x, y, disc, features, parameters, control, tally, frame):
    """Add the impulses on the walls that a disc has hit along x and along y."""
    if control.tallied and not is_absent(disc, features):
        scale = np.float64(parameters.tally_scale) * value_or(features.mass, disc, real(parameters, 1))
        changes = (LEFT, x.low_change), (RIGHT, x.high_change), (BOTTOM, y.low_change), (TOP, y.high_change)
        for edge, change in changes:
            if change != 0:
                tally[frame].wall[edge] += np.int64(change * scale)


@inlined
def commit_wall_contact(discs, i, x, y, in_flight, features, parameters, control, tally, frame):
    """Write back disc i after its motion along x and along y, tally its impulses on walls, and apply features there.

    x, y: of `WallContact`. in_flight: None while contacts are resolved.
    """
    discs.x[i], discs.y[i], discs.vx[i], discs.vy[i] = x.position, y.position, x.velocity, y.velocity
    x, y = leave_walls(discs, i, x, y, in_flight, features, parameters, control)
    count_impulses(x, y, discs.id[i], features, parameters, control, tally, frame)
    on_walls(discs, i, x, y, in_flight, features, parameters, control)


@inlined
def bounce_along(p, v, acceleration, edges, margin, wrap, features, parameters, control):
    """The `WallContact`, along the axis with these edges, of a disc that an impact has moved to p.

    At an absorbing edge, the disc is put on the edge and continues: the next step absorbs it.
    """
    zero, walls = real(parameters, 0), walls_at_contacts(edges, margin, features, parameters)
    if (p < walls.low) & lets_out(edges[0], features, control):
        return no_contact(walls.low, v, zero)
    if (p > walls.high) & lets_out(edges[1], features, control):
        return no_contact(walls.high, v, zero)
    accelerated = any_present(features.gravity, features.acceleration)
    return reach_boundary(p, v, acceleration, accelerated, walls, wrap, parameters)


@linked
def bounce(discs, i, features, parameters, control, tally, frame):
    """Bounce disc i off the walls beyond which an impact has moved it, and count the impulse on them."""
    margin = value_or(discs.radius, i, real(parameters, 0))
    ax, ay = accelerations_of(discs, i, features)
    x = bounce_along(discs.x[i], discs.vx[i], ax, ALONG_X, margin, features.wrap_x, features, parameters, control)
    y = bounce_along(discs.y[i], discs.vy[i], ay, ALONG_Y, margin, features.wrap_y, features, parameters, control)
    commit_wall_contact(discs, i, x, y, None, features, parameters, control, tally, frame)


@inlined
def keep_inside(discs, i, features, parameters, control, tally, frame):
    """`bounce`, if an impact has moved disc i beyond a wall: rare, so the bounce is not inlined."""
    margin = value_or(discs.radius, i, real(parameters, 0))
    walls_x = walls_at_contacts(ALONG_X, margin, features, parameters)
    walls_y = walls_at_contacts(ALONG_Y, margin, features, parameters)
    free_x = is_between(discs.x[i], walls_x, features.wrap_x)
    free_y = is_between(discs.y[i], walls_y, features.wrap_y)
    if not (free_x & free_y):
        bounce(discs, i, features, parameters, control, tally, frame)
