"""Friction and spin against closed forms: single contacts, a disc that comes to roll, gases of rough discs, heaps."""

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim import FixedDisc, Piston, Polyline, Scene
from mpsim.measure import independent_average, kinetic_energy, rotational_energy

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]

METHODS = {
    "push": {"method": "grid", "contact": "push"},
    "impact": {"method": "grid", "contact": "impact"},
    "naive": {"method": "naive", "contact": "impact"},
    "event": {"method": "event"},
}
LAWS = [(0.1, 0.0), (0.3, 0.4), (math.inf, 1.0), (0.5, -0.5)]
"""Friction and tangential restitution."""

RESTITUTION = 0.8
LATE = 0.05
"""Of a frame, since the contact when a frame ends: so little that a grazing one is not over by then."""

ANGLES = np.radians(np.arange(-85, 86, 17))
"""Between the velocity at impact, relative to what is met, and the normal."""

DT = 0.25


class Body(NamedTuple):
    """A disc, or with an infinite mass what does not turn."""

    velocity: Any
    spin: float
    mass: float
    radius: float


def cross(a: Any, b: Any) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def after(
    one: Body, two: Body, n: Any, friction: float, beta: float, restitution: float, factor: float = 1 / 3, sign: int = 1
) -> tuple[Any, float, Any, float]:
    """Velocities and spins of two bodies after they touch along the unit vector n from one to two.

    Written with the velocities of the two points that touch and the moments of the impulse about the centres. A wrong
    factor or sign makes it a control.
    """
    n = np.asarray(n, float)
    left = np.array([-n[1], n[0]])
    slip = (one.velocity + one.spin * one.radius * left) - (two.velocity - two.spin * two.radius * left)
    inverse = 1 / one.mass + 1 / two.mass
    normal = -(1 + restitution) * (slip @ n) / inverse  # impulse on `one` along n, < 0
    tangential = -(1 + beta) * factor * (slip @ left) / inverse
    most = friction * abs(normal)
    tangential = sign * math.copysign(min(abs(tangential), most), tangential)
    impulse = normal * n + tangential * left
    found = [
        one.velocity + impulse / one.mass,
        one.spin + cross(one.radius * n, impulse) / (one.mass * one.radius**2 / 2),
    ]
    turned = 0.0 if math.isinf(two.mass) else cross(-two.radius * n, -impulse) / (two.mass * two.radius**2 / 2)
    return found[0], found[1], two.velocity - impulse / two.mass, two.spin + turned


class Case(NamedTuple):
    """A scene of one contact, the bodies and the direction in which it comes, and after how many frames it has been."""

    scene: Scene
    one: Body
    two: Body
    n: Any
    restitution: float
    frames: int = 2


def law_of(friction: float, beta: float) -> dict[str, float]:
    return {"friction": friction, "wall_friction": friction, "tangential_restitution": beta}


def wall_cases(law: dict[str, float], method: str) -> Iterator[Case]:
    """A disc of radius 0.5 on each wall, from all angles."""
    for n, angle in itertools.product(np.array([[-1.0, 0], [1, 0], [0, -1], [0, 1]]), ANGLES[::3]):
        speed = 1.5 * (math.cos(angle) * n + math.sin(angle) * np.array([-n[1], n[0]]))
        place = 5 + n * 4.5 - speed * DT * 1.3
        one = Body(speed, -0.8, 1.0, 0.5)
        scene = Scene(
            width=10, height=10, position=[place], velocity=[speed], radius=0.5, spin=one.spin,
            wall_restitution=RESTITUTION, **law,
        )  # fmt: skip
        yield Case(scene, one, Body(np.zeros(2), 0.0, math.inf, 1.0), n, RESTITUTION, 3)


