"""The exact solver against closed forms of motion, each with something wrong that must fail the same gate."""

import decimal
import math

import numpy as np
import pytest
from support.exact import Run, gas, kinetic
from support.internals import machine_code
from support.scenes import simulate

from mpsim import Scene
from mpsim.kernels.events import flight, records
from mpsim.measure import reference_motion

pytestmark = pytest.mark.slow

time_to_impact = machine_code(flight.time_to_impact)


def test_a1_time_to_impact_to_13_digits(figures):
    decimal.getcontext().prec = 60
    rng = np.random.default_rng(3)
    worst = control = 0.0
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
        t = time_to_impact(r[0], r[1], u[0], u[1], 1.0)
        worst = max(worst, abs(float((decimal.Decimal(t) - exact) / exact)) / condition)
        wider = time_to_impact(r[0], r[1], u[0], u[1], 1.0 + 1e-12)
        control = max(control, abs(float((decimal.Decimal(wider) - exact) / exact)) / condition)
    assert worst < 1e-14
    assert control > 1e-13, "a diameter larger by 1e-12 must fail"
    note = f"diameter 1e-12 larger: {control:.0e}"
    figures.note("A1", "exact", "time to impact, relative error", "< 1e-14", f"{worst:.1e}", note)


def test_a1_the_textbook_root_cancels_where_this_one_does_not(figures):
    # Just above contact and approaching: t is tiny against b/u^2, and the textbook root is the difference of two
    # numbers near b/u^2.
    decimal.getcontext().prec = 60
    r, u = (1.0 + 2.0**-20, 0.0), (-1.0, 0.9)
    rx, ux, uy = (decimal.Decimal(a) for a in (r[0], *u))
    b, gap, u2 = rx * ux, rx * rx - 1, ux * ux + uy * uy
    exact = float(gap / (-b + (b * b - u2 * gap).sqrt()))
    b, gap, u2 = r[0] * u[0], r[0] * r[0] - 1.0, u[0] ** 2 + u[1] ** 2
    textbook = (-b - math.sqrt(b * b - u2 * gap)) / u2
    found, naive = (abs(t / exact - 1.0) for t in (time_to_impact(*r, *u, 1.0), textbook))
    assert found < 1e-15
    assert naive > 1e-12
    figures.note("A1", "exact", "the same just above contact", "< 1e-15", f"{found:.1e}", f"textbook: {naive:.0e}")
    assert time_to_impact(-1.0, 0.0, 0.0, 1.0, 1.0) == math.inf
    assert time_to_impact(1.0 - 1e-12, 0.0, -1.0, 0.0, 1.0) == 0.0
    assert time_to_impact(1.0 - 1e-12, 0.0, 1.0, 0.0, 1.0) == math.inf


def test_a2_impact_with_masses_and_restitution(figures):
    masses, e = (2.0, 5.0), 0.6
    run = Run([[3.0, 5.0], [6.0, 5.4]], [[1.5, 0.1], [-0.5, -0.2]], 10.0, 10.0, mass=masses, restitution=e)
    energy = kinetic(run.state()[1], np.array(masses))
    while run.count("pairs") == 0:
        assert run.advance(100.0, 1) == (records.PAUSED, -1)
    x, v = run.state(run.present())
    n = (x[1] - x[0]) / np.linalg.norm(x[1] - x[0])
    assert abs(np.linalg.norm(x[1] - x[0]) - 1.0) < 1e-14
    closing = (np.array([1.5, 0.1]) - np.array([-0.5, -0.2])) @ n
    reduced = 10.0 / 7.0
    impulse = (1 + e) * reduced * closing
    error = np.abs(v[0] - (np.array([1.5, 0.1]) - impulse * n / 2.0)).max()
    assert error < 1e-14
    assert np.abs(v[1] - (np.array([-0.5, -0.2]) + impulse * n / 5.0)).max() < 1e-14
    lost = energy - kinetic(v, np.array(masses))
    assert abs(lost - 0.5 * (1 - e**2) * reduced * closing**2) < 1e-14
    equal = np.abs(v[0] - (np.array([1.5, 0.1]) - (1 + e) * 0.5 * closing * n)).max()
    assert equal > 0.1, "the law of equal masses must fail"
    figures.note(
        "A2", "exact", "velocity after impact, error", "< 1e-14", f"{error:.0e}", f"as equal masses: {equal:.2f}"
    )


