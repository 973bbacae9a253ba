"""The parameters that a page can change, with the values and ranges of their sliders."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from mpsim.core import checks
from mpsim.core.machine import usable_cores
from mpsim.engine.parameters import OF_FRICTION
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError
from mpsim.kernels import records
from mpsim.scene.scene import Scene

MOST_PASSES, MOST_SUBSTEPS = 4, 16
"""Upper ends of these sliders. If the value of the simulation is larger, the slider ends there."""

DECADE = 10.0
"""Sliders of times, rates and temperatures go from a tenth to ten times the initial value."""

TEMPERATURES = "temperature", "wall_temperature"

ROUNDING = 0.005
"""Relative rounding error of a slider's value: pages send three digits."""


class Sliders:
    """The sliders of one simulation. Their ranges follow from its initial values, so that they stay when values change.

    >>> from mpsim import Scene, Settings
    >>> scene = Scene.random(count=5, packing=0.2, radius=0.5, seed=1, gravity=(0, -3))
    >>> with Simulation(scene, Settings(method="event")) as sim:
    ...     found = Sliders(sim).of(sim)
    >>> [(each["name"], each["value"]) for each in found][:3]
    [('gravity', [0.0, -3.0]), ('restitution', 1.0), ('wall_restitution', 1.0)]
    """

    def __init__(self, sim: Simulation):
        start = sim.journal
        scene, self._dt = start.scene, start.settings.dt
        self._gravity = longest_gravity(scene)
        self._piston = None if scene.piston is None else scene.piston.speed
        self._cores = usable_cores()
        self._interval, self._every = rate_of(scene, "interval"), rate_of(scene, "every")
        self._friction = {name: friction_of(scene, name) for name in OF_FRICTION}
        self._temperatures = {name: temperature_of(scene, name) for name in TEMPERATURES}

    def of(self, sim: Simulation) -> list[dict[str, Any]]:
        """Name, value and range of each slider, as sent to pages. The range is `low` and `high`, or `choices`.

        log: whether the scale is logarithmic. whole: whether only whole numbers can be chosen. The value of gravity is
        (x, y), and its `high` is the length of the longest arrow.
        """
        return [*self._of_scene(sim), *self._of_settings(sim)]

    def demand_offered(self, sim: Simulation, name: str, value: Any) -> None:
        """Refuse numbers outside the sliders: they could make a frame so long that the page stops responding.

        Raises:
            InputError: if the value is outside; the message gives the parameter, its rule and the value received.
        """
        offered = {each["name"]: each for each in self.of(sim)}
        remedy = "Use the slider, or Simulation.change in a program."
        if name not in offered:
            raise InputError(
                f"{name} must be a parameter that the page offers here, one of {', '.join(offered)}; got "
                f"{checks.brief(value)}. Use Simulation.change in a program."
            )
        ends, given = offered[name], [value] if checks.dimensions(value) <= 0 else list(value)
        if not all(isinstance(each, int | float) for each in given):
            return  # a word, or something that the simulation will refuse
        if name == "gravity":
            longest = ends["high"] * (1 + ROUNDING)
            if len(given) == len("xy") and math.hypot(*given) > longest:
                raise InputError(f"gravity must be at most {ends['high']:g} here; got {checks.brief(value)}. {remedy}")
            return
        if "low" not in ends:
            return
        low, high = ends["low"], ends["high"]
        for each in given:
            if not low - ROUNDING * abs(low) <= each <= high + ROUNDING * abs(high):
                raise InputError(f"{name} must be from {low:.4g} to {high:.4g} here; got {each:g}. {remedy}")

    def _of_scene(self, sim: Simulation) -> Iterator[dict[str, Any]]:
        scene = sim.scene
        gravity = [0.0, 0.0] if scene.gravity is None else scene.gravity.tolist()
        yield {"name": "gravity", "value": gravity, "high": self._gravity}
        if sim.settings.law == "elastic":
            yield _slider("restitution", scene.restitution, 0.0, 1.0)
            yield _slider("wall_restitution", scene.wall_restitution, 0.0, 1.0)
        for name, first in self._friction.items():
            if (coefficient := friction_of(scene, name)) is not None and first is not None:
                yield _slider(name, coefficient, first / DECADE, first * DECADE, log=True)
        if scene.piston is not None and self._piston is not None:
            ends = sorted((self._piston / DECADE, self._piston * DECADE))
            yield _slider("piston_speed", scene.piston.speed, *ends, log=True)
        for name, first in self._temperatures.items():
            if (temperature := temperature_of(scene, name)) is not None and first is not None:
                yield _slider(name, temperature, first / DECADE, first * DECADE, log=True)
        if (interval := rate_of(scene, "interval")) is not None and self._interval is not None:
            yield _slider("interval", interval, self._interval / DECADE, self._interval * DECADE, log=True)
        if (every := rate_of(scene, "every")) is not None and self._every is not None:
            yield _slider("every", every, 1, int(self._every * DECADE), log=True, whole=True)

    def _of_settings(self, sim: Simulation) -> Iterator[dict[str, Any]]:
        settings = sim.settings
        yield _slider("dt", settings.dt, self._dt / DECADE, self._dt * DECADE, log=True)
        if capabilities_of(settings).has_steps:
            yield {"name": "contact", "value": settings.contact, "choices": list(records.CONTACTS)}
            yield _slider("passes", settings.passes, 1, MOST_PASSES, whole=True)
            yield _slider("substeps", settings.substeps, 1, MOST_SUBSTEPS, whole=True)
        if settings.method == "parallel":
            yield _slider("workers", settings.workers or self._cores, 1, self._cores, whole=True)


