"""Contacts of discs with capsules: fixed segments with a radius. A fixed disc is a capsule of length 0.

A capsule is treated like a wall: right after the motion, for each disc alone, so the order of discs cannot matter and
every worker can process its own slice. A separate grid tells which capsules are near a place.

Capsules that share an end, or have one on another, form one surface, which a disc meets where its distance from the
chain has a local minimum: across a segment, or at a corner that is ahead along none of the segments there. Other ends
lie behind the surface, and an impulse from one would stop discs that slide past.

A capsule of length 0 with a radius below 0 is a container: a circle that is solid outside. The sum of its radius and
that of a disc is then below 0, too: minus the distance from its centre at which they touch.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from mpsim.kernels.compiling import inlined, linked, value_or
from mpsim.kernels.features.collisions import on_capsule
from mpsim.kernels.features.edges import is_absent, put_inside, wrap_disc
from mpsim.kernels.features.properties import accelerations_of
from mpsim.kernels.geometry import AX, AY, BX, BY, OWNER, RADIUS, SURFACE, bounce_back, concerns
from mpsim.kernels.records import IMPACT


class Capsules(NamedTuple):
    """Capsules, and which of them are near a place.

    capsule: shape (K, ROW). The last ones, which are in no cell, are halves of segments on which ends of others lie.
    next_end: for ends 2 k (a) and 2 k + 1 (b), the next end at the same corner, in a circle, shape (2 K,).
    near: for each cell of a grid of its own, column-major, where its section of `index` begins, shape (cells + 1,).
    index: numbers of capsules. grid: columns and rows, shape (2,).
    per_length: columns per length along x and rows per length along y, shape (2,) [1/length].
    around: numbers of containers, which are in no cell, shape (M,); None: there is none.
    shift: of the exact solver, whose grid is of squares of 2^shift of its cells. It uses neither next_end nor
    per_length, and lists containers too.
    """

    capsule: Any
    next_end: Any
    near: Any
    index: Any
    grid: Any
    per_length: Any
    around: Any
    shift: Any


@inlined
def nearest_offset(x, y, capsule, k):
    """From the nearest point of segment k to (x, y): the vector, and which end that point is, or -1 between both."""
    along_x, along_y = capsule[k, BX] - capsule[k, AX], capsule[k, BY] - capsule[k, AY]
    rx, ry = x - capsule[k, AX], y - capsule[k, AY]
    squared = along_x * along_x + along_y * along_y
    fraction = rx * along_x + ry * along_y
    if fraction <= 0 or squared == 0:
        return rx, ry, 2 * k
    if fraction >= squared:
        return x - capsule[k, BX], y - capsule[k, BY], 2 * k + 1
    fraction /= squared
    return rx - fraction * along_x, ry - fraction * along_y, -1


@inlined
def along_from(end, capsule):
    """Vector from an end of a segment to the other one."""
    k = end >> 1
    along_x, along_y = capsule[k, BX] - capsule[k, AX], capsule[k, BY] - capsule[k, AY]
    if end & 1:
        return -along_x, -along_y
    return along_x, along_y


@inlined
def is_behind_surface(rx, ry, end, capsules, radius):
    """Whether a disc, r from the end of a segment that is nearest to it, is nearer to another segment of the corner."""
    other = capsules.next_end[end]
    while other != end:
        along_x, along_y = along_from(other, capsules.capsule)
        if rx * along_x + ry * along_y > 0 and concerns(capsules.capsule, other >> 1, radius):
            return True
        other = capsules.next_end[other]
    return False


@inlined
def across(along_x, along_y, left):
    """Unit vector at right angles to a segment, to its left or right; (0, 1) if it has no length."""
    length = math.sqrt(along_x * along_x + along_y * along_y)
    if length == 0:
        return 0.0, 1.0
    if left:
        return -along_y / length, along_x / length
    return along_y / length, -along_x / length


@inlined
def normal_of(rx, ry, distance, capsule, k):
    """Unit vector from the nearest point of segment k to a disc `distance` away; on the segment itself, across it."""
    if distance > 0:
        return rx / distance, ry / distance
    along_x, along_y = along_from(2 * k, capsule)
    return across(np.float64(along_x), np.float64(along_y), True)


@inlined
def normal_at_touch(rx, ry, squared, reach, vx, vy, dt):
    """Unit vector from an end of a segment to where a disc that approaches it, and now overlaps, has touched it.

    Found like the contact of two discs, along a straight line: -c / (sqrt(b^2 - v^2 c) - b). If that was before this
    step, the disc had been pushed in, and the direction is that in which it comes out.
    """
    b, c = rx * vx + ry * vy, squared - reach * reach
    time = -c / (math.sqrt(b * b - (vx * vx + vy * vy) * c) - b)
    if time > dt:
        time -= time
    nx, ny = rx - vx * time, ry - vy * time
    length = math.sqrt(nx * nx + ny * ny)
    return nx / length, ny / length


@inlined
def normal_at_corner(nx, ny, end, capsules, radius):
    """The normal at touch, or that of the side over which the disc then was, which it must have touched before."""
    other = end
    while True:
        along_x, along_y = along_from(other, capsules.capsule)
        if nx * along_x + ny * along_y > 0 and concerns(capsules.capsule, other >> 1, radius):
            nx, ny = across(np.float64(along_x), np.float64(along_y), along_x * ny - along_y * nx >= 0)
        other = capsules.next_end[other]
        if other == end:
            return nx, ny


@inlined
def surface_speed(capsule, k, nx, ny):
    """Speed of the surface of capsule k along (-ny, nx), where its outer normal is n.

    SURFACE is from a to b on both sides of a segment, counter-clockwise around a disc, and clockwise in a container.
    """
    if (capsule[k, BY] - capsule[k, AY]) * nx < (capsule[k, BX] - capsule[k, AX]) * ny:
        return -capsule[k, SURFACE]
    return capsule[k, SURFACE]


@inlined
def resolve_capsule(discs, i, k, capsules, radius, ax, ay, features, parameters, impact):
    """Contact of the disc in slot i with capsule k, if they overlap: by impact, or pushed out to its surface.

    Impact treats the side of a segment, and the tangent plane at an end, as a wall: `bounce_back` keeps the energy of
    accelerated discs, and lets a disc rest.
    """
    if not concerns(capsules.capsule, k, radius):
        return False
    offset_x, offset_y, end = nearest_offset(discs.x[i], discs.y[i], capsules.capsule, k)
    reach = radius + capsules.capsule[k, RADIUS]
    if not offset_x * offset_x + offset_y * offset_y < reach * reach:
        return False
    if end >= 0 and is_behind_surface(offset_x, offset_y, end, capsules, radius):
        return False
    # In float64 whatever the run's precision, as between two discs: see `laws.impact_contact`.
    rx, ry, vx, vy = np.float64(offset_x), np.float64(offset_y), np.float64(discs.vx[i]), np.float64(discs.vy[i])
    squared = rx * rx + ry * ry
    distance = np.sqrt(squared)
    nx, ny = normal_of(rx, ry, distance, capsules.capsule, k)
    approaches = impact and rx * vx + ry * vy < 0
    if approaches:
        if end >= 0:
            nx, ny = normal_at_touch(rx, ry, squared, reach, vx, vy, parameters.dt)
            nx, ny = normal_at_corner(nx, ny, end, capsules, radius)
        distance = rx * nx + ry * ny
    leave_surface(discs, i, k, nx, ny, reach - distance, approaches, capsules, ax, ay, features, parameters)
    return True


MOST_BOUNCES = 8
"""Contacts with a container in one step: of discs that run along it there are several."""

TOGETHER = 256
"""Discs of which it is first asked whether any has left a container, which most have not."""


@inlined
def from_centre(discs, i, k, capsules):
    """From the centre of container k to the disc in slot i: the vector, and its square."""
    rx, ry = np.float64(discs.x[i] - capsules.capsule[k, AX]), np.float64(discs.y[i] - capsules.capsule[k, AY])
    return rx, ry, rx * rx + ry * ry


@linked
def resolve_containers(around, discs, low, high, features, parameters, control):
    """Contacts of a slice with containers, in the order in which the scene lists them."""
    if around is None:
        return
    capsules, half, impact = features.capsules, parameters.diameter / discs.x.dtype.type(2), control.contact == IMPACT
    for k in around:
        for begin in range(low, high, TOGETHER):
            end, outside = min(begin + TOGETHER, high), 0
            for i in range(begin, end):
                reach = value_or(discs.radius, i, half) + capsules.capsule[k, RADIUS]
                outside += from_centre(discs, i, k, capsules)[2] > reach * reach
            if outside == 0:
                continue
            for i in range(begin, end):
                if is_absent(features.exits, discs.id[i]):
                    continue
                radius = value_or(discs.radius, i, half)
                ax, ay = accelerations_of(discs, i, features)
                if resolve_container(discs, i, k, capsules, radius, ax, ay, features, parameters, impact):
                    put_inside(discs, i, discs.x[i], discs.y[i], features, parameters)
                    wrap_disc(discs, i, features)


@inlined
def resolve_container(discs, i, k, capsules, radius, ax, ay, features, parameters, impact):
    """Contact of the disc in slot i with container k, as `resolve_capsule`, until it is inside."""
    reach, dt, met = radius + capsules.capsule[k, RADIUS], parameters.dt, False
    for bounce in range(MOST_BOUNCES):
        rx, ry, squared = from_centre(discs, i, k, capsules)
        if not (squared > reach * reach and concerns(capsules.capsule, k, radius)):
            break
        vx, vy = np.float64(discs.vx[i]), np.float64(discs.vy[i])
        met, distance = True, -np.sqrt(squared)
        nx, ny, outward = rx / distance, ry / distance, rx * vx + ry * vy
        approaches = impact and outward > 0 and bounce < MOST_BOUNCES - 1
        if approaches:
            gap = squared - reach * reach
            crossing = outward * outward - (vx * vx + vy * vy) * gap  # below 0 if its line does not cross the circle
            time = gap / (outward + np.sqrt(max(crossing, 0.0)))
            if (crossing > 0.0) & (time <= dt):  # since it crossed the circle
                nx, ny = vx * time - rx, vy * time - ry
                length = math.sqrt(nx * nx + ny * ny)
                nx, ny = nx / length, ny / length
            distance = min(rx * nx + ry * ny, reach)  # not above it by rounding
        leave_surface(discs, i, k, nx, ny, reach - distance, approaches, capsules, ax, ay, features, parameters)
    return met


@inlined
def leave_surface(discs, i, k, nx, ny, depth, approaches, capsules, ax, ay, features, parameters):
    """New place and velocity of a disc `depth` in capsule k, along n from there: by `bounce_back` if it approaches."""
    vx, vy = np.float64(discs.vx[i]), np.float64(discs.vy[i])
    if approaches:
        speed = -(vx * nx + vy * ny)
        displacement, inward, time = bounce_back(depth, max(speed, 0.0), -(ax * nx + ay * ny), parameters)
        displacement, change = displacement + depth, max(inward + speed, 0.0)
    else:
        along = vx * nx + vy * ny
        back = 1.0 + np.float64(parameters.wall_restitution)
        displacement, change = depth, -back * along if along < 0 else 0.0
        time = 0.0
    discs.vx[i] += change * nx
    discs.vy[i] += change * ny
    discs.x[i] += displacement * nx
    discs.y[i] += displacement * ny
    surface = surface_speed(capsules.capsule, k, nx, ny)
    on_capsule(discs, i, int(capsules.capsule[k, OWNER]), nx, ny, change, time, 0.0, surface, features, parameters)


@inlined
def cell_at(capsules, x, y):
    """The cell of a place, whose list names the capsules near it."""
    columns, rows = capsules.grid[0], capsules.grid[1]
    column = min(max(int(x * capsules.per_length[0]), 0), columns - 1)
    return column * rows + min(max(int(y * capsules.per_length[1]), 0), rows - 1)


@linked
def resolve_capsules(discs, low, high, features, parameters, control):
    """Contacts of a slice with the capsules near each disc, in the order in which the scene lists them."""
    half = parameters.diameter / discs.x.dtype.type(2)
    impact = control.contact == IMPACT
    capsules = features.capsules
    for i in range(low, high):
        disc = discs.id[i]
        if is_absent(features.exits, disc):
            continue
        cell = cell_at(capsules, discs.x[i], discs.y[i])
        radius = value_or(discs.radius, i, half)
        ax, ay = accelerations_of(discs, i, features)
        met = False
        for entry in range(capsules.near[cell], capsules.near[cell + 1]):
            k = capsules.index[entry]
            met |= resolve_capsule(discs, i, k, capsules, radius, ax, ay, features, parameters, impact)
        if met:
            put_inside(discs, i, discs.x[i], discs.y[i], features, parameters)
            wrap_disc(discs, i, features)  # out of a thick capsule it may be far beyond the border, where no cells are


@inlined
def after_move(capsules, discs, low, high, features, parameters, control):
    """Contacts of a slice with capsules, then with containers."""
    if capsules is not None:
        if capsules.near[capsules.near.size - 1] > 0:
            resolve_capsules(discs, low, high, features, parameters, control)
        resolve_containers(capsules.around, discs, low, high, features, parameters, control)


# --- Discs that are about to be pressed through what is at rest, by something that moves


PAST, HALF_PAST = 0.875, 0.5
"""Depth, in radii, from which on the side on which a centre lies is uncertain, as at 1 it lies on the surface; and that
of a disc at rest, of which two surfaces of a corner may undo each one's half."""

