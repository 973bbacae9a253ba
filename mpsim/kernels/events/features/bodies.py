"""Obstacles that move, in the exact solver: the first contact with one by steps that cannot pass it.

A disc and a body approach each other along a curve. In the frame of the body the disc's acceleration is at most A (that
of gravity and of the body, and of a rotation the Coriolis and centrifugal ones). The distance to a convex shape along a
straight line is convex, so that the gap f to a capsule obeys f(t) >= f + f' t - A t^2 / 2: no contact lies before the
root of the right side. Steps to such roots never pass a contact, and converge on it as Newton's do (conservative
advancement; Mirtich, PhD thesis, Berkeley 1996, with a bound of second order). In a container at distance d from the
centre, the curvature of the circle adds u^2 / d to A, for relative speeds up to u. A list names the capsules that are
nearer than `margin`; what it does not name bounds the step by the margin over the largest relative speed. A step never
passes an instant at which the body's velocity jumps. Only an approaching disc meets a capsule, so that rounding can
neither lose a contact nor repeat one.

After MOST_STEPS without a contact, as for a disc that rests, the disc is looked at again from there: `side` is LOOK.
"""

import math

import numpy as np

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.events.features.properties import component, radius_of
from mpsim.kernels.events.flight import INFINITY
from mpsim.kernels.events.records import FIRST_BODY, FIRST_CAPSULE, LOOK
from mpsim.kernels.features.bodies import (
    OSCILLATION,
    PATH,
    ROTATION,
    into_frame,
    out_of_frame,
    piece_of_path,
    pose_at,
    turned,
    velocity_at,
)
from mpsim.kernels.features.capsules import nearest_offset, normal_of, surface_speed
from mpsim.kernels.geometry import OWNER, RADIUS, concerns

MOST_STEPS = 64
"""Steps of one search: a contact takes some five, a near miss ten."""

TOUCH = 1e-13
"""Gap, in parts of the reach of a contact, below which disc and capsule touch: some roundings."""


@linked
def next_jump(body, knots, time):
    """The next instant after a time at which the velocity of a body jumps; infinity if there is none."""
    since = time - body.start
    if since < 0.0:
        return body.start
    if body.kind == OSCILLATION:
        return INFINITY
    if body.kind != PATH:
        return body.start + body.stop if since < body.stop else INFINITY
    row = piece_of_path(body, knots, since) + 1
    return body.start + knots[row, 0] if row < body.knots[1] else INFINITY


@inlined
def step_to_contact(gap, speed, bend):
    """The first time at which gap + speed t - bend t^2 / 2 falls to 0, for a gap >= 0; it is 0 only if it falls now."""
    root = math.sqrt(speed * speed + 2.0 * bend * gap)
    if speed < 0.0:
        return 2.0 * gap / (root - speed)
    return (speed + root) / bend if bend > 0.0 else INFINITY


@inlined
def step_in_container(gap, opening, bend, distance, speed):
    """The same for a disc so far from the centre of a container, whose relative speed is at most `speed`.

    Until half of the distance has been covered, the circle adds no more than 2 speed^2 / distance to the bend.
    """
    if speed == 0.0:
        return INFINITY
    if distance <= gap:
        return gap / speed
    step = step_to_contact(gap, opening, bend + 2.0 * speed * speed / distance)
    return max(gap / speed, min(step, 0.5 * distance / speed))


@inlined
def nearest_point(body, bodies, k, pose, frame_x, frame_y):
    """The point in the middle of capsule k that is nearest to a disc, whose place is in the frame of the body.

    Returns the distance (below 0 of the centre of a container), the unit vector (x, y) from there to the disc, or in a
    container to the centre, in that frame, and the point in the box.
    """
    rx, ry, _ = nearest_offset(frame_x, frame_y, bodies.capsule, k)
    distance = math.sqrt(rx * rx + ry * ry)
    nx, ny = normal_of(rx, ry, distance, bodies.capsule, k)
    if bodies.capsule[k, RADIUS] < 0.0:
        distance, nx, ny = -distance, -nx, -ny
    at_x, at_y = out_of_frame(body, pose, frame_x - rx, frame_y - ry)
    return distance, nx, ny, at_x, at_y


