"""The exact solver: event-driven molecular dynamics of hard discs, in float64.

Discs fly freely (a straight line, or one parabola shared by all of them) from impact to impact, and the solver jumps
from event to event in the order of time. The only approximation is the rounding of float64.

- One prediction per disc: its earliest impact with another disc, and the time it leaves its cell or meets a wall. If
  the partner has been deflected in the meantime, its count of collisions shows it when the impact is due, and the
  impact is predicted anew (Lubachevsky, J. Comput. Phys. 94, 255, 1991).
- Lazy positions: a disc is stored where and when its own last event left it; only its own events move it.
- Only an approaching pair collides, and an overlapping pair that approaches collides at once, so rounding can neither
  lose an impact nor cause endless ones (Bannerman, Strobl, Formella and Poeschel, Comput. Part. Mech. 1, 191, 2014).
- A guard ends inelastic collapse (`features/laws.py`).

The caller owns the arrays (`cells.layout`); in order: `cells.place`, the tasks OVERLAP and SCHEDULE, then PLAY and
`cells.read_out` as often as needed. All tasks are one kernel, `run_events`, compiled once for a scene. What only some
scenes need is in `features/hooks.py`.
"""

import math
from collections import namedtuple

import numpy as np

from mpsim.kernels.compiling import compiled, inlined, linked
from mpsim.kernels.events.calendar import begin_turn, due, earliest, fit_lap, shift_times
from mpsim.kernels.events.cells import (
    cell_of,
    cross,
    deepest_overlap,
    is_disordered,
    is_wall,
    leave_store,
    link_cells,
    order_in_space,
    particle_of,
)
from mpsim.kernels.events.features.edges import is_crushed
from mpsim.kernels.events.features.hooks import with_columns
from mpsim.kernels.events.features.laws import heat, is_heated
from mpsim.kernels.events.features.properties import component
from mpsim.kernels.events.flight import advance_to, is_finite
from mpsim.kernels.events.impacts import collide, hit_surface, hit_wall, predict
from mpsim.kernels.events.records import (
    BACKWARDS,
    BANDS,
    ELSEWHERE,
    ENTRIES,
    MIDDLE,
    NOT_FINITE,
    PAUSED,
    PROGRESS,
    REACHED,
    STALLED,
    STOPPED,
    TOTALS,
    band_along,
    begin_event,
    counts,
    mixed,
    number_of_partner,
)
from mpsim.kernels.features.collisions import agree, begin_span, is_full, take_back
from mpsim.kernels.machine import now

# --- Hash sums of the events in bands along the borders of a tile, with which neighbouring tiles are compared
#
# Each event in a band adds a hash of the disc after it: state, counts and predictions. A sum does not depend on the
# order of events; equal sums mean equal histories, except in one case in 2^64.

Watch = namedtuple("Watch", "bits seen")
"""bits: the records of the discs as whole numbers, shape (N, 8); seen: sums by band, shape (25,)."""


@inlined
def digest_of(i, bits, store, features):
    """A hash of everything that can change in disc i, wherever it lies in memory."""
    event = store.event[i]
    digest = np.int64(event.number)
    for k in range(bits.shape[1]):
        digest = mixed(digest, bits[i, k])
    digest = mixed(digest, number_of_partner(event.partner, store.event))
    digest = mixed(digest, np.int64(event.partner_collision_count))
    digest = mixed(digest, np.int64(event.collision_count))
    digest = mixed(digest, np.int64(event.side))
    digest = mixed(digest, np.int64(event.cell[0]))
    digest = mixed(digest, np.int64(event.cell[1]))
    return with_columns(digest, features.spin, features.image, i)


@inlined
def watch_disc(watch, i, store, box, features):
    """Add disc i, as an event has just left it, to the sums of its bands."""
    if watch is not None:
        cell = store.event[i].cell
        column, row = band_along(0, cell[0], store.region, box), band_along(1, cell[1], store.region, box)
        if column != ELSEWHERE and row != ELSEWHERE and (column != MIDDLE or row != MIDDLE):
            watch.seen[column * BANDS + row] += digest_of(i, watch.bits, store, features)


STOP_ROUNDING = 1e-12
"""Fraction of a time by which rounding may put a stop beyond the end of the frame that reaches it."""

MOST_AT_ONCE = 1_000_000
"""Events without time passing, beside some for each disc, that are more than can be legal."""


