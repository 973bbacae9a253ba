"""A file that several processes write at the same time, each at its own positions.

The first process has made it. Another one writes to it only after both have seen in it what the other has written
there: a name, or even the number of a file, may be the same on machines that do not share it, and what a machine keeps
of a shared file in a layer of its own is read through it, but not written. What those would write that do not share it
falls to the others, in the end to the first alone.
"""

import contextlib
import os
import secrets
from pathlib import Path
from typing import Any, Protocol

from mpsim.core import atomic
from mpsim.core.archive_layout import PAGE
from mpsim.core.team import Team

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
            scratch = removed.enter_context(atomic.scratch_beside(path))

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
