"""Bad input is one exception that says name, rule, value received and what to do; nothing is changed by it."""

import re
from fractions import Fraction

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim

NAN, INF = float("nan"), float("inf")

GOOD = {"width": 8, "height": 6, "position": [[2, 2], [4, 3]], "velocity": [[1, 0], [0, 1]], "radius": 0.5}

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
        ["position[0] must lie", "(2.0, 5.6)", "2 discs outside", "Move"],
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
    "gravity of one number": ({"gravity": -9.8}, ["gravity must have shape (2,)", "()"]),
    "gravity nan": ({"gravity": (0, NAN)}, ["gravity must be finite", "gravity[1] is nan"]),
    "acceleration shape": ({"acceleration": (0, -1)}, ["acceleration must have shape (2, 2)", "(2,)"]),
    "acceleration inf": ({"acceleration": [[0, 0], [0, INF]]}, ["acceleration must be finite", "[1, 1] is inf"]),
}

SETTINGS = {
    "dt 0": ({"dt": 0}, ["dt must be a finite number > 0", "got 0"]),
    "dt below 0": ({"dt": -0.01}, ["dt must be a finite number > 0", "got -0.01"]),
    "dt nan": ({"dt": NAN}, ["dt must be a finite number > 0", "got nan"]),
    "dt inf": ({"dt": INF}, ["dt must be a finite number > 0", "got inf"]),
    "dt as text": ({"dt": "fast"}, ["dt must be a number > 0", "'fast'"]),
    "dt too large for a number": ({"dt": 10**400}, ["dt must be a number > 0", "finite", "of 401 digits"]),
    "method": ({"method": "gird"}, ["method must be one of", "'naive', 'grid'", "got 'gird'", "Did you mean 'grid'?"]),
    "method None": ({"method": None}, ["method must be one of", "got None"]),
    "method far off": ({"method": "xyz"}, ["method must be one of", "got 'xyz'."]),
    "law": ({"law": "elastisch"}, ["law must be one of 'reflect', 'elastic'", "Did you mean 'elastic'?"]),
    "contact": ({"contact": "pull"}, ["contact must be one of", "'push'", "got 'pull'"]),
    "precision": ({"precision": "float16"}, ["precision must be one of 'float32', 'float64'", "got 'float16'"]),
    "start method": ({"start_method": "frok"}, ["start_method must be one of", "Did you mean 'fork'?"]),
    "workers 0": ({"workers": 0}, ["workers must be a whole number from 1 to", "got 0", "Leave it out"]),
    "workers below 0": ({"workers": -2}, ["workers must be a whole number", "got -2"]),
    "workers absurd": ({"workers": 10**6}, ["workers must be a whole number from 1 to 1024", "got 1000000"]),
    "workers in halves": ({"workers": 1.5}, ["workers must be a whole number", "got 1.5"]),
    "workers as truth": ({"workers": True}, ["workers must be a whole number", "got True"]),
    "substeps 0": ({"substeps": 0}, ["substeps must be a whole number from 1", "got 0", "dt"]),
    "unguarded as text": ({"unguarded": "no"}, ["unguarded must be", "'no'"]),
}

RANDOM = {
    "count below 0": ({"count": -1}, ["count must be a whole number from 0", "got -1"]),
    "count absurd": ({"count": 10**12}, ["count must be a whole number", "got 1000000000000", "fewer discs"]),
    "count in halves": ({"count": 10.5}, ["count must be a whole number", "got 10.5"]),
    "packing 0": ({"packing": 0}, ["packing must be a finite number > 0", "got 0"]),
    "packing above 0.8": ({"packing": 0.81}, ["packing must be at most 0.8", "got 0.81", "fewer"]),
    "packing of next to nothing": (
        {"packing": 5e-324, "radius": 1e10},
        ["packing must leave the box finite", "got 4.94066e-324", "Use a larger one"],
    ),
    "packing 2": ({"packing": 2}, ["packing must be at most 0.8", "got 2"]),
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


def assert_says(caught, parts):
    """Require one exception of mpsim's own kind whose text has all parts and ends like a sentence."""
    text = str(caught.value)
    assert isinstance(caught.value, mpsim.MpsimError)
    assert isinstance(caught.value, ValueError)
    for part in parts:
        assert part in text, f"{part!r} is not in {text!r}"
    assert re.search(r"[.?]$", text), f"not a sentence: {text!r}"
    assert caught.value.__cause__ is None, "one exception, not a chain"


@pytest.mark.parametrize("case", SCENES)
def test_a_bad_scene_is_refused(case):
    change, parts = SCENES[case]
    with pytest.raises(mpsim.InputError) as caught:
        mpsim.Scene(**(GOOD | change))
    assert_says(caught, parts)


@pytest.mark.parametrize("case", SETTINGS)
def test_bad_settings_are_refused(case):
    change, parts = SETTINGS[case]
    with pytest.raises(mpsim.InputError) as caught:
        mpsim.Settings(**change)
    assert_says(caught, parts)


@pytest.mark.parametrize("case", RANDOM)
def test_a_bad_random_scene_is_refused(case):
    change, parts = RANDOM[case]
    with pytest.raises(mpsim.InputError) as caught:
        mpsim.Scene.random(**({"count": 10, "radius": 0.5, "packing": 0.3, "seed": 1} | change))
    assert_says(caught, parts)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ({}, ["run needs either frames or until", "frames=None", "until=None"]),
        ({"frames": 3, "until": 1.0}, ["run needs either frames or until", "frames=3", "until=1.0"]),
        ({"frames": -1}, ["frames must be a whole number from 0", "got -1"]),
        ({"frames": 2.5}, ["frames must be a whole number", "got 2.5"]),
        ({"frames": "all"}, ["frames must be a whole number", "got 'all'"]),
        ({"until": NAN}, ["until must be a finite number >= 0", "got nan"]),
        ({"until": INF}, ["until must be a finite number >= 0", "got inf"]),
        ({"until": -1}, ["until must be a finite number >= 0", "got -1"]),
        ({"until": 0.01}, ["until must not lie in the past", "the time is 0.02", "got 0.01"]),
    ],
)
def test_a_bad_run_is_refused_and_the_simulation_goes_on(arguments, parts):
    with simulate(gas(20, 0.2), method="grid", dt=0.01) as sim:
        sim.run(frames=2)
        before = sim.digest()
        with pytest.raises(mpsim.InputError) as caught:
            sim.run(**arguments)
        assert_says(caught, parts)
        assert (sim.frame, sim.digest()) == (2, before)
        assert sim.run(frames=1).frames == 1


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (([1, NAN], [0, 0]), ["position must be finite", "nan"]),
        (([1, 1], [INF, 0]), ["velocity must be finite", "inf"]),
        (([1, 1, 1], [0, 0, 0]), ["position must have shape", "(2,) or (K, 2)"]),
        (([[1, 1], [2, 2]], [0, 0]), ["velocity must have shape (2, 2)", "as position has"]),
        (([0.2, 1], [0, 0]), ["position[0] must lie in", "(0.2, 1.0)"]),
        (([[1, 1], [1, 99]], [[0, 0], [0, 0]]), ["position[1] must lie in", "99"]),
        (([1, 1], [0, 0], [0, 1]), ["acceleration can be given", "this one has none", "numpy.zeros"]),
    ],
)
def test_a_bad_disc_is_not_added(arguments, parts):
    with simulate(gas(20, 0.2), method="grid") as sim:
        before = sim.digest()
        with pytest.raises(mpsim.InputError) as caught:
            sim.add(*arguments)
        assert_says(caught, parts)
        assert (sim.count, sim.digest()) == (20, before)


