"""Snapshots of the exact solver: their content, and checks of it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.columns import Column
from mpsim.engine.columns import columns_of
from mpsim.engine.solvers.event_scene import crushing_speed_of
from mpsim.engine.solvers.snapshots import MOST_STEPS, REAL, Shapes, Snapshot, check_periods, demand, shapes_in_each
from mpsim.features.obstacles import OBSTACLES
from mpsim.features.radii import has_radii
from mpsim.kernels.events import records
from mpsim.kernels.events import state as stores
from mpsim.kernels.events.cells import plan_cells
from mpsim.scene.scene import Scene

SLACK = 1e-6
"""Fraction of a cell by which rounding may have put a centre beyond its limit."""

PARTNER = (records.EVENT.names or ()).index("partner")

CRUSHING_SPEED = "crushing_speed"
"""That of a scene with a wall that moves [length/time], by name, shape (1,)."""

_SAVED_AS = {"image": "winding"}
"""Columns that have another name in a snapshot."""

# --- columns


def columns_in(scene: Scene) -> list[Column]:
    """Columns of the exact solver's discs, which lie in its block in the order of its own numbers."""
    return [Column("radius", "radius", kept=False, in_state=False)] * has_radii(scene) + columns_of(scene)


def column_shapes(scene: Scene, count: int) -> Shapes:
    """dtype and shape of the array of each in the block."""
    return {each.name: (each.dtype(REAL), (count, *each.components)) for each in columns_in(scene)}


