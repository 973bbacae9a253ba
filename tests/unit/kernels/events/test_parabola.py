"""Times at which a point on a parabola comes to a line and to a circle, against looking at it very often."""

import math

import numpy as np
import pytest
from support.selection import long_but

from mpsim.kernels.events.parabola import MOST_HALVINGS, time_to_circle, time_to_come_down

LOOKS = 2001


def place_at(r, v, g, t):
    return r[0] + v[0] * t + 0.5 * g[0] * t * t, r[1] + v[1] * t + 0.5 * g[1] * t * t


def sampled(height, within):
    """The first time at which a height falls through 0, by looking at many times and halving; infinity if it does not.

    A dip between two looks is looked for where the height is least.
    """
    times = np.linspace(0.0, within, LOOKS)
    heights = np.array([height(t) for t in times])
    for k in range(LOOKS - 1):
        low, high = times[k], times[k + 1]
        if heights[k] > 0.0 and heights[k + 1] <= 0.0:
            return halved(height, low, high)
        if k > 0 and heights[k] > 0 and heights[k] <= heights[k - 1] and heights[k] <= heights[k + 1]:
            bottom = lowest(height, times[k - 1], high)
            if height(bottom) < 0.0:
                return halved(height, times[k - 1], bottom)
    return math.inf


def halved(height, low, high):
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if height(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)


def lowest(height, low, high):
    """By thirds."""
    for _ in range(100):
        a, b = low + (high - low) / 3, high - (high - low) / 3
        low, high = (low, b) if height(a) < height(b) else (a, high)
    return 0.5 * (low + high)


def circle(r, v, g, contact, within, along=(0.0, 0.0)):
    return time_to_circle(*r, *v, *g, contact, *along, within)


@pytest.mark.slow
@pytest.mark.parametrize("seed", long_but(range(8), 0, 1, 2))
def test_the_first_entry_into_a_circle_is_that_found_by_looking_often(seed):
    rng = np.random.default_rng(seed)
    hits = twice = 0
    for _ in range(60):
        g = rng.normal(size=2) * rng.choice([0.0, 0.1, 1.0, 10.0])
        contact = rng.uniform(0.1, 2.0)
        angle = rng.uniform(0, 2 * math.pi)
        r = (contact + rng.exponential(1.5)) * np.array([math.cos(angle), math.sin(angle)])
        v = (rng.normal(size=2) - 0.7 * r) * rng.choice([0.0, 0.3, 3.0])
        within = rng.uniform(0.5, 6.0)
        height = lambda t, r=r, v=v, g=g, contact=contact: math.hypot(*place_at(r, v, g, t)) - contact  # noqa: E731
        expected, found = sampled(height, within), circle(r, v, g, contact, within)
        if found != expected:
            assert found == pytest.approx(expected, abs=1e-9), (r, v, g, contact, within)
            assert abs(height(found)) < 1e-12
        hits += expected < math.inf
        twice += expected < math.inf and height(within) > 0
    assert hits > 8
    assert twice > 1  # it comes out again, so that later roots are there to be taken by mistake


def test_grazes_are_found_where_they_are_deep_and_left_out_where_they_miss():
    """A parabola whose top touches a circle from below: depth d of the overlap decides, down to rounding."""
    contact, g = 0.5, (0.0, -1.0)
    for depth in (1e-3, 1e-6, 1e-9, 1e-12, -1e-12, -1e-9, -1e-6):
        v, rise = (0.7, 1.1), 1.1**2 / 2
        r = (-0.7 * 1.1, -contact - rise + depth)  # the top of the flight is right below the centre, at t = 1.1
        t = circle(r, v, g, contact, 3.0)
        if depth < 0:
            assert t == math.inf
        else:
            # A time s from the top the overlap is depth - (v_x^2 / contact + g) s^2 / 2.
            assert t == pytest.approx(
                1.1 - math.sqrt(2 * depth / (0.7**2 / contact + 1.0)), abs=2e-2 * math.sqrt(depth)
            )
            assert abs(math.hypot(*place_at(r, v, g, t)) - contact) < 1e-12


