"""Nearest images of a disc at a periodic border, for exact impacts and for placement."""

from mpsim.kernels.compiling import inlined


@inlined
def nearest_image(difference, length, periodic):
    """One component of the relative position of the nearest image."""
    if periodic and difference > 0.5 * length:
        return difference - length
    if periodic and difference < -0.5 * length:
        return difference + length
    return difference
