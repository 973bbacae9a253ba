"""Gases against kinetic theory and published values, by the exact and the stepped solvers, with the bias of each step.

h = dt sqrt(kT/m) / diameter. The errors of long steps are measured here, so warnings about them are left out.
"""

import math
from functools import cache

import numpy as np
import pytest
from support.compare import overlapping_pairs
from support.scenes import gas, simulate

import mpsim
from mpsim import Scene
from mpsim.measure import Measure, independent_average, reference, speed_kurtosis

pytestmark = [pytest.mark.compiled, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]


def agree(found, expected, control, within=3.0, beyond=5.0, slack=0.0):
    """Require a value, within so many standard errors and a slack, and that a wrong one is beyond so many."""
    assert abs(found.value - expected) < within * found.error + slack, f"{found}, expected {expected}"
    assert abs(found.deviation(control)) > beyond, f"{control} must fail; got {found}"


# --- few discs


def two_discs(seed):
    """Two discs of radius 0.2 in a box of 1 x 1 with a total energy of 2."""
    rng, places = np.random.default_rng(seed), np.full((2, 2), 0.5)
    while np.hypot(*(places[0] - places[1])) < 0.4:
        places = rng.uniform(0.2, 0.8, (2, 2))
    velocity = rng.normal(size=(2, 2))
    return Scene(width=1, height=1, radius=0.2, position=places, velocity=velocity * 2 / np.linalg.norm(velocity))


@cache
def rates_of_two(method, contact, dt, starts, until):
    """Force on a wall and rate of pairs, over those of the closed forms."""
    known, rows = reference.two_discs(1, 1, 0.2, energy=2.0), []
    for seed in range(starts):
        with simulate(two_discs(seed), method=method, contact=contact, dt=dt) as sim:
            found = sim.run(until=until, measures=["pressure", "collision_rate"]).measures
        rows.append([found["pressure"].value / known.force_x, found["collision_rate"].value / known.pair_rate])
    return [independent_average(column) for column in np.transpose(rows)]


def test_two_discs_in_a_box_have_the_rates_of_their_phase_space():
    """The control is a radius larger by one per cent, and the bias of `push`, of first order in dt."""
    wrong, right = (reference.two_discs(1, 1, radius, energy=2.0) for radius in (0.202, 0.2))
    exact = rates_of_two("event", "impact", 20.0, 24, 4000.0)
    for found, name in zip(exact, ("force_x", "pair_rate"), strict=True):
        assert found.error < 0.0035
        agree(found, 1.0, getattr(wrong, name) / getattr(right, name), beyond=2)
    impact, push, longer = (
        rates_of_two("naive", contact, dt, 6, 600.0)[1]
        for contact, dt in (("impact", 0.02), ("push", 0.02), ("push", 0.04))
    )
    assert abs(impact.value - 1) < 0.01 + 2 * impact.error
    assert push.value - 1 < -0.03, f"push must meet too seldom; got {push}"
    assert 1.4 < (longer.value - 1) / (push.value - 1) < 2.6, f"{longer}, {push}"


def at_equal_speeds(scene, seed):
    """The same discs, all of speed sqrt(2) and of random direction."""
    angle = np.random.default_rng(seed).random(scene.count) * 2 * math.pi
    velocity = math.sqrt(2) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Scene(width=scene.width, height=scene.height, position=scene.position, velocity=velocity, radius=0.5)


def kurtosis_from_equal_speeds(count, starts, frames, **settings):
    values = []
    for seed in range(starts):
        with simulate(at_equal_speeds(gas(count, 0.3, seed=seed), seed), **settings) as sim:
            sim.run(until=20)
            values.append(sim.run(frames=frames, measures=["speed_kurtosis"]).measures["speed_kurtosis"].value)
    return independent_average(values)


