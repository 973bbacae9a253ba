"""The exact solver as the coordinator sees it: event-driven, one process, float64."""

import math
import time
from typing import Any, ClassVar

import numpy as np
import psutil
from numpy.typing import NDArray

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.errors import DivergedError, InputError, StalledError
from mpsim.core.state import State
from mpsim.engine.columns import has_masses
from mpsim.engine.feature_arrays import has_radii
from mpsim.engine.frame_count import frames_until
from mpsim.engine.insertion import NewDiscs
from mpsim.engine.solvers.base import Capabilities, Choice, Solver
from mpsim.engine.solvers.event_snapshot import KEPT, arrays_of, check, shapes
from mpsim.engine.solvers.slices import Slice
from mpsim.engine.solvers.snapshots import Shapes, Snapshot, count_in
from mpsim.engine.workers.arrays import ArraySpec
from mpsim.engine.workers.shared import SharedBlock
from mpsim.features import FEATURES
from mpsim.kernels import layout, records
from mpsim.kernels.events import solver as events
from mpsim.measure.driving import gravity_strength
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

SECONDS_AT_ONCE = 0.03
"""Time between two looks at Ctrl-C, about: a turn of the calendar, 0.025 s at a million discs, may come on top."""

FEWEST_EVENTS = 1_000
"""Events between two looks at Ctrl-C at least, so that the Python around a call costs next to nothing."""

GUARD = 1e-6
"""The contact-time guard, as a fraction of the time in which a typical disc moves the smallest radius: an impact so
soon after the last one loses no energy. Small against any time between collisions of a gas, large against rounding."""

LONGEST = 1e100
"""Frame that is taken at most [time], and one over the slowest scene [length/time]."""

MOST_CROSSINGS = 1e10
"""Crossings of the box by a disc in one frame: some minutes of them, in the smallest scene."""

ROUNDING = 1e-12
"""Depth of an overlap, in diameters of the largest disc, up to which a start counts as touching."""


