"""The piston, by numbers that can be checked by hand."""

import numpy as np
import pytest
from support.arrays import control_of, parameters_of
from support.internals import machine_code, parameters

from mpsim.kernels import layout
from mpsim.kernels.features.hooks import BARE
from mpsim.kernels.features.piston import prepare_next_step, wall_place, wall_speed
from mpsim.kernels.frame import flight
from mpsim.kernels.records import moving_wall_in

fly_along = machine_code(flight.fly_along)


def piston(start=10.0, speed=-1.0, stop=2.0, dt=0.25, precision="float64", **more):
    record = np.zeros((), moving_wall_in(precision))[()]
    values = {"edge": layout.RIGHT, "start": start, "speed": speed, "stop": stop, "arrival": (stop - start) / speed}
    for name, value in {**values, "dt": dt, **more}.items():
        record[name] = value
    return record


@pytest.mark.parametrize(
    ("v", "restitution", "expected"), [(1.0, 1.0, -3.0), (1.0, 0.5, -2.0), (0.0, 1.0, -2.0), (-2.0, 1.0, -2.0)]
)
def test_a_piston_gives_a_disc_twice_its_speed(v, restitution, expected):
    """The right wall, at 9.5 for centres at the end of the step, moves at -1; a disc ends at 9.75 and bounces off."""
    values = parameters(restitution, dt=0.5)
    values.wall_bounce = restitution
    features = BARE._replace(moving_wall=piston(velocity=-1.0))
    found = fly_along(9.75 - v / 2, v, 0.0, None, layout.ALONG_X, 0.0, None, features, values)
    assert found.velocity == expected
    assert found.position == 9.5 - 0.25 * restitution
    assert (found.low_change, found.high_change) == (0, v - expected)
    assert found.time == (0.25 / (v + 1) if v > -1 else 0)


@pytest.mark.parametrize("substeps", [1, 3])
def test_a_piston_stands_where_its_time_says_until_it_stops(substeps):
    """It is at 8.9 after 0.6, so it moves for less than half of the third frame."""
    values, control = parameters(dt=0.25 / substeps), control_of(0)
    wall, found = piston(9.5, stop=8.9), []
    control.substeps = substeps
    for frame in range(4):
        control.steps = frame * substeps
        prepare_next_step(wall, values, control)
        control.steps += substeps - 1
        here = wall_place(wall, layout.RIGHT, values)
        prepare_next_step(wall, values, control)
        found.append((here, values.limit[layout.RIGHT], wall_speed(wall, layout.RIGHT, values)))
    assert found == [(9.5, 9.25, -1), (9.25, 9.0, -1), (9.0, 8.9, 0), (8.9, 8.9, 0)]


def test_its_place_is_that_of_float64_rounded_once():
    values, control = parameters_of(np.float32, 10, 10, dt=0.1), control_of(0)
    wall = piston(9.5, -0.7, 1.0, 0.1, "float32", margin=-0.5, origin=3.0, began=2.5)
    control.substeps, control.steps = 1, 4
    prepare_next_step(wall, values, control)
    assert values.limit[layout.RIGHT] == np.float32(9.5 - 0.7 * (3 + 5 * 0.1 - 2.5) - 0.5)
