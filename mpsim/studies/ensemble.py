"""Runs of many candidates on one scene: accuracy runs through an executor, timings alone, all kept in a file."""

import dataclasses
import math
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from mpsim.core import checks
from mpsim.core.errors import FastWarning, InputError, NotMeasurableError
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.engine.workers.cores import usable_cores
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies import cost
from mpsim.studies.cost import Cost
from mpsim.studies.deviations import RELATIVE, Deviation, deviations, short_deviations, unmeasurable
from mpsim.studies.independent_starts import VARIATION, Starts, StartsGiven
from mpsim.studies.preliminary import Pilot, pilot
from mpsim.studies.replicas import LONG, PIECES, SHORT, Plan, Stopped, key_of, long_run, physics_of, quietly, short_runs
from mpsim.studies.saved_results import Kept
from mpsim.studies.windows import spans_of

PAIRS = 300_000
"""Collisions in all replicas of a candidate together, where nobody says how long to run: they fix the pressure of a gas
to about 0.1 % (relative error of Z - 1: 1.1 / sqrt(collisions))."""

PARTINGS = 10
"""... but the replicas should live this many times as long as they need to part: the structure of a dense gas changes
slowly, and runs that are shorter have it in common."""

REFERENCE = 2
"""The exact reference has so many times the replicas of a candidate, so that its noise adds little; a stepped one,
which costs more than all candidates together, as many."""

PATIENCE, LEAST_PATIENCE = 10.0, 10.0
"""A run of the reference may take so many times as long as was forecast, and so many seconds at least."""

TELLING = 1.0
"""Seconds that runs must have been forecast to take for the time that they took to correct later forecasts."""

AGAIN = 2
"""Step of the runs that show how far a stepped reference may be off itself, in steps of the reference."""


class CandidateFailed(Exception):  # noqa: N818 - an outcome, not an error
    """A candidate could not be run to the end; the text says why."""