def pair_cases(law: dict[str, float], method: str, count: int = 0) -> Iterator[Case]:
    """Two discs of unequal masses and radii, from all angles. count: of others, far away and small."""
    for angle in ANGLES:
        n = np.array([math.cos(angle / 2 + 0.3), math.sin(angle / 2 + 0.3)])
        masses, radii = (1.0, 3.0), (0.5, 0.75)
        if count:
            radii = (0.25, 1.5)
        line = np.array([math.cos(angle + angle / 2 + 0.3), math.sin(angle + angle / 2 + 0.3)])
        drift = np.array([0.25, -0.125])
        speeds = [drift + 1.5 * line, drift]
        late = 0.0 if method == "push" else LATE
        depth = 1e-3 if method == "push" else 0.0
        touch = [np.array([8.0, 8.0]), np.array([8.0, 8.0]) + (sum(radii) - depth) * n]
        place = [at - speed * DT * (2 - late) for at, speed in zip(touch, speeds, strict=True)]
        bodies = [Body(*each) for each in zip(speeds, (0.7, -1.1), masses, radii, strict=True)]
        more = [(0.5 + 0.5 * k, 0.3) for k in range(count)]
        scene = Scene(
            width=20, height=20, restitution=RESTITUTION, position=[*place, *more],
            velocity=[*speeds, *[(0.0, 0.0)] * count], radius=[*radii, *[0.125] * count],
            mass=[*masses, *[1.0] * count], spin=[0.7, -1.1, *[0.0] * count], **law,
        )  # fmt: skip
        yield Case(scene, *bodies, n, RESTITUTION)


def giant_cases(law: dict[str, float], method: str) -> Iterator[Case]:
    """One of the two is a giant, which is not in the grid."""
    return pair_cases(law, method, 24)


def fixed_cases(law: dict[str, float], method: str) -> Iterator[Case]:
    """A disc that meets a fixed disc, the side and the end of a polyline, and a piston."""
    for angle in ANGLES[::3]:
        for obstacle, centre, radius, n in (
            (FixedDisc((5.0, 5.0), 0.5), (5.0, 5.0), 0.5, np.array([0.6, 0.8])),
            (Polyline([(2, 5), (8, 5)], thickness=0.5), (5.0, 5.0), 0.25, np.array([0.0, -1.0])),
            (Polyline([(5, 5), (8, 5)], thickness=0.5), (5.0, 5.0), 0.25, np.array([0.8, 0.6])),
        ):
            speed = 1.2 * (math.cos(angle) * n + math.sin(angle) * np.array([-n[1], n[0]]))
            depth = 1e-3 if method == "push" else 0.0
            touch = np.array(centre) - (radius + 0.5 - depth) * n
            one = Body(speed, 0.9, 1.0, 0.5)
            scene = Scene(
                width=10, height=10, position=[touch - speed * DT * (2.0 if depth else 2 - LATE)], velocity=[speed],
                radius=0.5, spin=one.spin, wall_restitution=RESTITUTION, obstacles=obstacle, **law,
            )  # fmt: skip
            yield Case(scene, one, Body(np.zeros(2), 0.0, math.inf, 1.0), n, RESTITUTION)
        right = np.array([1.0, 0.0])
        speed = 1.2 * np.array([math.cos(angle), math.sin(angle)])
        one = Body(speed, 0.9, 1.0, 0.5)
        scene = Scene(
            width=10, height=10, position=[[9.2, 5.0]], velocity=[speed], radius=0.5, spin=one.spin,
            wall_restitution=RESTITUTION, piston=Piston("right", -0.5, 5), **law,
        )  # fmt: skip
        yield Case(scene, one, Body(np.array([-0.5, 0.0]), 0.0, math.inf, 1.0), right, RESTITUTION, 4)


CASES = {"walls": wall_cases, "pairs": pair_cases, "giants": giant_cases, "what is fixed": fixed_cases}


def energy(velocity: Any, spin: Any, masses: Any, radii: Any) -> float:
    return float((masses * (velocity**2).sum(axis=1)).sum() / 2 + (masses * (radii * spin) ** 2).sum() / 4)