def test_a_point_that_touches_leaves_and_comes_back_when_it_falls():
    """Thrown straight up from the top of a circle: back after 2 v / g; also from a rounding inside or outside."""
    for start in (2.0, 2.0 * (1 - 2e-16), 2.0 * (1 + 2e-16)):
        for speed in (1.0, 1e-3, 1e-6):
            assert circle((0.0, start), (0.0, speed), (0.0, -1.0), 2.0, 10.0) == pytest.approx(2 * speed, rel=1e-3)


def test_a_point_that_touches_and_approaches_enters_now():
    assert circle((0.0, 2.0), (0.3, -1e-9), (0.0, -1.0), 2.0, 10.0) == 0.0
    assert circle((0.0, 2.0 - 1e-15), (0.0, -1.0), (0.0, 1.0), 2.0, 10.0) == 0.0
    # At rest on the top: it approaches from now on.
    assert circle((0.0, 2.0), (0.0, 0.0), (0.0, -1.0), 2.0, 10.0) == 0.0
    # At rest below the bottom, it falls away for good.
    assert circle((0.0, -2.0), (0.0, 0.0), (0.0, -1.0), 2.0, 10.0) == math.inf


def test_a_point_along_the_tangent_leaves_where_it_is_fast_and_stays_where_it_is_slow():
    """On the top of a circle of radius R a disc of v^2 > g R flies off; a slower one presses on it."""
    assert circle((0.0, 2.0), (1.5, 0.0), (0.0, -1.0), 2.0, 10.0) == math.inf
    assert circle((0.0, 2.0), (1.4, 0.0), (0.0, -1.0), 2.0, 10.0) == 0.0


def test_the_part_ahead_does_not_count_and_a_later_entry_into_the_rest_does():
    r, v, g = (3.0, 0.0), (-1.0, 0.0), (0.0, 0.0)
    assert circle(r, v, g, 1.0, 10.0) == pytest.approx(2.0, abs=1e-12)
    assert circle(r, v, g, 1.0, 10.0, along=(1.0, 0.0)) == math.inf
    assert circle(r, v, g, 1.0, 10.0, along=(-1.0, 0.0)) == pytest.approx(2.0, abs=1e-12)
    assert circle(r, v, g, 1.0, 1.9) == math.inf
    # Through the circle on the right, up, and back on the left: only the left half counts.
    r, v, g = (0.35, -1.0), (-0.25, 3.0), (0.0, -2.0)
    gap = lambda t: math.hypot(*place_at(r, v, g, t)) - 0.5  # noqa: E731
    first = circle(r, v, g, 0.5, 10.0)
    later = circle(r, v, g, 0.5, 10.0, along=(1.0, 0.0))
    left = sampled(lambda t: gap(t) if t > 1.0 else 1.0, 4.0)
    assert place_at(r, v, g, first)[0] > 0 > place_at(r, v, g, later)[0]
    assert later == pytest.approx(left, abs=1e-9)
    assert later > first + 1


@pytest.mark.parametrize("scale", [1e-100, 1e-30, 1.0, 1e30, 1e100])
def test_units_do_not_matter(scale):
    t = circle((3.0 * scale, 0.4 * scale), (-1.0 * scale, 0.3 * scale), (0.1 * scale, -1.0 * scale), scale, 10.0)
    assert t == pytest.approx(circle((3.0, 0.4), (-1.0, 0.3), (0.1, -1.0), 1.0, 10.0), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", long_but(range(4), 0, 1))
def test_the_time_at_which_a_height_falls_to_zero_is_that_found_by_looking_often(seed):
    rng = np.random.default_rng(seed)
    found = 0
    for _ in range(200):
        height, speed, pull = rng.normal(size=3) * rng.choice([0.0, 0.1, 1.0], 3)
        expected = sampled(lambda t, h=height, s=speed, p=pull: h + s * t + 0.5 * p * t * t, 40.0)
        t = time_to_come_down(height, speed, pull)
        if t == 0.0:
            assert height == 0.0
            continue
        assert (t if t <= 40.0 else math.inf) == pytest.approx(expected, rel=1e-9, abs=1e-9), (height, speed, pull)
        found += expected < math.inf
    assert found > 25


def test_a_bisection_ends():
    """Were each step a halving alone: the longest way down to a single number is shorter than what is allowed."""
    assert MOST_HALVINGS > 3 * 53