@pytest.mark.parametrize(
    ("count", "method"),
    [pytest.param(3, "event", marks=pytest.mark.slow), pytest.param(10, "naive", marks=pytest.mark.long)],
)
def test_speeds_of_few_discs_have_the_moments_of_fixed_energy(count, method):
    """2N/(N+1), from equal speeds: neither Maxwell's 2 nor the 1 of the start, which `reflect` never leaves."""
    settings = {"method": method, "contact": "impact", "dt": 1.0 if method == "event" else 0.02}
    found = kurtosis_from_equal_speeds(count, 10, 500 if method == "event" else 8000, **settings)
    expected = reference.speed_kurtosis(count)
    assert found.error < 0.025 * expected
    agree(found, expected, 2.0, beyond=6 if count == 3 else 4)
    control = kurtosis_from_equal_speeds(count, 2, 500, method="naive", dt=0.02, law="reflect")
    assert control.value == pytest.approx(1, abs=1e-9)


# --- discs on a line


def line_gas(seed):
    """Twenty discs on a line of 35."""
    rng = np.random.default_rng(seed)
    x, speed = np.sort(rng.uniform(0, 15.0, 20)) + np.arange(20) + 0.5, rng.normal(size=20)
    return Scene(width=35, height=1, radius=0.5, position=np.stack([x, np.full(20, 0.5)], axis=1),
                 velocity=np.stack([speed, np.zeros(20)], axis=1))  # fmt: skip


def jepsen(scene, time, longer=0.0):
    """Places at a time: without their diameters the discs are free points that pass through each other, between walls
    (Jepsen, J. Math. Phys. 6, 405, 1965; Tonks, Phys. Rev. 50, 955, 1936)."""
    x, order, shifts = scene.position[:, 0], np.argsort(scene.position[:, 0]), np.arange(scene.count) + 0.5
    free = 35.0 + longer - scene.count
    points = np.mod(x[order] - shifts + scene.velocity[order, 0] * time, 2 * free)
    places = np.empty_like(x)
    places[order] = np.sort(np.minimum(points, 2 * free - points)) + shifts
    return places


def test_discs_on_a_line_move_as_points_that_pass_through_each_other():
    scene, until = line_gas(11), 7000.0
    with simulate(scene, method="event", dt=until / 4) as sim:
        report = sim.run(frames=4, measures=["pressure"])
        found = sim.state.position[:, 0]
    assert report.collisions > 80_000
    error = np.abs(found - jepsen(scene, until)).max()
    control = np.abs(found - jepsen(scene, until, longer=4e-8)).max()
    assert error < 1e-9
    assert control > 1e-6, "radii smaller by 1e-9 must fail"
    force, squares = report.measures["pressure"].value * (35 + 1), (scene.velocity**2).sum()
    assert force == pytest.approx(squares / (35.0 - 20), rel=5e-3)
    assert abs(force / (squares / 35.0) - 1) > 0.5, "the force of points must fail"


def order(steps, bias, errors):
    """Slope of log |bias| against log step, weighted by the errors of the bias."""
    return np.polyfit(np.log(steps), np.log(np.abs(bias)), 1, w=np.abs(np.divide(bias, errors)))[0]


def line_gas_miss(dt, contact, until, starts):
    """Mean distance of the discs from where they should be, over random starts."""
    misses = []
    for scene in map(line_gas, range(starts)):
        with simulate(scene, method="naive", dt=dt, contact=contact) as sim:
            sim.run(until=until)
            misses.append(np.abs(sim.state.position[:, 0] - jepsen(scene, sim.time)).mean())
    return independent_average(misses)


def test_discs_on_a_line_miss_their_places_by_a_multiple_of_dt_squared():
    """Two contacts of one disc in one frame come at a rate ~ dt, and each puts a disc ~ dt off: dt^2 in all.

    The factor is that of this gas, 0.9 to 1.1 for each unit of time; `push` misses ten times as much, and by dt.
    """
    steps, until = (0.08, 0.04, 0.02), 5.0
    found, control = ([line_gas_miss(dt, how, until, 12) for dt in steps] for how in ("impact", "push"))
    for dt, miss, late in zip(steps, found, control, strict=True):
        assert miss.value < 1.6 * dt**2 * until, f"impact misses by {miss} at dt={dt}"
        assert late.value > max(3 * dt**2 * until, 4 * miss.value), f"push must miss by more; got {late} at dt={dt}"
    orders = [order(steps, [m.value for m in row], [m.error for m in row]) for row in (found, control)]
    assert 1.6 < orders[0] < 2.5, f"order of impact {orders[0]}"
    assert 0.75 < orders[1] < 1.25, f"order of push {orders[1]}"


