"""Scenes of more discs than are read at a time, and all that can be measured of them, to the last bit."""

import numpy as np

import mpsim
from mpsim.core.columns import CHUNK
from mpsim.measure.registry import NAMES, refusal


def bare() -> mpsim.Scene:
    """A gas between walls, a little more than a chunk."""
    return mpsim.Scene.lattice(count=CHUNK + 3000, packing=0.4, radius=0.5, seed=3)


def torus() -> mpsim.Scene:
    """Rough discs of several masses between periodic borders, which drift."""
    start, rng = mpsim.Scene.lattice(count=CHUNK + 1000, packing=0.4, radius=0.5, seed=4), np.random.default_rng(4)
    return mpsim.Scene(
        width=start.width,
        height=start.height,
        position=start.position,
        velocity=start.velocity + np.array([0.3, -0.1]),
        radius=0.5,
        mass=rng.choice([0.5, 1.0, 3.0], start.count),
        spin=rng.normal(size=start.count),
        friction=0.5,
        boundary="periodic",
    )


def falling() -> mpsim.Scene:
    """Discs of several masses under gravity and accelerations of their own."""
    start, rng = mpsim.Scene.lattice(count=CHUNK + 2000, packing=0.3, radius=0.5, seed=5), np.random.default_rng(5)
    return mpsim.Scene(
        width=start.width,
        height=start.height,
        position=start.position,
        velocity=start.velocity,
        radius=0.5,
        mass=rng.choice([0.5, 1.0, 3.0], start.count),
        gravity=(0.001, -0.005),
        acceleration=0.005 * rng.normal(size=(start.count, 2)),
    )


LARGE = {"bare": bare, "torus": torus, "falling": falling}
"""By name; made when they are asked for."""


def measures_of(scene: mpsim.Scene) -> list[str]:
    """Names of all measures that a scene can have."""
    return [name for name in NAMES if refusal(name, scene) is None]


def measured(sim: mpsim.Simulation, frames: int = 3) -> dict[str, list[str]]:
    """Values and errors of all that can be measured in so many frames, exactly, by name."""
    report = sim.run(frames=frames, measures=measures_of(sim.scene))
    return {name: [float(each.value).hex(), float(each.error).hex()] for name, each in report.measures.items()}
