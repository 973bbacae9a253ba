"""What accompanies the frames of one run: what was gathered, who looks on, snapshots to go back to, checkpoints."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.deferred_signals import Handled
from mpsim.core.errors import GuardWarning, InputError, WorkerDied
from mpsim.engine.frame_count import MOST_FRAMES_OF_A_RUN
from mpsim.engine.notices import Notices
from mpsim.engine.report import Slice
from mpsim.kernels.layout import PHASES
from mpsim.measure.run_averages import Gathering
from mpsim.scene.scene import Scene

SNAPSHOT_PART = 0.01
"""Part of the running time that in-memory snapshots may take: the next one waits until the last one's time is so small
a part of what has passed since."""

SNAPSHOT_SECONDS = 0.2
"""Time between two snapshots, at least."""

MOST_DEATHS = 5
"""Deaths of workers without a snapshot in between after which there is no use in trying again."""

Mark = tuple[int, int, int, Any]


def tell_of(death: WorkerDied, what_now: str, notices: Notices) -> None:
    """One line in the log for a death that is healed."""
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
    """Act; where a worker has died, once more on new ones.

    Args:
        act: changes nothing if a worker dies.
        renew: starts new workers; None: a death is not to be healed.
        notices: which take a line for each death.

    Raises:
        WorkerDied: if that does not help.
    """
    died = False
    for chances in range(MOST_DEATHS, -1, -1):
        try:
            if died and renew is not None:
                renew()
            act()
            return
        except WorkerDied as death:
            if renew is None or not chances:
                raise
            tell_of(death, "trying again", notices)
            died = True


def warn_of_guard(guarded: int, notices: Notices) -> None:
    """Say that the exact solver's guard has acted, if it has."""
    if guarded:
        notices.warn(
            f"in {guarded} collisions the contact-time guard suppressed the loss of energy: a disc's last contact was "
            "an instant before, as in inelastic collapse or of a disc at rest. Without it the run would never end.",
            GuardWarning,
        )


class Ledger:
    """Times, collisions and counts of the frames of a run so far."""

    def __init__(self, workers: int, gathering: Gathering):
        self.gathering = gathering
        self.done: int = 0
        self.collisions: int = 0
        self._times = [np.zeros((workers, 0, len(PHASES)), np.int64)]

    def take(self, part: Slice, scene: Scene) -> None:
        """Take in what one command of the solver has done."""
        size = part.times.shape[1]
        self.done += size
        self._times.append(part.times)
        self.collisions += part.contacts
        if size:
            self.gathering.take(part.tally, self.done, scene)

    def mark(self) -> Mark:
        """Where it stands, for `rewind`."""
        return self.done, self.collisions, len(self._times), self.gathering.mark()

    def rewind(self, mark: Mark) -> None:
        """Forget what came after a mark."""
        self.done, self.collisions, slices, gathered = mark
        del self._times[slices:]
        self.gathering.rewind(gathered)

    @property
    def times(self) -> NDArray[np.int64]:
        """Times of all frames, (workers, frames, phases); growth under `auto` may have raised the number of workers."""
        workers = max(part.shape[0] for part in self._times)
        times = np.zeros((workers, sum(part.shape[1] for part in self._times), len(PHASES)), np.int64)
        end = 0
        for part in self._times:
            begin, end = end, end + part.shape[1]
            times[: len(part), begin:end] = part
        return times


class HasFrame(Protocol):
    """A simulation, as far as it matters here."""

    @property
    def frame(self) -> int:
        """Frames done."""
        ...


Seen_contra = TypeVar("Seen_contra", contravariant=True)
Observed = TypeVar("Observed", bound=HasFrame)


class Observer(Protocol[Seen_contra]):
    """Somebody who looks at a simulation along a run, to write a trajectory say. Looking must change nothing.

    Attributes:
        every: frames between two looks, >= 1, counted from frame 0, so that a run in parts shows the same frames.
    """

    every: int

    def look(self, sim: Seen_contra, collisions: int) -> None:
        """Look at the simulation between two frames.

        A frame may be shown twice: at the end of one run and the start of the next, or when a run has healed.

        Args:
            sim: to be read only.
            collisions: contacts resolved since this run began.
        """
        ...


class Observers(Generic[Observed]):
    """The observers of one run. Attribute seconds: the time they have taken [s].

    Raises:
        InputError: if one of them is no observer.
    """

    def __init__(self, observers: Observer[Observed] | Iterable[Observer[Observed]] | None):
        self.seconds: float = 0.0
        given: Any = [] if observers is None else [observers] if hasattr(observers, "look") else observers
        self._observers: list[Observer[Observed]] = list(given) if isinstance(given, Iterable) else [given]
        for each in self._observers:
            if not callable(getattr(each, "look", None)):
                raise InputError(
                    f"observe must be one observer or several, such as mpsim.Trajectory.write(...); got {each!r}."
                )
            checks.whole("every of an observer", getattr(each, "every", None), 1, 10**12, "1 looks at every frame.")

    def frames_ahead(self, frame: int) -> int:
        """Frames until somebody wants to look; a very large number without observers."""
        return min((each.every - frame % each.every for each in self._observers), default=2**62)

    def look(self, sim: Observed, collisions: int) -> None:
        """Let those look whose turn it is."""
        started = time.perf_counter()
        for each in self._observers:
            if sim.frame % each.every == 0:
                each.look(sim, collisions)
        self.seconds += time.perf_counter() - started


