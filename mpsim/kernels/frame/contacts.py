"""Contacts: which discs overlap, and what a contact does to them.

shift_x, shift_y: along a periodic axis, the length by which disc i is seen farther back when its partner lies beyond
the border; None elsewhere, which costs nothing.
"""

import math

import numpy as np

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.acceleration import acceleration_of
from mpsim.kernels.features.hooks import between_discs, is_absent
from mpsim.kernels.features.images import confined, seen_from
from mpsim.kernels.features.masses import mass_fraction
from mpsim.kernels.features.radii import touching_distance
from mpsim.kernels.frame.walls import keep_inside
from mpsim.kernels.layout import BOTTOM, DEPTH_SCALE, ELASTIC, IMPACT, LEFT, RIGHT, TOP
from mpsim.kernels.machine import LANES, lowest_bit, nonnegative, overlap_lanes
from mpsim.kernels.optional import any_present, value_or


@inlined
def separation(discs, i, j, shift_x, shift_y):
    """Vector from disc i to disc j."""
    return discs.x[j] - seen_from(discs.x[i], shift_x), discs.y[j] - seen_from(discs.y[i], shift_y)


@inlined
def normalised(x, y, one):
    """Unit vector along (x, y), and its length. No length gives (one, 0): defined, never NaN."""
    length = math.sqrt(x * x + y * y)
    if length == 0:
        return one, length, length
    return x / length, y / length, length


@inlined
def displace(discs, i, dx, dy, features, parameters):
    """Move disc i by (dx, dy), but not through a wall."""
    margin = value_or(discs.radius, i, discs.x.dtype.type(0))
    discs.x[i] = confined(discs.x[i] + dx, parameters.limit[LEFT], parameters.limit[RIGHT], margin, features.wrap_x)
    discs.y[i] = confined(discs.y[i] + dy, parameters.limit[BOTTOM], parameters.limit[TOP], margin, features.wrap_y)


@inlined
def apply_law(discs, i, j, nx, ny, features, parameters, law):
    """Change the velocities of two discs in contact along the unit vector n from i to j.

    `elastic`: discs that approach part with e times their normal velocity, momentum kept (e = 1: energy too). With
    friction their tangential velocities and spins change as well.
    `reflect` (the report's): each velocity is mirrored about the contact line, whether they approach or not.
    Returns the impulse [mass length/time] (for `reflect`, which has two of them, their mean) and the unit vector.
    """
    vx, vy = discs.vx, discs.vy
    zero, one, two = vx.dtype.type(0), vx.dtype.type(1), vx.dtype.type(2)
    along_i = vx[i] * nx + vy[i] * ny
    along_j = vx[j] * nx + vy[j] * ny
    if law == ELASTIC:
        approach = along_j - along_i
        exchanged = approach * parameters.exchange if approach < zero else zero
        change_i = exchanged * mass_fraction(features.mass, discs.id[i], discs.id[j], one)
        change_j = -(exchanged * mass_fraction(features.mass, discs.id[j], discs.id[i], one))
        between_discs(features.friction, discs, i, j, nx, ny, exchanged, features, parameters)
    else:
        change_i = -two * along_i
        change_j = -two * along_j
    vx[i] += change_i * nx
    vy[i] += change_i * ny
    vx[j] += change_j * nx
    vy[j] += change_j * ny
    impulse_i = abs(change_i) * value_or(features.mass, discs.id[i], one)
    return (impulse_i + abs(change_j) * value_or(features.mass, discs.id[j], one)) / two, nx, ny


