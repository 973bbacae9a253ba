"""Random velocities follow from seed, disc, and frame or contact: of a thermostat, and at thermal walls."""

import dataclasses

import numpy as np
import pytest
from support.scenes import scene_of, simulate, state_after

import mpsim
from mpsim import ThermalWalls, Thermostat
from mpsim.kernels import random_numbers

BATH = Thermostat(temperature=1.5, rate=2.0, seed=5)

pytestmark = pytest.mark.plain


def lonely(count=30, **features):
    """Discs that meet nothing for a while, at rest: each has a lane of its own."""
    places = np.stack([np.full(count, 50.0), 4.0 * np.arange(count) + 2], axis=1)
    return scene_of(places, width=100, height=4 * count, radius=0.25, boundary="periodic", **features)


def chosen(frame, probability):
    """Discs that get new velocities after so many frames, by the generator itself."""
    return [disc for disc in range(30) if random_numbers.pair(BATH.seed, disc, frame, 0)[0] < probability]


def heated(frames, before=None, **settings):
    """Which discs had other velocities after each of the frames."""
    found, velocity = [], np.zeros((30, 2))
    with simulate(lonely(thermostat=BATH), dt=0.02, contact="impact", method="grid", **settings) as sim:
        for frame in range(frames):
            if before is not None:
                before(sim, frame)
            sim.run(frames=1)
            now = sim.state.velocity
            found.append(np.flatnonzero((now != velocity).any(axis=1)).tolist())
            velocity = now
    return found


@pytest.mark.parametrize("substeps", [1, 3])
def test_frames_decide_and_not_steps(substeps):
    """Velocities are given before the next frame, so a state shows them one frame later; none before the first."""
    probability = -np.expm1(-0.04)
    assert heated(12, substeps=substeps) == [[], *(chosen(frame, probability) for frame in range(1, 12))]


def test_frames_are_counted_on_after_a_change_of_dt():
    change = lambda sim, frame: sim.change(dt=0.01) if frame == 6 else None  # noqa: E731
    probability = {frame: -np.expm1(-0.04 if frame < 6 else -0.02) for frame in range(1, 14)}
    expected = [[], *(chosen(frame, probability[frame]) for frame in range(1, 14))]
    assert heated(14, change) == expected
    assert expected[7:] != expected[1:8], "the control: frames counted anew"


def test_the_exact_solver_gives_the_same_velocities_at_the_end_of_a_frame():
    """So its state shows them one frame sooner, and until discs collide they are in the same places."""
    bare = lonely(thermostat=BATH)
    grid, exact = (state_after(bare, 20, method=method, dt=0.02, contact="impact") for method in ("grid", "event"))
    assert np.abs(grid.position - exact.position).max() < 1e-12
    later = state_after(bare, 21, method="grid", dt=0.02, contact="impact")
    assert (later.velocity == exact.velocity).all()
    assert (later.velocity != grid.velocity).any(), "the control"


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_discs_that_have_left_stay_as_they_are(method):
    """The control: those that are there get new velocities."""
    with simulate(lonely(thermostat=dataclasses.replace(BATH, rate=1e3)), method=method, dt=0.02) as sim:
        sim.remove([0, 1])
        sim.run(frames=5)
        assert (sim.state.velocity[:2] == 0).all()
        assert (sim.state.velocity[2:] != 0).all()


COUNT = 300


def shot(**features):
    """Discs that fly to the right wall alone, each in a lane of its own, with the speeds 1 to 2."""
    places = np.stack([np.full(COUNT, 6.0), 8.0 * np.arange(COUNT) + 4], axis=1)
    velocity = np.stack([1 + np.arange(COUNT) / COUNT, np.zeros(COUNT)], axis=1)
    return mpsim.Scene(width=8, height=8.0 * COUNT, position=places, velocity=velocity, radius=0.25, **features)


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_disc_leaves_the_wall_at_the_instant_at_which_it_came_there(method):
    """x and y then follow from the new velocity and the time since the contact. The control: the wall next to it."""
    how = {"method": method, "dt": 0.08, "contact": "impact"}
    scene = shot(thermal_walls=ThermalWalls(right=0.25, seed=1))
    state = state_after(scene, 25, **how)
    time = 2.0 - (8 - 0.25 - 6.0) / scene.velocity[:, 0]
    hit = time > 0.02
    vx, vy = state.velocity[hit].T
    assert hit.sum() > COUNT / 2
    assert (vx < 0).all()
    assert np.abs(state.position[hit, 0] - (7.75 + vx * time[hit])).max() < 1e-9
    assert np.abs(state.position[hit, 1] - scene.position[hit, 1] - vy * time[hit]).max() < 1e-9
    assert (vx**2).mean() == pytest.approx(2 * 0.25, rel=4 / np.sqrt(hit.sum())), "twice that of a gas: Rayleigh"
    assert (vy**2).mean() == pytest.approx(0.25, rel=4 * np.sqrt(2 / hit.sum()))
    other = state_after(shot(thermal_walls=ThermalWalls(left=0.25, seed=1)), 25, **how)
    assert np.abs(other.velocity[hit, 0] + scene.velocity[hit, 0]).max() < 1e-12, "an elastic wall"
