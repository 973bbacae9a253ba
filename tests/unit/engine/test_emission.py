"""Emitters: what enters, when, and what they say while a disc waits; discs added to scenes with features."""

import warnings

import numpy as np
import pytest
from support.scenes import simulate

import mpsim

EMPTY = {"width": 10, "height": 4, "position": np.zeros((0, 2)), "velocity": np.zeros((0, 2))}
LEFT = (1.0, 2.0)


def entered(frames, *emitters, dt=0.1, **scene):
    """Numbers of discs after each frame."""
    with simulate(mpsim.Scene(**{**EMPTY, "radius": 0.25, **scene}, emitters=emitters), method="naive", dt=dt) as sim:
        counts = []
        for _ in range(frames):
            sim.run(frames=1)
            counts.append(sim.count)
        return counts


def test_a_disc_enters_before_every_so_manieth_frame_until_the_limit():
    assert entered(10, mpsim.Emitter(LEFT, (10, 0), every=3)) == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3]
    assert entered(10, mpsim.Emitter(LEFT, (10, 0), every=3, limit=2)) == [0, 0, 0, 1, 1, 1, 2, 2, 2, 2]
    assert entered(5, mpsim.Emitter(LEFT, (10, 0), every=1)) == [0, 1, 2, 3, 4]


def test_several_emitters_take_turns_in_the_order_of_the_scene():
    counts = entered(5, mpsim.Emitter(LEFT, (10, 0), every=2), mpsim.Emitter((1, 1), (10, 0), every=3))
    assert counts == [0, 0, 1, 2, 3]


def test_one_run_and_runs_of_single_frames_have_the_same_discs():
    emitters = [mpsim.Emitter(LEFT, (10, 0), every=3), mpsim.Emitter((1, 1), (8, 1), every=2, limit=3)]
    scene = mpsim.Scene(**EMPTY, radius=0.25, emitters=emitters)
    with simulate(scene, method="naive", dt=0.1) as one, simulate(scene, method="naive", dt=0.1) as many:
        one.run(frames=15)
        for _ in range(15):
            many.run(frames=1)
        assert one.count == many.count == 7
        assert one.digest() == many.digest()


def test_a_disc_waits_until_its_place_is_free_and_says_so_once():
    """Each disc covers the place for 0.5 / 1 = 5 frames of 0.1, and the next one enters as soon as it has gone."""
    with pytest.warns(mpsim.errors.EmitterWarning) as caught:
        counts = entered(14, mpsim.Emitter(LEFT, (1, 0), every=1))
    assert counts == [0, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3]
    assert [str(warning.message) for warning in caught] == [
        "emitters[0] found its place (1.0, 2.0) occupied before frame 2: its disc waits until the place is free. "
        "Give a larger `every`, or a velocity that leads away."
    ]


@pytest.mark.slow
def test_a_disc_beyond_a_periodic_border_occupies_a_place_too():
    blocked = {"position": [[9.9, 2]], "velocity": [[0, 0]], "boundary": ("periodic", "walls")}
    with pytest.warns(mpsim.errors.EmitterWarning):
        assert entered(4, mpsim.Emitter((0.2, 2), (1, 0), every=1), **blocked) == [1] * 4


def test_discs_that_have_left_occupy_no_place():
    scene = mpsim.Scene(
        **{**EMPTY, "position": [[9.5, 2]], "velocity": [[5, 0]]},
        radius=0.25,
        absorbing="right",
        emitters=mpsim.Emitter((9.5, 2), (-5, 0), every=2, limit=1),
    )
    with warnings.catch_warnings(), simulate(scene, method="naive", dt=0.1) as sim:
        warnings.simplefilter("error")
        sim.run(frames=4)
        assert sim.absorbed.tolist() == [True, False]
        assert sim.state.position[1, 0] == pytest.approx(8.5)


@pytest.mark.slow
def test_what_enters_has_the_radius_and_mass_of_its_emitter():
    emitter = mpsim.Emitter(LEFT, (0, 0), every=1, radius=0.5, mass=3, limit=1)
    scene = mpsim.Scene(**{**EMPTY, "position": [[4, 2]], "velocity": [[-10, 0]]}, radius=0.25, emitters=emitter)
    with simulate(scene, method="naive", dt=0.05, contact="impact") as sim:
        sim.run(frames=2)
        assert sim.radii.tolist() == [0.25, 0.5]
        sim.run(frames=3)
        speeds = sim.state.velocity[:, 0]
    assert speeds == pytest.approx([5, -5]), "a disc of mass 1 meets one of mass 3 at rest: half its speed back"


@pytest.mark.parametrize(
    ("features", "text"),
    [
        (
            {"radius": [0.5, 0.25]},
            r"emitters\[0\] must have a radius, as the discs of this scene have one each; got None",
        ),
        ({"radius": 0.5, "mass": [1, 2]}, r"emitters\[0\] must have a mass, as the discs of this scene have one each"),
        ({"radius": 3.5}, r"the position of emitters\[0\] must lie in \[3.5, 6.5\] x \[3.5, 6.5\]"),
    ],
)
def test_an_emitter_that_does_not_fit_the_scene_is_refused_by_name(features, text):
    places = {
        "position": [[4, 4], [6, 6]],
        "velocity": np.zeros((2, 2)),
        "emitters": mpsim.Emitter((1, 1), (0, 0), every=1),
    }
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.Scene(width=10, height=10, **{**features, **places})


def test_a_piston_must_leave_room_for_the_largest_disc():
    with pytest.raises(
        mpsim.InputError, match="stop of the piston must leave room for the largest disc, of diameter 1"
    ):
        mpsim.Scene(**EMPTY, radius=0.5, piston=mpsim.Piston("right", -1, 0.9))
    with pytest.raises(mpsim.InputError, match=r"got 9\.5, which leaves 0\.5"):
        mpsim.Scene(**EMPTY, radius=0.5, piston=mpsim.Piston("left", 1, 9.5))
    mpsim.Scene(**EMPTY, radius=0.5, piston=mpsim.Piston("left", 1, 9))
