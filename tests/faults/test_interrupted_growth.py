"""Ctrl-C while discs are added, which may move coordinator and workers to another block: all or nothing."""

import pytest
from support.processes import assert_clean, run_script

SCRIPT = """
import os, signal, threading, time, warnings
import numpy as np
import mpsim
from support.scenes import lattice, simulate, state_after

warnings.simplefilter("ignore", mpsim.FastWarning)  # of a box that is too full
more = np.clip(lattice(12, 12).position, 0.6, 8.4)


def attempt(seconds):
    sim = simulate(lattice(8, 8), method="{method}", workers=2, start_method="fork", precision="float64")
    sim.run(frames=1)
    before = sim.state
    ctrl_c = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    finished = False
    try:
        ctrl_c.start()
        sim.add(more, np.zeros_like(more))
        finished = True
        ctrl_c.join()
        time.sleep(1)
    except KeyboardInterrupt:
        pass
    try:
        check(sim, before)
    except mpsim.errors.ClosedError:
        pass  # a simulation that cannot go on says so
    sim.close()
    return not finished


def check(sim, before):
    state = sim.state
    added = len(state.position) - 64
    assert added in (0, len(more)) and added == sim.count - 64, added
    assert np.array_equal(state.position[:64], before.position), "discs have moved"
    assert np.array_equal(state.position[64:], more[:added]), "half of the discs were added"
    scene = mpsim.Scene(width=9, height=9, position=state.position, velocity=state.velocity, radius=0.5)
    sim.run(frames=3)
    assert sim.digest() == state_after(scene, 3, method="grid").digest(), "the run went on from another state"


print(sum(attempt(number * {step}) for number in range({attempts})) > 3)
"""


@pytest.mark.slow
@pytest.mark.parametrize(("method", "step"), [("grid", 5e-6), ("parallel", 4e-5)])
def test_an_interrupt_while_discs_are_added_leaves_a_whole_state_or_a_closed_simulation(method, step):
    """Ctrl-C comes a little later each time, so that over the attempts it meets every part of the growth."""
    outcome = run_script(SCRIPT.format(method=method, attempts=60, step=step), bound=60, warm=True)
    assert_clean(outcome)
    assert outcome.out == "True\n", "hardly any interrupt came in time, which tests little"


@pytest.mark.long
@pytest.mark.timeout(600)
def test_an_interrupt_at_any_moment_of_a_growth_does_no_harm(figures):
    outcome = run_script(SCRIPT.format(method="parallel", attempts=2000, step=1e-6), bound=500, warm=True)
    assert_clean(outcome)
    deed = "Ctrl-C at 2000 moments while discs are added"
    figures.note("R8", "parallel on 2", deed, "a complete state or a closed simulation", "2000 of 2000")
