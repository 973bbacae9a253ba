"""The method event: the exact, event-driven solver in float64."""

import dataclasses
import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.columns import MASS, kept_sizes
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.state import State, part_of
from mpsim.engine.feature_arrays import given_in
from mpsim.engine.solvers import base, event_block
from mpsim.engine.solvers.base import (
    MOST_COUNTED,
    BatchResult,
    Choice,
    CollisionLog,
    NewDiscs,
    SolverState,
    Terms,
    count_in,
    frames_until,
)
from mpsim.engine.solvers.event_block import (
    BlockPlan,
    System,
    crushed,
    crushing_speed_of,
    plan_of,
    refuse_extremes,
    refuse_what_is_not_exact,
    stalled,
)
from mpsim.engine.solvers.event_tiles import TILES, Windows
from mpsim.engine.workers.pool import Team
from mpsim.engine.workers.shared import SharedBlock
from mpsim.engine.workers.worker import load_kernels
from mpsim.errors import DivergedError, StalledError
from mpsim.kernels import records as stepped
from mpsim.kernels.compiling import entry_of
from mpsim.kernels.events import cells, records, solver
from mpsim.kernels.features import collisions
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

SECONDS_AT_ONCE = 0.03
"""Time between two looks at Ctrl-C, about: a turn of the calendar, 0.025 s at a million discs, may come on top."""

FEWEST_EVENTS = 1_000
"""Events between two looks at Ctrl-C at least, so that the Python around a call costs next to nothing."""

VIRIALS = {"virial": records.VIRIAL, "virial_xx": records.VIRIAL_XX, "virial_xy": records.VIRIAL_XY}
"""Entries of a tally, by name in COUNTS."""