def misses(name: str, how: str) -> dict[str, float]:
    """Largest miss of velocities and spins, of the two controls, of angular momentum about the point of contact, and
    the largest rise of the energy; and how many contacts stuck and how many slid."""
    found = dict.fromkeys(("velocity", "spin", "factor", "sign", "angular", "rise"), 0.0) | {"stuck": 0, "slid": 0}
    for friction, beta in LAWS:
        for case in CASES[name](law_of(friction, beta), how):
            with mpsim.Simulation(case.scene, mpsim.Settings(dt=DT, on_fast="warn", **METHODS[how])) as sim:
                sim.run(frames=case.frames)
                state = sim.state
            rules = (case.one, case.two, case.n, friction, beta, case.restitution)
            v, w, u, x = after(*rules)
            wall = math.isinf(case.two.mass)
            speeds = state.velocity[: 2 - wall]
            assert state.spin is not None
            spins = state.spin[: 2 - wall]
            right = np.array([v, u][: 2 - wall]), np.array([w, x][: 2 - wall])
            found["velocity"] = max(found["velocity"], float(np.abs(speeds - right[0]).max()))
            found["spin"] = max(found["spin"], float(np.abs(spins - right[1]).max()))
            for control, wrong in (("factor", {"factor": 1.0}), ("sign", {"sign": -1})):
                found[control] = max(found[control], float(np.abs(speeds[0] - after(*rules, **wrong)[0]).max()))
            for body, speed, spin, side in zip((case.one, case.two), speeds, spins, (1, -1), strict=False):
                arm, inertia = -side * body.radius * np.asarray(case.n), body.mass * body.radius**2 / 2
                about = body.mass * cross(arm, speed - body.velocity) + inertia * (spin - body.spin)
                found["angular"] = max(found["angular"], abs(about))
            if not case.two.velocity.any() or not wall:  # a piston does work
                masses, radii = case.scene.masses[: 2 - wall], case.scene.radii[: 2 - wall]
                before = energy(case.scene.velocity[: 2 - wall], case.scene.spin[: 2 - wall], masses, radii)
                found["rise"] = max(found["rise"], energy(speeds, spins, masses, radii) - before)
            sticks = after(case.one, case.two, case.n, math.inf, beta, case.restitution)
            found["stuck" if np.allclose(v, sticks[0], atol=1e-9) else "slid"] += 1
    return found


def rolling(how: str, dt: float = 1 / 64) -> dict[str, float]:
    """A disc that slides on the floor with mu = 1/4 under g = 2 from speed 1: while it slides, and when it rolls."""
    scene = Scene(
        width=20, height=4, position=[[1.0, 0.5]], velocity=[[1.0, 0.0]], radius=0.5, gravity=(0, -2),
        wall_restitution=0.0, wall_friction=0.25,
    )  # fmt: skip
    with mpsim.Simulation(scene, mpsim.Settings(dt=dt, **METHODS[how])) as sim:
        sim.run(until=0.5)
        early = sim.state
        sim.run(until=1.5)
        late = sim.state
        sim.run(until=2.0)
        end = sim.state
    assert early.spin is not None
    assert late.spin is not None
    return {
        "deceleration": float(2 * (1 - early.velocity[0, 0])),
        "spin-up": float(-2 * early.spin[0]),
        "place": float(early.position[0, 0] - 1.0),
        "speed": float(late.velocity[0, 0]),
        "slip": float(late.velocity[0, 0] + 0.5 * late.spin[0]),
        "change": float(np.abs(end.velocity - late.velocity).max()),
    }


def pyramid(friction: float) -> dict[str, float]:
    """Three discs of radius 1/2, one on two that touch, after a time of 8 under gravity 1: how wide and high."""
    places = [(4.5, 0.5), (5.5, 0.5), (5.0, 0.5 + math.sqrt(0.75))]
    scene = Scene(
        width=10, height=4, position=places, velocity=np.zeros((3, 2)), radius=0.5, gravity=(0, -1), restitution=0.3,
        wall_restitution=0.3, friction=friction, wall_friction=friction,
    )  # fmt: skip
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.02, method="naive", passes=4)) as sim:
        sim.run(until=8.0)
        x, y = sim.state.position.T
    return {"width": float(x[1] - x[0]), "height": float(y[2])}


# --- one contact