def columns_of_discs(scene: Scene, count: int, values: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Columns of so many discs, from what is known of them by name; the others are zero."""
    found: dict[str, NDArray[Any]] = {}
    for name, (dtype, shape) in column_shapes(scene, count).items():
        given = values.get(name)
        found[name] = np.zeros(shape, dtype) if given is None else given
    return found


def _saved_columns(scene: Scene) -> dict[str, str]:
    """Those that a snapshot holds: name there -> name of the array."""
    return {_SAVED_AS.get(each.name, each.name): each.name for each in columns_in(scene) if each.kept}


def cells_for(scene: Scene, count: int) -> tuple[int, int]:
    """Columns and rows of cells for so many discs, and for obstacles as for discs: short lists of both."""
    return plan_cells(scene.width, scene.height, 2 * scene.largest_radius, count + len(scene.capsules))


# --- a snapshot


def taken(scene: Scene, arrays: dict[str, Any]) -> Snapshot:
    """What a snapshot holds of the arrays of a block, discs by number. No radii and masses, and no calendar."""
    place = np.argsort(arrays["event"]["number"])  # of each disc
    by_disc = ("disc", "event")
    found = {name: records.numbers(arrays[name][place] if name in by_disc else arrays[name]) for name in stores.KEPT}
    number = np.append(arrays["event"]["number"], -1)  # of what lies at each place, and of none
    found["event"][:, PARTNER] = number[found["event"][:, PARTNER]]
    found = {name: np.array(values) for name, values in found.items()}
    return found | {saved: arrays[name][place] for saved, name in _saved_columns(scene).items()}


def put_back(scene: Scene, arrays: dict[str, Any], snapshot: Snapshot) -> None:
    """Write a snapshot into the arrays of a new block, the calendar aside."""
    for name in stores.KEPT:
        records.numbers(arrays[name])[...] = snapshot[name]
    arrays["event"]["number"] = np.arange(len(arrays["order"]))
    for saved, name in _saved_columns(scene).items():
        if saved in snapshot:  # counts of periods are not in files of older versions
            arrays[name][...] = snapshot[saved]
    for name, values in (("radius", snapshot["radii"]), ("mass", snapshot["masses"])):
        if name in arrays:
            arrays[name][...] = values[arrays["order"]]


def crushing_speed_in(scene: Scene, snapshot: Snapshot) -> float | None:
    """The crushing speed of a snapshot [length/time]; None without a wall that moves.

    Files of older versions do not hold it: there it follows from the discs as they are now.
    """
    if CRUSHING_SPEED in snapshot:
        return float(snapshot[CRUSHING_SPEED][0])
    return crushing_speed_of(scene, records.of_numbers(records.DISC, snapshot["disc"])["velocity"])


def shapes(scene: Scene, count: int) -> Shapes:
    """dtype and shape of every array of a snapshot."""
    layout, columns = stores.layout(count, cells_for(scene, count)), column_shapes(scene, count)
    blank = {name: records.numbers(np.empty(layout[name][1], layout[name][0])) for name in stores.KEPT}
    found: Shapes = {name: (array.dtype, array.shape) for name, array in blank.items()}
    found |= {saved: columns[name] for saved, name in _saved_columns(scene).items()}
    totals = records.numbers(np.empty((), records.TOTALS))
    if scene.moving_wall is not None:
        found[CRUSHING_SPEED] = (REAL, (1,))
    return found | shapes_in_each(count) | {"seen": (totals.dtype, totals.shape), "units": (REAL, (2,))}


# --- one from a file


def check(scene: Scene, arrays: Snapshot, dt: float) -> None:
    """Raise ValueError unless discs, events and lists of a snapshot go together, frames being dt long [time]."""
    disc, count = records.of_numbers(records.DISC, arrays["disc"]), len(arrays["order"])
    demand(checks.equal(np.sort(arrays["order"]), np.arange(count)), "order must be a permutation")
    flight = ("position", "velocity", "last_update")
    demand(all(np.isfinite(disc[name]).all() for name in flight), "position, velocity and their time must be finite")
    for saved in _saved_columns(scene):
        demand(saved not in arrays or np.isfinite(arrays[saved]).all(), f"{saved} must be finite")
    times = np.stack([disc["collision_time"], disc["crossing_time"], disc["last_contact"]])
    demand(not np.isnan(times).any(), "times of events must not be NaN")
    demand((times[:2] >= 0).all(), "no event may lie before the present lap")
    units = arrays["units"]
    demand(((units > 0) & (np.frexp(units)[0] == 0.5)).all(), "units of impulses must be powers of two")
    demand(CRUSHING_SPEED not in arrays or arrays[CRUSHING_SPEED][0] > 0, "the crushing speed must be > 0")
    progress = records.of_numbers(records.PROGRESS, arrays["progress"])
    _check_clock(arrays, frame_end=(int(progress.frame) + 1) * dt)
    _check_links(scene, arrays)
    if "winding" in arrays:
        check_periods(scene, arrays["winding"])


def _check_clock(arrays: Snapshot, frame_end: float) -> None:
    """frame_end: of the frame in hand [time]."""
    clock = records.of_numbers(records.CLOCK, arrays["clock"])
    counter = records.of_numbers(records.COUNTER, arrays["counter"])
    steps = stores.layout(len(arrays["order"]), (1, 1))["step_head"][1][0]
    finite = np.isfinite(arrays["clock"]).all()
    demand(finite and clock.origin >= 0 and clock.step > 0, "its clock must be finite, its step > 0")
    whole = np.frexp(clock.step)[0] == 0.5 and clock.lap == clock.step * steps
    demand(whole, "its step must be a power of two, its lap all steps")
    last_update = records.of_numbers(records.DISC, arrays["disc"])["last_update"]
    demand((last_update <= clock.now).all(), "no disc may be ahead of its present")
    in_frame = clock.origin + clock.now <= frame_end * (1 + 1e-9)
    demand(clock.now <= clock.lap and in_frame, "its present must lie in its lap and frame")
    counts = (counter[name] for name in ("pairs", "walls", "guarded", "events", "lap_events", "stall"))
    demand(all(each >= 0 for each in counts) and (arrays["counter"] <= MOST_STEPS).all(), "counts must be >= 0")


def _check_links(scene: Scene, arrays: Snapshot) -> None:
    """Whatever one array says of the place of something in another must be a place in it."""
    disc, event = records.of_numbers(records.DISC, arrays["disc"]), records.of_numbers(records.EVENT, arrays["event"])
    count, cells = len(disc), cells_for(scene, len(disc))
    partner, side, cell = event["partner"], event["side"], event["cell"]
    demand(((partner >= -1) & (partner < count)).all(), "partners must be discs")
    meets = disc["collision_time"] < disc["crossing_time"]
    demand(((partner >= 0) & (partner != np.arange(count)))[meets].all(), "an impact must have a partner")
    after_capsules = records.FIRST_CAPSULE + len(OBSTACLES.arrays(scene).get("capsule", ()))
    known = (side >= 0) & (side < after_capsules) & ((side != records.MOVING_WALL) | (scene.moving_wall is not None))
    demand(known.all(), "a disc leaves its cell by one of four sides, or meets what is there before")
    for axis, length in enumerate((scene.width, scene.height)):
        along, place = cell[:, axis], disc["position"][:, axis]
        demand(((along >= 0) & (along < cells[axis])).all(), "a disc must be in a cell of the box")
        beyond = np.abs(place * (cells[axis] / length) - (along + 0.5)) - 0.5
        demand((beyond <= max(SLACK * cells[axis], 1e-3)).all(), "a disc must be in its cell")
    if "exits" in arrays:
        _check_exits(arrays["exits"], disc)


def _check_exits(exits: NDArray[np.float64], disc: Any) -> None:
    """Discs that have left lie at rest where they did, and nothing more happens to them."""
    demand(((exits[:, 0] == 0) | (exits[:, 0] == 1)).all(), "a disc has left or it has not")
    gone, where = exits[:, 0] == 1, exits[:, 1:]
    to_come = np.stack([disc["collision_time"], disc["crossing_time"]])[:, gone]
    demand(np.isinf(to_come).all(), "a disc that has left must have no event")
    demand((disc["velocity"][gone] == 0).all(), "a disc that has left must be at rest")
    demand((where[~gone] == 0).all(), "only a disc that has left has done so somewhere")
    demand((where[gone] == disc["position"][gone]).all(), "a disc that has left must lie where it did")
