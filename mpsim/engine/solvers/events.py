"""The exact solver as the coordinator sees it: event-driven, one process, float64."""

import math
import time
from typing import Any, ClassVar, NamedTuple

import numpy as np
import psutil
from numpy.typing import NDArray

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.errors import DivergedError, InputError, StalledError
from mpsim.core.sizes import kept_sizes
from mpsim.core.state import State
from mpsim.engine.columns import given_in
from mpsim.engine.frame_count import frames_until
from mpsim.engine.solvers import event_features, event_snapshot
from mpsim.engine.solvers.base import Capabilities, Choice, NewDiscs, Solver
from mpsim.engine.solvers.slices import Slice
from mpsim.engine.solvers.snapshots import Shapes, Snapshot, count_in
from mpsim.engine.workers.arrays import ArraySpec
from mpsim.engine.workers.shared import SharedBlock
from mpsim.features import FEATURES
from mpsim.features.edges import kinds_of
from mpsim.features.radii import has_radii
from mpsim.kernels import layout
from mpsim.kernels import records as stepped
from mpsim.kernels.events import calendar, records, solver, state
from mpsim.kernels.events.boundary import Box
from mpsim.kernels.events.cells import worst_overlap
from mpsim.kernels.events.features.hooks import features_of
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


class System(NamedTuple):
    """What kernels take of a block: its arrays, the box with its cells, and what the scene has besides."""

    store: Any
    box: Any
    features: Any


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
        chosen = settings.contact_time
        self._contact_time = _contact_time(scene, settings.dt) if chosen is None else chosen
        self._events_per_call = 10 * FEWEST_EVENTS
        self._stopped = 0.0
        self._progress: Any = np.zeros((), records.PROGRESS)[()]
        self._seen: Any = np.zeros((), records.TOTALS)[()]
        self._clock: Any = np.zeros(2, np.int64)
        self._system: Any = None
        self._block = self._room(scene.count)

    def start(self) -> None:
        """Make the block with the scene's discs in it, which must not overlap."""
        scene = self._scene
        self._system = self._placed(
            self._block, scene.position, scene.velocity, self._present_columns(given_in(scene)), 0.0
        )
        # Compiles or loads the kernel, so that no frame time contains it, and no wait for Ctrl-C.
        with interrupts_held_back():  # as the stepped solvers do
            self._run_kernel(np.zeros(0, np.int64), np.zeros(0, records.TOTALS), math.inf)

    # --- frames

    def advance(self, frames: int, workers: int, stop: float = math.inf) -> Slice:
        """Run up to `frames` frames, fewer where they are long: after about SECONDS_AT_ONCE it returns.

        At the time `stop` [time] it returns too, inside a frame.

        What was done of an unfinished frame counts for the slice in which it ends.

        Raises:
            DivergedError, StalledError: the solver can then only be closed.
        """
        before, seen = int(self._system.store.counter.pairs), records.numbers(self._seen).copy()
        times = np.zeros(frames, np.int64)
        totals = np.zeros(frames if self.tallied else 0, records.TOTALS)
        done = self._run_kernel(times, totals, stop)
        by_phase = np.zeros((1, done, len(layout.PHASES)), np.int64)
        by_phase[0, :, layout.MOVE] = times[:done]
        contacts = int(self._system.store.counter.pairs) - before
        return Slice(by_phase, contacts, self._tally(totals[:done], seen) if self.tallied else None)

    def _run_kernel(self, times: NDArray[np.int64], totals: NDArray[Any], stop: float) -> int:
        """One call of the kernel. Returns the frames it finished."""
        before, started, most = int(self._system.store.counter.events), time.perf_counter(), len(times)
        # No call among the arguments: in a signal handler after it the process may fork, and the block be another's.
        finished, status, particle = solver.advance_frames(
            *self._system,
            self._settings.dt,
            most,
            self._events_per_call,
            stop,
            self._progress,
            self._seen,
            times,
            totals,
            self._clock,
        )
        if status == records.STOPPED:
            self._stopped = stop
        if status == records.PAUSED:
            done = int(self._system.store.counter.events) - before
            self._fit_events_per_call(done, time.perf_counter() - started)
        if status == records.NOT_FINITE:
            now = self.state()
            place, speed = now.position[particle].tolist(), now.velocity[particle].tolist()
            raise DivergedError(int(particle), self.frame, (place[0], place[1]), (speed[0], speed[1]))
        if status == records.STALLED:
            raise StalledError(
                f"disc {particle} collided without end at one instant of frame {self.frame}. Time must pass between "
                f"collisions; the contact time of the guard is {self._contact_time:.3g}. Give a longer contact_time, "
                "a restitution above 0 or the discs more room, or use method='grid'."
            )
        return int(finished)

    def _fit_events_per_call(self, done: int, seconds: float) -> None:
        """Choose the number of events per call by the time of the last; how a run is cut into calls changes no bit."""
        fitting = done * SECONDS_AT_ONCE / max(seconds, 1e-9)
        self._events_per_call = int(
            max(min(fitting, 2 * self._events_per_call), self._events_per_call / 2, FEWEST_EVENTS)
        )

    def _tally(self, totals: NDArray[Any], seen: NDArray[np.float64]) -> NDArray[Any]:
        """The kernel's counts in the form of the stepped solver's: impulses instead of r.dp, and no overlaps.

        totals: at the end of each frame; seen: those at the start, as plain numbers.
        """
        counts = records.of_numbers(records.TOTALS, np.diff(records.numbers(totals), axis=0, prepend=[seen]))
        tally = np.zeros(len(counts), stepped.COUNTS)
        for name in records.TOTALS.names or ():
            tally[name] = counts[name]
        for name in ("virial", "virial_xx", "virial_xy"):
            tally[name] /= 2 * self._scene.largest_radius or 1.0
        return tally

    def set_tallied(self, tallied: bool) -> None:
        """Have counts returned, or not. The kernel always counts, which costs 1 %."""
        self.tallied = tallied

    # --- state

    @property
    def frame(self) -> int:
        """Frames finished since the start."""
        return int(self._progress.frame)

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
        last_event = float(self._system.store.clock.origin + self._system.store.clock.now)
        return max(self.frame * self._settings.dt, last_event, self._stopped)

    def reached(self, time: float) -> bool:
        """Whether a time [time] has been reached."""
        return time <= self._present

    def state(self) -> State:
        """Synchronised copies at `time`, in the order of the scene's discs. Taking them changes nothing."""
        return event_features.state_of(self._scene, self._present, self._found(), self._radii)

    def _found(self) -> dict[str, NDArray[Any]]:
        """Positions, velocities and all columns but radii and masses, by name."""
        kept = [column.name for column in event_snapshot.columns_in(self._scene) if column.kept]
        store, box, features = self._system
        return state.read_out(store, box, features, self._present, kept)

    @property
    def absorbed(self) -> NDArray[np.bool_]:
        """Which discs have left through an absorbing edge, shape (N,)."""
        if not self._scene.absorbing:
            return np.zeros(self.count, bool)
        return event_features.absorbed_in(self._found(), self.count)

    def add(self, new: NewDiscs, choice: Choice) -> None:
        """Append discs at the present time; refused if they overlap.

        Raises:
            InputError: then nothing was added.
        """
        now = self.state()
        places, speeds = np.concatenate([now.position, new.position]), np.concatenate([now.velocity, new.velocity])
        radii, masses = kept_sizes(self._radii, new.radius), kept_sizes(self._masses, new.mass)
        values = {"radius": new.radius, **new.columns}
        brought = event_snapshot.columns_of_discs(self._scene, len(new.position), values)
        present = self._present_columns({**self._found(), **vars(now)})
        columns = {name: np.concatenate([here, brought[name]]) for name, here in present.items()}
        block = self._room(len(places))
        with block.closed_on_error():
            system = self._placed(block, places, speeds, columns, self._present)
            system.store.counter.guarded = self.guarded  # the guard acts once for the whole run
            # Of a frame in hand, the new store has counted nothing yet.
            counted: Any = np.zeros((), records.TOTALS)[()]
            solver.write_totals(counted, self._system.store)
            seen = records.of_numbers(records.TOTALS, records.numbers(self._seen) - records.numbers(counted))
        self._take(block, system)
        self._radii, self._masses, self._seen = radii, masses, seen

    def _take(self, block: SharedBlock, system: System) -> None:
        """Continue in another block, which is filled, and close the old one; one of them is owned at every moment."""
        old = self._block
        self._system, self._block, self.count = system, block, len(system.store.order)
        old.close()

    @property
    def guarded(self) -> int:
        """Losses of energy that the contact-time guard has suppressed."""
        return int(self._system.store.counter.guarded)

    @property
    def contact_time(self) -> float:
        """Contact time of that guard [time]; 0 where nothing needs it."""
        scene = self._scene
        lossy = scene.restitution < 1 or scene.wall_restitution < 1
        return self._contact_time if lossy or scene.gravity is not None else 0.0

    @property
    def array_names(self) -> tuple[str, ...]:
        """Names of the arrays in the block."""
        return tuple(self._block.specs)

    def resources(self) -> tuple[tuple[int, ...], int]:
        """Resident bytes of this process, and the size of the block."""
        return (psutil.Process().memory_info().rss,), self._block.nbytes

    def close(self) -> None:
        """Remove the block. May be called again."""
        self._system = self._seen = self._clock = None
        self._block.close()

    # --- snapshots

    def snapshot(self) -> Snapshot:
        """Copies of everything that the next event depends on; the calendar follows from the discs' next events."""
        found = event_snapshot.taken(self._scene, self._block.arrays)
        found |= {"radii": self._radii, "masses": self._masses}
        return found | {name: records.numbers(each).copy() for name, each in self._kept.items()}

    @property
    def _kept(self) -> dict[str, Any]:
        """Records beside the block that snapshots hold."""
        return {"progress": self._progress, "seen": self._seen}

    def restore(self, snapshot: Snapshot, choice: Choice, room: int = 0) -> None:
        """Go back, or on, to a snapshot. There are no workers, and room for no more discs than there are."""
        block = self._room(count_in(snapshot))
        with block.closed_on_error():
            block.create()
            event_snapshot.put_back(self._scene, block.arrays, snapshot)
            system = self._system_in(block)
            counter = system.store.counter
            lap_events = int(counter.lap_events)
            calendar.fill(system.store)  # whose order is total: where the calendar keeps an event cannot matter
            counter.lap_events = lap_events
            radii, masses = kept_sizes(snapshot["radii"]), kept_sizes(snapshot["masses"])
        self._take(block, system)
        self.choice, self._radii, self._masses = choice, radii, masses
        for name, each in self._kept.items():
            records.numbers(each)[:] = snapshot[name]
        self._stopped = 0.0  # a stop at which nothing was done yet is met again

    @staticmethod
    def snapshot_shapes(scene: Scene, settings: Settings, count: int) -> Shapes:
        """dtype and shape of every array of a snapshot of so many discs."""
        return event_snapshot.shapes(scene, count)

    @staticmethod
    def check_snapshot(scene: Scene, settings: Settings, snapshot: Snapshot) -> None:
        """Raise ValueError for a snapshot in which no solver can have been, saying why."""
        event_snapshot.check(scene, snapshot, settings.dt)

    # --- the block

    def _room(self, count: int) -> SharedBlock:
        """A block for so many discs, which is still to be made."""
        cells = event_snapshot.cells_for(self._scene, count)
        shapes = state.layout(count, cells) | event_snapshot.column_shapes(self._scene, count)
        return SharedBlock({name: ArraySpec(np.dtype(dtype), shape) for name, (dtype, shape) in shapes.items()})

    def _system_in(self, block: SharedBlock) -> System:
        """What kernels take of a block."""
        scene, arrays = self._scene, block.arrays
        store = state.Store(*(arrays[name] for name in state.Store._fields))
        common = 0.0 if has_radii(scene) else scene.largest_radius
        columns, rows = event_snapshot.cells_for(scene, len(store.order))
        box = Box(scene.width, scene.height, *scene.periodic, columns, rows, common)
        given = {"contact_time": self._contact_time, **event_features.given(scene, (columns, rows))}
        return System(store, box, features_of(scene, arrays | given))

    def _present_columns(self, values: dict[str, Any]) -> dict[str, NDArray[Any]]:
        """Columns of the discs that are there, whose radii and masses are known."""
        known = {"radius": self._radii, "mass": self._masses}
        return event_snapshot.columns_of_discs(self._scene, self.count, values | known)

    def _placed(
        self,
        block: SharedBlock,
        position: NDArray[np.floating],
        velocity: NDArray[np.floating],
        columns: dict[str, NDArray[Any]],
        time: float,
    ) -> System:
        """Make a block, with discs in it that are ready to go."""
        block.create()
        system = self._system_in(block)
        status, particle = state.place(position, velocity, columns, time, *system)
        if status != records.REACHED:
            raise InputError(
                f"velocity[{particle}] must be below 1e100 for method='event'; got {velocity[particle].tolist()}. "
                "Choose units in which the numbers are smaller."
            )
        _refuse_overlap(system, ROUNDING * 2 * self._scene.largest_radius)
        solver.schedule(*system)
        return system


