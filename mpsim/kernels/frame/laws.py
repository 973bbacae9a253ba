"""What a contact does to two discs: when it acts (contact `push` or `impact`), and by which law.

shift_x, shift_y: as in contacts.py.
"""

import math

import numpy as np

from mpsim.kernels.compiling import any_present, inlined, linked, value_or
from mpsim.kernels.features.collisions import log_discs, touching_point
from mpsim.kernels.features.edges import put_inside, seen_from
from mpsim.kernels.features.friction import between_discs
from mpsim.kernels.features.properties import accelerations_of, mass_fraction, touching_distance
from mpsim.kernels.frame.motion import keep_inside
from mpsim.kernels.records import DEPTH_SCALE, ELASTIC, IMPACT, STEPS_OF_OVERLAP


@inlined
def separation(discs, i, j, shift_x, shift_y):
    """Vector from disc i to disc j."""
    return discs.x[j] - seen_from(discs.x[i], shift_x), discs.y[j] - seen_from(discs.y[i], shift_y)


@linked
def parting(disc, other):
    """Direction (cos, sin) in which two discs at one point part, by their ids: no axis of the box, and seldom the same.

    From u, in [0, 1), the fractional part of a sum of irrational multiples: by the rational parametrisation of the
    circle with t = 2 u - 1, of which half is enough.
    """
    low, high = np.float64(min(disc, other)), np.float64(max(disc, other))
    u = 0.6180339887498949 * low + 0.7548776662466927 * high
    t = 2.0 * (u - np.floor(u)) - 1.0
    sign = 1.0 if disc < other else -1.0
    return sign * (1.0 - t * t) / (1.0 + t * t), sign * 2.0 * t / (1.0 + t * t)


@inlined
def normalised(discs, i, j, x, y, one):
    """Unit vector along (x, y) from disc i to disc j, and its length. At one point they have a direction by ids."""
    length = math.sqrt(x * x + y * y)
    if length == 0:
        nx, ny = parting(discs.id[i], discs.id[j])
        return one * discs.x.dtype.type(nx), one * discs.x.dtype.type(ny), length
    return x / length, y / length, length


@inlined
def elastic(discs, i, j, nx, ny, along_i, along_j, features, parameters):
    """Discs that approach separate with e times their normal velocity; momentum is kept (e = 1: energy too).

    With friction their tangential velocities and spins change here. Returns the changes of normal velocities, and the
    tangential impulse on i along (-ny, nx).
    """
    one, approach = discs.vx.dtype.type(1), along_j - along_i
    normal_change = approach * parameters.half_one_plus_e if approach < 0 else discs.vx.dtype.type(0)
    change_i = normal_change * mass_fraction(features.mass, discs.id[i], discs.id[j], one)
    change_j = -(normal_change * mass_fraction(features.mass, discs.id[j], discs.id[i], one))
    across = between_discs(features.friction, discs, i, j, nx, ny, normal_change, features, parameters)
    return change_i, change_j, across


@inlined
def apply_law(discs, i, j, nx, ny, features, parameters, law):
    """Change the velocities of two discs in contact along the unit vector n from i to j, by a law of `records.LAWS`.

    Returns the impulse [mass length/time] (for `reflect`, which has two of them, their mean), the unit vector, and the
    tangential impulse on i along (-ny, nx).
    """
    vx, vy = discs.vx, discs.vy
    one, two = vx.dtype.type(1), vx.dtype.type(2)
    along_i = vx[i] * nx + vy[i] * ny
    along_j = vx[j] * nx + vy[j] * ny
    if law == ELASTIC:
        change_i, change_j, across = elastic(discs, i, j, nx, ny, along_i, along_j, features, parameters)
    else:  # the report's law: each velocity is mirrored about the contact line, whether the discs approach or not
        change_i, change_j, across = -two * along_i, -two * along_j, one - one
    vx[i] += change_i * nx
    vy[i] += change_i * ny
    vx[j] += change_j * nx
    vy[j] += change_j * ny
    impulse_i = abs(change_i) * value_or(features.mass, discs.id[i], one)
    return (impulse_i + abs(change_j) * value_or(features.mass, discs.id[j], one)) / two, nx, ny, across