@inlined
def push_contact(discs, i, j, shift_x, shift_y, features, parameters, law):
    """Contact `push`: the discs move apart until they touch, then the law acts along the normal found here.

    Each moves half the overlap, of unequal ones the lighter more. Returns what the law does.
    """
    one = discs.x.dtype.type(1)
    x, y = separation(discs, i, j, shift_x, shift_y)
    nx, ny, distance = normalised(x, y, one)
    half = (touching_distance(discs.radius, i, j, parameters) - distance) / discs.x.dtype.type(2)
    displacement_i = half * mass_fraction(features.mass, discs.id[i], discs.id[j], one)
    displacement_j = half * mass_fraction(features.mass, discs.id[j], discs.id[i], one)
    displace(discs, i, -nx * displacement_i, -ny * displacement_i, features, parameters)
    displace(discs, j, nx * displacement_j, ny * displacement_j, features, parameters)
    return apply_law(discs, i, j, nx, ny, features, parameters, law)


@inlined
def conserve_energy(accelerated, discs, i, j, shift_x, shift_y, start_i, start_j, features, parameters):
    """Keep the energy of two accelerated discs that a contact has moved from `start`: pairs (x, y).

    Uniform gravity does no work on a contact that keeps the centre of mass; where a wall confines one of the discs it
    does (both are lifted), and discs of different accelerations always meet some. The work W changes the velocity w
    with which they part or approach: w'^2 = w^2 + 2 W / mu, with the reduced mass mu. Discs that cannot pay are moved
    as far as they can; where collisions lose energy, and discs may lie in heaps, as far as they must.
    accelerated: None where there is no acceleration to be paid for.
    """
    if accelerated is None:
        return
    one, two = discs.x.dtype.type(1), discs.x.dtype.type(2)
    work = work_since(discs, i, *start_i, features) + work_since(discs, j, *start_j, features)
    share_i = mass_fraction(features.mass, discs.id[i], discs.id[j], one)
    share_j = mass_fraction(features.mass, discs.id[j], discs.id[i], one)
    given = two * two * work / (share_i * value_or(features.mass, discs.id[i], one))
    x, y = separation(discs, i, j, shift_x, shift_y)
    nx, ny, _ = normalised(x, y, one)
    along = (discs.vx[j] - discs.vx[i]) * nx + (discs.vy[j] - discs.vy[i]) * ny
    square = along * along
    if (square + given < 0) & (parameters.exchange == one):
        for disc, start in ((i, start_i), (j, start_j)):
            discs.x[disc] = start[0] - (discs.x[disc] - start[0]) * square / given
            discs.y[disc] = start[1] - (discs.y[disc] - start[1]) * square / given
    paid = np.sqrt(max(square + given, along - along))
    change = (paid if along >= 0 else -paid) - along
    change_i, change_j = -change * share_i / two, change * share_j / two
    discs.vx[i] += change_i * nx
    discs.vy[i] += change_i * ny
    discs.vx[j] += change_j * nx
    discs.vy[j] += change_j * ny


@inlined
def work_since(discs, i, x, y, features):
    """Work that its acceleration has done on disc i since it was at (x, y) [mass length^2/time^2]."""
    zero, one, disc = discs.x.dtype.type(0), discs.x.dtype.type(1), discs.id[i]
    along_x = (discs.x[i] - x) * acceleration_of(features.gravity, features.acceleration, 0, disc, zero)
    along_y = (discs.y[i] - y) * acceleration_of(features.gravity, features.acceleration, 1, disc, zero)
    return (along_x + along_y) * value_or(features.mass, disc, one)


@inlined
def time_since_impact(discs, i, j, shift_x, shift_y, parameters):
    """Time since two overlapping discs touched, in free flight; negative if they do not approach.

    |r - u t| = D with r, u the relative position and velocity, b = r.u < 0 and c = r.r - D^2 < 0:
    t = (b + sqrt(b^2 - u.u c)) / u.u, which loses its digits where the overlap is small; its conjugate does not:
    t = -c / (sqrt(b^2 - u.u c) - b). Discs of the same acceleration move uniformly against each other: it holds too.
    """
    diameter = touching_distance(discs.radius, i, j, parameters)
    rx, ry = separation(discs, i, j, shift_x, shift_y)
    ux = discs.vx[j] - discs.vx[i]
    uy = discs.vy[j] - discs.vy[i]
    b = rx * ux + ry * uy
    if not b < 0:
        return -diameter  # any negative number: there was no impact
    c = rx * rx + ry * ry - diameter * diameter
    return -c / (math.sqrt(b * b - (ux * ux + uy * uy) * c) - b)


