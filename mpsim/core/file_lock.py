"""Locks a file, so that it has only one writer in all processes."""

import fcntl
import os
import weakref
from contextlib import suppress
from pathlib import Path

from mpsim.errors import OutputError


class FileLock:
    """Keeps other writers from a file, in this process and in others, until it is released or the process ends.

    A lock of the system, by `flock`: it holds among those that ask for it, hinders no reader and leaves nothing behind.
    Without a file, or on a file system without locks, nothing is locked. Forks of the process do not keep the lock:
    worker processes that outlive a killed owner would keep the next one from the file.

    Raises:
        OutputError: if another writer has the file.
    """

    def __init__(self, path: Path):
        self._path = path
        self._unlock: weakref.finalize[..., FileLock] | None = None
        self._descriptor = -1
        self.renew()

    def renew(self) -> None:
        """Lock the file that is there now: another may have taken its place."""
        self.release()
        try:
            descriptor = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe must not wait for its other end
        except OSError:
            return
        self._unlock = weakref.finalize(self, _unlock, descriptor, os.getpid())
        self._descriptor = descriptor
        _held.add(self)
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
        _held.discard(self)
        if self._unlock is not None:
            self._unlock()

    def leave_to_owner(self) -> None:
        """In a fork of the process that holds the lock: close the copy of its descriptor."""
        if self._unlock is not None and self._unlock.detach() is not None:
            with suppress(OSError):
                os.close(self._descriptor)


_held: weakref.WeakSet[FileLock] = weakref.WeakSet()


def _leave_to_owner() -> None:
    for lock in list(_held):
        lock.leave_to_owner()
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_to_owner)


def _unlock(descriptor: int, owner: int) -> None:
    """Unlock a file, though a fork of its owner may still have the file open; in such a fork, leave it to the owner."""
    if os.getpid() == owner:
        with suppress(OSError):  # there was no lock
            fcntl.flock(descriptor, fcntl.LOCK_UN)
    os.close(descriptor)
