"""Counts of the periods that discs have moved through periodic borders: with them, displacements have no end.

Every disc's count is changed where its coordinate is wrapped, by the worker that moves it, and by nobody else.
"""

import numpy as np

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.absorption import is_gone
from mpsim.kernels.optional import wrapped

MOST_PERIODS = 2.0**53
"""Periods of one flight that are counted at most: below, they are whole numbers in float64."""


@inlined
def count_periods(image, axis, disc, taken, wrap):
    """Count the periods that wrapping has taken off a coordinate: `taken` is that length [length].

    So coordinate + image * length has no jump, also where `wrapped` puts a disc just below 0 at 0. A flight that is not
    finite, or so long that no digit of the place in the box is left, is not counted.
    """
    if wrap is not None:  # noqa: SIM102 - a test of its own, which the compiler drops
        if taken != 0:
            periods = np.rint(taken / wrap[0])
            if abs(periods) < MOST_PERIODS:
                image[axis, disc] += np.int64(periods)


@inlined
def count_flight(discs, i, x, y, flight_x, flight_y, features):
    """Count the periods of the disc in slot i, which a flight from its stored place has brought to (x, y)."""
    disc = discs.id[i]
    if not is_gone(features.exits, disc):  # it will be put back
        count_periods(features.image, 0, disc, discs.x[i] + flight_x - x, features.wrap_x)
        count_periods(features.image, 1, disc, discs.y[i] + flight_y - y, features.wrap_y)


@compiled
def wrap_places(places, image, axis, wrap):
    """`wrapped` for each of many coordinates along an axis, in place; image, shape (2, N), is counted on."""
    for i in range(places.shape[0]):
        before = places[i]
        places[i] = wrapped(before, wrap)
        count_periods(image, axis, i, before - places[i], wrap)
