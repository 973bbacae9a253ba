"""What moves by itself: obstacles (rigid bodies, kinematic ones in games) and walls, whose place follows from the time.

A body consists of capsules. A disc is looked up in the frame of the body, where the capsules are at rest, so that their
near lists never change. A contact goes back to the instant of the touch: the disc along its parabola, the body by its
own motion. There the relative velocity is reflected, along the normal of that instant, and the rest of the step is done
again. So contacts are of second order in the step, whatever the motion. All of it is in float64, and consists of
+ - * / and sqrt: the same bits on every machine.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from mpsim.kernels.compiling import inlined, linked, value_or
from mpsim.kernels.features.capsules import (
    goes_past,
    goes_past_capsules,
    is_behind_surface,
    nearest_offset,
    normal_at_corner,
    normal_of,
    surface_speed,
)
from mpsim.kernels.features.collisions import FIRST_OBSTACLE, add_work, on_capsule
from mpsim.kernels.features.edges import is_absent, put_inside, wrap_disc
from mpsim.kernels.features.properties import accelerations_of
from mpsim.kernels.geometry import OWNER, RADIUS, concerns
from mpsim.kernels.records import BOTTOM, IMPACT, PINCHED, PRESSED, Field, real, record_of

# --- Motions: displacement, angle and velocities at a time

TRANSLATION, OSCILLATION, ROTATION, PATH = range(4)

MOTION: list[Field] = [
    ("kind", np.int64),  # TRANSLATION, ...
    ("start", np.float64),  # time of the run at which it begins [time]
    ("stop", np.float64),  # how long it moves [time]; infinity of oscillations
    ("vector", np.float64, (2,)),  # velocity [length/time], amplitude [length], or centre of a rotation [length]
    ("rate", np.float64),  # turns per time of an oscillation or a rotation, counter-clockwise [1/time]
    ("phase", np.float64),  # of an oscillation [turns]
    ("knots", np.int64, (2,)),  # of a path: the first of its rows in `knots`, and one past the last
    ("fastest", np.float64),  # largest speed of its points, without that of a rotation [length/time]
    ("bend", np.float64),  # and acceleration [length/time^2]
    ("origin", np.float64),  # time from which steps are counted [time]
    ("dt", np.float64),  # of a frame [time]
]
"""Fields of a motion, of a body or a wall of the box."""

BODY = record_of(
    [
        *MOTION,
        ("nearest", np.int64, (2,)),  # by axis, 1: discs see its nearest image; 0: its capsules include all images
        ("low", np.float64, (2,)),  # lower left corner of the grid of its near lists [length]
        ("middle", np.float64, (2,)),  # of that grid [length]
        ("cells", np.int64, (2,)),  # columns and rows
        ("per_length", np.float64, (2,)),  # columns per length along x, and rows along y [1/length]
        ("first", np.int64),  # of its cells in `near`
        ("margin", np.float64),  # gap up to which the near lists name all capsules; 0 for stepped solvers [length]
        # At the end of the current step:
        ("now", np.float64),  # [time]
        ("displacement", np.float64, (2,)),  # [length]
        ("turned", np.float64, (2,)),  # cosine and sine of the angle
        ("place", np.float64, (2,)),  # of the middle [length]
    ]
)
"""A body. Numbers not named so are in the frame in which its obstacle was given."""

TERMS = 9
"""Pairs of terms of the series of sine and cosine: the next one is below 1e-19 for an eighth of a turn."""


class Pose(NamedTuple):
    """Where a body is: displacement (x, y) [length], cosine and sine of its angle about its centre."""

    x: Any
    y: Any
    cosine: Any
    sine: Any


@linked
def cosine_and_sine(turns):
    """Of an angle in turns, by their series."""
    quarter = np.floor(4.0 * turns + 0.5)
    angle = (turns - 0.25 * quarter) * (2.0 * math.pi)
    square, cosine, sine = angle * angle, 1.0, 1.0
    for k in range(TERMS, 0, -1):
        cosine = 1.0 - square / ((2.0 * k - 1.0) * (2.0 * k)) * cosine
        sine = 1.0 - square / ((2.0 * k) * (2.0 * k + 1.0)) * sine
    sine *= angle
    quadrant = quarter - 4.0 * np.floor(0.25 * quarter)
    if quadrant == 0.0:
        return cosine, sine
    if quadrant == 1.0:
        return -sine, cosine
    if quadrant == 2.0:
        return -cosine, -sine
    return sine, -cosine


@linked
def piece_of_path(body, knots, since):
    """The row of `knots` at or before a time since the start; one before the first row, if that is still to come."""
    low, high = body.knots[0] - 1, body.knots[1]
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle, 0] <= since:
            low = middle
        else:
            high = middle
    return low


@linked
def pose_at(body, knots, time):
    """The `Pose` of a body at a time of the run."""
    since = max(time - body.start, 0.0)
    if body.kind == TRANSLATION:
        since = min(since, body.stop)
        return Pose(body.vector[0] * since, body.vector[1] * since, 1.0, 0.0)
    if body.kind == OSCILLATION:
        _, sine = cosine_and_sine(body.rate * since + body.phase)
        return Pose(body.vector[0] * sine, body.vector[1] * sine, 1.0, 0.0)
    if body.kind == ROTATION:
        cosine, sine = cosine_and_sine(body.rate * min(since, body.stop))
        return Pose(0.0, 0.0, cosine, sine)
    row = piece_of_path(body, knots, since)
    if row < body.knots[0] or row + 1 == body.knots[1]:
        row = max(row, body.knots[0])
        return Pose(knots[row, 1], knots[row, 2], 1.0, 0.0)
    part = (since - knots[row, 0]) / (knots[row + 1, 0] - knots[row, 0])
    x = knots[row, 1] + part * (knots[row + 1, 1] - knots[row, 1])
    y = knots[row, 2] + part * (knots[row + 1, 2] - knots[row, 2])
    return Pose(x, y, 1.0, 0.0)


@linked
def velocity_at(body, knots, time, x, y):
    """Velocity of the material point of a body that is at (x, y) at a time."""
    since = time - body.start
    if since < 0.0 or (body.kind != OSCILLATION and since >= body.stop):
        return 0.0, 0.0
    if body.kind == TRANSLATION:
        return body.vector[0], body.vector[1]
    speed = body.rate * (2.0 * math.pi)
    if body.kind == OSCILLATION:
        cosine, _ = cosine_and_sine(body.rate * since + body.phase)
        return body.vector[0] * speed * cosine, body.vector[1] * speed * cosine
    if body.kind == ROTATION:
        return -speed * (y - body.vector[1]), speed * (x - body.vector[0])
    row = piece_of_path(body, knots, since)
    if row < body.knots[0]:
        return 0.0, 0.0
    long = knots[row + 1, 0] - knots[row, 0]
    return (knots[row + 1, 1] - knots[row, 1]) / long, (knots[row + 1, 2] - knots[row, 2]) / long


@inlined
def into_frame(body, pose, x, y):
    """Coordinates in the frame of a body, from those in the box."""
    centre_x, centre_y = centre_of(body)
    dx, dy = x - centre_x - pose.x, y - centre_y - pose.y
    return centre_x + pose.cosine * dx + pose.sine * dy, centre_y + pose.cosine * dy - pose.sine * dx


@inlined
def out_of_frame(body, pose, x, y):
    """Coordinates in the box, from those in the frame of a body."""
    centre_x, centre_y = centre_of(body)
    dx, dy = x - centre_x, y - centre_y
    return (
        centre_x + pose.x + pose.cosine * dx - pose.sine * dy,
        centre_y + pose.y + pose.cosine * dy + pose.sine * dx,
    )


@inlined
def turned(pose, nx, ny):
    """A vector in the box, from one in the frame of a body."""
    return pose.cosine * nx - pose.sine * ny, pose.sine * nx + pose.cosine * ny


@inlined
def centre_of(body):
    """Of its rotation; of other motions any point will do."""
    if body.kind == ROTATION:
        return body.vector[0], body.vector[1]
    return 0.0, 0.0


# --- Contacts of discs with bodies


class Bodies(NamedTuple):
    """All bodies of a scene.

    body: of BODY, shape (M,). knots: of all paths, shape (P, 3): time since the start [time], displacement [length].
    capsule, next_end, near, index: as of `Capsules`, of all bodies; `near` by the cells of one body after the other.
    body_of: number of the body of each capsule, shape (K,).
    """

    body: Any
    knots: Any
    capsule: Any
    next_end: Any
    near: Any
    index: Any
    body_of: Any


class Touch(NamedTuple):
    """A disc at a capsule of a body.

    gap: between them, negative where they overlap [length]. nx, ny: unit vector from there to the disc. wx, wy:
    velocity of the material point that is nearest; along: what the surface runs past it along (-ny, nx) [length/time].
    """

    gap: Any
    nx: Any
    ny: Any
    wx: Any
    wy: Any
    along: Any


@linked
def touch_at(body, bodies, k, radius, x, y, time, pose):
    """The `Touch` of a disc at (x, y) and capsule k, when the body is in this pose."""
    frame_x, frame_y = into_frame(body, pose, x, y)
    rx, ry, end = nearest_offset(frame_x, frame_y, bodies.capsule, k)
    distance = np.sqrt(rx * rx + ry * ry)
    nx, ny = normal_of(rx, ry, distance, bodies.capsule, k)
    if end >= 0:
        nx, ny = normal_at_corner(nx, ny, end, bodies, radius)
    thick = bodies.capsule[k, RADIUS]
    if thick < 0.0:
        nx, ny = -nx, -ny
    across = rx * nx + ry * ny
    at_x, at_y = out_of_frame(body, pose, frame_x - (across - thick) * nx, frame_y - (across - thick) * ny)
    wx, wy = velocity_at(body, bodies.knots, time, at_x, at_y)
    normal_x, normal_y = turned(pose, nx, ny)
    along = surface_speed(bodies.capsule, k, nx, ny)
    return Touch(across - radius - thick, normal_x, normal_y, wx, wy, along)


@inlined
def current_pose(body):
    """At the end of the current step."""
    return Pose(body.displacement[0], body.displacement[1], body.turned[0], body.turned[1])


@inlined
def time_of_touch(body, bodies, k, radius, x, y, vx, vy, ax, ay, now, dt):
    """How long ago a disc that now overlaps capsule k has touched it, at most dt, and the `Touch` of that time.

    First the time on straight paths, then two more of Newton's steps, with the body where it was at each of them.
    """
    since, touch = 0.0, now
    for _ in range(3):
        speed = (vx - ax * since - touch.wx) * touch.nx + (vy - ay * since - touch.wy) * touch.ny
        if speed >= 0.0:
            return since, touch
        since = min(max(since + touch.gap / speed, 0.0), dt)
        back_x, back_y = x - since * (vx - 0.5 * ax * since), y - since * (vy - 0.5 * ay * since)
        time = body.now - since
        touch = touch_at(body, bodies, k, radius, back_x, back_y, time, pose_at(body, bodies.knots, time))
    return since, touch


@inlined
def overlap(body, bodies, k, radius, x, y, pose):
    """Whether a disc at (x, y) overlaps capsule k, and not another one of the corner more."""
    if not concerns(bodies.capsule, k, radius):
        return False
    frame_x, frame_y = into_frame(body, pose, x, y)
    rx, ry, end = nearest_offset(frame_x, frame_y, bodies.capsule, k)
    reach = radius + bodies.capsule[k, RADIUS]
    apart = rx * rx + ry * ry < reach * reach if reach < 0.0 else not rx * rx + ry * ry < reach * reach
    if apart:
        return False
    return not (end >= 0 and is_behind_surface(rx, ry, end, bodies, radius))


@linked
def resolve_touch(discs, i, body, bodies, k, radius, shift_x, shift_y, features, parameters, impact):
    """Contact of the disc in slot i, less the shift of an image, with capsule k. Returns whether they overlap."""
    pose = current_pose(body)
    x, y = np.float64(discs.x[i]) - shift_x, np.float64(discs.y[i]) - shift_y
    if not overlap(body, bodies, k, radius, x, y, pose):
        return False
    own_ax, own_ay = accelerations_of(discs, i, features)
    ax, ay = np.float64(own_ax), np.float64(own_ay)
    vx, vy = np.float64(discs.vx[i]), np.float64(discs.vy[i])
    touch, since = touch_at(body, bodies, k, radius, x, y, body.now, pose), 0.0
    if impact:
        dt = np.float64(parameters.dt)
        since, touch = time_of_touch(body, bodies, k, radius, x, y, vx, vy, ax, ay, touch, dt)
    speed = (vx - ax * since - touch.wx) * touch.nx + (vy - ay * since - touch.wy) * touch.ny
    change = 0.0
    if speed < 0.0:
        change = -(1.0 + np.float64(parameters.wall_restitution)) * speed
        discs.vx[i] += change * touch.nx
        discs.vy[i] += change * touch.ny
        discs.x[i] += change * touch.nx * since
        discs.y[i] += change * touch.ny * since
    pushing = touch.wx * touch.nx + touch.wy * touch.ny
    surface = touch.wy * touch.nx - touch.wx * touch.ny + touch.along
    owner = int(bodies.capsule[k, OWNER])
    on_capsule(discs, i, owner, touch.nx, touch.ny, change, since, pushing, surface, features, parameters)
    leave(discs, i, body, bodies, k, radius, shift_x, shift_y, features)
    return True


@inlined
def leave(discs, i, body, bodies, k, radius, shift_x, shift_y, features):
    """Put a disc that is still inside capsule k on its surface, where it rests: it does not move inwards."""
    x, y = np.float64(discs.x[i]) - shift_x, np.float64(discs.y[i]) - shift_y
    touch = touch_at(body, bodies, k, radius, x, y, body.now, current_pose(body))
    if touch.gap < 0.0:
        discs.x[i] -= touch.gap * touch.nx
        discs.y[i] -= touch.gap * touch.ny
        inward = (discs.vx[i] - touch.wx) * touch.nx + (discs.vy[i] - touch.wy) * touch.ny
        if inward < 0.0:
            discs.vx[i] -= inward * touch.nx
            discs.vy[i] -= inward * touch.ny
            power = -inward * (touch.wx * touch.nx + touch.wy * touch.ny)
            add_work(features.work, FIRST_OBSTACLE + int(bodies.capsule[k, OWNER]), discs.id[i], power, features.mass)


@linked
def resolve_bodies(bodies, discs, low, high, features, parameters, control, mine):
    """Contacts of a slice with bodies, in the order in which the scene lists them."""
    if bodies is None:
        return
    half = parameters.diameter / discs.x.dtype.type(2)
    impact = control.contact == IMPACT
    for number in range(bodies.body.size):
        body = bodies.body[number]
        for i in range(low, high):
            cell, shift_x, shift_y = cell_in(body, np.float64(discs.x[i]), np.float64(discs.y[i]), features)
            if cell < 0 or is_absent(features.exits, discs.id[i]):
                continue
            radius, met = np.float64(value_or(discs.radius, i, half)), False
            for entry in range(bodies.near[cell], bodies.near[cell + 1]):
                k = bodies.index[entry]
                met |= resolve_touch(discs, i, body, bodies, k, radius, shift_x, shift_y, features, parameters, impact)
            if met:
                put_inside(discs, i, discs.x[i], discs.y[i], features, parameters)
                wrap_disc(discs, i, features)
                if control.deep >= 0 and is_pinched(discs, i, number, radius, features, parameters):
                    note_pinched(discs.id[i], control, mine)


@inlined
def cell_in(body, x, y, features):
    """The cell of a body in which (x, y) or its image is, below 0 outside its grid, and the shift of the image."""
    shift_x = period_to_nearest(features.wrap_x, body.nearest[0], x - body.place[0])
    shift_y = period_to_nearest(features.wrap_y, body.nearest[1], y - body.place[1])
    frame_x, frame_y = into_frame(body, current_pose(body), x - shift_x, y - shift_y)
    column = (frame_x - body.low[0]) * body.per_length[0]
    row = (frame_y - body.low[1]) * body.per_length[1]
    columns, rows = body.cells[0], body.cells[1]
    if not ((column >= 0.0) & (column < columns) & (row >= 0.0) & (row < rows)):
        return -1, shift_x, shift_y
    return body.first + int(column) * rows + int(row), shift_x, shift_y


@linked
def is_pinched(discs, i, number, radius, features, parameters):
    """Whether one more step takes a disc past a surface in which it still is when its contacts are done.

    Those with what is at rest and with the bodies up to `number`: surfaces less than a diameter apart undo one
    another's. As no disc moves more than its radius in a step, it has not been past it before.
    """
    dt, bodies = np.float64(parameters.dt), features.bodies
    push = farthest_push(features.moving_wall, dt)
    past = goes_past_capsules(features.capsules, discs, i, radius, push, dt)
    x, y, vx, vy = np.float64(discs.x[i]), np.float64(discs.y[i]), np.float64(discs.vx[i]), np.float64(discs.vy[i])
    for other in range(number + 1):
        body = bodies.body[other]
        cell, shift_x, shift_y = cell_in(body, x, y, features)
        if cell < 0:
            continue
        own_x, own_y, pose = x - shift_x, y - shift_y, current_pose(body)
        for entry in range(bodies.near[cell], bodies.near[cell + 1]):
            k = bodies.index[entry]
            if overlap(body, bodies, k, radius, own_x, own_y, pose):
                touch = touch_at(body, bodies, k, radius, own_x, own_y, body.now, pose)
                past |= goes_past(-touch.gap, touch.nx, touch.ny, vx - touch.wx, vy - touch.wy, radius, push, dt)
    return past


@inlined
def note_pinched(disc, control, mine):
    """Report a disc that is pinched, the one with the lowest number, and end the command with this frame."""
    if mine.fastest < PINCHED or disc < mine.fastest_disc:
        mine.fastest, mine.fastest_disc = PINCHED, disc
    control.frames = mine.frame + 1  # as `motion.end_where_fast`


@inlined
def note_pressed(pressing, control, mine):
    """Report that discs were deep in each other in the step before, and end the command with this frame."""
    if pressing is not None and control.deep > 0:
        if mine.fastest < PRESSED:
            mine.fastest, mine.fastest_disc = PRESSED, 0
        control.frames = mine.frame + 1


@inlined
def farthest_push(moving_wall, dt):
    """The longest way of a wall in this step, of dt [length]."""
    way = 0.0
    if moving_wall is not None:
        for edge in range(4):
            way = max(way, abs(np.float64(moving_wall.wall[edge].velocity)) * dt)
    return way


@linked
def look_beside_walls(moving_wall, discs, low, high, features, parameters, control, mine):
    """Report the discs of a slice that a wall presses through what is at rest, when their contacts are done."""
    if moving_wall is None:
        return
    half, dt = parameters.diameter / discs.x.dtype.type(2), np.float64(parameters.dt)
    push = farthest_push(moving_wall, dt)
    for edge in range(4):
        if (moving_wall.wall[edge].moves == 0) | (control.deep < 0):
            continue
        place, wall = discs.x if edge < BOTTOM else discs.y, parameters.limit[edge]
        for i in range(low, high):
            radius = np.float64(value_or(discs.radius, i, half))
            near = abs(place[i] - wall) < 2.0 * radius and not is_absent(features.exits, discs.id[i])
            if near and goes_past_capsules(features.capsules, discs, i, radius, push, dt):
                note_pinched(discs.id[i], control, mine)


@inlined
def period_to_nearest(wrap, nearest, difference):
    """Periods between a disc and the nearest image of a body [length]; wrap: the length of a periodic axis, or None."""
    if wrap is None:
        return 0.0
    length = np.float64(wrap[0])
    return nearest * length * np.floor(difference / length + 0.5)


@linked
def move_bodies(bodies, control):
    """Put all bodies where they are at the end of the next step: by one worker, between motion and contacts."""
    if bodies is None:
        return
    for number in range(bodies.body.size):
        body = bodies.body[number]
        body.now = body.origin + (control.steps + 1) / control.substeps * body.dt
        pose = pose_at(body, bodies.knots, body.now)
        body.displacement[0], body.displacement[1] = pose.x, pose.y
        body.turned[0], body.turned[1] = pose.cosine, pose.sine
        body.place[0], body.place[1] = out_of_frame(body, pose, body.middle[0], body.middle[1])


# --- Walls of the box that move: pistons


def moving_wall_in(precision: DTypeLike) -> np.dtype[Any]:
    """The record of a wall: in float64, but for what the motion of discs reads, of the precision of the run."""
    return record_of(
        [
            *MOTION,
            ("moves", np.int64),  # 0: it is at rest where the box ends
            ("home", np.float64),  # coordinate without displacement [length]
            ("end", np.float64),  # where it stops [length]
            ("low", np.float64),  # least and largest coordinate that it ever has [length]
            ("high", np.float64),
            ("margin", np.float64),  # from the wall to the limit of centres, along its axis [length]
            ("running", precision),  # at which it runs past the discs, along the other axis [length/time]
            ("limit", precision),  # of centres while contacts are resolved; `parameters` has that of the next step
            # In the next step; under contact `impact` at its end, where the acceleration is not 0.
            ("velocity", precision),
            ("acceleration", precision),
        ]
    )


class MovingWalls(NamedTuple):
    """The walls of the box: of `moving_wall_in`, by edge, shape (4,); `knots` as of `Bodies`."""

    wall: Any
    knots: Any


@linked
def place_of_wall(wall, knots, time):
    """Coordinate of a wall at a time of the run [length]."""
    if time - wall.start >= wall.stop:
        return wall.end
    pose = pose_at(wall, knots, time)
    return min(max(wall.home + (pose.x + pose.y), wall.low), wall.high)  # one of them is 0


@linked
def velocity_of_wall(wall, knots, time):
    """Velocity of a wall along its axis [length/time]."""
    vx, vy = velocity_at(wall, knots, time, 0.0, 0.0)
    return vx + vy


@inlined
def acceleration_of_wall(wall, knots, time):
    """Acceleration of a wall along its axis, jumps apart [length/time^2]."""
    if wall.kind != OSCILLATION or time < wall.start:
        return 0.0
    pose, rate = pose_at(wall, knots, time), 2.0 * math.pi * wall.rate
    return -rate * rate * (pose.x + pose.y)


@linked
def move_walls(moving_wall, parameters, control):
    """Put the walls where they will be at the end of the next step: the motion of that step meets them there.

    `limit` then is where they are now. At the end of a frame, the time has the bits of `Solver.time`.
    """
    if moving_wall is None:
        return
    for edge in range(4):
        wall = moving_wall.wall[edge]
        if wall.moves == 0:
            wall.limit = parameters.limit[edge]
            continue
        now = wall.origin + control.steps / control.substeps * wall.dt
        later = wall.origin + (control.steps + 1) / control.substeps * wall.dt
        wall.limit = place_of_wall(wall, moving_wall.knots, now) + wall.margin
        parameters.limit[edge] = place_of_wall(wall, moving_wall.knots, later) + wall.margin
        bent = acceleration_of_wall(wall, moving_wall.knots, later) if control.contact == IMPACT else 0.0
        wall.acceleration = bent
        wall.velocity = velocity_of_wall(wall, moving_wall.knots, later if bent != 0.0 else 0.5 * (now + later))


@inlined
def wall_motion(moving_wall, edge, parameters):
    """Speed and acceleration of the wall at an edge (LEFT, ...)."""
    if moving_wall is None:
        return real(parameters, 0), real(parameters, 0)
    return moving_wall.wall[edge].velocity, moving_wall.wall[edge].acceleration


@inlined
def wall_place(moving_wall, edge, parameters):
    """Position of the limit of an edge while contacts are resolved: `limit` of parameters already has the next one."""
    if moving_wall is None:
        return parameters.limit[edge]
    return moving_wall.wall[edge].limit
