"""Obstacles: segments with a radius that never move, met where a disc's centre comes within the sum of both radii.

That is, two straight sides and a circle around each end; of a container, a circle from inside. Impacts on them are
predicted only up to the border of the disc's cell, whose list names those near it; the next cell has its own list.
`side` of such an event is FIRST_CAPSULE + its row.
"""

import math

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.events.features.properties import component, radius_of
from mpsim.kernels.events.flight import INFINITY, approach_of, time_to_circle, time_to_come_down, time_to_impact
from mpsim.kernels.events.records import FIRST_CAPSULE
from mpsim.kernels.features.capsules import nearest_offset, surface_speed
from mpsim.kernels.geometry import AX, AY, BX, BY, RADIUS, concerns

# --- when a disc meets one ----------------------------------------------------------------------------------------


@inlined
def time_to_side(upward, along, length, reach, gravity):
    """Time until a centre reaches a straight side of a segment, from either side of it [time].

    upward, along: its place, speed and acceleration at right angles to the segment and along it, from its beginning.
    """
    height, climb, pull = upward
    place, speed, drift = along
    if height < 0.0:
        height, climb, pull = -height, -climb, -pull
    gap = height - reach
    if 0.0 <= place <= length:
        gap = max(gap, 0.0)  # only rounding can have put it deeper
    t = time_to_come_down(gap, climb, pull)
    if t < INFINITY and not 0.0 <= place + t * (speed + 0.5 * t * drift) <= length:
        t = INFINITY
    if gravity is not None:  # it may return on the other side, past an end
        beyond = time_to_come_down(-height - reach, -climb, -pull)
        if beyond < t and 0.0 <= place + beyond * (speed + 0.5 * beyond * drift) <= length:
            t = beyond
    return t


@inlined
def time_to_end(rx, ry, vx, vy, contact, ax, ay, within, gravity):
    """Time until a centre, r from an end, reaches the part of the circle around it that is not ahead along a."""
    if gravity is not None:
        return time_to_circle(rx, ry, vx, vy, gravity[0], gravity[1], contact, ax, ay, within)
    t = time_to_impact(rx, ry, vx, vy, contact)
    if t <= within:
        slack = 1e-9 * contact * math.sqrt(ax * ax + ay * ay)
        if (rx + vx * t) * ax + (ry + vy * t) * ay <= slack:
            return t
    return INFINITY


@inlined
def is_container(around, capsule, k):
    """Whether capsule k is a circle around the discs."""
    if around is None:
        return False
    return capsule[k, RADIUS] < 0.0


@inlined
def time_to_container(rx, ry, vx, vy, contact, within, gravity):
    """Time until a centre, r from that of a container, comes to a distance -contact from it from inside."""
    if gravity is not None:
        return time_to_circle(rx, ry, vx, vy, gravity[0], gravity[1], contact, 0.0, 0.0, within)
    b, gap, discriminant = approach_of(rx, ry, vx, vy, contact)
    root, square = math.sqrt(max(discriminant, 0.0)), vx * vx + vy * vy
    if b > 0.0:
        return max(-gap, 0.0) / (root + b)
    return (root - b) / square if square > 0.0 else INFINITY


@linked
def time_to_capsule(x, y, vx, vy, reach, travel, within, k, capsules, gravity):
    """Time until a centre that moves at most `travel` comes within `reach` of segment k; infinity after `within`."""
    ends = capsules.capsule
    rx, ry = x - ends[k, AX], y - ends[k, AY]
    along_x, along_y = ends[k, BX] - ends[k, AX], ends[k, BY] - ends[k, AY]
    length = math.sqrt(along_x * along_x + along_y * along_y)
    far = reach + travel
    best = INFINITY
    if is_container(capsules.around, capsules.capsule, k):
        best = time_to_container(rx, ry, vx, vy, reach, within, gravity)
        return best if best <= within else INFINITY
    if length > 0.0:
        ux, uy = along_x / length, along_y / length
        height = ry * ux - rx * uy
        if abs(height) > far:
            return INFINITY
        gx, gy = component(gravity, 0), component(gravity, 1)
        upward = height, vy * ux - vx * uy, gy * ux - gx * uy
        along = rx * ux + ry * uy, vx * ux + vy * uy, gx * ux + gy * uy
        best = time_to_side(upward, along, length, reach, gravity)
        qx, qy = x - ends[k, BX], y - ends[k, BY]
        if qx * qx + qy * qy <= far * far:
            best = min(best, time_to_end(qx, qy, vx, vy, reach, -along_x, -along_y, within, gravity))
    if rx * rx + ry * ry <= far * far:
        best = min(best, time_to_end(rx, ry, vx, vy, reach, along_x, along_y, within, gravity))
    return best if best <= within else INFINITY


@inlined
def before_border(capsules, i, store, box, features):
    """Predict the impact of disc i, whose stored state is current, on an obstacle before it leaves its cell."""
    if capsules is not None:
        disc = store.disc[i]
        within = disc.crossing_time - disc.last_update
        if within < INFINITY:  # else it does not move
            x, y, vx, vy = disc.position[0], disc.position[1], disc.velocity[0], disc.velocity[1]
            pull = abs(component(features.gravity, 0)) + abs(component(features.gravity, 1))
            travel = (abs(vx) + abs(vy) + 0.5 * pull * within) * within
            radius = radius_of(i, box, features)
            cell = store.event[i].cell
            square = (cell[0] >> capsules.shift) * capsules.grid[1] + (cell[1] >> capsules.shift)
            for entry in range(capsules.near[square], capsules.near[square + 1]):
                k = capsules.index[entry]
                if not concerns(capsules.capsule, k, radius):
                    continue
                reach = radius + capsules.capsule[k, RADIUS]
                t = time_to_capsule(x, y, vx, vy, reach, travel, within, k, capsules, features.gravity)
                if disc.last_update + t < disc.crossing_time or (t <= within and store.event[i].side < FIRST_CAPSULE):
                    disc.crossing_time = disc.last_update + t
                    store.event[i].side = FIRST_CAPSULE + k


# --- where it has met it -----------------------------------------------------------------------------------------


@inlined
def surface(capsules, i, side, store, box, features):
    """The obstacle that disc i, whose stored state is current, has met; see `hooks.surface`."""
    if capsules is None:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, -1
    if side < FIRST_CAPSULE:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, -1
    disc = store.disc[i]
    k = side - FIRST_CAPSULE
    rx, ry, _ = nearest_offset(disc.position[0], disc.position[1], capsules.capsule, k)
    distance = math.sqrt(rx * rx + ry * ry)
    if is_container(capsules.around, capsules.capsule, k):
        distance = -distance
    depth = radius_of(i, box, features) + capsules.capsule[k, RADIUS] - distance
    nx, ny = rx / distance, ry / distance
    return True, nx, ny, depth, 0.0, surface_speed(capsules.capsule, k, nx, ny), -1
