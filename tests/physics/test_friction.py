"""Friction and spin against closed forms: single contacts, a disc that comes to roll, gases of rough discs, heaps."""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from support.scenes import scene_of, simulate, state_after

import mpsim
from mpsim import Scene
from mpsim.measure import kinetic_energy, rotational_energy

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]

METHODS = {
    "push": {"method": "grid", "contact": "push"},
    "impact": {"method": "grid", "contact": "impact"},
    "naive": {"method": "naive", "contact": "impact"},
    "event": {"method": "event"},
}
LAWS = [(0.1, 0.0), (0.3, 0.4), (math.inf, 1.0), (0.5, -0.5)]  # friction and tangential restitution

E, DT = 0.8, 0.25
LATE = 0.05  # of a frame, since the contact when a frame ends: so little that a grazing one is not over by then

ANGLES = np.radians(np.arange(-85, 86, 34))
"""Between the velocity at impact, relative to what is met, and the normal."""


class Body(NamedTuple):
    """A disc, or with an infinite mass what does not turn."""

    velocity: Any
    spin: float
    mass: float
    radius: float

    def kicked(self, arm, impulse):
        """Velocity and spin after an impulse at a point relative to the centre; of a disc."""
        turned = (arm[0] * impulse[1] - arm[1] * impulse[0]) / (self.mass * self.radius**2 / 2)
        return self.velocity + impulse / self.mass, self.spin + turned

    def energy(self, velocity, spin):
        return self.mass * (velocity @ velocity + (self.radius * spin) ** 2 / 2) / 2


WALL = Body(np.zeros(2), 0.0, math.inf, 1.0)


def after(one, two, n, friction, beta, factor=1 / 3, sign=1):
    """Velocity and spin of each disc after they touch along the unit vector n from one to two.

    Written with the velocities of the two points that touch and the moments of the impulse about the centres. A wrong
    factor or sign makes it a control.
    """
    left = np.array([-n[1], n[0]])
    slip = (one.velocity + one.spin * one.radius * left) - (two.velocity - two.spin * two.radius * left)
    inverse = 1 / one.mass + 1 / two.mass
    normal = -(1 + E) * (slip @ n) / inverse  # impulse on `one` along n, < 0
    tangential = -(1 + beta) * factor * (slip @ left) / inverse
    tangential = sign * math.copysign(min(abs(tangential), friction * abs(normal)), tangential)
    impulse = normal * n + tangential * left
    found = [one.kicked(one.radius * n, impulse)]
    return found if two is WALL else [*found, two.kicked(-two.radius * n, -impulse)]


def contacts(name, friction, beta):
    """Scenes of one contact, from all angles: scene, the two bodies, the direction between them, and frames."""
    law = {"friction": friction, "wall_friction": friction, "tangential_restitution": beta, "restitution": E}
    for number, angle in enumerate(ANGLES):
        for wall in (number % 4, (number + 1) % 4) if name == "walls" else ():
            n = np.array([(-1.0, 0), (1, 0), (0, -1), (0, 1)][wall])
            one = Body(1.5 * (math.cos(angle) * n + math.sin(angle) * np.array([-n[1], n[0]])), -0.8, 1.0, 0.5)
            scene = Scene(
                width=10, height=10, position=[5 + n * 4.5 - one.velocity * DT * 1.3], velocity=[one.velocity],
                radius=0.5, spin=one.spin, wall_restitution=E, **law,
            )  # fmt: skip
            yield scene, one, WALL, n, 3
        if name == "pairs":
            n, line = (np.array([math.cos(turn + 0.3), math.sin(turn + 0.3)]) for turn in (angle / 2, 3 * angle / 2))
            drift = np.array([0.25, -0.125])
            one, two = Body(drift + 1.5 * line, 0.7, 1.0, 0.5), Body(drift, -1.1, 3.0, 0.75)
            places = [8 - one.velocity * DT * (2 - LATE), 8 + 1.25 * n - two.velocity * DT * (2 - LATE)]
            scene = Scene(
                width=20, height=20, position=places, velocity=[one.velocity, two.velocity], radius=[0.5, 0.75],
                mass=[1.0, 3.0], spin=[0.7, -1.1], **law,
            )  # fmt: skip
            yield scene, one, two, n, 2


# --- one contact


@pytest.mark.parametrize(
    ("name", "how"),
    [("walls", "push"), ("walls", "impact"), ("walls", "event"), ("pairs", "naive"), ("pairs", "event")],
)
def test_velocities_and_spins_after_a_contact_are_those_of_walton_and_braun(name, how):
    """Over all angles of impact, on both sides of tan = 3 mu (1 + e) / (1 + beta_0), where discs begin to slide."""
    worst, controls, stuck = 0.0, np.zeros(2), []
    for friction, beta in LAWS:
        for scene, one, two, n, frames in contacts(name, friction, beta):
            state = state_after(scene, frames, dt=DT, **METHODS[how])
            found = list(zip(state.velocity, state.spin, strict=True))
            expected, sticks = after(one, two, n, friction, beta), after(one, two, n, math.inf, beta)
            wrong = [after(one, two, n, friction, beta, **each) for each in ({"factor": 1.0}, {"sign": -1})]
            worst = max(
                worst, *(np.abs(np.hstack(a) - np.hstack(b)).max() for a, b in zip(found, expected, strict=True))
            )
            controls = np.maximum(controls, [np.abs(found[0][0] - each[0][0]).max() for each in wrong])
            stuck.append(np.allclose(expected[0][0], sticks[0][0], atol=1e-9))
            rise = sum(body.energy(*now) - body.energy(*body[:2]) for body, now in zip((one, two), found, strict=False))
            assert rise < 1e-14
    assert worst < 1e-12
    assert min(sum(stuck), len(stuck) - sum(stuck)) > 5, "both happen"
    assert controls.min() > 0.1, "the controls: a law without the factor 1/3, and of the wrong sign"


