"""The shared block of the exact solver: scenes it takes, their features, its arrays and snapshots."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.columns import Column
from mpsim.core.state import State
from mpsim.engine.solvers import base
from mpsim.engine.solvers.base import (
    NewDiscs,
    Origin,
    SolverState,
    Terms,
    check_periods,
    check_shapes,
    count_in,
    demand,
)
from mpsim.engine.solvers.event_tiles import WHOLE, Tiling, lay_out, packed, specs_of, tiling_of
from mpsim.engine.workers.shared import SharedBlock, Specs
from mpsim.errors import InputError, StalledError
from mpsim.features.baths import probability_of
from mpsim.features.capsules import lists_of_cells
from mpsim.features.edges import EDGES
from mpsim.features.feature import gravity_strength, is_inelastic, thermal_speed
from mpsim.features.obstacles import OBSTACLES, surfaces_near
from mpsim.features.piston import PISTON
from mpsim.features.properties import has_radii
from mpsim.kernels.events import cells as stores
from mpsim.kernels.events import records, solver
from mpsim.kernels.events.cells import COARSE, Box, plan_cells
from mpsim.kernels.events.features.hooks import features_of
from mpsim.kernels.events.features.laws import ImpactFriction
from mpsim.kernels.features import collisions
from mpsim.kernels.features.bodies import Bodies, MovingWalls
from mpsim.kernels.features.capsules import Capsules
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

# --- Scenes for the exact solver: which are unsupported, and the units and times derived from a scene

GUARD = 1e-6
"""The contact-time guard, as a fraction of the time in which a typical disc moves the smallest radius: an impact so
soon after the last one loses no energy. Small against any time between collisions of a gas, large against rounding."""

AT_REST = 0.02
"""A contact time for scenes that come to rest, likewise: most then reach the end of a run, and a disc that hovers in
such bounces rises by less than a ten-thousandth of its radius."""

CRUSHING = 1e4
"""So many times as fast as any disc at the start is one to which a wall that moves leaves no room: the gap in which it
bounces is then a ten-thousandth of what it was."""

LONGEST = 1e100  # frame that is taken at most [time], and one over the slowest scene [length/time]

MOST_CROSSINGS = 1e10
"""Crossings of the box by a disc in one frame: some minutes of them, in the smallest scene."""


ROUNDING = 1e-12
"""Depth of an overlap, in diameters of the largest disc, up to which a start counts as touching."""


def refuse_what_is_not_exact(scene: Scene, settings: Settings) -> None:
    """Raise InputError for what the exact solver cannot do exactly, by name."""
    refused = [
        "law='reflect', which acts on discs that separate" if settings.law == "reflect" else "",
        "precision='float32'" if settings.precision != "float64" else "",
        *(feature.not_exact for feature in scene._features),
    ]
    for what in filter(None, refused):
        raise InputError(f"method='event' cannot do {what}. Leave it out, or use method='grid'.")
    refuse_extremes(scene, scene.velocity, settings.dt)
    contact_time, longest = settings.contact_time, longest_contact_time(scene)
    if contact_time is not None and contact_time > longest:
        raise InputError(
            f"contact_time must be at most {longest:.3g} in this scene: with a longer one, discs that should rest "
            f"under gravity of {gravity_strength(scene):.3g} bounce higher than their radius, "
            f"{scene.smallest_radius:.3g}; got {contact_time:.3g}. Give a shorter one, such as "
            f"{contact_time_at_rest(scene):.1g}."
        )


def refuse_extremes(scene: Scene, velocity: NDArray[np.floating], dt: float) -> None:
    """Raise InputError for speeds whose squares vanish, and frames so long that no run would reach their end.

    velocity: of all discs, shape (N, 2) [length/time].
    """
    if dt > LONGEST:
        raise InputError(f"dt must be at most {LONGEST:g} for method='event'; got {dt:g}. Choose other units of time.")
    fastest = float(np.abs(velocity).max(initial=0.0))
    if 0 < fastest < 1 / LONGEST:
        raise InputError(
            f"velocity must be at least {1 / LONGEST:g} for method='event', or all zero, so that squares do not "
            f"vanish; the fastest is {fastest:g}. Choose other units of time."
        )
    fall = math.sqrt(gravity_strength(scene) * scene.height)
    push = 2 * scene._driving_speed
    crossings = (fastest + fall + push) * dt / max(scene.width, scene.height)
    if crossings > MOST_CROSSINGS and fastest < LONGEST:  # which is refused with its disc
        raise InputError(
            f"dt must be short enough for method='event' to end a frame: one of {dt:g} would take the fastest disc "
            f"{crossings:.3g} times through the box; at most {MOST_CROSSINGS:g} are tried. Use a smaller dt."
        )


def units_of(scene: Scene, dt: float) -> tuple[float, float]:
    """Units of sums of impulses [mass length/time] and of virials [mass length^2/time]: powers of two."""
    diameter = 2 * scene.largest_radius or 1.0
    mass = float(scene.masses.max(initial=0.0)) or 1.0
    impulse = mass * (max(_typical_speed(scene), scene._driving_speed) or diameter / dt)
    coarse = math.ldexp(COARSE, math.frexp(impulse)[1])
    return coarse, math.ldexp(coarse, math.frexp(diameter)[1])


def contact_time_at_rest(scene: Scene, dt: float = 1.0) -> float:
    """A contact time with which most scenes that come to rest reach the end of a run [time]."""
    return AT_REST * _time_of_a_radius(scene, dt)


def longest_contact_time(scene: Scene) -> float:
    """A contact time in which a bounce under gravity is as high as the smallest radius; inf without gravity [time]."""
    gravity, radius = gravity_strength(scene), scene.smallest_radius
    return math.sqrt(8 * radius / gravity) if gravity and radius else math.inf


def crushing_speed_of(scene: Scene, velocity: NDArray[np.floating], least: float | None = None) -> float | None:
    """Speed of a disc that surfaces crush or drive without end [length/time]; None where none moves.

    velocity: of discs that are there or come in [length/time]. least: the speed so far.
    """
    if not scene._driving_speed:
        return None
    fall = math.sqrt(2 * gravity_strength(scene) * (scene.width + scene.height))
    fastest = max(_typical_speed(scene), scene._driving_speed, float(np.abs(velocity).max(initial=0.0)), fall)
    return max(CRUSHING * fastest, least or 0.0)


def crushed(scene: Scene, time: float, disc: int, frame: int, now: State, radius: float) -> StalledError:
    """The error for a disc that surfaces have made so fast by a time [time], with the state of all then."""
    name, what, speed = "obstacle", "an obstacle that moves", math.hypot(*now.velocity[disc].tolist())
    fast = f"a speed of {speed:.3g}, more than {CRUSHING:g} times any at the start"
    between = " and ".join(
        [*surfaces_near(scene, now.position[disc].astype(np.float64), radius, time), "other discs"][:2]
    )
    if any(feature.running_speed(scene) for feature in scene._features):
        return StalledError(
            f"disc {disc} is driven to {fast}, in frame {frame} between {between}: surfaces that run along themselves "
            "and meet in a corner, or leave no room, do so without end. Use a smaller surface_velocity, wall_friction "
            "or wall_restitution, or keep what runs or moves farther apart."
        )
    for wall in scene._moving_walls[:1]:
        way = "" if math.isinf(wall.rests) else f" and on its way to {wall.record.end:g}"
        name, what = wall.name, f"the {wall.name}, now at {wall.place(time):.6g}{way},"
    return StalledError(
        f"disc {disc} is crushed in frame {frame} between {between}: {what} leaves it no room, and has driven it to "
        f"{fast}. Let the {name} stop earlier, or make room for the discs before it."
    )


def stalled(scene: Scene, dt: float, disc: int, frame: int, contact_time: float) -> StalledError:
    """The error for a disc that collides without end at one instant."""
    what = f"disc {disc} collided without end at one instant of frame {frame}. Time must pass between collisions"
    moving = "".join(f", let the {wall.name} stop earlier" for wall in scene._moving_walls[:1] if wall.speed)
    if not is_inelastic(scene) and scene.gravity is None:
        return StalledError(
            f"{what}, but the disc touches others or walls on all sides, as in a crystal without gaps, and no "
            f"collision takes energy. Give the discs more room (a larger box or a smaller radius){moving}, or use "
            "method='grid'."
        )
    longer = min(max(contact_time_at_rest(scene, dt), 10 * contact_time), longest_contact_time(scene))
    sticky = ", a restitution above 0" if min(scene.restitution, scene.wall_restitution) == 0 else ""
    return StalledError(
        f"{what}; the contact time of the guard is {contact_time:.3g}. Give a longer one, such as "
        f"contact_time={longer:.1g}{sticky} or the discs more room{moving}, or use method='grid'."
    )


def _time_of_a_radius(scene: Scene, dt: float) -> float:
    """Time in which a typical disc moves the smallest radius; dt where nothing moves by itself [time]."""
    speed = _typical_speed(scene)
    return scene.smallest_radius / speed if speed > 0 else dt


def _typical_speed(scene: Scene) -> float:
    """Speed of a typical disc, or of one that has fallen its radius, is emitted, or is in a heat bath [length/time]."""
    squares = float((scene.velocity**2).sum(axis=1).mean()) if scene.count else 0.0
    smallest = scene.smallest_radius
    speeds = [
        math.sqrt(squares + gravity_strength(scene) * smallest),
        *(math.hypot(*np.array(each.velocity)) for each in scene.emitters),
        scene._surface_speed,
        thermal_speed(scene),
    ]
    return max(speeds)


# --- Data of features for the kernels of the exact solver, apart from columns


def given(terms: Terms, cells: tuple[int, int]) -> dict[str, Any]:
    """Numbers, arrays and records by their names in `hooks.Features`, for so many columns and rows of cells."""
    scene, settings, origin = terms
    found: dict[str, Any] = {"capsules": _capsules(scene, cells)} if OBSTACLES.at_rest(scene) else {}
    if bodies := OBSTACLES.bodies(scene, margin=2 * scene.largest_radius):
        bodies["body"]["origin"] = origin.time
        found["bodies"] = Bodies(**bodies)
    for name in ("restitution", "wall_restitution"):
        if getattr(scene, name) < 1:
            found[name] = getattr(scene, name)
    for name in ("friction", "wall_friction"):
        if getattr(scene, name) > 0:
            found[name] = ImpactFriction(getattr(scene, name), scene.tangential_restitution)
    if scene.gravity is not None:
        found["gravity"] = tuple(scene.gravity.tolist())
    if scene.absorbing:
        found["absorbing"] = tuple(edge in scene.absorbing for edge in EDGES)
    if (walls := scene.thermal_walls) is not None:
        found["thermal_walls"] = walls.by_edge, walls.seed
    if (bath := scene.thermostat) is not None:
        found["thermostat"] = (probability_of(bath, settings.dt), bath.temperature, bath.seed, origin.frame)
    if scene._moving_walls:
        found["moving_wall"] = moving = MovingWalls(**PISTON.walls(scene, np.float64))
        # Their clock begins with their motion: as long as that is 0, the bits are those of any time.
        moving.wall["origin"], moving.wall["start"] = moving.wall["start"] - origin.time, 0.0
    return found


def state_of(scene: Scene, time: float, found: dict[str, NDArray[Any]], radii: NDArray[np.float64]) -> State:
    """The state at a time [time] of discs whose columns are given by name; it takes over these arrays.

    A wall that moves is where it is then, and present discs on it, of these radii [length], are not a rounding beyond.
    Absent discs stay where they left.
    """
    absorbed = base.absorbed_in(found, len(radii))
    for wall in scene._moving_walls:
        least, most = (limit[..., wall.axis] for limit in scene.limits(radii, time))
        along = found["position"][:, wall.axis]
        np.clip(along, least, most, out=along, where=~absorbed)
    return base.state_of(found, absorbed, scene._box_at(time))


def _capsules(scene: Scene, cells: tuple[int, int]) -> Capsules:
    """The scene's capsules, listed by cells."""
    arrays = OBSTACLES.at_rest(scene)
    lists, shift = lists_of_cells(arrays["capsule"], (scene.width, scene.height), scene.largest_radius, cells)
    around = arrays.get("around")
    return Capsules(arrays["capsule"], None, lists.near, lists.listed, lists.grid, None, around, shift)


