"""Runs of many candidates on one scene, through any executor, with saved results."""

import dataclasses
import json
import math
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeVar

import numpy as np

from mpsim.core import checks, files
from mpsim.core.machine import usable_cores
from mpsim.core.state import State
from mpsim.engine import access
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.event_block import contact_time_at_rest, longest_contact_time
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import FastWarning, InputError, NotMeasurableError, OutputError
from mpsim.features.energy import adds_discs
from mpsim.measure.registry import LONG, OBSERVABLES, SHORT
from mpsim.scene.scene import Scene, no_scene
from mpsim.scene.settings import Settings
from mpsim.studies import replicas
from mpsim.studies.deviations import Deviation, deviations, short_deviations, spans_of, unmeasurable
from mpsim.studies.preliminary import VARIATION, PreliminaryRun, Starts, StartsGiven, preliminary_run
from mpsim.studies.replicas import PIECES, Cost, Plan, Stopped, key_of, long_run, physics_of, quietly, short_runs

# --- Runs independent tasks on any executor, yields results as they come, and cancels those that have not started

POLL_SECONDS = 0.2
"""Seconds between two checks for signals while threads run: one delivered to another thread wakes no waiting one."""

MOST_SUBMITTED = 4096
"""Tasks that an executor holds at most: many for each worker of a large cluster, without memory for millions."""

Key = TypeVar("Key")


def checked_executor(executor: Any) -> Executor | None:
    """An executor, or None, checked.

    Raises:
        InputError: if it is not an executor.
    """
    if executor is not None and not isinstance(executor, Executor):
        raise InputError(
            f"executor must be a concurrent.futures.Executor; got {type(executor).__name__}. Use "
            "ProcessPoolExecutor(), Dask's client.get_executor(), mpi4py's MPIPoolExecutor(), or leave it out."
        )
    return executor


class Submissions(Generic[Key]):
    """Tasks that are handed to an executor, at most MOST_SUBMITTED of them at a time.

    Args:
        executor: any of concurrent.futures.
        tasks: (key, (function, argument, ...)) each; read as far as tasks are handed over.
    """

    def __init__(self, executor: Executor, tasks: Iterable[tuple[Key, tuple[Any, ...]]]):
        self._executor = executor
        self._tasks = iter(tasks)
        self._pending: dict[Future[Any], Key] = {}
        self._finished: SimpleQueue[Future[Any]] = SimpleQueue()

    def finished(self) -> Iterator[tuple[Key, Future[Any]]]:
        """Each key with its future, when that is done. After an executor has broken, futures hold its error."""
        while self._submit():
            try:
                future = self._finished.get(timeout=POLL_SECONDS)
            except Empty:
                continue
            yield self._pending.pop(future), future

    def _submit(self) -> bool:
        """Hand over what there is room for; returns whether anything is pending."""
        while len(self._pending) < MOST_SUBMITTED and (task := next(self._tasks, None)) is not None:
            key, call = task
            future = self._future(call)
            self._pending[future] = key
            future.add_done_callback(self._finished.put)
        return bool(self._pending)

    def _future(self, call: tuple[Any, ...]) -> Future[Any]:
        """The future of a task; it holds the error of an executor that has broken, or could not send the task."""
        try:
            return self._executor.submit(*call)
        except Exception as error:
            if isinstance(error, RuntimeError) and not isinstance(error, BrokenExecutor):
                raise InputError(
                    f"executor must accept tasks; got {type(self._executor).__name__}, which does not ({error}). Make "
                    "one that is not shut down, and call inside its `with` block."
                ) from error
            future = Future[Any]()
            future.set_exception(error)
            return future

    def cancel(self) -> None:
        """Cancel the tasks that have not started."""
        for future in tuple(self._pending):
            future.cancel()

    def left(self) -> Iterator[tuple[Key, Future[Any]]]:
        """Tasks that have succeeded, and that `finished` has not yielded."""
        for future, key in self._pending.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                yield key, future


