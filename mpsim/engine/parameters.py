"""Parameters of scene and settings that may change during a simulation, and their present values."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

import dataclasses
import inspect
import numbers
from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from mpsim.core import checks
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError
from mpsim.features.baths import ThermalWalls, Thermostat
from mpsim.features.emitters import Emitter
from mpsim.features.obstacles import Obstacle, exchanged, listed
from mpsim.features.piston import Piston
from mpsim.features.properties import friction_coefficient
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings


class Parameters(TypedDict, total=False):
    """Arguments of `Simulation.change`."""

    gravity: ArrayLike
    restitution: float
    wall_restitution: float
    friction: float
    wall_friction: float
    piston_speed: float
    interval: float | Sequence[float]
    every: int | Sequence[int]
    temperature: float
    wall_temperature: float | Sequence[float]
    obstacles: Sequence[Obstacle] | Obstacle
    dt: float
    contact: str
    passes: int
    substeps: int
    workers: int | None


OF_STEPS = ("contact", "passes", "substeps")

OF_FRICTION = ("friction", "wall_friction")

OF_SETTINGS = ("dt", *OF_STEPS, "workers")

ENERGY = "[mass length^2/time^2]"

NAMES = tuple(Parameters.__annotations__)


def check_names(given: Mapping[str, Any], settings: Settings) -> None:
    """Refuse what cannot be changed while a simulation runs, or would change nothing with its method."""
    for name, value in given.items():
        if name in OF_STEPS and not capabilities_of(settings).has_steps:
            raise InputError(
                f"{name} can be changed only where frames are made of steps, and got {checks.brief(value)} with "
                f"method={settings.method!r}, which has none. Leave it out."
            )
        if name not in NAMES:
            meant = checks.near(name, NAMES)
            hint = f"Did you mean {meant!r}?" if meant else f"What can be changed: {', '.join(NAMES)}."
            fixed = name in inspect.signature(Scene).parameters or name in inspect.signature(Settings).parameters
            why = "is fixed from the start of a simulation" if fixed else "is not a parameter of a simulation"
            raise InputError(f"change must be given parameters that may change; {name!r} {why}. {hint}")
    if not given:
        raise InputError(f"change needs something to change, one of {', '.join(NAMES)}; got none of them. Give one.")


def in_force(scene: Scene, settings: Settings, given: Mapping[str, Any], time: float) -> tuple[Scene, Settings]:
    """Scene and settings after a change at a time [time], which `Simulation.change` was given by name."""
    if "gravity" in given and given["gravity"] is None:
        raise InputError("gravity must be two numbers in a change; got None. Give (0, 0) for a scene without weight.")
    values: dict[str, Any] = {}
    for name, value in given.items():
        if name in ("gravity", "restitution", "wall_restitution"):
            values[name] = value
        elif name in OF_FRICTION:
            values[name] = _rubbing(scene, name, value)
        elif name == "piston_speed":
            values |= _at_speed(scene, value, time)
        elif name in ("interval", "every"):
            values["emitters"] = _emitting(values.get("emitters", scene.emitters), name, value)
        elif name == "temperature":
            values["thermostat"] = _at_temperature(scene.thermostat, value)
        elif name == "wall_temperature":
            values["thermal_walls"] = _with_walls_at(scene.thermal_walls, value)
        elif name == "obstacles":
            values["obstacles"] = exchanged(scene.obstacles, listed(value), time)
    changed = dataclasses.replace(settings, **{name: given[name] for name in OF_SETTINGS if name in given})
    scene = scene._replace(**values) if values else scene
    for feature in scene._features:
        feature.check_law(scene, changed.law)
    return scene, changed


def _without(name: str, value: Any, what: str, remedy: str) -> InputError:
    """The error for a parameter of something that the scene lacks."""
    return InputError(f"{name} can be changed only in a scene {what}, and got {checks.brief(value)}. {remedy}")


def _rubbing(scene: Scene, name: str, value: Any) -> float:
    """Another coefficient of friction. Discs without friction have no spin, so it neither begins nor ends."""
    if not getattr(scene, name):
        raise _without(name, value, "that has it", "Give the scene a small one, which has almost no effect.")
    coefficient = friction_coefficient(name, value)
    if not coefficient:
        raise InputError(
            f"{name} must be > 0 in a change; got {checks.brief(value)}. A small one has almost no effect."
        )
    return coefficient


def _at_speed(scene: Scene, speed: Any, time: float) -> dict[str, Any]:
    """The piston at another speed from a time on, and this time."""
    if not isinstance(scene.piston, Piston) or scene.piston.speed is None:
        remedy = "Give the scene one; a slow one hardly moves."
        raise _without("piston_speed", speed, "with a piston that has a speed", remedy)
    return {
        "piston": dataclasses.replace(scene.piston, speed=speed, start=scene._moving_walls[0].place(time)),
        "_piston_began": time,
    }


def _at_temperature(thermostat: Thermostat | None, temperature: Any) -> Thermostat:
    if thermostat is None:
        remedy = "Give the scene a Thermostat; one with a small rate has almost no effect."
        raise _without("temperature", temperature, "with a thermostat", remedy)
    return dataclasses.replace(thermostat, temperature=checks.positive("temperature", temperature, ENERGY))


def _with_walls_at(walls: ThermalWalls | None, value: Any) -> ThermalWalls:
    """Thermal walls at another temperature: one number for all of them, or one for each."""
    if walls is None:
        raise _without("wall_temperature", value, "with thermal walls", "Give the scene ThermalWalls.")
    edges = list(walls.temperatures)
    each = [value] * len(edges) if checks.dimensions(value) <= 0 else list(value)
    if len(each) != len(edges):
        raise InputError(
            f"wall_temperature must be one number, or one for each of the thermal walls {', '.join(edges)}; got "
            f"{checks.brief(value)}."
        )
    checked = [checks.positive("wall_temperature", one, ENERGY) for one in each]
    return dataclasses.replace(walls, **dict(zip(edges, checked, strict=True)))


def _emitting(emitters: tuple[Emitter, ...], name: str, value: Any) -> tuple[Emitter, ...]:
    """Emitters with another interval or every: one number for all that have such a one, or one for each emitter."""
    having = [index for index, each in enumerate(emitters) if getattr(each, name) is not None]
    if not having:
        raise _without(name, value, "with emitters that have it", f"Give the scene an Emitter with {name}.")
    if checks.dimensions(value) <= 0:
        each_of = {index: value for index in having}
    elif len(value) == len(emitters) == len(having):
        each_of = dict(enumerate(np.asarray(value).tolist()))
    else:
        raise InputError(
            f"{name} must be one number, or one for each of {len(emitters)} emitters that all have it; got "
            f"{checks.brief(value)}."
        )
    return tuple(
        dataclasses.replace(each, **{name: each_of[index]}) if index in each_of else each
        for index, each in enumerate(emitters)
    )


def plain(given: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as a journal holds them: plain numbers, words and lists of these; what is neither, as it is."""
    return {name: _plain(value) for name, value in given.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, bool):
        return value
    if isinstance(value, numbers.Integral):
        return int(value)
    return float(value) if isinstance(value, numbers.Real | Decimal) else value
