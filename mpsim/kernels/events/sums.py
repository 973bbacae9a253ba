"""Sums of real numbers in fixed point, which do not depend on the order of the terms.

A number is split into whole multiples of a unit and of 2^-33 of it. The sum is `coarse` units and
0 <= `fine` < 2^33, so equal sums have equal numbers.
"""

import math

import numpy as np

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.records import ENTRIES, FINE

CARRY = np.int64(1) << FINE
MASK = CARRY - 1


@inlined
def add(tally, entry, value, unit):
    """Add a number to an entry of a tally; unit: a power of two, in the unit of the number."""
    scaled = value / unit
    whole = math.floor(scaled)
    add_parts(tally, entry, np.int64(whole), np.int64((scaled - whole) * CARRY))


@inlined
def add_parts(tally, entry, coarse, fine):
    """Add so many coarse and fine units to an entry of a tally."""
    fine += tally.fine[entry]
    tally.coarse[entry] += coarse + (fine >> FINE)
    tally.fine[entry] = fine & MASK


@inlined
def add_tally(tally, other):
    """Add all entries of another tally."""
    for entry in range(ENTRIES):
        add_parts(tally, entry, other.coarse[entry], other.fine[entry])


@inlined
def clear_tally(tally):
    """Set all entries to zero."""
    for entry in range(ENTRIES):
        tally.coarse[entry] = tally.fine[entry] = 0
