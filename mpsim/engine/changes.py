"""Changes of discs between two frames, and added discs: checked, then applied to a copy."""

import math
import numbers
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.columns import EXITS, MASS, SPIN, Column, check_names, given
from mpsim.engine.feature_arrays import columns_of
from mpsim.engine.parameters import in_force, plain
from mpsim.engine.solvers.base import NewDiscs, Origin, Solver, Terms
from mpsim.errors import InputError
from mpsim.features import feature
from mpsim.features.motions import Movement
from mpsim.features.obstacles import Obstacle, Polyline, Removed, capsules_of, listed
from mpsim.features.properties import has_masses, has_radii
from mpsim.measure.observables import to_nearest_image
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

# --- Discs that are added to a simulation: checked against the scene before anything is changed

Floats = NDArray[np.float64]


def checked(
    solver: Solver,
    position: ArrayLike,
    velocity: ArrayLike,
    radius: ArrayLike | None,
    mass: ArrayLike | None,
    others: Mapping[str, Any],
) -> NewDiscs:
    """What `Simulation.add` was given, as arrays."""
    check_names("Simulation.add", others, ("position", "velocity", "acceleration", "radius", "mass"), given())
    scene, settings, _ = terms = solver.terms
    places = checks.finite_array("position", checks.rows(position), (None, 2), "(2,) or (K, 2)")
    count = len(places)
    speeds = checks.finite_array("velocity", checks.rows(velocity), (count, 2), f"({count}, 2), as position has")
    radii = _one_each("radius", radius, scene.largest_radius, count, has_radii(scene))
    masses = _one_each("mass", mass, 1.0, count, has_masses(scene))
    present = solver.radii[~solver.absorbed] if scene._loses_discs else solver.radii
    _check_new(scene, solver.time, present, "position", places, radii)
    checks.fitting("velocity", speeds, settings.precision)
    brought = {
        column.name: _brought(terms, column, others[column.name], count, "given for added discs")
        for column in given()
        if others.get(column.name) is not None
    }
    return NewDiscs(places, speeds, radii, {MASS.name: masses, **brought})


def arguments_of(scene: Scene, new: NewDiscs) -> dict[str, Any]:
    """The arguments of `Simulation.add` for discs that have been checked: those that it would be given."""
    found: dict[str, Any] = {"position": new.position, "velocity": new.velocity}
    found |= {"radius": new.radius} if has_radii(scene) else {}
    return found | {name: values for name, values in new.columns.items() if name != MASS.name or has_masses(scene)}


def _brought(terms: Terms, column: Column, value: ArrayLike, count: int, how: str) -> Floats:
    """What was given of a column, one row each; how: what the caller does, in words."""
    if column not in columns_of(terms.scene):
        raise InputError(
            f"{column.name} can be {how} only in a scene {column.scenes}, and got {checks.brief(value)}. "
            f"{column.remedy}"
        )
    values = column.one_each(value, count)
    checks.fitting(column.name, values, terms.settings.precision)
    return values


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
    return terms._replace(settings=replace(terms.settings, workers=settings.workers))


def demand_apart(solver: Solver, new: NewDiscs) -> None:
    """Refuse new discs that overlap discs that are there, or each other."""
    state = solver.state()
    position = np.concatenate([state.position[state.present].astype(np.float64), new.position])
    radius = np.concatenate([solver.radii[state.present], new.radius])
    for index, own in enumerate(new.position):
        at = len(position) - len(new.position) + index
        gap = np.hypot(*to_nearest_image(position - own, solver.terms.scene).T) - radius - new.radius[index]
        gap[at] = np.inf
        if gap.min() < 0:
            raise InputError(
                f"position[{index}] must be free for overlap='refuse'; got {tuple(own.tolist())}, where a disc is "
                f"{-gap.min():.3g} too near. Choose another place, or overlap='allow'."
            )


def demand_whole_frame(solver: Solver, what: str) -> None:
    """Refuse a change inside a frame, in which Ctrl-C may leave the exact solver."""
    end = solver.terms.time_of(solver.frame)
    if solver.time != end:
        raise InputError(
            f"{what} must be called between two frames; got time {solver.time:g}, and frame {solver.frame} ended at "
            f"{end:g}: an interrupt has left the run inside a frame. Finish it by run(frames=1) before."
        )


