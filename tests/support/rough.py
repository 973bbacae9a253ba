"""Contacts of rough discs against closed forms, in plain Python, which needs no compilation for each feature.

python -m support.rough        the largest misses of each case, as JSON
"""

import itertools
import json
import math
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

import mpsim
from mpsim import FixedDisc, Piston, Polyline, Scene

METHODS = {
    "push": {"method": "grid", "contact": "push"},
    "impact": {"method": "grid", "contact": "impact"},
    "naive": {"method": "naive", "contact": "impact"},
    "event": {"method": "event"},
}
LAWS = [(0.0, 0.5), (0.1, 0.0), (0.3, 0.4), (math.inf, 1.0), (math.inf, 0.0), (0.5, -0.5)]
"""Friction and tangential restitution."""

RESTITUTION = 0.8
LATE = 0.05
"""Of a frame, since the contact when a frame ends: so little that a grazing one is not over by then."""

ANGLES = np.radians(np.arange(-85, 86, 12))
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
    """Three discs of radius 1/2, one on two that touch, after a time of 10 under gravity 1: how wide and high."""
    places = [(4.5, 0.5), (5.5, 0.5), (5.0, 0.5 + math.sqrt(0.75))]
    scene = Scene(
        width=10, height=4, position=places, velocity=np.zeros((3, 2)), radius=0.5, gravity=(0, -1), restitution=0.3,
        wall_restitution=0.3, friction=friction, wall_friction=friction,
    )  # fmt: skip
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.01, method="naive", passes=4)) as sim:
        sim.run(until=10.0)
        x, y = sim.state.position.T
    return {"width": float(x[1] - x[0]), "height": float(y[2])}


def main() -> None:
    """Print all."""
    out = {f"{name} by {how}": misses(name, how) for name, how in itertools.product(CASES, METHODS)}
    rolls = {f"rolling by {how}": rolling(how) for how in METHODS if how != "event"}
    pyramids = {f"pyramid with {friction}": pyramid(friction) for friction in (0.24, 0.3)}
    json.dump(out | rolls | pyramids, sys.stdout)


if __name__ == "__main__":
    main()
