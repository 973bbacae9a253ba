"""Random numbers computed from their use: seed, disc, frame and a count of draws.

There is no state, so a number depends neither on the order of discs nor on the worker that draws it. The generator is
Philox4x32-10 (Salmon, Moraes, Dror and Shaw, Proc. SC11, 2011). Only + - * / and sqrt are
applied to its numbers: the same bits on every machine. Words are uint64 numbers below 2^32: no product overflows.
"""

import math

import numpy as np

from mpsim.kernels.compiling import inlined, linked

WORD, HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
FACTOR_A, FACTOR_B = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
WEYL_A, WEYL_B = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
ROUNDS = 10

UP, DOWN = np.uint64(21), np.uint64(11)
UNIT = 2.0**-53

LN_2 = 0.6931471805599453
ROOT_HALF = 0.7071067811865476
TERMS = 10


@inlined
def words(seed, a, b, c, d):
    """Four words from the counter of four words a, b, c, d, and a seed below 2^64."""
    key_a, key_b = seed & WORD, seed >> HALF
    for _ in range(ROUNDS):
        one, two = FACTOR_A * a, FACTOR_B * c
        a, b, c, d = (two >> HALF) ^ b ^ key_a, two & WORD, (one >> HALF) ^ d ^ key_b, one & WORD
        key_a, key_b = (key_a + WEYL_A) & WORD, (key_b + WEYL_B) & WORD
    return a, b, c, d


@inlined
def uniform(high, low):
    """A number in [0, 1) from two words, a multiple of 2^-53."""
    return np.float64((high << UP) ^ (low >> DOWN)) * UNIT


@inlined
def pair(seed, disc, frame, draw):
    """Two numbers in [0, 1), for a disc and a frame >= 0, below 2^64; draw: number of the pair, below 2^32."""
    counter = np.uint64(frame)
    a, b, c, d = words(np.uint64(seed), np.uint64(disc), np.uint64(draw), counter & WORD, counter >> HALF)
    return uniform(a, b), uniform(c, d)


@linked
def logarithm(x):
    """ln x of a number in (0, 1], to 2 roundings: of x = m 2^e by ln m = 2 artanh((m - 1) / (m + 1))."""
    mantissa, exponent = math.frexp(x)
    if mantissa < ROOT_HALF:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    t = (mantissa - 1.0) / (mantissa + 1.0)
    square, total = t * t, 0.0
    for k in range(TERMS, -1, -1):
        total = total * square + 1.0 / (2.0 * k + 1.0)
    return 2.0 * t * total + exponent * LN_2


@linked
def normal_pair(seed, disc, frame, draw):
    """Two independent normal numbers of mean 0 and variance 1, from the uniform pairs `draw`, `draw` + 1, ...

    The polar method (Marsaglia and Bray, SIAM Rev. 6, 260, 1964): points in a square, until one lies in the circle.
    """
    while True:
        one, two = pair(seed, disc, frame, draw)
        x, y = 2.0 * one - 1.0, 2.0 * two - 1.0
        square = x * x + y * y
        if 0.0 < square < 1.0:
            scale = math.sqrt(-2.0 * logarithm(square) / square)
            return x * scale, y * scale
        draw += 1


# --- velocities at thermal walls

MANTISSA = 2.0**53
APART = 2**20
"""Draws after which another pair of normal numbers begins: never are so many points outside the circle."""


@inlined
def digits(value):
    """The digits of a real number, as a whole number."""
    fraction, _ = math.frexp(abs(value))
    return np.uint64(np.int64(fraction * MANTISSA))


@inlined
def seed_of(seed, one, other):
    """A new seed, from a seed and the digits of two real numbers."""
    a, b = digits(one), digits(other)
    high, low, _, _ = words(np.uint64(seed), a & WORD, a >> HALF, b & WORD, b >> HALF)
    return (high << HALF) ^ low


@linked
def wall_velocity(seed, disc, place, came, slid):
    """Velocity of a disc that leaves a wall at temperature m: speed along the normal > 0, tangential velocity.

    The first has the density v exp(-v^2 / 2), as has the length of a pair of normal numbers; the second is normal. They
    follow from the velocity at which it arrived, along the normal and across, and from its place along the wall. So no
    count of contacts is needed, which would have to be the same for any number of workers.
    """
    own, where = seed_of(seed, came, slid), digits(place)
    x, y = normal_pair(own, disc, where, 0)
    across, _ = normal_pair(own, disc, where, APART)
    return math.sqrt(x * x + y * y), across