class Campaign:
    """All runs on one scene. Use it in a `with` block: leaving it ends its threads and writes its file.

    Args:
        scene: what is run.
        until: length of a long run [time]; None: that of the scene, or else see PAIRS.
        measures: names of errors that are wanted.
        replicas: long runs per candidate.
        starts: see `Starts`.
        seconds: that all may take, about [s]: a stepped reference is as fine as there is time for.
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
        executor: Executor | None = None,
        path: str | Path | None = None,
        progress: Callable[[int, int, str], None] | None = None,
    ):
        if not isinstance(scene, Scene):
            raise InputError(f"scene must be an mpsim.Scene; got {type(scene).__name__}. Make one with Scene(...).")
        if until is not None:
            until = checks.positive("until", until, "[time]")
        if executor is not None and not isinstance(executor, Executor):
            raise InputError(
                f"executor must be a concurrent.futures.Executor; got {type(executor).__name__}. Use "
                "ProcessPoolExecutor(), Dask's client.get_executor(), mpi4py's MPIPoolExecutor(), or leave it out."
            )
        _demand_times(scene)
        self.starts: Starts = Starts(scene, starts)
        self._kept = Kept(path, f"{scene.digest()} {self.starts.key}")
        until = scene.duration if until is None else until
        self._progress = progress or (lambda done, of, what: None)
        self._progress(0, 1, "preliminary run")
        self.pilot: Pilot = pilot(scene, until, self._kept.reference, seconds)
        self.chosen: bool = until is None
        until = _length(self.pilot, scene, replicas) if until is None else until
        speed, memory = self.pilot.speed * np.sqrt(2), _memory(self.pilot, until) if self.starts.same else 0.0
        self.plan: Plan = Plan(until, speed, self.pilot.short, self.pilot.growth, memory)
        self.measures: tuple[str, ...] = tuple(measures)
        self.replicas = replicas
        self._scene = scene
        self._executor = executor
        self._threads: ThreadPoolExecutor | None = None
        self._stop = threading.Event()
        self._further: dict[int, tuple[State, ...]] = {}
        self._slowness = 1.0  # of runs side by side, over what was forecast from one
        self._kept.open(f"{self.plan}", self.pilot.reference_name)

    def __enter__(self) -> "Campaign":
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            if self._threads is not None:
                self._stop.set()
                self._threads.shutdown(cancel_futures=True)
                self._threads = None
        finally:
            self._kept.save()

    def announce(self, text: str) -> None:
        """Tell whoever watches what comes."""
        self._progress(0, 1, text)

    def warning_of(self, settings: Settings) -> str:
        """What mpsim warns of the speeds in a run of the scene with these settings, or ""."""
        if settings.on_fast != "warn":
            return ""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", FastWarning)

            def stop_at_the_first(done: int, frames: int) -> None:
                if caught:
                    raise Stopped

            with suppress(Stopped), Simulation(self._scene, dataclasses.replace(settings, workers=1)) as sim:
                sim.run(until=self.plan.until, progress=stop_at_the_first)
        return str(caught[0].message) if caught else ""

    def assess(self, candidates: Iterable[Settings], replicas: int | None = None, first: int = 0) -> None:
        """Do the accuracy runs of candidates, and of the reference, that are not there yet.

        Args:
            candidates: settings; those that differ in speed alone share their runs.
            replicas: how many runs of each, `first` being the number of the first one.
            first: above 0 the runs are independent of those below.
        """
        replicas = replicas or self.replicas
        numbers = range(first, first + replicas)
        reference = range(first, first + self._references(replicas))
        wanted = [(self.pilot.reference, number) for number in reference]
        if not self.pilot.exact and not first:
            wanted += [(self._physics(self._coarser_reference), number) for number in range(self.replicas)]
        unique = {key_of(each): each for each in map(self._physics, candidates)}
        wanted += [(each, number) for each in unique.values() for number in numbers]
        tasks: dict[str, tuple[Any, ...]] = {}
        forecast, begun = 0.0, time.monotonic()
        for settings, number in wanted if self._asks_for(LONG) else ():
            key = f"long {key_of(settings)} {number}"
            if key not in self._kept:
                tasks[key] = long_run, self.starts[number], settings, self.plan, self._limit_of(settings)
                forecast += self._seconds_of(settings) / usable_cores()
        for key, settings in unique.items() if self._asks_for(SHORT) else ():
            for number, start in self._starts(first):
                arguments = short_runs, self._scene, settings, self.plan, start, self.pilot.reference
                tasks[f"short {key} {number}"] = arguments
        self._run({key: task for key, task in tasks.items() if key not in self._kept})
        if forecast > TELLING:
            self._slowness = (time.monotonic() - begun) / forecast

    def _limit_of(self, settings: Settings) -> float:
        """Seconds after which a run is given up: there are starts of which the exact solver never comes to an end."""
        if settings.method != "event":
            return math.inf
        return max(PATIENCE * self.pilot.seconds * self.plan.until, LEAST_PATIENCE)

    def _references(self, replicas: int) -> int:
        """Runs of the reference beside so many of a candidate."""
        return replicas * (REFERENCE if self.pilot.exact else 1)

    @property
    def _coarser_reference(self) -> Settings:
        """What a stepped reference is compared with to see how far it may be off."""
        return dataclasses.replace(self.pilot.reference, dt=AGAIN * self.pilot.reference.dt)

    def seconds_for(self, settings: Settings, replicas: int, verify: bool = False) -> float:
        """Seconds that the accuracy runs of a candidate will take, about; verify: with as many of the reference."""
        references = self._references(replicas) if verify else 0
        runs = replicas * self._seconds_of(settings) + references * self._seconds_of(self.pilot.reference)
        return self._slowness * runs / usable_cores()

    def _seconds_of(self, settings: Settings) -> float:
        """Seconds of one accuracy run by itself, as forecast."""
        if settings == self.pilot.reference or settings.method == "event":
            return self.pilot.seconds * self.plan.until
        steps = self.plan.until / settings.dt * settings.substeps
        return steps * settings.passes * self.pilot.step_seconds

    def time(self, candidates: Sequence[Settings]) -> None:
        """Measure the cost of candidates, one after the other, with nothing else running."""
        for done, settings in enumerate(candidates):
            if len(candidates) > 1:
                self._progress(done, len(candidates), "timing")
            key = f"cost {key_of(settings)}"
            if key not in self._kept:
                whole = bool(self._scene.emitters)
                self._kept.put(key, cost.measure(self._scene, settings, self.plan.until, whole))
        self._progress(len(candidates), len(candidates), "timing")

    def cost(self, settings: Settings) -> Cost:
        """What `time` has measured.

        Raises:
            CandidateFailed: if it could not be run.
        """
        found = self._kept[f"cost {key_of(settings)}"]
        _demand_success([found])
        return Cost(**found)

    def errors(self, settings: Settings, replicas: int | None = None, first: int = 0) -> dict[str, Deviation]:
        """What `assess` has found.

        Raises:
            CandidateFailed: if a run did not come to its end.
        """
        replicas = replicas or self.replicas
        errors: dict[str, Deviation] = {}
        if self._asks_for(LONG):
            names = [name for name in self.measures if name in LONG]
            errors = self._long_errors(settings, replicas, first, names)
            if not self.pilot.exact:
                own = self._long_errors(self._coarser_reference, self.replicas, 0, names)
                errors = {name: _widened(each, own[name]) for name, each in errors.items()}
        if self._asks_for(SHORT):
            key = key_of(self._physics(settings))
            short = [self._kept[f"short {key} {number}"] for number, _ in self._starts(first)]
            _demand_success(short)
            errors |= short_deviations(short, self.measures)
        if self._is_reference(settings):  # its difference from itself is nothing, not noise
            errors = dict.fromkeys(errors, Deviation(0.0, 0.0))
        return {name: errors[name] for name in self.measures}

    def _long_errors(self, settings: Settings, replicas: int, first: int, names: list[str]) -> dict[str, Deviation]:
        key = key_of(self._physics(settings))
        found = [self._kept[f"long {key} {number}"] for number in range(first, first + replicas)]
        _demand_success(found)
        return deviations(found, self._reference_runs(replicas, first), names, self._least)

    def _reference_runs(self, replicas: int, first: int) -> list[dict[str, Any]]:
        key = key_of(self.pilot.reference)
        numbers = range(first, first + self._references(replicas))
        runs = [self._kept[f"long {key} {number}"] for number in numbers]
        _demand_success(runs, "the reference failed, ")
        return runs

    @property
    def _least(self) -> int:
        """First piece of a run that may be stationary: where runs of one start have become independent."""
        return math.ceil(PIECES * self.plan.memory / self.plan.until)

    def _is_reference(self, settings: Settings) -> bool:
        return key_of(self._physics(settings)) == key_of(self.pilot.reference)

    def demand_measurable(self, budgets: Mapping[str, float]) -> None:
        """Refuse measures of which the reference alone shows that no error of them means anything.

        Raises:
            NotMeasurableError: naming the measure, why, and what to ask for.
            CandidateFailed: if a run of the reference did not come to its end.
        """
        if self._asks_for(LONG):
            self._reference_runs(self.replicas, 0)
        for name, budget in budgets.items():
            reason = self._why_not(name) or self._too_rough(name, budget)
            if reason:
                raise NotMeasurableError(f"{name} is not measurable here: {reason}")

    def _too_rough(self, name: str, budget: float) -> str:
        """Why a stepped reference cannot tell an error as small as a budget, or ""."""
        if self.pilot.exact or name not in LONG:
            return ""
        own = self._long_errors(self._coarser_reference, self.replicas, 0, [name])[name]
        if not own.measurable or abs(own.value) - own.noise < budget:
            return ""
        return (
            "the exact solver cannot do this scene, and the finest affordable run "
            f"(dt={self.pilot.reference.dt:.3g}) is itself uncertain by {abs(own.value):.2g}: so much does {name} "
            "change when its step is doubled. Allow a larger error or more time (seconds=...), or ask for another "
            "measure."
        )

    def _why_not(self, name: str) -> str:
        """Why the reference does not measure something, or ""."""
        if name not in LONG:
            return ""
        if name not in RELATIVE:
            return self._why_idle(name)
        reference = np.array([run[name] for run in self._reference_runs(self.replicas, 0)], dtype=float)
        reason = unmeasurable(name, reference)
        if not reason and self.chosen and spans_of(reference, self._least).steady is None:
            reason = (
                f"the scene still changes with time in runs of {self.plan.until:.3g}, and says no duration. Say how "
                "long a run shall be: until=..., or Scene(duration=...)."
            )
        return reason

    def _why_idle(self, name: str) -> str:
        """Why a measure that collisions alone make wrong has no error, as there are none; or ""."""
        runs = self._reference_runs(self.replicas, 0)
        if len(self._scene.capsules) or any(np.any(run["met"]) or np.any(run.get("pressure", 0.0)) for run in runs):
            return ""
        return (
            f"nothing is hit in any of {len(runs)} runs of the reference, to {self.plan.until:.3g}, so that no step is "
            f"too long for {name}. Ask for longer runs (until=...)."
        )

    def _asks_for(self, kind: Sequence[str]) -> bool:
        return any(name in kind for name in self.measures)

    def _starts(self, first: int) -> list[tuple[int, State]]:
        """Numbered starts of short runs: others for each `first`."""
        starts = self.pilot.starts
        if not first:
            return list(enumerate(starts))
        if first not in self._further:
            self._further[first] = self.pilot.further_starts(self._scene, first)
        return list(enumerate(self._further[first], start=first))

    def _physics(self, settings: Settings) -> Settings:
        """The settings under which a candidate's accuracy runs are made."""
        physics = physics_of(settings, self._scene.count)
        return self.pilot.reference if physics.method == self.pilot.reference.method == "event" else physics

    def _run(self, tasks: dict[str, tuple[Any, ...]]) -> None:
        """Run tasks through the executor, and keep each result as it comes."""
        if self._executor is None and self._threads is None:
            # Kernels let go of the GIL, so threads use every core, and no process has to be started.
            self._threads = ThreadPoolExecutor(usable_cores(), "mpsim-accuracy")
        executor = self._executor or self._threads
        assert executor is not None
        ours = () if self._executor else (self._stop,)  # an event cannot travel to another process
        futures: dict[Future[Any], str] = {}
        try:
            with quietly():  # for the threads, whose filters are those of this one
                for key, task in tasks.items():
                    futures[executor.submit(*task, *ours)] = key
                for done, future in enumerate(_finished(futures)):
                    self._kept.put(futures[future], future.result())
                    self._progress(done + 1, len(futures), "accuracy")
        finally:
            for future, key in futures.items():
                if not future.cancel() and key not in self._kept and future.done() and not future.exception():
                    self._kept.put(key, future.result())


