"""One accuracy run of one candidate, and what a candidate costs."""

import dataclasses
import functools
import json
import math
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mpsim.core.state import State
from mpsim.engine import access
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers import methods
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import (
    EmitterWarning,
    FastWarning,
    GuardWarning,
    InputError,
    MpsimError,
    OverlapWarning,
    ResolutionWarning,
    ResourceError,
    WorkerDiedError,
    WorkerStalledError,
)
from mpsim.features import energy
from mpsim.kernels.compiling import running_seconds
from mpsim.measure import registry
from mpsim.measure.observables import trajectory_error
from mpsim.measure.registry import ERRORS, LONG, NAMES, OBSERVABLES, SHORT
from mpsim.measure.statistics import require_predictable
from mpsim.scene.scene import Scene, no_scene
from mpsim.scene.settings import Settings
from mpsim.studies.runner import Stopped

# --- One accuracy run of one candidate, a pure function that any executor can run
#
# The physics of a scene is an average over starts (`preliminary.Starts`). If they are variations of one start,
# collisions soon decorrelate them. Before that, all runs amount to a single sample, and their scatter does not show
# its noise. So that time does not count as stationary (`Plan.memory`).

PIECES = 16
"""Number of pieces of a long run: averages are taken over each, and speeds sampled after each."""

SPEED_LEVELS = np.linspace(0.2, 2.6, 13)
"""Speeds, in units of the reference's root mean square, at which distributions are compared."""

ALONG = "states along one run of the scene"
"""Starts of the short runs, in words."""


def available(scene: Scene) -> tuple[str, ...]:
    """Those of ERRORS that are defined in a scene; there is no pressure without walls and virial, for example."""
    if not isinstance(scene, Scene):
        raise no_scene(scene)
    return tuple(name for name in ERRORS if _refusal(name, scene) is None)


def demand_available(names: Iterable[str], scene: Scene) -> None:
    """Raise InputError for one of ERRORS that the scene cannot have, with the reason."""
    known = available(scene)
    for name in names:
        if name not in known:
            raise InputError(_refusal(name, scene))


def _refusal(name: str, scene: Scene) -> str | None:
    """Why one of ERRORS would be wrong in a scene, or None."""
    if name in SHORT and (energy.adds_discs(scene) or energy.removes_discs(scene)):
        return (
            f"{name!r} compares runs from states along a run, and needs all discs in each; emitters and absorbing "
            "edges change them. Ask for 'overlap', or for an average such as 'pressure'."
        )
    return registry.refusal(name, scene)


def starts_of(names: Collection[str], starts: str) -> str:
    """Starts of the runs for given errors, in words: `starts` for long runs, ALONG for short ones.

    >>> starts_of(["pressure", "trajectory"], "other starts of the same kind")
    'other starts of the same kind (trajectory: over states along one run of the scene)'
    """
    short = [name for name in names if name in SHORT]
    if len(short) == len(names):
        return ALONG
    return f"{starts} ({', '.join(short)}: over {ALONG})" if short else starts


@dataclass(frozen=True)
class Plan:
    """The runs that every candidate has to do.

    Attributes:
        until: length of a long run [time].
        speed: unit of SPEED_LEVELS, a typical speed of the reference [length/time].
        short: length of a short run [time]; 0 if trajectories cannot be compared.
        rate: Lyapunov exponent of the scene [1/time].
        memory: time after which runs of one start are independent, and may be stationary [time].
    """

    until: float
    speed: float
    short: float
    rate: float
    memory: float = 0.0


def physics_of(settings: Settings, scene: Scene) -> Settings:
    """The settings, with standard values for those that change only speed: candidates with equal ones share errors."""
    method = methods.choose(scene.count, settings).method
    if not capabilities_of(settings).has_steps:
        dt = Settings.dt if scene.thermostat is None else settings.dt  # it acts once a frame
        return Settings(dt=dt, method=method, contact_time=settings.contact_time)
    return replace(settings, method="grid" if method == "parallel" else method, workers=None)


def key_of(settings: Settings) -> str:
    """Settings as a text that serves as a key."""
    return json.dumps(dataclasses.asdict(settings), sort_keys=True)


class RunTooLong(Exception):  # noqa: N818 - an outcome, not an error
    """A run takes far more time than forecast."""


Progress = Callable[[int, int], None]


