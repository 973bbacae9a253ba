"""A bad scene is one exception that says name, rule, value received and what to do."""

from fractions import Fraction

import numpy as np
import pytest
from support.refusals import GOOD, assert_says
from support.scenes import simulate

import mpsim

NAN, INF = float("nan"), float("inf")

SCENES = {
    # changed argument: (value, parts of the text: name, rule, value, remedy)
    "nan in position": (
        {"position": [[2, 2], [4, NAN]]},
        ["position must be finite", "position[1, 1] is nan", "leave"],
    ),
    "inf in position": ({"position": [[INF, 2], [4, 3]]}, ["position must be finite", "position[0, 0] is inf"]),
    "nan in velocity": ({"velocity": [[1, NAN], [0, 1]]}, ["velocity must be finite", "velocity[0, 1] is nan"]),
    "minus inf": ({"velocity": [[1, 0], [-INF, 1]]}, ["velocity must be finite", "velocity[1, 0] is -inf"]),
    "flat position": ({"position": [2, 2, 4, 3]}, ["position must have shape (N, 2)", "(4,)", "Reshape"]),
    "three columns": ({"position": [[1, 2, 3]]}, ["position must have shape (N, 2)", "(1, 3)"]),
    "too few velocities": ({"velocity": [[1, 0]]}, ["velocity must have shape (2, 2)", "(1, 2)", "one row per row"]),
    "text": ({"position": "somewhere"}, ["position must be numbers", "'somewhere'"]),
    "ragged": ({"position": [[1, 2], [3]]}, ["position must be numbers", "[[1, 2], [3]]"]),
    "outside to the left": (
        {"position": [[2, 2], [0.4, 3]]},
        ["position[1] must lie in [0.5, 7.5] x [0.5, 5.5]", "0.4"],
    ),
    "outside above": (
        {"position": [[2, 5.6], [9, 3]]},
        ["position[0] must lie", "(2.0, 5.6)", "discs outside: 2", "Move"],
    ),
    "radius 0": ({"radius": 0}, ["radius must be a finite number > 0", "got 0"]),
    "radius below 0": ({"radius": -1.5}, ["radius must be a finite number > 0", "got -1.5"]),
    "radius nan": ({"radius": NAN}, ["radius must be a finite number > 0", "got nan"]),
    "radius too large": ({"radius": 3.5}, ["radius must be at most half the box, 3", "got 3.5", "smaller discs"]),
    "radius as text": ({"radius": "0.5"}, ["radius must be a number > 0", "got '0.5'"]),
    "radius as truth": ({"radius": True}, ["radius must be a number > 0", "got True"]),
    "width 0": ({"width": 0}, ["width must be a finite number > 0", "got 0"]),
    "height inf": ({"height": INF}, ["height must be a finite number > 0", "got inf"]),
    "height missing": ({"height": None}, ["height must be a number > 0", "got None"]),
    "gravity of one number": (
        {"gravity": -9.8},
        ["gravity must be two numbers", "got -9.8. Downwards it is (0,"],
    ),
    "gravity nan": ({"gravity": (0, NAN)}, ["gravity must be finite", "gravity[1] is nan"]),
    "acceleration shape": ({"acceleration": (0, -1)}, ["acceleration must have shape (2, 2)", "(2,)"]),
    "acceleration inf": ({"acceleration": [[0, 0], [0, INF]]}, ["acceleration must be finite", "[1, 1] is inf"]),
}

RANDOM = {
    "count below 0": ({"count": -1}, ["count must be a whole number from 0", "got -1"]),
    "count absurd": (
        {"count": 10**12},
        ["count must be a whole number from 0 to 100000000", "got 1000000000000"],
    ),
    "count in halves": ({"count": 10.5}, ["count must be a whole number", "got 10.5"]),
    "packing 0": ({"packing": 0}, ["packing must be a finite number > 0", "got 0"]),
    "packing above 0.8": ({"packing": 0.81}, ["packing must be at most 0.8", "got 0.81", "fewer"]),
    "packing of next to nothing": (
        {"packing": 5e-324, "radius": 1e10},
        ["packing must leave the box finite", "got 4.94066e-324", "Use a larger one"],
    ),
    "packing 40": ({"packing": 40}, ["packing must be a fraction of the area; got 40. 40 % is 0.4."]),
    "packing 400": ({"packing": 400}, ["packing must be at most 0.8", "got 400"]),
    "neither": ({"packing": None}, ["the box must be given either by packing or by width and height", "packing=None"]),
    "both": ({"width": 9, "height": 9}, ["the box must be given either by", "width=9"]),
    "half a box": ({"packing": None, "width": 9}, ["the box must be given either by", "height=None"]),
    "temperature below 0": ({"temperature": -1}, ["temperature must be a finite number >= 0", "got -1"]),
    "seed below 0": ({"seed": -1}, ["seed must be a whole number from 0", "got -1"]),
    "seed None": ({"seed": None}, ["seed must be a whole number", "got None"]),
    "too many for the box": (
        {"packing": None, "width": 2.1, "height": 2.1, "count": 4, "radius": 0.53},
        ["packing must be at most 0.8", "fewer or smaller discs"],
    ),
    "walls in the way": (
        {"packing": None, "width": 2.5, "height": 1.9, "count": 4, "radius": 0.5},
        ["4 discs of radius 0.5 do not fit", "fewer or smaller discs"],
    ),
}


