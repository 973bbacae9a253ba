"""Sweeps: a function, or a scene that is run, at every point of a grid of parameters, through any executor."""

from __future__ import annotations

import os
import pickle
import re
import threading
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from typing import Any

from mpsim.core import checks
from mpsim.core.cores import usable_cores
from mpsim.core.deferred_signals import terminated_by_exit
from mpsim.core.progress import Show, checked_progress, shown
from mpsim.errors import InputError, SweepWarning, level_of_caller
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies import sweep_runs
from mpsim.studies.executors import Submissions, checked_executor
from mpsim.studies.sweep_file import SweepFile
from mpsim.studies.sweep_points import Point, points_of
from mpsim.studies.sweep_runs import SceneRun
from mpsim.studies.sweep_table import OWN, Sweep, SweepRow, checked_units
from mpsim.studies.sweep_task import Options, Task, source_of, task_of

_NO_PICKLE = re.compile("pickle|serializ|get attribute", re.IGNORECASE)
"""In texts of errors of executors that could not send something."""


@checks.known_names()
def sweep(
    function: Callable[..., Any] | Scene | str,
    grid: Mapping[str, Iterable[Any]],
    seeds: int | Iterable[int] | None = None,
    executor: Executor | None = None,
    path: str | os.PathLike[str] | None = None,
    *,
    until: float | None = None,
    frames: int | None = None,
    measures: Iterable[str] | None = None,
    settings: Settings | None = None,
    units: Mapping[str, str] | None = None,
    retry_failed: bool = True,
    progress: bool | Callable[[int, int, str], None] | None = None,
) -> Sweep:
    """Run a function, or a scene, at every point of a grid: a table with a row for each run.

    A point is one combination of the grid's values. A function is called with them as its arguments by name, and with
    `seed` if there are seeds, and returns a dictionary of numbers, texts, truth values or None by name; of a
    `measure.Measure` the row holds its value and, under name_error, its error. If the function raises an error, only
    that run fails, and its row says why. If it returns something else before any run has succeeded, the sweep ends.

    A scene is run at every point, with the grid's values of fields of `Settings`, `until` or `frames`. A function may
    also make the scene from the other values; to run what it makes, give at least one of until, frames, measures and
    settings. The row holds the measures, their errors, and the numbers of frames and collisions. Settings without
    `workers` run in one process, since there is one run for each core; the bits are the same.

    Args:
        function: called at each point; or a Scene, or the name or path of one as for `Scene.load`, or a function that
            makes one. For executors of processes it must be in a module that they can import.
        grid: name of a parameter -> its values, at least one, all different. Values are None, truth values, numbers,
            texts, or tuples, lists, dictionaries and dataclasses of these. Equal numbers are one value.
        seeds: number of runs at each point, >= 1, or different numbers >= 0 that name them. The seed of a run, from 0
            to 2^63 - 1, follows from its point and its number alone, so that no other value in the grid changes it: the
            first 63 bits of the BLAKE2b hash of the point as JSON with sorted names, a space, and the number. A Scene
            is drawn again with it (`Scene.redrawn`). None: one run at each point, without a seed, of a Scene as it is.
        executor: any concurrent.futures.Executor: of threads, processes, Dask, mpi4py, loky; None: threads, one for
            each core. It is not shut down.
        path: file to which each run is written as soon as it is done. An interrupted sweep continues from it: runs in
            the file are not repeated, even if the grid now has other values. A file of another function, or
            with other names of parameters or other runs, is refused.
        until: length of a run of a scene [time], >= 0; None: as given by `frames`, the grid, or the scene's duration.
        frames: length in frames instead, >= 0.
        measures: names of what to measure, as for `Simulation.run`; None: pressure, collision_rate, kinetic_energy and
            overlap, if the scene can have them.
        settings: of all runs, where the grid does not vary them; None: those that the scene recommends (also a scene
            that a function makes), or the defaults.
        units: name of a column -> its unit, for the header of the table. Those of a scene's measures are known.
        retry_failed: whether failed runs in the file are run again.
        progress: True: shown on standard error, with rate and time left; or a function, called as progress(done, of,
            what).

    Returns:
        The rows, in the order of the grid, whatever the order in which runs ended.

    Raises:
        InputError: naming the argument and its rule; nothing was run.
        OutputError: if the file cannot be written.
        KeyboardInterrupt: Ctrl-C. Runs that have not started are cancelled; finished ones are in the file.

    Warns:
        SweepWarning: if the executor broke, the last line of the file was cut off, or the function's source has changed
            since the file was begun.

    >>> def distance(speed, time, seed):
    ...     return {"distance": speed * time, "odd": bool(seed % 2)}
    >>> table = sweep(distance, {"speed": [1.0, 2.0], "time": [3.0]}, seeds=2)
    >>> [(row.point["speed"], row.run, row.values["distance"]) for row in table.rows]
    [(1.0, 0, 3.0), (1.0, 1, 3.0), (2.0, 0, 6.0), (2.0, 1, 6.0)]

    >>> scene = Scene.random(count=30, packing=0.2, radius=0.5, seed=1)
    >>> runs = sweep(scene, {"dt": [0.1, 0.02], "method": ["grid"]}, until=5.0, measures=["overlap"])
    >>> [row.values["frames"] for row in runs.rows], runs.units["overlap"]
    ([50, 250], 'length')
    """
    checked_executor(executor)
    points = points_of(grid, seeds)
    task = task_of(function, points, Options(until, frames, measures, settings))
    named = checked_units(units, sweep_runs.UNITS if isinstance(task.call, SceneRun) else {})
    show = checked_progress(progress, "progress(done, of, what)")
    retry_failed = checks.truth("retry_failed", retry_failed)
    task.demand_picklable(executor, points[0])
    with terminated_by_exit(), SweepFile(path, task.title, source_of(function)) as file, shown(show) as say:
        missing = [point for point in points if _is_missing(file.get(point), retry_failed)]
        _Running(task, file, len(points), say).run(missing, executor)
        rows = tuple(_row(point, file.get(point)) for point in points)
    units_here = {*points[0].values, *OWN, *(name for row in rows for name in row.values)}
    known = {name: unit for name, unit in named.items() if name in units_here}
    known |= {"wall_seconds": "s"}
    known |= {f"{name}_error": unit for name, unit in known.items() if f"{name}_error" in units_here}
    return Sweep(task.name, tuple(points[0].values), rows, known)