def _refuse_overlap(system: System, rounding: float) -> None:
    """Raise InputError for discs that overlap by more than rounding [length], naming the worst pair."""
    first, second, depth = worst_overlap(*system)
    if depth > rounding:
        raise InputError(
            "method='event' needs discs that do not overlap; discs "
            f"{min(first, second)} and {max(first, second)} overlap by {depth:.3g}, the most of all. Move them "
            "apart, or run a few frames with method='grid' and start from there."
        )


def _refuse_what_is_not_exact(scene: Scene, settings: Settings) -> None:
    """Raise InputError for what the exact solver cannot do exactly, by name."""
    refusals = {
        **{law.not_exact: word == settings.law for word, law in layout.LAWS.items() if law.not_exact},
        "precision='float32'": settings.precision != "float64",
        "unguarded=True": settings.unguarded,
        **{kind.not_exact: True for kind in kinds_of(scene.boundary) if kind.not_exact},
        **{feature.not_exact: feature.is_in(scene) for feature in FEATURES if feature.not_exact},
    }
    for what, present in refusals.items():
        if present:
            raise InputError(f"method='event' cannot do {what}. Leave it out, or use method='grid'.")
    _refuse_extremes(scene, settings.dt)


def _refuse_extremes(scene: Scene, dt: float) -> None:
    """Raise InputError for speeds whose squares vanish, and frames so long that no run would reach their end."""
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


def _contact_time(scene: Scene, dt: float) -> float:
    """The contact time of the guard [time]."""
    squares = float((scene.velocity**2).sum(axis=1).mean()) if scene.count else 0.0
    smallest = scene.smallest_radius
    speeds = [
        math.sqrt(squares + gravity_strength(scene) * smallest),
        *(math.hypot(*np.array(each.velocity)) for each in scene.emitters),
        0.0 if scene.moving_wall is None else abs(scene.moving_wall.speed),
    ]
    speed = max(speeds)
    # Where nothing moves by itself, a fraction of the time of a frame: speeds are those of what is added later.
    return GUARD * (smallest / speed if speed > 0 else dt)