@pytest.mark.parametrize("case", SCENES)
def test_a_bad_scene_is_refused(case):
    change, parts = SCENES[case]
    with pytest.raises(mpsim.InputError) as caught:
        mpsim.Scene(**(GOOD | change))
    assert_says(caught, parts)


@pytest.mark.parametrize("case", RANDOM)
def test_a_bad_random_scene_is_refused(case):
    change, parts = RANDOM[case]
    with pytest.raises(mpsim.InputError) as caught:
        mpsim.Scene.random(**({"count": 10, "radius": 0.5, "packing": 0.3, "seed": 1} | change))
    assert_says(caught, parts)


@pytest.mark.parametrize("empty", [[], np.empty((0, 2)), ()])
def test_a_scene_without_discs_is_allowed(empty):
    scene = mpsim.Scene(width=5, height=5, position=empty, velocity=empty, radius=0.5)
    assert (scene.count, scene.packing, scene.position.shape, scene.velocity.shape) == (0, 0, (0, 2), (0, 2))


@pytest.mark.parametrize("number", [Fraction(1, 100), np.float32(0.01), np.float64(0.01), 1])
def test_any_kind_of_real_number_is_a_number(number):
    assert mpsim.Settings(dt=number).dt == pytest.approx(float(number))


@pytest.mark.parametrize(
    ("radius", "precision"), [(1e-30, "float32"), (1e-24, "float32"), (1e-200, "float64"), (1e30, "float32")]
)
def test_a_scene_so_small_or_large_that_squares_of_lengths_do_not_fit_is_refused(radius, precision):
    """The square of a diameter would be 0 or infinite: every pair would pass through each other, or none."""
    scene = mpsim.Scene(
        width=9 * radius, height=9 * radius, position=[[3 * radius] * 2], velocity=[[0, 0]], radius=radius
    )
    with pytest.raises(mpsim.InputError, match=precision):
        mpsim.Simulation(scene, mpsim.Settings(precision=precision, method="grid"))


@pytest.mark.parametrize(("radius", "precision"), [(1e-10, "float32"), (1e9, "float32"), (1e-100, "float64")])
def test_scenes_in_any_sensible_unit_behave_alike(radius, precision):
    """Negative control: lengths in metres of atoms or of planets are no reason to refuse, and give the same motion."""
    ends = []
    for unit in (1.0, radius):
        position, velocity = np.array([[3, 3], [4.5, 3.25]]) * unit, np.array([[1, 0], [0, 0]]) * unit
        scene = mpsim.Scene(width=9 * unit, height=9 * unit, position=position, velocity=velocity, radius=unit / 2)
        with simulate(scene, method="grid", precision=precision, dt=1 / 64) as sim:
            assert sim.run(frames=200).collisions == 1
            ends.append(sim.state.position / unit)
    assert np.allclose(*ends, rtol=1e-4)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            {"gravity": 9.81},
            r"gravity must be two numbers, along x and y; got 9.81. Downwards it is \(0, -9.81\), in a",
        ),
        ({"count": 5.0}, r"count must be a whole number from 0 to 100000000; got 5.0. Give 5\."),
        ({"velocity": [[1, 0]]}, "an argument of Scene.random must be one of .*; got 'velocity'"),
        ({"count": 5.5}, r"count must be a whole number from 0 to 100000000; got 5.5. Give 5 or 6\."),
    ],
)
def test_a_mistake_of_people_is_answered_to_the_point(given, text):
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.Scene.random(**{"count": 5, "packing": 0.1, "radius": 0.5, **given})
