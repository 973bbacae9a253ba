"""The exact solver: event-driven molecular dynamics of hard discs, in float64.

Discs fly freely (a straight line, or one parabola shared by all of them) from impact to impact, and the solver jumps
from event to event in the order of time. Nothing is approximated but the rounding of float64.

- One prediction a disc: its earliest impact with another disc, and the time it leaves its cell or meets a wall. An
  impact whose partner has been deflected meanwhile is found out, when its time comes, by the partner's count of
  deflections, and predicted anew (Lubachevsky, J. Comput. Phys. 94, 255, 1991).
- Lazy positions: a disc is stored where and when its own last event left it; only its own events move it.
- Only an approaching pair collides, and an overlapping pair that approaches collides at once, so rounding can neither
  lose an impact nor tie a knot (Bannerman, Strobl, Formella and Poeschel, Comput. Part. Mech. 1, 191, 2014).
- A contact-time guard: an impact loses no energy when one of its discs had its last contact less than `contact_time`
  ago, so that inelastic collapse ends (Luding and McNamara, Granular Matter 1, 113, 1998).

The caller owns the arrays (`layout`); in order: `place`, `worst_overlap`, `schedule`, then `advance` and `read_out` as
often as wanted. Optional features are None and cost nothing: the compiler drops what is tested against None.
"""

import math

import numpy as np

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.events.calendar import begin_lap, due, earliest, fill, reschedule
from mpsim.kernels.events.cells import (
    enter_list,
    leave_list,
    link_cells,
    nearest_image,
    value_of,
    worst_overlap,
)
from mpsim.kernels.events.flight import add_to, advance_to, component, earliest_partner, is_finite, predict_border
from mpsim.kernels.events.friction import rub_discs, rub_wall
from mpsim.kernels.events.state import (
    BACKWARDS,
    BASE,
    BORDER,
    BOTTOM,
    COLUMN,
    COUNTED,
    CROSSINGS,
    DEFLECTIONS,
    EVENTS,
    FRAME,
    GUARDS,
    IMPACT,
    LAP,
    LAP_EVENTS,
    LAST,
    LEFT,
    NOT_FINITE,
    NOW,
    OUTSIDE,
    PAIRS,
    PARTNER,
    PARTNER_DEFLECTIONS,
    PAUSED,
    REACHED,
    RENEWALS,
    RIGHT,
    ROW,
    SIDE,
    SPENT,
    STALL,
    STALLED,
    STEP,
    STOPPED,
    TALLIES,
    TOP,
    VIRIAL,
    VIRIAL_XX,
    VIRIAL_XY,
    VX,
    VY,
    WALLS,
    Box,
    Law,
    Store,
    X,
    Y,
    layout,
    place,
    plan_cells,
    read_out,
)
from mpsim.kernels.machine import now

# What a caller needs is found here; the three other files are how it is done.
__all__ = [
    "BACKWARDS",
    "BOTTOM",
    "COUNTED",
    "CROSSINGS",
    "EVENTS",
    "FRAME",
    "GUARDS",
    "LEFT",
    "NOT_FINITE",
    "OUTSIDE",
    "PAIRS",
    "PAUSED",
    "REACHED",
    "RENEWALS",
    "RIGHT",
    "STALLED",
    "STOPPED",
    "TALLIES",
    "TOP",
    "VIRIAL",
    "VIRIAL_XX",
    "VIRIAL_XY",
    "WALLS",
    "Box",
    "Law",
    "Store",
    "advance",
    "advance_frames",
    "layout",
    "place",
    "plan_cells",
    "read_out",
    "schedule",
    "worst_overlap",
]

STOP_ROUNDING = 1e-12
"""Fraction of a time by which rounding may put a stop beyond the end of the frame that reaches it."""

# --- events ---


@inlined
def effective_restitution(restitution, i_last, j_last, now, law, counter):
    """The restitution of one impact, 1 where the guard acts (Luding and McNamara 1998)."""
    if restitution is None:
        return 1.0
    if now - max(i_last, j_last) < law.contact_time and restitution < 1.0:
        counter[GUARDS] += 1
        return 1.0
    return restitution


