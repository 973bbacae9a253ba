"""Changes of discs and walls between two frames, and added discs: checked, given room, then applied to a copy."""

from __future__ import annotations

import dataclasses
import inspect
import math
import numbers
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.core.columns import EXITS, GIVEN, MASS, SPIN
from mpsim.engine.solvers.base import NewDiscs, Origin, Solver, Terms, is_between_frames
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError
from mpsim.features import feature
from mpsim.features.baths import ThermalWalls, Thermostat
from mpsim.features.capsules import gaps, of_discs, shifted, with_images
from mpsim.features.emitters import Emitter
from mpsim.features.motions import Movement
from mpsim.features.obstacles import Obstacle, Polyline, Removed, capsules_of, exchanged, listed
from mpsim.features.piston import Piston
from mpsim.features.properties import friction_coefficient, has_masses, has_radii
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.scene.starts import GAP, Room, pushed_aside

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation

# --- Discs that are added to a simulation: checked against the scene before anything is changed


def checked(
    solver: Solver,
    position: ArrayLike,
    velocity: ArrayLike,
    radius: ArrayLike | None,
    mass: ArrayLike | None,
    others: Mapping[str, Any],
) -> NewDiscs:
    """What `Simulation.add` was given, as arrays."""
    names = [column.name for column in GIVEN]
    checks.known_arguments("Simulation.add", others, ["position", "velocity", "acceleration", "radius", "mass", *names])
    scene, settings, _ = terms = solver.terms
    places = checks.finite_array("position", checks.rows(position), (None, 2), "(2,) or (K, 2)")
    count = len(places)
    speeds = checks.finite_array("velocity", checks.rows(velocity), (count, 2), f"({count}, 2), as position has")
    radii = _one_each("radius", radius, scene.largest_radius, count, has_radii(scene))
    masses = _one_each("mass", mass, 1.0, count, has_masses(scene))
    present = solver.radii[~solver.absorbed] if scene._loses_discs else solver.radii
    _check_new(scene, solver.time, present, "position", places, radii)
    checks.fitting("velocity", speeds, settings.precision)
    return NewDiscs(
        places, speeds, radii, {MASS.name: masses, **_brought(terms, others, count, "given for added discs")}
    )


def arguments_of(scene: Scene, new: NewDiscs) -> dict[str, Any]:
    """The arguments of `Simulation.add` for discs that have been checked: those that it would be given."""
    found: dict[str, Any] = {"position": new.position, "velocity": new.velocity}
    found |= {"radius": new.radius} if has_radii(scene) else {}
    return found | {name: values for name, values in new.columns.items() if name != MASS.name or has_masses(scene)}


def _brought(terms: Terms, values: Mapping[str, Any], count: int, how: str) -> dict[str, Floats]:
    """What was given of columns but masses, by name, one row each; how: what the caller does, in words."""
    found: dict[str, Floats] = {}
    for column in GIVEN:
        value = values.get(column.name)
        if column is MASS or value is None:
            continue
        if column not in terms.scene._columns:
            raise InputError(
                f"{column.name} can be {how} only in a scene {column.scenes}, and got {checks.brief(value)}. "
                f"{column.remedy}"
            )
        found[column.name] = column.one_each(value, count)
        checks.fitting(column.name, found[column.name], terms.settings.precision)
    return found


def _check_new(scene: Scene, time: float, present: Floats, name: str, position: Floats, radius: Floats) -> None:
    """Refuse discs that are not in the box as it is now, or for which a feature of the scene leaves no room."""
    scene._check_inside(name, position, radius, time)
    new = feature.AddedDiscs(name, position, radius, present, time)
    for each in scene._features:
        each.check_room(scene, new)


def hindrance(scene: Scene, time: float, present: Floats, name: str, position: Floats, radius: float) -> str | None:
    """Why there is no room for a disc at a time, as `checked`: words for a warning, or None."""
    try:
        _check_new(scene, time, present, name, position[None], np.array([radius]))
    except InputError as error:
        return str(error)
    return None


