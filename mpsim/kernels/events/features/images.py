"""Counts of periods: how often each disc has left through a periodic border, so that its path can be unwrapped."""

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.records import mixed

FIELDS = {"image": None}
"""image: shape (N, 2), periods along x and y, int64; where an axis is periodic."""


@inlined
def with_periods(digest, image, i):
    """A hash that includes the counts of disc i, if there are any."""
    if image is not None:
        return mixed(mixed(digest, image[i, 0]), image[i, 1])
    return digest


@inlined
def through_border(image, i, axis, direction):
    """Disc i has left through a periodic border, upward (direction = 1) or downward (-1) along the axis."""
    if image is not None:
        image[i, axis] += direction
