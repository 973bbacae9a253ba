"""Predicted partners: by place in memory if they are in the store, else by number."""

import numpy as np

from mpsim.kernels.compiling import inlined


@inlined
def elsewhere(number):
    """The code for the number of a partner that is not in the store; also its inverse."""
    return -2 - number


@inlined
def number_of_partner(partner, event):
    """The number of a predicted partner, here or elsewhere; -1 if there is none."""
    if partner >= 0:
        return np.int64(event[partner].number)
    return np.int64(partner) if partner == -1 else elsewhere(np.int64(partner))