# --- Saved results of a trade-off study: by key, in memory and in a file

FORMAT = 3
"""Of the file: results of runs that were divided or counted differently must not be mixed."""

SAVE_EVERY = 1.0
"""Seconds between two writes of the file."""

MOST_BYTES = 2**23
"""Largest size of the file: thousands of runs with all their errors."""


class SavedResults:
    """Results by key, in memory and, if there is a path, in a JSON file that is always complete."""

    def __init__(self, path: str | Path | None, scene: str):
        self._path = None if path is None else checked_path(path)
        self._results: dict[str, Any] = {}
        self._title = {"format": FORMAT, "scene": scene}
        self._plan: str | None = None
        self.reference: str | None = None
        self._open = False
        self._saved = time.monotonic()
        if self._path is not None and self._path.exists():
            self._plan, self.reference, self._results = _loaded(self._path, self._title)

    def open(self, plan: str, reference: str) -> None:
        """Start to save results of a plan and a reference, which must be those of an existing file."""
        if self._plan not in (None, plan):
            raise _other(self._path)
        self._plan, self.reference, self._open = plan, reference, True

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Any:
        return self._results[key]

    def put(self, key: str, value: Any) -> None:
        """Add a result; it is written to the file within SAVE_EVERY seconds, or at the end."""
        self._results[key] = value
        if time.monotonic() - self._saved > SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Write the file; if the process is killed, the old or the new one remains."""
        self._saved = time.monotonic()
        if self._path is not None and self._open:
            results = {key: value for key, value in self._results.items() if "machine" not in value}
            kept = {"title": self._title, "plan": self._plan, "reference": self.reference, "results": results}
            try:
                files.write_text(self._path, json.dumps(kept))
            except OSError as error:
                raise OutputError(
                    f"path must be a file in a folder that can be written to, with room on its disk; got "
                    f"{str(self._path)!r} ({error.strerror or error}). Make room, or give another path."
                ) from error


def checked_path(path: str | os.PathLike[str]) -> Path:
    """A path that can be written, checked before the long work.

    Raises:
        InputError: if it cannot.
    """
    try:
        files.check_target(Path(path))
    except (OSError, TypeError, ValueError) as error:  # the last two: no path at all
        raise InputError(
            f"path must be a file in a folder that can be written to; got {path!r} "
            f"({getattr(error, 'strerror', None) or error}). Make the folder, or give another path."
        ) from None
    return Path(path)


def _loaded(path: Path, title: dict[str, Any]) -> tuple[str, str, dict[str, Any]]:
    try:
        kept = files.json_value(path, MOST_BYTES)
        found, plan, reference, results = kept["title"], kept["plan"], kept["reference"], dict(kept["results"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(
            f"path must be a file of an earlier trade-off study, or none yet; {path} cannot be read as one "
            f"({error!s:.200}). Remove it, or give another path."
        ) from None
    if found != title:
        raise _other(path)
    return plan, reference, results


def _other(path: Path | None) -> InputError:
    return InputError(
        f"path must be a file of the same scene and the same lengths of runs; {path} is of others. "
        "Remove it, or give another path."
    )


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

RELIABLE_SECONDS = 1.0
"""Forecast time of runs from which on their measured time corrects later forecasts [s]."""

ROUNDING = 1e-8
"""Size of a drift or an overlap in runs of the reference from which on it is not rounding: impulses are summed in steps
of 2^-32."""

COARSER = 2
"""Step, or contact time, of the runs that estimate the error of a reference that is not exact, in its own."""


class CandidateFailed(Exception):  # noqa: N818 - an outcome, not an error
    """A candidate could not be run to the end; the text says why."""


class Ensemble:
    """All runs on one scene. Use it in a `with` block: leaving it ends its threads and writes its file.

    Args:
        scene: the scene.
        until: length of a long run [time]; None: the scene's duration; without one, see PAIRS.
        measures: names of the errors to determine.
        replicas: long runs per candidate.
        starts: see `Starts`.
        seconds: approximate time that everything may take [s]; a stepped reference is as fine as that allows.
        contact_time: of the exact solver as the reference, which makes it a model [time]; None: its own.
        executor: for accuracy runs; None: threads.
        path: of the file, or None.
        progress: called as progress(done, of, what).
    """

    def __init__(
        self,
        scene: Scene,
        until: float | None,
        measures: Sequence[str],
        *,
        replicas: int,
        starts: StartsGiven = None,
        seconds: float = 150.0,
        contact_time: float | None = None,
        executor: Executor | None = None,
        path: str | Path | None = None,
        progress: Callable[[int, int, str], None] | None = None,
    ):
        if not isinstance(scene, Scene):
            raise no_scene(scene)
        if until is not None:
            until = checks.positive("until", until, "[time]")
        if contact_time is not None:
            contact_time = _checked_contact_time(scene, contact_time)
        checked_executor(executor)
        _demand_times(scene)
        self.starts: Starts = Starts(scene, starts)
        model = "" if contact_time is None else f" contact_time={contact_time!r}"
        self._saved = SavedResults(path, f"{scene.digest()} {self.starts.key}{model}")
        until = scene.duration if until is None else until
        self._progress = progress or (lambda done, of, what: None)
        self._progress(0, 1, "preliminary run")
        self.preliminary: PreliminaryRun = preliminary_run(scene, until, self._saved.reference, seconds, contact_time)
        self.chosen: bool = until is None
        until = _length(self.preliminary, scene, replicas) if until is None else until
        memory = _usable_decorrelation_time(self.preliminary, until) if self.starts.same else 0.0
        speed = self.preliminary.thermal_velocity * np.sqrt(2)
        self.plan: Plan = Plan(
            until=until,
            speed=speed,
            short=self.preliminary.short,
            rate=self.preliminary.growth,
            memory=memory,
        )
        self.measures: tuple[str, ...] = tuple(measures)
        self.replicas = replicas
        self._scene = scene
        self._executor = executor
        self._threads: ThreadPoolExecutor | None = None
        self._stop = threading.Event()
        self._further: dict[int, tuple[State, ...]] = {}
        self._slowness = 1.0  # time of parallel runs over their forecast from a single one
        self._saved.open(f"{self.plan}", self.preliminary.reference_name)

    def __enter__(self) -> "Ensemble":
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            if self._threads is not None:
                self._stop.set()
                self._threads.shutdown(cancel_futures=True)
                self._threads = None
        finally:
            self._saved.save()

    def announce(self, text: str) -> None:
        """Announce through `progress` what comes next."""
        self._progress(0, 1, text)

    def warning_of(self, settings: Settings) -> str:
        """The FastWarning of a run of the scene with these settings, or ""."""
        if settings.on_fast != "warn":
            return ""
        with quietly(), access.caught(FastWarning) as texts:

            def stop_at_the_first(done: int, frames: int) -> None:
                if texts:
                    raise Stopped

            with suppress(Stopped), Simulation(self._scene, dataclasses.replace(settings, workers=1)) as sim:
                sim.run(until=self.plan.until, progress=stop_at_the_first)
        return texts[0] if texts else ""

    def framed(self, settings: Settings) -> Settings:
        """The exact solver with the frames of the reference, if a thermostat acts once a frame."""
        if self._scene.thermostat is None or capabilities_of(settings).has_steps or not self.preliminary.exact:
            return settings
        return dataclasses.replace(settings, dt=self.preliminary.reference.dt)

    def assess(self, candidates: Iterable[Settings], replicas: int | None = None, first: int = 0) -> None:
        """Do those accuracy runs of the candidates and the reference that are missing.

        Args:
            candidates: settings; those that differ only in speed share their runs.
            replicas: number of runs of each, numbered from `first` on.
            first: runs of other numbers are independent.
        """
        replicas = replicas or self.replicas
        numbers = range(first, first + replicas)
        reference = range(first, first + self._references(replicas))
        wanted = [(self.preliminary.reference, number) for number in reference]
        if not self.preliminary.exact and not first:
            wanted += [(self._physics(self._coarser_reference), number) for number in range(self.replicas)]
        unique = {key_of(each): each for each in map(self._physics, candidates)}
        wanted += [(each, number) for each in unique.values() for number in numbers]
        tasks: dict[str, tuple[Any, ...]] = {}
        forecast, begun = 0.0, time.monotonic()
        for settings, number in wanted if self._asks_for(LONG) else ():
            key = f"long {key_of(settings)} {number}"
            if key not in self._saved:
                tasks[key] = long_run, self.starts[number], settings, self.plan, self._limit_of(settings)
                forecast += self._seconds_of(settings)
        for key, settings in unique.items() if self._asks_for(SHORT) else ():
            for number, start in self._starts(first):
                arguments = short_runs, self._scene, settings, self.plan, start, self.preliminary.reference
                tasks[f"short {key} {number}"] = arguments
        self._run({key: task for key, task in tasks.items() if key not in self._saved})
        if (forecast := forecast / usable_cores()) > RELIABLE_SECONDS:
            self._slowness = (time.monotonic() - begun) / forecast

    def _limit_of(self, settings: Settings) -> float:
        """Seconds after which a run is given up: from some starts the exact solver never reaches the end."""
        if capabilities_of(settings).has_steps:
            return math.inf
        return max(TIME_LIMIT_FACTOR * self.preliminary.seconds * self.plan.until, LEAST_TIME_LIMIT)

    def _references(self, replicas: int) -> int:
        """Number of runs of the reference for so many of a candidate."""
        return replicas * (REFERENCE if self.preliminary.exact else 1)

    @property
    def _coarser_reference(self) -> Settings:
        """Settings to compare a reference that is not exact with, to estimate its error."""
        reference, model = self.preliminary.reference, self.preliminary.contact_time
        if model is not None:
            return dataclasses.replace(reference, contact_time=COARSER * model)
        return dataclasses.replace(reference, dt=COARSER * reference.dt)

    def seconds_for(self, settings: Settings, replicas: int, verify: bool = False) -> float:
        """Forecast of the time of a candidate's accuracy runs [s]; verify: including those of the reference."""
        references = self._references(replicas) if verify else 0
        runs = replicas * self._seconds_of(settings) + references * self._seconds_of(self.preliminary.reference)
        return self._slowness * runs / usable_cores()

    def _seconds_of(self, settings: Settings) -> float:
        """Forecast of the time of one accuracy run by itself [s]."""
        if settings == self.preliminary.reference or not capabilities_of(settings).has_steps:
            return self.preliminary.seconds * self.plan.until
        steps = self.plan.until / settings.dt * settings.substeps
        return steps * settings.passes * self.preliminary.step_seconds

    def time(self, candidates: Sequence[Settings]) -> None:
        """Measure the cost of candidates, one after the other, with nothing else running."""
        for done, settings in enumerate(candidates):
            if len(candidates) > 1:
                self._progress(done, len(candidates), "timing")
            key = f"cost {key_of(settings)}"
            if key not in self._saved:
                whole = adds_discs(self._scene)
                self._saved.put(key, replicas.measure(self._scene, settings, self.plan.until, whole))
        self._progress(len(candidates), len(candidates), "timing")

    def cost(self, settings: Settings) -> Cost:
        """The cost that `time` has measured.

        Raises:
            CandidateFailed: if the candidate could not be run.
        """
        found = self._saved[f"cost {key_of(settings)}"]
        _demand_success([found])
        return Cost(**found)

    def errors(self, settings: Settings, replicas: int | None = None, first: int = 0) -> dict[str, Deviation]:
        """The errors from the runs of `assess`.

        Raises:
            CandidateFailed: if a run did not reach its end.
        """
        replicas = replicas or self.replicas
        errors: dict[str, Deviation] = {}
        if self._asks_for(LONG):
            names = [name for name in self.measures if name in LONG]
            errors = self._long_errors(settings, replicas, first, names)
            if not self.preliminary.exact:
                own = self._long_errors(self._coarser_reference, self.replicas, 0, names)
                errors = {name: _with_systematic(each, own[name]) for name, each in errors.items()}
        if self._asks_for(SHORT):
            key = key_of(self._physics(settings))
            short = [self._saved[f"short {key} {number}"] for number, _ in self._starts(first)]
            _demand_success(short)
            errors |= short_deviations(short, self.measures)
        if self._is_reference(settings):  # its difference from itself is 0, not noise; what it keeps at 0 may not be
            errors = {name: each if _is_wrong(name, each) else Deviation(0.0, 0.0) for name, each in errors.items()}
        return {name: errors[name] for name in self.measures}

    def _long_errors(self, settings: Settings, replicas: int, first: int, names: list[str]) -> dict[str, Deviation]:
        key = key_of(self._physics(settings))
        found = [self._saved[f"long {key} {number}"] for number in range(first, first + replicas)]
        _demand_success(found)
        return deviations(found, self._reference_runs(replicas, first), names, self._least)

    def _reference_runs(self, replicas: int, first: int) -> list[dict[str, Any]]:
        key = key_of(self.preliminary.reference)
        numbers = range(first, first + self._references(replicas))
        runs = [self._saved[f"long {key} {number}"] for number in numbers]
        _demand_success(runs, "the reference failed, ")
        return runs

    @property
    def _least(self) -> int:
        """First piece of a run that may be stationary: there runs of one start have become independent."""
        return math.ceil(PIECES * self.plan.memory / self.plan.until)

    def _is_reference(self, settings: Settings) -> bool:
        return key_of(self._physics(settings)) == key_of(self.preliminary.reference)

    def demand_measurable(self, budgets: Mapping[str, float]) -> None:
        """Refuse measures whose errors would be meaningless, judged by the reference alone.

        Raises:
            NotMeasurableError: naming the measure, why, and what to ask for.
            CandidateFailed: if a run of the reference did not reach its end.
        """
        if self._asks_for(LONG):
            self._reference_runs(self.replicas, 0)
        for name, budget in budgets.items():
            reason = self._why_not(name) or self._too_rough(name, budget)
            if reason:
                raise NotMeasurableError(f"{name} is not measurable here: {reason}")

    def _too_rough(self, name: str, budget: float) -> str:
        """Why a reference that is not exact cannot resolve an error as small as a budget, or ""."""
        if self.preliminary.exact or name not in LONG:
            return ""
        own = self._long_errors(self._coarser_reference, self.replicas, 0, [name])[name]
        if not own.measurable or abs(own.value) - own.noise < budget:
            return ""
        if (model := self.preliminary.contact_time) is not None:
            return (
                f"the reference with contact_time={model:g} is itself uncertain by {abs(own.value):.2g}: {name} "
                "changes by this much when contact_time is doubled. Allow a larger error, give a shorter contact_time, "
                "or ask for another measure."
            )
        return (
            "the exact solver cannot do this scene, and the finest affordable run "
            f"(dt={self.preliminary.reference.dt:.3g}) is itself uncertain by {abs(own.value):.2g}: {name} "
            "changes by this much when its step is doubled. Allow a larger error or more time (seconds=...), or ask "
            "for "
            "another measure."
        )

    def _why_not(self, name: str) -> str:
        """Why the reference does not determine a measure, or ""."""
        if name not in LONG:
            return ""
        if OBSERVABLES[name].error != "relative":
            return self._why_idle(name)
        reference = np.array([run[name] for run in self._reference_runs(self.replicas, 0)], dtype=float)
        reason = unmeasurable(name, reference)
        if not reason and self.chosen and spans_of(reference, self._least).steady is None:
            reason = (
                f"the scene still changes with time in runs of {self.plan.until:.3g}, and has no duration. Give "
                "the length of a run: until=..., or Scene(duration=...)."
            )
        return reason

    def _why_idle(self, name: str) -> str:
        """Why a measure whose errors come from collisions alone has none, as there are no collisions; or ""."""
        runs = self._reference_runs(self.replicas, 0)
        if self._scene.obstacles or any(np.any(run["met"]) or np.any(run.get("pressure", 0.0)) for run in runs):
            return ""
        return (
            f"no collisions occurred in any of {len(runs)} runs of the reference, to {self.plan.until:.3g}, so that no "
            f"step is too long for {name}. Ask for longer runs (until=...)."
        )

    def _asks_for(self, kind: Sequence[str]) -> bool:
        return any(name in kind for name in self.measures)

    def _starts(self, first: int) -> list[tuple[int, State]]:
        """Numbered starts of short runs, different for each `first`."""
        starts = self.preliminary.starts
        if not first:
            return list(enumerate(starts))
        if first not in self._further:
            self._further[first] = self.preliminary.further_starts(self._scene, first)
        return list(enumerate(self._further[first], start=first))

    def _physics(self, settings: Settings) -> Settings:
        """The settings of a candidate's accuracy runs."""
        physics = physics_of(settings, self._scene)
        return self.preliminary.reference if self.preliminary.is_reference(physics) else physics

    def _run(self, tasks: dict[str, tuple[Any, ...]]) -> None:
        """Run tasks through the executor, and save each result as it comes."""
        if self._executor is None and self._threads is None:
            # Kernels release the GIL, so threads use every core, and no process has to be started.
            self._threads = ThreadPoolExecutor(usable_cores(), "mpsim-accuracy")
        executor = self._executor or self._threads
        assert executor is not None
        ours = () if self._executor else (self._stop,)  # an event cannot be sent to another process
        submitted = Submissions(executor, ((key, (*task, *ours)) for key, task in tasks.items()))
        try:
            for done, (key, future) in enumerate(submitted.finished()):
                self._saved.put(key, future.result())
                self._progress(done + 1, len(tasks), "accuracy")
        finally:
            submitted.cancel()
            for key, future in submitted.left():
                self._saved.put(key, future.result())


