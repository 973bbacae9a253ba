"""Files of arrays (NumPy .npz): written by one or several processes, read without trust in what they declare."""

import contextlib
import functools
import hashlib
import io
import math
import os
import re
import secrets
import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mpsim.core import files
from mpsim.core.columns import Array, ranges
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.team import Team, raise_first

# --- CRC-32 of a file from the CRCs of its parts, which different processes write
#
# A CRC-32 is the rest of a division of polynomials over {0, 1} by P, of degree 32. Bytes b take the register s to U(s,
# b), and as that is linear in both, U(s, b) = U(t, b) + (s + t) x^(8 len(b)) mod P, where + is exclusive or. The
# register begins with ones, and crc(b) = ~U(~0, b). For a followed by b the register is s = ~crc(a) once a is in, so
#
#     crc(a b) = ~U(~crc(a), b) = ~(U(~0, b) + (~crc(a) + ~0) x^(8 len(b))) = crc(b) + crc(a) x^(8 len(b)) mod P.

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


# --- Byte positions of the arrays in an uncompressed .npz file, computed before it is written
#
# So processes can write parts of one file, and it is the same to the byte whoever writes which part. Beside the
# contents of its arrays it has headers and a directory, which hold sums over the contents and so come last. All sizes
# are written as those of files beyond 4 GB are (ZIP64), however small the file.

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


# --- A file that several processes write at the same time, each at its own positions
#
# The first process has made it. Another one writes to it only after both have seen in it what the other has written
# there: a name, or even the number of a file, may be the same on machines that do not share it, and what a machine
# keeps of a shared file in a layer of its own is read through it, but not written. What those would write that do not
# share it falls to the others, in the end to the first alone.

_TOKEN = 32
"""Random bytes by which a process shows that a file is the same."""


class _Named(Protocol):
    @property
    def name(self) -> Any: ...

    def fileno(self) -> int: ...