@linked
def time_to_body(body, bodies, x, y, vx, vy, gx, gy, radius, began, within, box):
    """The first contact of a disc and a body: (time from now, capsule), or (time up to which there is none, -1).

    x, y, vx, vy: of the disc at the time of the run `began`. within: the longest time that is asked for [time].
    """
    pull, rate = math.sqrt(gx * gx + gy * gy), 0.0
    if body.kind == ROTATION:
        rate = abs(body.rate) * (2.0 * math.pi)
    t = 0.0
    for _ in range(MOST_STEPS):
        time, ux, uy = began + t, vx + t * gx, vy + t * gy
        pose, most = pose_at(body, bodies.knots, time), min(within, next_jump(body, bodies.knots, time) - began) - t
        px, py = seen_by(body, pose, x + t * (vx + 0.5 * t * gx), y + t * (vy + 0.5 * t * gy), box)
        # Bounds for as long as no capsule beyond the margin can be met.
        own = math.sqrt(ux * ux + uy * uy)
        far = 0.0
        if rate > 0.0:
            far = math.sqrt((px - body.vector[0]) ** 2 + (py - body.vector[1]) ** 2) + body.margin
        speed = own + body.fastest + rate * far
        step = min(most, body.margin / (speed + math.sqrt(pull * body.margin)) if speed + pull > 0.0 else INFINITY)
        speed += pull * step if step < INFINITY else 0.0
        bend = pull + body.bend + rate * (2.0 * speed + rate * far)
        frame_x, frame_y = into_frame(body, pose, px, py)
        column = (frame_x - body.low[0]) * body.per_length[0]
        row = (frame_y - body.low[1]) * body.per_length[1]
        if (column >= 0.0) & (column < body.cells[0]) & (row >= 0.0) & (row < body.cells[1]):
            cell = body.first + int(column) * body.cells[1] + int(row)
            for entry in range(bodies.near[cell], bodies.near[cell + 1]):
                k = bodies.index[entry]
                if not concerns(bodies.capsule, k, radius):
                    continue
                distance, nx, ny, at_x, at_y = nearest_point(body, bodies, k, pose, frame_x, frame_y)
                wx, wy = velocity_at(body, bodies.knots, time, at_x, at_y)
                normal_x, normal_y = turned(pose, nx, ny)
                opening, reach = (ux - wx) * normal_x + (uy - wy) * normal_y, radius + bodies.capsule[k, RADIUS]
                gap = distance - reach
                if gap <= TOUCH * (reach + abs(px) + abs(py)):
                    if opening < 0.0 or (opening == 0.0 and bend > 0.0):
                        return t, k
                    gap = 0.0
                if reach < 0.0:
                    step = min(step, step_in_container(gap, opening, bend, -distance, speed))
                else:
                    step = min(step, step_to_contact(gap, opening, bend))
        if t + step >= within:
            return within, -1
        t += max(step, np.spacing(time))  # past a jump, too
    return t, -1


@inlined
def seen_by(body, pose, x, y, box):
    """Coordinates of a disc, or of that image of it which is nearest to a body."""
    middle_x, middle_y = out_of_frame(body, pose, body.middle[0], body.middle[1])
    periods_x, periods_y = np.floor((x - middle_x) / box.width + 0.5), np.floor((y - middle_y) / box.height + 0.5)
    return x - body.nearest[0] * box.width * periods_x, y - body.nearest[1] * box.height * periods_y


@inlined
def is_one(bodies, side):
    """Whether `side` of an event is a body."""
    if bodies is None:
        return False
    return side >= FIRST_BODY


@inlined
def owner_of(capsules, bodies, side):
    """Number of the obstacle, at rest or moving, that `side` of an event is."""
    if bodies is not None:  # noqa: SIM102
        if side >= FIRST_BODY:
            return np.int64(bodies.capsule[side - FIRST_BODY, OWNER])
    if capsules is not None:
        return np.int64(capsules.capsule[side - FIRST_CAPSULE, OWNER])
    return np.int64(-1)


@inlined
def is_look(moving, side):
    """Whether `side` of an event is LOOK; moving: None if nothing moves by itself."""
    if moving is None:
        return False
    return side == LOOK


@inlined
def before_border(bodies, i, store, box, features):
    """Predict the impact of disc i, whose stored state is current, on a body before it leaves its cell."""
    if bodies is not None:
        disc, radius = store.disc[i], radius_of(i, box, features)
        gx, gy = component(features.gravity, 0), component(features.gravity, 1)
        for number in range(bodies.body.size):
            body, within = bodies.body[number], disc.crossing_time - disc.last_update
            began = body.origin + store.clock.origin + disc.last_update
            x, y, vx, vy = disc.position[0], disc.position[1], disc.velocity[0], disc.velocity[1]
            t, k = time_to_body(body, bodies, x, y, vx, vy, gx, gy, radius, began, within, box)
            if k >= 0 or t < within:
                disc.crossing_time = disc.last_update + t
                store.event[i].side = FIRST_BODY + k if k >= 0 else LOOK


@inlined
def surface(bodies, i, side, now, store, box, features):
    """The capsule of a body that disc i, whose stored state is current, has met; see `hooks.surface`."""
    if bodies is None:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, -1
    k, disc = side - FIRST_BODY, store.disc[i]
    body = bodies.body[bodies.body_of[k]]
    time = body.origin + store.clock.origin + now
    pose = pose_at(body, bodies.knots, time)
    x, y = seen_by(body, pose, disc.position[0], disc.position[1], box)
    frame_x, frame_y = into_frame(body, pose, x, y)
    distance, nx, ny, at_x, at_y = nearest_point(body, bodies, k, pose, frame_x, frame_y)
    wx, wy = velocity_at(body, bodies.knots, time, at_x, at_y)
    running = surface_speed(bodies.capsule, k, nx, ny)
    nx, ny = turned(pose, nx, ny)
    thick = bodies.capsule[k, RADIUS]
    depth = radius_of(i, box, features) + thick - distance
    # The point of the body that is touched is `thick` away from the middle of the capsule.
    px, py = velocity_at(body, bodies.knots, time, at_x + thick * nx, at_y + thick * ny)
    return True, nx, ny, depth, wx * nx + wy * ny, py * nx - px * ny + running, -1