# --- Snapshots of the exact solver: their content, and checks of it

SLACK = 1e-6  # fraction of a cell by which rounding may have put a centre beyond its limit

PARTNER = (records.EVENT.names or ()).index("partner")

CRUSHING_SPEED = "crushing_speed"  # that of a scene with a wall that moves [length/time], by name, shape (1,)
_SAVED_AS = {"image": "winding"}  # columns that have another name in a snapshot

# --- columns


def columns_in(scene: Scene) -> list[Column]:
    """Columns of the exact solver's discs, which lie in its block in the order of its own numbers."""
    return [Column("radius", "radius", kept=False, in_state=False)] * has_radii(scene) + scene._columns


def column_shapes(scene: Scene, count: int) -> Specs:
    """dtype and shape of the array of each in the block."""
    return {each.name: (each.dtype(np.dtype(np.float64)), (count, *each.components)) for each in columns_in(scene)}


def _saved_columns(scene: Scene) -> dict[str, str]:
    """Those that a snapshot holds: name there -> name of the array."""
    return {_SAVED_AS.get(each.name, each.name): each.name for each in columns_in(scene) if each.kept}


def cells_for(scene: Scene, count: int) -> tuple[int, int]:
    """Columns and rows of cells for so many discs, and for obstacles as for discs: short lists of both."""
    return plan_cells(scene.width, scene.height, 2 * scene.largest_radius, count + len(scene._capsules_at(0.0)))


