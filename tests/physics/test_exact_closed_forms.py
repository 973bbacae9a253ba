"""The exact solver against closed forms; the numbers in the names are those of the list in docs/accuracy.md."""

import decimal
import math

import numpy as np
import pytest
from support.exact import (
    Run,
    gas,
    kinetic,
    two_discs,
)

from mpsim.kernels import event_flight, events


def test_a1_time_to_impact_to_13_digits():
    decimal.getcontext().prec = 60
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(300):
        angle, miss, distance = rng.uniform(0, 7), rng.uniform(-0.9, 0.9), rng.uniform(1.001, 9.0)
        speed = 10 ** rng.uniform(-9, 3)
        r = distance * np.array([math.cos(angle), math.sin(angle)])
        turn = math.asin(miss / distance)
        u = -speed * np.array([math.cos(angle + turn), math.sin(angle + turn)])
        rx, ry, ux, uy = (decimal.Decimal(float(a)) for a in (*r, *u))
        b, gap, u2 = rx * ux + ry * uy, rx * rx + ry * ry - 1, ux * ux + uy * uy
        exact = gap / (-b + (b * b - u2 * gap).sqrt())
        # Rounding of the gap itself, r^2 - 1, is a matter of the coordinates: it is taken out.
        condition = max(1.0, float((rx * rx + ry * ry) / gap))
        t = event_flight.time_to_impact(r[0], r[1], u[0], u[1], 1.0)
        worst = max(worst, abs(float((decimal.Decimal(t) - exact) / exact)) / condition)
    print(worst)
    assert worst < 1e-14


def test_a1_the_textbook_root_cancels_where_this_one_does_not():
    # Just above contact and approaching: t is tiny against b/u^2, and the textbook root is the difference of two
    # numbers near b/u^2.
    decimal.getcontext().prec = 60
    r, u = (1.0 + 2.0**-20, 0.0), (-1.0, 0.9)
    rx, ux, uy = (decimal.Decimal(a) for a in (r[0], *u))
    b, gap, u2 = rx * ux, rx * rx - 1, ux * ux + uy * uy
    exact = float(gap / (-b + (b * b - u2 * gap).sqrt()))
    b, gap, u2 = r[0] * u[0], r[0] * r[0] - 1.0, u[0] ** 2 + u[1] ** 2
    textbook = (-b - math.sqrt(b * b - u2 * gap)) / u2
    assert abs(event_flight.time_to_impact(*r, *u, 1.0) / exact - 1.0) < 1e-15
    assert abs(textbook / exact - 1.0) > 1e-12
    assert event_flight.time_to_impact(-1.0, 0.0, 0.0, 1.0, 1.0) == math.inf
    assert event_flight.time_to_impact(1.0 - 1e-12, 0.0, -1.0, 0.0, 1.0) == 0.0
    assert event_flight.time_to_impact(1.0 - 1e-12, 0.0, 1.0, 0.0, 1.0) == math.inf


def test_a2_impact_with_masses_and_restitution():
    masses, e = (2.0, 5.0), 0.6
    run = Run([[3.0, 5.0], [6.0, 5.4]], [[1.5, 0.1], [-0.5, -0.2]], 10.0, 10.0, mass=masses, restitution=e)
    energy = kinetic(run.state()[1], np.array(masses))
    while run.count(events.PAIRS) == 0:
        assert run.advance(100.0, 1) == (events.PAUSED, -1)
    x, v = run.state(run.present())
    n = (x[1] - x[0]) / np.linalg.norm(x[1] - x[0])
    assert abs(np.linalg.norm(x[1] - x[0]) - 1.0) < 1e-14
    closing = (np.array([1.5, 0.1]) - np.array([-0.5, -0.2])) @ n
    reduced = 10.0 / 7.0
    impulse = (1 + e) * reduced * closing
    assert np.abs(v[0] - (np.array([1.5, 0.1]) - impulse * n / 2.0)).max() < 1e-14
    assert np.abs(v[1] - (np.array([-0.5, -0.2]) + impulse * n / 5.0)).max() < 1e-14
    lost = energy - kinetic(v, np.array(masses))
    assert abs(lost - 0.5 * (1 - e**2) * reduced * closing**2) < 1e-14


def test_a3_struck_disc_leaves_along_the_line_of_centres():
    run = Run([[3.0, 5.0], [6.0, 5.4]], [[1.0, 0.0], [0.0, 0.0]], 20.0, 20.0)
    run.advance(4.0)
    assert run.count(events.PAIRS) == 1
    v = run.state()[1]
    assert abs(v[0] @ v[1]) < 1e-14
    n = np.array([math.sqrt(1.0 - 0.16), 0.4])
    assert abs(v[1] @ np.array([-n[1], n[0]])) < 1e-14


