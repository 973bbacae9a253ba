"""What a run needs beside the simulation: frames, its record, recovery, size of slices, checkpoints, signals."""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.engine.access import Notices
from mpsim.engine.solvers import base
from mpsim.engine.solvers.base import BatchResult, Ranks, Terms, WorkDone
from mpsim.errors import InputError, WorkerDiedError
from mpsim.kernels.records import PHASES

if TYPE_CHECKING:
    from mpsim.measure.registry import RunAverages

# --- Number of frames of a run


def frames_wanted(frames: int | None, until: float | None, terms: Terms, frame: int, time: float) -> int:
    """Frames of a run from a frame and a time [time] on; frames, until: as `Simulation.run` is given them.

    Raises:
        InputError: both or neither, or one out of range.
    """
    if (frames is None) == (until is None):
        raise InputError(f"run needs either frames or until; got frames={frames!r}, until={until!r}.")
    if frames is not None:
        return checks.whole("frames", frames, 0, base.MOST_FRAMES_OF_A_RUN, "Ask for 0 or more frames.")
    until = checks.non_negative("until", until, "[time]")
    if until < time * (1 - 1e-12):  # as far as rounding can reach
        raise InputError(f"until must not lie in the past: the time is {time:g}; got {until!r}.")
    return max(terms.frame_at(until) - frame, 0)


def frames_skipped(start: float | None, measures: object, frames: int, terms: Terms, frame: int) -> int:
    """Frames at the beginning of a run from `frame` on that are not measured; start, measures: as of `Simulation.run`.

    Raises:
        InputError: without measures, for a start out of range, and for one that leaves no frame to measure.
    """
    if start is None:
        return 0
    start = checks.non_negative("start", start, "[time]")
    if not measures:
        raise InputError(
            f"start needs measures, which are taken from then on; got start={start:g} and none. Name them."
        )
    skipped = max(terms.frame_at(start, "start") - frame, 0)
    if skipped and skipped >= frames:
        end = terms.time_of(frame + frames)
        raise InputError(f"start must lie before the end of the run, at time {end:g}; got {start:g}. Run longer.")
    return skipped


# --- Times and counts that a run has collected so far


class Rewind(NamedTuple):
    """How far a run had come, with what had been gathered for measures, and logged."""

    done: int
    collisions: int
    slices: int
    guarded: int
    gathered: Any
    logged: tuple[NDArray[Any], ...]


class RunRecord:
    """Times, collisions and counts of the frames of a run so far.

    Attributes:
        averages: averages for its measures; None: it has none.
        count_enabled: whether these need what the solver counts.
        guarded: losses of energy that the solver's guard has suppressed.
        done, collisions: frames, and contacts resolved.
        logged: tables of collisions that nobody has taken yet.
        work_before: work that had been done when the run began.
    """

    def __init__(self, workers: int, averages: RunAverages | None, logged: list[NDArray[Any]], work: WorkDone):
        self.averages = averages
        self.count_enabled: bool = averages is not None and averages.counting
        self.guarded: int = 0
        self.done: int = 0
        self.collisions: int = 0
        self.logged: list[NDArray[Any]] = logged
        self.work_before = work
        self._workers = workers
        self._times: list[NDArray[np.int64]] = []

    def take(self, part: BatchResult) -> None:
        """Add what one command of the solver took and counted."""
        size = part.times.shape[1]
        self.done += size
        self._times.append(part.times)
        self.collisions += part.contacts
        self.guarded += part.guarded
        if size and self.averages is not None:
            self.averages.take(part.counters, self.done)

    def mark(self) -> Rewind:
        """How far the run has come, for `rewind`."""
        gathered = None if self.averages is None else self.averages.mark()
        return Rewind(self.done, self.collisions, len(self._times), self.guarded, gathered, tuple(self.logged))

    def rewind(self, mark: Rewind) -> None:
        """Forget what came after a mark."""
        self.done, self.collisions, self.guarded = mark.done, mark.collisions, mark.guarded
        del self._times[mark.slices :]
        if self.averages is not None:
            self.averages.rewind(mark.gathered)
        self.logged[:] = mark.logged

    def take_logged(self, frame: int) -> NDArray[Any]:
        """The collisions up to the end of a frame that nobody has taken yet, in order: TABLE. Later ones stay."""
        table = base.joined(self.logged)
        late = table["frame"] > frame
        self.logged[:] = [table[late]]
        return base.in_order(table[~late])

    @property
    def times(self) -> NDArray[np.int64]:
        """Times of all frames, (workers, frames, phases); growth under `auto` may have raised the number of workers."""
        if len(self._times) == 1 and len(self._times[0]) == self._workers:
            return self._times[0]
        workers = max([self._workers, *(part.shape[0] for part in self._times)])
        times = np.zeros((workers, sum(part.shape[1] for part in self._times), len(PHASES)), np.int64)
        end = 0
        for part in self._times:
            begin, end = end, end + part.shape[1]
            times[: len(part), begin:end] = part
        return times


