"""Counts of periods: unwrapped places go on through borders, with the same bits whatever the workers and pieces."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.compare import assert_same_bits
from support.scenes import after, simulate, state_after

import mpsim

pytestmark = pytest.mark.plain

METHODS = ("naive", "grid", "event")


def box_of(position, velocity, boundary="periodic", **more):
    """Discs of radius 1/2 in a box of 10 x 8."""
    return mpsim.Scene(width=10, height=8, position=position, velocity=velocity, radius=0.5, boundary=boundary, **more)


@pytest.mark.parametrize(("method", "precision"), [*((each, "float64") for each in METHODS), ("grid", "float32")])
def test_a_free_disc_goes_on_beyond_the_border(method, precision):
    """By hand: from (2, 7) at (-3, 5) for a time 10 to (-28, 57): 3 periods of 10 back, 7 of 8 on."""
    scene = box_of([[2, 7], [2, 3]], [[-3, 5], [-3, 5]])
    state = state_after(scene, 80, method=method, precision=precision, dt=1 / 8)
    assert state.image is not None
    assert state.image.tolist() == [[-3, 7], [-3, 6]]
    assert state.image.dtype == np.int64
    assert state.position == pytest.approx(np.array([[2, 1], [2, 5]]), abs=1e-14)
    assert state.unwrapped == pytest.approx(np.array([[-28, 57], [-28, 53]]), abs=1e-13)
    assert state.box == (0, 10, 0, 8)


@pytest.mark.parametrize("method", METHODS)
def test_only_periodic_axes_count(method):
    state = state_after(box_of([[2, 7]], [[-3, 5]], ("periodic", "walls")), 80, method=method, dt=1 / 8)
    assert state.image.tolist() == [[-3, 0]]
    assert state.unwrapped[0, 1] == state.position[0, 1]
    with simulate(box_of([[2, 7]], [[-3, 5]], "walls"), method=method) as sim:
        assert sim.state.image is None
        assert not {"image", "winding"} & set(sim.array_names), "a scene with walls pays for no count"
        assert sim.state.unwrapped.tolist() == sim.state.position.tolist()


speed = st.floats(-300, 300).map(lambda value: round(value, 6))  # none whose square would vanish
free = st.tuples(st.floats(0, 9.999), st.floats(0, 7.999), speed, speed)


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
@settings(max_examples=5)
@given(discs=st.lists(free, min_size=1, max_size=1), contact=st.sampled_from(["push", "impact"]))
@pytest.mark.parametrize(("method", "falls"), [("grid", False), ("naive", True), ("event", True)])
def test_unwrapped_places_are_the_integral_of_the_motion(discs, contact, method, falls):
    """A disc alone: r(t) = r + v t + g t^2 / 2, through however many borders in a step."""
    start = np.array(discs)
    gravity = np.array([1.5, -40.0]) * falls
    scene = box_of(start[:, :2], start[:, 2:], gravity=gravity if falls else None)
    contact = "impact" if falls or method == "event" else contact
    with simulate(scene, method=method, dt=0.1, contact=contact) as sim:
        before = sim.state.unwrapped
        for frames in (1, 6, 3):
            sim.run(frames=frames)
        moved = sim.state.unwrapped - before
    expected = scene.velocity * 1.0 + gravity / 2
    assert np.abs(moved - expected).max() < 1e-11 * (1 + np.abs(expected).max())


def test_a_disc_that_rounding_puts_at_the_border_is_not_off_by_a_period():
    """Just below 0 a coordinate rounds to the length itself, and becomes 0: of the same period as before."""
    scene = box_of([[0, 4]], [[-1e-18, 0]])
    for method in METHODS:
        with simulate(scene, method=method, workers=1, dt=1.0) as sim:
            for _ in range(3):
                sim.run(frames=1)
                assert abs(sim.state.unwrapped[0, 0]) < 1e-15, f"{method}: {sim.state}"


@pytest.mark.parametrize("method", ["grid", "event"])
def test_an_added_disc_starts_to_count_and_changes_no_other_count(method):
    with simulate(box_of([[2, 7], [2, 3]], [[-3, 5], [-3, 5]]), method=method, dt=1 / 8) as sim:
        sim.run(frames=80)
        before = sim.state
        sim.add((7, 5), (0, 3))
        assert sim.state.image.tolist() == [*before.image.tolist(), [0, 0]]
        assert sim.state.unwrapped[:2].tolist() == before.unwrapped.tolist()
        for _ in range(6):  # which makes the block grow
            sim.add((9, 1), (0, 0)) if method == "grid" else None
        assert sim.state.unwrapped[:2].tolist() == before.unwrapped.tolist()


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
@pytest.mark.parametrize(("method", "dt"), [*((each, 0.3) for each in METHODS), ("grid", 0.01), ("event", 1.2)])
def test_a_disc_that_enters_inside_a_frame_counts_the_borders_of_that_flight(method, dt):
    """Two that leave (9.8, 0.2) at 0.5 and 1: by hand, 0.7 and 0.2 later, in unwrapped places."""
    jet = mpsim.Emitter((9.8, 0.2), (4, -3), interval=0.5, limit=2)
    scene = box_of(np.zeros((0, 2)), np.zeros((0, 2)), emitters=jet)
    state = after(scene, 1.2, method=method, contact="push", dt=dt)
    assert state.unwrapped == pytest.approx(np.array([[12.6, -1.9], [10.6, -0.4]]), abs=1e-12)
    assert state.image.tolist() == [[1, -1], [1, -1]]


def test_a_disc_that_has_left_counts_no_more_borders():
    """Gravity along a periodic axis goes on pulling at it, and it is put back after each step."""
    scene = box_of([[1, 0.5]], [[-4, -1]], ("walls", "periodic"), absorbing="left", gravity=(0, -9))
    for contact in ("push", "impact"):
        with simulate(scene, method="grid", contact=contact, dt=0.05) as sim:
            sim.run(frames=20)
            left = sim.state
            sim.run(frames=60)
            assert not left.present[0]
            assert_same_bits(sim.state, left, contact)