@inlined
def impact_contact(discs, i, j, shift_x, shift_y, features, parameters, control, tally, frame):
    """Contact `impact`: back to the instant of contact, the law along the normal found there, and on again.

    Discs that do not approach, or that overlapped before this step, are pushed apart instead. Returns what the law
    does.
    """
    time = time_since_impact(discs, i, j, shift_x, shift_y, parameters)
    start_i, start_j = (discs.x[i], discs.y[i]), (discs.x[j], discs.y[j])
    if not (time >= 0) & (time <= parameters.dt):
        done = push_contact(discs, i, j, shift_x, shift_y, features, parameters, control.law)
        accelerated = any_present(features.gravity, features.acceleration)
        conserve_energy(accelerated, discs, i, j, shift_x, shift_y, start_i, start_j, features, parameters)
        return done
    for disc in (i, j):
        discs.x[disc] -= discs.vx[disc] * time
        discs.y[disc] -= discs.vy[disc] * time
    # In float64 whatever the run's precision. Discs that just touch are all equally far apart, and a float32 root or
    # quotient of that one number is rounded the same way each time: with diameter 1, by 1e-7 of energy per collision.
    x, y = separation(discs, i, j, shift_x, shift_y)
    nx, ny, _ = normalised(np.float64(x), np.float64(y), 1.0)
    done = apply_law(discs, i, j, nx, ny, features, parameters, control.law)
    for disc in (i, j):
        discs.x[disc] += discs.vx[disc] * time
        discs.y[disc] += discs.vy[disc] * time
    conserve_energy(features.acceleration, discs, i, j, shift_x, shift_y, start_i, start_j, features, parameters)
    for disc in (i, j):
        keep_inside(discs, disc, features, parameters, control, tally, frame)
    return done


@inlined
def resolve_contact(discs, i, j, shift_x, shift_y, features, parameters, control, tally, frame):
    """Resolve two overlapping discs by the contact and the law of the run."""
    if tally is not None:
        tally_depth(discs, i, j, shift_x, shift_y, parameters, tally, frame)
    if control.contact == IMPACT:
        impulse, nx, ny = impact_contact(discs, i, j, shift_x, shift_y, features, parameters, control, tally, frame)
    else:
        impulse, nx, ny = push_contact(discs, i, j, shift_x, shift_y, features, parameters, control.law)
    if tally is not None:
        relative = touching_distance(discs.radius, i, j, parameters) / parameters.diameter
        virial = impulse * relative * np.float64(parameters.tally_scale)
        tally[frame].virial += np.int64(virial)
        tally[frame].virial_xx += np.int64(virial * nx * nx)
        tally[frame].virial_xy += np.int64(virial * nx * ny)
        tally[frame].collisions += impulse > 0


@compiled
def tally_depth(discs, i, j, shift_x, shift_y, parameters, tally, frame):
    """Count a pair that is met and how deep it overlaps, as a fraction of the (largest) diameter."""
    x, y = separation(discs, i, j, shift_x, shift_y)
    _, _, distance = normalised(x, y, discs.x.dtype.type(1))
    overlap = touching_distance(discs.radius, i, j, parameters) - distance
    depth = np.int64(np.float64(overlap / parameters.diameter) * DEPTH_SCALE)
    tally[frame].met += 1
    tally[frame].depth += depth
    tally[frame].deepest = max(tally[frame].deepest, depth)


@inlined
def overlapping(discs, i, block, shift_x, shift_y, reach):
    """The mask of the discs from slot `block` on that overlap disc i."""
    x, y = seen_from(discs.x[i], shift_x), seen_from(discs.y[i], shift_y)
    return overlap_lanes(discs.x, discs.y, discs.radius, block, x, y, reach)