def _one_each(name: str, value: ArrayLike | None, common: float, count: int, own: bool) -> Floats:
    """Radii or masses, shape (count,): the given ones where discs have their own, otherwise the common one."""
    if not own:
        if value is not None:
            raise InputError(
                f"{name} can be given for added discs only in a scene whose discs have one each; here all have "
                f"the same, and got {value!r}. Leave it out, or give the scene {name}=numpy.full(N, ...) with "
                "different values."
            )
        return np.full(count, common)
    if value is None:
        raise InputError(f"{name} must be given for added discs, as the discs of this scene have one each; got None.")
    each = np.full(count, value) if checks.dimensions(value) == 0 else value
    array = checks.finite_array(name, each, (count,), f"() or ({count},)")
    largest = common if name == "radius" else math.inf
    if (array <= 0).any() or (array > largest).any():
        limit = f" and at most that of the scene's largest disc, {largest:g}" if name == "radius" else ""
        raise InputError(f"{name} of added discs must be > 0{limit}; got {array.tolist()}.")
    return array


# --- Room for a disc or a wall that a user puts among discs: those in the way are pushed aside, as few as possible

NEAR, FAR = 4.0, 64.0
"""Distance up to which discs are pushed at first, and in the end, in radii of the largest disc; it is doubled."""

BARRIER = 3.0  # thickness of the layer of discs that stay and keep in those that are pushed, in the same unit


def make_room(sim: Simulation, capsules: Floats) -> None:
    """Push discs aside that overlap capsules, shape (K, ROW).

    Raises:
        InputError: if there is no room for them; then nothing has changed.
    """
    for ids, position in room_for(sim, capsules):
        sim.set(ids, position=position)


def room_for(sim: Simulation, capsules: Floats) -> list[tuple[NDArray[np.int64], Floats]]:
    """Ids of discs that must make room for capsules, and their new places; [] if none must."""
    if not len(capsules):
        return []
    scene, state = sim.scene, sim.state
    numbers, radius = np.flatnonzero(state.present), sim.radii[state.present]
    low, high = scene.walls_at(sim.time)
    position, (width, height) = state.position[numbers].astype(np.float64) - low, (high - low).tolist()
    largest = float(radius.max(initial=0.0))
    images = with_images(shifted(capsules, -low), (width, height), scene.periodic, width + height).capsule
    gap = np.min([gaps(position, radius, each) for each in images], axis=0)
    if not (gap < 0).any():
        return []
    solid = shifted(np.concatenate([scene._capsules_at(sim.time), capsules]), -low)
    rounding = 8 * checks.resolution(state.position) * max(scene.width, scene.height)
    scale = 1 + GAP + rounding / float(radius.min())
    reach = NEAR * largest
    while True:
        near = gap < reach
        fixed, around = (~near & (gap < reach + layer * largest) for layer in (BARRIER, 3 * BARRIER))
        others = np.concatenate([solid, of_discs(position[fixed], radius[fixed])])
        found = pushed_aside(position[near], radius[near], Room((width, height), scene.periodic, others), scale)
        if found is not None:
            moved = (found != position[near]).any(axis=1)
            apart = scene._to_nearest_image(found[moved, None] - position[around])
            if (np.hypot(*np.moveaxis(apart, -1, 0)) >= radius[near][moved, None] + radius[around]).all():
                return [(numbers[near][moved], found[moved] + low)]
        if near.all() or reach >= FAR * largest:
            raise InputError("there must be room for it; got too little between the discs. Remove some of them.")
        reach *= 2


# --- Parameters of scene and settings that may change, and their values after a change


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

PARAMETER_NAMES = tuple(Parameters.__annotations__)


