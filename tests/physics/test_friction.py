"""Friction and spin against closed forms: single contacts, a disc that comes to roll, gases of rough discs, a heap."""

import json
import math

import numpy as np
import pytest
from support.processes import run_script
from support.rough import CASES, METHODS
from support.scenes import simulate
from support.selection import long_but

import mpsim
from mpsim import Scene
from mpsim.measure import independent_average, kinetic_energy, rotational_energy

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


@pytest.fixture(scope="module")
def found():
    """What contacts and a rolling disc come to, in plain Python, which needs no compilation for each feature."""
    ran = run_script(
        "from support import rough; rough.main()", env={"NUMBA_DISABLE_JIT": "1"}, flags=("-W", "ignore"), bound=300
    )
    assert ran.code == 0, ran.err
    return json.loads(ran.out)


# --- one contact


@pytest.mark.parametrize("how", METHODS)
@pytest.mark.parametrize("name", CASES)
def test_velocities_and_spins_after_a_contact_are_those_of_walton_and_braun(name, how, found):
    """Over all angles of impact, on both sides of tan = 3 mu (1 + e) / (1 + beta_0), where discs begin to slide."""
    case = found[f"{name} by {how}"]
    assert max(case["velocity"], case["spin"]) < 1e-12
    assert case["angular"] < 1e-13, "about the point of contact, of each disc"
    assert case["rise"] < 1e-14, "the energy"
    assert min(case["stuck"], case["slid"]) > 30, "both happen"
    assert min(case["factor"], case["sign"]) > 0.1, "the controls: a law without the factor 1/3, and of the wrong sign"


# --- a disc that slides until it rolls


@pytest.mark.parametrize("how", ["push", "impact", "naive"])
def test_a_sliding_disc_slows_down_by_mu_g_until_it_rolls_at_two_thirds_of_its_speed(how, found):
    roll = found[f"rolling by {how}"]
    assert roll["deceleration"] == pytest.approx(0.5, rel=1e-12), "mu g"
    assert roll["spin-up"] == pytest.approx(2.0, rel=1e-12), "2 mu g / a"
    exact = 0.5 - 0.5 * 0.5 * 0.5**2
    assert roll["place"] == pytest.approx(exact, rel=1e-12 if how != "push" else 0.01), "v t - mu g t^2 / 2"
    assert roll["speed"] == pytest.approx(2 / 3, rel=1e-12)
    assert abs(roll["slip"]) < 1e-14
    assert roll["change"] < 1e-14, "it rolls on"


@pytest.mark.long
def test_the_exact_solver_has_the_same_sliding_and_rolling_disc():
    """At rest on the floor it hovers in bounces of the guard's time; friction acts at each of them."""
    scene = Scene(
        width=20, height=4, position=[[1.0, 0.5]], velocity=[[1.0, 0.0]], radius=0.5, gravity=(0, -2),
        wall_restitution=0.0, wall_friction=0.25,
    )  # fmt: skip
    with simulate(scene, method="event", dt=1 / 64) as sim:
        with pytest.warns(mpsim.errors.GuardWarning):
            sim.run(until=0.5)
        early = sim.state
        sim.run(until=1.5)  # which warns no more
        late = sim.state
    assert early.velocity[0, 0] == pytest.approx(0.75, rel=1e-5)
    assert late.velocity[0, 0] == pytest.approx(2 / 3, rel=1e-5)
    assert late.velocity[0, 0] + 0.5 * late.spin[0] == pytest.approx(0, abs=1e-5)


# --- gases


def rough_gas(seed, beta, spin=None, restitution=1.0, count=600, **law):
    """A dilute gas of discs that never slide."""
    law = {
        "friction": math.inf,
        "tangential_restitution": beta,
        "restitution": restitution,
        "boundary": "periodic",
    } | law
    return Scene.random(count=count, packing=0.05, radius=0.5, seed=seed, spin=spin, **law)


def temperatures(state, scene):
    """Of translation and of rotation, the first without the motion of the whole gas."""
    rotation = rotational_energy(state, scene)
    return (kinetic_energy(state, scene) - rotation) / (scene.count - 1), 2 * rotation / scene.count


def exchanged(beta, restitution, tau):
    """Temperatures (translation, rotation) after so many collisions of each disc, from (1, 0).

    Mean field, both Gaussian: Huthmann and Zippelius, Phys. Rev. E 56, R6275 (1997); for discs Luding, Huthmann,
    McNamara and Zippelius, Phys. Rev. E 58, 3416 (1998). Per collision, with h = (1 + beta) / 3 for uniform discs:
    dT = -(1 - e^2) T / 2 - h T / 2 + h^2 (T / 4 + R / 2), dR = -2 h R + h^2 (T + 2 R).
    """
    h = (1 + beta) / 3
    rates = np.array(
        [[-(1 - restitution**2) / 2 - h / 2 + h * h / 4, h * h / 2], [h * h, -2 * h + 2 * h * h]]
    )  # fmt: skip
    values, vectors = np.linalg.eig(rates * tau)
    return (vectors @ np.diag(np.exp(values)) @ np.linalg.inv(vectors) @ np.array([1.0, 0.0])).real


def test_the_rates_of_exchange_are_those_known():
    """The control of the reference: equipartition at beta = 1, Haff's law at beta = -1, and no energy from nowhere."""
    assert exchanged(1.0, 1.0, 60) == pytest.approx([2 / 3, 2 / 3])
    assert exchanged(1.0, 1.0, 0.5)[0] - exchanged(1.0, 1.0, 0.5)[1] == pytest.approx(math.exp(-1 / 3))
    assert exchanged(-1.0, 0.9, 2.0) == pytest.approx([math.exp(-(1 - 0.81)), 0])


