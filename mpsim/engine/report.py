"""`Report`: timings, counts and averages of one run."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.files import written
from mpsim.core.late import view
from mpsim.errors import NotRecordedError
from mpsim.kernels.records import PHASES

if TYPE_CHECKING:
    from mpsim.engine.solvers.base import WorkDone
    from mpsim.measure.statistics import Measure

TABLE = "a table of times"


class Measures(dict[str, "Measure"]):
    """Measures of one run by name. The error for one that was not recorded says how to ask for it."""

    def __missing__(self, name: str) -> Measure:
        """Raise an error that explains, instead of a KeyError."""
        checks.choice("the name of a measure", name, view("measure_names"))
        raise NotRecordedError(
            f"{name} was not recorded in this run (recorded: {', '.join(self) or 'nothing'}). Measures are gathered "
            f"only when asked for. Use sim.run(..., measures=[{name!r}])."
        )


@dataclass(frozen=True)
class Report:
    """Times, counts and measures of one `run`. Frame times do not include compilation and the start of workers.

    Attributes:
        times: wall time of each phase, shape (workers, frames, phases), int64 [ns]; see `frame_seconds` and
            `phase_seconds`.
        collisions: contacts resolved.
        method, workers: those used ("auto" is resolved).
        memory_bytes: resident memory of each process at the end of the run, the coordinator first, read anew after
            0.1 s of frames; 0 for a process that has died since its last frame, or where the system does not say. The
            shared block is included for each process that has used it.
        block_bytes: size of the shared block.
        measures: name -> Measure(value, error, samples), for the measures that `run` was given.
        guarded: number of collisions in which the exact solver suppressed the energy loss (see `contact_time`).
        observing_seconds: time spent in observers (`run(observe=...)`) without compiling; frame times do not include
            it [s].
        compile_seconds: time spent compiling kernels since the previous report of this simulation, or since its
            creation; frame times do not include it [s]. 0 if all kernels were in the cache.
        contact_time: contact time of the exact solver [time]; 0 if there was none.
        _work: what had been done when the run began, and when it ended: see `work`.
    """

    times: NDArray[np.int64]
    collisions: int
    method: str
    workers: int
    memory_bytes: tuple[int, ...]
    block_bytes: int
    measures: Measures
    guarded: int
    observing_seconds: float
    compile_seconds: float
    contact_time: float
    _work: tuple[WorkDone, WorkDone]

    @property
    def frames(self) -> int:
        """Number of frames run."""
        return self.times.shape[1]

    @cached_property
    def work(self) -> dict[int | str, float]:
        """Energy that each moving surface and bath gave in this run, as `Simulation.work` [mass length^2/time^2]."""
        before, after = (each.energies() for each in self._work)
        return {name: done - before.get(name, 0.0) for name, done in after.items()}

    @cached_property
    def frame_seconds(self) -> NDArray[np.float64]:
        """Wall time of each frame, shape (frames,) [s]."""
        return (self.times[0] * 1e-9).sum(axis=1)

    @cached_property
    def phase_seconds(self) -> dict[str, NDArray[np.float64]]:
        """Phase name -> shape (frames, workers) [s]; "wait" is the time spent at barriers.

        For each worker the phases of a frame add up to its frame time, except that a worker that the system interrupts
        at the end of a frame may count this time in the next one.
        """
        seconds = self.times * 1e-9
        return {name: seconds[:, :, index].T.astype(np.float64) for index, name in enumerate(PHASES)}

    @property
    def waiting(self) -> float:
        """Fraction of the workers' time spent waiting for each other at barriers, from 0 to 1."""
        total = sum(float(seconds.sum()) for seconds in self.phase_seconds.values())
        return float(self.phase_seconds["wait"].sum()) / total if total else 0.0

    def to_csv(self, path: str | os.PathLike[str] | None = None, *, first_frame: int = 1) -> str:
        """Times as CSV, one line per frame: its number, its time, and each phase of each worker, all in seconds.

        Args:
            path: also written to this file, if given; an existing file is replaced.
            first_frame: number of the first line.

        Raises:
            InputError: if the path has the ending of another format.
            OutputError: if the file cannot be written.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        names = [(name, worker) for name in PHASES for worker in range(self.phase_seconds[name].shape[1])]
        phases = {f"{name.replace(' ', '_')}_{each}": self.phase_seconds[name][:, each] for name, each in names}
        columns = {"seconds": self.frame_seconds, **phases}
        writer.writerow(["frame", *columns])
        numbers = range(first_frame, first_frame + self.frames)
        writer.writerows(zip(numbers, *(column.tolist() for column in columns.values()), strict=True))
        return written(text.getvalue(), path, TABLE)

    def plot(self) -> Any:
        """matplotlib Figure, without a window, of the frame times and of each worker's working and waiting times.

        >>> from mpsim import Scene, Simulation
        >>> with Simulation(Scene.random(count=50, packing=0.2, radius=0.5)) as sim:
        ...     figure = sim.run(frames=10).plot()
        >>> len(figure.axes)
        2
        """
        return view("report_times", self)

    def _repr_html_(self) -> str:
        return view("report_html", self)

    @property
    def summary(self) -> str:
        """Counts and times in one line, without the measures."""
        workers = f" on {self.workers} workers" if self.workers > 1 else ""
        if not self.frames:
            return f"0 frames by {self.method}{workers}"
        median = np.median(self.frame_seconds) * 1e6
        compiled = f"{self.compile_seconds:.1f} s of compiling before, " if self.compile_seconds else ""
        return (
            f"{self.frames} frame{'s' * (self.frames != 1)} by {self.method}{workers}, median {median:.3g} us a frame, "
            f"{compiled}{self.collisions} collision{'s' * (self.collisions != 1)}"
        )

    def __repr__(self) -> str:
        return f"<Report: {', '.join([self.summary, *(f'{name} {each!r}' for name, each in self.measures.items())])}>"
