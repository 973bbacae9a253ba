"""Runs of many candidates on one scene, through any executor, and what a candidate costs."""

import dataclasses
import functools
import json
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mpsim.core import checks
from mpsim.core.deferred_signals import terminated_by_exit
from mpsim.core.machine import usable_cores
from mpsim.core.progress import Show, checked_progress, shown
from mpsim.core.state import State
from mpsim.engine import access
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers import methods
from mpsim.engine.solvers.event_block import contact_time_at_rest, longest_contact_time
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import (
    FastWarning,
    InputError,
    MpsimError,
    NotMeasurableError,
    ResourceError,
    WorkerDiedError,
    WorkerStalledError,
)
from mpsim.features.feature import adds_discs, removes_discs
from mpsim.measure import registry
from mpsim.measure.observables import trajectory_error
from mpsim.measure.registry import ERRORS, LONG, NAMES, OBSERVABLES, SHORT
from mpsim.scene.scene import Scene, no_scene
from mpsim.scene.settings import Settings
from mpsim.studies.deviations import Deviation, deviations, short_deviations, spans_of, unmeasurable
from mpsim.studies.preliminary import (
    AGREEMENT,
    VARIATION,
    PreliminaryRun,
    RunTooLong,
    Starts,
    StartsGiven,
    preliminary_run,
    quietly,
    time_limit,
)
from mpsim.studies.runner import RunFile, Runner, Stopped

# --- One accuracy run of one candidate, a pure function that any executor can run
#
# The physics of a scene is an average over starts (`preliminary.Starts`). If they are variations of one start,
# collisions soon decorrelate them. Before that, all runs amount to a single sample, and their scatter does not show
# its noise. So that time does not count as stationary (`Ensemble.memory`).

PIECES = 16  # number of pieces of a long run: averages are taken over each, and speeds sampled after each

SPEED_LEVELS = np.linspace(0.2, 2.6, 13)
"""Speeds, in units of the reference's root mean square, at which distributions are compared."""

COMPARABLE = 0.5
"""Fraction of the time for which two correct solvers agree up to which trajectories are compared [1]; the rest is
margin for growth above the average."""


def available(scene: Scene) -> tuple[str, ...]:
    """Those of ERRORS that are defined in a scene; there is no pressure without walls and virial, for example."""
    return tuple(name for name in ERRORS if _refusal(name, scene) is None)


def demand_available(names: Iterable[str], scene: Scene) -> None:
    """Raise InputError for one of ERRORS that the scene cannot have, with the reason."""
    for name in names:
        if reason := _refusal(name, scene):
            raise InputError(reason)


def _refusal(name: str, scene: Scene) -> str | None:
    """Why one of ERRORS would be wrong in a scene, or None."""
    if not isinstance(scene, Scene):
        raise no_scene(scene)
    if name in SHORT and (adds_discs(scene) or removes_discs(scene)):
        return (
            f"{name!r} compares runs from states along a run, and needs all discs in each; emitters and absorbing "
            "edges change them. Ask for 'overlap', or for an average such as 'pressure'."
        )
    return registry.refusal(name, scene)


