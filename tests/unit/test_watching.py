"""Speeds above the bound and numbers too coarse are warned of, refused or sub-stepped, with numbers and a remedy."""

import re
import warnings
from itertools import pairwise

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.engine import speed_estimates, step_limits


def pair(speed=1.0, apart=2.0, side=20.0, **more):
    """Two discs that approach each other head-on."""
    middle = side / 2
    places = [[middle - apart / 2, middle], [middle + apart / 2, middle]]
    box = {"width": side, "height": side, "radius": 0.5}
    return mpsim.Scene(position=places, velocity=[[speed, 0], [-speed, 0]], **{**box, **more})


def quiet(scene, frames=0, **settings):
    """Run without any warning at all; returns the state."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with mpsim.Simulation(scene, mpsim.Settings(method="grid", **settings)) as sim:
            sim.run(frames=frames)
            return sim.state


def test_a_disc_that_moves_more_than_its_radius_is_told_with_number_disc_and_remedy():
    text = (
        r"in frame 0 disc 0 moves 1.2 times its radius 0.5 in one step \(speed 6, step 0.1\); above 1 discs may pass "
        r"through each other unseen. Use dt=0.042, substeps=3 or on_fast='substep'; method='event' has no such bound."
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
    with pytest.warns(mpsim.FastWarning, match=r"a disc collides some [\d.]+ times in one step .* above 1 many"):
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
    with pytest.raises(mpsim.TooFastError, match=r"1.2 times its radius .* on_fast='warn' runs it all the same"):
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
    watch = step_limits.Watch(scene, mpsim.Settings(dt=0.1, on_fast="substep"), exact=False)
    assert watch.substeps_for(speed_estimates.pace_of(scene.velocity, scene.radii, scene), 0) == 257


def test_what_would_need_absurdly_many_sub_steps_is_refused():
    with pytest.raises(mpsim.TooFastError, match=r"at most 10000 sub-steps, and would need 4e\+12\. Use a smaller dt"):
        mpsim.Simulation(pair(1e12), mpsim.Settings(dt=1.0, on_fast="substep"))
    with pytest.raises(mpsim.TooFastError, match="No number of sub-steps is enough"):
        simulate(pair(1.0, apart=0.1, side=1.2), dt=1.0, on_fast="substep")


def test_a_box_too_large_for_the_precision_is_told_and_then_refused():
    far = pair(side=8000.0)
    with pytest.warns(mpsim.ResolutionWarning, match=r"in float32 coordinates are 0.000954 apart .* 0.0019 of"):
        mpsim.Simulation(far, mpsim.Settings(dt=0.1, precision="float32")).close()
    quiet(far, dt=0.1)
    quiet(pair(side=800.0), dt=0.1, precision="float32")
    text = r"radius must be at least 0.954 in a box of 1e\+06 x 1e\+06 in float32, .* got 0.5. Use precision='float64'"
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.Simulation(pair(side=1e6), mpsim.Settings(precision="float32"))


def test_steps_that_rounding_swallows_are_told():
    slow = pair(1e-5, side=100.0)
    with pytest.warns(mpsim.ResolutionWarning, match="most discs do not move at all. Use larger steps, or precision="):
        sim = mpsim.Simulation(slow, mpsim.Settings(dt=0.1, precision="float32", method="grid"))
    with sim:
        start = sim.state.position
        sim.run(frames=100)
        assert (sim.state.position == start).all(), "what was said is so"
    quiet(slow, dt=0.1)


def test_gravity_that_rounding_swallows_is_told():
    weak = pair(1.0, gravity=(0, -1e-15))
    with pytest.warns(mpsim.ResolutionWarning, match=r"gravity changes a velocity by 1e-17 in a step, which rounding"):
        mpsim.Simulation(weak, mpsim.Settings(dt=0.01, method="grid")).close()


def test_what_event_cannot_resolve_is_refused_or_told():
    with pytest.raises(mpsim.InputError, match="velocity must be at least 1e-100 for method='event', or all zero"):
        mpsim.Simulation(pair(1e-200), mpsim.Settings(dt=1.0, method="event"))
    with pytest.raises(mpsim.InputError, match=r"dt must be at most 1e\+100 for method='event'; got 1e\+110"):
        mpsim.Simulation(pair(), mpsim.Settings(dt=1e110, method="event"))
    with pytest.raises(mpsim.InputError, match=r"would take the fastest disc 5e\+18 times through the box"):
        mpsim.Simulation(pair(), mpsim.Settings(dt=1e20, method="event"))
    with pytest.warns(mpsim.ResolutionWarning, match="the square of the radius is lost"):
        mpsim.Simulation(pair(radius=1e-9), mpsim.Settings(dt=0.1, method="event")).close()


@pytest.mark.parametrize(("mass", "rule"), [(1e-300, "at least"), (1e200, "at most")])
def test_masses_that_the_precision_would_lose_are_refused(mass, rule):
    with pytest.raises(mpsim.InputError, match=re.escape(f"mass must be {rule}")):
        mpsim.Simulation(pair(mass=[mass, 1.0]), mpsim.Settings(dt=0.1))


def test_the_estimate_of_meetings_is_that_of_a_gas():
    """Of the exact solver's rate, 2.34 per time and disc at packing 0.3 and 21.2 at 0.7, both of this project."""
    for packing, rate in ((0.3, 2.34), (0.7, 21.2)):
        scene = gas(2000, packing)
        assert speed_estimates.pace_of(scene.velocity, scene.radii, scene).meetings == pytest.approx(rate, rel=0.2)