def time_limit(seconds: float, text: str, stop: threading.Event | None = None) -> Progress:
    """A progress function that ends a run after seconds of this thread, compiling left out, or soon after `stop`.

    It raises RunTooLong, with a text that says why, or Stopped.
    """
    end = running_seconds() + seconds

    def progress(done: int, frames: int) -> None:
        if stop is not None and stop.is_set():
            raise Stopped
        if running_seconds() > end:
            raise RunTooLong(text)

    return progress


@contextmanager
def quietly() -> Iterator[None]:
    """Suppress warnings about the scene in this thread, which hundreds of runs would repeat."""
    with access.caught(EmitterWarning, OverlapWarning, GuardWarning, FastWarning, ResolutionWarning):
        yield


def _attempt(run: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    """A run that returns {"failure": reason} if it fails, with "machine" if that is the cause, not the candidate."""

    @functools.wraps(run)
    def attempted(*arguments: Any) -> dict[str, Any]:
        try:
            with quietly():
                return run(*arguments)
        except (MpsimError, ArithmeticError, MemoryError, RunTooLong) as error:
            of_machine = MemoryError | ResourceError | WorkerDiedError | WorkerStalledError | RunTooLong
            machine = {"machine": True} if isinstance(error, of_machine) else {}
            return {"failure": f"{type(error).__name__}: {error}", **machine}

    return attempted


@_attempt
def long_run(
    scene: Scene, settings: Settings, plan: Plan, seconds: float = math.inf, stop: threading.Event | None = None
) -> dict[str, Any]:
    """Averages over PIECES of one run to plan.until: a list for each measure of LONG, of lists for the speeds.

    Also "centre", the middle of each piece as a fraction of plan.until, "met", the number of overlapping pairs, and
    "seconds" of running.

    Raises:
        RunTooLong: if it takes more than `seconds` of its thread.
        Stopped: if `stop` is set.
    """
    text = f"a run took more than {seconds:.0f} s, far more than was forecast: its start is unusual"
    progress = time_limit(seconds, text, stop)
    if not capabilities_of(settings).has_steps and scene.thermostat is None:  # frames only cut it into pieces
        settings = replace(settings, dt=plan.until / PIECES)
    counted = [name for name in available(scene) if name in LONG and name in NAMES]
    pieces = min(PIECES, max(int(plan.until / settings.dt), 1))
    series: dict[str, Any] = {name: [] for name in (*counted, "speed_distribution", "met", "centre")}
    series["seconds"] = 0.0
    with Simulation(scene, settings) as sim:
        for piece in range(1, pieces + 1):
            before = sim.time
            report = sim.run(until=plan.until * piece / pieces, measures=counted, progress=progress)
            for name in counted:
                unit = 2 * scene.smallest_radius if OBSERVABLES[name].unit == "diam." else 1.0
                series[name].append(report.measures[name].value / unit)
            series["met"].append(report.measures["overlap"].samples)
            series["speed_distribution"].append(_cumulative(sim.state, plan.speed))
            series["centre"].append((before + sim.time) / 2 / plan.until)
            series["seconds"] += float(report.frame_seconds.sum())
    return series


def _cumulative(state: State, unit: float) -> list[float]:
    """Fractions of the discs slower than each of SPEED_LEVELS."""
    speeds = np.sort(np.hypot(*state.velocity[state.present].astype(float).T))
    return (np.searchsorted(speeds, SPEED_LEVELS * unit) / max(len(speeds), 1)).tolist()


@_attempt
def short_run(
    scene: Scene,
    settings: Settings,
    plan: Plan,
    start: tuple[State, float],
    reference: Settings,
    stop: threading.Event | None = None,
) -> dict[str, Any]:
    """A run of length plan.short, in whole frames, and the reference, both from `start`: a state and its time.

    Returns:
        "trajectory", the deviation of the positions [diameters], and "collisions" of both: a stepped run resolves
        contacts at rest again in each step.

    Raises:
        InputError: if two correct solvers do not agree for that long.
        Stopped: if `stop` is set.
    """
    scene, progress = scene.starting_from(*start), time_limit(math.inf, "", stop)
    frames = max(round(plan.short / settings.dt), 1)
    until = frames * settings.dt
    require_predictable(until, plan.rate)
    with Simulation(scene, settings) as run:
        met = run.run(frames=frames, progress=progress).collisions
        state = run.state
    steps = max(round(until / reference.dt), 1) if capabilities_of(reference).has_steps else 1
    if scene.thermostat is None:
        reference, frames = replace(reference, dt=until / steps), steps
    else:  # which acts once a frame: on both alike
        reference = replace(reference, dt=settings.dt, substeps=-(-steps // frames))
    with Simulation(scene, reference) as exact:
        collisions = [met, exact.run(frames=frames, progress=progress).collisions]
        distance = trajectory_error(state, exact.state, scene).rms
    return {"trajectory": distance / (2 * scene.smallest_radius), "collisions": collisions}


# --- Cost of a candidate: wall time per disc and unit of the scene's time, and memory, measured alone on the machine

WARM_UP = 0.05
"""Seconds of running before timing starts: caches fill, workers wake, `auto` makes its first choice."""

RESTARTS = 3
"""Largest number of warm-up runs: if the whole run is shorter than WARM_UP, starting workers for each would take
minutes."""

CHUNKS = 21
"""Number of timed pieces; their median is the cost and their quartiles the spread."""

CHUNK_SECONDS = 0.002
"""Approximate length of a timed piece: mostly shorter than a time slice of the scheduler, so that on a busy machine
most pieces are not interrupted."""

WHOLE = 16
"""Pieces of a run that is timed as a whole; its discs are counted after each."""

WHOLE_SECONDS = 1.0
"""Seconds after which no other whole run is timed."""


@dataclass(frozen=True)
class Cost:
    """Wall time of a run.

    Attributes:
        median, low, high: median and quartiles over pieces [ns per disc and time].
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


@_attempt
def measure(scene: Scene, settings: Settings, until: float) -> dict[str, Any]:
    """Cost of a run of the scene, as the fields of `Cost`. Nothing else should run on the machine meanwhile.

    Where discs are added, the cost changes along the run, so whole runs to `until` are timed.

    Args:
        scene: the scene, run from its start.
        settings: of the run. Frames without steps are chosen here, as their dt does not matter for the cost.
        until: simulated time after which the scene starts again [time].
    """
    if not capabilities_of(settings).has_steps:
        settings = replace(settings, dt=until / 1000)
    if energy.adds_discs(scene):
        return _of_whole_runs(scene, settings, until)
    costs: list[float] = []
    most = max(int(until / settings.dt), 1)
    per_frame, warm, starts, ran = 0.0, 0.0, 0, {}
    while len(costs) < CHUNKS:
        starts += 1
        with Simulation(scene, settings) as sim:
            while len(costs) < CHUNKS and sim.frame < most:
                wanted = int(CHUNK_SECONDS / per_frame) if per_frame else 1
                report = sim.run(frames=max(min(wanted, most - sim.frame), 1))
                seconds = float(report.frame_seconds.sum())
                per_frame = max(seconds / report.frames, 1e-9)
                if warm >= WARM_UP or starts > RESTARTS:
                    costs.append(seconds / (report.frames * settings.dt * max(scene.count, 1)) * 1e9)
                warm += seconds
                ran = _what_ran(report, scene.count)
    low, median, high = np.percentile(costs, [25, 50, 75]).tolist()
    return {"median": median, "low": low, "high": high, **ran}


def _of_whole_runs(scene: Scene, settings: Settings, until: float) -> dict[str, Any]:
    """Cost of whole runs, per disc of the average number."""
    costs: list[float] = []
    ran: dict[str, Any] = {}
    end = time.monotonic() + WHOLE_SECONDS
    while not costs or (len(costs) < RESTARTS and time.monotonic() < end):
        with Simulation(scene, settings) as sim:
            seconds, discs = 0.0, 0.0
            for piece in range(1, WHOLE + 1):
                before = sim.time
                report = sim.run(until=until * piece / WHOLE)
                seconds += float(report.frame_seconds.sum())
                discs += sim.count * (sim.time - before)
                ran = _what_ran(report, sim.count)
            costs.append(seconds / max(discs, sim.time) * 1e9)
    low, median, high = np.percentile(costs, [0, 50, 100]).tolist()
    return {"median": median, "low": low, "high": high, **ran}


def _what_ran(report: Report, count: int) -> dict[str, Any]:
    """The fields of `Cost` that are no times."""
    memory = report.block_bytes / max(count, 1)
    return {"memory": memory, "method": report.method, "workers": report.workers, "contact_time": report.contact_time}
