"""Radii that grow: times of impacts against roots found by numpy, and impacts against their conservation laws."""

import math

import numpy as np
import pytest

from mpsim.kernels.events import flight
from mpsim.kernels.events.features import expansion

RATE, CONTACT = 0.3, 1.0


class Clock:
    origin = 0.25


class Store:
    clock = Clock()


def first_root(r, u, rate, now):
    """The first time > 0 at which |r + u t| is the contact distance, from all roots of the polynomial."""
    reach, speed = CONTACT * (1 + rate * (now + Clock.origin)), rate * CONTACT
    roots = np.roots([u @ u - speed**2, 2 * (r @ u - reach * speed), r @ r - reach**2])
    found = [root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0]
    return min(found, default=math.inf)


def test_times_of_impacts_are_the_first_roots():
    rng, met = np.random.default_rng(1), 0
    for _ in range(3000):
        angle, distance = rng.uniform(0, 2 * math.pi), rng.uniform(1.5, 4)
        r, u = distance * np.array([math.cos(angle), math.sin(angle)]), rng.normal(size=2) * rng.choice([0.1, 1])
        found = expansion.time_to_impact(RATE, *r, *u, CONTACT, 0.75, Store)
        expected = first_root(r, u, RATE, 0.75)
        met += math.isfinite(expected)
        assert found == pytest.approx(expected, rel=1e-9), (r, u)
    assert 500 < met < 2900, "both kinds occur"


def test_discs_that_do_not_grow_meet_as_ever():
    arguments = 2.0, 0.25, -1.0, 0.0, CONTACT
    assert expansion.time_to_impact(None, *arguments, 0.75, Store) == flight.time_to_impact(*arguments)
    growing = expansion.time_to_impact(RATE, *arguments, 0.75, Store)
    assert growing < flight.time_to_impact(*arguments), "negative control: growth matters"


@pytest.mark.parametrize("speed", [-1.0, 0.0, 0.2])
def test_discs_at_rest_and_slow_ones_meet_as_they_grow(speed):
    """Those that part more slowly than they grow, too."""
    wait = expansion.time_to_impact(RATE, 2.0, 0.0, speed, 0.0, CONTACT, 0.0, Store)
    assert 2.0 + speed * wait == pytest.approx(CONTACT * (1 + RATE * (wait + Clock.origin)))
    assert expansion.time_to_impact(RATE, 2.0, 0.0, 0.31, 0.0, CONTACT, 0.0, Store) == math.inf


def test_discs_in_touch_meet_now_unless_they_part():
    reach = CONTACT * (1 + RATE * Clock.origin)
    inside = reach * (1 - 1e-15)
    assert expansion.time_to_impact(RATE, inside, 0.0, 0.0, 0.0, CONTACT, 0.0, Store) == 0.0
    parting = expansion.time_to_impact(RATE, inside, 0.0, RATE * CONTACT * 1.001, 0.0, CONTACT, 0.0, Store)
    assert parting == math.inf
    aside = expansion.time_to_impact(RATE, inside, 0.0, RATE * CONTACT * 1.001, 0.1, CONTACT, 0.0, Store)
    assert aside == math.inf


def test_surfaces_part_as_fast_as_they_came():
    """r.u of the surfaces, here u - s for r = 1, is turned round; and never so small that they stay in touch."""
    growth = RATE * CONTACT
    assert expansion.approach(RATE, -1.0, 1.0, 0.0, CONTACT) == -1.0 - growth
    assert expansion.approach(RATE, growth, 1.0, 0.0, CONTACT) == -expansion.LEAST * growth
    assert expansion.approach(None, -1.0, 1.0, 0.0, CONTACT) == -1.0
    assert expansion.speed_off_wall(RATE, 1.0, 1.0, 0.5) == pytest.approx(1.0 + 2 * RATE * 0.5)
    assert expansion.speed_off_wall(RATE, -0.5, 0.5, 0.5) > RATE * 0.5, "it leaves the limit that follows it"
    assert expansion.speed_off_wall(None, 1.0, 0.9, 0.5) == 0.9