def test_the_number_of_cells_does_not_grow_with_the_aspect_of_a_box():
    scene = mpsim.Scene(width=4e9, height=4.0, position=[[1, 2], [3e9, 2]], velocity=[[1, 0], [-1, 0]], radius=0.5)
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.1, method="grid")) as sim:
        report = sim.run(frames=3)
    assert report.block_bytes < 2e6
    assert mpsim.Scene.random(count=10, width=4e9, height=4.0, radius=0.5).count == 10
    assert mpsim.Scene.random(count=10, width=1e6, height=1e6, radius=0.5).count == 10
    assert mpsim.Scene.random(count=3, width=1e200, height=1.0, radius=[0.1, 0.2, 0.3]).count == 3


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


@pytest.mark.parametrize("on_fast", ["error", "substep"])
def test_a_scene_without_discs_is_judged_alike_in_all_units_of_length(on_fast):
    """With lengths times 100 it was refused: no disc has no radius, and 1 was taken for it."""
    seen = []
    for unit in (0.01, 1.0, 100.0):
        scene = mpsim.Scene(
            width=10 * unit, height=10 * unit, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.5 * unit,
            gravity=(0, -unit), emitters=mpsim.Emitter((5 * unit, 9 * unit), (0.5 * unit, 0), interval=1.5),
        )  # fmt: skip
        with mpsim.Simulation(scene, mpsim.Settings(dt=0.1, method="naive", on_fast=on_fast)) as sim:
            steps = [sim.run(frames=4).frames and sim.substeps for _ in range(5)]
        seen.append(steps)
        heavy = mpsim.Scene(
            width=10 * unit, height=10 * unit, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.5 * unit,
            gravity=(0, -2 * unit), emitters=mpsim.Emitter((5 * unit, 9 * unit), (0, 0), interval=1.0),
        )  # fmt: skip
        found = step_limits.Watch(heavy, mpsim.Settings(dt=0.1), exact=False).forecast()
        assert found is not None
        assert "after a fall through the box a disc moves 1.26 times its radius" in found, "the control"
    assert seen[0] == seen[1] == seen[2]


def test_discs_that_share_their_energy_meet_in_the_box_at_the_start():
    """A piston that starts half-way leaves half the box, where they meet more than twice as often."""
    places = np.array([[0.6 + 1.1 * (i // 8), 0.6 + 1.1 * (i % 8)] for i in range(40)])
    parts = {"height": 9.0, "position": places, "velocity": np.ones((40, 2)), "radius": 0.5, "mass": np.arange(1, 41.0)}
    half = mpsim.Scene(width=12, **parts, piston=mpsim.Piston("right", -1, 5.7, start=6))
    whole = mpsim.Scene(width=6, **parts)
    assert [
        speed_estimates.pace_in_equilibrium(speed_estimates.Pace(), scene).meetings for scene in (half, whole)
    ] == pytest.approx([speed_estimates.pace_in_equilibrium(speed_estimates.Pace(), whole).meetings] * 2)
