"""Arrays in one file that several processes write, with a digest for each piece."""

import hashlib
import os
import zlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mpsim.core.archive_layout import Member, around, pieces_of
from mpsim.core.chunks import Array
from mpsim.core.joint_file import JointFile, write_at
from mpsim.core.team import Team, raise_first


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
