"""The features of the exact solver, which of them a scene has, and at which points of an event they act.

A new one is a file, its fields in `Features`, and a line at each point where it acts. A function that acts there takes
its own field first, so that it compiles to nothing if the field is None. What is asked of one feature alone is read
from its file.
"""

import math
from collections import namedtuple
from collections.abc import Mapping
from typing import Any

from mpsim.kernels.compiling import copy_entry, copy_row, inlined, swap_entries, swap_rows
from mpsim.kernels.events.features import bodies, capsules, edges, laws, properties
from mpsim.kernels.events.features.properties import mass_of, radius_of
from mpsim.kernels.events.records import MOVING_WALL, counts, mixed, mixed_real
from mpsim.kernels.features.collisions import DISC, FIRST_OBSTACLE, OBSTACLE, WALL, add_work, write
from mpsim.kernels.features.friction import running_of

COLUMNS = ("radius", "mass", "spin", "image", "exits")
"""Fields of `Features` that are arrays with a row for each disc, in the order of the discs in memory."""

Features: Any = namedtuple(
    "Features",
    "image gravity radius mass friction wall_friction spin restitution wall_restitution contact_time absorbing exits "
    "moving_wall crushing_speed capsules bodies thermostat thermal_walls log work expansion",
)
"""What only some scenes need. None: the scene lacks it, and the compiler drops whatever is tested against it.

gravity: (gx, gy) [length/time^2]. friction, wall_friction: `ImpactFriction` > 0. restitution, wall_restitution: < 1.
absorbing: for each edge (LEFT, ...), whether it absorbs. thermal_walls: kT of each edge, 0 where it is not thermal
[mass length^2/time^2], and the seed. log: `Log`, whose numbers of discs are those of `event.number`. expansion: growth
of each radius, as a fraction of that at the start [1/time].
"""

BARE = Features(*[None] * len(Features._fields))
"""Of a scene without features."""


def features_of(given: Mapping[str, Any]) -> Any:
    """The `Features` of a scene, from its arrays and numbers by name; others are left out."""
    return Features(*map(given.get, Features._fields))


# --- what features answer together --------------------------------------------------------------------------------


@inlined
def speed_off_wall(i, speed, axis, inward, last_contact, now, store, box, features):
    """Speed inward of disc i, which has hit a wall at right angles to an axis at such a speed outward."""
    nx, ny = (inward if axis == 0 else 0.0), (inward if axis == 1 else 0.0)
    leaving = laws.speed_off(abs(speed), nx, ny, last_contact, now, features, store)
    return properties.speed_off_approaching(features.expansion, speed, leaving, radius_of(i, box, features))


@inlined
def swap_columns(features, i, j):
    """Exchange discs i and j in memory."""
    swap_entries(features.radius, i, j)
    swap_entries(features.mass, i, j)
    swap_entries(features.spin, i, j)
    swap_rows(features.image, i, j)
    swap_rows(features.exits, i, j)


@inlined
def with_columns(digest, spin, image, i):
    """A hash that includes all that events change in the columns of disc i."""
    if spin is not None:
        digest = mixed_real(digest, spin[i])
    if image is not None:
        digest = mixed(mixed(digest, image[i, 0]), image[i, 1])
    return digest


@inlined
def copy_columns(source, i, target, j):
    """Copy the columns of disc i in one memory to place j of another."""
    copy_entry(source.radius, i, target.radius, j)
    copy_entry(source.mass, i, target.mass, j)
    copy_entry(source.spin, i, target.spin, j)
    copy_row(source.image, i, target.image, j)
    copy_row(source.exits, i, target.exits, j)


@inlined
def surface(i, side, now, store, box, features):
    """The surface that disc i, whose stored state is current, has hit, if `side` of its event says so.

    Returns whether it has; the unit vector (x, y) from there to the disc; how far the disc must be moved along it to
    touch (a rounding); the speed of the surface along it, and along (-ny, nx); which edge of the box it is (LEFT, ...),
    or -1.
    """
    if edges.is_moving_wall(features.moving_wall, side):
        return edges.surface(features.moving_wall, i, side, now, store, box, features)
    if bodies.is_one(features.bodies, side):
        return bodies.surface(features.bodies, i, side, now, store, box, features)
    return capsules.surface(features.capsules, i, side, store, box, features)


# --- the points of an event at which they act ---------------------------------------------------------------------


@inlined
def before_border(i, store, box, features):
    """When it is known when disc i, whose stored state is current, leaves its cell: what it meets before that."""
    edges.before_border(features.moving_wall, i, store, box, features)
    capsules.before_border(features.capsules, i, store, box, features)
    bodies.before_border(features.bodies, i, store, box, features)


@inlined
def between_discs(i, j, rx, ry, normal_impulse, store, box, features):
    """After the normal impulse of discs i and j, r = r_i - r_j apart [mass length/time]."""
    across = laws.between_discs(features.friction, i, j, rx, ry, normal_impulse, store, box, features)
    log_discs(features.log, i, j, rx, ry, normal_impulse, across, store, box, features)


@inlined
def on_wall(i, axis, inward, normal_change, sliding, store, box, features):
    """After disc i has hit a wall at right angles to an axis, which has changed its velocity inward by so much.

    sliding: change along the wall so far.
    """
    edge, nx, ny = 2 * axis + (inward < 0.0), (inward if axis == 0 else 0.0), (inward if axis == 1 else 0.0)
    running = running_of(features.moving_wall, edge, 0.0)
    rubbed = laws.on_wall(features.wall_friction, i, axis, inward, normal_change, running, store, box, features)
    if features.moving_wall is not None:  # noqa: SIM102 - see compiling.py
        if running != 0.0 and counts(store.region) != 0:
            add_work(features.work, edge, i, rubbed * running, features.mass)
    sliding += rubbed
    sliding *= inward if axis == 0 else -inward
    log_fixed(features.log, WALL, i, edge, nx, ny, normal_change, sliding, store, box, features)


@inlined
def on_surface(i, nx, ny, normal_change, speed, running, store, box, features):
    """After disc i has hit a surface that has changed its velocity by so much along n, the unit vector from there.

    speed, running: of the surface along n, and along (-ny, nx).
    """
    sliding = laws.on_surface(features.wall_friction, i, nx, ny, normal_change, running, store, box, features)
    side = store.event[i].side
    if edges.is_moving_wall(features.moving_wall, side):
        kind, number, owner = WALL, side - MOVING_WALL, side - MOVING_WALL
    else:
        number = bodies.owner_of(features.capsules, features.bodies, side)
        kind, owner = OBSTACLE, FIRST_OBSTACLE + number
    if counts(store.region) != 0:
        add_work(features.work, owner, i, normal_change * speed + sliding * running, features.mass)
    log_fixed(features.log, kind, i, number, nx, ny, normal_change, sliding, store, box, features)


# --- the log of collisions, if a run asks for it ------------------------------------------------------------------


@inlined
def log_discs(log, i, j, rx, ry, impulse, across, store, box, features):
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
def log_fixed(log, kind, i, met, nx, ny, change, sliding, store, box, features):
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