@inlined
def resolve_range(discs, i, first, last, shift_x, shift_y, features, parameters, control, tally, frame):
    """Resolve disc i with each of the discs [first, last) that overlaps it when its turn comes. Returns how many.

    The same as testing one by one: after a contact has moved disc i, the lanes that follow are tested again.
    """
    reach = value_or(discs.radius, i, parameters.diameter * parameters.diameter)
    contacts = 0
    block, last = np.int64(first), np.int64(last)
    while block < last:
        lanes = (1 << min(last - block, LANES)) - 1
        mask = overlapping(discs, i, block, shift_x, shift_y, reach) & lanes
        while mask != 0:
            lane = lowest_bit(mask)
            if not is_absent(features.exits, discs.id[block + lane]):
                resolve_contact(discs, i, block + lane, shift_x, shift_y, features, parameters, control, tally, frame)
                contacts += 1
            lanes &= ~((2 << lane) - 1)
            mask = overlapping(discs, i, block, shift_x, shift_y, reach) & lanes
        block += LANES
    return contacts


@compiled
def resolve_far(discs, i, first, last, shift_x, shift_y, features, parameters, control, tally, frame):
    """`resolve_range` as a call: for the few discs at borders, where copies of it would only cost compilation time."""
    return resolve_range(discs, i, first, last, shift_x, shift_y, features, parameters, control, tally, frame)


@inlined
def resolve_column(discs, start, column, features, parameters, control, tally, frame):
    """Contacts of one column with itself and with the next one. Returns how many.

    Both candidate ranges of a disc (own cell and the one above; three cells of the next column) are contiguous and
    nearly always shorter than a vector, so a disc costs two vector tests and one branch that is seldom taken.
    """
    cells, stride = discs.cell, control.rows + 2
    diameter_squared = parameters.diameter * parameters.diameter
    contacts = 0
    for slot in range(start[column * stride], start[(column + 1) * stride]):
        i = nonnegative(slot)
        cell = nonnegative(cells[i])
        own_end = start[cell + 2]
        next_first = nonnegative(start[nonnegative(cell + stride - 1)])
        next_end = start[nonnegative(cell + stride + 2)]
        own = own_end - i - 1
        others = next_end - next_first
        reach = value_or(discs.radius, i, diameter_squared)
        own_mask = overlapping(discs, i, i + 1, None, None, reach)
        next_mask = overlapping(discs, i, next_first, None, None, reach)
        own_mask &= (1 << min(own, LANES)) - 1
        next_mask &= (1 << min(others, LANES)) - 1
        if (own_mask | next_mask) != 0 or own > LANES or others > LANES:
            for first, last in ((i + 1, np.int64(own_end)), (next_first, np.int64(next_end))):
                contacts += resolve_range(
                    discs, i, first, last, None, None, features, parameters, control, tally, frame
                )
    return contacts


@inlined
def resolve_top_and_bottom(
    wrap_y, discs, start, column, next_column, shift_x, features, parameters, control, tally, frame
):
    """Contacts of a column's first and last row, through the border of a periodic y. Returns how many.

    The last row looks at the first one of its own column and of the next one, the first row at the last one of the
    next: with the cells inside the box, each pair once.
    """
    contacts = 0
    if wrap_y is not None:
        stride = control.rows + 2
        first, last = column * stride + 1, column * stride + control.rows
        next_first, next_last = next_column * stride + 1, next_column * stride + control.rows
        up, down = wrap_y[0], -wrap_y[0]
        for slot in range(start[last], start[last + 1]):
            i = nonnegative(slot)
            contacts += resolve_far(
                discs, i, start[first], start[first + 1], None, up, features, parameters, control, tally, frame
            )
            contacts += resolve_far(
                discs,
                i,
                start[next_first],
                start[next_first + 1],
                shift_x,
                up,
                features,
                parameters,
                control,
                tally,
                frame,
            )
        for slot in range(start[first], start[first + 1]):
            i = nonnegative(slot)
            contacts += resolve_far(
                discs,
                i,
                start[next_last],
                start[next_last + 1],
                shift_x,
                down,
                features,
                parameters,
                control,
                tally,
                frame,
            )
    return contacts