def test_a_simulation_needs_a_scene_and_settings():
    with pytest.raises(mpsim.InputError, match=r"scene must be an mpsim.Scene; got dict.*Make one with Scene"):
        mpsim.Simulation(GOOD)
    with pytest.raises(mpsim.InputError, match=r"settings must be mpsim.Settings; got str.*Use Settings"):
        mpsim.Simulation(gas(5, 0.1), "grid")


USES = {
    "run": lambda sim: sim.run(frames=1),
    "state": lambda sim: sim.state,
    "digest": lambda sim: sim.digest(),
    "add": lambda sim: sim.add([1, 1], [0, 0]),
    "count": lambda sim: sim.count,
    "pids": lambda sim: sim.pids,
}


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("method", ["naive", "grid", "parallel"])
def test_a_closed_simulation_says_so(method, use):
    with simulate(gas(20, 0.2), method=method, workers=2) as sim:
        sim.run(frames=3)
    with pytest.raises(mpsim.ClosedError, match=r"closed after frame 3.*no state.*`with` block"):
        USES[use](sim)
    assert "closed after frame 3" in repr(sim)
    assert sim.frame == 3


@pytest.mark.parametrize("empty", [[], np.empty((0, 2)), ()])
def test_a_scene_without_discs_is_allowed(empty):
    scene = mpsim.Scene(width=5, height=5, position=empty, velocity=empty, radius=0.5)
    assert (scene.count, scene.packing, scene.position.shape, scene.velocity.shape) == (0, 0, (0, 2), (0, 2))


@pytest.mark.parametrize("method", ["naive", "grid", "parallel", "auto"])
def test_an_empty_scene_runs_and_can_grow(method):
    scene = mpsim.Scene.random(count=0, packing=0.3, radius=0.5)
    with simulate(scene, method=method, workers=2) as sim:
        report = sim.run(frames=5)
        assert (report.frames, report.collisions, sim.state.position.shape) == (5, 0, (0, 2))
    box = mpsim.Scene(width=5, height=5, position=np.empty((0, 2)), velocity=np.empty((0, 2)), radius=0.5)
    with simulate(box, method=method, workers=2) as sim:
        sim.run(frames=2)
        sim.add([2, 2], [1, 0])
        sim.add(np.empty((0, 2)), np.empty((0, 2)))
        sim.run(frames=100)
        assert sim.state.position[0].tolist() == pytest.approx([3, 2])


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


def test_a_frame_so_short_that_it_is_none_in_the_precision_is_refused():
    """1e-50 is 0 in float32: nothing would ever move."""
    with pytest.raises(mpsim.InputError, match=r"dt.*float32"):
        mpsim.Simulation(gas(5, 0.1), mpsim.Settings(dt=1e-50, precision="float32", method="grid"))


def test_values_that_do_not_fit_the_precision_are_refused():
    """1e300 is a finite float64, and infinite in float32: better said at the start than as a divergence."""
    scene = mpsim.Scene(width=5, height=5, position=[[2, 2]], velocity=[[1e300, 0]], radius=0.5)
    with pytest.raises(mpsim.InputError, match="float32"):
        mpsim.Simulation(scene, mpsim.Settings(precision="float32", method="grid"))
    with simulate(gas(20, 0.2), method="grid", precision="float32") as sim, pytest.raises(mpsim.InputError):
        sim.add([1, 1], [1e300, 0])
