"""What Python's fork server imports last: the first call of a kernel, with all that Numba loads in it, once for all."""

from contextlib import suppress

import numpy as np

from mpsim.kernels.waiting import load_word

with suppress(Exception):  # a worker that needs it says what is wrong
    load_word(np.zeros(1, np.int64), 0)