@linked
def fill_calendar(store, box, features):
    """Predict the first event of every disc and fill the calendar."""
    disc = store.disc
    energy = 0.0
    for i in range(disc.shape[0]):
        vx = disc[i].velocity[0]
        vy = disc[i].velocity[1]
        energy += vx * vx + vy * vy
    cell_length = min(box.width / box.columns, box.height / box.rows)
    acceleration = abs(component(features.gravity, 0)) + abs(component(features.gravity, 1))
    speed = math.sqrt(energy / max(disc.shape[0], 1)) + math.sqrt(acceleration * cell_length)
    # About four events while a disc crosses a cell; later laps fit the step to the true rate.
    wait = cell_length / (4.0 * speed * max(disc.shape[0], 1)) if speed > 0.0 else 1.0
    store.clock.step = math.ldexp(1.0, math.frexp(wait)[1])
    store.clock.lap = store.clock.step * store.step_head.size
    store.counter.lap_events = 0
    begin_turn(0.0, store.clock.lap, store)
    link_cells(store, box, features)
    for i in range(disc.shape[0]):
        predict(np.int64(i), 0.0, np.int64(-1), True, store, box, features)


# --- one event after another ------------------------------------------------------------------------------------


@inlined
def begin_lap(store, box, features):
    """Begin a lap of the calendar, with discs in a good order in memory."""
    for i in range(store.disc.shape[0]):
        shift_times(store.disc[i], store.clock.lap)
    fit_lap(store)
    if is_disordered(store, box):
        order_in_space(store, box, features)
    begin_turn(0.0, store.clock.lap, store)


@inlined
def stalled(t, most, store):
    """Whether more events than possible have happened without time passing: `most`, and some for each disc."""
    counter = store.counter
    counter.stall = counter.stall + 1 if t <= store.clock.now else 0
    return counter.stall > most + 64 * store.disc.shape[0]


@inlined
def process_event(i, now, store, box, features, watch):
    """Process the event of disc i at time `now`, and predict anew. Returns a disc that cannot be followed, or -1."""
    disc = store.disc
    event = store.event
    other = np.int64(-1)
    side = np.int64(-1)
    deflected = True
    begin_event(event[i].cell, store.region, box)
    store.counter.events += counts(store.region)
    store.counter.lap_events += counts(store.region)
    if disc[i].collision_time < disc[i].crossing_time:
        other = np.int64(event[i].partner)
        if other >= 0 and event[other].collision_count == event[i].partner_collision_count:
            collide(i, other, now, store, box, features)
            if not is_finite(disc[other]):
                return other
        else:
            other = np.int64(-1)
            deflected = False
            store.counter.stale_predictions += counts(store.region)
    else:
        advance_to(disc[i], now, features.gravity)
        side = np.int64(event[i].side)
        met = hit_surface(i, now, side, store, box, features)
        if not met and is_wall(side, event[i].cell, box):
            hit_wall(i, now, side, store, box, features)
            met = True
        if met:
            if is_crushed(features.crushing_speed, disc[i]):
                return np.int64(i)
            side = np.int64(-1)
        else:
            cross(i, side, store, box, features)
            if cell_of(i, store, box) < 0:
                leave_store(i, store)
                return np.int64(-1)
    if not is_finite(disc[i]):
        return np.int64(i)
    while i >= 0:
        predict(i, now, side, deflected, store, box, features)
        watch_disc(watch, i, store, box, features)
        i, other = other, np.int64(-1)
    return np.int64(-1)


@linked
def advance(store, box, features, until, max_events):
    """Process events up to time `until` [time], at most about `max_events` of them: (status, particle).

    Stopping changes nothing: a run divided into calls in any way has the same bits. PAUSED: call again, once
    the log of collisions has been emptied, if there is one.
    NOT_FINITE (or crushed), STALLED: the particle where it happened. BACKWARDS: `until` lies before the present.
    """
    clock = store.clock
    if not until - clock.origin >= clock.now:
        return BACKWARDS, -1
    budget = max_events
    while budget > 0 and not is_full(features.log):
        i = earliest(store)
        if i < 0:
            # A lap begins only when `until` lies beyond the one before: the laps do not depend on the stops.
            if store.turn.end > until - clock.origin:
                return REACHED, -1
            begin_lap(store, box, features)
            budget -= 1 + store.disc.shape[0] // 16
            continue
        t = due(store.disc, i)
        if t > until - clock.origin:
            return REACHED, -1
        if stalled(t, MOST_AT_ONCE, store):
            return STALLED, particle_of(i, store)
        clock.now = t
        budget -= 1
        culprit = process_event(i, t, store, box, features, None)
        if culprit >= 0:
            return NOT_FINITE, particle_of(culprit, store)
    return PAUSED, -1


