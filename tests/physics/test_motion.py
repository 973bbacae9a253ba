"""One disc whose motion is known in closed form. All numbers are exact in binary, so results are exact too."""

import numpy as np
import pytest
from support.scenes import simulate

import mpsim

pytestmark = pytest.mark.plain

DT = 1 / 64


def scene_of(position, velocity, width=8.0, height=8.0, **features):
    return mpsim.Scene(width=width, height=height, position=position, velocity=velocity, radius=0.5, **features)


def run(scene, frames, **settings):
    """State after so many frames of 1/64."""
    with simulate(scene, **{"dt": DT, "method": "grid", **settings}) as sim:
        sim.run(frames=frames)
        assert sim.time == frames * sim.settings.dt
        return sim.state


@pytest.mark.parametrize(
    ("method", "precision"), [("naive", "float32"), ("grid", "float64"), ("grid", "float32"), ("event", "float64")]
)
def test_a_free_disc_moves_in_a_straight_line(method, precision):
    state = run(scene_of([[2, 3]], [[1, 0.5]]), 192, method=method, precision=precision)
    assert state.position.tolist() == [[2 + 3, 3 + 1.5]]
    assert state.velocity.tolist() == [[1, 0.5]]


def test_a_pushed_disc_repeats_its_flight_between_two_walls_exactly():
    """From wall to wall it is 7 length units, 56 frames; the frame after is spent turning round at the wall."""
    scene = scene_of([[7.5, 4]], [[-1, 0]])
    for frames, x, v in ((56, 0.5, -1), (57, 0.5, 1), (57 + 56, 7.5, 1), (114, 7.5, -1)):
        state = run(scene, frames, dt=1 / 8)
        assert (state.position.tolist(), state.velocity.tolist()) == ([[x, 4]], [[v, 0]]), f"after {frames} frames"


@pytest.mark.parametrize("settings", [{"method": "event"}, {"contact": "impact"}], ids=str)
def test_a_disc_is_mirrored_at_a_wall_at_any_part_of_a_frame(settings):
    """After 1/8 + 1/32 past each wall it is as far on its way back; `push` would have stopped at the wall."""
    state = run(scene_of([[7, 4]], [[1, 0]]), 21, **{"dt": 1 / 32, **settings})
    assert (state.position.tolist(), state.velocity.tolist()) == ([[7.5 - 5 / 32, 4]], [[-1, 0]])
    state = run(scene_of([[7, 4]], [[1, 0]]), 3, **{"dt": 1 / 4, **settings})
    assert (state.position.tolist(), state.velocity.tolist()) == ([[7.25, 4]], [[-1, 0]])


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_a_corner_turns_both_components(method):
    state = run(scene_of([[7, 1]], [[2, -2]]), 17, method=method)
    back = 1 / 32 if method == "event" else 0
    assert state.position.tolist() == [[7.5 - back, 0.5 + back]]
    assert state.velocity.tolist() == [[-2, 2]]


def test_free_fall_with_push_is_first_order_in_dt_and_exact_without():
    """Against y = y_0 + g t^2 / 2 the error is g t dt / 2, of y_n = y_0 + g dt^2 n (n + 1) / 2. Substeps are frames."""
    g, t, scene = -2.0, 1.0, scene_of([[4, 7]], [[0, 0]], gravity=(0, -2.0))
    for settings, part in (({"contact": "push"}, 0.5), ({"contact": "impact"}, 0.0), ({"method": "event"}, 0.0)):
        errors = [7 + g * t**2 / 2 - run(scene, n, dt=t / n, **settings).position[0, 1] for n in (16, 32)]
        assert errors == [-g * t * (t / n) * part for n in (16, 32)], settings
    assert run(scene, 16, dt=DT * 4, substeps=4).digest() == run(scene, 64).digest()


def test_accelerations_of_each_disc_and_gravity_add_up():
    places, own = [[2, 2], [4, 4], [6, 6]], [[1, 0], [0, -1], [0, 0]]
    alone = run(scene_of(places, np.zeros((3, 2)), acceleration=own), 64)
    assert alone.velocity.tolist() == own
    both = run(scene_of(places, np.zeros((3, 2)), acceleration=own, gravity=(0, 1)), 64)
    assert both.velocity.tolist() == [[1, 1], [0, 0], [0, 1]]


def test_until_ends_with_the_first_frame_that_reaches_it():
    with simulate(scene_of([[4, 4]], [[1, 0]]), dt=DT, method="grid") as sim:
        assert sim.run(until=1.0).frames == 64
        assert sim.run(until=1.0).frames == 0
        assert sim.run(until=1.0 + DT / 2).frames == 1
        assert sim.time == 65 * DT
        assert sim.run(until=2.0).frames == 63
    with simulate(scene_of([[4, 4]], [[1, 0]]), dt=0.1, method="grid") as sim:
        assert sim.run(until=0.3).frames == 3, "0.3 is three frames of 0.1, whatever rounding says"