def key_of(settings: Settings) -> str:
    """Settings as a text that serves as a key."""
    return json.dumps(dataclasses.asdict(settings), sort_keys=True)


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
    scene: Scene,
    settings: Settings,
    until: float,
    speed: float,
    seconds: float = math.inf,
    stop: threading.Event | None = None,
) -> dict[str, Any]:
    """Averages over PIECES of one run to `until`: a list for each measure of LONG, of lists for the speeds.

    Also "centre", the middle of each piece as a fraction of the run, "met", the number of overlapping pairs, and
    "seconds" of running. speed: unit of SPEED_LEVELS [length/time].

    Raises:
        RunTooLong: if it takes more than `seconds` of its thread.
        Stopped: if `stop` is set.
    """
    text = f"a run took more than {seconds:.0f} s, far more than was forecast: its start is unusual"
    progress = time_limit(seconds, text, stop)
    if not capabilities_of(settings).has_steps and scene.thermostat is None:  # frames only cut it into pieces
        settings = replace(settings, dt=until / PIECES)
    counted = [name for name in available(scene) if name in LONG and name in NAMES]
    pieces = min(PIECES, max(int(until / settings.dt), 1))
    series: dict[str, Any] = {name: [] for name in (*counted, "speed_distribution", "met", "centre")}
    series["seconds"] = 0.0
    with Simulation(scene, settings) as sim:
        for piece in range(1, pieces + 1):
            before = sim.time
            report = sim.run(until=until * piece / pieces, measures=counted, progress=progress)
            for name in counted:
                unit = 2 * scene.smallest_radius if OBSERVABLES[name].unit == "diam." else 1.0
                series[name].append(report.measures[name].value / unit)
            series["met"].append(report.measures["overlap"].samples)
            state = sim.state
            speeds = np.sort(np.hypot(*state.velocity[state.present].astype(float).T))
            slower = np.searchsorted(speeds, SPEED_LEVELS * speed) / max(len(speeds), 1)
            series["speed_distribution"].append(slower.tolist())
            series["centre"].append((before + sim.time) / 2 / until)
            series["seconds"] += float(report.frame_seconds.sum())
    return series


@_attempt
def short_run(
    scene: Scene,
    settings: Settings,
    reference: Settings,
    start: tuple[State, float],
    length: float,
    rate: float,
    stop: threading.Event | None = None,
) -> dict[str, Any]:
    """A run of about `length`, in whole frames, and the reference, both from `start`: a state and its time.

    rate: Lyapunov exponent of the scene [1/time].

    Returns:
        "trajectory", the deviation of the positions [diameters], and "collisions" of both: a stepped run resolves
        contacts at rest again in each step.

    Raises:
        InputError: if two correct solvers do not agree for that long.
        Stopped: if `stop` is set.
    """
    scene, progress = scene.starting_from(*start), time_limit(math.inf, "", stop)
    frames = max(round(length / settings.dt), 1)
    until = frames * settings.dt
    if until * rate > COMPARABLE * AGREEMENT:
        rule = f"be short enough for a comparison of trajectories, {COMPARABLE * AGREEMENT / rate:g}"
        instead = "Beyond that two correct solvers differ: compare averages such as pressure."
        raise checks.refusal("a frame", rule, f"{until:g}", instead)
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

CHUNKS = 21  # number of timed pieces; their median is the cost and their quartiles the spread

CHUNK_SECONDS = 0.002
"""Approximate length of a timed piece: mostly shorter than a time slice of the scheduler, so that on a busy machine
most pieces are not interrupted."""