def test_a3_struck_disc_leaves_along_the_line_of_centres(figures):
    run = Run([[3.0, 5.0], [6.0, 5.4]], [[1.0, 0.0], [0.0, 0.0]], 20.0, 20.0)
    run.advance(4.0)
    assert run.count("pairs") == 1
    v = run.state()[1]
    assert abs(v[0] @ v[1]) < 1e-14
    across = np.array([-0.4, math.sqrt(1.0 - 0.16)])
    aside = abs(v[1] @ across)
    assert aside < 1e-14
    scene = Scene(width=20, height=20, position=[[3, 5], [6, 5.4]], velocity=[[1, 0], [0, 0]], radius=0.5)
    with simulate(scene, method="grid", dt=0.03, contact="push") as sim:
        sim.run(until=4)
        late = abs(sim.state.velocity[1] @ across)
    assert late > 1e-3, "push, which meets the pair late, must fail"
    figures.note("A3", "exact", "velocity across the line of centres", 0, f"{aside:.0e}", f"push, h = 0.03: {late:.3f}")


@pytest.mark.parametrize(("gap", "e"), [(0.0, None), (1e-9, None), (1e-3, 0.9), (1e-9, 0.9)])
def test_a4_cradle(gap, e, figures):
    count = 6
    x = np.array([2.0] + [5.0 + k * (1.0 + gap) for k in range(count - 1)])
    v = np.zeros((count, 2))
    v[0, 0] = 1.0
    place = np.stack([x, np.full(count, 1.5)], 1)
    run = Run(place, v, 40.0, 3.0, restitution=e)
    # With losses the first disc follows slowly; look once the last one has been struck.
    run.advance(2.0 + 50.0 * gap + 1e-6)
    last = run.state()[1][-1, 0]
    # Gaps of 1e-9 are positions known to 1e-15 only, along one line: nothing is lost.
    expected = 1.0 if e is None else ((1.0 + e) / 2.0) ** (count - 1)
    assert abs(last - expected) < 1e-14
    heavy = Run(place, v, 40.0, 3.0, restitution=e, mass=[1.0] * (count - 1) + [1.01])
    heavy.advance(2.0 + 50.0 * gap + 1e-6)
    control = heavy.state()[1][-1, 0]
    assert abs(control - expected) > 1e-3, "a last disc one per cent heavier must fail"
    quantity = f"cradle, gap {gap:g}, e = {e or 1}: last speed"
    figures.note(
        "A4", "exact", quantity, f"{expected:.6f}", f"within {abs(last - expected):.0e}", f"heavier: {control:.4f}"
    )
    if e is None:
        assert run.count("pairs") == count - 1
        assert np.abs(run.state()[1][:-1]).max() < 1e-14


def test_a5_discs_on_a_line(figures):
    rng = np.random.default_rng(11)
    count, length = 20, 35.0
    free = length - count
    start = np.sort(rng.uniform(0.0, free, count))
    speed = rng.normal(size=count)
    position = np.stack([start + np.arange(count) + 0.5, np.full(count, 0.5)], 1)
    run = Run(position, np.stack([speed, np.zeros(count)], 1), length, 1.0)
    until = 7000.0
    run.advance(until)
    done = run.count("pairs") + run.count("walls")
    assert done > 90_000
    found = run.state()[0][:, 0]
    error = np.abs(found - reference_motion.line_gas(position[:, 0], speed, until, length, 0.5)[0]).max()
    assert error < 1e-9
    # The same points in a line longer by 4e-8, as discs of radius 0.5 - 1e-9 would leave it.
    control = np.abs(found - reference_motion.line_gas(position[:, 0], speed, until, length + 4e-8, 0.5)[0]).max()
    assert control > 1e-6
    quantity = f"discs on a line after {done} events"
    figures.note("A5", "exact", quantity, "within 1e-9", f"{error:.1e}", f"radius 1e-9 smaller: {control:.0e}")
    force = (run.walls[records.LEFT] + run.walls[records.RIGHT]) / (2.0 * until)
    known = reference_motion.line_gas_force((speed**2).sum() / 2, count, length, 0.5)
    naive = (speed**2).sum() / length
    assert abs(force / known - 1.0) < 2e-3
    assert abs(force / naive - 1.0) > 0.5, "the force of points must fail"
    figures.note("A5", "exact", "mean force on an end wall", f"{known:.4f}", f"{force:.4f}", f"points: {naive:.4f}")


@pytest.mark.parametrize(("k", "expected"), [(0, 3), (1, 31), (2, 314), (3, 3141), (4, 31415)])
def test_a6_counts_the_digits_of_pi(k, expected, figures):
    counted = []
    for mass in (100.0**k, 2.0 * 100.0**k):
        run = Run([[3.0, 0.5], [8.0, 0.5]], [[0.0, 0.0], [-1.0, 0.0]], 300.0, 1.0, mass=[1.0, mass])
        run.advance(100.0)
        counted.append(run.count("pairs") + run.count("walls"))
    found, control = counted
    assert found == expected
    assert control == math.ceil(math.pi / math.atan(1 / math.sqrt(2.0 * 100.0**k))) - 1
    assert control != expected, "twice the mass must count differently"
    figures.note("A6", "exact", f"collisions, mass 100^{k}", expected, found, f"twice the mass: {control}")


