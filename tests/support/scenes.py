"""Small scenes, and simulations of them."""

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


FEATURED = [("float64", "gravity"), ("float32", "acceleration"), ("float64", "gravity and acceleration")]
"""Precision and features of the scenes that have any: each combination is a compilation of its own, some seconds."""


def features_of(words: str, count: int) -> dict[str, Any]:
    """Arguments of a scene of so many discs for features named in words; "" for none.

    Accelerations are of both signs, different from disc to disc, and exact binary values.
    """
    index = np.arange(count)
    values = {
        "gravity": (0.375, -2.0),
        "acceleration": np.stack([(index % 7 - 3) / 2, (index % 5 - 2) / 4], axis=1),
    }
    return {name: value for name, value in values.items() if name in words}


def simulate(scene: mpsim.Scene, **settings: Any) -> mpsim.Simulation:
    """A simulation, without the warning that discs of the start overlap.

    Its contact is `push` unless told otherwise: most numbers of these tests were worked by hand, and push is easier.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.OverlapWarning)
        return mpsim.Simulation(scene, mpsim.Settings(**{"contact": "push", **settings}))


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