def check_parameters(given: Mapping[str, Any], settings: Settings) -> None:
    """Refuse what cannot be changed while a simulation runs, or would change nothing with its method."""
    for name, value in given.items():
        if name in OF_STEPS and not capabilities_of(settings).has_steps:
            raise InputError(
                f"{name} can be changed only where frames are made of steps, and got {checks.brief(value)} with "
                f"method={settings.method!r}, which has none. Leave it out."
            )
        if name not in PARAMETER_NAMES:
            meant = checks.near(name, PARAMETER_NAMES)
            hint = f"Did you mean {meant!r}?" if meant else f"What can be changed: {', '.join(PARAMETER_NAMES)}."
            fixed = name in inspect.signature(Scene).parameters or name in inspect.signature(Settings).parameters
            why = "is fixed from the start of a simulation" if fixed else "is not a parameter of a simulation"
            raise InputError(f"change must be given parameters that may change; {name!r} {why}. {hint}")
    if not given:
        raise InputError(
            f"change needs something to change, one of {', '.join(PARAMETER_NAMES)}; got none of them. Give one."
        )


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
    for each in scene._features:
        each.check_law(scene, changed.law)
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
    piston = dataclasses.replace(scene.piston, speed=speed)
    return {"piston": piston, "_piston_from": (time, scene._moving_walls[0].place(time))}


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
    each = _one_for_each("wall_temperature", value, len(edges), f"of the thermal walls {', '.join(edges)}")
    checked = [checks.positive("wall_temperature", one, ENERGY) for one in each]
    return dataclasses.replace(walls, **dict(zip(edges, checked, strict=True)))


def _emitting(emitters: tuple[Emitter, ...], name: str, value: Any) -> tuple[Emitter, ...]:
    """Emitters with another interval or every: one number for all that have such a one, or one for each emitter."""
    having = [each for each in emitters if getattr(each, name) is not None]
    if not having:
        raise _without(name, value, "with emitters that have it", f"Give the scene an Emitter with {name}.")
    of = f"of {len(emitters)} emitters that all have it"
    values = _one_for_each(name, value, len(emitters), of, all_have_one=len(having) == len(emitters))
    return tuple(
        each if getattr(each, name) is None else dataclasses.replace(each, **{name: own})
        for each, own in zip(emitters, values, strict=True)
    )


def _one_for_each(name: str, value: Any, count: int, of: str, all_have_one: bool = True) -> list[Any]:
    """One number for all, or one for each, where all have one; of: them, in words."""
    if checks.dimensions(value) <= 0:
        return [value] * count
    if len(value) != count or not all_have_one:
        raise InputError(f"{name} must be one number, or one for each {of}; got {checks.brief(value)}.")
    return list(value)


# --- Changes of discs between two frames: checked, then applied to a copy
#
# A change is a plain record of what was asked for, once that has passed the gate. The same record is applied, kept in
# the journal, written to checkpoints and session files, and applied again when those are replayed.


SET, KICK, REMOVE, ADD, PARAMETERS = "set", "kick", "remove", "add", "change"
WALL, MOVE_WALL, REMOVE_WALL = WALLS = "add_wall", "move_wall", "remove_wall"
"""What a change can be: each is called as the method of a simulation that makes it."""


class Change(NamedTuple):
    """One change: the arguments of the method `what` by name, made when `frame` frames were done, at `time` [time]."""

    frame: int
    time: float
    what: str
    values: Mapping[str, Any]


def made(solver: Solver, what: str, values: Mapping[str, Any]) -> Change:
    """A change of a simulation as it now stands."""
    return Change(solver.frame, solver.time, what, values)


def after(terms: Terms, change: Change) -> Terms:
    """Scene, settings, and when frames of this length began, after a change."""
    scene, settings, origin = terms
    if change.what == PARAMETERS:
        scene, settings = in_force(scene, settings, change.values, change.time)
        origin = Origin(change.frame, change.time) if "dt" in change.values else origin
    elif change.what == REMOVE and not scene._loses_discs:
        scene = scene._replace(_has_gaps=True)
    elif change.what in WALLS:
        scene = _with_walls(scene, change)
    return Terms(scene, settings, origin)


