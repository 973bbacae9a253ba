"""Random gases with random features, from one number each: scenes that the exact solver does too."""

from typing import Any

import numpy as np

import mpsim
from support.transforms import features_of


def any_gas(seed: int, *, friction: bool = True, wrap: float = 0.3) -> mpsim.Scene:
    """Up to 24 discs without overlap, dilute to dense, some with radii, masses, fields, losses, friction, borders.

    With the probability `wrap` an axis is periodic. Coordinates are multiples of 2^-20.
    """
    rng = np.random.default_rng([seed, 77])
    chance = lambda part=0.4: rng.random() < part  # noqa: E731
    count = int(rng.choice([1, 2, 6, 15, 24]))
    radius: Any = rng.choice([0.5, 0.34375, 0.1875], count) if chance() else 0.5
    features: dict[str, Any] = {}
    if chance():
        features["mass"] = rng.choice([0.25, 1.0, 4.0], count)
    if chance():
        features["gravity"] = rng.choice([0.0, -1.0, 0.5], 2)
    if chance():
        # Not much under gravity, under which discs would come to rest on one another: millions of events.
        falls = "gravity" in features
        features["restitution"] = 0.95 if falls else rng.choice([0.5, 0.9])
        features["wall_restitution"] = 1.0 if falls else rng.choice([0.5, 0.9, 1.0])
    if friction:
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


def typical_time(scene: mpsim.Scene) -> float:
    """A time in which a disc of thermal speed moves one mean distance between discs [time]."""
    speed = float(np.sqrt((scene.velocity**2).sum(axis=1).mean())) or 1.0
    return float(np.sqrt(scene.width * scene.height / scene.count)) / speed