WHOLE = 16  # pieces of a run that is timed as a whole; its discs are counted after each
WHOLE_SECONDS = 1.0  # seconds after which no other whole run is timed


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

    until: simulated time after which the scene starts again [time].
    """
    if not capabilities_of(settings).has_steps:  # so that dt does not matter for the cost
        settings = replace(settings, dt=until / 1000)
    if adds_discs(scene):
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


# --- All runs of a study

FILE = "trade-off study", 6
"""Kind and version of a file of runs: those that were divided or counted differently must not be mixed."""

PAIRS = 300_000
"""Collisions in all replicas of a candidate together, if no length of the runs is given: they determine the pressure of
a gas to about 0.1 % (relative error of Z - 1: 1.1 / sqrt(collisions))."""

DECORRELATION_TIMES = 10
"""Least length of replicas in units of their decorrelation time: shorter runs share the structure of a dense gas, which
changes slowly."""

REFERENCE = 2
"""Replicas of the exact reference, over those of a candidate, so that its noise adds little. Another one, which costs
more than all candidates together, has as many."""

TIME_LIMIT_FACTOR, LEAST_TIME_LIMIT = 10.0, 10.0
"""Time limit of a run of the reference: this multiple of the forecast, and at least so many seconds."""

RELIABLE_SECONDS = 1.0  # forecast time of runs from which on their measured time corrects later forecasts [s]

ROUNDING = 1e-8
"""Size of a drift or an overlap in runs of the reference from which on it is not rounding: impulses are summed in steps
of 2^-32."""

COARSER = 2
"""Step, or contact time, of the runs that estimate the error of a reference that is not exact, in its own."""


class CandidateFailed(Exception):  # noqa: N818 - an outcome, not an error
    """A candidate, or the reference, could not be run to the end; the text says why. Results of its runs raise it."""


class Ensemble:
    """All runs on one scene; the arguments are those of `tradeoff`. `ensemble` makes it.

    Attributes:
        until: length of a long run [time].
        memory: time after which runs of one start are independent, and may be stationary [time].
    """

    def __init__(
        self,
        scene: Scene,
        until: float | None,
        measures: Sequence[str],
        *,
        replicas: int,
        starts: StartsGiven,
        seconds: float,
        contact_time: float | None,
        runner: Runner[str],
        file: RunFile,
        progress: Show,
    ):
        until = scene.duration if until is None else checks.positive("until", until, "[time]")
        self.replicas = replicas
        self.measures: tuple[str, ...] = tuple(measures)
        self._long = [name for name in measures if name in LONG]
        self._short = [name for name in measures if name in SHORT]
        self._scene = scene
        self._runner = runner
        self._further: dict[int, tuple[tuple[State, float], ...]] = {}
        self._slowness = 1.0  # time of parallel runs over their forecast from a single one
        self._progress = progress
        contact_time = None if contact_time is None else _checked_contact_time(scene, contact_time)
        _demand_times(scene)
        self.starts: Starts = Starts(scene, starts)
        title = {"scene": scene.digest(), "starts": self.starts.key, "contact_time": contact_time}
        file.demand(**title)
        progress(0, 1, "preliminary run")
        earlier = file.head.get("reference")
        self.preliminary: PreliminaryRun = preliminary_run(scene, until, earlier, seconds, contact_time)
        self.chosen: bool = until is None
        self.until: float
        self.memory: float
        self.until, self.memory = self._planned(until)
        self._file, self._results = file, dict[str, Any]()
        first = self.preliminary
        self._speed = first.thermal_velocity * math.sqrt(2)
        title["plan"] = [self.until, self._speed, first.short, first.growth, self.memory]
        file.begin(title, self._take, reference=first.reference_name)

    def _take(self, line: dict[str, Any]) -> None:
        self._results[str(line["key"])] = dict(line["result"])

    def _put(self, key: str, result: dict[str, Any]) -> None:
        """Keep a result, in the file as well unless it is due to this machine."""
        self._results[key] = result
        if "machine" not in result:
            self._file.append({"key": key, "result": result})

    def _planned(self, until: float | None) -> tuple[float, float]:
        """`until`, or if it is None the time of PAIRS collisions and decorrelated replicas, and `memory`."""
        first = self.preliminary
        memory = math.log(1 / VARIATION) / first.growth
        if until is None:
            crossing = 2 * self._scene.smallest_radius / first.thermal_velocity
            least = min(max(2 * crossing, DECORRELATION_TIMES * memory * first.exact), 1e3 * crossing)
            usual = PAIRS / (first.collisions * self.replicas) if first.collisions else 100 * crossing
            until = float(np.clip(usual, least, 1e5 * crossing)) if first.collisions else usual
        return until, memory if self.starts.same and memory < until / 2 else 0.0

    def warning_of(self, settings: Settings) -> str:
        """The FastWarning of a run of the scene with these settings, or ""."""
        if settings.on_fast != "warn":
            return ""
        with quietly(), access.caught(FastWarning) as texts:

            def stop_at_the_first(done: int, frames: int) -> None:
                if texts:
                    raise Stopped

            with suppress(Stopped), Simulation(self._scene, replace(settings, workers=1)) as sim:
                sim.run(until=self.until, progress=stop_at_the_first)
        return texts[0] if texts else ""

    def framed(self, settings: Settings) -> Settings:
        """The exact solver with the frames of the reference, if a thermostat acts once a frame."""
        if self._scene.thermostat is None or capabilities_of(settings).has_steps or not self.preliminary.exact:
            return settings
        return replace(settings, dt=self.preliminary.reference.dt)

    def assess(self, candidates: Iterable[Settings], replicas: int | None = None, first: int = 0) -> None:
        """Do those accuracy runs of the candidates and the reference that are missing.

        Args:
            candidates: settings; those that differ only in speed share their runs.
            replicas: number of runs of each, numbered from `first` on.
            first: runs of other numbers are independent.
        """
        replicas, known = replicas or self.replicas, self.preliminary
        unique = {key_of(each): each for each in map(self._physics, candidates)}
        wanted = [(known.reference, number) for number in self._reference_numbers(replicas, first)]
        if not known.exact and not first:
            wanted += [(self._coarser_reference, number) for number in range(self.replicas)]
        wanted += [(each, number) for each in unique.values() for number in range(first, first + replicas)]
        tasks: dict[str, tuple[Any, ...]] = {}
        forecast, begun = 0.0, time.monotonic()
        for settings, number in wanted if self._long else ():
            key = f"long {key_of(settings)} {number}"
            if key not in self._results:
                tasks[key] = long_run, self.starts[number], settings, self.until, self._speed, self._limit_of(settings)
                forecast += self._seconds_of(settings)
        for key, settings in unique.items() if self._short else ():
            for number, start in self._starts(first):
                if f"short {key} {number}" not in self._results:
                    arguments = self._scene, settings, known.reference, start, known.short, known.growth
                    tasks[f"short {key} {number}"] = short_run, *arguments
        self._runner.run(
            tasks.items(),
            lambda key, future: self._put(key, future.result()),
            lambda done: self._progress(done, len(tasks), "accuracy"),
        )
        if (forecast := forecast / usable_cores()) > RELIABLE_SECONDS:
            self._slowness = (time.monotonic() - begun) / forecast

    def _limit_of(self, settings: Settings) -> float:
        """Seconds after which a run is given up: from some starts the exact solver never reaches the end."""
        if capabilities_of(settings).has_steps:
            return math.inf
        return max(TIME_LIMIT_FACTOR * self.preliminary.seconds * self.until, LEAST_TIME_LIMIT)

    def _reference_numbers(self, replicas: int, first: int) -> range:
        """Numbers of the runs of the reference beside those of a candidate."""
        return range(first, first + replicas * (REFERENCE if self.preliminary.exact else 1))

    @property
    def _coarser_reference(self) -> Settings:
        """Settings to compare a reference that is not exact with, to estimate its error."""
        reference, model = self.preliminary.reference, self.preliminary.contact_time
        changed = {"dt": COARSER * reference.dt} if model is None else {"contact_time": COARSER * model}
        return self._physics(replace(reference, **changed))

    def seconds_for(self, settings: Settings, replicas: int, verify: bool = False) -> float:
        """Forecast of the time of a candidate's accuracy runs [s]; verify: including those of the reference."""
        references = len(self._reference_numbers(replicas, 0)) if verify else 0
        runs = replicas * self._seconds_of(settings) + references * self._seconds_of(self.preliminary.reference)
        return self._slowness * runs / usable_cores()

    def _seconds_of(self, settings: Settings) -> float:
        """Forecast of the time of one accuracy run by itself [s]."""
        if settings == self.preliminary.reference or not capabilities_of(settings).has_steps:
            return self.preliminary.seconds * self.until
        steps = self.until / settings.dt * settings.substeps
        return steps * settings.passes * self.preliminary.step_seconds

    def time(self, candidates: Sequence[Settings]) -> None:
        """Measure the cost of candidates, one after the other, with nothing else running."""
        for done, settings in enumerate(candidates):
            if len(candidates) > 1:
                self._progress(done, len(candidates), "timing")
            key = f"cost {key_of(settings)}"
            if key not in self._results:
                self._put(key, measure(self._scene, settings, self.until))
        self._progress(len(candidates), len(candidates), "timing")

    def _found(self, keys: Iterable[str], whose: str = "") -> list[dict[str, Any]]:
        """Results of runs. If one has failed, the text of CandidateFailed begins with `whose`."""
        found = [self._results[key] for key in keys]
        for each in found:
            if "failure" in each:
                raise CandidateFailed(whose + each["failure"])
        return found

    def cost(self, settings: Settings) -> Cost:
        """The cost that `time` has measured."""
        (found,) = self._found([f"cost {key_of(settings)}"])
        return Cost(**found)

    def errors(self, settings: Settings, replicas: int | None = None, first: int = 0) -> dict[str, Deviation]:
        """The errors from the runs of `assess`."""
        physics = self._physics(settings)
        errors: dict[str, Deviation] = {}
        if self._long:
            errors = self._long_errors(physics, replicas or self.replicas, first)
            if not self.preliminary.exact:
                own = self._long_errors(self._coarser_reference, self.replicas, 0)
                for name, error in errors.items():
                    if error.measurable and own[name].measurable:  # what changes when step or time is doubled
                        errors[name] = replace(error, systematic=abs(own[name].value))
        if self._short:
            keys = [f"short {key_of(physics)} {number}" for number, _ in self._starts(first)]
            errors |= short_deviations(self._found(keys), self._short)
        if physics == self.preliminary.reference:  # 0 from itself, not noise; but what it should keep may change
            errors = {name: each if _is_wrong(name, each) else Deviation(0.0, 0.0) for name, each in errors.items()}
        return {name: errors[name] for name in self.measures}

    def _long_errors(self, physics: Settings, replicas: int, first: int) -> dict[str, Deviation]:
        found = self._found(f"long {key_of(physics)} {number}" for number in range(first, first + replicas))
        return deviations(found, self._reference_runs(replicas, first), self._long, self._least)

    def _reference_runs(self, replicas: int, first: int = 0) -> list[dict[str, Any]]:
        key = key_of(self.preliminary.reference)
        numbers = self._reference_numbers(replicas, first)
        return self._found((f"long {key} {number}" for number in numbers), "the reference failed, ")

    @property
    def _least(self) -> int:
        """First piece of a run that may be stationary: there runs of one start have become independent."""
        return math.ceil(PIECES * self.memory / self.until)

    def demand_measurable(self, budgets: Mapping[str, float]) -> None:
        """Refuse measures whose errors would be meaningless, judged by the reference alone: NotMeasurableError."""
        runs = self._reference_runs(self.replicas) if self._long else []
        for name in self._long:
            if reason := self._why_not(name, runs) or self._too_rough(name, budgets[name]):
                raise NotMeasurableError(f"{name} is not measurable here: {reason}")

    def _why_not(self, name: str, runs: list[dict[str, Any]]) -> str:
        """Why runs of the reference do not determine a measure, or ""."""
        if OBSERVABLES[name].error != "relative":  # but 0, unless a collision goes wrong
            met = any(np.any(run["met"]) or np.any(run.get("pressure", 0.0)) for run in runs)
            if self._scene.obstacles or met:
                return ""
            return (
                f"no collisions occurred in any of {len(runs)} runs of the reference, to {self.until:.3g}, so "
                f"that no step is too long for {name}. Ask for longer runs (until=...)."
            )
        reference = np.array([run[name] for run in runs], dtype=float)
        reason = unmeasurable(name, reference)
        if not reason and self.chosen and spans_of(reference, self._least).steady is None:
            return (
                f"the scene still changes with time in runs of {self.until:.3g}, and has no duration. Give "
                "the length of a run: until=..., or Scene(duration=...)."
            )
        return reason

    def _too_rough(self, name: str, budget: float) -> str:
        """Why a reference that is not exact cannot resolve an error as small as a budget, or ""."""
        if self.preliminary.exact:
            return ""
        own = self._long_errors(self._coarser_reference, self.replicas, 0)[name]
        if not own.measurable or abs(own.value) - own.noise < budget:
            return ""
        model, dt = self.preliminary.contact_time, self.preliminary.reference.dt
        what, finer = f"dt={dt:.3g}, the finest affordable", "more time (seconds=...)"
        if model is not None:
            what, finer = f"contact_time={model:g}", "a shorter contact_time"
        return (
            f"the reference with {what}, is itself uncertain by {abs(own.value):.2g}: {name} changes by this much when "
            f"that is doubled. Allow a larger error, give {finer}, or ask for another measure."
        )

    def _starts(self, first: int) -> list[tuple[int, tuple[State, float]]]:
        """Numbered starts of short runs, different for each `first`."""
        if first and first not in self._further:
            self._further[first] = self.preliminary.further_starts(self._scene, first)
        return list(enumerate(self._further[first] if first else self.preliminary.starts, start=first))

    def _physics(self, settings: Settings) -> Settings:
        """Of a candidate's accuracy runs: standard values of what changes only speed, so that equal ones share runs."""
        method = methods.choose(self._scene.count, settings).method
        if capabilities_of(settings).has_steps:
            physics = replace(settings, method="grid" if method == "parallel" else method, workers=None)
        else:
            dt = Settings.dt if self._scene.thermostat is None else settings.dt  # it acts once a frame
            physics = Settings(dt=dt, method=method, contact_time=settings.contact_time)
        return self.preliminary.reference if self.preliminary.is_reference(physics) else physics


