"""The features of the exact solver, which of them a scene has, and at which points of an event they act.

A new one is a file, its fields in `Features`, and a line at each point where it acts. A function that acts there takes
its own field first, so that it compiles to nothing if the field is None. What is asked of one feature alone is read
from its file.
"""

from collections import namedtuple
from collections.abc import Mapping
from typing import Any

from mpsim.kernels.compiling import copy_entry, copy_row, inlined, swap_entries, swap_rows
from mpsim.kernels.events.features import bodies, capsules, collisions, edges, laws, properties
from mpsim.kernels.events.features.properties import radius_of
from mpsim.kernels.events.records import mixed, mixed_real

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
    e = laws.effective_restitution(features.wall_restitution, last_contact, now, features.contact_time, store)
    leaving = laws.speed_off_wall(features.gravity, e * abs(speed), axis, inward, features.contact_time, store)
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


@inlined
def is_crushed(i, side, store, features):
    """Whether disc i, which has just hit `side` of its event, is crushed there: no solver can follow it."""
    if bodies.is_one(features.bodies, side):
        return bodies.is_crushed(features.crushing_speed, store.disc[i])
    if edges.is_moving_wall(features.moving_wall, side):
        return edges.is_crushed(features.moving_wall, features.crushing_speed, side, store.disc[i])
    return False


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
    collisions.between_discs(features.log, i, j, rx, ry, normal_impulse, across, store, box, features)


@inlined
def on_wall(i, axis, inward, normal_change, sliding, store, box, features):
    """After disc i has hit a wall at right angles to an axis, which has changed its velocity inward by so much.

    sliding: change along the wall so far.
    """
    sliding += laws.on_wall(features.wall_friction, i, axis, inward, normal_change, store, box, features)
    collisions.on_wall(features.log, i, axis, inward, normal_change, sliding, store, box, features)


@inlined
def on_surface(i, nx, ny, normal_change, speed, running, store, box, features):
    """After disc i has hit a surface that has changed its velocity by so much along n, the unit vector from there.

    speed, running: of the surface along n, and along (-ny, nx).
    """
    sliding = laws.on_surface(features.wall_friction, i, nx, ny, normal_change, running, store, box, features)
    others = features.moving_wall, features.capsules, features.bodies
    collisions.add_work(features.work, i, normal_change * speed + sliding * running, *others, store, features)
    collisions.on_surface(features.log, i, nx, ny, normal_change, sliding, *others, store, box, features)
