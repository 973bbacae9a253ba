"""Discs of different masses."""

import numpy as np

from mpsim.kernels.compiling import inlined

FIELDS = {"mass": "mass"}
"""mass: shape (capacity,), by id [mass]."""


@inlined
def mass_fraction(mass, disc, other, one):
    """2 m' / (m + m'): the share of `disc` in a change divided between a pair, 1 for equal masses (m' is the other's).

    In float64: rounded to float32, the same two fractions would miss the energy by as much at each collision of a pair.
    """
    if mass is None:
        return one
    return 2.0 * np.float64(mass[other]) / (np.float64(mass[disc]) + np.float64(mass[other]))
