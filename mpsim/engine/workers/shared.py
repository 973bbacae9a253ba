"""The one shared block of a simulation, its arrays, and what the system allows."""

import _posixshmem  # type: ignore[import-not-found]
import ctypes
import errno
import fcntl
import math
import mmap
import os
import re
import resource
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any, cast

import numpy as np
import psutil
from numpy.typing import DTypeLike, NDArray

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.errors import ResourceError, SharedMemoryError, is_of_the_system

MOST_FRAMES = 4096  # frames of one command at most: the length of the array of times in the shared block


Specs = dict[str, tuple[DTypeLike, tuple[int, ...]]]
"""dtype and shape of arrays, by name; of shape () it is a record."""


# --- What the system allows this process, for errors that say in numbers what it has refused


@contextmanager
def refusals_named() -> Iterator[None]:
    """Turn a refusal of the system during the start of a simulation into a ResourceError."""
    try:
        yield
    except ResourceError:
        raise
    except OSError as error:
        if not is_of_the_system(error):
            raise
        if error.errno in (errno.EMFILE, errno.ENFILE):
            raise ResourceError(f"a simulation needs file descriptors, {_descriptors(error)}") from error
        raise ResourceError(
            f"the system refuses what a simulation needs: {error}. It must be allowed shared memory, descriptors and "
            "processes. See what limits this process (ulimit -a), and what is free (free, df /dev/shm)."
        ) from error


def refusal_of_block(size: int, error: OSError) -> SharedMemoryError:
    """The error for a shared block of a size [bytes] that cannot be had."""
    need = f"the shared block needs {size:,} bytes"
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return SharedMemoryError(f"{need} and a file descriptor, {_descriptors(error)}")
    return SharedMemoryError(
        f"{need} in /dev/shm, which are refused ({error.strerror or error}; {_free()}). Shared memory must be writable "
        "for this user, and hold the whole block. Use fewer discs or precision='float32', enlarge it (docker run "
        f"--shm-size={-(-size // 2**20) + 1}m; mount -o remount,rw,size=... /dev/shm), or raise what this process may "
        "have (ulimit -v, ulimit -f)."
    )


NO_WORKERS = "Use fewer workers, or method='grid', which starts no workers."


def refusal_of_process(what: str, error: OSError | RuntimeError | EOFError, remedy: str = NO_WORKERS) -> ResourceError:
    """The error for a process or thread that cannot be started; EOFError: the fork server has ended."""
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return ResourceError(f"{what} needs file descriptors, {_descriptors(error)}")
    why = str(error)
    if isinstance(error, EOFError | ConnectionError):
        why = "Python's fork server, which starts workers, ended. It may have been killed, or allowed no process"
    return ResourceError(
        f"{what} could not be started: {why}. There must be memory for one (free, ulimit -v), starting one allowed "
        "(ulimit -u, or a container's), and the current folder, a folder for temporary files (TMPDIR, of fewer than 80 "
        f"characters) and {sys.executable!r} there, which may be used. {remedy}"
    )


def resident_bytes(pid: int) -> int:
    """Resident memory of a process [bytes]; 0 if it has ended, or the system does not say, as without descriptors."""
    try:
        return psutil.Process(pid).memory_info().rss
    except (psutil.Error, OSError):
        return 0


def demand_descriptors(number: int) -> None:
    """Raise an OSError unless n descriptors are available: multiprocessing leaks some when it runs out."""
    opened: list[int] = []
    try:
        for _ in range(number):
            opened.append(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))
    finally:
        for descriptor in opened:
            os.close(descriptor)


def _descriptors(error: OSError) -> str:
    """The rest of a sentence about descriptors."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    in_use = "an unknown number are"
    with suppress(psutil.Error, OSError):  # which itself needs one to count them
        in_use = f"{psutil.Process().num_fds():,} are"
    if error.errno == errno.EMFILE:
        of = f"of which this process may have {limit:,} and {in_use} open"
    else:
        of = "of which the whole machine has no more"
    return f"{of} ({error.strerror}). Close files and simulations that are not needed, or raise the limit (ulimit -n)."


def _free() -> str:
    try:
        space = os.statvfs("/dev/shm")
    except OSError:
        return "how much is free is unknown"
    return f"{space.f_bavail * space.f_frsize:,} bytes are free in /dev/shm"


# --- The one shared block of a simulation. Nothing else in mpsim uses multiprocessing.shared_memory
#
# Ownership: the coordinator creates the block before any worker starts, and it alone unlinks it. Workers attach
# without registering for clean-up, because a registered worker that exits would take the block away from all
# processes. If the coordinator is killed, its resource tracker unlinks the block as soon as the last worker has gone.
# If that is killed as well, the block stays; `remove_stale_blocks` finds it.

PAGE = 4096
STAGGER = 384
"""Bytes by which each array's place inside a memory page differs from that of the array before. A load that follows a
store to another page at the same place waits for it in vain (4 KiB aliasing): with arrays of about a page or a power of
two, which the sort reads and writes side by side, that doubles its time. A multiple of two cache lines, 128, which is
what the prefetcher takes at a time."""


FOLDER = Path("/dev/shm")  # where Linux shows shared memory as files

MAP_FIXED = 0x10
"""Of the C function mmap: at that address, in place of what is there. Python's module has not got it."""