ROUNDING = 1e-3
"""Depth, in radii, up to which a disc has been put on the surface."""


@inlined
def goes_past(depth, nx, ny, vx, vy, radius, push, dt):
    """Whether the centre of a disc `depth` in a surface may be at it after one more step of dt.

    v: relative to the surface; in that step a wall may turn the disc round, and push it so far.
    """
    later = depth + abs(vx * nx + vy * ny) * dt + push
    return (depth > ROUNDING * radius) & ((later > PAST * radius) | (depth > HALF_PAST * radius))


@linked
def goes_past_capsules(capsules, discs, i, radius, push, dt):
    """`goes_past`, of the disc in slot i and any capsule or container; capsules: None if nothing is at rest."""
    if capsules is None:
        return False
    vx, vy, cell = np.float64(discs.vx[i]), np.float64(discs.vy[i]), cell_at(capsules, discs.x[i], discs.y[i])
    past = False
    for entry in range(capsules.near[cell], capsules.near[cell + 1]):
        k = capsules.index[entry]
        offset_x, offset_y, end = nearest_offset(discs.x[i], discs.y[i], capsules.capsule, k)
        hidden = end >= 0 and is_behind_surface(offset_x, offset_y, end, capsules, radius)
        if concerns(capsules.capsule, k, radius) and not hidden:
            rx, ry = np.float64(offset_x), np.float64(offset_y)
            distance = np.sqrt(rx * rx + ry * ry)
            nx, ny = normal_of(rx, ry, distance, capsules.capsule, k)
            past |= goes_past(radius + capsules.capsule[k, RADIUS] - distance, nx, ny, vx, vy, radius, push, dt)
    return past | goes_past_containers(capsules.around, discs, i, capsules, radius, push, dt)


@inlined
def goes_past_containers(around, discs, i, capsules, radius, push, dt):
    """`goes_past`, of the disc in slot i and any container; around: None if there is none."""
    past = False
    if around is not None:
        for k in around:
            rx, ry, squared = from_centre(discs, i, k, capsules)
            distance = max(np.sqrt(squared), 1e-300)
            depth = radius + capsules.capsule[k, RADIUS] + distance
            vx, vy = np.float64(discs.vx[i]), np.float64(discs.vy[i])
            if concerns(capsules.capsule, k, radius):
                past |= goes_past(depth, -rx / distance, -ry / distance, vx, vy, radius, push, dt)
    return past
