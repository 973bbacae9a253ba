"""One file that several processes write at once, each at its own places.

The first process has made it. Another one writes to it only after both have seen in it what the other has written
there: a name, or even the number of a file, may be the same on machines that do not share it, and what a machine keeps
of a shared file in a layer of its own is read through it, but not written. What those would write that do not share it
falls to the others, in the end to the first alone.
"""

import contextlib
import os
import secrets
from typing import Any, Protocol

from mpsim.core.archive_layout import PAGE
from mpsim.core.team import Team

_TOKEN = 32
"""Random bytes by which a process shows that a file is the same."""


class _Named(Protocol):
    @property
    def name(self) -> Any: ...

    def fileno(self) -> int: ...


class JointFile:
    """A file that all processes of a team write that share it. Use it in a `with` block.

    All of them make it, and use it, in the same order.

    Args:
        team: of the processes.
        file: open for writing, and empty, in the first process; None in the others.

    Raises:
        OSError: on all of them, if the first one cannot write to it.

    Attributes:
        writers: ranks of those that write, the first process the last of them.
    """

    def __init__(self, team: Team, file: _Named | None):
        self._rank, self._own = team.rank, -1
        self._descriptor = -1 if file is None else file.fileno()
        self.writers: list[int] = [0]
        if team.size > 1:
            self.writers = self._met(team, file)

    def __enter__(self) -> "JointFile":
        return self

    def __exit__(self, *exception: object) -> None:
        own, self._own = self._own, -1
        if own >= 0:
            os.close(own)

    @property
    def writes(self) -> bool:
        """Whether this process writes."""
        return self._rank in self.writers

    def share(self, pieces: int) -> range:
        """Those of so many pieces that this process writes: in their order, the first process the last of them.

        So that one has the end of each array, which shares a page with what follows.
        """
        if not self.writes:
            return range(0)
        at, of = self.writers.index(self._rank), len(self.writers)
        return range(pieces * at // of, pieces * (at + 1) // of)

    def rounds(self, pieces: int) -> int:
        """Pieces of the process that has the most of so many."""
        return -(-pieces // len(self.writers))

    def write(self, content: Any, offset: int) -> None:
        """Write bytes at a place."""
        write_at(self._descriptor, content, offset)

    def sync(self) -> None:
        """Flush to the disk what this process has written; the first one's file is flushed when it is complete."""
        if self._own >= 0:
            os.fsync(self._own)

    def _met(self, team: Team, file: _Named | None) -> list[int]:
        """Ranks of those that see the same file."""
        path, token = team.once(lambda: _begun(file, self._descriptor))
        self._own, seen = (-1, b"") if file is not None else _joined(path, token, PAGE * team.rank)
        self._descriptor = max(self._descriptor, self._own)
        told = team.all_of(seen)

        def found() -> list[int]:
            with open(path, "rb", buffering=0) as again:  # opened anew, as network file systems then look again
                descriptor = again.fileno()
                return [rank for rank, seen in enumerate(told) if seen and seen == _token_at(descriptor, PAGE * rank)]

        others = team.once(found)
        if self._rank not in others:
            self.__exit__()
        return [*others, 0]


def write_at(descriptor: int, content: Any, offset: int) -> None:
    """Write all bytes at a place of a file."""
    rest = memoryview(content).cast("B")
    while rest:
        written = os.pwrite(descriptor, rest, offset)
        rest, offset = rest[written:], offset + written


def _begun(file: _Named | None, descriptor: int) -> tuple[str, bytes]:
    """The path of the file that is begun, and what the first process has written to it."""
    assert file is not None  # of the first process
    token = secrets.token_bytes(_TOKEN)
    write_at(descriptor, token, 0)
    os.fsync(descriptor)
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
