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
from mpsim.features.laws import friction_coefficient
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


def check_names(given: Mapping[str, Any]) -> None:
    """Refuse what cannot be changed while a simulation runs.

    Raises:
        InputError: naming it, with the name that was probably meant.
    """
    for name in given:
        if name in NAMES:
            continue
        meant = checks.near(name, NAMES)
        hint = f"Did you mean {meant!r}?" if meant else f"What can be changed: {', '.join(NAMES)}."
        fixed = name in inspect.signature(Scene).parameters or name in inspect.signature(Settings).parameters
        why = "is fixed from the start of a simulation" if fixed else "is not a parameter of a simulation"
        raise InputError(f"change must be given parameters that may change; {name!r} {why}. {hint}")
    if not given:
        raise InputError(f"change needs something to change, one of {', '.join(NAMES)}; got none of them. Give one.")


def demand_steps(given: Mapping[str, Any], settings: Settings) -> None:
    """Refuse parameters of steps where frames have none: they would change nothing.

    Raises:
        InputError: naming the first one and the method.
    """
    if capabilities_of(settings).has_steps:
        return
    for name in given:
        if name in OF_STEPS:
            raise InputError(
                f"{name} can be changed only where frames are made of steps, and got {checks.brief(given[name])} with "
                f"method={settings.method!r}, which has none. Leave it out."
            )


def in_force(scene: Scene, settings: Settings, given: Mapping[str, Any], time: float) -> tuple[Scene, Settings]:
    """Scene and settings after a change.

    Args:
        scene, settings: in force before.
        given: parameters by name, as `Simulation.change` was given them.
        time: of the change [time].

    Raises:
        InputError: naming the parameter, its rule and the value received.
    """
    if "gravity" in given and given["gravity"] is None:
        raise InputError("gravity must be two numbers in a change; got None. Give (0, 0) for a scene without weight.")
    values = {name: given[name] for name in given if name in ("gravity", "restitution", "wall_restitution")}
    values |= {name: _rubbing(scene, name, given[name]) for name in OF_FRICTION if name in given}
    if "piston_speed" in given:
        values |= _at_speed(scene, given["piston_speed"], time)
    counts = {name: given[name] for name in ("interval", "every") if name in given}
    if counts:
        emitters = scene.emitters
        for name, value in counts.items():
            emitters = _emitting(emitters, name, value)
        values["emitters"] = emitters
    if "temperature" in given:
        values["thermostat"] = _at_temperature(scene.thermostat, given["temperature"])
    if "wall_temperature" in given:
        values["thermal_walls"] = _with_walls_at(scene.thermal_walls, given["wall_temperature"])
    changed = dataclasses.replace(settings, **{name: given[name] for name in OF_SETTINGS if name in given})
    scene = scene._replace(**values) if values else scene
    for feature in scene._features:
        feature.check_law(scene, changed.law)
    return scene, changed


def _rubbing(scene: Scene, name: str, value: Any) -> float:
    """Another coefficient of friction. Discs without friction have no spin, so it neither begins nor ends."""
    if not getattr(scene, name):
        raise InputError(
            f"{name} can be changed only in a scene that has it, and got {checks.brief(value)}. Give the scene a small "
            "one, which has almost no effect."
        )
    coefficient = friction_coefficient(name, value)
    if not coefficient:
        raise InputError(
            f"{name} must be > 0 in a change; got {checks.brief(value)}. A small one has almost no effect."
        )
    return coefficient


def _at_speed(scene: Scene, speed: Any, time: float) -> dict[str, Any]:
    """The piston at another speed from a time on, and this time."""
    wall = scene._moving_wall
    if scene.piston is None or wall is None:
        raise InputError(
            f"piston_speed can be changed only in a scene with a piston, and got {checks.brief(speed)}. Give the scene "
            "one; a slow one hardly moves."
        )
    return {
        "piston": dataclasses.replace(scene.piston, speed=speed, start=wall.place(time)),
        "_piston_began": time,
    }


def _at_temperature(thermostat: Thermostat | None, temperature: Any) -> Thermostat:
    if thermostat is None:
        raise InputError(
            f"temperature can be changed only in a scene with a thermostat, and got {checks.brief(temperature)}. Give "
            "the scene a Thermostat; one with a small rate has almost no effect."
        )
    return dataclasses.replace(thermostat, temperature=checks.positive("temperature", temperature, ENERGY))


def _with_walls_at(walls: ThermalWalls | None, value: Any) -> ThermalWalls:
    """Thermal walls at another temperature: one number for all of them, or one for each."""
    if walls is None:
        raise InputError(
            f"wall_temperature can be changed only in a scene with thermal walls, and got {checks.brief(value)}. Give "
            "the scene ThermalWalls."
        )
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
        raise InputError(
            f"{name} can be changed only in a scene with emitters that have it, and got {checks.brief(value)}. Give "
            f"the scene an Emitter with {name}."
        )
    if checks.dimensions(value) <= 0:
        each_of = {index: value for index in having}
    else:
        if len(value) != len(emitters) or len(having) != len(emitters):
            raise InputError(
                f"{name} must be one number, or one for each of {len(emitters)} emitters that all have it; got "
                f"{checks.brief(value)}."
            )
        each_of = dict(enumerate(np.asarray(value).tolist()))
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
