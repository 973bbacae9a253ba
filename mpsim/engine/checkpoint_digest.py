"""The digest of a checkpoint, computed from digests of pieces of its arrays."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from mpsim.core.archive import Arrays
from mpsim.core.archive_layout import pieces_of
from mpsim.core.chunks import Array
from mpsim.core.joint_archive import content_of, digest_of_piece
from mpsim.engine.older_formats import digest_at_once

AT_ONCE = 6
"""The last format in which the digest is over all bytes one after the other, which only one process can make."""


def digest_of(header: dict[str, Any], arrays: Arrays) -> str:
    """Hex digest over header and arrays, names, dtypes and shapes included, as the format of the header has it."""
    if int(header["format"]) <= AT_ONCE:
        return digest_at_once(_plain_text(header), arrays)
    return joined_digest(
        header,
        arrays,
        {
            name: [digest_of_piece(content_of(array, rows)) for rows in pieces_of(array.shape)]
            for name, array in arrays.items()
        },
    )


def joined_digest(header: dict[str, Any], arrays: Mapping[str, Array], digests: Mapping[str, list[bytes]]) -> str:
    """The digest over header and arrays, from those of their pieces, which may be taken by different processes."""
    digest = hashlib.blake2b(_plain_text(header), digest_size=16)
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape}".encode())
        digest.update(b"".join(digests[name]))
    return digest.hexdigest()


def _plain_text(header: dict[str, Any]) -> bytes:
    """A header without its digest, in an order of its own."""
    return json.dumps({name: header[name] for name in header if name != "digest"}, sort_keys=True).encode()
