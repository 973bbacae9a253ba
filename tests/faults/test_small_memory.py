"""Too little shared memory is an exception that names the sizes, before any worker starts; never a SIGBUS."""

import re
import subprocess

import pytest
from support.processes import Outcome, assert_clean, run_script

SIZE = 2 * 2**20
"""Bytes of the private /dev/shm: enough for a small scene, too little for a large one on several workers."""

PREFIX = [
    *("unshare", "--mount", "sh", "-c"),
    f'mount -t tmpfs -o size={SIZE} tmpfs /dev/shm && exec "$@"',
    "sh",
]

SCRIPT = """
import os
import mpsim
from support.scenes import lattice

def attempt(columns, method):
    try:
        with mpsim.Simulation(lattice(columns, 100), mpsim.Settings(method=method, workers=2)) as sim:
            sim.run(frames=3)
            print("ran")
    except mpsim.errors.SharedMemoryError as error:
        print(error)
    print(os.listdir("/dev/shm"))

attempt(columns=1000, method="parallel")
attempt(columns=1000, method="grid")
"""


def run_in_small_memory(text: str) -> Outcome:
    """Run a script that sees a /dev/shm of its own, which is small."""
    try:
        subprocess.run([*PREFIX, "true"], check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no private mount can be made here: {error}")
    return run_script(text, prefix=PREFIX)


def test_too_little_shared_memory_is_an_error_with_sizes_and_a_remedy():
    outcome = run_in_small_memory(SCRIPT)
    assert_clean(outcome)
    error, left, ran, left_after = outcome.out.splitlines()
    needed, free = (int(number.replace(",", "")) for number in re.findall(r"([\d,]+) bytes", error))
    assert needed > SIZE >= free > SIZE / 2, error
    assert "--shm-size=" in error
    assert "fewer discs" in error
    assert (left, ran, left_after) == ("[]", "ran", "[]")


def test_too_little_shared_memory_for_a_growth_keeps_the_simulation_as_it_was():
    outcome = run_in_small_memory("""
    import os
    import warnings
    import numpy as np
    import mpsim
    from support.scenes import lattice, state_after

    warnings.simplefilter("ignore", mpsim.FastWarning)  # of discs that are added where others are
    scene, more = lattice(60, 60), lattice(60, 60)
    with mpsim.Simulation(scene, mpsim.Settings(method="parallel", workers=2)) as sim:
        sim.run(frames=3)
        try:
            for _ in range(20):
                sim.add(more.position, more.velocity)
        except mpsim.errors.SharedMemoryError as error:
            print("refused")
        before = sim.state
        for number in (1, 20, 500):
            try:
                sim.add(more.position[:number], more.velocity[:number])
            except mpsim.errors.SharedMemoryError as error:
                print("refused again")
        assert (sim.count, sim.digest()) == (len(before.position), before.digest())
        sim.run(frames=3)
        assert sim.frame == 6
    print(os.listdir("/dev/shm"))
    """)
    assert_clean(outcome)
    assert outcome.out == "refused\n" + 3 * "refused again\n" + "[]\n"
