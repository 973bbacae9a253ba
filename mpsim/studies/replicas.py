"""One accuracy run of one candidate: a pure function of scene, settings and plan, so that any executor can run it.

The physics of a scene is an average over starts (`starts.Starts`). Where they are one start but for a tiny variation,
collisions soon make independent samples of them. What a gas does before that is one sample however many runs there are,
whose chance no scatter shows: it does not count as part of a stationary state (`Plan.memory`).
"""

import dataclasses
import json
import math
import threading
import time
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from mpsim.core.errors import (
    EmitterWarning,
    FastWarning,
    GuardWarning,
    InputError,
    MpsimError,
    OverlapWarning,
    ResolutionWarning,
    ResourceError,
    WorkerDied,
    WorkerStalled,
)
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers import methods
from mpsim.measure import run_averages
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.comparison import short_run

PIECES = 16
"""Parts of a long run over which averages are taken one by one, and after which the speeds are looked at."""

SPEED_LEVELS = np.linspace(0.2, 2.6, 13)
"""Speeds, in units of the reference's root mean square, at which distributions are compared."""

LONG = (
    "pressure",
    "collision_rate",
    "energy_drift",
    "momentum_drift",
    "overlap",
    "largest_overlap",
    "speed_distribution",
)
SHORT = ("trajectory", "missed_collisions")
MEASURES = (*LONG, *SHORT)

ALONG = "states along one run of the scene"
"""Starts of the short runs, in words: trajectories are compared from what the scene looks like on its way."""


def available(scene: Scene) -> tuple[str, ...]:
    """Those of MEASURES that mean something in a scene: no pressure where there are neither walls nor a virial, say."""
    if not isinstance(scene, Scene):  # which the campaign checks
        return MEASURES
    return tuple(name for name in MEASURES if refusal(name, scene) is None)


def refusal(name: str, scene: Scene) -> str | None:
    """Why one of MEASURES would be wrong in a scene, or None."""
    if name in SHORT and (scene.emitters or scene.absorbing):
        return (
            f"{name!r} compares runs from states along a run, and needs all discs in each; emitters and absorbing "
            "edges change them. Ask for 'overlap', or for an average such as 'pressure'."
        )
    return run_averages.refusal(name, scene)


def starts_of(names: Collection[str], starts: str) -> str:
    """Of what starts errors are, in words: `starts` those of long runs, ALONG those of short ones.

    >>> starts_of(["pressure", "trajectory"], "other starts of the same kind")
    'other starts of the same kind (trajectory: over states along one run of the scene)'
    """
    short = [name for name in names if name in SHORT]
    if not short:
        return starts
    if len(short) == len(names):
        return ALONG
    return f"{starts} ({', '.join(short)}: over {ALONG})"


def demand_available(names: Iterable[str], scene: Scene) -> None:
    """Raise InputError for one of MEASURES that the scene cannot have, with the reason."""
    if isinstance(scene, Scene):  # which the campaign checks
        for reason in filter(None, (refusal(name, scene) for name in names)):
            raise InputError(reason)


@dataclass(frozen=True)
class Plan:
    """What every candidate is put through.

    Attributes:
        until: length of a long run [time].
        speed: unit of SPEED_LEVELS, a typical speed of the reference [length/time].
        short: length of a short run [time]; 0 where trajectories cannot be compared.
        rate: Lyapunov exponent of the scene [1/time].
        memory: time from which on runs of one start are independent [time]: a stationary part begins no earlier.
    """

    until: float
    speed: float
    short: float
    rate: float
    memory: float = 0.0


def physics_of(settings: Settings, count: int) -> Settings:
    """The settings with all that changes speed only made standard: candidates that share it share their errors."""
    method = methods.choose(count, settings).method
    if method == "event":
        return Settings(method="event")
    plain: dict[str, Any] = {"method": "grid" if method == "parallel" else method, "workers": None}
    return dataclasses.replace(settings, start_method=None, **plain)


def key_of(settings: Settings) -> str:
    """A text that is the same for equal settings, and tells which they are."""
    values = dataclasses.asdict(settings)
    if settings.on_fast == "warn":  # which changes nothing, and younger than the keys of kept runs
        del values["on_fast"]
    return json.dumps(values, sort_keys=True)


class Stopped(Exception):  # noqa: N818 - not an error
    """Nobody waits for this run any more."""


