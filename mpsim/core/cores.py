"""Number of cores that this process may use: the smaller of CPU affinity and container quota."""

import math
import multiprocessing
import os
from pathlib import Path

import psutil


def usable_cores() -> int:
    """Cores that this process may use, at least 1.

    The least of: the machine's cores, the CPU affinity, the cgroup's CPU quota (rounded up), and PYTHON_CPU_COUNT.
    """
    limits = [psutil.cpu_count() or 1]
    process = psutil.Process()
    if hasattr(process, "cpu_affinity"):
        limits.append(len(process.cpu_affinity() or [0]))
    limits.extend(math.ceil(quota) for quota in _cgroup_quotas())
    wanted = os.environ.get("PYTHON_CPU_COUNT", "")
    if wanted.isdecimal() and len(wanted) < 10:
        limits.append(int(wanted))
    return max(min(limits), 1)


def may_start_processes() -> bool:
    """False inside a daemonic process (a worker of a pool), which Python forbids to have children."""
    return not multiprocessing.current_process().daemon


def _cgroup_quotas() -> list[float]:
    """CPU quotas, in cores, of this process's cgroup and all above it (version 2), or of version 1's controller."""
    quotas = []
    try:
        lines = Path("/proc/self/cgroup").read_text().splitlines()
    except OSError:
        return []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            folder = Path("/sys/fs/cgroup") / path.lstrip("/")
            for place in (folder, *folder.parents):
                quotas += _quota(place / "cpu.max")
                if place == Path("/sys/fs/cgroup"):
                    break
        elif "cpu" in controllers.split(","):
            place = Path("/sys/fs/cgroup/cpu") / path.lstrip("/")
            quotas += _quota(place / "cpu.cfs_quota_us", place / "cpu.cfs_period_us")
    return quotas


def _quota(*files: Path) -> list[float]:
    """Quota over period, read from one file with both or from two files; nothing where there is no limit."""
    try:
        quota, period = " ".join(file.read_text() for file in files).split()[:2]
        return [float(quota) / float(period)] if quota not in ("max", "-1") else []
    except (OSError, ValueError):
        return []