@inlined
def collide(i, j, now, store, box, law):
    """Impact of discs i and j at time `now`: momentum is kept, the normal velocity turns round times e.

    dp = -(1+e) m1 m2/(m1+m2) (u.n) n with n = r/|r|, written with r itself and r^2, so that energy is kept at
    rounding level however far rounding has left |r| from the contact distance.
    """
    disc = store.disc
    advance_to(disc, i, now, law.gravity)
    advance_to(disc, j, now, law.gravity)
    rx = nearest_image(disc[i, X] - disc[j, X], box.width, box.periodic_x)
    ry = nearest_image(disc[i, Y] - disc[j, Y], box.height, box.periodic_y)
    b = rx * (disc[i, VX] - disc[j, VX]) + ry * (disc[i, VY] - disc[j, VY])
    if b < 0.0:
        e = effective_restitution(law.restitution, disc[i, LAST], disc[j, LAST], now, law, store.counter)
        mass_i = value_of(store.mass, 1.0, i)
        mass_j = value_of(store.mass, 1.0, j)
        push = -(1.0 + e) * b / ((rx * rx + ry * ry) * (mass_i + mass_j))
        disc[i, VX] += push * mass_j * rx
        disc[i, VY] += push * mass_j * ry
        disc[j, VX] -= push * mass_i * rx
        disc[j, VY] -= push * mass_i * ry
        rub_discs(law.friction, i, j, rx, ry, push * mass_i * mass_j * math.sqrt(rx * rx + ry * ry), store, box)
        disc[i, LAST] = now
        disc[j, LAST] = now
        store.counter[PAIRS] += 1
        virial = -(1.0 + e) * b * mass_i * mass_j / (mass_i + mass_j)
        add_to(store.tally, VIRIAL, virial)
        add_to(store.tally, VIRIAL_XX, virial * rx * rx / (rx * rx + ry * ry))
        add_to(store.tally, VIRIAL_XY, virial * rx * ry / (rx * rx + ry * ry))
    store.event[i, DEFLECTIONS] += 1
    store.event[j, DEFLECTIONS] += 1


@inlined
def rebound(speed, acceleration, contact_time, gravity, counter):
    """Speed off a wall: never so small that gravity brings the disc back in less than `contact_time`.

    A disc at rest on a wall hovers in bounces of that duration, g contact_time^2/8 high at most, and the guard counts
    them. Without this it would hit the wall infinitely often in no time.
    """
    if gravity is None:
        return speed
    least = -0.5 * acceleration * contact_time
    if speed < least:
        counter[GUARDS] += 1
        return least
    return speed


@inlined
def hit_wall(i, now, side, store, box, law):
    """Impact of disc i, whose stored state is current, on a wall: its centre is put on the limit exactly."""
    disc = store.disc
    radius = value_of(store.radius, box.radius, i)
    axis = side >> 1
    high = side & 1
    length = box.width if axis == 0 else box.height
    inward = -1.0 if high else 1.0
    speed = -inward * disc[i, VX + axis]
    e = effective_restitution(law.wall_restitution, disc[i, LAST], disc[i, LAST], now, law, store.counter)
    leaving = rebound(
        e * abs(speed), inward * component(law.gravity, axis), law.contact_time, law.gravity, store.counter
    )
    disc[i, X + axis] = length - radius if high else radius
    disc[i, VX + axis] = inward * leaving
    rub_wall(law.wall_friction, i, axis, inward, speed + leaving, store, box)
    disc[i, LAST] = now
    store.event[i, DEFLECTIONS] += 1
    store.counter[WALLS] += 1
    add_to(store.tally, side, value_of(store.mass, 1.0, i) * (speed + leaving))


