"""Which discs are too fast for the next step: detected as they move; the fastest one is reported.

The test whether any disc of a slice is beyond the limit has no branch and no order, so that it becomes vector code.
Only if one is are the discs examined one by one.
"""

import math

import numpy as np

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.layout import FASTEST_SCALE
from mpsim.kernels.optional import slice_of, value_or
from mpsim.kernels.records import real

MOST = 2.0**40
"""Largest speed that is reported, in units of the limit: more does not fit the word."""


@linked
def any_fast(discs, low, high, parameters):
    """Whether a disc of a slice is beyond the limit. A value that is not finite is not."""
    vx, vy, radius = discs.vx[low:high], discs.vy[low:high], slice_of(discs.radius, low, high)
    limit, one = parameters.fast, real(parameters, 1)
    fast = False
    for i in range(high - low):
        own = value_or(radius, i, one)
        fast |= vx[i] * vx[i] + vy[i] * vy[i] > limit * (own * own)
    return fast


@linked
def note_fastest(discs, low, high, parameters, mine):
    """Record the disc of a slice that is farthest beyond the limit; among equals, the one with the lowest number."""
    limit = np.float64(parameters.fast)
    for i in range(low, high):
        vx, vy, own = np.float64(discs.vx[i]), np.float64(discs.vy[i]), np.float64(value_or(discs.radius, i, 1.0))
        square = vx * vx + vy * vy
        if square > limit * own * own:
            ratio = MOST
            if square < MOST * MOST * limit * own * own:
                ratio = math.sqrt(square / (limit * own * own))
            scaled = np.int64(ratio * FASTEST_SCALE)
            if scaled > mine.fastest or (scaled == mine.fastest and discs.id[i] < mine.fastest_disc):
                mine.fastest, mine.fastest_disc = scaled, discs.id[i]


@inlined
def end_where_fast(discs, low, high, parameters, control, mine):
    """Make this frame the last of the command if a disc of the slice is too fast for the next step.

    Called by all workers before they move their slices. They all write the same number, and no worker compares with it
    before the barriers of this frame, or it sees that this frame is still to be run.
    """
    if parameters.fast < math.inf and any_fast(discs, low, high, parameters):
        note_fastest(discs, low, high, parameters, mine)
        control.frames = mine.frame + 1
