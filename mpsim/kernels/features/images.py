"""Periodic axes: images of discs beyond a border, and how many periods each disc has moved through it.

With these counts, displacements have no end. Every disc's count is changed where its coordinate is wrapped, by the
worker that moves it, and by nobody else.
"""

import numpy as np

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.absorption import is_absent

FIELDS = {"wrap_x": "wrap_x", "wrap_y": "wrap_y", "image": "image"}
"""wrap_x, wrap_y: length of a periodic axis, shape (1,) [length].
image: shape (2, capacity), by id: periods that a disc has moved through each periodic border, int64."""

MOST_PERIODS = 2.0**53
"""Periods of one flight that are counted at most: below, they are whole numbers in float64."""


@inlined
def seen_from(coordinate, image):
    """A coordinate as seen by discs on the other side of a periodic border, `image` being the length to go back."""
    if image is None:
        return coordinate
    return coordinate - image


@inlined
def confined(coordinate, low, high, margin, wrap):
    """A coordinate kept between walls; along a periodic axis it is left alone until the next step begins."""
    if wrap is None:
        return min(max(coordinate, low + margin), high - margin)
    return coordinate


@inlined
def wrapped(coordinate, wrap):
    """A coordinate brought into [0, length) along a periodic axis. Doing it twice changes nothing."""
    if wrap is None:
        return coordinate
    coordinate -= wrap[0] * np.floor(coordinate / wrap[0])
    # Just below 0 the sum rounds to the length itself, and a flight of many lengths leaves rounding of either sign.
    if (coordinate < 0) | (coordinate >= wrap[0]):
        return wrap[0] - wrap[0]
    return coordinate


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
    if not is_absent(features.exits, disc):  # it will be put back
        count_periods(features.image, 0, disc, discs.x[i] + flight_x - x, features.wrap_x)
        count_periods(features.image, 1, disc, discs.y[i] + flight_y - y, features.wrap_y)


@compiled
def wrap_places(places, image, axis, wrap):
    """`wrapped` for each of many coordinates along an axis, in place; image, shape (2, N), is counted on."""
    for i in range(places.shape[0]):
        before = places[i]
        places[i] = wrapped(before, wrap)
        count_periods(image, axis, i, before - places[i], wrap)