class EventSolver(CollisionLog):
    """Runs a scene by `event`: from collision to collision, exact but for the rounding of float64.

    Raises:
        InputError: for a scene or setting that has no exact solution here, naming it.
    """

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        refuse_what_is_not_exact(scene, settings)
        super().__init__(scene, settings, choice)
        self._plan = plan_of(scene, settings, max(choice.workers))
        self._events_per_call = 10 * FEWEST_EVENTS
        self._contacts_of_a_frame = math.inf  # in the last command that finished one
        self._stopped = 0.0
        self._progress: Any = np.zeros((), records.PROGRESS)[()]
        self._seen: Any = np.zeros((), records.TOTALS)[()]
        self._clock: Any = np.zeros(2, np.int64)
        self._system: Any = None
        self._played: Any = None  # the system for whose types `_player` is
        self._windows: Windows | None = None
        self._team = Team(TILES)

    def start(self) -> None:
        columns = {**given_in(self._scene), MASS.name: self.masses}
        discs = NewDiscs(self._scene.position, self._scene.velocity, self.radii, columns)
        with self._team.moving_to(self._plan.room(self.count)) as block:
            system = self._plan.placed(block, discs, 0.0)
            windows = self._windows_on(block, system, self.choice)
        self._take(self._plan, self.choice, system, windows)
        self._count_work_from(base.NO_WORK, 0.0)

    # --- frames

    def advance(self, frames: int, workers: int, stop: float = math.inf, count_enabled: bool = False) -> BatchResult:
        counter = self._system.store.counter
        contacts, guarded = int(counter["pairs"]), int(counter["guarded"])
        seen = records.numbers(self._seen).copy() if count_enabled else None
        times = np.zeros((1 + self._plan.workers, frames), np.int64)
        totals = np.zeros(frames if count_enabled else 0, records.TOTALS)
        stop -= self._origin.time
        windows = self._windows
        if windows is not None and self._contacts_in(frames, stop) < windows.fewest_contacts:
            self._team.pool.assert_alive()
            windows.link()
            windows = None
        done = self._run_kernel(times, totals, stop, windows)
        by_phase = np.zeros((self._plan.workers, done, len(stepped.PHASES)), np.int64)
        by_phase[:, :, stepped.MOVE] = times[1:, :done]
        if self._windows is not None:
            by_phase[:, :, stepped.WAIT] = np.maximum(times[0, :done] - times[1:, :done], 0)
        # What was done of an unfinished frame counts for the call in which it ends.
        counters = None if seen is None else self._counters(totals[:done], seen)
        contacts, guarded = int(counter["pairs"]) - contacts, int(counter["guarded"]) - guarded
        if done:
            self._contacts_of_a_frame = contacts / done
        return BatchResult(by_phase, contacts, counters, guarded, logged=self.logging)

    def _contacts_in(self, frames: int, stop: float) -> float:
        """Collisions that so many frames will have until a stop [time], if they are as in the last command."""
        return min(frames, (stop - self._present) / self._settings.dt) * self._contacts_of_a_frame

    def _run_kernel(self, times: NDArray[np.int64], totals: NDArray[Any], stop: float, windows: Windows | None) -> int:
        """One call of the kernel, on tiles or, without windows, as a whole. Returns the frames it finished."""
        if windows is None:
            finished, status, particle = self._play_whole(times, totals, stop)
            times[1] = times[0]
        else:
            kept = self._present, self._progress, self._seen
            finished, status, particle = windows.play(times, totals, stop, *kept)
        if status == records.STOPPED:
            self._stopped = stop
        if status == records.NOT_FINITE:
            raise self._not_followed(int(particle))
        if status == records.STALLED:
            raise stalled(self._scene, self._settings.dt, int(particle), self.frame, self._plan.contact_time)
        return int(finished)

    def _not_followed(self, disc: int) -> DivergedError | StalledError:
        """Why a disc could not be followed: it is not finite, or a wall that moves crushes it."""
        now = self.state()
        place, velocity = now.position[disc].tolist(), now.velocity[disc].tolist()
        if np.isfinite([place, velocity]).all():
            return crushed(self._scene, self.time, disc, self.frame, now, float(self.radii[disc]))
        return DivergedError(disc, self.frame, (place[0], place[1]), (velocity[0], velocity[1]))

    def _play_whole(self, times: NDArray[np.int64], totals: NDArray[Any], stop: float) -> tuple[int, int, float]:
        """Play the box as a whole, in this process: as `run_events`."""
        before, started = int(self._system.store.counter["events"]), time.perf_counter()
        # No call among the arguments: in a signal handler after it the process may fork, and the block be another's.
        call = (solver.PLAY, *self._system, self._settings.dt, times.shape[1], self._events_per_call, stop)
        call += self._progress, self._seen, times[0], totals, self._clock
        if self._played is not self._system:
            self._player, self._played = entry_of(solver.run_events, *call), self._system
        outcome = self._player(*call)
        if outcome[1] == records.PAUSED:
            done = int(self._system.store.counter.events) - before
            fitting, last = done * SECONDS_AT_ONCE / max(time.perf_counter() - started, 1e-9), self._events_per_call
            self._events_per_call = int(max(min(fitting, 2 * last), last / 2, FEWEST_EVENTS))  # changes no result
        return outcome

    def _counters(self, totals: NDArray[Any], seen: NDArray[np.int64]) -> NDArray[Any]:
        """The kernel's counts in the form of the stepped solver's: impulses instead of r.dp, and no overlaps.

        totals: at the end of each frame; seen: those at the start, as plain numbers.
        """
        counts = records.of_numbers(records.TOTALS, np.diff(records.numbers(totals), axis=0, prepend=[seen]))
        box, tally = self._system.box, np.zeros(len(counts), stepped.COUNTS)
        units = counts["coarse"] + counts["fine"] / 2.0**records.FINE
        tally["wall"] = units[:, : records.VIRIAL] * box.impulse_unit
        for name, entry in VIRIALS.items():
            tally[name] = units[:, entry] * (box.virial_unit / (2 * self._scene.largest_radius or 1.0))
        tally["collisions"] = counts["collisions"]
        return tally

    def log_collisions(self, enabled: bool) -> None:
        stopped = self._stopped
        super().log_collisions(enabled)
        self._stopped = stopped

    def take_collisions(self) -> NDArray[Any]:
        rows = base.emptied(self.block.arrays)
        rows["i"] = self._system.store.order[rows["i"]]
        among_discs = rows["kind"] == collisions.DISC
        rows["j"][among_discs] = self._system.store.order[rows["j"][among_discs]]
        frame, time = self._origin.frame + rows["span"] + 1, self._origin.time + rows["time"]
        return base.table_of(rows, frame, time, self._scene)

    # --- state

    @property
    def frame(self) -> int:
        return self._origin.frame + int(self._progress["frame"])

    @property
    def time(self) -> float:
        frame, dt, present = self.frame, self._settings.dt, self._present
        if frames_until(present, dt) <= frame - self._origin.frame:
            return self.terms.time_of(frame)
        return min(self._origin.time + present, self.terms.time_of(frame + 1))  # beyond its frame only by rounding

    @property
    def _present(self) -> float:
        """The time of the last event, stop or end of a frame, since the origin [time].

        To the bit, where `time` rounds to frames.
        """
        clock = self._system.store.clock
        last_event = float(clock["origin"] + clock["now"])
        return max(int(self._progress["frame"]) * self._settings.dt, last_event, self._stopped)

    def reached(self, time: float) -> bool:
        return time - self._origin.time <= self._present

    def state(self, first: int = 0, last: int | None = None) -> State:
        return part_of(self._whole()[0], first, self.count if last is None else last)

    def _whole(self) -> tuple[State, dict[str, NDArray[Any]]]:
        """The state of all discs, and all columns but radii and masses, by name."""
        kept = [column.name for column in self._scene._columns if column.kept]
        present, (store, box, features) = self._present, self._system
        found = cells.read_out(store, box, features, present, kept)
        return event_block.state_of(self._scene, self._origin.time + present, found, self.radii), found

    def add(self, new: NewDiscs, choice: Choice) -> None:
        now = self.discs()
        places, speeds = np.concatenate([now.position, new.position]), np.concatenate([now.velocity, new.velocity])
        radii, masses = kept_sizes(self.radii, new.radius), kept_sizes(self.masses, new.mass)
        kept = {each.name: np.concatenate([now.of(each), new.of(each)]) for each in self._scene._columns}
        everyone = NewDiscs(places, speeds, radii, {**kept, MASS.name: masses})
        self._place_anew(everyone, choice, self.terms, new.velocity)

    def discs(self, numbers: NDArray[np.int64] | None = None) -> NewDiscs:
        now, there = self._whole()
        columns = {**there, **vars(now)}
        kept = {each.name: columns[each.name] for each in self._scene._columns if each.name in columns}
        found = NewDiscs(now.position, now.velocity, self.radii, {**kept, MASS.name: self.masses})
        return found if numbers is None else found.rows(numbers)

    def set_discs(self, discs: NewDiscs, numbers: NDArray[np.int64] | None = None) -> None:
        if numbers is not None:
            discs = self.discs().with_rows(discs, numbers)
        self._place_anew(discs, self.choice, self.terms, discs.velocity)

    def change_scene(self, terms: Terms, choice: Choice) -> None:
        scene, settings, _ = terms
        if terms == self.terms._replace(settings=dataclasses.replace(self._settings, workers=settings.workers)):
            # Of other workers no event is predicted anew: what goes on has the same bits.
            self.restore(self.snapshot(), choice, terms)
            return
        refuse_what_is_not_exact(scene, settings)
        discs = self.discs()
        self._place_anew(discs, choice, terms, discs.velocity)

    def _place_anew(self, discs: NewDiscs, choice: Choice, terms: Terms, velocity: NDArray[np.floating]) -> None:
        """Continue with these discs under these terms: all that is to come is predicted anew.

        velocity: of the discs that are new or were changed [length/time].

        Raises:
            InputError: if they overlap, or are too fast; then nothing has changed.
        """
        scene, settings, origin = terms
        refuse_extremes(scene, discs.velocity, settings.dt)
        crushing = crushing_speed_of(scene, velocity, self._plan.crushing_speed)
        plan = self._plan._replace(terms=terms, workers=max(choice.workers), crushing_speed=crushing)
        begins = origin != self._origin
        work = self.work.together
        with self._team.moving_to(plan.room(len(discs.position))) as block:
            present = 0.0 if begins else self._present
            system = plan.placed(block, discs, present)
            system.store.counter.guarded = self._system.store.counter.guarded  # which counts for the whole run
            # Of a frame in hand, the new store has counted nothing yet.
            counted: Any = np.zeros((), records.TOTALS)[()]
            solver.write_totals(counted, self._system.store)
            seen = records.of_numbers(records.TOTALS, records.numbers(self._seen) - records.numbers(counted))
            windows = self._windows_on(block, system, choice)
        self._take(plan, choice, system, windows)
        self._count_work_from(work, self.work_unit)
        self.radii, self.masses, self._seen = discs.radius, discs.mass, seen
        if begins:
            self._progress, self._stopped = np.zeros((), records.PROGRESS)[()], 0.0

    def _windows_on(
        self, block: SharedBlock, system: System, choice: Choice, new_workers: bool = False
    ) -> Windows | None:
        """Windows on the tiles of another block, if it has any, with the present workers where there are as many.

        Raises:
            WorkerDiedError, WorkerStalledError, ResourceError: then the state is as it was.
        """
        if "tiles" not in block.specs:
            return None
        with interrupts_held_back():
            load_kernels(block, TILES)
        workers = max(choice.workers)
        before = None if new_workers or 1 + len(self.pids) != workers else self._windows
        if before is not None:  # if a worker dies on the way, none is left, and the box goes on as a whole
            before.link()
            self._windows = None
        pool = self._team.man(workers, choice.processes.start_method, before is None)
        return Windows(pool, block, system)

    def _take(self, plan: BlockPlan, choice: Choice, system: System, windows: Windows | None) -> None:
        """Continue in the block that is next, which is filled, and close the old one."""
        self._system, self._windows, self._plan = system, windows, plan
        self.count: int = len(system.store.order)
        self.choice: Choice = choice
        self._set_terms(plan.terms)
        self._team.take()

    @property
    def contact_time(self) -> float:
        scene = self._scene
        lossy = scene.restitution < 1 or scene.wall_restitution < 1
        return self._plan.contact_time if lossy or scene.gravity is not None else 0.0

    @property
    def most_momentum(self) -> float:
        return MOST_COUNTED * self._plan.units[0]

    @property
    def half_done(self) -> bool:
        return self._windows is not None and self._windows.failed

    def close(self) -> None:
        windows, self._windows = self._windows, None
        if windows is not None:
            windows.close()
        self._system = self._played = self._seen = self._clock = None
        self._team.close()

    def _work_counted(self) -> NDArray[np.int64]:
        return super()._work_counted()[..., collisions.AGREED :, :, :]

    # --- snapshots

    def snapshot(self) -> SolverState:
        if self._windows is not None:
            self._windows.link()
        found = event_block.taken(self._scene, self.block.arrays)
        found |= {"radii": self.radii, "masses": self.masses, "units": np.array(self._plan.units)}
        if self._plan.crushing_speed is not None:
            found[event_block.CRUSHING_SPEED] = np.array([self._plan.crushing_speed])
        return found | {name: records.numbers(each).copy() for name, each in self._kept.items()} | self._saved_work()

    @property
    def _kept(self) -> dict[str, Any]:
        """Records beside the block that snapshots hold."""
        return {"progress": self._progress, "seen": self._seen}

    def restore(self, snapshot: SolverState, choice: Choice, terms: Terms, new_workers: bool = True) -> None:
        refuse_what_is_not_exact(terms.scene, terms.settings)
        impulse, virial = snapshot["units"].tolist()
        kept, workers = snapshot.get(event_block.CRUSHING_SPEED), max(choice.workers)
        crushing = None if kept is None else float(kept[0])
        plan = BlockPlan(terms, (impulse, virial), self._plan.contact_time, crushing, workers, self.logging)
        with self._team.moving_to(plan.room(count_in(snapshot))) as block:
            block.create()
            event_block.put_back(terms.scene, block.arrays, snapshot)
            system = plan.system_in(block)
            solver.run_task(solver.RELINK, *system)
            radii, masses = kept_sizes(snapshot["radii"]), kept_sizes(snapshot["masses"])
            windows = self._windows_on(block, system, choice, new_workers)
        self._take(plan, choice, system, windows)
        self._restore_work(snapshot)
        self.radii: NDArray[np.float64] = radii
        self.masses: NDArray[np.float64] = masses
        for name, each in self._kept.items():
            records.numbers(each)[:] = snapshot[name]
        self._stopped = 0.0  # a stop at which nothing was done yet is met again

    @staticmethod
    def check_snapshot(scene: Scene, settings: Settings, snapshot: SolverState) -> None:
        refuse_what_is_not_exact(scene, settings)
        event_block.check(scene, snapshot, settings.dt)
