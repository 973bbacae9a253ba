"""Byte positions of the arrays in an uncompressed .npz file, computed before it is written.

So processes can write parts of one file, and it is the same to the byte whoever writes which part. Beside the contents
of its arrays it has headers and a directory, which hold sums over the contents and so come last. All sizes are written
as those of files beyond 4 GB are (ZIP64), however small the file.
"""

import io
import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from mpsim.core.chunks import Array, ranges
from mpsim.core.crc import joined

PIECE = 2**16
"""Rows of an array that one process writes, and of which there is one digest: part of the format of checkpoints."""

PAGE = 4096
"""Bytes, of which pieces of an array of more than one are multiples: their array begins at one, too. So no two
processes write to the same page, which clients of a network file system may write back as a whole."""

_VERSION = 45  # of zip files from which on there are such sizes
_UNIX, _MODE = 3, 0o600 << 16
_DAY = 1 << 5 | 1  # the first that zip files know: that of writing would make each file another one
_BEYOND, _BEYOND_SHORT = 0xFFFFFFFF, 0xFFFF  # "see the long form"


class Member(NamedTuple):
    """An array in the file.

    Attributes:
        name: of the array.
        start: where its headers begin.
        head: header of the array, as `numpy.save` writes it.
        begin: where its content begins.
        nbytes: size of its content.
    """

    name: str
    start: int
    head: bytes
    begin: int
    nbytes: int

    @property
    def end(self) -> int:
        """Where its content ends."""
        return self.begin + self.nbytes


def rows_of(shape: tuple[int, ...]) -> int:
    """Rows of an array: a single number is one."""
    return shape[0] if shape else 1


def pieces_of(shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """First row and the one after the last of each piece of an array of a shape.

    >>> pieces_of((PIECE + 1, 2)), pieces_of(()), pieces_of((0, 2))
    ([(0, 65536), (65536, 65537)], [(0, 1)], [])
    """
    return ranges(rows_of(shape), PIECE)


def laid_out(arrays: Mapping[str, Array]) -> list[Member]:
    """The members of a file of arrays, one after the other."""
    found, at = [], 0
    for name, array in arrays.items():
        before = at + len(_local_header(name, 0, 0))
        is_shared = len(pieces_of(array.shape)) > 1
        head = _head(array, before, PAGE if is_shared else 1)
        found.append(Member(name, at, head, before + len(head), math.prod(array.shape) * array.dtype.itemsize))
        at = found[-1].end
    return found


def around(members: list[Member], sums: Mapping[str, list[tuple[int, int]]]) -> Iterator[tuple[int, bytes]]:
    """All but the contents: where each part begins, and its bytes.

    sums: of each member CRC-32 and length of the parts of its content, in order.
    """
    directory = []
    for member in members:
        crc, size = joined([(zlib.crc32(member.head), len(member.head)), *sums[member.name]]), _size(member)
        yield member.start, _local_header(member.name, crc, size) + member.head
        directory.append(_entry(member, crc, size))
    end = members[-1].end
    yield end, b"".join(directory) + _ending(len(directory), sum(map(len, directory)), end)


def _size(member: Member) -> int:
    return len(member.head) + member.nbytes


def _head(array: Array, before: int, multiple: int) -> bytes:
    """Header of an array that stands at a place, with blanks, so that a multiple of so many bytes is behind it."""
    file = io.BytesIO()
    descr = np.lib.format.dtype_to_descr(array.dtype)
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": array.shape})
    written, blanks = file.getvalue(), -(before + file.tell()) % multiple
    length = struct.unpack_from("<H", written, 8)[0] + blanks
    return written[:8] + struct.pack("<H", length) + written[10:-1] + b" " * blanks + b"\n"


def _local_header(name: str, crc: int, size: int) -> bytes:
    what = _VERSION, 0, 0, 0, _DAY, crc, _BEYOND, _BEYOND
    sizes, file = struct.pack("<2H2Q", 1, 16, size, size), f"{name}.npy".encode()
    return struct.pack("<4s5H3L2H", b"PK\x03\x04", *what, len(file), len(sizes)) + file + sizes


def _entry(member: Member, crc: int, size: int) -> bytes:
    what = _VERSION, _UNIX, _VERSION, 0, 0, 0, 0, _DAY, crc, _BEYOND, _BEYOND
    sizes, file = struct.pack("<2H3Q", 1, 24, size, size, member.start), f"{member.name}.npy".encode()
    rest = len(file), len(sizes), 0, 0, 0, _MODE, _BEYOND
    return struct.pack("<4s4B4H3L5H2L", b"PK\x01\x02", *what, *rest) + file + sizes


def _ending(entries: int, size: int, begin: int) -> bytes:
    long = struct.pack("<4sQ2H2L4Q", b"PK\x06\x06", 44, _VERSION, _VERSION, 0, 0, entries, entries, size, begin)
    where = struct.pack("<4sLQL", b"PK\x06\x07", 0, begin + size, 1)
    short = 0, 0, _BEYOND_SHORT, _BEYOND_SHORT, _BEYOND, _BEYOND, 0
    return long + where + struct.pack("<4s4H2LH", b"PK\x05\x06", *short)