@inlined
def cross(i, side, store, box):
    """Disc i goes over to the neighbouring cell; through a periodic border its centre comes in opposite."""
    axis = side >> 1
    turn = 1 if side & 1 else -1
    event = store.event
    leave_list(i, event[i, ROW] * box.columns + event[i, COLUMN], store)
    cells = box.columns if axis == 0 else box.rows
    length = box.width if axis == 0 else box.height
    cell = event[i, COLUMN + axis] + turn
    if cell < 0 or cell >= cells:
        cell -= turn * cells
        store.disc[i, X + axis] -= turn * length
        add_to(store.winding, (i, axis), turn)
    event[i, COLUMN + axis] = cell
    enter_list(i, event[i, ROW] * box.columns + event[i, COLUMN], store)
    store.counter[CROSSINGS] += 1


@inlined
def block_to_search(i, side, event):
    """The cells to search for disc i: (first column, last column, first row, last row).

    The nine cells around it; right after it has crossed to `side` (-1: it has not) only the three ahead are new.
    """
    column = event[i, COLUMN]
    row = event[i, ROW]
    if side < 0:
        return column - 1, column + 1, row - 1, row + 1
    turn = 1 if side & 1 else -1
    if side < BOTTOM:
        return column + turn, column + turn, row - 1, row + 1
    return column - 1, column + 1, row + turn, row + turn


@inlined
def predict(i, now, side, deflected, store, box, law):
    """Predict the next event of disc i and enter it in the calendar.

    side: the border it has just crossed or -1; deflected: whether its stored state is new as of `now`.
    """
    disc = store.disc
    event = store.event
    first_column, last_column, first_row, last_row = block_to_search(i, side, event)
    wait, partner = earliest_partner(i, now, first_column, last_column, first_row, last_row, store, box, law.gravity)
    if side < 0 or now + wait < disc[i, IMPACT]:
        disc[i, IMPACT] = now + wait
        event[i, PARTNER] = partner
        if partner >= 0:
            event[i, PARTNER_DEFLECTIONS] = event[partner, DEFLECTIONS]
    if deflected:
        predict_border(i, store, box, law.gravity)
    reschedule(i, store)


@inlined
def is_wall(i, side, event, box):
    """Whether the border at `side` of the cell of disc i is a wall."""
    if side < BOTTOM:
        return not box.periodic_x and event[i, COLUMN] == (box.columns - 1 if side == RIGHT else 0)
    return not box.periodic_y and event[i, ROW] == (box.rows - 1 if side == TOP else 0)


@inlined
def stalled(t, store):
    """Whether far more events than can be legal have happened without time passing."""
    counter = store.counter
    counter[STALL] = counter[STALL] + 1 if t <= store.clock[NOW] else 0
    return counter[STALL] > 1_000_000 + 64 * store.disc.shape[0]


@inlined
def process_event(i, now, store, box, law):
    """The event of disc i at time `now`, and what it makes anew. Returns a disc that is not finite, or -1."""
    disc = store.disc
    event = store.event
    other = np.int64(-1)
    side = np.int64(-1)
    deflected = True
    if disc[i, IMPACT] < disc[i, BORDER]:
        other = np.int64(event[i, PARTNER])
        if event[other, DEFLECTIONS] == event[i, PARTNER_DEFLECTIONS]:
            collide(i, other, now, store, box, law)
            if not is_finite(disc, other):
                return other
        else:
            other = np.int64(-1)
            deflected = False
            store.counter[RENEWALS] += 1
    else:
        advance_to(disc, i, now, law.gravity)
        side = np.int64(event[i, SIDE])
        if is_wall(i, side, event, box):
            hit_wall(i, now, side, store, box, law)
            side = np.int64(-1)
        else:
            cross(i, side, store, box)
    if not is_finite(disc, i):
        return np.int64(i)
    while i >= 0:
        predict(i, now, side, deflected, store, box, law)
        i, other = other, np.int64(-1)
    return np.int64(-1)