@inlined
def resolve_border(wrap_x, discs, start, column, features, parameters, control, tally, frame):
    """Contacts of one column through the borders of periodic axes. Returns how many.

    The last column's next one is the first, seen one width farther on. The number of columns is even, so in the odd
    pass, which resolves the last column, nobody else touches the first one.
    """
    if wrap_x is None:
        return resolve_top_and_bottom(
            features.wrap_y, discs, start, column, column + 1, None, features, parameters, control, tally, frame
        )
    if column + 1 < control.columns:
        return resolve_top_and_bottom(
            features.wrap_y, discs, start, column, column + 1, None, features, parameters, control, tally, frame
        )
    stride = control.rows + 2
    contacts = 0
    for slot in range(start[column * stride], start[(column + 1) * stride]):
        i = nonnegative(slot)
        row = discs.cell[i] - column * stride
        contacts += resolve_far(
            discs, i, start[row - 1], start[row + 2], wrap_x[0], None, features, parameters, control, tally, frame
        )
    return contacts + resolve_top_and_bottom(
        features.wrap_y, discs, start, column, 0, wrap_x[0], features, parameters, control, tally, frame
    )


@compiled
def resolve_columns(discs, start, first, last, step, features, control, parameters, tally, frame):
    """Columns first, first + step, ... below last."""
    contacts = 0
    for column in range(first, last, step):
        contacts += resolve_column(discs, start, column, features, parameters, control, tally, frame)
        contacts += resolve_border(features.wrap_x, discs, start, column, features, parameters, control, tally, frame)
    return contacts


@inlined
def is_near_border(coordinate, length, parameters):
    """Whether the image of a disc, outside the box along one axis, is near enough to touch what lies in it."""
    return (coordinate > -parameters.diameter) & (coordinate < length + parameters.diameter)


@inlined
def resolve_images_y(wrap_y, discs, i, count, shift_x, features, parameters, control, tally, frame):
    """Contacts of disc i, seen `shift_x` away, with later discs through the border of y. Returns how many."""
    contacts = 0
    if wrap_y is not None:
        for shift_y in (wrap_y[0], -wrap_y[0]):
            if is_near_border(discs.y[i] - shift_y, wrap_y[0], parameters):
                contacts += resolve_far(
                    discs, i, i + 1, count, shift_x, shift_y, features, parameters, control, tally, frame
                )
    return contacts


@inlined
def resolve_images_x(wrap_x, discs, i, count, features, parameters, control, tally, frame):
    """Contacts of disc i with later discs through the border of a periodic x. Returns how many."""
    contacts = 0
    if wrap_x is not None:
        for shift_x in (wrap_x[0], -wrap_x[0]):
            if is_near_border(discs.x[i] - shift_x, wrap_x[0], parameters):
                contacts += resolve_far(
                    discs, i, i + 1, count, shift_x, None, features, parameters, control, tally, frame
                )
                contacts += resolve_images_y(
                    features.wrap_y, discs, i, count, shift_x, features, parameters, control, tally, frame
                )
    return contacts


@compiled
def resolve_all_pairs(discs, features, control, parameters, tally, frame):
    """All pairs i < j in index order. Returns the number of contacts."""
    contacts, count = 0, control.count
    for i in range(count):
        if not is_absent(features.exits, discs.id[i]):
            contacts += resolve_range(discs, i, i + 1, count, None, None, features, parameters, control, tally, frame)
            contacts += resolve_images_y(
                features.wrap_y, discs, i, count, None, features, parameters, control, tally, frame
            )
            contacts += resolve_images_x(features.wrap_x, discs, i, count, features, parameters, control, tally, frame)
    return contacts