@inlined
def push_contact(discs, i, j, shift_x, shift_y, features, parameters, law):
    """Contact `push`: the discs move apart until they touch, then the law acts along the normal found here.

    Each moves by half the overlap; of unequal discs, the lighter moves more. Returns what `apply_law` does.
    """
    one = discs.x.dtype.type(1)
    x, y = separation(discs, i, j, shift_x, shift_y)
    nx, ny, distance = normalised(discs, i, j, x, y, one)
    half = (touching_distance(discs.radius, i, j, parameters) - distance) / discs.x.dtype.type(2)
    displacement_i = half * mass_fraction(features.mass, discs.id[i], discs.id[j], one)
    displacement_j = half * mass_fraction(features.mass, discs.id[j], discs.id[i], one)
    x_i, y_i = discs.x[i] - nx * displacement_i, discs.y[i] - ny * displacement_i
    put_inside(discs, i, x_i, y_i, features, parameters)
    x_j, y_j = discs.x[j] + nx * displacement_j, discs.y[j] + ny * displacement_j
    put_inside(discs, j, x_j, y_j, features, parameters)
    return apply_law(discs, i, j, nx, ny, features, parameters, law)


@inlined
def conserve_energy(accelerated, discs, i, j, shift_x, shift_y, start_i, start_j, features, parameters):
    """Keep the energy of two accelerated discs that a contact has moved from `start`, pairs (x, y).

    Uniform gravity does no work on a contact that keeps the centre of mass; where a wall confines one of the discs it
    does (both are lifted), and with different accelerations there is always some. The work W changes their normal
    relative velocity w: w'^2 = w^2 + 2 W / mu, with the reduced mass mu. If that kinetic energy is too small, the
    displacement is scaled back; if collisions lose energy, and discs may lie in heaps, it is kept.
    accelerated: None if no acceleration does work.
    """
    if accelerated is None:
        return
    one, two = discs.x.dtype.type(1), discs.x.dtype.type(2)
    work = work_since(discs, i, *start_i, features) + work_since(discs, j, *start_j, features)
    share_i = mass_fraction(features.mass, discs.id[i], discs.id[j], one)
    share_j = mass_fraction(features.mass, discs.id[j], discs.id[i], one)
    gained = two * two * work / (share_i * value_or(features.mass, discs.id[i], one))
    x, y = separation(discs, i, j, shift_x, shift_y)
    nx, ny, _ = normalised(discs, i, j, x, y, one)
    along = (discs.vx[j] - discs.vx[i]) * nx + (discs.vy[j] - discs.vy[i]) * ny
    square = along * along
    if (square + gained < 0) & (parameters.half_one_plus_e == one):
        for disc, start in ((i, start_i), (j, start_j)):
            discs.x[disc] = start[0] - (discs.x[disc] - start[0]) * square / gained
            discs.y[disc] = start[1] - (discs.y[disc] - start[1]) * square / gained
    after = np.sqrt(max(square + gained, along - along))
    change = (after if along >= 0 else -after) - along
    change_i, change_j = -change * share_i / two, change * share_j / two
    discs.vx[i] += change_i * nx
    discs.vy[i] += change_i * ny
    discs.vx[j] += change_j * nx
    discs.vy[j] += change_j * ny


@inlined
def work_since(discs, i, x, y, features):
    """Work that its acceleration has done on disc i since it was at (x, y) [mass length^2/time^2]."""
    ax, ay = accelerations_of(discs, i, features)
    return ((discs.x[i] - x) * ax + (discs.y[i] - y) * ay) * value_or(features.mass, discs.id[i], discs.x.dtype.type(1))


@inlined
def time_since_impact(discs, i, j, shift_x, shift_y, parameters):
    """Time since two overlapping discs touched, in free flight; negative if they do not approach.

    |r - u t| = D with r, u the relative position and velocity, b = r.u < 0 and c = r.r - D^2 < 0:
    t = (b + sqrt(b^2 - u.u c)) / u.u, which loses its digits where the overlap is small; its conjugate does not:
    t = -c / (sqrt(b^2 - u.u c) - b). The relative motion of discs with the same acceleration is uniform: it holds too.
    """
    diameter = touching_distance(discs.radius, i, j, parameters)
    rx, ry = separation(discs, i, j, shift_x, shift_y)
    ux = discs.vx[j] - discs.vx[i]
    uy = discs.vy[j] - discs.vy[i]
    b = rx * ux + ry * uy
    if not b < 0:
        return -diameter  # any negative number means that there was no impact
    c = rx * rx + ry * ry - diameter * diameter
    return -c / (math.sqrt(b * b - (ux * ux + uy * uy) * c) - b)