class _Running:
    """The runs of a sweep that a file lacks; `of` is the number of all."""

    def __init__(self, task: Task, file: SweepFile, of: int, show: Show):
        self._task, self._file, self._of, self._show = task, file, of, show
        self._done = self._failed = 0
        self._good = False
        self._broken: BaseException | None = None
        self._lost = 0

    def run(self, missing: list[Point], executor: Executor | None) -> None:
        """Run them, in threads without an executor."""
        self._done = self._of - len(missing)
        self._good = self._done > 0
        self._show_progress()
        if not missing:
            return
        stop = threading.Event()
        threads, extra = None, ()
        if executor is None:
            executor = threads = ThreadPoolExecutor(usable_cores(), "mpsim-sweep")
            extra = (stop,)  # an event cannot be sent to another process
        tasks = ((point, self._task.submission(point, *extra)) for point in missing)
        submitted = Submissions(executor, tasks)
        try:
            for point, future in submitted.finished():
                self._take(point, self._outcome(future))
        finally:
            stop.set()
            submitted.cancel()
            try:
                if threads is not None:
                    threads.shutdown(cancel_futures=True)
            finally:
                for point, future in submitted.left():
                    self._file.put(point, future.result())
        self._warn_if_broken()

    def _outcome(self, future: Future[Any]) -> dict[str, Any]:
        """What a future holds: the outcome of a run, or why the executor could not bring it back."""
        try:
            error = future.exception()
        except CancelledError as cancelled:
            error = cancelled
        if error is None:
            return future.result()
        if isinstance(error, KeyboardInterrupt):
            raise error
        if isinstance(error, BrokenExecutor):
            self._broken, self._lost = error, self._lost + 1
        elif isinstance(error, pickle.PicklingError) or _NO_PICKLE.search(str(error)):
            raise self._task.unpicklable(error) from error
        return sweep_runs.failed_elsewhere(error)

    def _take(self, point: Point, outcome: dict[str, Any]) -> None:
        if "wrong" in outcome and not self._good:
            raise InputError(outcome["failure"].partition(": ")[2])
        self._good = self._good or "values" in outcome
        self._file.put(point, outcome)
        self._done, self._failed = self._done + 1, self._failed + ("failure" in outcome)
        self._show_progress()

    def _show_progress(self) -> None:
        self._show(self._done, self._of, f"runs, {self._failed} failed" if self._failed else "runs")

    def _warn_if_broken(self) -> None:
        if self._broken is not None:
            warnings.warn(
                f"the executor broke, and {self._lost} runs failed with it: {sweep_runs.described(self._broken):.200} "
                "The other rows are kept. Call again with a new executor and the same path to run these.",
                SweepWarning,
                stacklevel=level_of_caller(),
            )


def _is_missing(outcome: dict[str, Any] | None, retry_failed: bool) -> bool:
    return outcome is None or (retry_failed and "failure" in outcome)


def _row(point: Point, outcome: dict[str, Any] | None) -> SweepRow:
    found = outcome or {}
    return SweepRow(
        point.values,
        point.run,
        point.seed,
        found.get("values", {}),
        found.get("failure"),
        found.get("traceback", ""),
        found["seconds"],
        found["versions"],
    )
