"""The points of a contact at which features act, after the change of normal velocities.

Separate from `hooks.py`, which imports the capsules: their contacts are such points too.
"""

from mpsim.kernels.compiling import inlined
from mpsim.kernels.features import baths, collisions, friction


@inlined
def between_discs(discs, i, j, nx, ny, normal_change, features, parameters):
    """Contact of two discs along the unit vector n from i to j.

    normal_change: of the velocities along n, to be multiplied by each disc's `mass_fraction`; < 0 if they approach.
    Returns the impulse on i along (-ny, nx) [mass length/time].
    """
    return friction.between_discs(features.friction, discs, i, j, nx, ny, normal_change, features, parameters)


@inlined
def leave_walls(discs, i, x, y, in_flight, features, parameters, control):
    """Features that change the velocity of a disc that has hit walls. Returns its contacts along x and y then.

    Arguments as of `on_walls`. The disc is already where they say.
    """
    return baths.on_walls(features.thermal_walls, discs, i, x, y, in_flight, features, parameters, control)


@inlined
def on_walls(discs, i, x, y, in_flight, features, parameters, control):
    """Contact of a disc with the walls of the box that it has reached.

    x, y: its contacts along each axis, of `WallContact`. in_flight: None while contacts are resolved, when coordinates
    along periodic axes are left unchanged.
    """
    sliding = friction.on_walls(features.wall_friction, discs, i, x, y, in_flight, features, parameters, control)
    collisions.on_walls(features.log, discs, i, x, y, sliding, features, parameters, control)


@inlined
def on_capsule(discs, i, owner, nx, ny, normal_change, time, pushing, surface, features, parameters):
    """Contact of a disc with a capsule, along the unit vector n from there to the disc.

    owner: number of the obstacle. normal_change: of its velocity along n. time: since the contact [time].
    pushing, surface: speed of the capsule's surface along n, and along (-ny, nx) [length/time].
    """
    sliding = friction.on_surface(
        features.wall_friction, discs, i, nx, ny, normal_change, time, surface, features, parameters
    )
    power = normal_change * pushing - sliding * surface
    collisions.add_work(features.work, collisions.WALLS + owner, discs.id[i], power, features.mass)
    collisions.on_capsule(features.log, discs, i, owner, nx, ny, normal_change, sliding, time, features, parameters)


@inlined
def note_contact(discs, i, j, touched, impulse, nx, ny, across, features):
    """Contact of two discs that has been resolved, with such an impulse along the unit vector n from i to j.

    touched: how long before the end of the step [time], and where (x, y) [length]; None if there is no log. across:
    impulse on i along (-ny, nx).
    """
    collisions.between_discs(features.log, discs, i, j, touched, impulse, nx, ny, across)