def _length(first: PreliminaryRun, scene: Scene, replicas: int) -> float:
    """Length of a long run, for PAIRS collisions in all replicas together and decorrelated replicas [time]."""
    crossing = 2 * scene.smallest_radius / first.thermal_velocity
    if first.collisions == 0:
        return 100 * crossing
    least = max(2 * crossing, DECORRELATION_TIMES * _decorrelation_time(first)) if first.exact else 2 * crossing
    return float(np.clip(PAIRS / (first.collisions * replicas), min(least, 1e3 * crossing), 1e5 * crossing))


def _decorrelation_time(first: PreliminaryRun) -> float:
    """Time in which replicas decorrelate [time]."""
    return math.log(1 / VARIATION) / first.growth


def _usable_decorrelation_time(first: PreliminaryRun, until: float) -> float:
    """Time in which runs of one start decorrelate [time]; 0 if that is more than half of a run."""
    memory = _decorrelation_time(first)
    return memory if memory < until / 2 else 0.0


def _is_wrong(name: str, own: Deviation) -> bool:
    """Whether a measure that is 0 in an exact run by definition exceeds rounding in the runs of the reference."""
    return OBSERVABLES[name].error in ("mean", "largest", "depth") and abs(own.value) > ROUNDING


def _with_systematic(found: Deviation, own: Deviation) -> Deviation:
    """The error with the uncertainty of a reference that is not exact: its change when step or time is doubled."""
    return dataclasses.replace(found, systematic=abs(own.value)) if own.measurable and found.measurable else found


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


def _demand_success(found: Sequence[dict[str, Any]], whose: str = "") -> None:
    failures = [each["failure"] for each in found if "failure" in each]
    if failures:
        raise CandidateFailed(whose + failures[0])
