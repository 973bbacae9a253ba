"""Closed forms of motions against direct simulation of the simplest kind."""

import math

import numpy as np
import pytest

from mpsim.errors import InputError
from mpsim.measure import reference_motion as motion


def follow_line(x, v, time, length, radius):
    """The gas on a line, collision by collision: positions, velocities, impulse on both walls. Discs in order."""
    x, v, clock, impulse = x.copy(), v.copy(), 0.0, 0.0
    while True:
        gaps = np.diff(x, prepend=-radius, append=length + radius) - 2 * radius
        closing = -np.diff(v, prepend=0.0, append=0.0)
        waits = np.where(closing > 0, np.maximum(gaps, 0) / np.where(closing > 0, closing, 1), np.inf)
        k = int(waits.argmin())
        if clock + waits[k] >= time:
            return x + v * (time - clock), v, impulse
        x, clock = x + v * waits[k], clock + waits[k]
        if k in (0, len(x)):
            end = 0 if k == 0 else -1
            impulse += 2 * abs(v[end])
            v[end] = -v[end]
        else:
            v[k - 1], v[k] = v[k], v[k - 1]


def line(count, seed, length=12.0, radius=0.25):
    rng = np.random.default_rng(seed)
    x = np.sort(rng.random(count)) * (length - 2 * radius * count) + 2 * radius * (np.arange(count) + 0.5)
    return x, rng.normal(size=count), length, radius


@pytest.mark.parametrize("count", [1, 2, 7])
def test_the_gas_on_a_line_is_followed_exactly(count):
    x, v, length, radius = line(count, seed=count)
    for time in (0.0, 0.3, 5.0, 400.0):
        places, speeds, _ = follow_line(x, v, time, length, radius)
        found, velocity = motion.line_gas(x, v, time, length, radius)
        assert found == pytest.approx(places, abs=1e-9)
        assert velocity == pytest.approx(speeds, abs=1e-12)


def test_discs_of_the_line_keep_the_order_they_were_given_in():
    x, v, length, radius = line(5, seed=9)
    shuffle = np.array([3, 0, 4, 1, 2])
    found, velocity = motion.line_gas(x[shuffle], v[shuffle], 7.0, length, radius)
    expected, speeds = motion.line_gas(x, v, 7.0, length, radius)
    assert found.tolist() == expected[shuffle].tolist()
    assert velocity.tolist() == speeds[shuffle].tolist()


def test_negative_control_points_without_diameter_are_elsewhere():
    x, v, length, radius = line(7, seed=7)
    places, _, _ = follow_line(x, v, 5.0, length, radius)
    found, _ = motion.line_gas(x, v, 5.0, length, 1e-9)
    assert np.abs(found - places).max() > 0.1


def test_a_full_line_cannot_move():
    found, _ = motion.line_gas([0.5, 1.5], [1.0, -3.0], 8.0, 2.0, 0.5)
    assert found.tolist() == [0.5, 1.5]


def test_mean_force_on_the_walls_of_the_line():
    x, v, length, radius = line(7, seed=1)
    _, _, impulse = follow_line(x, v, 2000.0, length, radius)
    expected = motion.line_gas_force(float((v**2).sum()) / 2, 7, length, radius)
    assert impulse / 2 / 2000.0 == pytest.approx(expected, rel=0.005)


def collisions_with_a_wall(heavy):
    """Collisions of a heavy disc that comes from the right, a light one (mass 1) at rest, and a wall at the left."""
    light_v, heavy_v, count = 0.0, -1.0, 0
    while True:
        if heavy_v < light_v:
            total = heavy * heavy_v + light_v
            light_v, heavy_v = 2 * total / (heavy + 1) - light_v, 2 * total / (heavy + 1) - heavy_v
        elif light_v < 0:
            light_v = -light_v
        else:
            return count
        count += 1