# --- a disc that slides until it rolls


@pytest.mark.parametrize("how", ["push", "impact", pytest.param("event", marks=pytest.mark.long)])
@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
def test_a_sliding_disc_slows_down_by_mu_g_until_it_rolls_at_two_thirds_of_its_speed(how):
    """mu = 1/4, g = 2, from speed 1. By the exact solver it hovers in bounces of the guard's time."""
    scene = scene_of([[1.0, 0.5]], [[1.0, 0.0]], 20, 4, gravity=(0, -2), wall_restitution=0.0, wall_friction=0.25)
    states, rel = [], 1e-4 if how == "event" else 1e-12
    with simulate(scene, dt=1 / 64, **METHODS[how]) as sim:
        for until in (0.5, 1.5, 2.0):
            sim.run(until=until)
            states.append(sim.state)
    early, late, end = states
    assert early.velocity[0, 0] == pytest.approx(0.75, rel=rel), "1 - mu g t"
    assert early.spin[0] == pytest.approx(-1.0, rel=rel), "2 mu g t / R"
    exact = 0.5 - 0.5 * 0.5 * 0.5**2
    assert early.position[0, 0] - 1 == pytest.approx(exact, rel=rel if how != "push" else 0.01), "v t - mu g t^2 / 2"
    assert late.velocity[0, 0] == pytest.approx(2 / 3, rel=rel)
    assert late.velocity[0, 0] + 0.5 * late.spin[0] == pytest.approx(0, abs=rel)
    assert np.abs(end.velocity - late.velocity)[0, 0] < rel, "it rolls on"


# --- gases


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
    ("how", "beta", "restitution"), [("naive", 1.0, 1.0), ("event", 0.0, 0.9), ("event", -1.0, 1.0)]
)
def test_rotation_takes_energy_from_translation_at_the_known_rate(how, beta, restitution):
    ratios = []
    for seed in range(8 if beta > -1 else 1):
        scene = Scene.random(
            count=24, packing=0.05, radius=0.5, seed=seed, friction=math.inf, tangential_restitution=beta,
            restitution=restitution, boundary="periodic",
        )  # fmt: skip
        with simulate(scene, dt=0.2, **METHODS[how]) as sim:
            collisions = sim.run(until=4.0).collisions
            translation, rotation = temperatures(sim.state, scene)
        expected = exchanged(beta, restitution, 2 * collisions / scene.count)
        start = temperatures(mpsim.State(scene.position, scene.velocity), scene)[0]
        ratios.append(np.array([translation, rotation]) / start - expected)
    if beta == -1:
        assert np.abs(ratios).max() < 1e-12, "smooth: nothing is exchanged"
        return
    mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0, ddof=1) / math.sqrt(8)
    assert expected[1] > 0.05
    assert (np.abs(mean) < 4 * error + 0.015).all(), f"{mean} +- {error}"  # the mean field is good to some percent


def test_no_collision_of_a_gas_between_rough_walls_raises_the_energy():
    rough = {"friction": 0.3, "wall_friction": 0.6, "tangential_restitution": 0.5, "spin": 2.0}
    scene = Scene.random(count=16, packing=0.5, radius=0.5, seed=3, **rough)
    with simulate(scene, method="grid", dt=0.02, contact="impact") as sim:
        energies = [kinetic_energy(sim.state, scene)]
        for _ in range(80):
            sim.run(frames=1)
            energies.append(kinetic_energy(sim.state, scene))
    assert (np.diff(energies) <= 1e-12 * energies[0]).all()
    assert energies[-1] < 0.85 * energies[0]


# --- heaps


@pytest.mark.slow
def test_a_pyramid_of_three_discs_stands_from_the_friction_on_that_statics_asks_for():
    """The upper disc pushes the lower ones apart along 30 degrees; they do not roll from mu = tan 15 = 0.268 on.

    There is no static friction in the law: the impulses of each step add up to it.
    """
    for friction, stands in ((0.3, True), (0.24, False)):
        places = [(4.5, 0.5), (5.5, 0.5), (5.0, 0.5 + math.sqrt(0.75))]
        scene = Scene(
            width=10, height=4, position=places, velocity=np.zeros((3, 2)), radius=0.5, gravity=(0, -1),
            restitution=0.3, wall_restitution=0.3, friction=friction, wall_friction=friction,
        )  # fmt: skip
        with simulate(scene, dt=0.025, method="naive", contact="impact", passes=4) as sim:
            sim.run(until=8.0)
            x, y = sim.state.position.T
        assert x[1] - x[0] < 1.05 if stands else x[1] - x[0] > 2
        assert y[2] == pytest.approx(0.5 + math.sqrt(0.75) * stands, abs=0.02)
