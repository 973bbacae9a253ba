"""Speeds above the bound are warned of, refused or sub-stepped, with numbers and a remedy."""

from itertools import pairwise

import numpy as np
import pytest
from support.scenes import gas, pair, quiet, simulate

import mpsim
from mpsim.engine import step_limits
from mpsim.engine.solvers import speeds


def test_a_disc_that_moves_more_than_its_radius_is_told_with_number_disc_and_remedy():
    text = (
        r"in frame 0 disc 0 moves 1.2 times its radius 0.5 in one step \(speed 6, step 0.1\); beyond one radius, "
        r"discs may pass through each other without a collision. Use dt=0.042, substeps=3 or "
        r"on_fast='substep'; method='event' has no such limit."
    )
    with pytest.warns(mpsim.FastWarning, match=text):
        mpsim.Simulation(pair(6.0), mpsim.Settings(dt=0.1)).close()
    quiet(pair(6.0), dt=0.042)
    quiet(pair(6.0), dt=0.1, substeps=3)
    quiet(pair(4.999), dt=0.1)  # just below the bound
    with mpsim.Simulation(pair(6.0), mpsim.Settings(dt=0.1, method="event")) as sim:
        sim.run(frames=1)


def test_above_the_bound_discs_do_pass_through_each_other_and_sub_steps_catch_them():
    settings = {"dt": 1.0, "method": "grid"}
    with simulate(pair(4.0), contact="impact", **settings) as sim:
        sim.run(frames=1)
        assert sim.state.velocity[0, 0] == 4, "the control: they have passed"
    state = quiet(pair(4.0), frames=1, dt=1.0, on_fast="substep")
    assert state.velocity[:, 0].tolist() == [-4, 4]
    assert np.allclose(state.position[:, 0], [10 - 0.5 - 3.5, 10 + 0.5 + 3.5])


def test_a_free_way_between_walls_bounds_the_step_too():
    scene = mpsim.Scene(width=1.2, height=9, position=[[0.6, 4]], velocity=[[1, 0]], radius=0.5)
    with pytest.warns(mpsim.FastWarning, match=r"1.5 times its free path 0.2 between the walls along x .* bounces are"):
        mpsim.Simulation(scene, mpsim.Settings(dt=0.3)).close()
    quiet(scene, dt=0.15)
    along = mpsim.Scene(width=1.2, height=9, position=[[0.6, 4]], velocity=[[0, 1]], radius=0.5)
    quiet(along, dt=0.3)


def test_too_many_meetings_in_a_step_are_told():
    scene = gas(64, 0.75)
    with pytest.warns(mpsim.FastWarning, match=r"a disc collides about [\d.]+ times in one step .* above 1 many"):
        mpsim.Simulation(scene, mpsim.Settings(dt=0.05)).close()
    quiet(scene, dt=0.01)


def test_a_disc_that_becomes_fast_is_told_once():
    with mpsim.Simulation(pair(0.5, side=60.0), mpsim.Settings(dt=0.01, method="grid")) as sim:
        sim.run(frames=40)
        with pytest.warns(mpsim.FastWarning, match=r"in frame 40 disc 2 moves 1.8 times") as told:
            sim.add((5, 5), (90, 1))
        assert len(told) == 1
        assert told[0].filename == __file__
        sim.add((5, 50), (90, 1))  # where warnings are errors
        sim.run(frames=5000)


def test_error_refuses_before_the_run_and_during_it():
    with pytest.raises(mpsim.TooFastError, match=r"1.2 times its radius .* on_fast='warn' runs it anyway"):
        mpsim.Simulation(pair(6.0), mpsim.Settings(dt=0.1, on_fast="error"))
    with mpsim.Simulation(pair(0.5, side=60.0), mpsim.Settings(dt=0.01, method="grid", on_fast="error")) as sim:
        sim.run(frames=40)
        with pytest.raises(mpsim.TooFastError, match="in frame 40 disc 2"):
            sim.add((5, 5), (90, 1))
        assert sim.frame == 40, "the simulation goes on living"
        assert len(sim.state.position) == 2, "and nothing was added"
        sim.run(frames=10)