@inlined
def impact_contact(discs, i, j, shift_x, shift_y, features, parameters, control, tally, frame):
    """Contact `impact`: back to the instant of contact, the law along the normal found there, and on again.

    Discs that do not approach, or that overlapped before this step, are pushed apart instead. Returns what
    `apply_law` does.
    """
    time = time_since_impact(discs, i, j, shift_x, shift_y, parameters)
    start_i, start_j = (discs.x[i], discs.y[i]), (discs.x[j], discs.y[j])
    if not (time >= 0) & (time <= parameters.dt):
        impulses = push_contact(discs, i, j, shift_x, shift_y, features, parameters, control.law)
        accelerated = any_present(features.gravity, features.acceleration)
        conserve_energy(accelerated, discs, i, j, shift_x, shift_y, start_i, start_j, features, parameters)
        return impulses
    for disc in (i, j):
        discs.x[disc] -= discs.vx[disc] * time
        discs.y[disc] -= discs.vy[disc] * time
    # In float64 whatever the run's precision. Discs that just touch are all equally far apart, and a float32 root or
    # quotient of that one number is rounded the same way each time: with diameter 1, by 1e-7 of energy per collision.
    x, y = separation(discs, i, j, shift_x, shift_y)
    nx, ny, _ = normalised(discs, i, j, np.float64(x), np.float64(y), 1.0)
    impulses = apply_law(discs, i, j, nx, ny, features, parameters, control.law)
    for disc in (i, j):
        discs.x[disc] += discs.vx[disc] * time
        discs.y[disc] += discs.vy[disc] * time
    conserve_energy(features.acceleration, discs, i, j, shift_x, shift_y, start_i, start_j, features, parameters)
    for disc in (i, j):
        keep_inside(discs, disc, features, parameters, control, tally, frame)
    return impulses


@inlined
def touched(log, discs, i, j, shift_x, shift_y, parameters, control):
    """How long ago, and where, two overlapping discs touched, for `log_discs`; None if there is no log."""
    if log is None:
        return None
    since = 0.0
    if control.contact == IMPACT:
        time = np.float64(time_since_impact(discs, i, j, shift_x, shift_y, parameters))
        since = time if (time >= 0.0) & (time <= parameters.dt) else 0.0
    x, y = touching_point(discs, i, j, shift_x, shift_y, since, parameters)
    return since, x, y


VERY_DEEP = 0.5
"""Overlap of discs that are pressed into each other, in radii of the smaller one, beyond what steps explain."""


@inlined
def note_deep(pressing, discs, i, j, shift_x, shift_y, parameters, control):
    """Note that two discs are deep in each other; pressing: None if nothing moves that may press them."""
    if pressing is None:
        return
    if control.deep == 0:
        x, y = separation(discs, i, j, shift_x, shift_y)
        fastest = max(discs.vx[i] ** 2 + discs.vy[i] ** 2, discs.vx[j] ** 2 + discs.vy[j] ** 2)
        half = parameters.diameter / 2
        smaller = min(value_or(discs.radius, i, half), value_or(discs.radius, j, half))
        overlap = touching_distance(discs.radius, i, j, parameters) - math.sqrt(x * x + y * y)
        if overlap > VERY_DEEP * smaller + STEPS_OF_OVERLAP * parameters.dt * math.sqrt(fastest):
            control.deep = 1


@inlined
def resolve_contact(discs, i, j, shift_x, shift_y, features, parameters, control, tally, frame):
    """Resolve two overlapping discs by the contact, one of `records.CONTACTS`, and the law of the run."""
    if control.tallied:
        tally_depth(discs, i, j, shift_x, shift_y, parameters, tally, frame)
    note_deep(any_present(features.bodies, features.moving_wall), discs, i, j, shift_x, shift_y, parameters, control)
    before = touched(features.log, discs, i, j, shift_x, shift_y, parameters, control)
    if control.contact == IMPACT:
        impulses = impact_contact(discs, i, j, shift_x, shift_y, features, parameters, control, tally, frame)
    else:
        impulses = push_contact(discs, i, j, shift_x, shift_y, features, parameters, control.law)
    impulse, nx, ny, across = impulses
    log_discs(features.log, discs, i, j, before, impulse, nx, ny, across)
    if control.tallied:
        relative = touching_distance(discs.radius, i, j, parameters) / parameters.diameter
        virial = impulse * relative * np.float64(parameters.tally_scale)
        tally[frame].virial += np.int64(virial)
        tally[frame].virial_xx += np.int64(virial * nx * nx)
        tally[frame].virial_xy += np.int64(virial * nx * ny)
        tally[frame].collisions += impulse > 0


@linked
def tally_depth(discs, i, j, shift_x, shift_y, parameters, tally, frame):
    """Count a contact and its overlap, as a fraction of the (largest) diameter."""
    x, y = separation(discs, i, j, shift_x, shift_y)
    distance = math.sqrt(x * x + y * y)
    overlap = touching_distance(discs.radius, i, j, parameters) - distance
    depth = np.int64(np.float64(overlap / parameters.diameter) * DEPTH_SCALE)
    tally[frame].met += 1
    tally[frame].depth += depth
    tally[frame].deepest = max(tally[frame].deepest, depth)
