"""Report: timings and counts of one `run`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpsim.kernels.layout import PHASES
from mpsim.measure.gathering import Measures


@dataclass(frozen=True)
class Slice:
    """What one command of a solver took and counted.

    Attributes:
        times: int64 [ns], shape (workers, frames, phases), zero for workers at rest.
        contacts: contacts resolved.
        tally: shape (frames, tallies), in the scene's units, or None if nothing was to be counted.
    """

    times: NDArray[np.int64]
    contacts: int
    tally: NDArray[np.float64] | None


@dataclass(frozen=True)
class Report:
    """What one `run` took. Compilation and the start of workers are never part of it.

    Attributes:
        frame_seconds: wall time of each frame, shape (frames,), float64 [s].
        phase_seconds: phase name -> shape (frames, workers) [s]; "wait" is the time spent at barriers. For each worker
            the phases of a frame add up to its frame time.
        collisions: contacts resolved.
        method, workers: what ran ("auto" is resolved).
        memory_bytes: resident memory of each process, the coordinator first, at the end of the run; the shared block
            counts in each that touched it.
        block_bytes: size of the shared block.
        measures: name -> Measure(value, error, samples), for those that the run was asked for.
        guarded: collisions of the exact solver in which its guard suppressed the loss of energy.
    """

    frame_seconds: NDArray[np.float64]
    phase_seconds: dict[str, NDArray[np.float64]]
    collisions: int
    method: str
    workers: int
    memory_bytes: tuple[int, ...]
    block_bytes: int
    measures: Measures
    guarded: int

    @property
    def frames(self) -> int:
        """Number of frames run."""
        return len(self.frame_seconds)

    def __repr__(self) -> str:
        workers = f" on {self.workers} workers" if self.workers > 1 else ""
        if not self.frames:
            return f"<Report: 0 frames by {self.method}{workers}>"
        median = np.median(self.frame_seconds) * 1e6
        return (
            f"<Report: {self.frames} frames by {self.method}{workers}, "
            f"median {median:.3g} us a frame, {self.collisions} collisions>"
        )


def phase_seconds(nanoseconds: NDArray[np.int64]) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """frame_seconds and phase_seconds from int64 times of shape (workers, frames, phases)."""
    seconds = (nanoseconds * 1e-9).astype(np.float64)
    by_phase = {name: seconds[:, :, index].T.copy() for index, name in enumerate(PHASES)}
    return seconds[0].sum(axis=1), by_phase