def test_sub_steps_keep_every_frame_below_the_bound():
    scene = gas(60, 0.3, restitution=0.5, wall_restitution=0.5)
    seen = []
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.4, method="grid", on_fast="substep")) as sim:
        for _ in range(60):
            sim.run(frames=1)
            fastest = np.hypot(*sim.state.velocity.T).max()
            assert fastest * 0.4 / sim.substeps <= 0.5
            seen.append(sim.substeps)
    assert seen[0] > seen[-1] >= 1, "it takes fewer steps as the gas cools"
    assert all(a == b for frame, (a, b) in enumerate(pairwise(seen), 1) if frame % 16)


def test_the_smallest_disc_counts_for_what_gravity_adds():
    """In 16 frames it adds 64, and the smallest moves half its radius at most: 64 * 0.1 / 0.05 / 0.5 steps, and those
    of the disc that is fastest for its size now."""
    scene = mpsim.Scene(
        width=9, height=90, position=[[4, 80], [2, 80]], velocity=[[1, 0], [0, 0]], radius=[0.5, 0.05], gravity=(0, -40)
    )
    limits = step_limits.StepLimits(scene, mpsim.Settings(dt=0.1, on_fast="substep"), has_steps=True)
    assert limits.substeps_for(speeds.speeds_of(scene.velocity, scene.radii, scene), 0) == 257


def test_what_would_need_absurdly_many_sub_steps_is_refused():
    with pytest.raises(mpsim.TooFastError, match=r"at most 10000 sub-steps, and would need 4e\+12\. Use a smaller dt"):
        mpsim.Simulation(pair(1e12), mpsim.Settings(dt=1.0, on_fast="substep"))
    falling = mpsim.Scene(width=9, height=9, position=[[4, 8]], velocity=[[1, 0]], radius=0.5, gravity=(0, -1e15))
    words = r"a speed of 1\.6e\+16 within 16 frames of frame 0, with which it moves 3\.2e\+16 times .* takes at most"
    with pytest.raises(mpsim.TooFastError, match=words):
        mpsim.Simulation(falling, mpsim.Settings(dt=1.0, on_fast="substep"))
    with pytest.raises(mpsim.TooFastError, match="No number of sub-steps is enough"):
        simulate(pair(1.0, apart=0.1, side=1.2), dt=1.0, on_fast="substep")


def test_light_discs_among_heavy_ones_are_told_before_they_are_fast():
    """At one speed for all the light half has next to no energy; with its share it is 28 times as fast."""
    scene = gas(100, 0.3)
    parts = {"width": scene.width, "height": scene.height, "position": scene.position, "velocity": scene.velocity}
    mixed = mpsim.Scene(**parts, radius=0.5, mass=np.where(np.arange(100) % 2, 1.0, 1e-3))
    text = r"once collisions have shared the energy out disc \d+ moves 1\.\d+ times its radius 0.5 in one step"
    with pytest.warns(mpsim.FastWarning, match=text):
        sim = mpsim.Simulation(mixed, mpsim.Settings(dt=0.01, method="grid"))
    with sim:
        light = np.arange(0, 100, 2)
        speeds = [np.hypot(*sim.state.velocity[light].T).max()]
        sim.run(frames=3000)
        speeds.append(np.hypot(*sim.state.velocity[light].T).max())
    assert speeds[0] * 0.01 < 0.1, "the control: at the start nothing is fast"
    assert speeds[1] * 0.01 > 0.5, "what was said came true"
    quiet(mixed, dt=0.002)
    quiet(mixed, dt=0.01, law="reflect")  # which gives no disc the speed of another
    quiet(scene, dt=0.01)