# --- pressure in a closed box


@cache
def compressibilities(contact, dt, law="elastic", method="naive", packing=0.3, until=1550.0):
    """P A / (N kT) of 100 discs in a closed box from the walls, and that less the same from the collisions."""
    rows = []
    for scene in (gas(100, packing, seed=seed) for seed in range(4)):
        with simulate(scene, method=method, dt=dt, contact=contact, law=law) as sim:
            sim.run(until=50)
            found = sim.run(until=until, measures=["pressure", "pressure_virial"]).measures
        area = scene.width * scene.height / scene.count
        rows.append(np.array([found["pressure"].value, found["pressure_virial"].value]) * area)
    walls, pairs = np.transpose(rows)
    return independent_average(walls), independent_average(walls - pairs)


def test_pressure_tells_the_exact_solver_impact_and_push_apart():
    """At h = 0.1 the published biases are -1.95 % of `impact` and -11 % of `push`.

    The walls' pressure less that of the collisions vanishes for a solver that keeps momentum at each contact at once.
    """
    published, bulk = 2.2389, reference.compressibility(0.3)
    exact, difference = compressibilities("impact", 1.0, method="event")
    assert exact.error < 0.003 * published
    agree(exact, published, bulk, within=4, slack=0.002)
    assert abs(difference.value) < 0.0002 + 3 * difference.error
    impact, late = compressibilities("impact", 0.1)
    push, later = compressibilities("push", 0.1)
    mirrored = compressibilities("impact", 0.1, law="reflect", until=450.0)[1]
    assert -0.027 < impact.value / 2.2389 - 1 < -0.011
    assert -0.12 < push.value / 2.2389 - 1 < -0.095
    assert -0.016 < late.value < -0.005, f"{late} at h = 0.1: second order"
    assert later.value < -0.05, f"push must fail; got {later}"
    assert abs(mirrored.value) > 0.05, f"contacts that do not keep momentum must fail; got {mirrored}"


@pytest.mark.long
@pytest.mark.timeout(900)
def test_push_is_first_order_and_impact_second():
    steps = np.array([0.2, 0.1, 0.05])
    for contact, low, high in (("push", 0.85, 1.15), ("impact", 1.8, 2.2)):
        found = [compressibilities(contact, h, until=20_000.0)[0] for h in steps]
        found_order = order(steps, [m.value / 2.2389 - 1 for m in found], [m.error / 2.2389 for m in found])
        assert low < found_order < high, f"{contact}: {found_order}"


def test_the_mean_overlap_that_is_met_is_that_of_kinetic_theory():
    """sqrt(pi)/2 dt at kT = 1: approach speeds follow v exp(-v^2 / 4 kT), and a contact is half a frame old.

    Looked at from outside as well: in the discs' free flight of one frame.
    """
    expected, found = math.sqrt(math.pi) / 2 * 0.01, {}
    for contact in ("push", "impact"):
        with simulate(gas(200, 0.2, seed=0), method="naive", dt=0.01, contact=contact) as sim:
            sim.run(until=10)
            found[contact] = sim.run(until=90, measures=["overlap"]).measures["overlap"]
        assert found[contact].error < 0.02 * expected
        assert found[contact].value == pytest.approx(expected, rel=0.06)
    depths = []
    with simulate(gas(2000, 0.2, seed=2), dt=0.01, method="grid") as sim:
        for _ in range(60):
            sim.run(frames=4)
            depths.append(1.0 - overlapping_pairs(sim.state.position + sim.state.velocity * 0.01, 1.0)[2])
    outside = np.concatenate(depths)
    assert outside.mean() == pytest.approx(expected, rel=4 * outside.std() / outside.mean() / math.sqrt(len(outside)))
    assert outside.mean() < 0.75 * 2 * expected, "the control: a frame of twice the length"