_NO_SHARED_MEMORY = {errno.ENOENT, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSYS, errno.ENOSPC, errno.EFBIG}
"""Errors of a system that has no shared memory, or not enough."""

_map_memory = ctypes.CDLL(None, use_errno=True).mmap
_map_memory.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
_map_memory.restype = ctypes.c_void_p

_OWN_NAME = re.compile(r"mpsim-(\d+)-[0-9a-f]{8}")

_CLOCK_SLACK = 10.0
"""Seconds by which a process must be younger than a block before it is not the block's owner: the start of a process
is known to the tick of a clock that may have been set since."""


class SharedBlock:
    """Named arrays in one block of shared memory.

    Attributes:
        name: of the block, mpsim-<pid of the coordinator>-<token>.
        arrays: views by name, arrays and records; they are dropped by `close`, and never handed out of the engine.
        calls: arguments of kernels, made of these, by whom they are for; they are dropped, too.
    """

    def __init__(self, specs: Specs, name: str | None = None, alone: bool = False):
        """Holds nothing yet, so that its owner knows of the block before there is anything to give back.

        alone: whether no other process attaches, so that memory of this process will do where shared memory is refused.
        """
        self.name: str = name or f"mpsim-{os.getpid()}-{secrets.token_hex(4)}"
        self.specs = specs
        self.alone = alone
        self.nbytes: int = _offsets(specs)[-1]
        self.arrays: dict[str, Any] = {}
        self.calls: dict[Any, Any] = {}
        self._memory: SharedMemory | None = None
        self._owner = False
        self._creator = os.getpid()

    def create(self) -> None:
        """Create and reserve the block, filled with zeros. Ctrl-C waits so long.

        A block of one process takes private memory where there is enough of it, but not of shared memory.
        """
        with interrupts_held_back():
            _start_tracker()
            try:
                with self.closed_on_error():
                    self._create()
            except OSError as error:
                if not is_of_the_system(error):
                    raise
                if not (
                    self.alone and error.errno in _NO_SHARED_MEMORY and self.nbytes < psutil.virtual_memory().available
                ):
                    raise refusal_of_block(self.nbytes, error) from error
                with self.closed_on_error():
                    self._memory = _Private(self.nbytes)
                    self._map(self._memory)

    @contextmanager
    def closed_on_error(self) -> Iterator[None]:
        """Close the block if what it is filled with in the meantime cannot be had."""
        try:
            yield
        except BaseException:
            self.close()
            raise

    def _create(self) -> None:
        # SharedMemory registers a block that it has made. A kill in between, which threads that wait for each other
        # make likely, would leave it for ever; a name that never came to be is no harm. (Under `-W error` it is some:
        # the tracker of CPython then ends at the first name that it cannot find. `remove_stale_blocks` finds the rest.)
        resource_tracker.register(f"/{self.name}", "shared_memory")
        self._owner = True
        self._memory = memory = SharedMemory.__new__(SharedMemory)  # `close` knows of it at every line of what follows
        try:
            memory.__init__(self.name, create=True, size=self.nbytes)
        except BaseException:
            resource_tracker.register(f"/{self.name}", "shared_memory")  # it may have taken itself off the list
            raise
        # Without this a too small /dev/shm would only show later, as SIGBUS at the first write.
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(memory._fd, 0, self.nbytes)  # type: ignore[attr-defined]
        with suppress(OSError):  # a system without such locks; then the process number alone tells who is dead
            # Held until the owner closes the block or dies, however that happens and in whatever container.
            fcntl.flock(memory._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # type: ignore[attr-defined]
        self._map(memory)

    @classmethod
    def attach(cls, name: str, specs: Specs) -> "SharedBlock":
        """Map an existing block in a worker, leaving its clean-up to the coordinator."""
        block = cls(specs, name)
        try:
            if sys.version_info >= (3, 13):
                block._memory = _Attached(name, track=False)
            else:
                with _registering_nothing():
                    block._memory = _Attached(name)
        except FileNotFoundError:
            raise
        except OSError as error:
            raise refusal_of_block(block.nbytes, error) from error
        block._map(block._memory)
        return block

    def _map(self, memory: SharedMemory) -> None:
        for (name, (dtype, shape)), offset in zip(self.specs.items(), _offsets(self.specs), strict=False):
            # frombuffer holds the block: closing while a view lives raises instead of crashing at the next read.
            flat: NDArray[Any] = np.frombuffer(cast(memoryview, memory.buf), dtype, math.prod(shape), offset)
            self.arrays[name] = flat.reshape(shape)[()]  # of shape (): the record itself, no copy of it

    def close(self) -> None:
        """Drop the views and the mapping; the owner also removes the block. May be called again, and at any moment."""
        self.arrays.clear()
        self.calls.clear()
        if (memory := self._memory) is not None:
            try:
                memory.close()
            except BufferError:
                # The traceback of an exception on its way up still holds a view. The mapping goes when that view goes;
                # SharedMemory must forget it, or it would complain when it is collected.
                if os.getpid() != self._creator:
                    _make_private(memory)
                memory._buf = memory._mmap = None  # type: ignore[attr-defined]
                memory.close()
        if self._owner and os.getpid() == self._creator:  # a fork of the coordinator must not take its block away
            self._owner = False
            try:
                _posixshmem.shm_unlink(f"/{self.name}")
            except OSError:
                if (FOLDER / self.name).exists():
                    return  # it may not be removed; the tracker says so when the program ends
                # Never made; or a foreign Python before 3.13 that attached took the name for a leak on its exit.
            resource_tracker.register(f"/{self.name}", "shared_memory")  # a tracker that was started anew has no name
            resource_tracker.unregister(f"/{self.name}", "shared_memory")


@dataclass(frozen=True)
class StaleBlock:
    """A block whose owner is dead: its name, the process number of the owner, and its size."""

    name: str
    pid: int
    nbytes: int


def stale_blocks(folder: Path = FOLDER) -> list[StaleBlock]:
    """Blocks of mpsim whose owner is dead, by name; of this user only.

    A block counts as stale only if both are true: no process holds the lock that its owner holds while it lives, and no
    process has the owner's number, or only one that was started after the block was made. The lock also knows owners
    in other containers that share this folder, whose process numbers mean nothing here.
    """
    return [block for path in sorted(folder.glob("mpsim-*")) if (block := _as_stale(path)) is not None]


def remove_stale_blocks(folder: Path = FOLDER) -> list[StaleBlock]:
    """Remove `stale_blocks`, and nothing else. Returns those that were removed."""
    removed = []
    for block in stale_blocks(folder):
        with suppress(OSError):
            (folder / block.name).unlink()
            removed.append(block)
    return removed


def _as_stale(path: Path) -> StaleBlock | None:
    match = _OWN_NAME.fullmatch(path.name)
    if match is None:
        return None
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        status = os.fstat(descriptor)
        if status.st_uid != os.getuid() or not _owner_is_dead(int(match[1]), status.st_mtime):
            return None
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # BlockingIOError: it is held
        return None
    finally:
        os.close(descriptor)
    return StaleBlock(path.name, int(match[1]), status.st_size)


def _owner_is_dead(pid: int, made: float) -> bool:
    """Whether no process has this number, or one that did not live yet when the block was last known to be made."""
    try:
        process = psutil.Process(pid)
        return process.status() == psutil.STATUS_ZOMBIE or process.create_time() > made + _CLOCK_SLACK
    except psutil.NoSuchProcess:
        return True
    except psutil.Error:
        return False


def _start_tracker() -> None:
    """Start the resource tracker, where it does not run yet: registering would, with an error that names no cause."""
    try:
        resource_tracker.ensure_running()
    except OSError as error:
        raise refusal_of_process(
            "the resource tracker, a process of Python that removes shared memory after a kill,",
            error,
            "Every program with a simulation needs one, whatever the method. End other processes, or raise the limit.",
        ) from error


def _make_private(memory: SharedMemory) -> None:
    """Put zeros in place of a block, in this process alone: for a fork that returns into a call that has views of it.

    It would read and write its parent's discs. Kernels of the stepped solver do nothing on zeros; that of the exact one
    is called without any Python code between the look for its arguments and the call.
    """
    mapping: Any = memory._mmap  # type: ignore[attr-defined]
    address = np.frombuffer(mapping, np.uint8).__array_interface__["data"][0]
    access, kind = mmap.PROT_READ | mmap.PROT_WRITE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | MAP_FIXED
    if _map_memory(address, memory.size, access, kind, -1, 0) != address:
        raise OSError(ctypes.get_errno(), "the block of the parent cannot be unmapped in a fork")


class _Attached(SharedMemory):
    """A block in a worker. SharedMemory takes a name away if it cannot be mapped, whoever made it."""

    def unlink(self) -> None:
        """Nothing: the coordinator alone does."""


class _Private(_Attached):
    """Memory of this process alone, which needs no /dev/shm, descriptor or resource tracker."""

    def __init__(self, size: int):
        self._name, self._size = "private", size
        self._mmap = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        self._buf = memoryview(self._mmap)


@contextmanager
def _registering_nothing():
    """Keep SharedMemory from registering with the resource tracker (before 3.13 it has no parameter for that)."""
    register = resource_tracker.register
    resource_tracker.register = lambda name, rtype: None
    try:
        yield
    finally:
        resource_tracker.register = register


def _offsets(specs: Specs) -> list[int]:
    """Where each array begins in the block, and where the last one ends."""
    offsets = [0]
    for index, (dtype, shape) in enumerate(specs.values(), start=1):
        end, place = offsets[-1] + np.dtype(dtype).itemsize * math.prod(shape), index * STAGGER % PAGE
        offsets.append(end + (place - end) % PAGE)
    return offsets