# --- Recovery after the death of a worker: back to the last snapshot in memory, then on with new workers

SNAPSHOT_FRACTION = 0.01
"""Fraction of the running time that in-memory snapshots may take: the next one waits until the last one's time is so
small a fraction of what has passed since."""

SNAPSHOT_SECONDS = 0.2  # time between two snapshots, at least
MOST_DEATHS = 5  # deaths of workers without a snapshot in between after which there is no use in trying again


def log_death(death: WorkerDiedError, what_now: str, notices: Notices) -> None:
    """Log a death from which the run recovers."""
    notices.log(
        "mpsim: worker %d (process %s) ended with exit code %s in frame %d, phase '%s'; %s, on new workers.",
        death.worker,
        death.pid,
        death.exitcode,
        death.frame,
        death.phase,
        what_now,
    )


def retried_on_new_workers(act: Callable[[], None], renew: Callable[[], None] | None, notices: Notices) -> None:
    """Act; if a worker dies, which must change nothing, act again on new ones, which `renew` starts; None: raise."""
    died = False
    for chances in range(MOST_DEATHS, -1, -1):
        try:
            if died and renew is not None:
                renew()
            act()
            return
        except WorkerDiedError as death:
            if renew is None or not chances:
                raise
            log_death(death, "trying again", notices)
            died = True


class RecoverySnapshots:
    """Snapshots of a run, and the return to the last one, on new workers, when a worker has died.

    Args:
        take, restore: copies everything that the next frame depends on; goes back to such a copy.
        record: of the run, which is rewound too.
        notices: which take a line for each death.
    """

    def __init__(self, take: Callable[[], Any], restore: Callable[[Any], None], record: RunRecord, notices: Notices):
        self._take, self._restore, self._record, self._notices = take, restore, record, notices
        self._kept: tuple[Any, Rewind, int] | None = None  # a snapshot, where the record stood, number of changes
        self._due = 0.0
        self._deaths = 0

    def take(self, changes: int) -> None:
        """Take a snapshot if it is time for one and there is anything new to keep.

        changes: how often discs or parameters have been changed from outside: a snapshot from before is of no use.
        """
        started = time.perf_counter()
        _, mark, before = self._kept or (None, None, changes)
        is_new = mark is None or self._record.done > mark.done
        if changes != before or (is_new and started >= self._due):
            self._kept = self._take(), self._record.mark(), changes
            now = time.perf_counter()
            self._due = now + max(SNAPSHOT_SECONDS, (now - started) / SNAPSHOT_FRACTION)
            self._deaths = 0

    def go_back(self, death: WorkerDiedError) -> None:
        """Restore the last snapshot; raise the death where workers die faster than snapshots can be taken."""
        while True:
            self._deaths += 1
            if self._kept is None or self._deaths > MOST_DEATHS:
                raise death
            snapshot, mark, _ = self._kept
            frames = self._record.done - mark.done
            log_death(death, f"going back {frames} frames and more" if frames else "trying again", self._notices)
            self._record.rewind(mark)
            try:
                self._restore(snapshot)
                return
            except WorkerDiedError as another:  # a new worker, before it was ready
                death = another


