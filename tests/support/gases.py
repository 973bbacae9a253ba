"""Random gases with random features, from one number each: scenes that the exact solver does too."""

from typing import Any

import numpy as np

import mpsim
from support.transforms import features_of


def any_gas(seed: int, *, gravity: bool = True, losses: bool = True, wrap: bool = True) -> mpsim.Scene:
    """Up to 24 discs without overlap, dilute to dense, some with radii, masses, gravity, losses, periodic axes.

    Coordinates are multiples of 2^-20, and so is the box: a mirror image has no rounding.
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
    boundary = ["periodic" if wrap and chance(0.3) else "walls" for _ in "xy"]
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


def typical_time(scene: mpsim.Scene) -> float:
    """A time in which a disc of thermal speed moves one mean distance between discs [time]."""
    speed = float(np.sqrt((scene.velocity**2).sum(axis=1).mean())) or 1.0
    return float(np.sqrt(scene.width * scene.height / scene.count)) / speed
