"""Bounces from walls, by numbers that can be checked by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.internals import machine_code, parameters, wall_impulses
from support.scenes import simulate

import mpsim
from mpsim.kernels import bouncing

bounce_back = machine_code(bouncing.bounce_back)


@pytest.mark.parametrize(("restitution", "expected"), [(1.0, (3.5 / 9, 3.0)), (0.5, (1.5 / 9, 1.0)), (0.0, (0, 0))])
def test_a_bounce_goes_back_to_the_wall_and_on(restitution, expected):
    """Speed 5 at depth 1/2 under a pull of 9: 4 at the wall (25 = 16 + 9), 1/9 ago, and slowed by 1 since."""
    *found, time = bounce_back(0.5, 5.0, 9.0, parameters(restitution))
    assert found == pytest.approx(list(expected), rel=1e-15)
    assert time == pytest.approx(1 / 9 if restitution else 0.1), "of one that rests the mean, depth over speed"


def test_a_bounce_without_a_pull_is_as_far_inside_as_it_would_be_outside():
    assert bounce_back(0.25, 2.0, 0.0, parameters()) == (0.25, 2.0, 0.125)
    assert bounce_back(0.25, 2.0, 0.0, parameters(0.5)) == (0.125, 1.0, 0.125)


def test_a_disc_at_rest_on_a_wall_stays_there():
    """Pulled by 2 for a time 1/4 from rest at the wall: speed 1/2 at depth 1/16, nothing at the wall."""
    assert bounce_back(1 / 16, 0.5, 2.0, parameters(dt=0.25)) == (0, 0, 0.125)
    assert bounce_back(0.0, 0.0, 0.0, parameters()) == (0, 0, 0)


@given(st.floats(1e-6, 1), st.floats(1e-3, 100), st.floats(-50, 50))
def test_a_bounce_keeps_the_energy_unless_the_disc_comes_to_rest(depth, speed, pull):
    if speed * speed < 2 * pull * depth:
        return  # it would never have been at the wall
    way, inward, _ = bounce_back(depth, speed, pull, parameters(dt=1e9))
    before, after = speed**2 / 2 - pull * depth, inward**2 / 2 + pull * way
    assert after <= before + 1e-9 * (1 + before)
    if way > 0:
        assert after == pytest.approx(before, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("contact", ["push", "impact"])
def test_the_floor_carries_a_disc_at_rest(contact):
    heap = mpsim.Scene(
        width=4, height=4, position=[[2, 0.5]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1), wall_restitution=0.5
    )
    with simulate(heap, method="naive", dt=1 / 64, contact=contact) as sim:
        assert wall_impulses(sim, 640) == pytest.approx([0, 0, 10, 0], rel=2e-3)