class EventSolver(Solver):
    """Runs a scene by `event`: from collision to collision, exact but for the rounding of float64.

    Raises:
        InputError: for a scene or setting that has no exact solution here, naming it.
    """

    capabilities: ClassVar[Capabilities] = Capabilities(has_steps=False, is_exact=True)
    count: int
    choice: Choice

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        _refuse_what_is_not_exact(scene, settings)
        super().__init__(scene, settings, choice)
        self._law = _law_of(scene, settings.dt)
        self._events_per_call = 10 * FEWEST_EVENTS
        self._stopped = 0.0
        self._progress: Any = np.zeros(2, np.int64)
        self._seen: Any = np.zeros(events.COUNTED)
        self._clock: Any = np.zeros(2, np.int64)
        self._store: Any = None
        self._block, self._box = self._room(scene.count)

    def start(self) -> None:
        """Make the block with the scene's discs in it, which must not overlap."""
        scene = self._scene
        spin = np.zeros(self.count) if scene.spin is None else scene.spin
        discs = scene.position, scene.velocity, self._radii, self._masses, spin
        self._store = self._placed(self._block, self._box, *discs, 0.0)
        # Compiles or loads the kernel, so that no frame time contains it, and no wait for Ctrl-C.
        with interrupts_held_back():  # as the stepped solvers do
            self._run_kernel(np.zeros(0, np.int64), np.zeros((0, events.COUNTED)), math.inf)

    # --- frames

    def advance(self, frames: int, workers: int, stop: float = math.inf) -> Slice:
        """Run up to `frames` frames, fewer where they are long: after about SECONDS_AT_ONCE it returns.

        At the time `stop` [time] it returns too, inside a frame.

        What was done of an unfinished frame counts for the slice in which it ends.

        Raises:
            DivergedError, StalledError: the solver can then only be closed.
        """
        before = int(self._store.counter[events.PAIRS])
        times = np.zeros(frames, np.int64)
        counts = np.zeros((frames if self.tallied else 0, events.COUNTED))
        done = self._run_kernel(times, counts, stop)
        by_phase = np.zeros((1, done, len(layout.PHASES)), np.int64)
        by_phase[0, :, layout.MOVE] = times[:done]
        contacts = int(self._store.counter[events.PAIRS]) - before
        return Slice(by_phase, contacts, self._tally(counts[:done]) if self.tallied else None)

    def _run_kernel(self, times: NDArray[np.int64], counts: NDArray[np.float64], stop: float) -> int:
        """One call of the kernel. Returns the frames it finished."""
        before, started, most = int(self._store.counter[events.EVENTS]), time.perf_counter(), len(times)
        # No call among the arguments: in a signal handler after it the process may fork, and the block be another's.
        finished, status, particle = events.advance_frames(
            self._store,
            self._box,
            self._law,
            self._settings.dt,
            most,
            self._events_per_call,
            stop,
            self._progress,
            self._seen,
            times,
            counts,
            self._clock,
        )
        if status == events.STOPPED:
            self._stopped = stop
        if status == events.PAUSED:
            self._fit_events_per_call(int(self._store.counter[events.EVENTS]) - before, time.perf_counter() - started)
        if status == events.NOT_FINITE:
            now = self.state()
            place, speed = now.position[particle].tolist(), now.velocity[particle].tolist()
            raise DivergedError(int(particle), self.frame, (place[0], place[1]), (speed[0], speed[1]))
        if status == events.STALLED:
            raise StalledError(
                f"disc {particle} collided without end at one instant of frame {self.frame}. Time must pass between "
                "collisions. Give the discs more room, or use method='grid'."
            )
        return int(finished)

    def _fit_events_per_call(self, done: int, seconds: float) -> None:
        """Choose the number of events per call by the time of the last; how a run is cut into calls changes no bit."""
        fitting = done * SECONDS_AT_ONCE / max(seconds, 1e-9)
        self._events_per_call = int(
            max(min(fitting, 2 * self._events_per_call), self._events_per_call / 2, FEWEST_EVENTS)
        )

    def _tally(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """The kernel's counts in the form of the stepped solver's: impulses instead of r.dp, and no overlaps."""
        tally = np.zeros(len(counts), records.COUNTS)
        tally["wall"] = counts[:, [events.LEFT, events.RIGHT, events.BOTTOM, events.TOP]]
        virials = {"virial": events.VIRIAL, "virial_xx": events.VIRIAL_XX, "virial_xy": events.VIRIAL_XY}
        for name, column in virials.items():
            tally[name] = counts[:, column] / (2 * self._scene.largest_radius or 1.0)
        tally["collisions"] = counts[:, events.TALLIES]
        return tally

    def set_tallied(self, tallied: bool) -> None:
        """Have counts returned, or not. The kernel always counts, which costs 1 %."""
        self.tallied = tallied

    # --- state

    @property
    def frame(self) -> int:
        """Frames finished since the start."""
        return int(self._progress[events.FRAME])

    @property
    def time(self) -> float:
        """The time that has been reached [time]: the end of the last frame, or later if a stop came inside one."""
        frame, dt, present = self.frame, self._settings.dt, self._present
        if frames_until(present, dt) <= frame:
            return frame * dt
        return min(present, (frame + 1) * dt)  # beyond its frame only by rounding

    @property
    def _present(self) -> float:
        """The time of the last event, stop or end of a frame [time]: to the bit, where `time` rounds to frames."""
        last_event = float(self._store.clock[events.BASE] + self._store.clock[events.NOW])
        return max(self.frame * self._settings.dt, last_event, self._stopped)

    def reached(self, time: float) -> bool:
        """Whether a time [time] has been reached."""
        return time <= self._present

    def state(self) -> State:
        """Synchronised copies at `time`, in the order of the scene's discs. Taking them changes nothing."""
        position, velocity = np.empty((2, self.count, 2))
        image = np.zeros((self.count, 2), np.int64) if any(self._scene.periodic) else None
        events.read_out(self._store, self._box, self._law, self._present, position, velocity, image)
        spin = None
        if self._store.spin is not None:
            spin = np.empty(self.count)
            spin[self._store.order] = self._store.spin
        return State(position, velocity, image=image, spin=spin, box=self._scene.box)

    def add(self, new: NewDiscs, choice: Choice) -> None:
        """Append discs at the present time; refused if they overlap.

        Raises:
            InputError: then nothing was added.
        """
        state = self.state()
        places, speeds = np.concatenate([state.position, new.position]), np.concatenate([state.velocity, new.velocity])
        radii, masses = np.concatenate([self._radii, new.radius]), np.concatenate([self._masses, new.mass])
        given: NDArray[np.floating] = np.zeros(len(new.position)) if new.spin is None else new.spin
        spin = np.concatenate([np.zeros(self.count) if state.spin is None else state.spin, given])
        block, box = self._room(len(places))
        with block.closed_on_error():
            store = self._placed(block, box, places, speeds, radii, masses, spin, self._present)
            if state.image is not None:
                store.winding[:] = np.concatenate([state.image, new.image])[store.order]
            store.counter[events.GUARDS] = self.guarded  # the guard acts once for the whole run
            # Of a frame in hand, the new store has counted nothing yet.
            seen = self._seen - np.array([*self._store.tally, self._store.counter[events.PAIRS]])
        self._take(block, store, box)
        self._radii, self._masses, self._seen = radii, masses, seen

    def _take(self, block: SharedBlock, store: Any, box: Any) -> None:
        """Continue in another block, which is filled, and close the old one; one of them is owned at every moment."""
        old = self._block
        self._store, self._block, self._box, self.count = store, block, box, len(store.order)
        old.close()

    @property
    def guarded(self) -> int:
        """Losses of energy that the contact-time guard has suppressed."""
        return int(self._store.counter[events.GUARDS])

    @property
    def array_names(self) -> tuple[str, ...]:
        """Names of the arrays in the block."""
        return tuple(self._block.specs)

    def resources(self) -> tuple[tuple[int, ...], int]:
        """Resident bytes of this process, and the size of the block."""
        return (psutil.Process().memory_info().rss,), self._block.nbytes

    def close(self) -> None:
        """Remove the block. May be called again."""
        self._store = self._seen = self._clock = None
        self._block.close()

    # --- snapshots

    def snapshot(self) -> Snapshot:
        """Copies of everything that the next event depends on; the calendar follows from the discs' next events."""
        found = {name: self._block.arrays[name].copy() for name in KEPT if name in self._block.specs}
        found |= {"radii": self._radii.astype(float), "masses": self._masses.astype(float)}
        return found | {"progress": self._progress.copy(), "seen": self._seen.copy()}

    def restore(self, snapshot: Snapshot, choice: Choice, new_workers: bool, room: int = 0) -> None:
        """Go back, or on, to a snapshot. There are no workers, and room for no more discs than there are."""
        count = count_in(snapshot)
        block, box = self._room(count)
        with block.closed_on_error():
            block.create()
            store = _store_of(block)
            for name in KEPT:
                if name in snapshot:  # winding is not in scenes with walls, nor in files of older versions
                    block.arrays[name][...] = snapshot[name]
            for name, values in (("radius", snapshot["radii"]), ("mass", snapshot["masses"])):
                if name in block.arrays:
                    block.arrays[name][...] = values[store.order]
            lap_events = int(store.counter[events.LAP_EVENTS])
            events.fill(store)  # whose order is total, so that it does not matter where the calendar keeps an event
            store.counter[events.LAP_EVENTS] = lap_events
            radii, masses = snapshot["radii"].copy(), snapshot["masses"].copy()
        self._take(block, store, box)
        self.choice, self._radii, self._masses = choice, radii, masses
        self._progress[:], self._seen[:] = snapshot["progress"], snapshot["seen"]
        self._stopped = 0.0  # a stop at which nothing was done yet is met again

    @staticmethod
    def snapshot_shapes(scene: Scene, settings: Settings, count: int) -> Shapes:
        """dtype and shape of every array of a snapshot of so many discs."""
        return shapes(scene, count)

    @staticmethod
    def check_snapshot(scene: Scene, settings: Settings, snapshot: Snapshot) -> None:
        """Raise ValueError for a snapshot in which no solver can have been, saying why."""
        check(scene, snapshot, frame_end=(int(snapshot["progress"][events.FRAME]) + 1) * settings.dt)

    # --- the block

    def _room(self, count: int) -> tuple[SharedBlock, Any]:
        """A block for so many discs, which is still to be made, and the box as the kernel takes it."""
        scene = self._scene
        each = arrays_of(scene)
        # A scene has room for two discs along a periodic axis, so that there always are cells.
        cells: Any = events.plan_cells(scene.width, scene.height, 2 * scene.largest_radius, count, scene.periodic)
        shapes = events.layout(count, cells, [name for name in each if each[name]])
        block = SharedBlock({name: ArraySpec(np.dtype(dtype), shape) for name, (dtype, shape) in shapes.items()})
        common = 0.0 if each["radius"] else scene.largest_radius
        return block, events.Box(scene.width, scene.height, *scene.periodic, cells[0], cells[1], common)

    def _placed(
        self,
        block: SharedBlock,
        box: Any,
        position: NDArray[np.floating],
        velocity: NDArray[np.floating],
        radii: NDArray[np.float64],
        masses: NDArray[np.float64],
        spin: NDArray[np.floating],
        time: float,
    ) -> Any:
        """Make a block, with discs in it that are ready to go; returns its arrays as the kernel takes them."""
        scene = self._scene
        block.create()
        store = _store_of(block)
        own = radii if has_radii(scene) else None, masses if has_masses(scene) else None
        status, particle = events.place(position, velocity, *own, time, store, box, spin)
        if status != events.REACHED:
            raise InputError(
                f"velocity[{particle}] must be below 1e100 for method='event'; got {velocity[particle].tolist()}. "
                "Choose units in which the numbers are smaller."
            )
        _refuse_overlap(store, box, ROUNDING * 2 * scene.largest_radius)
        events.schedule(store, box, self._law)
        return store


def _store_of(block: SharedBlock) -> Any:
    """The arrays of a block as the kernel takes them; None for what the scene has not."""
    return events.Store(*(block.arrays.get(name) for name in events.Store._fields))


def _refuse_overlap(store: events.Store, box: events.Box, rounding: float) -> None:
    """Raise InputError for discs that overlap by more than rounding [length], naming the worst pair."""
    first, second, depth = events.worst_overlap(store, box)
    if depth > rounding:
        raise InputError(
            "method='event' needs discs that do not overlap; discs "
            f"{min(first, second)} and {max(first, second)} overlap by {depth:.3g}, the most of all. Move them "
            "apart, or run a few frames with method='grid' and start from there."
        )


def _refuse_what_is_not_exact(scene: Scene, settings: Settings) -> None:
    """Raise InputError for what the exact solver cannot do exactly, by name."""
    refusals = {
        "law='reflect', which acts on discs that separate": settings.law != "elastic",
        "acceleration per disc, under which two discs do not move uniformly against each other": (
            scene.acceleration is not None
        ),
        "precision='float32'": settings.precision != "float64",
        "unguarded=True": settings.unguarded,
        **{feature.not_exact: feature.is_in(scene) for feature in FEATURES if feature.not_exact},
    }
    for what, present in refusals.items():
        if present:
            raise InputError(f"method='event' cannot do {what}. Leave it out, or use method='grid'.")
    _refuse_extremes(scene, settings.dt)


def _refuse_extremes(scene: Scene, dt: float) -> None:
    """Raise InputError for speeds whose squares vanish, and frames so long that nobody would see their end."""
    if dt > LONGEST:
        raise InputError(f"dt must be at most {LONGEST:g} for method='event'; got {dt:g}. Choose other units of time.")
    fastest = float(np.abs(scene.velocity).max(initial=0.0))
    if 0 < fastest < 1 / LONGEST:
        raise InputError(
            f"velocity must be at least {1 / LONGEST:g} for method='event', or all zero, so that squares do not "
            f"vanish; the fastest is {fastest:g}. Choose other units of time."
        )
    fall = math.sqrt(gravity_strength(scene) * scene.height)
    crossings = (fastest + fall) * dt / max(scene.width, scene.height)
    if crossings > MOST_CROSSINGS and fastest < LONGEST:  # which is refused with its disc
        raise InputError(
            f"dt must be short enough for method='event' to end a frame: one of {dt:g} would take the fastest disc "
            f"{crossings:.3g} times through the box; at most {MOST_CROSSINGS:g} are tried. Use a smaller dt."
        )


def _law_of(scene: Scene, dt: float) -> events.Law:
    """Gravity, restitution and the guard as the kernel takes them; what the scene lacks is None."""
    gravity = None if scene.gravity is None else tuple(scene.gravity.tolist())
    restitution = scene.restitution if scene.restitution < 1 else None
    wall_restitution = scene.wall_restitution if scene.wall_restitution < 1 else None
    squares = float((scene.velocity**2).sum(axis=1).mean()) if scene.count else 0.0
    smallest = scene.smallest_radius
    speeds = [
        math.sqrt(squares + gravity_strength(scene) * smallest),
        *(math.hypot(*np.array(each.velocity)) for each in scene.emitters),
    ]
    speed = max(speeds)
    # Where nothing moves by itself, a fraction of the time of a frame: speeds are those of what is added later.
    guard = GUARD * (smallest / speed if speed > 0 else dt)
    friction, wall_friction = (
        (coefficient, scene.tangential_restitution) if coefficient > 0 else None
        for coefficient in (scene.friction, scene.wall_friction)
    )
    return events.Law(gravity, restitution, wall_restitution, guard, friction, wall_friction)
