"""Runs of many candidates on one scene: accuracy runs through an executor, timings alone, all kept in a file."""

import json
import os
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from mpsim import checks
from mpsim.engine.cores import usable_cores
from mpsim.errors import InputError
from mpsim.measure import cost
from mpsim.measure.cost import Cost
from mpsim.measure.deviations import ABSOLUTE, Deviation, deviations, short_deviations
from mpsim.measure.pilot import Pilot, pilot
from mpsim.measure.replicas import LONG, SHORT, VARIATION, Plan, key_of, long_run, physics_of, quietly, short_runs
from mpsim.scene import Scene
from mpsim.settings import Settings
from mpsim.state import State

PAIRS = 300_000
"""Collisions in all replicas of a candidate together, where nobody says how long to run: they fix the pressure of a gas
to about 0.1 % (relative error of Z - 1: 1.1 / sqrt(collisions))."""

PARTINGS = 10
"""... but the replicas should live this many times as long as they need to part: the structure of a dense gas changes
slowly, and runs that are shorter have it in common."""

REFERENCE = 2
"""The reference has so many times the replicas of a candidate, so that its noise adds little."""

FORMAT = 2
"""Of the file that keeps what is finished: runs that are cut or counted in another way are not to be mixed."""

SAVE_EVERY = 1.0
"""Seconds between two writes of the file that keeps what is finished."""


class CandidateFailed(Exception):  # noqa: N818 - an outcome, not an error
    """A candidate could not be run to the end; the text says why."""


class Campaign:
    """All runs on one scene. Use it in a `with` block: leaving it ends its threads and writes its file.

    Args:
        scene: what is run.
        until: length of a long run [time]; None: see PAIRS.
        measures: names of errors that are wanted.
        replicas: long runs per candidate.
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
        self._kept = Kept(path, scene.digest())
        self.pilot: Pilot = pilot(scene, self._kept.reference)
        until = _length(self.pilot, scene, replicas) if until is None else until
        speed, memory = self.pilot.speed * np.sqrt(2), _memory(self.pilot, scene, until)
        self.plan: Plan = Plan(until, speed, self.pilot.short, self.pilot.growth, memory)
        self.measures: tuple[str, ...] = tuple(measures)
        self.replicas = replicas
        self._scene = scene
        self._executor = executor
        self._threads: ThreadPoolExecutor | None = None
        self._progress = progress or (lambda done, of, what: None)
        self._stop = threading.Event()
        self._further: tuple[State, ...] | None = None
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

    def assess(self, candidates: Iterable[Settings], replicas: int | None = None, first: int = 0) -> None:
        """Do the accuracy runs of candidates, and of the reference, that are not there yet.

        Args:
            candidates: settings; those that differ in speed alone share their runs.
            replicas: how many runs of each, `first` being the number of the first one.
            first: above 0 the runs are independent of those below.
        """
        replicas = replicas or self.replicas
        numbers = range(first, first + replicas)
        wanted = [(self.pilot.reference, k) for k in range(REFERENCE * first, REFERENCE * (first + replicas))]
        unique = {key_of(each): each for each in map(self._physics, candidates)}
        wanted += [(each, number) for each in unique.values() for number in numbers]
        tasks: dict[str, tuple[Any, ...]] = {}
        for settings, number in wanted if self._asks_for(LONG) else ():
            tasks[f"long {key_of(settings)} {number}"] = (long_run, self._scene, settings, self.plan, number)
        for key, settings in unique.items() if self._asks_for(SHORT) else ():
            for number, start in self._starts(first):
                arguments = short_runs, self._scene, settings, self.plan, start, self.pilot.reference
                tasks[f"short {key} {number}"] = arguments
        self._run({key: task for key, task in tasks.items() if key not in self._kept})

    def time(self, candidates: Sequence[Settings]) -> None:
        """Measure the cost of candidates, one after the other, with nothing else running."""
        for done, settings in enumerate(candidates):
            self._progress(done, len(candidates), "timing")
            key = f"cost {key_of(settings)}"
            if key not in self._kept:
                self._kept.put(key, cost.measure(self._scene, settings, self.plan.until))
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
        key = key_of(self._physics(settings))
        errors: dict[str, Deviation] = {}
        if self._asks_for(LONG):
            found = [self._kept[f"long {key} {number}"] for number in range(first, first + replicas)]
            _demand_success(found)
            reference = key_of(self.pilot.reference)
            numbers = range(REFERENCE * first, REFERENCE * (first + replicas))
            theirs = [self._kept[f"long {reference} {number}"] for number in numbers]
            _demand_success(theirs, "the reference failed, ")
            errors = deviations(found, theirs, [name for name in self.measures if name in LONG])
            if key == reference:  # its difference from itself is nothing, not noise
                errors |= {name: Deviation(0.0, 0.0) for name in errors if name not in ABSOLUTE}
        if self._asks_for(SHORT):
            short = [self._kept[f"short {key} {number}"] for number, _ in self._starts(first)]
            _demand_success(short)
            errors |= short_deviations(short, self.measures)
        return {name: errors[name] for name in self.measures}

    def _asks_for(self, kind: Sequence[str]) -> bool:
        return any(name in kind for name in self.measures)

    def _starts(self, first: int) -> list[tuple[int, State]]:
        """Numbered starts of short runs: where `first` is above 0, others than those of the first look."""
        starts = self.pilot.starts
        if not first:
            return list(enumerate(starts))
        if self._further is None:
            self._further = self.pilot.further_starts(self._scene)
        return list(enumerate(self._further, start=len(starts)))

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
                for done, future in enumerate(as_completed(futures)):
                    self._kept.put(futures[future], future.result())
                    self._progress(done + 1, len(futures), "accuracy")
        finally:
            for future, key in futures.items():
                if not future.cancel() and key not in self._kept and future.done() and not future.exception():
                    self._kept.put(key, future.result())


class Kept:
    """Results by key, in memory and, if there is a path, in a JSON file that is never half written."""

    def __init__(self, path: str | Path | None, scene: str):
        self._path = None if path is None else _checked(path)
        self._results: dict[str, Any] = {}
        self._title = {"format": FORMAT, "scene": scene}
        self._plan: str | None = None
        self.reference: str | None = None
        self._open = False
        self._saved = time.monotonic()
        if self._path is not None and self._path.exists():
            self._plan, self.reference, self._results = _loaded(self._path, self._title)

    def open(self, plan: str, reference: str) -> None:
        """Begin to keep results of a plan and a reference, which must be those of the file, if there is one."""
        if self._plan not in (None, plan):
            raise _other(self._path)
        self._plan, self.reference, self._open = plan, reference, True

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Any:
        return self._results[key]

    def put(self, key: str, value: Any) -> None:
        """Keep a result; the file follows within SAVE_EVERY seconds, or at the end."""
        self._results[key] = value
        if time.monotonic() - self._saved > SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Write the file, beside it first, so that a kill leaves the old one or the new one."""
        self._saved = time.monotonic()
        if self._path is not None and self._open:
            beside = self._path.with_name(f"{self._path.name}.{os.getpid()}.tmp")
            results = {key: value for key, value in self._results.items() if "machine" not in value}
            kept = {"title": self._title, "plan": self._plan, "reference": self.reference, "results": results}
            try:
                beside.write_text(json.dumps(kept))
                beside.replace(self._path)
            finally:
                beside.unlink(missing_ok=True)


