"""Cost of a candidate: wall time per disc and unit of the scene's time, and memory, measured alone on the machine."""

import resource
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import MpsimError
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.replicas import failure, quietly

WARM_UP = 0.05
"""Seconds of running before timing starts: caches fill, workers wake, `auto` makes its first choice."""

RESTARTS = 3
"""Largest number of warm-up runs: if the whole run is shorter than WARM_UP, starting workers for each would take
minutes."""

CHUNKS = 21
"""Number of timed pieces; their median is the cost and their quartiles the spread."""

CHUNK_SECONDS = 0.002
"""Approximate length of a timed piece: mostly shorter than a time slice of the scheduler, so that on a busy machine
enough pieces are not interrupted."""

WHOLE = 16
"""Pieces of a run that is timed as a whole; its discs are counted after each."""

UNINTERRUPTED_SECONDS = 1.0
"""Seconds to wait for uninterrupted pieces. If there are fewer than half of CHUNKS then, all pieces count."""


@dataclass(frozen=True)
class Cost:
    """Wall time of a run.

    Attributes:
        median, low, high: median and quartiles over uninterrupted pieces [ns per disc and time].
        memory: size of the shared block [bytes per disc].
        method, workers: those used ("auto" is resolved).
        contact_time: of the exact solver's guard [time]; 0 where there is none.
    """

    median: float
    low: float
    high: float
    memory: float
    method: str
    workers: int
    contact_time: float = 0.0


def measure(scene: Scene, settings: Settings, until: float, whole: bool = False) -> dict[str, Any]:
    """Cost of a run of the scene, as the fields of `Cost`; {"failure": reason} if it cannot be continued.

    Nothing else should run on the machine meanwhile.

    Args:
        scene: the scene, run from its start.
        settings: of the run. Frames without steps are chosen here, as their dt does not matter for the cost.
        until: simulated time after which the scene starts again [time].
        whole: time whole runs to `until`, for a scene whose cost changes along the run.
    """
    if not capabilities_of(settings).has_steps:
        settings = replace(settings, dt=until / 1000)
    try:
        with quietly():
            if whole:
                return _whole(scene, settings, until)
            return _measured(scene, settings, max(int(until / settings.dt), 1))
    except (MpsimError, ArithmeticError, MemoryError) as error:
        return failure(error)


def _measured(scene: Scene, settings: Settings, most_frames: int) -> dict[str, Any]:
    uninterrupted: list[float] = []
    costs: list[float] = []
    per_frame, warm, starts, what_ran = 0.0, 0.0, 0, {}
    end = time.monotonic() + UNINTERRUPTED_SECONDS

    def wanting() -> bool:
        patient = starts <= RESTARTS and time.monotonic() < end
        return len(costs) < CHUNKS or (len(uninterrupted) < CHUNKS and patient)

    while wanting():
        starts += 1
        with Simulation(scene, settings) as sim:
            while wanting() and sim.frame < most_frames:
                wanted = int(CHUNK_SECONDS / per_frame) if per_frame else 1
                before = _interruptions()
                report = sim.run(frames=max(min(wanted, most_frames - sim.frame), 1))
                seconds = float(report.frame_seconds.sum())
                per_frame = max(seconds / report.frames, 1e-9)
                if warm >= WARM_UP or starts > RESTARTS:
                    costs.append(seconds / (report.frames * settings.dt * max(scene.count, 1)) * 1e9)
                    uninterrupted += costs[-1:] if _interruptions() == before else []
                warm += seconds
                what_ran = _what_ran(report, scene.count)
    counted = uninterrupted if len(uninterrupted) > CHUNKS // 2 else costs
    low, median, high = np.percentile(counted, [25, 50, 75]).tolist()
    return {"median": median, "low": low, "high": high, **what_ran}


def _whole(scene: Scene, settings: Settings, until: float) -> dict[str, Any]:
    """Cost of whole runs, per disc of the average number."""
    costs: list[float] = []
    what_ran: dict[str, Any] = {}
    end = time.monotonic() + UNINTERRUPTED_SECONDS
    while not costs or (len(costs) < RESTARTS and time.monotonic() < end):
        with Simulation(scene, settings) as sim:
            seconds, discs = 0.0, 0.0
            for piece in range(1, WHOLE + 1):
                before = sim.time
                report = sim.run(until=until * piece / WHOLE)
                seconds += float(report.frame_seconds.sum())
                discs += sim.count * (sim.time - before)
                what_ran = _what_ran(report, sim.count)
            costs.append(seconds / max(discs, sim.time) * 1e9)
    low, median, high = np.percentile(costs, [0, 50, 100]).tolist()
    return {"median": median, "low": low, "high": high, **what_ran}


def _what_ran(report: Report, count: int) -> dict[str, Any]:
    """The fields of `Cost` that are no times."""
    memory = report.block_bytes / max(count, 1)
    ran = {"method": report.method, "workers": report.workers, "contact_time": report.contact_time}
    return {"memory": memory, **ran}


def _interruptions() -> int:
    """Number of involuntary context switches of this thread."""
    return resource.getrusage(getattr(resource, "RUSAGE_THREAD", resource.RUSAGE_SELF)).ru_nivcsw
