"""CRC-32 of a file from the CRCs of its parts, which different processes write.

A CRC-32 is the rest of a division of polynomials over {0, 1} by P, of degree 32. Bytes b take the register s to
U(s, b), and as that is linear in both, U(s, b) = U(t, b) + (s + t) x^(8 len(b)) mod P, where + is exclusive or. The
register begins with ones, and crc(b) = ~U(~0, b). For a followed by b the register is s = ~crc(a) once a is in, so

    crc(a b) = ~U(~crc(a), b) = ~(U(~0, b) + (~crc(a) + ~0) x^(8 len(b))) = crc(b) + crc(a) x^(8 len(b)) mod P.
"""

import functools
from collections.abc import Iterable

_P = 0xEDB88320
"""The polynomial without x^32. The highest bit of a number of 32 bits is the coefficient of 1, the lowest of x^31."""

_ONE, _X = 1 << 31, 1 << 30


def joined(parts: Iterable[tuple[int, int]]) -> int:
    """CRC-32 of parts one after the other; of each its CRC-32, as `zlib.crc32` has it, and its length in bytes.

    >>> import zlib
    >>> joined([(zlib.crc32(b"hard "), 5), (zlib.crc32(b"discs"), 5)]) == zlib.crc32(b"hard discs")
    True
    """
    whole = 0  # of nothing
    for crc, length in parts:
        whole = crc ^ _product(whole, _power_of_x(8 * length))
    return whole


def _product(a: int, b: int) -> int:
    """The product mod P, by Horner's rule from the highest coefficient of a, which is its lowest bit."""
    product = 0
    for bit in range(32):
        product = _times_x(product) ^ (b if a >> bit & 1 else 0)
    return product


def _times_x(a: int) -> int:
    return a >> 1 ^ (_P if a & 1 else 0)


@functools.lru_cache(maxsize=64)  # most parts of a file are of one length
def _power_of_x(exponent: int) -> int:
    """x^exponent mod P, by squares."""
    power, square = _ONE, _X
    while exponent:
        if exponent & 1:
            power = _product(power, square)
        square, exponent = _product(square, square), exponent >> 1
    return power
