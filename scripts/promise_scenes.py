"""Thirty generated scenes for run_promise.py: all features, alone and combined, dense and dilute."""

from collections.abc import Callable
from typing import Any

import numpy as np

import mpsim
from mpsim import Emitter, FixedDisc, Piston, Polyline, Scene


def _gas(number: int, count: int, packing: float, duration: float = 40.0, **others: Any) -> Scene:
    given: dict[str, Any] = {"radius": 0.5, "temperature": 1.0} | others
    return Scene.random(count=count, packing=packing, seed=number, duration=duration, **given)


def _boxed(number: int, count: int, width: float, height: float, duration: float = 40.0, **others: Any) -> Scene:
    given: dict[str, Any] = {"radius": 0.5, "temperature": 1.0} | others
    return Scene.random(count=count, width=width, height=height, seed=number, duration=duration, **given)


def _with_velocity(scene: Scene, velocity: np.ndarray) -> Scene:
    return scene.starting_from(mpsim.State(scene.position, velocity))


def _one_fast(number: int) -> Scene:
    """One disc at 20 times the speed of the others."""
    scene = _gas(number, 60, 0.3)
    velocity = scene.velocity.copy()
    velocity[0] *= 20 / max(float(np.hypot(*velocity[0])), 1e-9)
    return _with_velocity(scene, velocity)


def _hot_and_cold(number: int) -> Scene:
    """Heavy discs at rest among light hot ones."""
    masses = np.array([9.0] * 20 + [1.0] * 60)
    scene = _gas(number, 80, 0.3, mass=masses)
    velocity = scene.velocity.copy()
    velocity[:20] = 0
    return _with_velocity(scene, velocity)


def _stream(number: int) -> Scene:
    """Two halves that run into each other."""
    scene = _gas(number, 80, 0.25, temperature=0.1)
    velocity = scene.velocity.copy()
    velocity[:, 0] += np.where(scene.position[:, 0] < scene.width / 2, 1.0, -1.0)
    return _with_velocity(scene, velocity)


SIZES = np.linspace(0.2, 0.6, 80).tolist()
GIANT = [3.0] + [0.3] * 99
FUNNEL = (Polyline([(0.5, 9.0), (4.0, 6.0)], 0.2), Polyline([(11.5, 9.0), (8.0, 6.0)], 0.2))
PEGS = tuple(FixedDisc((3.0 * k, 4.0 + 3.0 * (k % 2)), 0.4) for k in range(1, 4))
SPOUT = Emitter((2.0, 9.0), (1.5, 0.3), interval=0.5, limit=40, radius=0.4)

CASES: dict[str, Callable[[int], Scene]] = {
    "dilute": lambda k: _gas(k, 40, 0.02, 200.0),
    "thin": lambda k: _gas(k, 80, 0.1),
    "medium": lambda k: _gas(k, 80, 0.3),
    "fluid": lambda k: _gas(k, 80, 0.5),
    "crowded": lambda k: _gas(k, 80, 0.65, 20.0),
    "crystal": lambda k: _gas(k, 80, 0.75, 20.0),
    "periodic": lambda k: _gas(k, 80, 0.3, boundary="periodic"),
    "mixed borders": lambda k: _gas(k, 80, 0.3, boundary=("periodic", "walls")),
    "periodic, crowded": lambda k: _gas(k, 80, 0.65, 20.0, boundary="periodic"),
    "radii": lambda k: _gas(k, 80, 0.4, radius=SIZES),
    "a giant": lambda k: _gas(k, 100, 0.3, radius=GIANT),
    "masses": lambda k: _gas(k, 80, 0.3, mass=np.geomspace(1, 20, 80)),
    "radii and masses, periodic": lambda k: _gas(
        k, 80, 0.3, radius=SIZES, mass=np.geomspace(1, 8, 80), boundary="periodic"
    ),
    "hot and cold": _hot_and_cold,
    "two streams": _stream,
    "one fast": _one_fast,
    "losses": lambda k: _gas(k, 80, 0.3, restitution=0.9),
    "losses at walls": lambda k: _gas(k, 80, 0.3, wall_restitution=0.8),
    "losses, periodic": lambda k: _gas(k, 80, 0.4, restitution=0.8, boundary="periodic"),
    "gravity": lambda k: _gas(k, 80, 0.3, gravity=(0.0, -0.5)),
    "gravity along a periodic axis": lambda k: _gas(
        k, 80, 0.2, 10.0, gravity=(0.3, 0.0), boundary=("periodic", "walls")
    ),
    "falls from rest": lambda k: _boxed(k, 60, 12.0, 16.0, 20.0, temperature=0.0, gravity=(0.0, -2.0)),
    "heap": lambda k: _boxed(
        k, 60, 10.0, 20.0, 20.0, temperature=0.0, gravity=(0.0, -5.0), restitution=0.5, wall_restitution=0.5
    ),
    "acceleration": lambda k: _gas(k, 60, 0.3, acceleration=np.tile([[0.2, -0.2]], (60, 1))),
    "pegs": lambda k: _boxed(k, 50, 12.0, 12.0, obstacles=PEGS),
    "funnel": lambda k: _boxed(k, 50, 12.0, 20.0, 30.0, obstacles=FUNNEL, gravity=(0.0, -1.0), restitution=0.9),
    "slow piston": lambda k: _boxed(k, 60, 16.0, 10.0, 60.0, piston=Piston("right", -0.1, 10.0)),
    "emitters": lambda k: _boxed(k, 20, 14.0, 12.0, 40.0, radius=0.4, emitters=[SPOUT]),
    "absorbing": lambda k: _boxed(k, 80, 14.0, 14.0, 20.0, absorbing="right"),
    "all together": lambda k: _boxed(
        k,
        40,
        14.0,
        14.0,
        20.0,
        radius=0.4,
        boundary=("periodic", "walls"),
        gravity=(0.0, -0.5),
        restitution=0.9,
        obstacles=[FixedDisc((7.0, 5.0), 1.0)],
        emitters=[SPOUT],
        absorbing="bottom",
    ),
}
"""How the starts of each scene are made from a number."""

BY_COLLISIONS = {
    "a giant",
    "radii and masses, periodic",
    "hot and cold",
    "losses",
    "losses, periodic",
    "gravity along a periodic axis",
    "slow piston",
}
"""Scenes of which the error of the collision rate is asked for; of the others it is that of the pressure."""
