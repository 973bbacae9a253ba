"""Times and counts that a run has collected so far."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.solvers import collisions
from mpsim.engine.solvers.slices import Slice
from mpsim.kernels.layout import PHASES
from mpsim.measure.run_averages import RunAverages


class Mark(NamedTuple):
    """How far a run had come: frames and collisions, slices of times, what had been gathered for measures, logged."""

    done: int
    collisions: int
    slices: int
    gathered: Any
    logged: tuple[NDArray[Any], ...]


class RunRecord:
    """Times, collisions and counts of the frames of a run so far.

    Attributes:
        averages: averages for its measures.
        whole: whether it began between two frames, not inside one.
        guarded: losses that the solver's guard had suppressed before.
        done: frames.
        collisions: contacts resolved.
        logged: tables of collisions that nobody has taken yet.
    """

    def __init__(self, workers: int, averages: RunAverages, whole: bool, guarded: int, logged: list[NDArray[Any]]):
        self.averages = averages
        self.whole: bool = whole
        self.guarded: int = guarded
        self.done: int = 0
        self.collisions: int = 0
        self.logged: list[NDArray[Any]] = logged
        self._times = [np.zeros((workers, 0, len(PHASES)), np.int64)]

    def take(self, part: Slice) -> None:
        """Add what one command of the solver took and counted."""
        size = part.times.shape[1]
        self.done += size
        self._times.append(part.times)
        self.collisions += part.contacts
        if size:
            self.averages.take(part.tally, self.done)

    def mark(self) -> Mark:
        """How far the run has come, for `rewind`."""
        return Mark(self.done, self.collisions, len(self._times), self.averages.mark(), tuple(self.logged))

    def rewind(self, mark: Mark) -> None:
        """Forget what came after a mark."""
        self.done, self.collisions = mark.done, mark.collisions
        del self._times[mark.slices :]
        self.averages.rewind(mark.gathered)
        self.logged[:] = mark.logged

    def take_logged(self, frame: int) -> NDArray[Any]:
        """The collisions up to the end of a frame that nobody has taken yet, in order: TABLE. Later ones stay."""
        table = collisions.joined(self.logged)
        late = table["frame"] > frame
        self.logged[:] = [table[late]]
        return collisions.in_order(table[~late])

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
