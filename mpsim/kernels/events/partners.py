"""Predicted partners: by place in memory where they are in a store, else by number."""

import numpy as np

from mpsim.kernels.compiling import inlined


@inlined
def elsewhere(number):
    """What stands for a partner of this number that is not in a store; and back."""
    return -2 - number


@inlined
def number_of_partner(partner, event):
    """The number of a predicted partner, here or elsewhere; -1 where there is none."""
    if partner >= 0:
        return np.int64(event[partner].number)
    return np.int64(partner) if partner == -1 else elsewhere(np.int64(partner))
