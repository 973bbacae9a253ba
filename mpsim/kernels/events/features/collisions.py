"""What each impact records: the log of collisions, if a run asks for it, and the work of surfaces that move."""

import math

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.features.bodies import owner_of
from mpsim.kernels.events.features.edges import is_moving_wall
from mpsim.kernels.events.features.properties import mass_of, radius_of
from mpsim.kernels.events.records import MOVING_WALL, counts
from mpsim.kernels.features.collisions import DISC, OBSTACLE, WALL, WALLS, write
from mpsim.kernels.features.collisions import add_work as add


@inlined
def between_discs(log, i, j, rx, ry, impulse, across, store, box, features):
    """Impact of discs i and j, r = r_i - r_j apart, whose stored states are current.

    impulse, across: on i, along r and along r rotated to the left.
    """
    if log is not None:  # noqa: SIM102 - see compiling.py
        if counts(store.region) != 0:
            disc, distance = store.disc[i], math.sqrt(rx * rx + ry * ry)
            share = radius_of(i, box, features) / (radius_of(i, box, features) + radius_of(j, box, features))
            x, y = disc.position[0] - share * rx, disc.position[1] - share * ry
            time = store.clock.origin + disc.last_update
            along, slide, other = impulse / distance, across / distance, store.event[j].number
            write(log, DISC, store.event[i].number, other, time, along * rx, along * ry, -slide * ry, slide * rx, x, y)


@inlined
def on_fixed(log, kind, i, met, nx, ny, change, sliding, store, box, features):
    """Impact of disc i on a wall or an obstacle that changed its velocity by so much along the unit vector n.

    sliding: its change along (-ny, nx).
    """
    if log is not None:  # noqa: SIM102
        if counts(store.region) != 0:
            disc, radius = store.disc[i], radius_of(i, box, features)
            impulse, across = mass_of(i, features) * change, mass_of(i, features) * sliding
            x, y = disc.position[0] - radius * nx, disc.position[1] - radius * ny
            time = store.clock.origin + disc.last_update
            number = store.event[i].number
            write(log, kind, number, met, time, impulse * nx, impulse * ny, -across * ny, across * nx, x, y)


@inlined
def on_wall(log, i, axis, inward, change, sliding, store, box, features):
    """Impact of disc i on a wall at rest; sliding: change of its velocity along the wall."""
    edge = 2 * axis + (inward < 0.0)
    nx, ny = (inward if axis == 0 else 0.0), (inward if axis == 1 else 0.0)
    sliding *= inward if axis == 0 else -inward
    on_fixed(log, WALL, i, edge, nx, ny, change, sliding, store, box, features)


@inlined
def on_surface(log, i, nx, ny, change, sliding, moving_wall, capsules, bodies, store, box, features):
    """Impact of disc i on a capsule, at rest or moving, or a moving wall, according to `side` of its event."""
    side = store.event[i].side
    if is_moving_wall(moving_wall, side):
        on_fixed(log, WALL, i, side - MOVING_WALL, nx, ny, change, sliding, store, box, features)
    else:
        on_fixed(log, OBSTACLE, i, owner_of(capsules, bodies, side), nx, ny, change, sliding, store, box, features)


@inlined
def add_work(work, i, power, moving_wall, capsules, bodies, store, features):
    """Impact of disc i as in `on_surface`; power: change of its velocity times the velocity of the surface."""
    if work is not None:  # noqa: SIM102 - see compiling.py
        if counts(store.region) != 0:
            side = store.event[i].side
            wall = is_moving_wall(moving_wall, side)
            owner = side - MOVING_WALL if wall else WALLS + owner_of(capsules, bodies, side)
            add(work, owner, i, power, features.mass)