class Keeper:
    """Snapshots in memory, and the way back to the last one when a worker has died.

    Args:
        take: copies everything that the next frame depends on.
        restore: goes back to such a copy, on new workers.
        ledger: of the run, which goes back too.
        notices: which take a line for each death.
    """

    def __init__(self, take: Callable[[], Any], restore: Callable[[Any], None], ledger: Ledger, notices: Notices):
        self._take = take
        self._restore = restore
        self._ledger = ledger
        self._notices = notices
        self._kept: tuple[Any, Mark] | None = None
        self._due = 0.0
        self._deaths = 0

    def keep(self) -> None:
        """Take a snapshot if it is time for one and there is anything new to keep."""
        started = time.perf_counter()
        if started >= self._due and (self._kept is None or self._ledger.done > self._kept[1][0]):
            self._kept = self._take(), self._ledger.mark()
            now = time.perf_counter()
            self._due = now + max(SNAPSHOT_SECONDS, (now - started) / SNAPSHOT_PART)
            self._deaths = 0

    def go_back(self, death: WorkerDied) -> None:
        """Restore the last snapshot.

        Raises:
            WorkerDied: the death itself, if workers die faster than snapshots can be taken.
        """
        while True:
            self._deaths += 1
            if self._kept is None or self._deaths > MOST_DEATHS:
                raise death
            snapshot, mark = self._kept
            frames = self._ledger.done - mark[0]
            tell_of(death, f"going back {frames} frames and more" if frames else "trying again", self._notices)
            self._ledger.rewind(mark)
            try:
                self._restore(snapshot)
                return
            except WorkerDied as another:  # a new worker, before it was ready
                death = another


class Checkpointer:
    """Writes checkpoints while a run goes on, and one when the process is asked to end (SIGTERM).

    Whatever handled SIGTERM before does so again afterwards, also a handler in C.

    Args:
        save: writes one.
        path: where; None: no checkpoints, and SIGTERM is left alone.
        every: frames between two; None: `seconds` count.
        seconds: between two.

    Raises:
        InputError: naming the argument of `run` that is out of range.
    """

    def __init__(self, save: Callable[[Path], Any], path: Path | None, every: int | None, seconds: float):
        if every is not None:
            checks.whole("checkpoint_every", every, 1, MOST_FRAMES_OF_A_RUN, "Frames between two checkpoints.")
            if path is None:
                raise InputError(f"checkpoint_every needs checkpoint, the file to write; got {every!r} and no file.")
        self._save = save
        self._path = path
        self._every = every
        self._seconds = checks.positive("checkpoint_seconds", seconds, "[s]")
        self._last = time.monotonic()
        self._frames = 0
        self._asked_to_end = False
        self._handled: Handled | None = None
        self._creator = os.getpid()

    def __enter__(self) -> "Checkpointer":
        if self._path is not None and threading.current_thread() is threading.main_thread():
            self._handled = Handled(signal.SIGTERM, self._note)
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        if self._handled is None:
            return
        self._handled.put_back()
        self._handled = None
        if self._asked_to_end and kind is None:  # after the last look
            raise SystemExit(128 + signal.SIGTERM)
        if self._asked_to_end and kind is not SystemExit:
            signal.raise_signal(signal.SIGTERM)  # the run has ended otherwise: let it do what it does without us

    def frames_ahead(self, done: int) -> int:
        """Frames until the next checkpoint by frames; a very large number without one."""
        if self._path is None or self._every is None:
            return 2**62
        return self._every - done % self._every

    def look(self, done: int, last: bool) -> None:
        """Write a checkpoint if it is time for one, or the last frame is done, or the process is to end.

        Raises:
            SystemExit: with 143, after SIGTERM and its checkpoint.
        """
        if self._path is None:
            return
        by_frames = self._every is not None and done - self._frames >= self._every
        by_time = self._every is None and time.monotonic() - self._last >= self._seconds
        if by_frames or by_time or last or self._asked_to_end:
            self._save(self._path)
            self._last, self._frames = time.monotonic(), done
        if self._asked_to_end:
            raise SystemExit(128 + signal.SIGTERM)

    def _note(self, number: int, frame: Any) -> None:
        if os.getpid() != self._creator and self._handled is not None:  # a fork, where nobody looks at it
            self._handled.put_back()
            signal.raise_signal(signal.SIGTERM)
        self._asked_to_end = True
