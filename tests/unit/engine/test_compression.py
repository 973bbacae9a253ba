"""Discs that a scene presses into each other are warned of or refused; those that only move in long steps are not."""

import warnings

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.engine import compression

PRESSED = "discs are pressed into each other: at time"


def closing(restitution, **more):
    """30 discs and a peg, to which a piston leaves packing 0.8: no bound excludes it, and no motion leads to it."""
    features = {"obstacles": mpsim.FixedDisc((2, 3), 1.9), "piston": mpsim.Piston("right", -0.5, 6.8)}
    lossy = {"restitution": restitution, "wall_restitution": restitution}
    return mpsim.Scene.random(
        count=30, width=20, height=6, radius=0.5, seed=2, temperature=0.1, **features, **lossy, **more
    )


def complaint(scene, until, **settings):
    """What a run is refused for, and the time by then; None and the end where it is not."""
    with mpsim.Simulation(scene, mpsim.Settings(**{"method": "naive", "on_fast": "error", **settings})) as sim:
        try:
            sim.run(until=until)
        except mpsim.TooFastError as error:
            return str(error), sim.time, mpsim.measure.overlap(sim.state, scene).largest
    return None, until, 0.0


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["impact", "push"])
def test_a_piston_that_presses_lossy_discs_is_refused_while_they_overlap_little(contact):
    """They ended 0.39 of a diameter deep in each other, in silence, and a disc 0.22 in the obstacle."""
    text, time, deepest = complaint(closing(0.2), 30, contact=contact)
    assert text is not None
    assert PRESSED in text
    assert "smaller steps and on_fast='substep' do not help" in text
    assert "on_fast='warn' runs it anyway" in text
    assert time < 27
    assert deepest < 0.2


@pytest.mark.slow
def test_a_piston_that_presses_lossless_discs_is_refused_before_they_are_fast():
    """They were half a diameter deep when the first complaint came, of speeds, at time 25.68.

    How deep depends on the last bit of a place, as the run is chaotic: 0.17 to 0.43 over eight seeds.
    """
    text, time, deepest = complaint(closing(1.0), 30)
    assert text is not None
    assert PRESSED in text
    assert "pairs overlap by" in text
    assert time < 25.5
    assert deepest < 0.45


@pytest.mark.slow
@pytest.mark.parametrize("on_fast", ["warn", "substep"])
def test_it_is_warned_of_once_and_the_run_goes_on(on_fast):
    with mpsim.Simulation(closing(0.2), mpsim.Settings(method="naive", on_fast=on_fast)) as sim:
        with pytest.warns(mpsim.FastWarning, match=PRESSED) as found:
            sim.run(until=28)
        assert len(found) == 1
        assert found[0].filename == __file__
        assert sim.time == 28


def test_a_run_ends_as_often_as_the_warning_is_an_error():
    """Only once: it counted as given."""
    with mpsim.Simulation(closing(0.2), mpsim.Settings(method="naive")) as sim:
        for _ in range(2):
            with pytest.raises(mpsim.FastWarning, match=PRESSED):
                sim.run(until=28)
            assert sim.time < 27


def test_the_place_of_the_complaint_depends_neither_on_pieces_nor_on_resuming(tmp_path):
    scene, settings = closing(0.2), mpsim.Settings(method="naive", on_fast="error")
    whole = complaint(scene, 30)
    with mpsim.Simulation(scene, settings) as sim:
        for _ in range(20):
            sim.run(frames=101)
        path = sim.save(tmp_path / "half.mpsim")
    with mpsim.Simulation.resume(path) as sim:
        with pytest.raises(mpsim.TooFastError, match=PRESSED):
            sim.run(until=30)
        assert sim.time == whole[1]


def test_a_disc_pressed_between_piston_and_obstacle_is_found():
    """Slow enough never to be fast: a lossy disc to which a wall leaves no place."""
    scene = mpsim.Scene(
        width=20, height=6, position=[[5, 2], [8, 4]], velocity=[[0.1, 0], [0.2, 0.1]], radius=0.5,
        obstacles=mpsim.Polyline([(6.2, 0), (6.2, 6)], 0.1), piston=mpsim.Piston("right", -0.5, 6.9),
        restitution=0, wall_restitution=0,
    )  # fmt: skip
    text, *_ = complaint(scene, 30)
    assert text is not None
    assert "disc 1 is 0." in text
    assert "deep in obstacles[0]" in text


def test_discs_added_to_a_full_box_are_found_and_those_that_part_at_once_are_not():
    places = np.array([[0.5 + i // 6, 0.5 + i % 6] for i in range(36)])
    full = {"width": 6, "height": 6, "radius": 0.5, "restitution": 0.5, "wall_restitution": 0.5}
    scene = mpsim.Scene(**full, position=places, velocity=np.zeros((36, 2)))
    with simulate(scene, method="grid", on_fast="error") as sim:
        sim.add([(1, 1), (3, 3), (5, 5)], np.zeros((3, 2)))
        with pytest.raises(mpsim.TooFastError, match=PRESSED):
            sim.run(frames=5000)
        assert sim.frame == 4096
    roomy = mpsim.Scene(**{**full, "width": 12}, position=places, velocity=np.zeros((36, 2)))
    with simulate(roomy, method="grid", on_fast="error") as sim:
        sim.run(frames=4095)
        sim.add([(8, 1), (8.4, 1), (10, 3)], np.zeros((3, 2)))
        sim.run(frames=5000)


@pytest.mark.parametrize(
    ("packing", "dt", "contact"), [(0.3, 0.1, "impact"), (0.6, 0.05, "impact"), (0.7, 0.04, "push")]
)
def test_gases_with_the_longest_steps_that_pass_are_not_pressed(packing, dt, contact):
    """Their discs do overlap, by a tenth of a radius and more, but no more than steps explain."""
    scene = gas(150, packing)
    deepest = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with mpsim.Simulation(scene, mpsim.Settings(dt=dt, method="grid", contact=contact)) as sim:
            for _ in range(50):
                sim.run(frames=5)
                assert compression.pressed(sim._solver, scene, sim.settings) is None
                deepest = max(deepest, mpsim.measure.overlap(sim.state, scene).largest)
    assert deepest > 0.05, "the control"


def test_grains_that_a_piston_packs_as_densely_as_they_can_be_are_not_pressed():
    scene = mpsim.Scene.random(
        count=50, width=20, height=10, radius=0.5, seed=2, temperature=0.1, restitution=0.9, wall_restitution=0.9,
        piston=mpsim.Piston("right", -0.5, 5.0),
    )  # fmt: skip
    assert complaint(scene, 34) == (None, 34, 0.0), "packing 0.785"
