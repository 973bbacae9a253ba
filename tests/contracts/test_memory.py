"""Memory of a large scene, per disc: the shared block, and what the process needs at most beside it."""

import pytest
from support.processes import assert_clean, run_script

pytestmark = [pytest.mark.compiled, pytest.mark.slow]

MOST = {"grid": (105, 220), "event": (290, 450)}
"""Bytes of a disc in the block, and at the peak of a run from its start: a quarter to a half more than in 2026."""

SCRIPT = """
import warnings
import mpsim
from pathlib import Path

def peak():
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024

def life(count, held):
    scene = mpsim.Scene.lattice(count=count, packing=0.4, radius=0.5, seed=3)
    with mpsim.Simulation(scene, mpsim.Settings(method={method!r}, dt=0.02)) as sim:
        block = sim.run(frames=3).block_bytes
        states = [sim.state for _ in range(held)]
    return block

life(3000, 1)  # kernels are loaded
before, count = peak(), 400_000
for held in (0, 16):
    print(life(count, held) / count, (peak() - before) / count)
"""


@pytest.mark.timeout(520)
@pytest.mark.parametrize("method", MOST)
def test_memory_of_a_disc_does_not_grow(method):
    """The control: states that are kept show."""
    for _ in range(2):  # the first time kernels are compiled, which takes more memory than the discs
        outcome = run_script(SCRIPT.format(method=method), bound=250)
    assert_clean(outcome)
    (block, peak), (same, more) = (map(float, line.split()) for line in outcome.out.splitlines())
    most_block, most_peak = MOST[method]
    assert block == same < most_block
    assert peak < most_peak < more