def terms_after(scene: Scene, settings: Settings, changes: Iterable[Change]) -> Terms:
    """What is in force after changes; the number of workers is that of the settings."""
    terms = Terms(scene, settings, Origin())
    for each in changes:
        terms = after(terms, each)
    return terms._replace(settings=dataclasses.replace(terms.settings, workers=settings.workers))


def demand_apart(solver: Solver, new: NewDiscs) -> None:
    """Refuse new discs that overlap discs that are there, or each other."""
    state = solver.state()
    position = np.concatenate([state.position[state.present].astype(np.float64), new.position])
    radius = np.concatenate([solver.radii[state.present], new.radius])
    for index, own in enumerate(new.position):
        at = len(position) - len(new.position) + index
        gap = np.hypot(*solver.terms.scene._to_nearest_image(position - own).T) - radius - new.radius[index]
        gap[at] = np.inf
        if gap.min() < 0:
            raise InputError(
                f"position[{index}] must be free for overlap='refuse'; got {tuple(own.tolist())}, where a disc is "
                f"{-gap.min():.3g} too near. Choose another place, or overlap='allow'."
            )


def demand_whole_frame(solver: Solver, what: str) -> None:
    """Refuse a change inside a frame."""
    if not is_between_frames(solver):
        raise InputError(
            f"{what} must be called between two frames; got time {solver.time:g}, and frame {solver.frame} ended at "
            f"{solver.terms.time_of(solver.frame):g}: an interrupt has left the run inside a frame. Finish it by "
            "run(frames=1) before."
        )


def checked_set(
    solver: Solver, ids: ArrayLike, position: ArrayLike | None, velocity: ArrayLike | None, others: Mapping[str, Any]
) -> Change:
    """`Simulation.set`, checked; others: columns by name."""
    names = ["position", "velocity", *(column.name for column in GIVEN if column is not MASS)]
    checks.known_arguments("Simulation.set", others, ["ids", *names])
    numbers = present_numbers(solver, ids)
    count = len(numbers)
    values: dict[str, Any] = {"ids": numbers}
    if position is not None:
        meaning = f"({count}, 2), one row per disc of ids"
        places = checks.finite_array("position", checks.rows(position), (count, 2), meaning)
        _check_room(solver, numbers, places)
        values["position"] = places
    if velocity is not None:
        values["velocity"] = _pairs("velocity", velocity, count, solver)
        check_momentum(solver, "velocity", values["velocity"], solver.masses[numbers])
    values |= _brought(solver.terms, others, count, "set")
    if len(values) == 1:
        raise InputError(f"set needs something to set, one of {', '.join(names)}; got none of them. Give one.")
    return made(solver, SET, values)


def checked_kick(solver: Solver, ids: ArrayLike, impulse: ArrayLike) -> Change:
    """`Simulation.kick`, checked."""
    numbers = present_numbers(solver, ids)
    change = made(solver, KICK, {"ids": numbers, "impulse": _pairs("impulse", impulse, len(numbers), solver)})
    changed = edited(solver.discs(numbers), change)
    name, velocity = "the velocity after the kick", np.asarray(changed.velocity, np.float64)
    checks.fitting(name, velocity, solver.terms.settings.precision)
    check_momentum(solver, name, velocity, changed.mass)
    return change


def check_momentum(solver: Solver, name: str, velocity: NDArray[np.floating], mass: Floats) -> None:
    """Refuse velocities, of discs of these masses, whose impulses the sums of the solver cannot hold."""
    speed = np.hypot(*velocity.T)
    most, total = solver.most_momentum, float((mass * speed).sum())
    if total > most:
        raise InputError(
            f"{name} must give speeds of at most {most / total * float(speed.max()):.3g}: the sums of impulses, from "
            "which the pressure is computed, are made for speeds like those at the start of the simulation; got "
            f"{float(speed.max()):.3g}. Start a new simulation with discs so fast."
        )


