"""The bits of features with random velocities: on workers, in pieces, after a resume or a death, replayed."""

import dataclasses

import pytest
from support.compare import assert_same_bits
from support.same_bits import FRAMES, SameBits
from support.scenes import gas, simulate, state_after

from mpsim import ThermalWalls, Thermostat

BATH = Thermostat(temperature=1.5, rate=2.0, seed=5)
WALLS = ThermalWalls(left=4.0, right=4.0, bottom=4.0, top=4.0, seed=5)

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