@pytest.mark.parametrize(
    ("name", "how"),
    [(name, how) for name in CASES for how in METHODS if (how == "naive") == (name == "pairs") or how == "event"],
)
def test_velocities_and_spins_after_a_contact_are_those_of_walton_and_braun(name, how):
    """Over all angles of impact, on both sides of tan = 3 mu (1 + e) / (1 + beta_0), where discs begin to slide."""
    case = misses(name, how)
    assert max(case["velocity"], case["spin"]) < 1e-12
    assert case["angular"] < 1e-13, "about the point of contact, of each disc"
    assert case["rise"] < 1e-14, "the energy"
    assert min(case["stuck"], case["slid"]) > 8, "both happen"
    assert min(case["factor"], case["sign"]) > 0.1, "the controls: a law without the factor 1/3, and of the wrong sign"


# --- a disc that slides until it rolls


@pytest.mark.parametrize("how", ["push", "impact", "naive"])
def test_a_sliding_disc_slows_down_by_mu_g_until_it_rolls_at_two_thirds_of_its_speed(how):
    roll = rolling(how)
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


def rough_gas(seed, beta, spin=None, restitution=1.0, count=30, **law):
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


@pytest.mark.parametrize(
    ("how", "beta", "restitution"),
    [("event", 1.0, 1.0), ("naive", 1.0, 1.0), ("event", 0.0, 0.9), ("event", -1.0, 1.0)],
)
def test_rotation_takes_energy_from_translation_at_the_known_rate(how, beta, restitution):
    ratios = []
    for seed in range(8):
        scene = rough_gas(seed, beta, restitution=restitution)
        with simulate(scene, dt=0.2, **METHODS[how]) as sim:
            collisions = sim.run(until=4.0).collisions
            translation, rotation = temperatures(sim.state, scene)
        expected = exchanged(beta, restitution, 2 * collisions / scene.count)
        start = temperatures(mpsim.State(scene.position, scene.velocity), scene)[0]
        ratios.append(np.array([translation, rotation]) / start - expected)
    mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0, ddof=1) / math.sqrt(8)
    if beta == -1:
        assert np.abs(ratios).max() < 1e-12, "smooth: nothing is exchanged"
        return
    assert expected[1] > 0.05
    assert (np.abs(mean) < 4 * error + 0.015).all(), f"{mean} +- {error}"  # the mean field is good to some percent


def test_perfectly_rough_discs_share_their_energy_evenly():
    """T_rot / T_tr = 1 for beta_0 = 1, whatever it was at the start: one degree of freedom of three rotates."""
    found = []
    for seed in range(4):
        scene = Scene.random(
            count=8, packing=0.3, radius=0.5, seed=seed, friction=math.inf, tangential_restitution=1.0,
            boundary="periodic", temperature=1.0, spin=6.0 * (seed % 2),
        )  # fmt: skip
        with simulate(scene, dt=0.5, method="event") as sim:
            energy = kinetic_energy(sim.state, scene)
            sim.run(until=5.0)
            ratios = []
            for _ in range(35):
                sim.run(frames=1)
                ratios.append(temperatures(sim.state, scene))
            assert kinetic_energy(sim.state, scene) == pytest.approx(energy, rel=1e-10)
        translation, rotation = np.mean(ratios, axis=0)
        found.append(rotation / translation)
    mean = independent_average(np.array(found))
    assert abs(mean.value - 1) < 4 * mean.error + 0.01, f"{mean}"
    assert mean.error < 0.2


def test_no_collision_of_a_gas_between_rough_walls_raises_the_energy():
    rough = {"friction": 0.3, "wall_friction": 0.6, "tangential_restitution": 0.5, "spin": 2.0}
    scene = Scene.random(count=20, packing=0.5, radius=0.5, seed=3, **rough)
    with simulate(scene, method="grid", dt=0.02, contact="impact") as sim:
        energies = [kinetic_energy(sim.state, scene)]
        for _ in range(100):
            sim.run(frames=1)
            energies.append(kinetic_energy(sim.state, scene))
    assert (np.diff(energies) <= 1e-12 * energies[0]).all()
    assert energies[-1] < 0.8 * energies[0]


# --- heaps


def test_a_pyramid_of_three_discs_stands_from_the_friction_on_that_statics_asks_for():
    """The upper disc pushes the lower ones apart along 30 degrees; they do not roll from mu = tan 15 = 0.268 on.

    There is no static friction in the law: the impulses of each step add up to it.
    """
    stands, falls = pyramid(0.3), pyramid(0.24)
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