# --- a snapshot


def taken(scene: Scene, arrays: dict[str, Any]) -> SolverState:
    """What a snapshot holds of the arrays of a block, discs by number. No radii and masses, and no calendar."""
    place = np.argsort(arrays["event"]["number"])  # of each disc
    by_disc = ("disc", "event")
    found = {name: records.numbers(arrays[name][place] if name in by_disc else arrays[name]) for name in stores.KEPT}
    number = np.append(arrays["event"]["number"], -1)  # of what lies at each place, and of none
    found["event"][:, PARTNER] = number[found["event"][:, PARTNER]]
    found = {name: np.array(values) for name, values in found.items()}
    return found | {saved: arrays[name][place] for saved, name in _saved_columns(scene).items()}


def put_back(scene: Scene, arrays: dict[str, Any], snapshot: SolverState) -> None:
    """Write a snapshot into the arrays of a new block, the calendar aside."""
    for name in stores.KEPT:
        records.numbers(arrays[name])[...] = snapshot[name]
    arrays["event"]["number"] = np.arange(len(arrays["order"]))
    for saved, name in _saved_columns(scene).items():
        arrays[name][...] = snapshot[saved]
    for name, values in (("radius", snapshot["radii"]), ("mass", snapshot["masses"])):
        if name in arrays:
            arrays[name][...] = values[arrays["order"]]