class JointFile:
    """A file that some processes of a team write. Use it in a `with` block; `begun` and `opened` make one.

    Args:
        rank: of this process.
        descriptor: of the file; -1 where it is not written.
        writers: ranks of those that write, the first process the last of them.
        is_own: whether the descriptor is to be closed.
    """

    def __init__(self, rank: int, descriptor: int, writers: list[int], is_own: bool = True):
        self._rank, self._descriptor, self._is_own = rank, descriptor, is_own
        self.writers: list[int] = writers

    def __enter__(self) -> "JointFile":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file. May be called again."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0 and self._is_own:
            os.close(descriptor)

    @property
    def place(self) -> int | None:
        """Which of the writers this process is; None if it is none."""
        return self.writers.index(self._rank) if self._rank in self.writers else None

    def share(self, pieces: int) -> range:
        """Those of so many pieces that this process writes: in their order, the first process the last of them.

        So that one has the end of each array, which shares a page with what follows.
        """
        at, of = self.place, len(self.writers)
        return range(0) if at is None else range(pieces * at // of, pieces * (at + 1) // of)

    def rounds(self, pieces: int) -> int:
        """Pieces of the process that has the most of so many."""
        return -(-pieces // len(self.writers))

    def write(self, content: Any, offset: int) -> None:
        """Write bytes at a place."""
        write_at(self._descriptor, content, offset)

    def sync(self) -> None:
        """Flush to the disk what this process has written to a file that it has opened itself."""
        if self._descriptor >= 0 and self._is_own:
            os.fsync(self._descriptor)


def begun(team: Team, file: _Named | None) -> JointFile:
    """A file that the first process has just made, for all that share it.

    Args:
        team: of the processes, all of which call this.
        file: open for writing, and empty, in the first process, which flushes it when it is complete; None in others.

    Raises:
        OSError: on all of them, if the first one cannot write to it.
    """
    if file is not None and team.size == 1:
        return JointFile(0, file.fileno(), [0], is_own=False)
    path, token = team.once(lambda: _token_written(file))
    descriptor, seen = (-1, b"") if team.rank == 0 else _joined(path, token, PAGE * team.rank)
    told = team.all_of(seen)

    def found() -> list[int]:
        with open(path, "rb", buffering=0) as again:  # opened anew, as network file systems then look again
            at = again.fileno()
            return [rank for rank, token in enumerate(told) if token and token == _token_at(at, PAGE * rank)]

    others = team.once(found)
    if file is not None:
        return JointFile(0, file.fileno(), [*others, 0], is_own=False)
    if team.rank not in others and descriptor >= 0:
        os.close(descriptor)
    return JointFile(team.rank, descriptor if team.rank in others else -1, [*others, 0])


def opened(team: Team, path: Path) -> JointFile:
    """A file that is there already, for all that share its folder, by a file that the first process makes beside it.

    Raises:
        OSError: on all of them, if the first one cannot open it.
    """
    path = team.once(lambda: path)
    with contextlib.ExitStack() as removed:
        scratch: Any = None

        def begin() -> None:
            nonlocal scratch
            scratch = removed.enter_context(files.scratch_beside(path))

        team.once(begin)
        with begun(team, scratch) as met:
            others = met.writers[:-1]
    descriptor = -1

    def own() -> int | None:
        nonlocal descriptor
        with contextlib.suppress(OSError) if team.rank else contextlib.nullcontext():
            descriptor = os.open(path, os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC) if team.rank in [*others, 0] else -1
        return os.fstat(descriptor).st_ino if descriptor >= 0 else None

    told = team.all_of(team.on_all(own))
    return JointFile(team.rank, descriptor, [*(rank for rank in others if told[rank] == told[0]), 0])


def write_at(descriptor: int, content: Any, offset: int) -> None:
    """Write all bytes at a place of a file."""
    rest = memoryview(content).cast("B")
    while rest:
        written = os.pwrite(descriptor, rest, offset)
        rest, offset = rest[written:], offset + written


def _token_written(file: _Named | None) -> tuple[str, bytes]:
    """The path of the file that is begun, and what the first process has written to it."""
    assert file is not None  # of the first process
    token = secrets.token_bytes(_TOKEN)
    write_at(file.fileno(), token, 0)
    os.fsync(file.fileno())
    return os.fspath(file.name), token


def _joined(path: str, token: bytes, offset: int) -> tuple[int, bytes]:
    """A descriptor of the file, and what this process has written to it; (-1, b"") where it is not seen."""
    with contextlib.ExitStack() as undone, contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        undone.callback(os.close, descriptor)
        if _token_at(descriptor, 0) == token:
            own = secrets.token_bytes(_TOKEN)
            write_at(descriptor, own, offset)
            os.fsync(descriptor)
            undone.pop_all()
            return descriptor, own
    return -1, b""


def _token_at(descriptor: int, offset: int) -> bytes:
    return os.pread(descriptor, _TOKEN, offset)


# --- Arrays in one file that several processes write, with a digest for each piece


class Piece(NamedTuple):
    """What is known of a piece of an array: a digest, CRC-32 and length of its bytes."""

    digest: bytes
    crc: int
    length: int


Pieces = dict[str, list[Piece]]
"""Of each array by name, in order."""


def digest_of_piece(content: Any) -> bytes:
    """Digest of the bytes of a piece."""
    return hashlib.blake2b(content, digest_size=16).digest()


def piece_of(content: Any) -> Piece:
    """What is known of a piece of these bytes."""
    return Piece(digest_of_piece(content), zlib.crc32(content), len(content))


def content_of(array: Array, rows: tuple[int, int]) -> memoryview:
    """Bytes of a range of rows, in the order of C."""
    part = array[slice(*rows)] if len(array.shape) else np.asarray(array)
    content: Any = np.ascontiguousarray(part).reshape(-1).view(np.uint8)
    return memoryview(content)


def write_contents(file: JointFile, team: Team, members: list[Member], arrays: Mapping[str, Array]) -> Pieces:
    """Write the contents of arrays, and flush them to the disk.

    Each process writes its share. All read an array at the same time, each rows of its own or none: so arrays of which
    none has all rows can be read.

    Raises:
        Exception: what any of the processes meets while it writes, on all.
    """
    own: Pieces = {member.name: [] for member in members}
    failed: list[Exception] = []
    for member in members:
        array = arrays[member.name]
        pieces, width = pieces_of(array.shape), member.nbytes // max(len(array) if array.shape else 1, 1)
        for rows in _in_turn(file, pieces):
            content = content_of(array, rows)
            if rows[0] == rows[1] or failed:
                continue
            try:
                file.write(content, member.begin + rows[0] * width)
            except Exception as error:
                if team.size == 1:
                    raise
                failed.append(error)  # the others go on to read, and so does this one
            own[member.name].append(piece_of(content))

    def end() -> None:
        raise_first(failed)
        file.sync()

    team.on_all(end)
    return _together(team.all_of(own), file.writers)


def write_around(descriptor: int, members: list[Member], pieces: Pieces) -> None:
    """Write all but the contents, after them: headers and directory. The file ends there."""
    sums = {name: [(piece.crc, piece.length) for piece in found] for name, found in pieces.items()}
    end = 0
    for offset, part in around(members, sums):
        write_at(descriptor, part, offset)
        end = max(end, offset + len(part))
    os.ftruncate(descriptor, end)  # what they have met by may lie behind it


def _in_turn(file: JointFile, pieces: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Rows of this process, and no rows while another one has more."""
    own = [pieces[index] for index in file.share(len(pieces))]
    return own + [(0, 0)] * (file.rounds(len(pieces)) - len(own))


def _together(told: list[Pieces], writers: list[int]) -> Pieces:
    """The pieces of all, in the order of the arrays."""
    return {name: [piece for rank in writers for piece in told[rank][name]] for name in told[0]}


# --- Reads and writes files of arrays (NumPy .npz); no declared size is trusted before it is checked
#
# Nothing is compressed and nothing is an object: a file cannot declare more than its own length, and nothing in it is
# executed.

Arrays = dict[str, NDArray[Any]]

MOST_ARRAYS = 64
"""Largest number of arrays in one file: several times what any simulation has."""

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

MOST_DIRECTORY = 2**16
"""Largest size in bytes of the directory at the end of a file, which names its arrays: each takes about 100."""

# The end of a zip file: a record of 22 bytes; in large ones behind a record of 56 bytes and its locator, of 20.
_END, _END_64, _LOCATOR = b"PK\x05\x06", b"PK\x06\x06", b"PK\x06\x07"

_LENGTHS_AT = 26
"""Bytes of a member's own header before the lengths of its name and of what follows that."""

_ENCRYPTED = 1
"""Bit among the flags of a member of a zip file."""

_LENGTH = rb"\d{1,19}"
_HEADER = re.compile(
    rb"\{'descr': '([<>|]?[fiubcU]\d{1,9})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:%b, ?)*(?:%b)?)\),? ?\}\s*" % (_LENGTH, _LENGTH)
)
"""The header of an array without objects. NumPy's reader evaluates the text, where
9000 minus signs lead to a MemoryError."""


REAL = "fiu"
"""dtype kinds of real numbers: floating, signed, unsigned."""


class Declared(NamedTuple):
    """What the header of an array says: the bytes that follow are of this type and shape, in the order "C" or "F"."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    order: Literal["C", "F"]
    nbytes: int


def read_array(file: Any, length: int, name: str, kinds: str) -> NDArray[Any]:
    """An array as numpy.save writes it, read-only: `length` bytes, of which a header declares kind and shape.

    Nothing is read or allocated before the kind is known to be in `kinds`, and the shape to fit the bytes that follow.

    Raises:
        ValueError: if they are not.
    """
    said = declared(file, length, name, kinds)
    content = file.read(said.nbytes)
    if len(content) != said.nbytes:
        raise ValueError(f"{name!r} is cut off")
    return np.frombuffer(content, said.dtype).reshape(said.shape, order=said.order)


def declared(file: Any, length: int, name: str, kinds: str) -> Declared:
    """The header of an array, behind which the file stands then.

    Raises:
        ValueError: as `read_array`.
    """
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError(f"{name!r} is of another version of the .npy format")
    header = file.read(int.from_bytes(file.read(2), "little"))
    found = _HEADER.fullmatch(header)
    if not found:
        raise ValueError(f"{name!r} is not a plain array; its header is {header[:80]!r}")
    try:
        dtype = np.dtype(found[1].decode())
    except TypeError:
        raise ValueError(f"{name!r} is of a type that NumPy does not know, {found[1].decode()}") from None
    if dtype.kind not in kinds:
        raise ValueError(f"{name!r} holds {dtype}")
    shape = tuple(int(length) for length in re.findall(_LENGTH, found[3]))
    rest = length - file.tell()
    if math.prod(shape) * dtype.itemsize != rest:
        raise ValueError(f"{name!r} declares shape {shape!s:.60} of {dtype}, and has {rest} bytes")
    return Declared(dtype, shape, "F" if found[2] == b"True" else "C", rest)


class ArrayFile:
    """The arrays in an open file, each read when it is asked for. Use it in a `with` block.

    Raises:
        DAMAGE: one of these exceptions, if the file is damaged.
        OSError: if it cannot be read.
    """

    def __init__(self, file: BinaryIO):
        self._file = file
        length = os.fstat(file.fileno()).st_size
        if _directory_bytes(file, length) > MOST_DIRECTORY:
            raise ValueError(f"its directory is longer than {MOST_DIRECTORY:,} bytes; {MOST_ARRAYS} arrays are allowed")
        try:
            with interrupts_held_back():  # one that is half made would print an error when it is collected
                self._zip = zipfile.ZipFile(file)
        except zipfile.BadZipFile as error:
            if isinstance(error.__context__, OSError):  # from the system or a signal handler: the file is not at fault
                raise error.__context__ from None
            raise
        members = self._zip.infolist()
        self._members = {member.filename.removesuffix(".npy"): member for member in members}
        if len(self._members) != len(members) or len(members) > MOST_ARRAYS:
            raise ValueError(f"it holds {len(members)} arrays, or one twice; {MOST_ARRAYS} different ones are allowed")
        for member in members:
            if member.compress_type != zipfile.ZIP_STORED or member.compress_size != member.file_size:
                raise ValueError(f"{member.filename!r} in it is compressed, as mpsim writes none")
            if not 0 <= member.header_offset < length:  # seeking there would be an OSError, which blames the system
                raise ValueError(f"{member.filename!r} in it begins outside of it")
            if member.flag_bits & _ENCRYPTED:
                raise ValueError(f"{member.filename!r} in it is encrypted, as mpsim writes none")
        # Members may overlap in a zip file: only the sum shows that no more is read than the file has.
        if sum(member.file_size for member in members) > length:
            raise ValueError("it declares more bytes than it has")

    def __enter__(self) -> "ArrayFile":
        return self

    def __exit__(self, *exception: object) -> None:
        with interrupts_held_back():  # in Python code that runs because something is collected, Ctrl-C is lost
            del self._zip

    @property
    def names(self) -> list[str]:
        """Names of the arrays."""
        return list(self._members)

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
        lengths = self._file.read(4)
        name_length, extra = (int.from_bytes(part, "little") for part in (lengths[:2], lengths[2:]))
        begin = info.header_offset + _LENGTHS_AT + len(lengths) + name_length + extra + info.file_size - said.nbytes
        if begin + said.nbytes > os.fstat(self._file.fileno()).st_size:
            raise ValueError(f"{name!r} is cut off")
        return np.asarray(np.memmap(self._file, said.dtype, "r", begin, said.shape, said.order))


def _directory_bytes(file: BinaryIO, length: int) -> int:
    """Declared size of a zip file's directory in bytes: zipfile would read all of it at once."""
    file.seek(max(length - 98, 0))
    end = file.read(98)[-98:].rjust(98, b"\0")
    file.seek(0)
    if not end[76:].startswith(_END):
        raise ValueError("it does not end as a file of arrays does")
    declared = [int.from_bytes(end[88:92], "little")]
    if end[56:].startswith(_LOCATOR):
        where = int.from_bytes(end[64:72], "little")
        if not end.startswith(_END_64) or where != length - 98:
            raise ValueError("it does not end as a large file of arrays does")
        declared = [int.from_bytes(end[40:48], "little"), *(size for size in declared if size != 2**32 - 1)]
    return max(declared)
