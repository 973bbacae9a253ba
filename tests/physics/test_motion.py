"""One or two discs whose motion is known in closed form. All numbers are exact in binary, so results are exact too."""

import numpy as np
import pytest
from support.scenes import simulate

import mpsim

METHODS = ["naive", "grid", "parallel"]
DT = 1 / 64


def scene_of(position, velocity, width=8.0, height=8.0, **features):
    return mpsim.Scene(width=width, height=height, position=position, velocity=velocity, radius=0.5, **features)


def run(scene, frames, **settings):
    """State after so many frames of 1/64."""
    with simulate(scene, **{"dt": DT, "workers": 2, **settings}) as sim:
        sim.run(frames=frames)
        assert sim.time == frames * sim.settings.dt
        return sim.state


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("method", METHODS)
def test_a_free_disc_moves_in_a_straight_line(method, precision):
    state = run(scene_of([[2, 3]], [[1, 0.5]]), 192, method=method, precision=precision)
    assert state.position.tolist() == [[2 + 3, 3 + 1.5]]
    assert state.velocity.tolist() == [[1, 0.5]]


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_flight_between_two_walls_repeats_exactly(method):
    """From wall to wall it is 7 length units, 448 frames; the frame after is spent turning round at the wall."""
    scene = scene_of([[7.5, 4]], [[-1, 0]])
    for frames, x, v in ((448, 0.5, -1), (449, 0.5, 1), (449 + 448, 7.5, 1), (898, 7.5, -1), (8980, 7.5, -1)):
        state = run(scene, frames, method=method)
        assert (state.position.tolist(), state.velocity.tolist()) == ([[x, 4]], [[v, 0]]), f"after {frames} frames"


@pytest.mark.parametrize("method", METHODS)
def test_a_corner_turns_both_components(method):
    state = run(scene_of([[7, 1]], [[2, -2]]), 17, method=method)
    assert state.position.tolist() == [[7.5, 0.5]]
    assert state.velocity.tolist() == [[-2, 2]]


def test_a_disc_on_a_wall_that_moves_inward_is_not_turned_back():
    state = run(scene_of([[0.5, 4]], [[1, 0]]), 1, method="grid")
    assert (state.position.tolist(), state.velocity.tolist()) == ([[0.5 + DT, 4]], [[1, 0]])


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_free_fall_is_the_sum_of_its_steps(method):
    """v_n = n g dt and y_n = y_0 + g dt^2 n (n + 1) / 2: the semi-implicit Euler step, exact here."""
    frames, g = 64, -2.0
    state = run(scene_of([[4, 7]], [[0.5, 0]], gravity=(0, g)), frames, method=method)
    assert state.velocity.tolist() == [[0.5, frames * g * DT]]
    assert state.position.tolist() == [[4 + 0.5 * frames * DT, 7 + g * DT**2 * frames * (frames + 1) / 2]]


def test_free_fall_is_first_order_in_dt():
    """Against y = y_0 + g t^2 / 2 the error is g t dt / 2: it halves with dt."""
    g, t = -2.0, 1.0
    errors = []
    for steps in (64, 128, 256):
        state = run(scene_of([[4, 7]], [[0, 0]], gravity=(0, g)), steps, method="grid", dt=t / steps)
        errors.append(7 + g * t**2 / 2 - state.position[0, 1])
    assert errors == [-g * t * (t / steps) / 2 for steps in (64, 128, 256)]


@pytest.mark.slow
def test_each_disc_has_its_own_acceleration():
    scene = scene_of([[2, 2], [4, 4], [6, 6]], np.zeros((3, 2)), acceleration=[[1, 0], [0, -1], [0, 0]])
    state = run(scene, 64, method="grid")
    assert state.velocity.tolist() == [[1, 0], [0, -1], [0, 0]]


def test_gravity_and_own_acceleration_add_up():
    scene = scene_of([[4, 4]], [[0, 0]], gravity=(0.5, -1), acceleration=[[0.5, 1]])
    assert run(scene, 64, method="grid").velocity.tolist() == [[1, 0]]


def test_substeps_are_shorter_frames():
    scene = scene_of([[4, 7]], [[0.5, 0]], gravity=(0, -2))
    whole = run(scene, 64, method="grid")
    parts = run(scene, 16, method="grid", dt=DT * 4, substeps=4)
    assert parts.digest() == whole.digest()


@pytest.mark.parametrize("method", METHODS)
def test_discs_that_meet_head_on_exchange_their_velocities(method):
    state = run(scene_of([[2, 4], [6, 4]], [[1, 0], [-0.5, 0]]), 160, method=method, law="elastic")
    assert state.velocity.tolist() == [[-0.5, 0], [1, 0]]


@pytest.mark.parametrize(("law", "velocity"), [("elastic", [[0, 0], [1, 0]]), ("reflect", [[-1, 0], [0, 0]])])
def test_a_disc_that_meets_one_at_rest_hands_on_its_motion_only_if_momentum_is_kept(law, velocity):
    state = run(scene_of([[2, 4], [4, 4]], [[1, 0], [0, 0]]), 80, method="grid", law=law)
    assert state.velocity.tolist() == velocity


@pytest.mark.parametrize("law", ["elastic", "reflect"])
def test_a_frame_ends_with_touching_discs_apart(law):
    """Centres 0.75 apart are pushed to 1.0 apart, each by an eighth, and a middle that does not move."""
    state = run(scene_of([[3, 4], [3.75, 4]], [[0, 0], [0, 0]]), 1, method="grid", law=law)
    assert state.position.tolist() == [[2.875, 4], [3.875, 4]]


def test_the_laws_differ_for_discs_that_part():
    """`elastic` leaves discs alone that already part; `reflect` turns them towards each other again."""
    scene = scene_of([[3, 4], [3.75, 4]], [[-1, 0], [1, 0]])
    assert run(scene, 1, method="grid", law="elastic").velocity.tolist() == [[-1, 0], [1, 0]]
    assert run(scene, 1, method="grid", law="reflect").velocity.tolist() == [[1, 0], [-1, 0]]


def test_until_ends_with_the_first_frame_that_reaches_it():
    with simulate(scene_of([[4, 4]], [[1, 0]]), dt=DT, method="grid") as sim:
        assert sim.run(until=1.0).frames == 64
        assert sim.run(until=1.0).frames == 0
        assert sim.run(until=1.0 + DT / 2).frames == 1
        assert sim.time == 65 * DT
        assert sim.run(until=2.0).frames == 63
    with simulate(scene_of([[4, 4]], [[1, 0]]), dt=0.1, method="grid") as sim:
        assert sim.run(until=0.3).frames == 3, "0.3 is three frames of 0.1, whatever rounding says"