@pytest.mark.parametrize(("gap", "e"), [(0.0, None), (1e-9, None), (1e-3, 0.9), (1e-9, 0.9)])
def test_a4_cradle(gap, e):
    count = 6
    x = np.array([2.0] + [5.0 + k * (1.0 + gap) for k in range(count - 1)])
    v = np.zeros((count, 2))
    v[0, 0] = 1.0
    run = Run(np.stack([x, np.full(count, 1.5)], 1), v, 40.0, 3.0, restitution=e)
    # With losses the first disc follows slowly; look once the last one has been struck.
    run.advance(2.0 + 50.0 * gap + 1e-6)
    last = run.state()[1][-1, 0]
    # Gaps of 1e-9 are positions known to 1e-15 only, along one line: nothing is lost.
    assert abs(last - (1.0 if e is None else ((1.0 + e) / 2.0) ** (count - 1))) < 1e-14
    if e is None:
        assert run.count(events.PAIRS) == count - 1
        assert np.abs(run.state()[1][:-1]).max() < 1e-14


def test_a5_discs_on_a_line():
    rng = np.random.default_rng(11)
    count, length = 20, 35.0
    free = length - count
    start = np.sort(rng.uniform(0.0, free, count))
    speed = rng.normal(size=count)
    position = np.stack([start + np.arange(count) + 0.5, np.full(count, 0.5)], 1)
    run = Run(position, np.stack([speed, np.zeros(count)], 1), length, 1.0, tally=True)
    until = 7000.0
    run.advance(until)
    done = run.count(events.PAIRS) + run.count(events.WALLS)
    assert done > 90_000
    folded = np.mod(start + speed * until, 2.0 * free)
    expected = np.arange(count) + 0.5 + np.sort(np.minimum(folded, 2.0 * free - folded))
    error = np.abs(run.state()[0][:, 0] - expected).max()
    assert error < 1e-9
    force = (run.store.tally[events.LEFT] + run.store.tally[events.RIGHT]) / (2.0 * until)
    assert abs(force / ((speed**2).sum() / free) - 1.0) < 2e-3


@pytest.mark.parametrize(("k", "expected"), [(0, 3), (1, 31), (2, 314), (3, 3141), (4, 31415)])
def test_a6_counts_the_digits_of_pi(k, expected):
    run = Run([[3.0, 0.5], [8.0, 0.5]], [[0.0, 0.0], [-1.0, 0.0]], 300.0, 1.0, mass=[1.0, 100.0**k])
    run.advance(100.0)
    assert run.count(events.PAIRS) + run.count(events.WALLS) == expected


def test_a7_bouncing_ball_comes_to_rest_and_does_not_hang():
    height, g, e, guard = 2.0, 1.5, 0.5, 1e-6
    options = dict(gravity=(0.0, -g), wall_restitution=e, contact_time=guard)
    run = Run([[5.0, 0.5 + height]], [[0.0, 0.0]], 10.0, 10.0, **options)
    end = math.sqrt(2.0 * height / g) * (1.0 + e) / (1.0 - e)
    while run.count(events.GUARDS) == 0:
        assert run.advance(100.0, 1) == (events.PAUSED, -1)
    assert abs(run.present() - end) < 3.0 * guard
    before = run.count(events.WALLS)
    assert run.advance(end + 0.05) == (events.REACHED, -1)
    x, _ = run.state()
    # It hovers: half a bounce of at most the guard's duration, and neither sinks nor rises.
    assert 0.0 <= x[0, 1] - 0.5 <= g * guard**2 / 8.0 * 1.01
    assert 0.05 / guard * 0.99 < run.count(events.WALLS) - before < 0.05 / guard / e * 1.01


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_disc_at_rest_on_the_floor_stays_there(speed):
    run = Run([[2.0, 0.5]], [[speed, 0.0]], 10.0, 10.0, gravity=(0.0, -1.0), contact_time=1e-4)
    assert run.advance(5.0) == (events.REACHED, -1)
    x, _ = run.state()
    assert abs(x[0, 1] - 0.5) < 2e-9
    assert abs(x[0, 0] - 2.0 - 5.0 * speed) < 1e-10
    assert run.count(events.GUARDS) > 0
    # Without the guard's least speed the same start is the endless loop that the solver reports.
    bare = Run([[2.0, 0.5]], [[speed, 0.0]], 10.0, 10.0, gravity=(0.0, -1.0), contact_time=0.0)
    assert bare.advance(5.0) == (events.STALLED, 0)


def test_a8_energy_over_a_million_collisions():
    position, velocity, radius, length = gas(400, 0.45, seed=2)
    run = Run(position, velocity, length, length, radius)
    while run.count(events.PAIRS) < 1_000_000:
        run.advance(1e9, 200_000)
    drift = kinetic(run.state(run.present())[1]) / kinetic(velocity) - 1.0
    assert abs(drift) < 1e-12