class RunTooLong(Exception):  # noqa: N818 - an outcome, not an error
    """A run takes far more time than was forecast."""


Progress = Callable[[int, int], None] | None


def long_run(
    start: Scene, settings: Settings, plan: Plan, seconds: float = math.inf, stop: threading.Event | None = None
) -> dict[str, Any]:
    """Averages over PIECES of one run to plan.until: a list for each measure of LONG, of lists for the speeds.

    With "centre", the middle of each piece as a fraction of plan.until, "met", the pairs met, and "seconds" of running.
    A run that cannot be continued, or takes more than `seconds` of its thread, gives {"failure": reason}; one whose
    `stop` is set, an exception.
    """
    try:
        with quietly():
            return _averages(start, settings, plan, _until_stopped(stop, seconds))
    except (MpsimError, ArithmeticError, MemoryError, RunTooLong) as error:
        return failure(error)


def failure(error: Exception) -> dict[str, Any]:
    """The result of a run that failed; "machine" where not the candidate but the machine is to blame."""
    machine = isinstance(error, MemoryError | ResourceError | WorkerDied | WorkerStalled | RunTooLong)
    return {"failure": f"{type(error).__name__}: {error}"} | ({"machine": True} if machine else {})


@contextmanager
def quietly() -> Iterator[None]:
    """No warnings about the scene, which hundreds of runs would repeat. In the main thread only: filters are global."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with warnings.catch_warnings():
        for kind in (EmitterWarning, OverlapWarning, GuardWarning, FastWarning, ResolutionWarning):
            warnings.simplefilter("ignore", kind)
        yield


def _until_stopped(stop: threading.Event | None, seconds: float = math.inf) -> Progress:
    """What ends a run from within, soon after `stop` is set or so many seconds of this thread are over."""
    end = time.thread_time() + seconds

    def look(done: int, frames: int) -> None:
        if stop is not None and stop.is_set():
            raise Stopped
        if time.thread_time() > end:
            raise RunTooLong(f"a run took more than {seconds:.0f} s, far more than was forecast: its start is unusual")

    return look


def _averages(scene: Scene, settings: Settings, plan: Plan, progress: Progress) -> dict[str, Any]:
    if settings.method == "event":  # whose frames are what this run is cut into, nothing else
        settings = dataclasses.replace(settings, dt=plan.until / PIECES)
    counted = [name for name in available(scene) if name in LONG and name != "speed_distribution"]
    pieces = min(PIECES, max(int(plan.until / settings.dt), 1))
    series: dict[str, Any] = {name: [] for name in (*counted, "speed_distribution", "met", "centre")}
    series["seconds"] = 0.0
    with Simulation(scene, settings) as sim:
        for piece in range(1, pieces + 1):
            before = sim.time
            report = sim.run(until=plan.until * piece / pieces, measures=counted, progress=progress)
            for name in counted:
                series[name].append(report.measures[name].value)
            series["met"].append(report.measures["overlap"].samples)
            series["speed_distribution"].append(_cumulative(sim.state, plan.speed))
            series["centre"].append((before + sim.time) / 2 / plan.until)
            series["seconds"] += float(report.frame_seconds.sum())
    for name in ("overlap", "largest_overlap"):
        series[name] = [depth / (2 * scene.smallest_radius) for depth in series[name]]
    return series


def _cumulative(state: State, unit: float) -> list[float]:
    """Fractions of the discs slower than each of SPEED_LEVELS."""
    speeds = np.sort(np.hypot(*state.velocity[state.present].astype(float).T))
    return (np.searchsorted(speeds, SPEED_LEVELS * unit) / max(len(speeds), 1)).tolist()


def short_runs(
    scene: Scene, settings: Settings, plan: Plan, start: State, reference: Settings, stop: threading.Event | None = None
) -> dict[str, Any]:
    """A run of length plan.short beside the reference, both from `start`: a number for each measure of SHORT."""
    how: dict[str, Any] = {"rate": plan.rate, "reference": reference, "progress": _until_stopped(stop)}
    try:
        with quietly():
            found = short_run(scene.starting_from(start), settings, plan.short, **how)
    except (MpsimError, ArithmeticError, MemoryError) as error:
        return failure(error)
    met, exact = found.collisions
    return {"trajectory": found.error.rms / (2 * scene.smallest_radius), "collisions": [met, exact]}