def checked_set(
    solver: Solver,
    ids: ArrayLike,
    position: ArrayLike | None,
    velocity: ArrayLike | None,
    acceleration: ArrayLike | None,
    others: Mapping[str, Any],
) -> Change:
    """`Simulation.set`, checked."""
    settable = [column for column in given() if column is not MASS]
    check_names("Simulation.set", others, ("ids", "position", "velocity", "acceleration"), settable)
    numbers = _present_numbers(solver, ids)
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
    for column in settable:
        value = {"acceleration": acceleration, **others}.get(column.name)
        if value is not None:
            values[column.name] = _brought(solver.terms, column, value, count, "set")
    if len(values) == 1:
        names = ", ".join(["position", "velocity", *(column.name for column in settable)])
        raise InputError(f"set needs something to set, one of {names}; got none of them. Give one.")
    return made(solver, SET, values)


def checked_kick(solver: Solver, ids: ArrayLike, impulse: ArrayLike) -> Change:
    """`Simulation.kick`, checked."""
    numbers = _present_numbers(solver, ids)
    impulses = _pairs("impulse", impulse, len(numbers), solver)
    change = made(solver, KICK, {"ids": numbers, "impulse": impulses})
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


def checked_remove(solver: Solver, ids: ArrayLike) -> Change:
    """`Simulation.remove`, checked."""
    return made(solver, REMOVE, {"ids": _present_numbers(solver, ids)})


def checked_parameters(solver: Solver, start: Scene, given: Mapping[str, Any]) -> Change:
    """`Simulation.change`, checked but for speeds, and for what `in_force` checks."""
    if "obstacles" not in given:
        return made(solver, PARAMETERS, plain(given))
    there = [each for each in listed(given["obstacles"]) if not isinstance(each, Removed)]
    return _checked_obstacles(solver, start, PARAMETERS, plain({**given, "obstacles": there}))


def checked_wall(solver: Solver, start: Scene, wall: ArrayLike | Obstacle) -> Change:
    """`Simulation.add_wall`, checked."""
    (obstacle,) = listed(_obstacle(wall))
    return _checked_obstacles(solver, start, WALL, {"wall": obstacle})


def _obstacle(wall: Any) -> Obstacle:
    """An obstacle, or the Polyline that points make."""
    return wall if isinstance(wall, Obstacle) else Polyline(wall)


def checked_move(solver: Solver, start: Scene, wall: int, motion: Movement | None) -> Change:
    """`Simulation.move_wall`, checked."""
    values: dict[str, Any] = {"wall": _present_wall(solver.terms.scene, wall)}
    return _checked_obstacles(solver, start, MOVE_WALL, values | ({"motion": motion} if motion else {}))


def checked_removal(solver: Solver, start: Scene, wall: int) -> Change:
    """`Simulation.remove_wall`, checked."""
    return _checked_obstacles(solver, start, REMOVE_WALL, {"wall": _present_wall(solver.terms.scene, wall)})


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


def _present_wall(scene: Scene, wall: int) -> int:
    """The number of an obstacle that is there."""
    there = [number for number, each in enumerate(scene.obstacles) if not isinstance(each, Removed)]
    if isinstance(wall, bool) or not isinstance(wall, numbers.Integral) or int(wall) not in there:
        raise InputError(
            f"wall must be the number of an obstacle that is there, as sim.add_wall returns it; got {wall!r:.60}, and "
            f"there are {checks.brief(there)}. It is the index in sim.scene.obstacles."
        )
    return int(wall)


def _present_numbers(solver: Solver, ids: ArrayLike) -> NDArray[np.int64]:
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
    times = np.bincount(numbers)
    for twice in np.flatnonzero(times > 1).tolist()[:1]:
        raise InputError(f"ids must hold each disc once; disc {twice} is in it {times[twice]} times.")
    if (gone := solver.absorbed[numbers]).any():
        raise InputError(
            f"ids must be discs that are there; disc {numbers[gone][0]} has been removed, or has left through an "
            "absorbing edge. sim.state.present says which discs are there."
        )
    numbers.flags.writeable = False
    return numbers


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
        for column in given():
            if column.name in values:
                columns[column.name] = np.asarray(values[column.name], columns[column.name].dtype)
    return NewDiscs(position, velocity, discs.radius, columns)