def _slider(name: str, value: float, low: float, high: float, log: bool = False, whole: bool = False) -> dict[str, Any]:
    ends = {"low": min(low, value), "high": max(high, value)}
    return {"name": name, "value": value, **ends, "log": log, "whole": whole}


def rate_of(scene: Scene, name: str) -> Any:
    """The attribute `interval` or `every` of the first emitter that has it; None: no emitter has it."""
    return next((value for each in scene.emitters if (value := getattr(each, name)) is not None), None)


def friction_of(scene: Scene, name: str) -> float | None:
    """A coefficient of friction; None: it is zero or infinite."""
    coefficient = getattr(scene, name)
    return coefficient if 0 < coefficient < math.inf else None


def temperature_of(scene: Scene, name: str) -> float | None:
    """The temperature of the thermostat, or that of the thermal walls; None: there is none, or the walls differ."""
    if name == "temperature":
        return None if scene.thermostat is None else scene.thermostat.temperature
    found = set() if scene.thermal_walls is None else set(scene.thermal_walls.temperatures.values())
    return found.pop() if len(found) == 1 else None


def longest_gravity(scene: Scene) -> float:
    """Length of the longest arrow for gravity, rounded up [length/time^2].

    It is twice the gravity of the scene. Without gravity it is 2 v^2 / height, with v the root mean square speed. This
    is strong enough to keep most discs in the lower part of the box.

    >>> from mpsim import Scene
    >>> longest_gravity(Scene.load("sediment")), longest_gravity(Scene.load("gas"))
    (2.0, 0.5)
    """
    if scene.gravity is not None and (length := float(np.hypot(*scene.gravity))) > 0:
        return _rounded_up(2 * length)
    square = float(np.mean(np.sum(scene.velocity**2, axis=1))) if scene.count else 0.0
    return _rounded_up(2 * square / scene.height or 10 * scene.height)


def _rounded_up(value: float) -> float:
    """The smallest number that is 1, 2 or 5 times a power of ten and not below the value.

    >>> [_rounded_up(value) for value in (0.3, 1.0, 30.0)]
    [0.5, 1.0, 50.0]
    """
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-12)))
