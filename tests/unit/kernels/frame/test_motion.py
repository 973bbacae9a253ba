"""Kernels of motion against slow obvious twins: acceleration, drift, the wall rule, and the search for NaN."""

import numpy as np
import pytest
from support.arrays import control_of, discs_of, parameters_of, team_of
from support.internals import machine_code

from mpsim.kernels import layout
from mpsim.kernels.features import acceleration
from mpsim.kernels.features.hooks import BARE
from mpsim.kernels.frame import motion
from mpsim.kernels.frame.motion import move, worst_slot

accelerate, drift_between_walls = map(machine_code, (acceleration.accelerate, motion.drift_between_walls))

REALS = [np.float32, np.float64]
WIDTH, HEIGHT = 10.0, 6.0


def drift_twin(p, v, dt, low, high):
    """One component of one disc after one step."""
    p = p + v * dt
    if (p < low and v < 0) or (p > high and v > 0):
        v = -v
    return min(max(p, low), high), v


@pytest.mark.parametrize("real", REALS)
def test_drift_is_its_twin(real):
    rng = np.random.default_rng(1)
    count = 500
    x, y = rng.uniform(0.4, 9.6, count), rng.uniform(0.4, 5.6, count)
    vx, vy = rng.normal(size=(2, count)) * 50
    vx[:5], vy[:5] = [0, -0.0, 1e-30, 1e6, -1e6], 0
    discs = discs_of(real, x, y, vx, vy)
    parameters = parameters_of(real, WIDTH, HEIGHT)
    low, high, before = 17, 480, [field.copy() for field in discs[:4]]
    assert not drift_between_walls(discs, low, high, parameters)
    dt = parameters.dt
    for i in range(count):
        inside = low <= i < high
        for place, speed, (low_edge, high_edge) in ((0, 2, layout.ALONG_X), (1, 3, layout.ALONG_Y)):
            p, v = before[place][i], before[speed][i]
            if inside:
                p, v = drift_twin(p, v, dt, parameters.limit[low_edge], parameters.limit[high_edge])
            assert (discs[place][i], discs[speed][i]) == (p, v), f"disc {i}, {discs._fields[place]}"


@pytest.mark.parametrize(
    ("x", "vx", "expected"),
    [
        (0.5, -1.0, (0.5, 1.0)),
        (0.5, 1.0, (0.5 + 1 / 64, 1.0)),
        (0.25, 1.0, (0.5, 1.0)),
        (0.25, -1.0, (0.5, 1.0)),
        (9.5, 1.0, (9.5, -1.0)),
        (9.75, -1.0, (9.5, -1.0)),
        (9.0, 64.0, (9.5, -64.0)),
        (5.0, 0.0, (5.0, 0.0)),
    ],
)
def test_a_disc_beyond_a_wall_is_clamped_and_turned_round_only_if_it_moves_outward(x, vx, expected):
    discs = discs_of(np.float64, [x], [3.0], [vx], [0.0])
    drift_between_walls(discs, 0, 1, parameters_of(np.float64, WIDTH, HEIGHT, dt=1 / 64))
    assert (discs.x[0], discs.vx[0]) == expected


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["x", "y", "vx", "vy"])
def test_drift_notices_what_is_not_finite_anywhere_in_the_slice(field, bad, real):
    parameters = parameters_of(real, WIDTH, HEIGHT)
    for at in (0, 7, 8, 15, 19):
        discs = discs_of(real, np.full(20, 3.0), np.full(20, 3.0), np.ones(20), np.ones(20))
        getattr(discs, field)[at] = bad
        assert drift_between_walls(discs, 0, 20, parameters), f"{field}[{at}] = {bad} went unnoticed"
    assert not drift_between_walls(discs, 0, 19, parameters), "a disc outside the slice is not this worker's"


@pytest.mark.slow
@pytest.mark.parametrize("real", REALS)
def test_acceleration_is_added_for_what_the_scene_has(real):
    own = np.array([[1, 2, 3], [-1, -2, -3]], real)
    gravity = np.array([0.5, -8], real)
    ids = [2, 0, 1]
    for g, a in ((None, None), (gravity, None), (None, own), (gravity, own)):
        discs = discs_of(real, np.ones(3), np.ones(3), np.zeros(3), np.zeros(3), ids)
        accelerate(discs, 0, 2, g, a, parameters_of(real, WIDTH, HEIGHT, dt=0.5))
        for slot, number in enumerate(ids):
            vx = ((0 if g is None else g[0]) + (0 if a is None else a[0, number])) * 0.5
            vy = ((0 if g is None else g[1]) + (0 if a is None else a[1, number])) * 0.5
            expected = (vx, vy) if slot < 2 else (0, 0)
            assert (discs.vx[slot], discs.vy[slot]) == expected, f"gravity {g}, acceleration {a}, slot {slot}"


@pytest.mark.parametrize("real", REALS)
def test_the_bad_disc_of_lowest_id_is_found(real):
    discs = discs_of(real, np.full(9, 3.0), np.full(9, 3.0), ids=[8, 3, 5, 1, 7, 0, 2, 4, 6])
    assert worst_slot(discs, 0, 9) == -1
    for slot, expected in ((0, 0), (2, 2), (3, 3), (4, 3), (6, 3)):
        discs.vx[slot] = np.nan
        assert worst_slot(discs, 0, 9) == expected
    assert worst_slot(discs, 4, 9) == 6


def test_a_bad_disc_raises_the_abort_word_and_an_empty_slice_does_not():
    discs = discs_of(np.float64, [3.0, 3.0], [3.0, 3.0])
    parameters, control, mine = parameters_of(np.float64, WIDTH, HEIGHT), control_of(2), team_of(1)[0]
    assert move(discs, 0, 2, BARE, parameters, control, mine, None)
    assert move(discs, 1, 1, BARE, parameters, control, mine, None)
    assert control.signals[layout.BAD] == 0
    discs.y[1] = np.nan
    assert not move(discs, 0, 2, BARE, parameters, control, mine, None)
    assert (control.signals[layout.BAD], mine.bad_slot) == (1, 1)