# --- relaxation


def relaxation(method, seed, count, **settings):
    """Kurtosis excess from equal speeds: first slope per collision, by a parabola, and the value after one."""
    scene = at_equal_speeds(Scene.random(count=count, packing=0.01, radius=0.5, seed=seed), seed + 100)
    chunk = 1 if method == "event" else 10
    collisions, excess = [0.0], [-0.5]
    with simulate(scene, method=method, contact="impact", **settings) as sim:
        while collisions[-1] < 1:
            collisions.append(collisions[-1] + 2 * sim.run(frames=chunk).collisions / count)
            excess.append(speed_kurtosis(sim.state) / 2 - 1)
    tau, gained = np.array(collisions), np.array(excess) + 0.5
    slope, _ = np.linalg.lstsq(np.stack([tau, tau**2], axis=1), gained, rcond=None)[0]
    return slope, float(np.interp(1.0, tau, excess))


@pytest.mark.parametrize(
    ("method", "starts", "count"), [("event", 8, 6000), pytest.param("grid", 8, 3000, marks=pytest.mark.long)]
)
def test_speeds_relax_from_equal_ones_as_boltzmann_says(method, starts, count):
    """a_2 = <v^4>/(2 <v^2>^2) - 1 grows by 32/225 per collision of each disc at first: one collision at an angle t of
    the velocities adds 2 v^4 sin^2(t) sin^2(2 a) to the sum of v^4, both factors average 8/15, and there is half a
    collision per disc. After one collision it is -0.368, by simulation.

    The parabola's slope is up to 3 % high, as the excess bends less and less; a packing of 0.01 is not dilute.

    The controls: collisions counted once for both discs, and one exponential.
    """
    dt = {"event": 1.0, "grid": 0.05}[method]
    found = np.transpose([relaxation(method, seed, count, dt=dt) for seed in range(starts)])
    slope, after = map(independent_average, found)
    expected, known = 32 / 225, -0.368
    assert slope.error < 0.05 * expected
    agree(slope, expected, expected / 2, slack=0.03 * expected)
    agree(after, known, -0.5 * math.exp(-2 * expected), slack=0.003, beyond=4)


def test_energy_stays_over_a_quarter_of_a_million_collisions():
    scene = gas(400, 0.45, seed=2)
    with simulate(scene, method="event", dt=5.0) as sim:
        collisions = 0
        while collisions < 250_000:
            collisions += sim.run(frames=20).collisions
        drift = abs((sim.state.velocity**2).sum() / (scene.velocity**2).sum() - 1)
    assert drift < 1e-12


# --- periodic gases


DENSE_72 = Measure(6.90107, 7e-5, 1)
"""P sigma^2 / kT of 72 discs at packing 0.65, periodic (Li, Nishikawa, Hoellmer, Carillo, Maggs and Krauth, J. Chem.
Phys. 157, 234111, 2022)."""


def bulk(count, packing, starts, collisions, shape=1.0):
    """Z of periodic discs from the collision virial, kT being E/(N - 1): a velocity component that the zero momentum
    takes away has no share of the energy. Of about so many collisions a start."""
    values, height = [], math.sqrt(count * math.pi / 4 / packing * shape)
    rate = count / 2 * reference.enskog_rate(min(packing, 0.62)) * packing / min(packing, 0.62)
    for seed in range(starts):
        scene = Scene.lattice(
            count=count, width=height / shape, height=height, radius=0.5, seed=seed, boundary="periodic"
        )
        with simulate(scene, method="event", dt=collisions / rate / 100) as sim:
            sim.run(frames=10)
            pressure = sim.run(frames=100, measures=["pressure"]).measures["pressure"].value
        kinetic = (scene.velocity**2).sum() / 2
        values.append(1 + (pressure * scene.width * scene.height - kinetic) / (kinetic * count / (count - 1)))
    return independent_average(values)


