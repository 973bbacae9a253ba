"""Work of surfaces that move: the impulse on a disc times the velocity of the surface's material where they touch.

Sums in fixed point: a number is split into whole units and 2^-32 of one, so that sums are the same in any order.
"""

import math
from collections import namedtuple
from collections.abc import Mapping
from typing import Any

import numpy as np

from mpsim.kernels.compiling import inlined, value_or

WALLS = 4
"""Owners of sums: the walls of the box by edge (LEFT, ...), and then the obstacles in the order of the scene."""

NEW, AGREED = range(2)
"""Sums that may still be taken back, by tiles of the exact solver that do not agree, and those that stay."""

PART_BITS = 32
PARTS = np.int64(1) << PART_BITS
MASK = PARTS - 1

Work: Any = namedtuple("Work", "sum unit")
"""sum: of one worker, int64, shape (2, 2, owners): NEW and AGREED, whole units and parts. unit: a power of two, shape
(1,) [mass length^2/time^2]."""

SUM, UNIT = "work", "work_unit"
"""Names of the arrays, with the sums of all workers, shape (workers, 2, 2, owners)."""

FIELDS = {"work": None}


def work_of(arrays: Mapping[str, Any], worker: int) -> Any:
    """The `Work` of one worker, from arrays by name; None if nothing moves."""
    return Work(arrays[SUM][worker], arrays[UNIT]) if SUM in arrays else None


@inlined
def add_units(work, which, owner, whole, parts):
    """Add so many units and parts to a sum."""
    parts += work.sum[which, 1, owner]
    work.sum[which, 0, owner] += whole + (parts >> PART_BITS)
    work.sum[which, 1, owner] = parts & MASK


@inlined
def add(work, owner, energy):
    """Add the work of one contact on a disc [mass length^2/time^2]."""
    if work is not None:  # noqa: SIM102
        if energy != 0.0:
            scaled = energy / work.unit[0]
            whole = math.floor(scaled)
            add_units(work, NEW, owner, np.int64(whole), np.int64((scaled - whole) * PARTS))


@inlined
def on_disc(work, owner, disc, power, mass):
    """Add the work of a contact with a disc of this id; power: change of its velocity times that of the surface."""
    if work is not None:
        add(work, owner, np.float64(power) * np.float64(value_or(mass, disc, 1.0)))


@inlined
def agree(work):
    """Keep what has been added so far: `take_back` does not remove it."""
    if work is not None:
        for owner in range(work.sum.shape[2]):
            add_units(work, AGREED, owner, work.sum[NEW, 0, owner], work.sum[NEW, 1, owner])
            work.sum[NEW, 0, owner] = work.sum[NEW, 1, owner] = 0


@inlined
def take_back(work):
    """Forget what was added since `agree`."""
    if work is not None:
        work.sum[NEW] = 0
