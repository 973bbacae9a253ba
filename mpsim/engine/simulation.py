"""Simulation: the coordinator. It checks what comes in, runs the frame loop in slices, and hands out copies."""

import math
import warnings
import weakref
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import ArrayLike

from mpsim import checks, placement
from mpsim.engine import methods
from mpsim.engine.exact import ExactSolver
from mpsim.engine.pacing import Pacer
from mpsim.engine.report import Report, phase_seconds
from mpsim.engine.stepped import SteppedSolver
from mpsim.errors import ClosedError, GuardWarning, InputError, OverlapWarning, WorkerDied
from mpsim.interrupts import interrupts_held_back
from mpsim.kernels.layout import PHASES
from mpsim.measure import observables
from mpsim.measure.gathering import Gathering, Run, checked
from mpsim.scene import Scene
from mpsim.settings import Settings
from mpsim.state import MOST_FRAMES, State

MOST_FRAMES_OF_A_RUN = 10**12


class Simulation:
    """A scene being simulated. Use it in a `with` block: leaving it stops the workers and frees the shared memory.

    Args:
        scene: what is simulated.
        settings: how; the defaults if left out.

    Raises:
        SharedMemoryError, WorkerDied: if the block or the workers cannot be had.

    Warns:
        OverlapWarning: if discs of the start overlap.

    >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with Simulation(scene, Settings(dt=0.01, method="grid")) as sim:
    ...     report = sim.run(frames=100)
    ...     sim.frame, round(sim.time, 9), report.frames, report.method
    (100, 1.0, 100, 'grid')
    """

    def __init__(self, scene: Scene, settings: Settings | None = None):
        if not isinstance(scene, Scene):
            raise InputError(f"scene must be an mpsim.Scene; got {type(scene).__name__}. Make one with Scene(...).")
        settings = Settings() if settings is None else settings
        if not isinstance(settings, Settings):
            raise InputError(f"settings must be mpsim.Settings; got {type(settings).__name__}. Use Settings(dt=...).")
        self._scene = scene
        self._settings = settings
        self._check_precision()
        self._last_frame = 0
        choice = methods.choose(scene.count, settings)
        if choice.method != "event":  # which refuses them
            _warn_of_overlaps(scene)
        self._pacer = Pacer(choice.workers, MOST_FRAMES)
        solver = ExactSolver if choice.method == "event" else SteppedSolver
        self._solver: SteppedSolver | ExactSolver = solver(scene, settings, choice)
        self._closing = weakref.finalize(self, self._solver.close)

    def __enter__(self) -> "Simulation":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the workers and free the shared memory. May be called again."""
        if self._closing.alive:
            self._last_frame = self._solver.frame
            self._closing()

    @property
    def scene(self) -> Scene:
        """The scene as it was given (discs added since are not in it)."""
        return self._scene

    @property
    def settings(self) -> Settings:
        """The settings as they were given."""
        return self._settings

    @property
    def frame(self) -> int:
        """Frames done since the start; after `close`, until then."""
        return self._solver.frame if self._closing.alive else self._last_frame

    @property
    def time(self) -> float:
        """Simulated time since the start [time]: frame * dt (of `event` after Ctrl-C inside a frame: a little more)."""
        return self._solver.time if self._closing.alive else self._last_frame * self._settings.dt

    @property
    def count(self) -> int:
        """Number of discs now."""
        return self._open_solver().count

    @property
    def state(self) -> State:
        """Copies of all positions and velocities, in the order of the scene's discs (added ones follow)."""
        return self._open_solver().state()

    @property
    def pids(self) -> list[int]:
        """Process numbers of the worker processes (the coordinator, this process, is not among them)."""
        return self._open_solver().pids

    def digest(self) -> str:
        """Hex digest of the state in the order of the scene's discs: equal digests mean equal bits."""
        return self.state.digest()

    def run(
        self,
        frames: int | None = None,
        *,
        until: float | None = None,
        measures: Iterable[str] | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Report:
        """Run a number of frames, or until a time is reached.

        Args:
            frames: how many, >= 0.
            until: simulated time at which to stop [time]: the first frame that reaches it is the last; not before now.
            measures: names of what to gather along the way, for report.measures: "pressure", "pressure_virial",
                "collision_rate", "overlap", "largest_overlap", "kinetic_energy", "temperature", "speed_kurtosis".
                Gathering never changes the digest; what is not asked for costs nothing.
            progress: called as progress(done, of_frames) about twenty times a second.

        Raises:
            InputError: both or neither of frames and until, or one out of range.
            ClosedError: after `close`.
            DivergedError, WorkerDied, WorkerStalled: the run cannot go on; the simulation is closed.
        """
        solver = self._open_solver()
        frames = self._frames_wanted(frames, until)
        gathering = Gathering(self._measures_wanted(measures), frames)
        with interrupts_held_back():
            solver.record(gathering.counting)
        times, collisions, done = [np.zeros((max(solver.choice.workers), 0, len(PHASES)), np.int64)], 0, 0
        guarded = solver.guarded
        while done < frames:
            workers, size = self._pacer.next_slice(
                min(frames - done, int(min(gathering.frames_to_sample(done), frames)))
            )
            try:
                part = solver.advance(size, workers)
            except Exception:
                self.close()
                raise
            size = part.times.shape[1]
            if size:
                self._pacer.note(workers, size, float(np.median(part.times[0].sum(axis=1))) * 1e-9)
            done += size
            times.append(part.times)
            collisions += part.contacts
            if size:
                gathering.take(part.tally, done, solver.state, self._scene)
            if progress is not None:
                progress(done, frames)
                self._open_solver()  # which says so if the callback has closed the simulation
        frame_seconds, phases = phase_seconds(_side_by_side(times))
        memory, block = solver.resources()
        energy = observables.kinetic_energy(solver.state(), self._scene) if gathering.counting else 0.0
        gathered = gathering.measures(Run(self._scene, solver.count, self._settings.dt, energy))
        guarded = solver.guarded - guarded
        if guarded:
            _warn_of_guard(guarded)
        return Report(frame_seconds, phases, collisions, *self._what_ran(), memory, block, gathered, guarded)

    def add(self, position: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike | None = None) -> None:
        """Add one disc, or several.

        Args:
            position, velocity: shape (2,) or (K, 2); centres inside the box [length], [length/time]. A new disc may
                overlap others: the next frames push them apart.
            acceleration: as position, only in a scene that has it; left out it is zero [length/time^2].

        Raises:
            InputError: naming the argument, its rule and the value received; then nothing was added.
        """
        solver = self._open_solver()
        places = checks.finite_array("position", np.atleast_2d(position), (None, 2), "(2,) or (K, 2)")
        shape, meaning = (len(places), 2), f"({len(places)}, 2), as position has"
        speeds = checks.finite_array("velocity", np.atleast_2d(velocity), shape, meaning)
        kicks = None
        if acceleration is not None:
            if self._scene.acceleration is None:
                raise InputError(
                    "acceleration can be given for added discs only in a scene that has acceleration per disc; this "
                    f"one has none, and got {acceleration!r}. Give the scene acceleration=numpy.zeros((N, 2))."
                )
            kicks = checks.finite_array("acceleration", np.atleast_2d(acceleration), shape, meaning)
        self._scene.check_inside("position", places)
        checks.fitting("velocity", speeds, self._settings.precision)
        before, choice = solver.choice, methods.choose(solver.count + len(places), self._settings)
        try:
            with interrupts_held_back():  # half a growth would be no state at all
                solver.add(places, speeds, kicks, choice)
        except WorkerDied:
            self.close()
            raise
        if choice != before:
            self._pacer = Pacer(choice.workers, MOST_FRAMES)

    def __repr__(self) -> str:
        if not self._closing.alive:
            return f"<Simulation: closed after frame {self.frame}>"
        return (
            f"<Simulation: {self.count} discs by {self._solver.choice.method}, frame {self.frame}, time {self.time:g}>"
        )

    def _check_precision(self) -> None:
        """Refuse a scene whose numbers do not fit the precision of the run."""
        scene, precision = self._scene, self._settings.precision
        checks.fitting("the box", np.array([scene.width, scene.height]), precision)
        # Squares of lengths must not underflow either, nor the time of a step.
        tiny = float(np.finfo(precision).tiny)
        checks.not_vanishing("radius", scene.radius, 1e4 * math.sqrt(tiny), precision)
        checks.not_vanishing("dt / substeps", self._settings.dt / self._settings.substeps, tiny, precision)
        for name in ("velocity", "gravity", "acceleration"):
            if getattr(scene, name) is not None:
                checks.fitting(name, getattr(scene, name), precision)

    def _open_solver(self) -> SteppedSolver | ExactSolver:
        if not self._closing.alive:
            raise ClosedError(
                f"this simulation was closed after frame {self.frame}. A closed simulation has no state. "
                "Use it inside its `with` block, take sim.state before, or make a new one."
            )
        return self._solver

    def _what_ran(self) -> tuple[str, int]:
        """Method and workers for the report; `auto` may have found one worker to be faster."""
        method, workers = self._solver.choice.method, self._pacer.best
        return (
            "grid" if self._settings.method == "auto" and method == "parallel" and workers == 1 else method
        ), workers

    def _measures_wanted(self, measures: Iterable[str] | None) -> tuple[str, ...]:
        names = checked(measures)
        if "pressure_virial" in names and (self._scene.gravity is not None or self._scene.acceleration is not None):
            raise InputError(
                "measures may hold 'pressure_virial' only without gravity and acceleration, which the virial leaves "
                "out; this scene has them. Use 'pressure', the impulses on the walls."
            )
        return names

    def _frames_wanted(self, frames: int | None, until: float | None) -> int:
        if (frames is None) == (until is None):
            raise InputError(f"run needs either frames or until; got frames={frames!r}, until={until!r}.")
        if frames is not None:
            return checks.whole("frames", frames, 0, MOST_FRAMES_OF_A_RUN, "Ask for 0 or more frames.")
        until = checks.non_negative("until", until, "[time]")
        if until < self.time:
            raise InputError(f"until must not lie in the past: the time is {self.time:g}; got {until!r}.")
        # A frame that ends within rounding of `until` reaches it.
        return max(math.ceil(until / self._settings.dt * (1 - 1e-12)) - self.frame, 0)


def _warn_of_overlaps(scene: Scene) -> None:
    pairs, (i, j), depth = placement.overlaps(scene.position, scene.width, scene.height, 2 * scene.radius)
    if pairs:
        warnings.warn(
            f"{pairs} pairs of discs overlap at the start, discs {i} and {j} deepest, by {depth:.3g}. "
            "The first frames push them apart. Give places at least one diameter apart to avoid it.",
            OverlapWarning,
            stacklevel=3,
        )


def _warn_of_guard(guarded: int) -> None:
    warnings.warn(
        f"in {guarded} collisions the contact-time guard suppressed the loss of energy: a disc's last contact was "
        "an instant before, as in inelastic collapse or of a disc at rest. Without it the run would never end.",
        GuardWarning,
        stacklevel=3,
    )


def _side_by_side(times: list[np.ndarray]) -> np.ndarray:
    """Times of all slices, (workers, frames, phases); growth under `auto` may have raised the number of workers."""
    workers = max(part.shape[0] for part in times)
    return np.concatenate([np.pad(part, ((0, workers - len(part)), (0, 0), (0, 0))) for part in times], axis=1)