# --- Number of frames of the next command, and number of workers that run it

MOST_SECONDS = 0.05
"""Length of a slice of frames: how long Ctrl-C, progress, or the report of a dead worker may have to wait."""

TRIAL_SECONDS = 0.005  # length of a slice that measures how fast a number of workers is

TRIALS = 7
"""Slices that decide: their median leaves out the first ones, in which caches are cold and workers asleep."""

FEW_TRIALS, HOPELESS = 3, 1.3
"""Slices after which a number of workers is given up if all of them were so many times slower than another number: so
that a run that is not long does not consist of trials."""

TRIAL_AFTER = 1.0
"""Seconds of running after which `auto` tries the slower number of workers again: machine and scene may change."""


class BatchSizer:
    """Chooses the next slice of a run, of `most_frames` at most, from the frame times of those before.

    `choices` are numbers of workers, the likely best first: all give the same bits, so the choice may follow the clock.

    Attributes:
        best: the one with the shortest recent frame time.
        seconds_run: time of all frames so far, slice by slice of the median frame [s].
    """

    def __init__(self, choices: tuple[int, ...], most_frames: int):
        self._most_frames = most_frames
        self._recent = {workers: deque(maxlen=TRIALS) for workers in choices}
        self._median = dict.fromkeys(choices, math.inf)  # frame time of these slices [s]; infinite before the first
        self._next_trial = TRIAL_AFTER
        self.seconds_run: float = 0.0
        self.best: int = choices[0]

    def next_slice(self, remaining: int) -> tuple[int, int]:
        """Workers and frames of the next slice."""
        if len(self._recent) > 1:
            if self.seconds_run > self._next_trial:
                self._next_trial = self.seconds_run + TRIAL_AFTER
                slowest = max(self._median, key=self._median.__getitem__)
                self._recent[slowest].clear()
                self._median[slowest] = math.inf
            for workers, recent in self._recent.items():
                if len(recent) < TRIALS and not self._is_hopeless(workers):
                    return workers, self._fit(TRIAL_SECONDS, self._median[workers], remaining)
        return self.best, 1 if remaining == 1 else self._fit(MOST_SECONDS, self._median[self.best], remaining)

    def _is_hopeless(self, workers: int) -> bool:
        """Whether so many workers need not be tried further."""
        recent = self._recent[workers]
        return len(recent) >= FEW_TRIALS and min(recent) > HOPELESS * min(self._median.values())

    def note(self, workers: int, frames: int, seconds_per_frame: float) -> None:
        """Note the time of a frame in the last slice: its median, which one late worker does not disturb [s]."""
        self.seconds_run += frames * seconds_per_frame
        recent = self._recent[workers]
        recent.append(max(seconds_per_frame, 1e-9))
        self._median[workers] = sorted(recent)[len(recent) // 2]
        self.best = min(self._median, key=self._median.__getitem__)

    def _fit(self, seconds: float, seconds_per_frame: float, remaining: int) -> int:
        """Number of frames that take so many seconds; one where nothing is known yet."""
        frames = 1 if math.isinf(seconds_per_frame) else int(seconds / seconds_per_frame)
        return max(min(frames, remaining, self._most_frames), 1)


# --- What goes on beside the frames of a run: signals, checkpoints, progress


class Awaited:
    """A signal that is noted in this `with` block, and raised as an error where all processes look.

    Else Ctrl-C would come to each of several ranks somewhere else, and the others would wait there for ever. Only the
    main thread can have it noted, and not if code in C handles it. In a fork, where nobody looks, it does what it did
    before.

    Args:
        number: of the signal.
        ranks: the processes that share the simulation.
        wanted: False: it comes as it always does.
        error: what is raised, with these arguments.
    """

    def __init__(self, number: int, ranks: Ranks, wanted: bool, error: type[BaseException], *arguments: Any):
        self._number, self._ranks, self._wanted = number, ranks, wanted
        self._error, self._arguments = error, arguments
        self._creator, self._noted = os.getpid(), False
        self._before: Any = None

    def __enter__(self) -> Awaited:
        if self._wanted and threading.current_thread() is threading.main_thread():
            self._before = signal.getsignal(self._number)
            if self._before is not None:
                signal.signal(self._number, self._note)
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        self._restore()
        if kind is None:  # it may have come after the last slice
            self.look(self.came())
        elif self._noted and kind is not self._error:  # the run has ended otherwise
            signal.raise_signal(self._number)

    def _restore(self) -> None:
        if self._before is not None:
            signal.signal(self._number, self._before)
            self._before = None

    def _note(self, number: int, frame: object) -> None:
        if os.getpid() != self._creator:
            self._restore()
            signal.raise_signal(number)
        self._noted = True

    def came(self) -> bool:
        """Whether it has come to any process. All of them ask."""
        return self._wanted and self._ranks.any_rank(self._noted)

    def look(self, came: bool) -> None:
        """Raise the error if it has come."""
        if came:
            raise self._error(*self._arguments)


class Beside:
    """What goes on beside the frames of a run, where anything does.

    Args:
        ranks, several: the processes that share the simulation, and whether they are several.
        save: writes a checkpoint.
        path: where; None: no checkpoints, and SIGTERM is left alone, which else ends the process after one more.
        every: frames between two; None: `seconds` count.
        seconds: between two.

    Attributes:
        progress: called as progress(done, of_frames); None: nobody asks.
        end, stop: SIGTERM, and Ctrl-C on several ranks.
    """

    def __init__(
        self,
        ranks: Ranks,
        several: bool,
        save: Callable[[Path], Any],
        path: Path | None,
        every: int | None,
        seconds: float,
    ):
        if every is not None:
            checks.whole("checkpoint_every", every, 1, base.MOST_FRAMES_OF_A_RUN, "Frames between two checkpoints.")
            if path is None:
                raise InputError(f"checkpoint_every needs checkpoint, the file to write; got {every!r} and no file.")
        self.progress: Callable[[int, int], None] | None = None
        self.end: Awaited = Awaited(signal.SIGTERM, ranks, path is not None, SystemExit, 128 + signal.SIGTERM)
        self.stop: Awaited = Awaited(signal.SIGINT, ranks, several, KeyboardInterrupt)
        self._any_rank, self._save, self._path, self._every = ranks.any_rank, save, path, every
        self._seconds = checks.positive("checkpoint_seconds", seconds, "[s]")
        self._last = time.monotonic()
        self._frames, self._reached = 0, -math.inf

    def frames_ahead(self, done: int) -> int:
        """Number of frames until the next checkpoint; very large if frames do not count."""
        if self._path is None or self._every is None:
            return 2**62
        return self._every - done % self._every

    def keep(self, done: int, reached: float, last: bool) -> None:
        """Write a checkpoint if it is time for one, or the last frame is done, or the process is to end.

        Args:
            done: frames of the run.
            reached: time of the simulation. Where it stands still there is nothing new to write, and a write would drop
                the window that the exact solver has in hand, again and again.
            last: whether the run is done.
        """
        if self._path is None:
            return
        by_frames = self._every is not None and done - self._frames >= self._every
        is_new = reached != self._reached
        by_time = self._every is None and is_new and time.monotonic() - self._last >= self._seconds
        ends = self.end.came()
        if self._any_rank(by_frames or by_time) or last or ends:
            self._save(self._path)
            self._last, self._frames, self._reached = time.monotonic(), done, reached
        self.end.look(ends)

    def look(self, done: int, reached: float, of: int) -> None:
        """Between two slices: a checkpoint, progress, Ctrl-C."""
        self.keep(done, reached, last=done == of)
        if self.progress is not None:
            self.progress(done, of)
        self.stop.look(self.stop.came())