def test_galperin_counts():
    assert [motion.galperin_collisions(power) for power in range(4)] == [3, 31, 314, 3141]
    for power in range(5):
        assert motion.galperin_collisions(power) == collisions_with_a_wall(100.0**power)
        assert motion.galperin_collisions(power) == math.ceil(math.pi / math.atan(0.1**power) * (1 - 1e-14)) - 1
    assert motion.galperin_collisions(15) == math.floor(math.pi * 10**15)
    assert collisions_with_a_wall(101.0) == 31  # the count is a step function of the mass,
    assert collisions_with_a_wall(120.0) != 31  # negative control: but not constant


@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.9])
def test_the_end_of_bouncing_is_the_sum_of_the_flights(restitution):
    height, gravity = 2.0, 3.0
    fall = math.sqrt(2 * height / gravity)
    flights = fall + sum(2 * fall * restitution**k for k in range(1, 600))
    assert motion.end_of_bouncing(height, gravity, restitution) == pytest.approx(flights, rel=1e-13)


def collide(v, rng, restitution, collisions):
    """Collisions of a uniform gas by direct simulation Monte Carlo (Bird 1963), 2 % of the discs at most at a time.

    Yields collisions per disc so far and velocities.
    """
    done, half = 0.0, len(v) // 2
    while done < collisions:
        i, j = rng.permutation(len(v)).reshape(2, -1)[:, :half]
        angle = rng.uniform(0, 2 * np.pi, half)
        n = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        approach = ((v[i] - v[j]) * n).sum(axis=1)
        hit = rng.random(half) * 25 * math.sqrt((v**2).mean()) < approach
        kick = ((1 + restitution) / 2 * approach)[hit, None] * n[hit]
        v[i[hit]] -= kick
        v[j[hit]] += kick
        done += 2 * int(hit.sum()) / len(v)
        yield done, v


@pytest.mark.parametrize("restitution", [0.95, 0.9])
def test_haff_by_collisions_in_a_simulated_gas(restitution):
    rng = np.random.default_rng(3)
    for done, v in collide(rng.normal(size=(20_000, 2)), rng, restitution, 8):  # noqa: B007
        pass
    expected = motion.haff_by_collisions(done, restitution)
    assert (v**2).mean() == pytest.approx(expected, rel=0.02)
    assert motion.haff_by_collisions(done, 1.0) > 1.4 * expected  # negative control: nothing lost


def test_haff_in_time_is_haff_by_collisions_at_the_falling_rate():
    restitution, rate = 0.8, 2.4
    time, steps = 10.0, 1000
    middle = (np.arange(steps) + 0.5) * time / steps
    ratio = np.array([motion.haff_in_time(t, restitution, rate) for t in middle])
    collisions = rate * np.sqrt(ratio).mean() * time
    assert motion.haff_in_time(time, restitution, rate) == pytest.approx(
        motion.haff_by_collisions(collisions, restitution), rel=1e-5
    )


def test_kurtosis_from_equal_speeds_in_a_simulated_gas():
    early, late = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        angle = rng.uniform(0, 2 * np.pi, 40_000)
        history = [(0.0, -0.5)]
        for done, v in collide(np.stack([np.cos(angle), np.sin(angle)], axis=1), rng, 1.0, 1.02):
            squares = (v**2).sum(axis=1)
            history.append((done, (squares**2).mean() / (2 * squares.mean() ** 2) - 1))
        done, excess = np.array(history).T
        early.append(np.interp(0.05, done, excess))
        late.append(np.interp(1.0, done, excess))
    assert np.mean(early) == pytest.approx(motion.excess_from_equal_speeds(0.05), abs=0.0005)
    assert np.mean(late) == pytest.approx(motion.EQUAL_SPEEDS_AFTER_ONE, abs=0.002)
    assert motion.excess_from_equal_speeds(1.0) > np.mean(late) + 0.005  # negative control: not a straight line
    exponential = -0.5 * math.exp(-2 * motion.EQUAL_SPEEDS_SLOPE)
    assert abs(exponential - np.mean(late)) > 0.004  # nor one exponential


