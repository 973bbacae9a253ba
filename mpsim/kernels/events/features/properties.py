"""Radii, masses, counts of periods: one for each disc; and gravity."""

from mpsim.kernels.compiling import inlined, value_or
from mpsim.kernels.events.records import mixed

# --- Counts of periods: how often each disc has left through a periodic border, so that its path can be unwrapped


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


# --- Gravity: one acceleration for all discs, so that their relative motion stays uniform


@inlined
def component(gravity, axis):
    """One component of the acceleration [length/time^2]."""
    if gravity is None:
        return 0.0
    return gravity[axis]


# --- Radii and masses: one for each disc, or one for all


@inlined
def radius_of(i, box, features):
    """Radius of disc i [length]."""
    return value_or(features.radius, i, box.radius)


@inlined
def mass_of(i, features):
    """Mass of disc i [mass], 1 if all have the same."""
    return value_or(features.mass, i, 1.0)


FIELDS = ("image", "gravity", "radius", "mass")
"""gravity: (gx, gy) [length/time^2]."""
