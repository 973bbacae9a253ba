"""How many cores may be used: the least of machine, affinity, container quota and the user's own limit."""

import os
from pathlib import Path

import pytest
from support.processes import assert_clean, run_script

from mpsim.core import cores


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """A pretended machine: `machine(cores=..., affinity=..., files={path: text})`."""

    def pretend(machine_cores=8, affinity=8, files=None):
        for path, text in (files or {}).items():
            (tmp_path / path.lstrip("/")).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path.lstrip("/")).write_text(text, errors="surrogateescape")
        monkeypatch.setattr(cores.psutil, "cpu_count", lambda: machine_cores)
        monkeypatch.setattr(cores.os, "sched_getaffinity", lambda pid: set(range(affinity)), raising=False)
        monkeypatch.setattr(cores, "Path", lambda path: tmp_path / str(path).lstrip("/"))
        monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)

    return pretend


MOUNTED = {
    1: "30 24 0:26 {} /sys/fs/cgroup/cpu rw,relatime shared:9 - cgroup cgroup rw,cpu,cpuacct\n",
    2: "30 24 0:26 {} /sys/fs/cgroup rw,relatime - cgroup2 cgroup2 rw,nsdelegate\n",
}


def groups(version, path, mounted="/"):
    """What a process in a group of this path sees, where the group `mounted` stands at the top."""
    line = f"5:memory:/\n3:cpu,cpuacct:{path}\n0::/\n" if version == 1 else f"0::{path}\n"
    mounts = "21 1 8:1 / / rw - ext4 /dev/sda1 rw\n31 24 0:27 / /sys/fs/cgroup/memory rw - cgroup cgroup rw,memory\n"
    return {"/proc/self/cgroup": line, "/proc/self/mountinfo": mounts + MOUNTED[version].format(mounted)}


def quota(folder, cores):
    """The files of a group of version 1."""
    return {f"{folder}/cpu.cfs_quota_us": f"{cores}00000\n", f"{folder}/cpu.cfs_period_us": "100000\n"}


V1, V2, TOP = groups(1, "/job"), groups(2, "/user/job"), "/sys/fs/cgroup/cpu"

CASES = {
    "no limits": ({}, 8),
    "fewer cores": ({"machine_cores": 4}, 4),
    "unknown cores": ({"machine_cores": None}, 1),
    "affinity": ({"affinity": 3}, 3),
    "no cgroup quota": ({"files": V2 | {"/sys/fs/cgroup/user/job/cpu.max": "max 100000\n"}}, 8),
    "quota of two cores": ({"files": V2 | {"/sys/fs/cgroup/user/job/cpu.max": "200000 100000\n"}}, 2),
    "quota rounded up": ({"files": V2 | {"/sys/fs/cgroup/user/job/cpu.max": "250000 100000\n"}}, 3),
    "quota of half a core": ({"files": V2 | {"/sys/fs/cgroup/user/job/cpu.max": "50000 100000\n"}}, 1),
    "quota of a parent": (
        {
            "files": V2
            | {
                "/sys/fs/cgroup/user/job/cpu.max": "max 100000\n",
                "/sys/fs/cgroup/user/cpu.max": "300000 100000\n",
            }
        },
        3,
    ),
    "quota of the root": ({"files": V2 | {"/sys/fs/cgroup/cpu.max": "400000 100000\n"}}, 4),
    "affinity below quota": (
        {"affinity": 2, "files": V2 | {"/sys/fs/cgroup/user/job/cpu.max": "500000 100000\n"}},
        2,
    ),
    "version 1": (
        {
            "files": V1
            | {
                "/sys/fs/cgroup/cpu/job/cpu.cfs_quota_us": "300000\n",
                "/sys/fs/cgroup/cpu/job/cpu.cfs_period_us": "100000\n",
            }
        },
        3,
    ),
    "version 1 unlimited": (
        {
            "files": V1
            | {
                "/sys/fs/cgroup/cpu/job/cpu.cfs_quota_us": "-1\n",
                "/sys/fs/cgroup/cpu/job/cpu.cfs_period_us": "100000\n",
            }
        },
        8,
    ),
    "version 1, quota of a parent": ({"files": groups(1, "/pod/own") | quota(f"{TOP}/pod", 2)}, 2),
    "version 1, own group at the top": ({"files": groups(1, "/pod/own", mounted="/pod/own") | quota(TOP, 2)}, 2),
    "version 1, below a group at the top": (
        {"files": groups(1, "/pod/own", mounted="/pod") | quota(f"{TOP}/own", 3) | quota(TOP, 5)},
        3,
    ),
    "version 1, another group of the same name": (
        {"files": groups(1, "/own", mounted="/pod") | quota(f"{TOP}/own", 1)},
        8,
    ),
    "version 2, own group at the top": (
        {"files": groups(2, "/docker/a", mounted="/docker/a") | {"/sys/fs/cgroup/cpu.max": "200000 100000\n"}},
        2,
    ),
    "other mounts without a source, with a dash for one, with a name that is not UTF-8": (
        {
            "files": V2
            | {
                "/proc/self/mountinfo": "40 24 0:30 / /a rw - tmpfs  rw\n41 24 0:31 / /b rw shared:2 - tmpfs - rw\n"
                "42 24 0:32 / /caf\udce9\x85 rw - tmpfs none rw\n" + MOUNTED[2].format("/"),
                "/sys/fs/cgroup/user/job/cpu.max": "200000 100000\n",
            }
        },
        2,
    ),
    "an empty file of a quota": ({"files": V2 | {"/sys/fs/cgroup/user/job/cpu.max": ""}}, 8),
    "unreadable quota": ({"files": V2 | {"/sys/fs/cgroup/user/job/cpu.max": "nonsense\n"}}, 8),
}


@pytest.mark.parametrize("case", CASES)
def test_the_least_limit_counts(case, machine):
    pretended, expected = CASES[case]
    machine(**pretended)
    assert cores.usable_cores() == expected


@pytest.mark.parametrize(("text", "expected"), [("3", 3), ("0", 1), ("99", 8), ("default", 8), ("", 8), ("-2", 8)])
def test_the_users_own_limit_counts_too(text, expected, machine, monkeypatch):
    machine()
    monkeypatch.setenv("PYTHON_CPU_COUNT", text)
    assert cores.usable_cores() == expected


def test_the_real_affinity_is_respected():
    first = min(os.sched_getaffinity(0))
    outcome = run_script(f"""
    import os
    os.sched_setaffinity(0, {{{first}}})
    import mpsim
    from mpsim.core.cores import usable_cores
    scene = mpsim.Scene.random(count=300, packing=0.3, radius=0.5)
    with mpsim.Simulation(scene, mpsim.Settings(method="parallel")) as sim:
        print(usable_cores(), sim.run(frames=2).workers)
    """)
    assert_clean(outcome)
    assert outcome.out == "1 1\n"


def test_this_machine_has_a_sensible_number():
    assert 1 <= cores.usable_cores() <= len(os.sched_getaffinity(0))
    assert Path("/proc/self").exists()