def shapes(scene: Scene, count: int) -> Specs:
    """dtype and shape of the arrays that only snapshots of this method have."""
    layout, columns = stores.layout(count, cells_for(scene, count)), column_shapes(scene, count)
    blank = {name: records.numbers(np.empty(layout[name][1], layout[name][0])) for name in stores.KEPT}
    found: Specs = {name: (array.dtype, array.shape) for name, array in blank.items()}
    found |= {saved: columns[name] for saved, name in _saved_columns(scene).items()}
    totals = records.numbers(np.empty((), records.TOTALS))
    if scene._driving_speed:
        found[CRUSHING_SPEED] = (np.dtype(np.float64), (1,))
    return found | {"seen": (totals.dtype, totals.shape), "units": (np.dtype(np.float64), (2,))}


# --- one from a file


def check(scene: Scene, arrays: SolverState, dt: float) -> None:
    """Raise ValueError unless each number by which kernels index arrays is one of theirs, frames being dt long [time].

    What is only no state of such a scene, as a disc that flies after it has left, is computed as it is.
    """
    check_shapes(arrays, shapes(scene, count_in(arrays)))
    disc, count = records.of_numbers(records.DISC, arrays["disc"]), len(arrays["order"])
    demand(checks.equal(np.sort(arrays["order"]), np.arange(count)), "order must be a permutation")
    flight = ("position", "velocity", "last_update")
    demand(all(np.isfinite(disc[name]).all() for name in flight), "position, velocity and their time must be finite")
    for saved in _saved_columns(scene):
        demand(np.isfinite(arrays[saved]).all(), f"{saved} must be finite")
    times = np.stack([disc["collision_time"], disc["crossing_time"], disc["last_contact"]])
    demand(not np.isnan(times).any(), "times of events must not be NaN")
    demand((times[:2] >= 0).all(), "no event may lie before the present lap")
    demand((np.frexp(arrays["units"])[0] == 0.5).all(), "units of its sums must be powers of two")
    progress = records.of_numbers(records.PROGRESS, arrays["progress"])
    _check_clock(arrays, frame_end=(int(progress.frame) + 1) * dt)
    _check_links(scene, arrays)
    if "winding" in arrays:
        check_periods(scene, arrays["winding"])