def _length(first: Pilot, scene: Scene, replicas: int) -> float:
    """Length of a long run that gives PAIRS collisions in all replicas together, and lets them part [time]."""
    crossing = 2 * scene.smallest_radius / first.speed
    if first.collisions == 0:
        return 100 * crossing
    least = max(2 * crossing, PARTINGS * _parted(first)) if first.reference.method == "event" else 2 * crossing
    return float(np.clip(PAIRS / (first.collisions * replicas), min(least, 1e3 * crossing), 1e5 * crossing))


def _parted(first: Pilot) -> float:
    """When replicas have parted [time]."""
    return float(np.log(1 / VARIATION)) / first.growth


def _memory(first: Pilot, scene: Scene, until: float) -> float:
    """When replicas of a gas have parted [time]; 0 where what happens before is what a run is about.

    That is where energy is lost, where the run is so short that little would be left, and where nobody knows.
    """
    lossless = scene.restitution == scene.wall_restitution == 1
    parted = _parted(first)
    return parted if lossless and first.reference.method == "event" and parted < until / 2 else 0.0


def _demand_success(found: Sequence[dict[str, Any]], whose: str = "") -> None:
    failures = [each["failure"] for each in found if "failure" in each]
    if failures:
        raise CandidateFailed(whose + failures[0])


def _checked(path: str | Path) -> Path:
    """A path that can be written, as is seen before hours are spent, not after."""
    folder = Path(path).absolute().parent
    if not folder.is_dir() or not os.access(folder, os.W_OK) or Path(path).is_dir():
        raise InputError(f"path must be a file in a folder that can be written to; got {str(path)!r}. Make the folder.")
    return Path(path)


def _loaded(path: Path, title: dict[str, Any]) -> tuple[str, str, dict[str, Any]]:
    try:
        kept = json.loads(path.read_text())
        found, plan, reference, results = kept["title"], kept["plan"], kept["reference"], dict(kept["results"])
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"path must be a file of an earlier trade, or none yet; {path} cannot be read as one ({error}). "
            "Remove it, or give another path."
        ) from None
    if found != title:
        raise _other(path)
    return plan, reference, results


def _other(path: Path | None) -> InputError:
    return InputError(
        f"path must be a file of the same scene and the same lengths of runs; {path} is of others. "
        "Remove it, or give another path."
    )
