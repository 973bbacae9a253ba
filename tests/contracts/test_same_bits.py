"""The bits of features with spins and random velocities: on workers, in pieces, after a resume or a death, replayed."""

import dataclasses

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.same_bits import FRAMES, SameBits
from support.scenes import gas, simulate, state_after

import mpsim
from mpsim import ThermalWalls, Thermostat

BATH = Thermostat(temperature=1.5, rate=2.0, seed=5)
WALLS = ThermalWalls(left=4.0, right=4.0, bottom=4.0, top=4.0, seed=5)
ROUGH = {"friction": 0.4, "wall_friction": 0.3, "tangential_restitution": 0.5, "restitution": 0.9}

pytestmark = [pytest.mark.compiled, pytest.mark.slow, pytest.mark.timeout(300)]


class TestThermostat(SameBits):
    features = {"boundary": "periodic", "thermostat": BATH}  # noqa: RUF012

    def test_another_bath_has_other_bits(self, expected):
        self.assert_other_bits(expected, thermostat=dataclasses.replace(BATH, seed=6))

    def test_frames_are_counted_from_the_start(self, expected):
        """Also in pieces: counted anew from a state, they give other bits."""
        with self.begun() as sim:
            sim.run(frames=20)
            anew = self.scene().starting_from(sim.state)
        other = state_after(anew, FRAMES - 20, method="grid", dt=self.dt, contact="impact")
        assert other.digest() != expected.digest()


@pytest.mark.long
class TestThermalWalls(SameBits):
    features = {"thermal_walls": WALLS}  # noqa: RUF012
    dt = 0.05

    def test_other_walls_have_other_bits(self, expected):
        self.assert_other_bits(expected, thermal_walls=dataclasses.replace(WALLS, seed=6))

    @pytest.mark.parametrize("workers", [2, 3])
    def test_the_exact_solver_has_the_same_bits_on_tiles(self, workers):
        large = gas(4000, 0.4, seed=2, thermal_walls=WALLS)
        alone = state_after(large, 20, method="event", dt=0.05)
        with simulate(large, method="event", dt=0.05, workers=workers) as sim:
            sim.run(frames=20)
            assert len(sim.pids) == workers - 1
            assert_same_bits(sim.state, alone, f"{workers} workers")


@pytest.mark.long
class TestFriction(SameBits):
    features = {**ROUGH, "spin": 1.0}  # noqa: RUF012
    packing = 0.6

    @pytest.mark.parametrize("precision", ["float32", "float64"])
    def test_both_precisions_have_the_same_bits_on_workers(self, precision):
        settings = {"dt": 0.02, "contact": "push", "precision": precision}
        grid = state_after(self.scene(), FRAMES, method="grid", **settings)
        assert grid.spin.dtype == precision
        assert_same_bits(state_after(self.scene(), FRAMES, method="parallel", workers=3, **settings), grid, precision)

    def test_contacts_change_spins_which_are_in_the_digest(self, expected):
        """The control: another spin is another digest."""
        assert np.unique(expected.spin).size > 1000
        other = mpsim.State(expected.position, expected.velocity, spin=np.nextafter(expected.spin, 9), box=expected.box)
        again = mpsim.State(expected.position, expected.velocity, spin=expected.spin.copy(), box=expected.box)
        assert other.digest() != again.digest() == expected.digest()