@pytest.mark.long
@pytest.mark.parametrize("packing", [0.1, 0.3])
def test_pressure_of_a_periodic_gas_is_that_of_the_virial_series(packing):
    """The control: two per cent more dense."""
    found, expected = bulk(256, packing, 8, 150_000), reference.compressibility(packing)
    expected += reference.finite_size(packing, 256)
    assert found.error < 1.5e-3 * expected
    agree(found, expected, reference.compressibility(1.02 * packing), slack=2e-4 * expected, beyond=4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("starts", "collisions", "precision"),
    [(8, 150_000, 3e-3), pytest.param(32, 2_000_000, 3e-4, marks=pytest.mark.long)],
)
def test_pressure_of_dense_discs_is_the_published_one(starts, collisions, precision):
    """72 discs at packing 0.65 in a square box. The controls: kT = E/N, and a box that suits the crystal better."""
    z, to_pressure = bulk(72, 0.65, starts, collisions), 4 * 0.65 / math.pi
    found, known = Measure(z.value * to_pressure, z.error * to_pressure, starts), DENSE_72
    assert found.error < precision * known.value
    assert abs(found.value - known.value) < 3 * math.hypot(found.error, known.error), f"{found}, published {known}"
    naive = ((z.value - 1) * 71 / 72 + 1) * to_pressure
    assert abs(naive - known.value) > 5 * found.error, f"kT = E/N, {naive}, must fail; published {known}"
    other = bulk(72, 0.65, 16, 150_000, shape=math.sqrt(0.75))
    assert other.value * to_pressure - known.value > 4 * other.error * to_pressure, f"another box; got {other}"


# --- a compressed gas in equilibrium, and where compressed discs jam

COUNT = 100


@pytest.mark.long
def test_a_compressed_gas_has_the_pressure_of_the_equation_of_state():
    packing = 0.6
    scene = mpsim.Scene.random(count=COUNT, packing=0.3, radius=0.5, boundary="periodic", seed=4)
    scene = scene.compressed(packing, rate=0.1)
    with simulate(scene, method="event", dt=1.0) as sim:
        sim.run(until=20.0)
        pressure = sim.run(until=520.0, measures="pressure").measures["pressure"]
    # kT = E/(N - 1): a velocity component that the zero momentum takes away has no share of the energy.
    ratio, area = (COUNT - 1) / COUNT, scene.width * scene.height
    z = 1 + (pressure.value * area / COUNT - 1) * ratio
    found = Measure(z, pressure.error * area / COUNT * ratio, pressure.samples)
    expected = reference.compressibility(packing) + reference.finite_size(packing, COUNT)
    assert found.error < 0.003 * expected
    assert abs(found.deviation(expected)) < 4, f"Z = {found}, expected {expected}"
    wrong = reference.compressibility(0.98 * packing)
    assert abs(found.deviation(wrong)) > 4, f"two per cent less dense, {wrong}, must fail; got {found}"


def jammed_at(scene, packing, rate=0.1):
    """The packing at which a scene jams on its way to another one."""
    with pytest.raises(mpsim.InputError, match="jammed") as caught:
        scene.compressed(packing, rate=rate)
    return float(str(caught.value).split("a packing of ")[1].split(". ")[0])


@pytest.mark.parametrize(
    ("count", "distance"),
    [
        pytest.param(5, math.sqrt(2) / 2, marks=pytest.mark.slow),
        pytest.param(3, math.sqrt(6) - math.sqrt(2), marks=pytest.mark.long),
        pytest.param(9, 0.5, marks=pytest.mark.long),
    ],
)
def test_few_discs_jam_in_the_densest_packing_in_a_square(count, distance):
    """distance: the largest least distance of so many points in a unit square (of nine: Schaer, Canad. Math. Bull. 8,
    273, 1965). Some starts jam before, none after.
    """
    densest = count * math.pi * (distance / (2 * (1 + distance))) ** 2
    starts = [mpsim.Scene.random(count=count, packing=0.2, radius=0.5, seed=seed) for seed in range(4)]
    found = max(jammed_at(scene, densest + 0.02) for scene in starts)
    assert densest - 3e-6 < found < densest, f"{found}, expected {densest}"
