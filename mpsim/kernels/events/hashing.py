"""A hash of a sequence of numbers, with which two tiles compare their results."""

import math

import numpy as np

from mpsim.kernels.compiling import inlined

FACTOR = np.int64(0x2545F4914F6CDD1D)
MANTISSA = 2.0**53


@inlined
def mixed(digest, value):
    """A hash with one more whole number added."""
    digest = (digest ^ value) * FACTOR
    return digest ^ (digest >> 29)


@inlined
def mixed_real(digest, value):
    """The same, with a real number."""
    fraction, exponent = math.frexp(value)
    return mixed(mixed(digest, np.int64(fraction * MANTISSA)), np.int64(exponent))