@compiled
def advance(store, box, law, until, max_events):
    """Play events up to time `until` [time], at most about `max_events` of them: (status, particle).

    Stopping changes nothing: however a run is cut into calls, the events are the same bits. PAUSED: call again.
    NOT_FINITE, STALLED: the particle where it happened. BACKWARDS: `until` lies before the present.
    """
    clock = store.clock
    counter = store.counter
    if not until - clock[BASE] >= clock[NOW]:
        return BACKWARDS, -1
    budget = max_events
    while budget > 0:
        i = earliest(store)
        if i < 0:
            # A lap begins only when `until` lies beyond the one before: the laps do not depend on the stops.
            if clock[LAP] > until - clock[BASE]:
                return REACHED, -1
            begin_lap(store)
            budget -= 1 + store.disc.shape[0] // 16
            continue
        t = due(store.disc, i)
        if t > until - clock[BASE]:
            return REACHED, -1
        if stalled(t, store):
            return STALLED, store.order[i]
        clock[NOW] = t
        budget -= 1
        counter[EVENTS] += 1
        counter[LAP_EVENTS] += 1
        culprit = process_event(i, t, store, box, law)
        if culprit >= 0:
            return NOT_FINITE, store.order[culprit]
    return PAUSED, -1


# --- the start ---


@compiled
def schedule(store, box, law):
    """Predict the first event of every disc and fill the calendar. Call once, after `place`."""
    disc = store.disc
    energy = 0.0
    for i in range(disc.shape[0]):
        energy += disc[i, VX] * disc[i, VX] + disc[i, VY] * disc[i, VY]
    side = min(box.width / box.columns, box.height / box.rows)
    acceleration = abs(component(law.gravity, 0)) + abs(component(law.gravity, 1))
    speed = math.sqrt(energy / max(disc.shape[0], 1)) + math.sqrt(acceleration * side)
    # About four events while a disc crosses a cell; later laps fit the step to the true rate.
    wait = side / (4.0 * speed * max(disc.shape[0], 1)) if speed > 0.0 else 1.0
    store.clock[STEP] = math.ldexp(1.0, math.frexp(wait)[1])
    store.clock[LAP] = store.clock[STEP] * store.step_head.size
    fill(store)
    link_cells(store, box)
    for i in range(disc.shape[0]):
        predict(np.int64(i), 0.0, np.int64(-1), True, store, box, law)


@compiled
def advance_frames(store, box, law, dt, frames, max_events, stop, progress, seen, times, counts, timespec):
    """Play so many frames of length dt [time] more: (frames finished, status, particle).

    progress: int64, (2,): frames finished since the start, and the time [ns] spent so far on the one in hand; seen:
    the totals at the end of the last finished one, (COUNTED,). Both are kept here, because Ctrl-C may throw away what a
    call returns. times: int64 [ns], and counts: (frames, COUNTED), or (0, COUNTED) where they are not wanted: what
    `tally` holds, and pair impacts; written for each finished frame.
    PAUSED after about max_events events, perhaps inside a frame: call again with what is left. STOPPED at the time
    `stop` [time], inside a frame: also where only rounding puts it beyond the end of the frame, which ends after it.
    """
    end = store.counter[EVENTS] + max_events
    for frame in range(frames):
        started = now(timespec)
        until = (progress[FRAME] + 1) * dt
        stops = stop <= until * (1.0 + STOP_ROUNDING)
        status, particle = advance(store, box, law, stop if stops else until, end - store.counter[EVENTS])
        progress[SPENT] += now(timespec) - started
        if status == BACKWARDS:  # a stop has carried the clock a rounding beyond the end of the frame
            status = REACHED
        if status == REACHED and stops:
            return frame, STOPPED, particle
        if status != REACHED:
            return frame, status, particle
        times[frame] = progress[SPENT]
        for k in range(COUNTED):
            total = store.tally[k] if k < TALLIES else store.counter[PAIRS] * 1.0
            if frame < counts.shape[0]:
                counts[frame, k] = total - seen[k]
            seen[k] = total
        progress[SPENT] = 0
        progress[FRAME] += 1
    return frames, REACHED, -1
