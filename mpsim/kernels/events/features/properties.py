"""Radii and masses: one for each disc, or one for all."""

from mpsim.kernels.compiling import inlined, value_or

FIELDS = {"radius": None, "mass": None}
"""radius [length], mass [mass]: shape (N,)."""


@inlined
def radius_of(i, box, features):
    """Radius of disc i [length]."""
    return value_or(features.radius, i, box.radius)


@inlined
def mass_of(i, features):
    """Mass of disc i [mass], 1 if all have the same."""
    return value_or(features.mass, i, 1.0)