@pytest.mark.parametrize(("beta", "restitution"), long_but([(1.0, 1.0), (0.0, 0.9), (-1.0, 1.0)], (1.0, 1.0)))
@pytest.mark.parametrize("how", ["event", "impact"])
def test_rotation_takes_energy_from_translation_at_the_known_rate(how, beta, restitution):
    ratios = []
    for seed in range(4):
        scene = rough_gas(seed, beta, restitution=restitution)
        with simulate(scene, dt=0.02, **METHODS[how]) as sim:
            collisions = sim.run(until=4.0).collisions
            translation, rotation = temperatures(sim.state, scene)
        expected = exchanged(beta, restitution, 2 * collisions / scene.count)
        start = temperatures(mpsim.State(scene.position, scene.velocity), scene)[0]
        ratios.append(np.array([translation, rotation]) / start - expected)
    mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0, ddof=1) / 2
    if beta == -1:
        assert np.abs(ratios).max() < 1e-12, "smooth: nothing is exchanged"
        return
    assert expected[1] > 0.05
    assert (np.abs(mean) < 4 * error + 0.015).all(), f"{mean} +- {error}"  # the mean field is good to some percent


@pytest.mark.parametrize("how", ["event", "impact"])
def test_perfectly_rough_discs_share_their_energy_evenly(how):
    """T_rot / T_tr = 1 for beta_0 = 1, whatever it was at the start: one degree of freedom of three rotates."""
    found = []
    for seed in range(8):
        scene = Scene.random(
            count=150, packing=0.3, radius=0.5, seed=seed, friction=math.inf, tangential_restitution=1.0,
            boundary="periodic", temperature=1.0, spin=6.0 * (seed % 2),
        )  # fmt: skip
        with simulate(scene, dt=0.01, **METHODS[how]) as sim:
            energy = kinetic_energy(sim.state, scene)
            sim.run(until=5.0)
            ratios = []
            for _ in range(60):
                sim.run(until=sim.time + 0.5)
                translation, rotation = temperatures(sim.state, scene)
                ratios.append(rotation / translation)
            assert kinetic_energy(sim.state, scene) == pytest.approx(energy, rel=1e-10)
        found.append(np.mean(ratios))
    mean = independent_average(np.array(found))
    assert abs(mean.value - 1) < max(4 * mean.error, 0.01), f"{mean}"
    assert mean.error < 0.03


@pytest.mark.long
def test_no_collision_of_a_gas_between_rough_walls_raises_the_energy():
    scene = Scene.random(
        count=200,
        packing=0.5,
        radius=0.5,
        seed=3,
        friction=0.3,
        wall_friction=0.6,
        tangential_restitution=0.5,
        spin=2.0,
    )
    with simulate(scene, method="grid", dt=0.01, contact="impact") as sim:
        energies = [kinetic_energy(sim.state, scene)]
        for _ in range(100):
            sim.run(frames=1)
            energies.append(kinetic_energy(sim.state, scene))
    assert (np.diff(energies) <= 1e-12 * energies[0]).all()
    assert energies[-1] < 0.8 * energies[0]


# --- heaps


def test_a_pyramid_of_three_discs_stands_from_the_friction_on_that_statics_asks_for(found):
    """The upper disc pushes the lower ones apart along 30 degrees; they do not roll from mu = tan 15 = 0.268 on.

    There is no static friction in the law: the impulses of each step add up to it.
    """
    stands, falls = found["pyramid with 0.3"], found["pyramid with 0.24"]
    assert stands["width"] < 1.05
    assert stands["height"] == pytest.approx(0.5 + math.sqrt(0.75), abs=0.02)
    assert falls["width"] > 2
    assert falls["height"] == pytest.approx(0.5, abs=0.01)


def heap(friction):
    """Width of the middle nine tenths of 200 grains of four sizes, and their mean height.

    They were let go in a column above a floor of grains that are glued to it.
    """
    index = np.arange(200)
    row, column = np.divmod(index, 10)
    radius = np.array([0.25, 0.2, 0.225, 0.175])[(index * index // 3) % 4]
    places = np.stack([15 + 0.53 * (column - 4.5) + 0.1 * (row % 2), 0.52 * (row + 1)], axis=1)
    scene = Scene(
        width=30, height=14, position=places, velocity=np.zeros((200, 2)), radius=radius, gravity=(0, -1),
        restitution=0.3, wall_restitution=0.3, friction=friction, wall_friction=friction,
        obstacles=[mpsim.FixedDisc((place / 2, 0), 0.25) for place in range(61)],
    )  # fmt: skip
    with simulate(scene, method="grid", dt=0.01, contact="impact", passes=4) as sim:
        sim.run(until=40.0)
        x, y = sim.state.position.T
    return float(np.percentile(x, 95) - np.percentile(x, 5)), float(y.mean())


@pytest.mark.long  # two compilations
def test_a_heap_with_friction_stands_where_one_without_spreads():
    (width, height), (flat, low) = heap(0.6), heap(0.0)
    assert flat > 1.3 * width
    assert height > 1.2 * low
    slopes = [math.degrees(math.atan(6 * mean / (wide / 0.9))) for mean, wide in ((height, width), (low, flat))]
    assert slopes[0] > 15 > slopes[1], f"slopes of triangles of these widths and mean heights: {slopes}"