LOOK = 0.2
"""Seconds between two looks at signals while runs are made in threads."""


def _finished(futures: Iterable[Future[Any]]) -> Iterator[Future[Any]]:
    """Each future when it is done. Looks up now and then: a signal that another thread gets would not wake a waiter."""
    pending = set(futures)
    while pending:
        done, pending = wait(pending, LOOK, FIRST_COMPLETED)
        yield from done


def _length(first: Pilot, scene: Scene, replicas: int) -> float:
    """Length of a long run that gives PAIRS collisions in all replicas together, and lets them part [time]."""
    crossing = 2 * scene.smallest_radius / first.speed
    if first.collisions == 0:
        return 100 * crossing
    least = max(2 * crossing, PARTINGS * _parted(first)) if first.exact else 2 * crossing
    return float(np.clip(PAIRS / (first.collisions * replicas), min(least, 1e3 * crossing), 1e5 * crossing))


def _parted(first: Pilot) -> float:
    """When replicas have parted [time]."""
    return math.log(1 / VARIATION) / first.growth


def _memory(first: Pilot, until: float) -> float:
    """When runs of one start have parted [time]; 0 where the runs are so short that little would be left."""
    parted = _parted(first)
    return parted if parted < until / 2 else 0.0


def _widened(found: Deviation, own: Deviation) -> Deviation:
    """An error against a stepped reference, which may itself be off by as much as a step twice as long changes it."""
    return dataclasses.replace(found, systematic=abs(own.value)) if own.measurable and found.measurable else found


def _demand_times(scene: Scene) -> None:
    """Refuse emitters that count frames: each dt would be another scene."""
    for index, emitter in enumerate(scene.emitters):
        if emitter.every is not None:
            raise InputError(
                f"a trade needs emitters that count time; emitters[{index}] counts frames (every={emitter.every}), so "
                "that each dt is another scene. Use Emitter(interval=...)."
            )


def _demand_success(found: Sequence[dict[str, Any]], whose: str = "") -> None:
    failures = [each["failure"] for each in found if "failure" in each]
    if failures:
        raise CandidateFailed(whose + failures[0])
