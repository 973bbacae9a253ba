"""Files of arrays (NumPy .npz): written in chunks, and read without trust in what they declare.

Nothing is compressed and nothing is an object: a file cannot declare more than its own length, and nothing in it is
executed.
"""

import math
import os
import struct
import tokenize
import zipfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import files
from mpsim.core.checks import Closable
from mpsim.core.columns import Array, chunks_of
from mpsim.core.deferred_signals import interrupts_held_back

Arrays = dict[str, NDArray[Any]]


# --- Writes


def save_arrays(what: str, path: Path, arrays: Mapping[str, Any]) -> Path:
    """Write arrays and numbers by name; `what` they are. An existing file is replaced completely or not at all."""
    with files.writable(what, path, "be in a folder that can be written to"), files.atomic_write(path) as file:
        np.savez(file, **arrays)
    return path


def write_arrays(file: BinaryIO, arrays: Iterable[tuple[str, Array]], see: Callable[[Any], object]) -> None:
    """Write named arrays one after the other to an open file, chunk by chunk.

    The bytes depend on nothing but names and arrays: the date of each is the first that zip files know.

    see: called with the bytes of each chunk, in order.
    """
    with interrupts_held_back():
        archive = zipfile.ZipFile(file, "w")
    with archive:
        for name, array in arrays:
            declared = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape}
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                np.lib.format.write_array_header_1_0(member, declared)
                for chunk in chunks_of(array):
                    content: Any = chunk.reshape(-1).view(np.uint8)
                    see(content)
                    member.write(content)


# --- Reads

MOST_ARRAYS = 64  # largest number of arrays in one file: several times what any simulation has

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
"""What reading a damaged file raises; other errors (no memory, no permission, an interrupt) are not the file's."""

MOST_HEADER = 256
"""Largest size in bytes of the header of an array: NumPy evaluates its text, and nested text can take all memory."""

_LENGTHS_AT = 26  # bytes of a member's own header before the lengths of its name and of what follows that
_ENCRYPTED = 1  # bit among the flags of a member of a zip file
REAL = "fiu"  # dtype kinds of real numbers: floating, signed, unsigned


class Declared(NamedTuple):
    """What the header of an array says: the bytes that follow are of this type and shape, in the order "C" or "F"."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    order: Literal["C", "F"]
    nbytes: int


def read_array(file: Any, length: int, name: str, kinds: str) -> NDArray[Any]:
    """An array as numpy.save writes it, read-only: `length` bytes, of which a header declares kind and shape.

    Nothing is read or allocated before the kind is known to be in `kinds`, and the shape to fit the bytes that follow:
    otherwise a ValueError says what does not.
    """
    said = declared(file, length, name, kinds)
    content = file.read(said.nbytes)
    if len(content) != said.nbytes:
        raise ValueError(f"{name!r} is cut off")
    return np.frombuffer(content, said.dtype).reshape(said.shape, order=said.order)


def declared(file: Any, length: int, name: str, kinds: str) -> Declared:
    """The header of an array, behind which the file stands then; errors as of `read_array`."""
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError(f"{name!r} is of another version of the .npy format")
    try:
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file, max_header_size=MOST_HEADER)
    except (SyntaxError, TypeError, tokenize.TokenError) as error:  # of NumPy, for a damaged one
        raise ValueError(f"{name!r} has a header that cannot be read ({error})") from None
    if dtype.kind not in kinds:
        raise ValueError(f"{name!r} holds {dtype}")
    rest = length - file.tell()
    if math.prod(shape) * dtype.itemsize != rest or min(shape, default=0) < 0:
        raise ValueError(f"{name!r} declares shape {shape!s:.60} of {dtype}, and has {rest} bytes")
    return Declared(dtype, tuple(map(int, shape)), "F" if fortran else "C", rest)


class ArrayFile(Closable):
    """The arrays in an open file, by their `names`, each read when it is asked for. Use it in a `with` block.

    Raises:
        DAMAGE: one of these exceptions, if the file is damaged.
        OSError: if it cannot be read.
    """

    def __init__(self, file: BinaryIO):
        self._file = file
        length = os.fstat(file.fileno()).st_size
        try:
            with interrupts_held_back():  # one that is half made would print an error when it is collected
                self._zip = zipfile.ZipFile(file)
        except zipfile.BadZipFile as error:
            if isinstance(error.__context__, OSError):  # from the system or a signal handler: the file is not at fault
                raise error.__context__ from None
            raise
        members = self._zip.infolist()
        self._members = {member.filename.removesuffix(".npy"): member for member in members}
        self.names: list[str] = list(self._members)
        if len(self._members) != len(members) or len(members) > MOST_ARRAYS:
            raise ValueError(f"it holds {len(members)} arrays, or one twice; {MOST_ARRAYS} different ones are allowed")
        for member in members:
            stored = member.compress_type == zipfile.ZIP_STORED and member.compress_size == member.file_size
            # Seeking outside would be an OSError, which blames the system.
            if not stored or member.flag_bits & _ENCRYPTED or not 0 <= member.header_offset < length:
                raise ValueError(f"{member.filename!r} in it is compressed, encrypted or outside, as mpsim writes none")
        # Members may overlap in a zip file: only the sum shows that no more is read than the file has.
        if sum(member.file_size for member in members) > length:
            raise ValueError("it declares more bytes than it has")

    def close(self) -> None:
        with interrupts_held_back():  # in Python code that runs because something is collected, Ctrl-C is lost
            del self._zip

    def read(self, name: str) -> NDArray[Any]:
        """One array, read-only. Its declared shape must be that of the bytes that follow."""
        info = self._members[name]
        with self._zip.open(info) as member:
            return read_array(member, info.file_size, name, f"{REAL}b")

    def map(self, name: str) -> NDArray[Any]:
        """The same in the pages of the file, none of which is read before it is needed; its checksum is not looked at.

        The file must not be made shorter as long as the array is there.
        """
        info = self._members[name]
        with self._zip.open(info) as member:
            said = declared(member, info.file_size, name, f"{REAL}b")
        if not said.nbytes:
            return self.read(name)
        self._file.seek(info.header_offset + _LENGTHS_AT)
        name_length, extra = struct.unpack("<HH", self._file.read(4))
        begin = info.header_offset + _LENGTHS_AT + 4 + name_length + extra + info.file_size - said.nbytes
        if begin + said.nbytes > os.fstat(self._file.fileno()).st_size:
            raise ValueError(f"{name!r} is cut off")
        return np.asarray(np.memmap(self._file, said.dtype, "r", begin, said.shape, said.order))
