"""Contacts of discs with capsules: fixed segments with a radius. A fixed disc is a capsule of length 0.

A capsule is treated like a wall: right after the motion, for each disc alone, so the order of discs cannot matter and
every worker can process its own slice. A separate grid tells which capsules are near a place.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from mpsim.kernels.bouncing import bounce_back
from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.features.absorption import is_absent
from mpsim.kernels.features.acceleration import accelerations_of
from mpsim.kernels.features.boundary import put_inside, wrap_disc
from mpsim.kernels.features.contact_hooks import on_capsule
from mpsim.kernels.layout import IMPACT
from mpsim.kernels.optional import value_or


class Capsules(NamedTuple):
    """Capsules, and which of them are near a place.

    capsule: shape (K, 5): ax, ay, bx, by, radius [length].
    near: for each cell of a grid of its own, column-major, where its section of `index` begins, shape (cells + 1,).
    index: numbers of capsules. grid: columns and rows, shape (2,).
    per_length: columns per length along x and rows per length along y, shape (2,) [1/length].
    """

    capsule: Any
    near: Any
    index: Any
    grid: Any
    per_length: Any


FIELDS = {"capsules": Capsules}


@inlined
def nearest_offset(x, y, capsule, k):
    """From the nearest point of segment k to (x, y): the vector, and whether that point lies between the ends."""
    along_x, along_y = capsule[k, 2] - capsule[k, 0], capsule[k, 3] - capsule[k, 1]
    rx, ry = x - capsule[k, 0], y - capsule[k, 1]
    squared = along_x * along_x + along_y * along_y
    fraction = rx * along_x + ry * along_y
    if fraction <= 0 or squared == 0:
        return rx, ry, False
    if fraction >= squared:
        return x - capsule[k, 2], y - capsule[k, 3], False
    fraction /= squared
    return rx - fraction * along_x, ry - fraction * along_y, True


@inlined
def normal_of(rx, ry, distance, flat, capsule, k):
    """Unit vector from the nearest point of segment k to a disc `distance` away; on the segment itself, across it."""
    if distance > 0:
        return rx / distance, ry / distance
    if not flat:
        return 0.0, 1.0
    along_x, along_y = np.float64(capsule[k, 2] - capsule[k, 0]), np.float64(capsule[k, 3] - capsule[k, 1])
    length = math.sqrt(along_x * along_x + along_y * along_y)
    return -along_y / length, along_x / length


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
def resolve_capsule(discs, i, k, capsule, radius, ax, ay, features, parameters, impact):
    """Contact of the disc in slot i with capsule k, if they overlap: by impact, or pushed out to its surface.

    Impact treats the side of a segment, and the tangent plane at an end, as a wall: `bounce_back` keeps the energy of
    accelerated discs, and lets a disc rest.
    """
    offset_x, offset_y, flat = nearest_offset(discs.x[i], discs.y[i], capsule, k)
    reach = radius + capsule[k, 4]
    if not offset_x * offset_x + offset_y * offset_y < reach * reach:
        return False
    # In float64 whatever the run's precision, as between two discs: see `laws.impact_contact`.
    rx, ry, vx, vy = np.float64(offset_x), np.float64(offset_y), np.float64(discs.vx[i]), np.float64(discs.vy[i])
    squared = rx * rx + ry * ry
    distance = np.sqrt(squared)
    nx, ny = normal_of(rx, ry, distance, flat, capsule, k)
    if impact and rx * vx + ry * vy < 0:
        if not flat:
            nx, ny = normal_at_touch(rx, ry, squared, reach, vx, vy, parameters.dt)
        depth, speed = reach - (rx * nx + ry * ny), -(vx * nx + vy * ny)
        displacement, inward, time = bounce_back(depth, max(speed, 0.0), -(ax * nx + ay * ny), parameters)
        displacement, change = displacement + depth, inward + speed
    else:
        along = vx * nx + vy * ny
        back = 1.0 + np.float64(parameters.wall_restitution)
        displacement, change = reach - distance, -back * along if along < 0 else 0.0
        time = 0.0
    discs.vx[i] += change * nx
    discs.vy[i] += change * ny
    discs.x[i] += displacement * nx
    discs.y[i] += displacement * ny
    on_capsule(discs, i, k, nx, ny, change, time, features, parameters)
    return True


@linked
def resolve_capsules(discs, low, high, features, parameters, control):
    """Contacts of a slice with the capsules near each disc, in the order in which the scene lists them."""
    half = parameters.diameter / discs.x.dtype.type(2)
    impact = control.contact == IMPACT
    capsules = features.capsules
    columns, rows = capsules.grid[0], capsules.grid[1]
    for i in range(low, high):
        disc = discs.id[i]
        if is_absent(features.exits, disc):
            continue
        column = min(max(int(discs.x[i] * capsules.per_length[0]), 0), columns - 1)
        row = min(max(int(discs.y[i] * capsules.per_length[1]), 0), rows - 1)
        cell = column * rows + row
        radius = value_or(discs.radius, i, half)
        ax, ay = accelerations_of(discs, i, features)
        met = False
        for entry in range(capsules.near[cell], capsules.near[cell + 1]):
            k = capsules.index[entry]
            met |= resolve_capsule(discs, i, k, capsules.capsule, radius, ax, ay, features, parameters, impact)
        if met:
            put_inside(discs, i, discs.x[i], discs.y[i], features, parameters)
            wrap_disc(discs, i, features)  # out of a thick capsule it may be far beyond the border, where no cells are


@inlined
def after_move(capsules, discs, low, high, features, parameters, control):
    """`resolve_capsules`, if there are capsules."""
    if capsules is not None:
        resolve_capsules(discs, low, high, features, parameters, control)
