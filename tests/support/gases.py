"""Random gases with random features, from one number each: scenes that the exact solver does too."""

from typing import Any

import numpy as np

import mpsim
from mpsim.features.capsules import distance
from mpsim.features.edges import EDGES
from support.transforms import features_of


def any_gas(
    seed: int, *, gravity: bool = True, losses: bool = True, friction: bool = True, wrap: float = 0.3
) -> mpsim.Scene:
    """Up to 24 discs without overlap, dilute to dense, some with radii, masses, fields, losses, friction, borders.

    With the probability `wrap` an axis is periodic. Coordinates are multiples of 2^-20, and so is the box: a mirror
    image has no rounding.
    """
    rng = np.random.default_rng([seed, 77])
    chance = lambda part=0.4: rng.random() < part  # noqa: E731
    count = int(rng.choice([1, 2, 6, 15, 24]))
    radius: Any = rng.choice([0.5, 0.34375, 0.1875], count) if chance() else 0.5
    features: dict[str, Any] = {}
    if chance():
        features["mass"] = rng.choice([0.25, 1.0, 4.0], count)
    if gravity and chance():
        features["gravity"] = rng.choice([0.0, -1.0, 0.5], 2)
    if losses and chance():
        # Not much under gravity, under which discs would come to rest on one another: millions of events.
        falls = "gravity" in features
        features["restitution"] = 0.95 if falls else rng.choice([0.5, 0.9])
        features["wall_restitution"] = 1.0 if falls else rng.choice([0.5, 0.9, 1.0])
    if losses and friction:
        features |= any_friction(np.random.default_rng([seed, 80]), count)
    boundary = ["periodic" if wrap and chance(wrap) else "walls" for _ in "xy"]
    area = np.pi * float((np.broadcast_to(radius, count) ** 2).sum())
    side = max(float(np.sqrt(area / rng.choice([0.02, 0.15, 0.4, 0.6]))), 2.5)
    width, height = (np.ceil(side * stretch * 64) / 64 for stretch in rng.choice([(1, 1), (2, 0.5), (1.25, 0.8)]))
    width, height = max(width, 2.5), max(height, 2.5)
    roomy = np.multiply(radius, 1 + 1e-4)  # so that rounding lets none overlap
    seeded = mpsim.Scene.random(
        count=count, width=width, height=height, radius=roomy, seed=seed, boundary=boundary, **features
    )
    places = np.round(seeded.position * 2**20) / 2**20
    return mpsim.Scene(**features_of(seeded) | {"radius": radius, "position": places})


def any_friction(rng: Any, count: int) -> dict[str, Any]:
    """Rough discs, rough walls or both, in a third of the scenes."""
    if rng.random() > 1 / 3:
        return {}
    features: dict[str, Any] = {"tangential_restitution": rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0])}
    for name in ("friction", "wall_friction"):
        features[name] = rng.choice([0.0, 0.25, 3.0, np.inf])
    if rng.random() < 0.7:
        features["spin"] = rng.normal(size=count)
    return features


def any_room(seed: int, *, stepped: bool) -> mpsim.Scene:
    """Such a gas with an emitter and, for stepped methods, an absorbing edge, obstacles and a piston: some of them."""
    scene, rng = any_gas(seed), np.random.default_rng([seed, 78])
    size, binary = np.array([scene.width, scene.height]), lambda value: np.round(value * 2**20) / 2**20
    unit = float(binary(np.abs(scene.velocity).max()))
    inside = lambda: binary(size * rng.uniform(0.25, 0.75, 2))  # noqa: E731
    walls = [edge for k, edge in enumerate(EDGES) if not scene.periodic[k // 2]]
    rng.shuffle(walls)
    features: dict[str, Any] = {}
    if stepped and walls and rng.random() < 0.4:
        features["absorbing"] = [walls.pop()]
    if rng.random() < 0.4:
        kind = {"radius": 0.25, "mass": 2.0} if scene.mass is not None else {"radius": 0.25}
        pace = {"interval": float(rng.choice([0.25, 0.5, 1.0])) * typical_time(scene), "limit": 3}
        features["emitters"] = mpsim.Emitter(inside(), binary(unit * rng.uniform(-0.5, 0.5, 2)), **pace, **kind)
    if stepped and rng.random() < 0.5:
        chain = mpsim.Polyline([inside() for _ in range(rng.integers(2, 4))], float(rng.choice([0.0, 0.125])))
        features["obstacles"] = [mpsim.FixedDisc(inside(), 0.125), chain]
    if stepped and walls and rng.random() < 0.5:
        axis, high = divmod(EDGES.index(walls[0]), 2)
        stop = float(binary(size[axis] * (0.8 if high else 0.2)))
        features["piston"] = mpsim.Piston(walls[0], (-0.5 if high else 0.5) * unit, stop)
    capsules = [part for obstacle in features.get("obstacles", []) for part in obstacle.capsules()]
    gaps = distance(scene.position[:, None], np.reshape(capsules, (-1, 5))).min(axis=1, initial=np.inf)
    others = features_of(without(scene, gaps <= scene.radii))
    for left_out in ((), ("emitters",), ("piston",), ("emitters", "piston")):  # where there is no room for them
        kept = {name: value for name, value in features.items() if name not in left_out}
        try:
            return mpsim.Scene(**others | kept)
        except mpsim.InputError:
            continue
    raise AssertionError(f"room {seed}: not even a gas")


def without(scene: mpsim.Scene, gone: np.ndarray) -> mpsim.Scene:
    """The scene without some of its discs."""
    features = features_of(scene)
    for name in ("position", "velocity", "radius", "mass", "spin"):
        if np.ndim(features.get(name)):
            features[name] = features[name][~gone]
    return mpsim.Scene(**features)


def typical_time(scene: mpsim.Scene) -> float:
    """A time in which a disc of thermal speed moves one mean distance between discs [time]."""
    speed = float(np.sqrt((scene.velocity**2).sum(axis=1).mean())) or 1.0
    return float(np.sqrt(scene.width * scene.height / scene.count)) / speed