def test_a10_floor_carries_the_weight():
    position, velocity, radius, length = gas(64, 0.3, seed=4)
    g, until = 0.8, 50.0
    run = Run(position, velocity, length, length, radius, gravity=(0.0, -g), tally=True)
    run.advance(until)
    tally = run.store.tally
    gained = run.state()[1][:, 1].sum() - velocity[:, 1].sum()
    assert abs((tally[events.BOTTOM] - tally[events.TOP]) / (64 * g * until + gained) - 1.0) < 1e-12
    assert abs((tally[events.BOTTOM] - tally[events.TOP]) / (64 * g * until) - 1.0) < 0.02


def test_a11_energy_of_350_bounces():
    g = 1.0
    run = Run([[5.0, 6.0]], [[0.1, 0.0]], 10.0, 10.0, gravity=(0.0, -g))
    energy = 0.5 * 0.01 + g * 6.0
    while run.count(events.WALLS) < 350:
        run.advance(1e9, 1)
    x, v = run.state(run.present())
    drift = (kinetic(v) + g * x[0, 1]) / energy - 1.0
    assert abs(drift) < 1e-12


def test_b1_two_discs_in_a_box():
    radius, starts, until = 0.2, 48, 10_000.0
    rates = []
    for seed in range(starts):
        x, v = two_discs(seed, 1.0, radius, False)
        run = Run(x, v, 1.0, 1.0, radius, tally=True)
        run.advance(until)
        rates.append([run.store.tally[:4].sum() / 4.0, run.count(events.WALLS), run.count(events.PAIRS)])
    rates = np.array(rates) / until
    mean, error = rates.mean(0), rates.std(0, ddof=1) / math.sqrt(starts)
    exact = np.array([5.641119, 9.576661, 4.155474])
    assert (error / exact < 1.2e-3).all()
    assert (np.abs(mean - exact) < 3.0 * error).all()
    # Negative control: the figures tell a radius that is wrong by one per cent.
    assert (np.abs(np.array([5.70, 9.65, 4.26]) - mean) > 3.0 * error).all()


def test_b3_two_discs_on_a_torus():
    radius, starts, length, until = 0.2, 48, 1.0, 15_000.0
    rates = []
    for seed in range(starts):
        x, v = two_discs(seed, length, radius, True)
        run = Run(x, v, length, length, radius, periodic=(True, True))
        run.advance(until)
        rates.append(run.count(events.PAIRS) / until)
    relative = 2.0 * math.sqrt(2.0)
    exact = 2.0 * 0.4 * relative / (length**2 - math.pi * 0.4**2)
    mean, error = np.mean(rates), np.std(rates, ddof=1) / math.sqrt(starts)
    assert error / exact < 1.5e-3
    assert abs(mean - exact) < 3.0 * error


def test_c6_wall_and_pair_counters_agree_exactly():
    position, velocity, radius, length = gas(100, 0.3, seed=6)
    run = Run(position, velocity, length, length, radius, tally=True)
    until = 60.0
    run.advance(until)
    x, v = run.state()
    left, right, bottom, top, virial = run.store.tally
    # d/dt sum r.p = 2K + forces: with positions counted from the box centre both walls of an axis push with arm
    # (L - 2R)/2. The left side is what the same two states give directly.
    half = 0.5 * length
    growth = ((x - half) * v).sum() - ((position - half) * velocity).sum()
    arm = half - radius
    balance = 2.0 * kinetic(velocity) * until - arm * (left + right + bottom + top) + virial
    scale = 2.0 * kinetic(velocity) * until
    assert abs(balance - growth) / scale < 1e-12
    # Negative control: leaving out one wall in a thousand shows.
    assert abs(balance + 1e-3 * arm * left - growth) / scale > 1e-5


def test_e4_inelastic_collapse_ends_with_the_guard():
    start = [[10.0, 0.5], [11.5, 0.5], [13.2, 0.5]], [[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]]
    run = Run(*start, 40.0, 1.0, restitution=0.05, contact_time=1e-6)
    assert run.advance(3.0) == (events.REACHED, -1)
    assert run.count(events.GUARDS) > 0
    assert run.count(events.PAIRS) < 1000
    # Above 7 - 4 sqrt 3 there is no collapse and the guard has nothing to do.
    mild = Run(*start, 40.0, 1.0, restitution=0.2, contact_time=1e-6)
    mild.advance(3.0)
    assert mild.count(events.GUARDS) == 0
    assert mild.count(events.PAIRS) >= 2


def test_h3_reversed_run_comes_home():
    position, velocity, radius, length = gas(64, 0.3, seed=8)
    there = Run(position, velocity, length, length, radius)
    there.advance(4.0)
    x, v = there.state()
    back = Run(x, -v, length, length, radius)
    back.advance(4.0)
    error = np.abs(back.state()[0] - position).max()
    assert error < 1e-8
    assert back.count(events.PAIRS) == there.count(events.PAIRS) > 150
