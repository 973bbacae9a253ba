"""Velocities at thermal walls follow from the disc and its contact, in whatever way a run is made; also on tiles."""

import dataclasses

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.same_bits import SameBits
from support.scenes import gas, simulate, state_after

import mpsim
from mpsim import ThermalWalls

WALLS = ThermalWalls(left=4.0, right=4.0, bottom=4.0, top=4.0, seed=5)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


class TestThermalWalls(SameBits):
    features = {"thermal_walls": WALLS}  # noqa: RUF012
    dt = 0.05

    @pytest.mark.parametrize("change", [{"seed": 6}, {"left": 5.0}, {"top": None}])
    def test_other_walls_have_other_bits(self, change, expected):
        self.assert_other_bits(expected, thermal_walls=dataclasses.replace(WALLS, **change))


@pytest.mark.long  # a compilation of the kernels of tiles
@pytest.mark.parametrize("workers", [2, 3])
def test_the_exact_solver_has_the_same_bits_on_tiles(workers):
    large = gas(4000, 0.4, seed=2, thermal_walls=WALLS)
    alone = state_after(large, 20, method="event", dt=0.05)
    with simulate(large, method="event", dt=0.05, workers=workers) as sim:
        sim.run(frames=20)
        assert len(sim.pids) == workers - 1
        assert_same_bits(sim.state, alone, f"{workers} workers")


# --- one contact

COUNT = 400


def shot(**features):
    """Discs that fly to the right wall alone, each in a lane of its own, with the speeds 1 to 2."""
    places = np.stack([np.full(COUNT, 6.0), 8.0 * np.arange(COUNT) + 4], axis=1)
    velocity = np.stack([1 + np.arange(COUNT) / COUNT, np.zeros(COUNT)], axis=1)
    return mpsim.Scene(width=8, height=8.0 * COUNT, position=places, velocity=velocity, radius=0.25, **features)


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_disc_leaves_the_wall_at_the_instant_at_which_it_came_there(method):
    """x and y then follow from the new velocity and the time since the contact. The control: the wall next to it."""
    scene = shot(thermal_walls=ThermalWalls(right=0.25, seed=1))
    state = state_after(scene, 50, method=method, dt=0.04, contact="impact")
    time = 2.0 - (8 - 0.25 - 6.0) / scene.velocity[:, 0]
    hit = time > 0.02
    vx, vy = state.velocity[hit].T
    assert hit.sum() > COUNT / 2
    assert (vx < 0).all()
    assert np.abs(state.position[hit, 0] - (7.75 + vx * time[hit])).max() < 1e-9
    moved = state.position[hit, 1] - scene.position[hit, 1]
    assert np.abs(moved - vy * time[hit]).max() < 1e-9
    assert (vx**2).mean() == pytest.approx(2 * 0.25, rel=4 / np.sqrt(hit.sum())), "twice that of a gas: Rayleigh"
    assert (vy**2).mean() == pytest.approx(0.25, rel=4 * np.sqrt(2 / hit.sum()))
    other = state_after(shot(thermal_walls=ThermalWalls(left=0.25, seed=1)), 50, method=method, dt=0.04,
                        contact="impact")  # fmt: skip
    assert np.abs(other.velocity[hit, 0] + scene.velocity[hit, 0]).max() < 1e-12, "an elastic wall"
