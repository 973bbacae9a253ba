"""Small scenes, and simulations of them."""

import inspect
import math
import warnings
from functools import cache
from typing import Any

import numpy as np

import mpsim


@cache
def gas(count: int, packing: float, seed: int = 0, **features: Any) -> mpsim.Scene:
    """Discs of radius 0.5 without overlap in a square box, at temperature 1."""
    return mpsim.Scene.random(count=count, packing=packing, radius=0.5, seed=seed, **features)


def crowd(count: int, packing: float, seed: int = 0, **features: Any) -> mpsim.Scene:
    """Discs of radius 0.5 dropped anywhere: many overlap, some deeply, so that every frame is full of contacts."""
    rng = np.random.default_rng(seed)
    side = max(math.sqrt(count * math.pi * 0.25 / packing), 1.5)
    position = 0.5 + rng.random((count, 2)) * (side - 1)
    velocity = rng.normal(size=(count, 2))
    return mpsim.Scene(width=side, height=side, position=position, velocity=velocity, radius=0.5, **features)


def lattice(columns: int, rows: int, pitch: float = 1.125) -> mpsim.Scene:
    """Discs of radius 0.5 in rows and columns, with velocities from integer arithmetic: the same on every machine.

    Made without random numbers and without transcendental functions, and quick at any size.
    """
    count = columns * rows
    index = np.arange(count, dtype=np.int64)
    position = np.stack([index // rows, index % rows], axis=1) * pitch + 0.5625
    draws = (np.arange(1, 2 * count + 1, dtype=np.uint64) * np.uint64(6364136223846793005)) >> np.uint64(44)
    velocity = (draws.astype(np.float64) / 2**19 - 1).reshape(count, 2) * 2
    width, height = columns * pitch, rows * pitch
    return mpsim.Scene(width=width, height=height, position=position, velocity=velocity, radius=0.5)


def exact_zoo() -> mpsim.Scene:
    """For the exact solver: discs that leave through an edge, obstacles, a piston, and rough discs with losses."""
    index = np.arange(24)
    place = np.stack([2 + 1.3 * (index % 6), 1.6 + 1.3 * (index // 6)], axis=1)
    velocity = np.stack([index % 7 - 3, index % 5 - 2], axis=1) * 1.5
    return mpsim.Scene(width=14, height=9, radius=0.5, position=place, velocity=velocity, absorbing="left",
                       obstacles=[mpsim.Polyline([[3, 7.6], [6, 8]], thickness=0.2), mpsim.FixedDisc((10.5, 3), 0.4)],
                       piston=mpsim.Piston("right", -0.3, 12.0), gravity=(0, -0.5), friction=0.3, restitution=0.95,
                       wall_restitution=0.95)  # fmt: skip


def zoo(words: str, count: int = 40, seed: int = 0, side: float = 8.0, **more: Any) -> mpsim.Scene:
    """Discs dropped anywhere in a square box with the features named in words, so that every frame is full of contacts.

    Words: gravity, acceleration, radii, giants, masses, lossy, rough, obstacles, absorbing, piston, emitters, heated
    (a thermostat and a thermal wall), and periodic (both axes), periodic-x or periodic-y.
    """
    chosen, rng = set(words.split()), np.random.default_rng(seed)
    radius: Any = 0.5
    if chosen & {"radii", "giants"}:
        radius = rng.choice([0.2, 0.35, 0.5], count)
        radius[: 2 if "giants" in chosen else 0] = 1.5
    periodic = ["periodic" if chosen & {"periodic", f"periodic-{axis}"} else "walls" for axis in "xy"]
    margin = np.multiply.outer(np.broadcast_to(radius, count), [word == "walls" for word in periodic])
    features: dict[str, Any] = {"gravity": (0.375, -2.0)} if "gravity" in chosen else {}
    if "acceleration" in chosen:
        index = np.arange(count)
        features["acceleration"] = np.stack([(index % 7 - 3) / 2, (index % 5 - 2) / 4], axis=1)
    if "masses" in chosen:
        features["mass"] = rng.choice([0.5, 1.0, 3.0], count)
    if "lossy" in chosen:
        features |= {"restitution": 0.75, "wall_restitution": 0.5}
    if "rough" in chosen:
        features |= {
            "friction": 0.5,
            "wall_friction": 0.25,
            "tangential_restitution": 0.5,
            "spin": np.random.default_rng([seed, 1]).normal(size=count),
        }
    if "obstacles" in chosen:
        low, peg = side / 4, mpsim.FixedDisc((0.7 * side, 0.7 * side), 0.4)
        features["obstacles"] = [
            mpsim.Polyline([(0, low), (low, low / 2), (low, 0)]),
            peg,
            mpsim.FixedDisc((0, 5), 0.1),
        ]
    if "absorbing" in chosen:
        features["absorbing"] = [
            edge for edge, word in (("right", periodic[0]), ("bottom", periodic[1])) if word == "walls"
        ]
    if "piston" in chosen:
        features["piston"] = mpsim.Piston("top", -1.5, 0.8 * side)
    if "heated" in chosen:
        features |= {"thermostat": mpsim.Thermostat(1.0, 5.0), "thermal_walls": mpsim.ThermalWalls(left=2.0)}
    if "emitters" in chosen:
        sizes = {"radius": 0.3} if chosen & {"radii", "giants"} else {}
        kinds = {"mass": 2.0} if "masses" in chosen else {}
        features["emitters"] = [
            mpsim.Emitter((1.0, side - 2), (1.0, -0.5), every=3, **sizes, **kinds),
            mpsim.Emitter((side / 2, side / 2), (0.0, 2.0), every=2, limit=2, **sizes, **kinds),
            mpsim.Emitter((0.75 * side, 0.3 * side), (1.5, 1.0), interval=0.12, **sizes, **kinds),
        ]
    position = margin + rng.random((count, 2)) * (side - 2 * margin)
    features |= {"width": side, "height": side, "velocity": 2 * rng.normal(size=(count, 2)), **more}
    return mpsim.Scene(position=position, radius=radius, boundary=periodic, **features)


ZOO = {
    "radii": "radii",
    "giants": "giants",
    "masses": "masses",
    "periodic": "periodic",
    "periodic x": "periodic-x",
    "periodic y": "periodic-y giants",
    "obstacles": "obstacles lossy",
    "obstacles and gravity": "obstacles gravity",
    "absorbing": "absorbing",
    "absorbing and gravity": "absorbing gravity",
    "piston": "piston lossy",
    "piston and gravity": "piston gravity",
    "emitters": "emitters",
    "periodic obstacles": "periodic obstacles radii gravity acceleration",
    "everything": "gravity acceleration giants masses lossy obstacles absorbing piston emitters periodic-x",
    "rough": "rough lossy",
    "rough and gravity": "rough radii masses gravity obstacles piston periodic-x",
    "everything rough": "rough gravity acceleration giants masses lossy obstacles absorbing piston emitters periodic-x",
}
"""Features alone and together, by name: words for `zoo`."""


def struck(**features: Any) -> mpsim.Scene:
    """Light discs at rest, into which heavy ones fly: some become ten times as fast for their size in one frame."""
    places = [[2.0 + 3 * i, 2.0 + 3 * j] for i in range(4) for j in range(3)]
    light = [[7.0 + 0.7 * i, 0.6 + 0.7 * j] for i in range(8) for j in range(12)]
    light = [place for place in light if min(np.hypot(*np.subtract(place, other)) for other in places) > 0.8]
    velocity = np.concatenate([[[4.0 + 0.5 * k, 1.0 - 0.25 * k] for k in range(12)], np.zeros((len(light), 2))])
    sizes = np.array([0.5] * 12 + [0.15] * len(light))
    return mpsim.Scene(
        width=14, height=10, position=places + light, velocity=velocity, radius=sizes, mass=(2 * sizes) ** 4, **features
    )


ALONE = {"naive": "naive", "grid": "grid", "parallel": "grid", "event": "event"}
"""For each method one of a single process that gives the same bits."""


OF_PROCESSES = inspect.signature(mpsim.Simulation).parameters.keys() - {"scene", "settings"}


def split(given: dict[str, Any]) -> dict[str, Any]:
    """Arguments of a simulation: those of its settings together, those of its processes by name."""
    settings = {name: value for name, value in given.items() if name not in OF_PROCESSES}
    return {"settings": mpsim.Settings(**settings)} | {name: given[name] for name in OF_PROCESSES if name in given}


def simulate(scene: mpsim.Scene, **settings: Any) -> mpsim.Simulation:
    """A simulation, without the warnings about its start: overlaps, fast discs, lost digits.

    Its contact is `push` unless told otherwise: most numbers of these tests were worked by hand, and push is easier.
    """
    with warnings.catch_warnings():
        for kind in (mpsim.OverlapWarning, mpsim.FastWarning, mpsim.errors.ResolutionWarning):
            warnings.simplefilter("ignore", kind)
        return mpsim.Simulation(scene, **split({"contact": "push", **settings}))


class At:
    """An observer that acts in one frame of a run."""

    every = 1

    def __init__(self, frame, act):
        self.frame, self.act = frame, act

    def observe(self, sim, collisions):
        if sim.frame == self.frame:
            self.act(sim)


def digest_after(scene: mpsim.Scene, frames: int, **settings: Any) -> str:
    """Digest of the state after so many frames."""
    with simulate(scene, **settings) as sim:
        sim.run(frames=frames)
        return sim.digest()


def state_after(scene: mpsim.Scene, frames: int, **settings: Any) -> mpsim.State:
    """State after so many frames."""
    with simulate(scene, **settings) as sim:
        sim.run(frames=frames)
        return sim.state


def pair(speed=1.0, apart=2.0, side=20.0, **more):
    """Two discs that approach each other head-on."""
    middle = side / 2
    places = [[middle - apart / 2, middle], [middle + apart / 2, middle]]
    box = {"width": side, "height": side, "radius": 0.5}
    return mpsim.Scene(position=places, velocity=[[speed, 0], [-speed, 0]], **{**box, **more})


# --- a few discs whose measures are known


def scene_of(position, velocity=None, width=20.0, height=20.0, radius=0.5, **features):
    velocity = np.zeros((len(position), 2)) if velocity is None else velocity
    return mpsim.Scene(width=width, height=height, position=position, velocity=velocity, radius=radius, **features)


def state_of(scene, precision="float64"):
    return mpsim.State(scene.position.astype(precision), scene.velocity.astype(precision))


def drop(count, side, seed, radius=0.5):
    """An ideal gas: centres anywhere, overlapping or not."""
    places = radius + np.random.default_rng(seed).random((count, 2)) * (side - 2 * radius)
    return scene_of(places, None, side, side, radius)


def box_of(**features):
    """Discs of radius 1/2 in a box of 10 x 8."""
    return mpsim.Scene(**{"width": 10, "height": 8, "radius": 0.5, **features})


def exactly(scene, dt=1.0):
    return simulate(scene, method="event", dt=dt)


def after(scene, until, **settings):
    with simulate(scene, **{"method": "naive", "contact": "impact", "dt": 0.01, **settings}) as sim:
        sim.run(until=until)
        return sim.state
