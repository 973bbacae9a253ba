"""The piston, by numbers that can be checked by hand."""

import numpy as np
import pytest
from support.arrays import control_of
from support.internals import machine_code, parameters

from mpsim.kernels import layout
from mpsim.kernels.features.hooks import BARE
from mpsim.kernels.features.piston import NOW, prepare_next_step
from mpsim.kernels.frame import flight

fly_along = machine_code(flight.fly_along)


@pytest.mark.parametrize(
    ("v", "restitution", "expected"), [(1.0, 1.0, -3.0), (1.0, 0.5, -2.0), (0.0, 1.0, -2.0), (-2.0, 1.0, -2.0)]
)
def test_a_piston_gives_a_disc_twice_its_speed(v, restitution, expected):
    """The right wall, at 9.5 for centres at the end of the step, moves at -1; a disc ends at 9.75 and bounces off."""
    values = parameters(restitution, dt=0.5)
    piston = np.array([layout.RIGHT, 10.0, -1.0, 2.0, -1.0])
    values.wall_bounce = restitution
    features = BARE._replace(moving_wall=piston)
    found = fly_along(9.75 - v / 2, v, 0.0, None, layout.ALONG_X, 0.0, None, features, values)
    assert found.velocity == expected
    assert found.position == 9.5 - 0.25 * restitution
    assert (found.low_change, found.high_change) == (0, v - expected)
    assert found.time == (0.25 / (v + 1) if v > -1 else 0)


def test_a_piston_stands_where_its_time_says_until_it_stops():
    values, control = parameters(dt=0.25), control_of(0)
    piston = np.array([layout.RIGHT, 9.5, -1.0, 8.9, 0.0])
    found = []
    for step in range(4):
        control.steps = step
        prepare_next_step(piston, values, control)
        found.append((values.limit[layout.RIGHT], piston[NOW]))
    assert found == [(9.25, -1), (9.0, -1), (8.9, 0), (8.9, 0)]
