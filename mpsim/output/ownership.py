"""An observer that writes belongs to one simulation, and a file to one writer: mixed frames would be meaningless."""

import fcntl
import os
import weakref
from contextlib import suppress
from pathlib import Path

from mpsim.core.errors import OutputError
from mpsim.engine.simulation import Simulation


class Ownership:
    """Binds an observer that writes to the first simulation that it observes.

    Args:
        what: what is written, for the error: "trajectory".
        path: of the file.
        advice: how the other simulation gets its own.
    """

    def __init__(self, what: str, path: Path, advice: str):
        self._name = f"{what} {str(path)!r}"
        self._advice = advice
        self._owner: weakref.ref[Simulation] | None = None
        self._closed: str | None = None

    def close(self, advice: str) -> None:
        """From now on refuse every simulation. advice: how to write more to the file."""
        self._closed = advice

    def bind_or_check(self, sim: Simulation) -> None:
        """Bind to this simulation the first time; from then on make sure that it is the same.

        Raises:
            OutputError: if it is another, or after `close`; nothing was written.
        """
        if self._closed is not None:
            raise OutputError(
                f"the {self._name} must be open to be written to, and was closed, as by the end of its `with` block; "
                f"got {sim} to observe. Put all its runs into that block. {self._closed}"
            )
        if self._owner is None:
            self._owner = weakref.ref(sim)
        owner = self._owner()
        if owner is not sim:
            raise OutputError(
                f"the {self._name} belongs to one simulation, {owner or 'which is gone by now'}; got another, {sim}. "
                f"{self._advice}"
            )


class FileLock:
    """Keeps other writers from a file, in this process and in others, until it is released or the process ends.

    A lock of the system, by `flock`: it holds among those that ask for it, hinders no reader and leaves nothing behind.
    Without a file, or on a file system without locks, nothing is locked.

    Raises:
        OutputError: if another writer has the file.
    """

    def __init__(self, path: Path):
        self._path = path
        self._unlock: weakref.finalize[..., FileLock] | None = None
        self.renew()

    def renew(self) -> None:
        """Lock the file that is there now: another may have taken its place."""
        self.release()
        try:
            descriptor = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe must not wait for its other end
        except OSError:
            return
        self._unlock = weakref.finalize(self, _unlock, descriptor, os.getpid())
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise OutputError(
                f"{str(self._path)!r} is being written by another writer, of this process or another. Frames of both "
                "would be lost. Close that one first, as the end of its `with` block does, or choose another file."
            ) from None
        except OSError:
            self.release()

    def release(self) -> None:
        """Release the file. May be called again."""
        if self._unlock is not None:
            self._unlock()


def _unlock(descriptor: int, owner: int) -> None:
    """Unlock a file, though a fork of its owner may still have the file open; in such a fork, leave it to the owner."""
    if os.getpid() == owner:
        with suppress(OSError):  # there was no lock
            fcntl.flock(descriptor, fcntl.LOCK_UN)
    os.close(descriptor)