def _check_clock(arrays: SolverState, frame_end: float) -> None:
    """frame_end: of the frame in hand [time]."""
    clock = records.of_numbers(records.CLOCK, arrays["clock"])
    steps = stores.layout(len(arrays["order"]), (1, 1))["step_head"][1][0]
    finite = np.isfinite(arrays["clock"]).all()
    demand(finite and clock.origin >= 0 and clock.step > 0, "its clock must be finite, its step > 0")
    whole = np.frexp(clock.step)[0] == 0.5 and clock.lap == clock.step * steps
    demand(whole, "its step must be a power of two, its lap all steps")
    last_update = records.of_numbers(records.DISC, arrays["disc"])["last_update"]
    demand((last_update <= clock.now).all(), "no disc may be ahead of its present")
    in_frame = clock.origin + clock.now <= frame_end * (1 + 1e-9)
    demand(clock.now <= clock.lap and in_frame, "its present must lie in its lap and frame")


def _check_links(scene: Scene, arrays: SolverState) -> None:
    """Whatever one array says of the place of something in another must be a place in it."""
    disc, event = records.of_numbers(records.DISC, arrays["disc"]), records.of_numbers(records.EVENT, arrays["event"])
    count, cells = len(disc), cells_for(scene, len(disc))
    partner, side, cell = event["partner"], event["side"], event["cell"]
    demand(((partner >= -1) & (partner < count)).all(), "partners must be discs")
    meets = disc["collision_time"] < disc["crossing_time"]
    demand(((partner >= 0) & (partner != np.arange(count)))[meets].all(), "an impact must have a partner")
    after_capsules = records.FIRST_CAPSULE + len(OBSTACLES.at_rest(scene).get("capsule", ()))
    known = (side >= 0) & (side < after_capsules) & ((side <= records.TOP) | (side >= records.FIRST_CAPSULE))
    if scene._moving_walls:
        known |= np.isin(side, [records.LOOK, *(records.MOVING_WALL + wall.edge for wall in scene._moving_walls)])
    if bodies := OBSTACLES.bodies(scene):
        known |= (side >= records.LOOK) & (side < records.FIRST_BODY + len(bodies["capsule"]))
    demand(known.all(), "a disc leaves its cell by one of four sides, or meets what is there before")
    for axis, length in enumerate((scene.width, scene.height)):
        along, place = cell[:, axis], disc["position"][:, axis]
        demand(((along >= 0) & (along < cells[axis])).all(), "a disc must be in a cell of the box")
        beyond = np.abs(place * (cells[axis] / length) - (along + 0.5)) - 0.5
        demand((beyond <= max(SLACK * cells[axis], 1e-3)).all(), "a disc must be in its cell")


# --- The shared block of the exact solver: its arrays for a scene, and the arguments of its kernels


class System(NamedTuple):
    """What kernels take of a block: its arrays, the box with its cells, and what the scene has besides."""

    store: Any
    box: Any
    features: Any