def test_a7_bouncing_ball_comes_to_rest_and_does_not_hang(figures):
    height, g, e, guard = 2.0, 1.5, 0.5, 1e-6
    options = dict(gravity=(0.0, -g), wall_restitution=e, contact_time=guard)
    run = Run([[5.0, 0.5 + height]], [[0.0, 0.0]], 10.0, 10.0, **options)
    end = math.sqrt(2.0 * height / g) * (1.0 + e) / (1.0 - e)
    while run.count("guarded") == 0:
        assert run.advance(100.0, 1) == (records.PAUSED, -1)
    last = run.present()
    assert abs(last - end) < 3.0 * guard
    control = reference_motion.end_of_bouncing(height, g, 0.5001)
    assert abs(last - control) > 100 * guard, "a restitution of 0.5001 must fail"
    figures.note("A7", "exact", "end of the bounces", f"{end:.6f}", f"{last:.6f}", f"e = 0.5001: {control:.6f}")
    before = run.count("walls")
    assert run.advance(end + 0.05) == (records.REACHED, -1)
    x, _ = run.state()
    # It hovers: half a bounce of at most the guard's duration, and neither sinks nor rises.
    assert 0.0 <= x[0, 1] - 0.5 <= g * guard**2 / 8.0 * 1.01
    assert 0.05 / guard * 0.99 < run.count("walls") - before < 0.05 / guard / e * 1.01


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_disc_at_rest_on_the_floor_stays_there(speed):
    run = Run([[2.0, 0.5]], [[speed, 0.0]], 10.0, 10.0, gravity=(0.0, -1.0), contact_time=1e-4)
    assert run.advance(5.0) == (records.REACHED, -1)
    x, _ = run.state()
    assert abs(x[0, 1] - 0.5) < 2e-9
    assert abs(x[0, 0] - 2.0 - 5.0 * speed) < 1e-10
    assert run.count("guarded") > 0
    # Without the guard's least speed the same start is the endless loop that the solver reports.
    bare = Run([[2.0, 0.5]], [[speed, 0.0]], 10.0, 10.0, gravity=(0.0, -1.0), contact_time=0.0)
    assert bare.advance(5.0) == (records.STALLED, 0)


def test_a8_energy_over_a_million_collisions(figures):
    position, velocity, radius, length = gas(400, 0.45, seed=2)

    def drift(restitution):
        run = Run(position, velocity, length, length, radius, restitution=restitution)
        while run.count("pairs") < 1_000_000:
            run.advance(1e9, 200_000)
        return abs(kinetic(run.state(run.present())[1]) / kinetic(velocity) - 1.0)

    found, control = drift(None), drift(1.0 - 1e-12)
    assert found < 1e-12
    assert control > 1e-10, "a restitution of 1 - 1e-12 must fail"
    quantity = "energy drift over a million collisions"
    figures.note("A8", "exact", quantity, "< 1e-12", f"{found:.0e}", f"e = 1 - 1e-12: {control:.0e}")


def test_a10_floor_carries_the_weight(figures):
    position, velocity, radius, length = gas(64, 0.3, seed=4)
    g, until = 0.8, 50.0
    run = Run(position, velocity, length, length, radius, gravity=(0.0, -g))
    run.advance(until)
    wall = run.walls
    gained = run.state()[1][:, 1].sum() - velocity[:, 1].sum()
    weight = 64 * g * until + gained
    error, alone = (
        abs(push / weight - 1.0) for push in (wall[records.BOTTOM] - wall[records.TOP], wall[records.BOTTOM])
    )
    assert error < 1e-12
    assert alone > 1e-6, "the floor without the ceiling must fail"
    quantity = "floor less ceiling over weight, error"
    figures.note("A10", "exact", quantity, "< 1e-12", f"{error:.0e}", f"without ceiling: {alone:.0e}")
    assert abs((wall[records.BOTTOM] - wall[records.TOP]) / (64 * g * until) - 1.0) < 0.02


def test_a11_energy_of_350_bounces(figures):
    g = 1.0
    energy = 0.5 * 0.01 + g * 6.0

    def drift(wall_restitution):
        options = dict(gravity=(0.0, -g), wall_restitution=wall_restitution)
        run = Run([[5.0, 6.0]], [[0.1, 0.0]], 10.0, 10.0, **options)
        while run.count("walls") < 350:
            run.advance(1e9, 1)
        x, v = run.state(run.present())
        return abs((kinetic(v) + g * x[0, 1]) / energy - 1.0)

    found, control = drift(None), drift(1.0 - 1e-9)
    assert found < 1e-12
    assert control > 1e-8, "a wall that loses 1e-9 of the speed must fail"
    figures.note(
        "A11", "exact", "energy drift of 350 bounces", "< 1e-12", f"{found:.0e}", f"e = 1 - 1e-9: {control:.0e}"
    )
