"""Named arrays in one file, a NumPy .npz, read without trusting it: no size is taken from it before it is checked.

Nothing is compressed and nothing is an object: what the file says it holds cannot be more than its own length, and
nothing in it is executed.
"""

import math
import os
import re
import struct
import zipfile
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]

MOST_ARRAYS = 64
"""Arrays in one file at most: several times what any simulation has."""

DAMAGE = (
    zipfile.BadZipFile,
    struct.error,
    EOFError,
    ValueError,
    LookupError,
    TypeError,
    OverflowError,
    NotImplementedError,
    RecursionError,
)
"""What reading a damaged file raises; all else (no memory, no right, an interrupt) says nothing about the file."""

_ENCRYPTED = 1
"""Bit among the flags of a member of a zip file."""

_LENGTH = rb"\d{1,19}"
_HEADER = re.compile(
    rb"\{'descr': '([<>|]?[fiub]\d{1,2})', 'fortran_order': False, "
    rb"'shape': \(((?:%b, ?)*(?:%b)?)\),? ?\}\s*" % (_LENGTH, _LENGTH)
)
"""The header of an array of plain numbers: floating, signed, unsigned, bool. NumPy's reader evaluates the text, where
9000 minus signs lead to a MemoryError."""


def write_arrays(file: BinaryIO, arrays: Arrays) -> None:
    """Write arrays, in this order."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(array, order="C"), (1, 0), allow_pickle=False)


class ArrayFile:
    """The arrays in an open file, each read when it is asked for.

    Raises:
        DAMAGE: one of these exceptions, if the file is damaged.
        OSError: if it cannot be read.
    """

    def __init__(self, file: BinaryIO):
        length = os.fstat(file.fileno()).st_size
        try:
            self._zip = zipfile.ZipFile(file)
        except zipfile.BadZipFile as error:
            if isinstance(error.__context__, OSError):  # of the system, or of a signal handler: no fault of the file
                raise error.__context__ from None
            raise
        members = self._zip.infolist()
        self._members = {member.filename.removesuffix(".npy"): member for member in members}
        if len(self._members) != len(members) or len(members) > MOST_ARRAYS:
            raise ValueError(f"it holds {len(members)} arrays, or one twice; {MOST_ARRAYS} different ones are allowed")
        for member in members:
            if member.compress_type != zipfile.ZIP_STORED or member.compress_size != member.file_size:
                raise ValueError(f"{member.filename!r} in it is compressed, which no checkpoint is")
            if not 0 <= member.header_offset < length:  # where the system would refuse to look, as if it were at fault
                raise ValueError(f"{member.filename!r} in it begins outside of it")
            if member.flag_bits & _ENCRYPTED:
                raise ValueError(f"{member.filename!r} in it is encrypted, which no checkpoint is")
        # Members may overlap in a zip file: only the sum tells that what is read is no more than what is there.
        if sum(member.file_size for member in members) > length:
            raise ValueError("it declares more bytes than it has")

    @property
    def names(self) -> list[str]:
        """Names of the arrays."""
        return list(self._members)

    def read(self, name: str) -> NDArray[Any]:
        """One array, read-only. Its declared shape must be that of the bytes that follow."""
        info = self._members[name]
        with self._zip.open(info) as member:
            if np.lib.format.read_magic(member) != (1, 0):
                raise ValueError(f"{name!r} in it is of another version of the .npy format")
            header = member.read(int.from_bytes(member.read(2), "little"))
            found = _HEADER.fullmatch(header)
            if not found:
                raise ValueError(f"{name!r} in it is no plain array; its header is {header[:80]!r}")
            dtype = np.dtype(found[1].decode())
            shape = tuple(int(length) for length in re.findall(_LENGTH, found[2]))
            rest = info.file_size - member.tell()
            if math.prod(shape) * dtype.itemsize != rest:
                raise ValueError(f"{name!r} in it declares shape {shape} of {dtype}, and has {rest} bytes")
            content = member.read(rest)
        if len(content) != rest:
            raise ValueError(f"{name!r} in it is cut off")
        return np.frombuffer(content, dtype).reshape(shape)