def checked_parameters(solver: Solver, start: Scene, given: Mapping[str, Any]) -> Change:
    """`Simulation.change`, checked but for speeds, and for what `in_force` checks."""
    values = {name: value if name == "obstacles" else feature.plain(value) for name, value in given.items()}
    if "obstacles" not in given:
        return made(solver, PARAMETERS, values)
    values["obstacles"] = [each for each in listed(given["obstacles"]) if not isinstance(each, Removed)]
    return _checked_obstacles(solver, start, PARAMETERS, values)


def checked_wall(
    solver: Solver, start: Scene, what: str, wall: int | ArrayLike | Obstacle, motion: Movement | None = None
) -> Change:
    """`Simulation.add_wall`, `move_wall` or `remove_wall`, checked."""
    own = listed(_obstacle(wall))[0] if what == WALL else _present_wall(solver.terms.scene, wall)
    return _checked_obstacles(solver, start, what, {"wall": own} | ({"motion": motion} if motion else {}))


def _obstacle(wall: Any) -> Obstacle:
    """An obstacle, or the Polyline that points make."""
    return wall if isinstance(wall, Obstacle) else Polyline(wall)


def _checked_obstacles(solver: Solver, start: Scene, what: str, values: Mapping[str, Any]) -> Change:
    """A change of obstacles: new ones are clear of discs, and those that move go on from where they are.

    start: the scene at the start, whose emitters and pistons must keep their room.
    """
    change, scene = made(solver, what, values), solver.terms.scene
    before, now = scene.obstacles, after(solver.terms, change).scene.obstacles
    differ = tuple(Removed() if each == old else each for each, old in zip_longest(now, before))
    bare = start._replace(obstacles=differ)._without_discs()
    for each in bare._features:
        each.check(bare)
    _check_moved(scene, differ, change)
    if len(now) > len(before):
        new = (Removed(),) * len(before) + differ[len(before) :]
        _check_clear(solver, scene._replace(obstacles=new), change.time)
    return change


def _check_moved(scene: Scene, differ: tuple[Obstacle, ...], change: Change) -> None:
    """Refuse motions of obstacles that are there if they begin elsewhere."""
    for before, now in zip(scene.obstacles, differ, strict=False):
        if isinstance(now, Removed):
            continue
        jump = np.abs(capsules_of((now,), change.time) - capsules_of((before,), change.time)).max()
        if jump > 1e-9 * max(scene.width, scene.height):
            raise InputError(
                f"motion must begin where the wall is; got {now.motion!r}, which would displace it at once by "
                f"{jump:.3g}. Use a phase of 0, or a first displacement of (0, 0)."
            )


def _check_clear(solver: Solver, scene: Scene, time: float) -> None:
    """Refuse discs that are there in the obstacles of a scene, or outside its containers."""
    discs, here = solver.discs(), np.flatnonzero(~solver.absorbed)
    position, radius = discs.position[here].astype(np.float64), discs.radius[here]
    if (found := scene._deepest(position, radius, time)) is not None:
        number, at = here[found.disc], tuple(position[found.disc].tolist())
        raise InputError(
            f"a wall must be clear of all discs; got disc {number} at {at} with radius {radius[found.disc]:g}, "
            f"{found.depth:.3g} inside {found.where}. Put it elsewhere, or move the disc first."
        )


def _present_wall(scene: Scene, wall: Any) -> int:
    """The number of an obstacle that is there."""
    there = [number for number, each in enumerate(scene.obstacles) if not isinstance(each, Removed)]
    if isinstance(wall, bool) or not isinstance(wall, numbers.Integral) or int(wall) not in there:
        raise InputError(
            f"wall must be the number of an obstacle that is there, as sim.add_wall returns it; got {wall!r:.60}, and "
            f"there are {checks.brief(there)}. It is the index in sim.scene.obstacles."
        )
    return int(wall)


