"""The exact solver as the coordinator sees it: event-driven, one process, float64."""

from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from mpsim.engine.methods import Choice
from mpsim.engine.report import Slice
from mpsim.engine.shared import SharedBlock
from mpsim.errors import DivergedError, InputError, StalledError
from mpsim.kernels import events, layout
from mpsim.scene import Scene
from mpsim.settings import Settings
from mpsim.state import ArraySpec, State

EVENTS_AT_ONCE = 50_000
"""Events between two looks at Ctrl-C: 25 ms at 10,000 discs, below 0.1 s at a million."""

GUARD = 1e-6
"""The contact-time guard, as a part of the time in which a typical disc moves one radius: an impact so soon after the
last one loses no energy. Small against any time between collisions of a gas, large against rounding."""

ROUNDING = 1e-12
"""Depth of an overlap, in diameters, up to which a start counts as touching."""


class ExactSolver:
    """Runs a scene by `event`: from collision to collision, exact but for the rounding of float64.

    Raises:
        InputError: for a scene or setting that has no exact solution here, naming it, and for overlapping starts.
    """

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        _refuse_what_is_not_exact(scene, settings)
        self.count = scene.count
        self.choice = choice
        self._scene = scene
        self._settings = settings
        self._law = _law_of(scene)
        self._process = psutil.Process()
        self._frame = 0
        self._counting = False
        self._place(scene.position, scene.velocity, 0.0)
        try:
            self._refuse_overlap()
            events.schedule(self._store, self._box, self._law)
            self._play(np.zeros(0, np.int64), None)  # compiles or loads, so that no frame time contains it
        except BaseException:
            self.close()
            raise

    # --- frames

    def advance(self, frames: int, workers: int) -> Slice:
        """Run up to `frames` frames, fewer where they are long: after EVENTS_AT_ONCE events it returns.

        What was done of an unfinished frame counts for the slice in which it ends.

        Raises:
            DivergedError, StalledError: the solver can then only be closed.
        """
        before = int(self._store.counter[events.PAIRS])
        times = np.zeros(frames + 1, np.int64)
        counts = np.zeros((frames + 1, 4))
        times[0], counts[0] = self._unfinished
        done = self._play(times[:frames], counts[:frames] if self._counting else None)
        self._unfinished = times[done], counts[done]
        by_phase = np.zeros((1, done, len(layout.PHASES)), np.int64)
        by_phase[0, :, layout.MOVE] = times[:done]
        contacts = int(self._store.counter[events.PAIRS]) - before
        return Slice(by_phase, contacts, self._tally(counts[:done]) if self._counting else None)

    def _play(self, times: NDArray[np.int64], counts: NDArray[np.float64] | None) -> int:
        """One call of the kernel. Returns the frames it finished."""
        finished, status, particle = events.advance_frames(
            self._store,
            self._box,
            self._law,
            self._settings.dt,
            self._frame,
            len(times),
            EVENTS_AT_ONCE,
            times,
            self._seen,
            counts,
            self._clock,
        )
        self._frame += finished
        if status == events.NOT_FINITE:
            now = self.state()
            place, speed = now.position[particle].tolist(), now.velocity[particle].tolist()
            raise DivergedError(int(particle), self._frame, (place[0], place[1]), (speed[0], speed[1]))
        if status == events.STALLED:
            raise StalledError(
                f"disc {particle} collided without end at one instant of frame {self._frame}. Time must pass between "
                "collisions. Give the discs more room, or use method='grid'."
            )
        return int(finished)

    def _tally(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """The kernel's counts in the form of the stepped solver's: impulses instead of r.dp, and no overlaps."""
        tally = np.zeros((len(counts), layout.TALLIES))
        tally[:, [layout.WALL_X, layout.WALL_Y]] = counts[:, :2]
        tally[:, layout.VIRIAL] = counts[:, 2] / (2 * self._scene.radius)
        tally[:, layout.COLLISION] = counts[:, 3]
        return tally

    def record(self, counting: bool) -> None:
        """Have what measures need handed out from now on, or not. It is always counted: that costs 1 %."""
        self._counting = counting
        if counting:
            tally = self._store.tally
            walls = tally[events.LEFT] + tally[events.RIGHT], tally[events.BOTTOM] + tally[events.TOP]
            self._seen[:] = *walls, tally[events.VIRIAL], self._store.counter[events.PAIRS]

    # --- state

    @property
    def frame(self) -> int:
        """Frames finished since the start."""
        return self._frame

    @property
    def time(self) -> float:
        """The time that has been reached [time]: the end of the last frame, or later if a stop came inside one."""
        present = float(self._store.clock[events.BASE] + self._store.clock[events.NOW])
        return max(self._frame * self._settings.dt, present)

    def state(self) -> State:
        """Synchronised copies at `time`, in the order of the scene's discs. Taking them changes nothing."""
        position, velocity = np.empty((2, self.count, 2))
        events.read_out(self._store, self._box, self._law, self.time, position, velocity)
        return State(position, velocity)

    def add(
        self,
        position: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64] | None,
        choice: Choice,
    ) -> None:
        """Append discs at the present time; refused if they overlap."""
        old, state, time, guarded = self._block, self.state(), self.time, self.guarded
        self.count += len(position)
        places, speeds = np.concatenate([state.position, position]), np.concatenate([state.velocity, velocity])
        try:
            self._place(places, speeds, time)
            self._refuse_overlap()
        except InputError:
            self._block.close()
            self.count -= len(position)
            self._block = old
            self._store = self._store_of(old)
            raise
        events.schedule(self._store, self._box, self._law)
        self._store.counter[events.GUARDS] = guarded
        old.close()

    @property
    def guarded(self) -> int:
        """Losses of energy that the contact-time guard has suppressed."""
        return int(self._store.counter[events.GUARDS])

    def resources(self) -> tuple[tuple[int, ...], int]:
        """Resident bytes of this process, and the size of the block."""
        return (self._process.memory_info().rss,), self._block.nbytes

    @property
    def pids(self) -> list[int]:
        """No worker processes."""
        return []

    def close(self) -> None:
        """Remove the block. May be called again."""
        self._store = self._seen = self._clock = None
        self._block.close()

    # --- the block

    def _place(self, position: NDArray[np.floating], velocity: NDArray[np.floating], time: float) -> None:
        """Put discs into a new block; `schedule` must follow."""
        scene = self._scene
        # A box with walls always has cells; only a periodic one can be too short for them.
        cells: Any = events.plan_cells(scene.width, scene.height, 2 * scene.radius, self.count)
        shapes = events.layout(self.count, cells, ("tally",))
        specs = {name: ArraySpec(np.dtype(dtype), shape) for name, (dtype, shape) in shapes.items()}
        self._block = SharedBlock.create(specs)
        self._store: Any = self._store_of(self._block)
        self._box: Any = events.Box(scene.width, scene.height, False, False, cells[0], cells[1], scene.radius)
        self._seen: Any = np.zeros(4)
        self._clock: Any = np.zeros(2, np.int64)
        self._unfinished = 0, np.zeros(4)
        status, particle = events.place(position, velocity, None, None, time, self._store, self._box)
        if status != events.REACHED:
            raise InputError(
                f"velocity[{particle}] must be below 1e100 for method='event'; got {velocity[particle].tolist()}. "
                "Choose units in which the numbers are smaller."
            )

    @staticmethod
    def _store_of(block: SharedBlock) -> events.Store:
        return events.Store(*(block.arrays.get(name) for name in events.Store._fields))

    def _refuse_overlap(self) -> None:
        first, second, depth = events.worst_overlap(self._store, self._box)
        if depth > ROUNDING * 2 * self._scene.radius:
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
    }
    for what, present in refusals.items():
        if present:
            raise InputError(f"method='event' cannot do {what}. Leave it out, or use method='grid'.")


def _law_of(scene: Scene) -> events.Law:
    """Gravity, restitution and the guard as the kernel takes them; what the scene lacks is None."""
    gravity = None if scene.gravity is None else tuple(scene.gravity.tolist())
    restitution = scene.restitution if scene.restitution < 1 else None
    wall_restitution = scene.wall_restitution if scene.wall_restitution < 1 else None
    pull = 0.0 if gravity is None else float(np.hypot(*gravity))
    speed = float(np.sqrt((scene.velocity**2).sum(axis=1).mean() if scene.count else 0.0 + pull * scene.radius))
    return events.Law(gravity, restitution, wall_restitution, GUARD * scene.radius / speed if speed > 0 else GUARD)
