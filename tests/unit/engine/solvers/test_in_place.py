"""Discs read where they lie are those of the state, by number; reading them changes nothing."""

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim.engine.simulation import read_in_place


def columns(discs):
    """Copies in the order of the numbers."""
    order = np.argsort(discs.number)
    return np.stack([discs.x, discs.y], axis=1)[order], np.stack([discs.vx, discs.vy], axis=1)[order]


@pytest.mark.parametrize("method", ["grid", "event"])
def test_they_are_those_of_the_state(method):
    scene = gas(300, 0.4)
    with mpsim.Simulation(scene, mpsim.Settings(method=method)) as sim:
        sim.run(frames=150)
        position, velocity = read_in_place(sim, columns)
        assert (position == sim.state.position).all()
        assert (velocity == sim.state.velocity).all()
        assert read_in_place(sim, lambda discs: (discs.frame, discs.time, discs.box)) == (150, sim.time, scene.box)
        assert read_in_place(sim, lambda discs: discs.absent) is None
        if method == "grid":
            assert read_in_place(sim, lambda discs: (np.diff(discs.number) < 0).any()), "in another order"
        before = sim.digest()
        read_in_place(sim, columns)
        assert sim.digest() == before


def test_a_closed_simulation_is_not_read():
    sim = mpsim.Simulation(gas(300, 0.4), mpsim.Settings(method="grid"))
    sim.close()
    with pytest.raises(mpsim.errors.ClosedError):
        read_in_place(sim, columns)