@contextmanager
def ensemble(
    scene: Scene,
    until: float | None,
    measures: Sequence[str],
    *,
    most: int,
    replicas: int,
    seconds: float,
    executor: Executor | None,
    path: str | Path | None,
    progress: bool | Show | None,
    **how: Any,
) -> Iterator[Ensemble]:
    """The runs of `tradeoff` or `tune`, whose arguments these are, with its file, progress and threads.

    most: replicas at most; how: starts and contact_time.
    """
    replicas = checks.whole("replicas", replicas, 2, most, "16 will do for most scenes.")
    seconds = checks.positive("seconds", seconds, "[s]")
    show = shown(checked_progress(progress, "progress(done, of, what)"))
    with terminated_by_exit(), RunFile(path, *FILE) as file, show as say, Runner[str](executor) as runner:
        how |= {"replicas": replicas, "seconds": seconds, "runner": runner, "file": file, "progress": say}
        yield Ensemble(scene, until, measures, **how)


def _is_wrong(name: str, own: Deviation) -> bool:
    """Whether a measure that is 0 in an exact run by definition exceeds rounding in the runs of the reference."""
    return OBSERVABLES[name].error in ("mean", "largest", "depth") and abs(own.value) > ROUNDING


def _checked_contact_time(scene: Scene, contact_time: float) -> float:
    """A contact time with which the reference runs, and COARSER times as long, too, for its uncertainty [time]."""
    contact_time, longest = checks.positive("contact_time", contact_time, "[time]"), longest_contact_time(scene)
    if COARSER * contact_time > longest:
        raise InputError(
            f"contact_time must be at most {longest / COARSER:.3g} here: the uncertainty of the reference is found "
            f"with one {COARSER} times as long, and above {longest:.3g} discs that should rest under gravity bounce "
            f"higher than their radius; got {contact_time:.3g}. Give a shorter one, such as "
            f"{contact_time_at_rest(scene):.1g}."
        )
    return contact_time


def _demand_times(scene: Scene) -> None:
    """Refuse emitters that count frames, with which each dt is another scene."""
    for index, emitter in enumerate(scene.emitters):
        if emitter.every is not None:
            raise InputError(
                f"a trade-off study needs emitters that count time; emitters[{index}] counts frames "
                f"(every={emitter.every}), so that each dt is another scene. Use Emitter(interval=...)."
            )