def test_first_slope_by_quadrature():
    """Mean growth of the sum of v^4 per collision of two discs of speed 1, over angles and impact parameters."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    half, w = (nodes + 1) * np.pi / 2, weights
    between = (w * np.sin(2 * half) ** 2 * np.sin(half)).sum() / (w * np.sin(half)).sum()
    impact = (weights / 2 * np.sin(2 * np.arcsin(nodes)) ** 2).sum()
    per_collision = 2 * between * impact
    assert per_collision / 2 / 2 == pytest.approx(motion.EQUAL_SPEEDS_SLOPE, rel=1e-12)


def test_mean_overlap_of_push_by_monte_carlo():
    """Approach speeds u of colliding pairs (density u exp(-u^2/(4 kT))), contact at any time of the frame."""
    rng = np.random.default_rng(4)
    approach = np.sqrt(4 * 2.0 * rng.exponential(size=400_000))
    depth = approach * rng.random(len(approach)) * 0.01
    assert depth.mean() == pytest.approx(motion.mean_push_overlap(0.01, 2.0), rel=0.005)
    normal = np.abs(rng.normal(0, math.sqrt(2 * 2.0), 400_000))  # negative control: as if fast pairs met no more often
    assert normal.mean() * 0.005 < 0.7 * depth.mean()
    assert round(motion.mean_push_overlap(1.0), 3) == 0.886


def test_largest_speed_of_many_draws():
    v = np.random.default_rng(5).normal(0, 1.5, (400, 2500, 2))
    largest = np.hypot(v[..., 0], v[..., 1]).max(axis=1)
    median = motion.largest_speed(2500, 1, 1.5**2)
    assert np.median(largest) == pytest.approx(median, rel=0.03)
    assert motion.largest_speed(1, 1) == 0.0


def test_tunnelling_limit_by_hand():
    dt = motion.tunnelling_dt(0.5, 4.0)
    assert dt == 0.125
    gap = 1.0  # discs touch, run at each other at 4: after a frame of just dt their centres meet, after more they pass
    assert gap - 2 * 4.0 * dt == 0
    assert gap - 2 * 4.0 * (1.01 * dt) < 0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: motion.line_gas([], [], 1.0, 2.0, 0.5), "one disc or more"),
        (lambda: motion.line_gas([0.5, 1.2], [0, 0], 1.0, 3.0, 0.5), "least gap -0.3"),
        (lambda: motion.line_gas([0.4], [0], 1.0, 3.0, 0.5), "walls at 0 and 3"),
        (lambda: motion.line_gas([2.6], [0], 1.0, 3.0, 0.5), "walls at 0 and 3"),
        (lambda: motion.line_gas([1.0], [0], -1.0, 3.0, 0.5), "time must be a finite number >= 0"),
        (lambda: motion.line_gas_force(1.0, 3, 3.0, 0.5), "length must be more than"),
        (lambda: motion.galperin_collisions(36), "power must be a whole number from 0 to 35"),
        (lambda: motion.galperin_collisions(1.0), "power must be a whole number"),
        (lambda: motion.end_of_bouncing(1.0, 9.8, 1), "restitution must be below 1"),
        (lambda: motion.end_of_bouncing(1.0, 0.0, 0.5), "gravity must be a finite number > 0"),
        (lambda: motion.haff_by_collisions(1.0, 1.1), "restitution must be a number from 0 to 1"),
        (lambda: motion.haff_in_time(-1.0, 0.9, 1.0), "time must be a finite number >= 0"),
        (lambda: motion.excess_from_equal_speeds(1.5), "collisions must be at most 1"),
        (lambda: motion.mean_push_overlap(-0.1), "dt must be a finite number >= 0"),
        (lambda: motion.largest_speed(0, 5), "count must be a whole number"),
        (lambda: motion.tunnelling_dt(0.5, 0.0), "speed must be a finite number > 0"),
    ],
)
def test_bad_input_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()
