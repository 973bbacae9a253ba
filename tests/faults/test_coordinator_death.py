"""A coordinator that is killed takes its workers with it at once, and its shared block soon after."""

import json
import signal
import time

import pytest
from support.processes import Script, assert_nothing_left_of, blocks_of, is_gone, wait_until
from support.selection import long_but

WORKERS_GONE_WITHIN = 2.0
BLOCK_GONE_WITHIN = 10.0
"""Seconds. The block goes when the last process lets go of the resource tracker's pipe, the fork server among them."""

SCRIPT = """
import json, time
import mpsim
from support.scenes import lattice

sim = mpsim.Simulation(lattice({columns}, 100), mpsim.Settings(method="parallel", workers=3), start_method="{start}")
sim.run(frames=3)
print(json.dumps(sim.pids))
{then}
"""

RUNNING = "sim.run(frames=10**9)"
IDLE = "time.sleep(1000)"


def kill_coordinator(script, pids):
    """Kill the coordinator alone, and require that nothing of it remains."""
    script.send(signal.SIGKILL)
    killed = time.monotonic()
    assert wait_until(lambda: all(is_gone(pid) for pid in pids), WORKERS_GONE_WITHIN), "workers outlive the coordinator"
    assert wait_until(lambda: not blocks_of(script.pid), BLOCK_GONE_WITHIN), "the block outlives everybody"
    assert_nothing_left_of(script.pid)
    return time.monotonic() - killed


@pytest.mark.slow
@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("start", "then"),
    long_but(
        [("fork", RUNNING), ("fork", IDLE), ("spawn", RUNNING), ("forkserver", RUNNING), ("forkserver", IDLE)],
        *(("fork", RUNNING), ("spawn", RUNNING), ("forkserver", IDLE)),
    ),
)
def test_a_killed_coordinator_leaves_no_worker_and_no_block(start, then):
    with Script(SCRIPT.format(start=start, then=then, columns=100)) as script:
        pids = json.loads(script.line())
        assert len(pids) == 2
        time.sleep(0.2)
        assert not any(is_gone(pid) for pid in pids)
        assert len(blocks_of(script.pid)) == 1
        kill_coordinator(script, pids)


@pytest.mark.slow
@pytest.mark.timeout(60)
@pytest.mark.parametrize(("start", "delay"), [("fork", 0.0), ("spawn", 0.3), ("forkserver", 0.3)])
def test_a_coordinator_killed_while_workers_start_leaves_nothing(start, delay):
    text = SCRIPT.format(start=start, then=RUNNING, columns=10).replace("sim = ", 'print("starting"); sim = ')
    with Script(text) as script:
        assert script.line() == "starting"
        time.sleep(delay)
        kill_coordinator(script, [])
