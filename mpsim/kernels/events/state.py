"""The arrays of the exact solver: their sizes, and how particles are put in and read out.

Plain numpy: nothing in this file is compiled. The caller owns every array (`disc` should start on a multiple of 64
bytes, so that one disc is one cache line). Together they hold the whole state of a run: a copy is a checkpoint.
Discs are numbered inside by where they start in the box; `order` maps that number, `event.number`, to the
particle of the scene. In memory they start in that order, and are reordered as they move (ordering.py).
"""

import math
from collections import namedtuple

import numpy as np

from mpsim.kernels.events.boundary import are_inside, brought_back
from mpsim.kernels.events.calendar import steps_for
from mpsim.kernels.events.records import (
    CLOCK,
    COUNTER,
    DISC,
    ENTRY,
    EVENT,
    MOST_NEAR,
    NOT_FINITE,
    OUTSIDE,
    REACHED,
    TALLY,
    TURN,
)

Store = namedtuple(
    "Store", "disc event entry cell_head cell_next step_head heap near approach order clock counter tally region turn"
)
"""The arrays and records of `layout`; and the `region`, of a tile, None where the whole box is here."""

MADE_ANEW = ("entry", "cell_head", "cell_next", "step_head", "heap", "near", "approach", "turn")
"""Those that follow from the others, and from the box."""

KEPT = tuple(name for name in Store._fields if name not in (*MADE_ANEW, "region"))
"""Those that a copy of the state needs."""


def layout(count, cells):
    """The arrays for a run of so many discs: name -> (dtype, shape); shape () is a record. cells: (columns, rows)."""
    return {
        "disc": (DISC, (count,)),
        "event": (EVENT, (count,)),
        "entry": (ENTRY, (count,)),
        "cell_head": (np.int32, (cells[0] * cells[1],)),
        "cell_next": (np.int32, (count,)),
        "step_head": (np.int32, (steps_for(count),)),
        "heap": (np.int32, (count,)),
        "near": (np.int32, (MOST_NEAR + 1,)),
        "approach": (np.float64, (MOST_NEAR + 1, 3)),
        "order": (np.int32, (count,)),
        "clock": (CLOCK, ()),
        "counter": (COUNTER, ()),
        "tally": (TALLY, ()),
        "turn": (TURN, ()),
    }


def store_of(arrays):
    """The store of the whole box, from arrays and records by name."""
    return Store(**{name: arrays.get(name) for name in Store._fields})


def first_misplaced(position, velocity, radius, box):
    """The first particle that is not finite, faster than 1e100, or outside the box: (status, particle)."""
    good = np.isfinite(position).all(axis=1) & (np.abs(velocity) < 1e100).all(axis=1)
    if not good.all():
        return NOT_FINITE, int(np.argmin(good))
    for axis in range(2):
        inside = are_inside(position[:, axis], radius, axis, box)
        if not inside.all():
            return OUTSIDE, int(np.argmin(inside))
    return REACHED, -1


def place(position, velocity, columns, time, store, box, features):
    """Put particles into the store at `time`: (status, particle), REACHED or the error and its particle.

    position [length], velocity [length/time]: (N, 2). columns: of the arrays of `features`, by name, in the order of
    the particles. `solver.schedule` must follow.
    """
    radius = box.radius if features.radius is None else columns["radius"]
    status, particle = first_misplaced(position, velocity, radius, box)
    if status != REACHED:
        return status, particle
    column = np.clip((position[:, 0] * (box.columns / box.width)).astype(np.int64), 0, box.columns - 1)
    row = np.clip((position[:, 1] * (box.rows / box.height)).astype(np.int64), 0, box.rows - 1)
    order = np.argsort(row * box.columns + column, kind="stable")
    for name in layout(0, (1, 1)):
        np.asarray(getattr(store, name))[...] = 0
    store.order[:] = order
    store.disc["position"] = position[order]
    store.disc["velocity"] = velocity[order]
    store.disc["last_contact"] = -math.inf
    store.event["number"] = np.arange(len(order))
    store.event["cell"] = np.stack([column[order], row[order]], axis=1)
    for name, values in columns.items():
        getattr(features, name)[:] = values[order]
    store.clock.origin = time
    return REACHED, -1


def read_out(store, box, features, until, columns=()):
    """Position, velocity and these columns at time `until`, by name, in the order of the particles.

    `until` is the time that `solver.advance` has reached. The state is not touched.
    """
    disc = store.disc
    flight = (until - store.clock.origin) - disc["last_update"]
    if features.exits is not None:
        flight[features.exits[:, 0] != 0] = 0.0
    radius = box.radius if features.radius is None else features.radius
    found = {name: getattr(features, name).copy() for name in columns}
    found |= {"position": np.empty((len(disc), 2)), "velocity": np.empty((len(disc), 2))}
    for axis in range(2):
        speed = disc["velocity"][:, axis]
        gain = 0.0 if features.gravity is None else features.gravity[axis] * flight
        flown = disc["position"][:, axis] + flight * (speed + 0.5 * gain)
        found["position"][:, axis], periods = brought_back(flown, radius, axis, box)
        found["velocity"][:, axis] = speed + gain
        if "image" in found:
            found["image"][:, axis] += periods
    place = np.empty_like(store.order)
    place[store.order[store.event["number"]]] = np.arange(len(disc))
    return {name: values[place] for name, values in found.items()}
