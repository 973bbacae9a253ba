"""What the system allows this process, for errors that say in numbers what it has refused."""

import errno
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psutil

from mpsim.errors import ResourceError, SharedMemoryError, is_of_the_system


@contextmanager
def refusals_named() -> Iterator[None]:
    """Turn a refusal of the system during the start of a simulation into a ResourceError.

    Raises:
        ResourceError: in place of an OSError that is none of mpsim's.
    """
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
    """The error for a shared block that cannot be had.

    Args:
        size: of the block [bytes].
        error: of the system.
    """
    need = f"the shared block needs {size:,} bytes"
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return SharedMemoryError(f"{need} and a file descriptor, {_descriptors(error)}")
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if error.errno == errno.ENOMEM and limit != resource.RLIM_INFINITY:
        return SharedMemoryError(
            f"{need} of address space; this process may have {limit:,} bytes, and uses "
            f"{psutil.Process().memory_info().vms:,}. Use fewer discs or precision='float32', or raise the limit "
            "(ulimit -v)."
        )
    if error.errno == errno.EFBIG:
        return SharedMemoryError(
            f"{need} in one file; this process may make files of {resource.getrlimit(resource.RLIMIT_FSIZE)[0]:,}. Use "
            "fewer discs or precision='float32', or raise the limit (ulimit -f)."
        )
    if error.errno in (errno.ENOSPC, errno.ENOMEM):
        return SharedMemoryError(
            f"{need}, and {_free()}. Shared memory must hold the whole block. Use fewer discs or precision='float32', "
            f"or enlarge it (docker run --shm-size={-(-size // 2**20) + 1}m; "
            "on Linux: mount -o remount,size=... /dev/shm)."
        )
    return SharedMemoryError(
        f"{need}, and cannot be made in /dev/shm ({error.strerror or error}; {_free()}). Shared memory must be there "
        "and writable for this user (on Linux: mount -o remount,rw /dev/shm; chmod 1777 /dev/shm)."
    )


NO_WORKERS = "Use fewer workers, or method='grid', which starts no workers."


def refusal_of_process(what: str, error: OSError | RuntimeError | EOFError, remedy: str = NO_WORKERS) -> ResourceError:
    """The error for a process or thread that cannot be started: a worker, say.

    Args:
        what: begins the sentence, without a verb.
        error: of the system, or of Python for a thread; EOFError: the fork server has ended.
        remedy: a sentence.
    """
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return ResourceError(f"{what} needs file descriptors, {_descriptors(error)}")
    why = str(error)
    if isinstance(error, EOFError | ConnectionError):
        why = "Python's fork server, which starts workers, ended. It may have been killed, or allowed no process"
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        rule = "There must be memory for one (free, ulimit -v)."
    elif isinstance(error, OSError) and error.errno != errno.EAGAIN and not isinstance(error, ConnectionError):
        rule = (
            "The current folder, a folder for temporary files (TMPDIR, of fewer than 80 characters) and "
            f"{sys.executable!r} must be there, and may be used."
        )
    else:
        processes = resource.getrlimit(resource.RLIMIT_NPROC)[0]
        most = "any number" if processes == resource.RLIM_INFINITY else f"{processes:,}"
        rule = (
            f"Starting one must be allowed; this user may have {most} of processes and threads (ulimit -u), and a "
            "container may have fewer."
        )
    return ResourceError(f"{what} could not be started: {why}. {rule} {remedy}")


def resident_bytes(pid: int) -> int:
    """Resident memory of a process [bytes]; 0 if it has ended, or the system does not say, as without descriptors."""
    try:
        return psutil.Process(pid).memory_info().rss
    except (psutil.Error, OSError):
        return 0


def demand_descriptors(number: int) -> None:
    """Check that so many descriptors are available: multiprocessing leaks some when it runs out.

    Raises:
        OSError: if not.
    """
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
