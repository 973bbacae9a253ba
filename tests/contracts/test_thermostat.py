"""A thermostat's velocities follow from seed, disc and frame: on workers, in pieces, after a resume or a death."""

import dataclasses

import numpy as np
import pytest
from support.same_bits import FRAMES, SameBits
from support.scenes import simulate, state_after

import mpsim
from mpsim import Thermostat
from mpsim.kernels import random_numbers

BATH = Thermostat(temperature=1.5, rate=2.0, seed=5)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


class TestThermostat(SameBits):
    features = {"boundary": "periodic", "thermostat": BATH}  # noqa: RUF012

    @pytest.mark.parametrize("change", [{"seed": 6}, {"rate": 2.5}, {"temperature": 1.25}])
    def test_another_bath_has_other_bits(self, change, expected):
        self.assert_other_bits(expected, thermostat=dataclasses.replace(BATH, **change))

    def test_frames_are_counted_from_the_start(self, expected):
        """Also in pieces: counted anew from a state, they give other bits."""
        with self.begun() as sim:
            sim.run(frames=20)
            halfway = sim.state
        anew = mpsim.Scene(**{name: getattr(self.scene(), name) for name in ("width", "height", "radius", "boundary")},
                           position=halfway.position, velocity=halfway.velocity, thermostat=BATH)  # fmt: skip
        other = state_after(anew, FRAMES - 20, method="grid", dt=self.dt, contact="impact")
        assert other.digest() != expected.digest()


# --- which discs, and when


def lonely(count=30, **features):
    """Discs that meet nothing for a while, at rest: each has a lane of its own."""
    places = np.stack([np.full(count, 50.0), 4.0 * np.arange(count) + 2], axis=1)
    return mpsim.Scene(width=100, height=4 * count, position=places, velocity=np.zeros((count, 2)), radius=0.25,
                       boundary="periodic", **features)  # fmt: skip


def chosen(frame, count, probability, seed=5):
    """Discs that get new velocities after so many frames, by the generator itself."""
    return [disc for disc in range(count) if random_numbers.pair(seed, disc, frame, 0)[0] < probability]


def heated(frames, dt, before=None, **settings):
    """Which discs had other velocities after each of the frames, of one step each."""
    found, velocity = [], np.zeros((30, 2))
    with simulate(lonely(thermostat=BATH), dt=dt, contact="impact", **settings) as sim:
        for frame in range(frames):
            if before is not None:
                before(sim, frame)
            sim.run(frames=1)
            now = sim.state.velocity
            found.append(np.flatnonzero((now != velocity).any(axis=1)).tolist())
            velocity = now
    return found


@pytest.mark.parametrize("settings", [{"method": "grid"}, {"method": "grid", "substeps": 3}])
def test_frames_decide_and_not_steps(settings):
    """Velocities are given before the next frame, so a state shows them one frame later; none before the first."""
    probability = -np.expm1(-0.04)
    assert heated(12, 0.02, **settings) == [[], *(chosen(frame, 30, probability) for frame in range(1, 12))]


def test_frames_are_counted_on_after_a_change_of_dt():
    change = lambda sim, frame: sim.change(dt=0.01) if frame == 6 else None  # noqa: E731
    probability = {frame: -np.expm1(-0.04 if frame < 6 else -0.02) for frame in range(1, 14)}
    expected = [[], *(chosen(frame, 30, probability[frame]) for frame in range(1, 14))]
    assert heated(14, 0.02, change, method="grid") == expected
    assert expected[7:] != expected[1:8], "the control: frames counted anew"


def test_the_exact_solver_gives_the_same_velocities_at_the_end_of_a_frame():
    """So its state shows them one frame sooner, and until discs collide they are in the same places."""
    bare = lonely(thermostat=BATH)
    grid, exact = (state_after(bare, 20, method=method, dt=0.02, contact="impact") for method in ("grid", "event"))
    assert np.abs(grid.position - exact.position).max() < 1e-12
    later = state_after(bare, 21, method="grid", dt=0.02, contact="impact")
    assert (later.velocity == exact.velocity).all()
    assert (later.velocity != grid.velocity).any(), "the control"


@pytest.mark.long  # a compilation
def test_discs_that_have_left_stay_as_they_are():
    """The control: those that are there get new velocities."""
    with simulate(lonely(thermostat=dataclasses.replace(BATH, rate=1e3)), method="naive", dt=0.02) as sim:
        sim.remove([0, 1])
        sim.run(frames=5)
        assert (sim.state.velocity[:2] == 0).all()
        assert (sim.state.velocity[2:] != 0).all()
