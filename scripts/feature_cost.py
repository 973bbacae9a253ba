"""Cost of each feature of a scene per disc and frame."""

import warnings
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np
from benchmark import WrongAnswerError
from harness import by_turns, table

from mpsim.engine.observers import Collisions
from mpsim.engine.simulation import Simulation
from mpsim.errors import FastWarning
from mpsim.features.baths import ThermalWalls, Thermostat
from mpsim.features.obstacles import FixedDisc, Polyline
from mpsim.features.piston import Piston
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

SIDE = 100
"""Number of discs along each side of the square lattice from which the scenes start."""

PITCH = 1.4
"""Its spacing [diameters]: packing 0.40."""

ROUNDS = 5
"""Number of times that each scene is timed, in turns; the least median counts, as other load only adds to it."""

FRAMES = 150

SPREADS = (1, 2, 4, 8, 16)
"""Ratios of the largest radius to the smallest: cells follow the largest disc, so that they hold many small ones."""

WARM_UP = 100
"""Frames before the first timing: the lattice melts."""


BOX = SIDE * PITCH
PEGS = np.arange(1, 100, 10) * PITCH
EXAMPLES: dict[str, dict[str, Any]] = {
    "radius": {"radii": np.random.default_rng(2).uniform(0.3, 0.5, SIDE**2)},
    "mass": {"masses": np.random.default_rng(2).uniform(0.5, 2.0, SIDE**2)},
    "gravity": {"gravity": (0.0, -0.1)},
    "acceleration": {"acceleration per disc": np.random.default_rng(2).normal(size=(SIDE**2, 2)) * 0.1},
    "restitution": {"restitution": 0.95},
    "obstacles": {
        "100 pegs": [FixedDisc((x, y), 0.1) for x in PEGS for y in PEGS],
        "a polyline": [Polyline([(0, BOX / 2), (BOX / 3, BOX / 2)])],
    },
    "piston": {"a piston": Piston("bottom", 0.01, BOX / 2)},
    "absorbing": {"an absorbing edge": "top"},
    "friction": {"friction": 0.5},
    "thermostat": {"a thermostat": Thermostat(1.0, 1.0)},
    "thermal_walls": {"thermal walls": ThermalWalls(left=1.0, right=1.0, bottom=1.0, top=1.0)},
}
"""Values to time, by argument and name, in the square box of the discs of radius 0.5, thermal velocities and mass 1."""

APART = ("thermal_walls",)
"""Arguments that are not combined with the others: a piston and an absorbing edge leave no wall to heat."""

OBSERVED = "collisions observed"
"""The bare scene, with all its collisions handed over at the end of each timing. Their table is made between frames, so
that its time is not in here."""


def scene(name: str, **features: Any) -> Scene:
    """10,000 discs of radius 0.5 on a lattice, packing 0.40, with thermal velocities and the given features."""
    rng = np.random.default_rng(1)
    places = (np.arange(SIDE) + 0.5) * PITCH
    position = np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)
    velocity = rng.normal(size=position.shape)
    size = SIDE * PITCH
    if name == "one giant":
        clear = np.hypot(*(position - size / 2).T) > 10.6
        position = np.concatenate([position[clear], [[size / 2, size / 2]]])
        velocity = np.concatenate([velocity[clear], [[0.0, 0.0]]])
        features["radius"] = np.append(np.full(int(clear.sum()), 0.5), 10.0)
    return Scene(width=size, height=size, position=position, velocity=velocity, **{"radius": 0.5, **features})


def scenes() -> dict[str, Scene]:
    """The bare scene, each feature alone, and all that can be combined."""
    alone: dict[str, dict[str, Any]] = {"bare": {}, "periodic": {"boundary": "periodic"}}
    together: dict[str, Any] = {"boundary": ("periodic", "walls")}
    for argument, examples in EXAMPLES.items():
        alone |= {name: {argument: value} for name, value in examples.items()}
        if argument not in APART:
            together[argument] = next(iter(examples.values()))
    found = {name: scene(name, **features) for name, features in alone.items()}
    found |= {"one giant": scene("one giant"), "all together": scene("all together", **together)}
    return found | {f"radii 1 to {spread}, packing 0.5": polydisperse(spread) for spread in SPREADS}


def polydisperse(spread: int) -> Scene:
    """As many discs at packing 0.5, with radii from 0.5 / spread to 0.5, uniform in the logarithm."""
    radius = 0.5 * np.exp(-np.random.default_rng(3).random(SIDE**2) * np.log(spread))
    return Scene.random(count=SIDE**2, packing=0.5, radius=radius if spread > 1 else 0.5, seed=3)


def feature_costs(settings: Settings, tick: Callable[[str], None]) -> str:
    """A table in Markdown: every scene by `grid`, timed in turns; the final states are checked.

    Raises:
        WrongAnswerError: if a disc was lost, left the box, or is not finite.
    """
    simulations: dict[str, Simulation] = {}
    observers = {OBSERVED: Collisions(callback=lambda _, table: None, every=FRAMES)}

    def cost(name: str) -> float:
        tick(f"timing {name}")
        report = simulations[name].run(frames=FRAMES, observe=observers.get(name))
        return float(np.median(report.frame_seconds)) / simulations[name].count * 1e9

    with ExitStack() as stack:
        for name, each in {**scenes(), OBSERVED: scene(OBSERVED)}.items():
            tick(f"compiling {name}")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FastWarning)  # of discs a sixteenth as large: only times are wanted
                simulations[name] = stack.enter_context(Simulation(each, settings))
                simulations[name].run(frames=WARM_UP, observe=observers.get(name))
        costs = {
            name: min(found) for name, found in by_turns({n: partial(cost, n) for n in simulations}, ROUNDS).items()
        }
        for name, sim in simulations.items():
            _check(name, sim)
        bare, rows = set(simulations["bare"].array_names), []
        for name, sim in simulations.items():
            own = families(each for each in sim.array_names if each not in bare)
            size = sim.run(frames=0, observe=observers.get(name)).block_bytes / sim.count
            times = f"{costs[name]:.2f}", f"{costs[name] / costs['bare']:.2f}"
            rows.append((name, *times, f"{size:.0f}", ", ".join(own) or "none"))
    return table(("scene", "ns per disc and frame", "over bare", "bytes per disc", "arrays of its own"), rows)


def families(arrays: Iterable[str]) -> tuple[str, ...]:
    """Names of quantities: both buffers of one count once, and so do all arrays of a feature."""
    names = (name.removeprefix("a.").removeprefix("b.").partition(".")[0] for name in arrays)
    return tuple(dict.fromkeys(names))


def _check(name: str, sim: Simulation) -> None:
    low, high = sim.scene.limits(sim.radii)
    state = sim.state
    slack = 1e-3  # float32 coordinates of a box of 140 diameters
    inside = (state.position >= low - slack) & (state.position <= high + slack)
    if not (inside.all() and np.isfinite(state.velocity).all() and sim.count == sim.scene.count):
        raise WrongAnswerError(f"{name}: the state is not whole after {sim.frame} frames")