def present_numbers(solver: Solver, ids: ArrayLike) -> NDArray[np.int64]:
    """Numbers of discs that are there, each once, shape (K,)."""
    count = solver.count
    array = np.atleast_1d(np.asarray(ids if checks.dimensions(ids) >= 0 else None))
    if not array.size:
        array = np.zeros(0, np.int64)
    if array.dtype.kind not in "iu" or array.ndim != 1:
        hint = " Use numpy.flatnonzero(mask) to select by a mask." if array.dtype.kind == "b" else ""
        raise InputError(
            f"ids must be whole numbers, one or shape (K,), as they are given to discs; got {checks.brief(ids)}.{hint}"
        )
    for wrong in array[(array < 0) | (array >= count)].tolist()[:1]:
        raise InputError(f"ids must be numbers of discs, from 0 to {count - 1}; got {wrong}. There are {count} discs.")
    numbers = array.astype(np.int64)
    ordered = np.sort(numbers)
    for twice in ordered[1:][ordered[1:] == ordered[:-1]].tolist()[:1]:
        raise InputError(f"ids must hold each disc once; disc {twice} is in it {(numbers == twice).sum()} times.")
    if (gone := solver.absorbed[numbers]).any():
        raise InputError(
            f"ids must be discs that are there; disc {numbers[gone][0]} has been removed, or has left through an "
            "absorbing edge. sim.state.present says which discs are there."
        )
    return checks.read_only(numbers)


def _pairs(name: str, value: Any, count: int, solver: Solver) -> Floats:
    """One pair for all, or one each, shape (count, 2)."""
    if checks.dimensions(value) == 1 and len(value) == 2:
        value = np.full((count, 2), checks.finite_array(name, value, (2,), "(2,)"))
    pairs = checks.finite_array(name, value, (count, 2), f"(2,) or ({count}, 2), one row per disc of ids")
    checks.fitting(name, pairs, solver.terms.settings.precision)
    return pairs


def _check_room(solver: Solver, numbers: NDArray[np.int64], position: Floats) -> None:
    """Refuse places outside the box as it is now, or where a feature of the scene leaves no room."""
    scene = solver.terms.scene
    if scene._loses_discs or has_radii(scene):
        others = ~solver.absorbed
        others[numbers] = False
        beside = solver.radii[others]
    else:
        beside = solver.radii[: solver.count - len(numbers)]
    _check_new(scene, solver.time, beside, "position", position, solver.radii[numbers])


def _with_walls(scene: Scene, change: Change) -> Scene:
    """A scene after a change of its obstacles, of one of the kinds WALLS."""
    values, obstacles, time = change.values, [*scene.obstacles], change.time
    if change.what == WALL:
        obstacles.append(_obstacle(values["wall"]).seen_from(-time))
    elif change.what == MOVE_WALL:
        obstacles[values["wall"]] = obstacles[values["wall"]].turned_over_to(values.get("motion"), time)
    else:
        obstacles[values["wall"]] = Removed()
    return scene._replace(obstacles=obstacles)


def edited(discs: NewDiscs, change: Change) -> NewDiscs:
    """Copies of the discs `ids` of a change after it, in the precision of the run.

    A kick adds impulse / mass to a velocity, computed in float64. A disc that is removed rests where it was.
    """
    values, position, velocity, columns = change.values, discs.position.copy(), discs.velocity.copy(), {**discs.columns}
    if change.what == KICK:
        velocity[:] = velocity + values["impulse"] / discs.mass[:, None]
    elif change.what == REMOVE:
        velocity[:], columns[EXITS.name] = 0, np.column_stack([np.ones(len(position)), position])
        if SPIN.name in columns:
            columns[SPIN.name] = np.zeros_like(columns[SPIN.name])
    else:
        for name, array in (("position", position), ("velocity", velocity)):
            if name in values:
                array[:] = values[name]
        for column in GIVEN:
            if column.name in values:
                columns[column.name] = np.asarray(values[column.name], columns[column.name].dtype)
    return NewDiscs(position, velocity, discs.radius, columns)
