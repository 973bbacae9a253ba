"""What this process may use of the machine: cores, garbage collection."""

import contextlib
import ctypes
import gc
import math
import multiprocessing
import os
from collections.abc import Generator
from pathlib import Path

import psutil

# --- Number of cores that this process may use: the smaller of CPU affinity and container quota


def usable_cores() -> int:
    """Cores that this process may use, at least 1.

    The least of: the machine's cores, the CPU affinity, the cgroup's CPU quota (rounded up), and PYTHON_CPU_COUNT.
    """
    limits = [psutil.cpu_count() or 1]
    if hasattr(os, "sched_getaffinity"):  # which needs no file descriptor, as that of psutil does
        limits.append(len(os.sched_getaffinity(0)))
    limits.extend(math.ceil(quota) for quota in _cgroup_quotas())
    wanted = os.environ.get("PYTHON_CPU_COUNT", "")
    if wanted.isdecimal() and len(wanted) < 10:
        limits.append(int(wanted))
    return max(min(limits), 1)


def may_start_processes() -> bool:
    """False inside a daemonic process (a worker of a pool), which Python forbids to have children."""
    return not multiprocessing.current_process().daemon


def _cgroup_quotas() -> list[float]:
    """CPU quotas, in cores, of this process's cgroups of both versions and of all groups above them.

    A container sees its own group at the top, also where its path is that of the host, which leads nowhere.
    """
    quotas: list[float] = []
    try:
        text = Path("/proc/self/cgroup").read_text(errors="surrogateescape")
    except OSError:
        return []
    for line in text.splitlines():
        _, controllers, path = line.split(":", 2)
        if not controllers:
            top, files = Path("/sys/fs/cgroup"), ["cpu.max"]
        elif "cpu" in controllers.split(","):
            top, files = Path("/sys/fs/cgroup/cpu"), ["cpu.cfs_quota_us", "cpu.cfs_period_us"]
        else:
            continue
        own = top / path.lstrip("/")
        for group in (own, *own.parents):
            if group.is_relative_to(top):
                quotas += _quota(*(group / file for file in files))
    return quotas


def _quota(*files: Path) -> list[float]:
    """Quota over period, read from one file with both or from two files; nothing where there is no limit."""
    try:
        quota, period = " ".join(file.read_text() for file in files).split()[:2]
        return [float(quota) / float(period)] if quota not in ("max", "-1") else []
    except (OSError, ValueError):
        return []


# --- Cores of a process that is to be woken: the scheduler may wake it where its waker runs, and there it has to wait

_core = getattr(ctypes.CDLL(None), "sched_getcpu", None)  # of Linux


def cores_of(pid: int) -> set[int]:
    """Cores that a process may use; none if it is gone, or the system does not say."""
    with contextlib.suppress(AttributeError, OSError):
        return os.sched_getaffinity(pid)
    return set()


def keep_off_this_core(pid: int, cores: set[int]) -> None:
    """Let a process use all of its cores but that on which this one runs."""
    if _core is not None:
        with contextlib.suppress(OSError):
            os.sched_setaffinity(pid, cores - {_core()})


# --- Pauses garbage collection while very many objects are created


@contextlib.contextmanager
def garbage_collection_paused() -> Generator[None]:
    """Pause garbage collection, of which many objects that all stay make too much.

    For a million tuples it would take four fifths of the time, in a compilation a sixth.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
