"""Ctrl-C while discs are added, which may move coordinator and workers to another block: all or nothing."""

import pytest
from support.processes import assert_clean, run_script

SCRIPT = """
import signal, time
import numpy as np
import mpsim
from support.scenes import lattice, simulate, state_after

signal.signal(signal.SIGALRM, signal.default_int_handler)
more = np.clip(lattice(12, 12).position, 0.6, 8.4)


def attempt(seconds):
    sim = simulate(lattice(8, 8), method="{method}", workers=2, start_method="fork", precision="float64")
    sim.run(frames=1)
    before = sim.state
    interrupted = False
    try:
        signal.setitimer(signal.ITIMER_REAL, seconds)
        sim.add(more, np.zeros_like(more))
        signal.setitimer(signal.ITIMER_REAL, 0)
    except KeyboardInterrupt:
        interrupted = True
    try:
        check(sim, before)
    except mpsim.ClosedError:
        pass  # a simulation that cannot go on says so
    sim.close()
    return interrupted


def check(sim, before):
    state = sim.state
    added = len(state.position) - 64
    assert added in (0, len(more)) and added == sim.count - 64, added
    assert np.array_equal(state.position[:64], before.position), "discs have moved"
    assert np.array_equal(state.position[64:], more[:added]), "half of the discs were added"
    scene = mpsim.Scene(width=9, height=9, position=state.position, velocity=state.velocity, radius=0.5)
    sim.run(frames=3)
    assert sim.digest() == state_after(scene, 3, method="grid").digest(), "the run went on from another state"


print(sum(attempt(0.0002 + number * {step}) for number in range({attempts})) > {attempts} / 8)
"""


@pytest.mark.parametrize("method", ["grid", "parallel"])
def test_an_interrupt_while_discs_are_added_leaves_a_whole_state_or_a_closed_simulation(method):
    outcome = run_script(SCRIPT.format(method=method, attempts=60, step=0.00004), bound=60)
    assert_clean(outcome)
    assert outcome.out == "True\n", "hardly any interrupt came in time, which tests little"


@pytest.mark.long
@pytest.mark.timeout(600)
def test_an_interrupt_at_any_moment_of_a_growth_does_no_harm():
    outcome = run_script(SCRIPT.format(method="parallel", attempts=2000, step=0.000002), bound=500)
    assert_clean(outcome)