class BlockPlan(NamedTuple):
    """What says which arrays a block has, and what stands in those that do not change.

    Attributes:
        terms: in force.
        units: of sums of impulses and of virials [mass length/time], [mass length^2/time].
        contact_time: of the guard [time].
        crushing_speed: of a disc that a wall crushes [length/time]; None without a wall that moves.
        workers: at most, the coordinator included.
        logging: whether collisions are logged.
    """

    terms: Terms
    units: tuple[float, float]
    contact_time: float
    crushing_speed: float | None
    workers: int
    logging: bool

    def room(self, count: int) -> SharedBlock:
        """A block for so many discs, which is still to be made."""
        scene, tiling = self.terms.scene, self._tiling(count)
        of_whole: Specs = stores.layout(count, cells_for(scene, count)) | column_shapes(scene, count)
        specs = of_whole | base.work_specs(scene, self.workers)
        if self.logging:
            specs |= base.specs_of(count, self.workers if tiling != WHOLE else 1)
        if tiling != WHOLE:
            laws = packed(self._box(count), features_of(self._given(count)))
            specs |= specs_of(count, tiling, self.workers, of_whole, laws)
        return SharedBlock(specs, alone=tiling == WHOLE or self.workers == 1)

    def placed(self, block: SharedBlock, discs: NewDiscs, time: float) -> System:
        """Make a block, with discs in it that are ready to go at a time [time].

        Raises:
            InputError: for discs that overlap, or are faster than can be computed.
        """
        block.create()
        system = self.system_in(block)
        scene = self.terms.scene
        columns = {each.name: discs.radius if each.name == "radius" else discs.of(each) for each in columns_in(scene)}
        if len(fast := np.flatnonzero(~(np.abs(discs.velocity) < LONGEST).all(axis=1))):
            raise InputError(
                f"velocity[{fast[0]}] must be below 1e100 for method='event'; got "
                f"{discs.velocity[fast[0]].tolist()}. Choose units in which the numbers are smaller."
            )
        stores.place(discs.position, discs.velocity, columns, time, *system)
        first, second, depth = solver.run_task(solver.OVERLAP, *system)
        if depth > ROUNDING * (2 * scene.largest_radius):
            raise InputError(
                "method='event' needs discs that do not overlap; discs "
                f"{first} and {second} overlap by {depth:.3g}, the most of all. Move them "
                "apart, or run a few frames with method='grid' and start from there."
            )
        solver.run_task(solver.SCHEDULE, *system)
        return system

    def system_in(self, block: SharedBlock) -> System:
        """What kernels take of a block."""
        arrays = block.arrays
        store = stores.store_of(arrays)
        count = len(store.order)
        box, features = self._box(count), features_of(arrays | self._given(count))
        features = features._replace(log=collisions.log_of(arrays, 0), work=collisions.work_of(arrays, 0))
        if "tiles" in arrays:
            lay_out(arrays, self._tiling(count), box, self.terms.settings.dt, self.workers, packed(box, features))
        return System(store, box, features)

    def _tiling(self, count: int) -> Tiling:
        scene = self.terms.scene
        if not all(feature.on_tiles for feature in scene._features):
            return WHOLE
        return tiling_of(count, cells_for(scene, count), scene.periodic, self.workers)

    def _box(self, count: int) -> Box:
        scene, (impulse, virial) = self.terms.scene, self.units
        common = 0.0 if has_radii(scene) else scene.largest_radius
        return Box(scene.width, scene.height, *scene.periodic, *cells_for(scene, count), common, impulse, virial)

    def _given(self, count: int) -> dict[str, Any]:
        """What features are given besides arrays of the block."""
        of_scene = given(self.terms, cells_for(self.terms.scene, count))
        return {"contact_time": self.contact_time, "crushing_speed": self.crushing_speed, **of_scene}


def plan_of(scene: Scene, settings: Settings, workers: int) -> BlockPlan:
    """The plan of a scene at its start."""
    units, crushing = units_of(scene, settings.dt), crushing_speed_of(scene, scene.velocity)
    contact_time = settings.contact_time
    if contact_time is None:
        contact_time = GUARD * _time_of_a_radius(scene, settings.dt)
    return BlockPlan(Terms(scene, settings, Origin()), units, contact_time, crushing, workers, logging=False)