# --- one frame after another ------------------------------------------------------------------------------------


@inlined
def write_totals(totals, store):
    """Write what has been counted since the start into a record of TOTALS."""
    for entry in range(ENTRIES):
        totals.coarse[entry] = store.tally.coarse[entry]
        totals.fine[entry] = store.tally.fine[entry]
    totals.collisions = store.counter.pairs


@linked
def after_frame(thermostat, time, frame, store, box, features):
    """At the end of so many frames, if there is a thermostat: heat discs, then predict their events anew."""
    if thermostat is None:
        return
    clock = store.clock
    clock.now = max(time - clock.origin, clock.now)
    for i in range(store.disc.shape[0]):
        heat(thermostat, i, particle_of(i, store), clock.now, frame, store, features)
    for i in range(store.disc.shape[0]):
        if is_heated(thermostat, i, particle_of(i, store), frame, features):
            begin_event(store.event[i].cell, store.region, box)
            predict(np.int64(i), clock.now, np.int64(-1), True, store, box, features)


@linked
def play_frames(store, box, features, dt, frames, max_events, stop, progress, seen, times, totals, timespec):
    """Run so many more frames of length dt [time]: (frames finished, status, particle).

    progress: PROGRESS, and seen: TOTALS, at the end of the last finished one. Both are written here, because Ctrl-C may
    discard what a call returns. times: int64 [ns], and totals: TOTALS, (frames,), or (0,) if they are not needed;
    written for each finished frame.
    PAUSED after about max_events events, perhaps inside a frame: call again for the rest. STOPPED at the time `stop`
    [time], inside a frame; also if only rounding puts it beyond the end of the frame, which ends after it.
    """
    end = store.counter.events + max_events
    for frame in range(frames):
        started = now(timespec)
        begin_span(features.log, progress.frame)
        until = (progress.frame + 1) * dt
        stops = stop <= until * (1.0 + STOP_ROUNDING)
        status, particle = advance(store, box, features, stop if stops else until, end - store.counter.events)
        progress.spent += now(timespec) - started
        if status == BACKWARDS:  # a stop has moved the clock beyond the end of the frame by rounding
            status = REACHED
        if status == REACHED and stops:
            return frame, STOPPED, particle
        if status != REACHED:
            return frame, status, particle
        after_frame(features.thermostat, until, progress.frame + 1, store, box, features)
        times[frame] = progress.spent
        if frame < totals.shape[0]:
            write_totals(totals[frame], store)
        write_totals(seen, store)
        progress.spent = 0
        progress.frame += 1
    return frames, REACHED, -1


# --- what Python calls ------------------------------------------------------------------------------------------

OVERLAP, SCHEDULE, PLAY, RELINK = range(4)


@compiled
def run_events(
    task, store, box, features, dt, frames, max_events, stop, progress, seen, times, totals, timespec
):  # fmt: skip
    """One kernel for all tasks, as their machine code has most in common: two whole numbers and a real one."""
    if task == OVERLAP:
        return deepest_overlap(store, box, features)
    if task == SCHEDULE:
        fill_calendar(store, box, features)
        return 0, REACHED, -1.0
    if task == RELINK:
        link_cells(store, box, features)  # the order of events is total: where the calendar keeps one cannot matter
        begin_turn(max(store.clock.now, 0.0), store.clock.lap, store)  # a lap that has just begun may lie ahead
        return 0, REACHED, -1.0
    take_back(features.log, features.work)  # of a window on tiles that was left
    finished, status, particle = play_frames(
        store, box, features, dt, frames, max_events, stop, progress, seen, times, totals, timespec
    )
    agree(features.log, features.work)
    return finished, status, float(particle)


def run_task(task, store, box, features):
    """Do a task in which no frame is played: find the deepest OVERLAP, SCHEDULE after `cells.place`, or RELINK."""
    return run_events(task, store, box, features, *nothing_to_play())


def nothing_to_play():
    """Arguments of `run_events` behind `features`, for no frame; the last six serve for one frame, too."""
    progress, seen = np.zeros((), PROGRESS)[()], np.zeros((), TOTALS)[()]
    return 0.0, 0, 0, math.inf, progress, seen, np.zeros(1, np.int64), np.zeros(0, TOTALS), np.zeros(2, np.int64)
