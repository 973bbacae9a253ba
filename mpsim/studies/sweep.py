"""Sweeps: a function, or a scene that is run, at every point of a grid of parameters, through any executor."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import inspect
import os
import pickle
import re
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpsim.core import checks
from mpsim.core.deferred_signals import terminated_by_exit
from mpsim.core.machine import usable_cores
from mpsim.core.progress import Show, checked_progress, shown
from mpsim.engine.report import MOST_FRAMES_OF_A_RUN
from mpsim.errors import InputError, MpsimError, SweepWarning, level_of_caller
from mpsim.measure import registry
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Recommends, Settings, settings_for
from mpsim.studies import sweep_runs
from mpsim.studies.ensemble import Submissions, checked_executor
from mpsim.studies.sweep_runs import (
    OWN,
    RUN_FIELDS,
    RUN_OPTIONS,
    Point,
    SceneRun,
    Sweep,
    SweepFile,
    SweepRow,
    canonical,
    checked_units,
    described,
    failed_elsewhere,
    points_of,
    run_point,
)

# --- The task of a sweep: a function or a scene, checked before anything runs


@dataclass(frozen=True)
class Options:
    """How scenes are run, as given by the caller of `sweep`.

    Attributes:
        until, frames, measures, settings: its arguments.
    """

    until: float | None
    frames: int | None
    measures: Iterable[str] | None
    settings: Settings | None

    @property
    def given(self) -> bool:
        """Whether any of them is."""
        return any(each is not None for each in (self.until, self.frames, self.measures, self.settings))


@dataclass(frozen=True)
class Task:
    """What is done at each point.

    Attributes:
        name: of the function or scene.
        call: the function, or how scenes are run.
        scene: that is run; None: `call` makes one, or needs none.
        title: plain values that identify the sweep in its file.
        taken: names that results must not have.
    """

    name: str
    call: Callable[..., Any]
    scene: Scene | None
    title: dict[str, Any]
    taken: frozenset[str]

    def submission(self, point: Point, *stop: threading.Event) -> tuple[Any, ...]:
        """What an executor is given for a point. A scene is redrawn here, because a scene that was sent cannot be."""
        arguments = dict(point.values)
        if self.scene is not None:
            try:
                arguments["scene"] = self.scene if point.seed is None else self.scene.redrawn(point.seed)
            except MpsimError as error:  # there was no room for its discs
                return failed_elsewhere, error
        elif point.seed is not None:
            arguments["seed"] = point.seed
        return run_point, self.call, arguments, self.taken, *stop

    def demand_picklable(self, executor: Executor | None, point: Point) -> None:
        """Refuse what pickle cannot send, if the executor is one of Python's that use pickle.

        Raises:
            InputError: naming the function.
        """
        if isinstance(executor, ProcessPoolExecutor):
            try:
                pickle.dumps((self.call, point.values))
            except (pickle.PicklingError, AttributeError, TypeError, RecursionError) as error:
                raise self.unpicklable(error) from error

    def unpicklable(self, error: BaseException) -> InputError:
        """The error for a function, or values, that cannot be sent to another process."""
        return InputError(
            "function and the values of the grid must be what pickle can send to other processes; got "
            f"{self.name} ({described(error):.200}). Define the function at the top of a module, or sweep in threads."
        )


def task_of(function: Any, points: list[Point], options: Options) -> Task:
    """What is done at each of the points.

    Raises:
        InputError: if the function, its arguments, or the options break a rule.
    """
    names, seeded = tuple(points[0].values), points[0].seed is not None
    for name in names:
        if name in OWN and (name != "seed" or seeded):
            raise InputError(
                f"grid must not have the names {', '.join(OWN)}, which are columns of each sweep ('seed' only without "
                f"seeds); got {name!r}. Choose another name, or leave out seeds."
            )
    title: dict[str, Any] = {"parameters": sorted(names), "seeded": seeded}
    if isinstance(function, Scene | str | os.PathLike):
        return _scene_task(function, names, points, options, title)
    if not callable(function):
        raise InputError(
            "function must be a function, an mpsim.Scene, or the name or path of one; got "
            f"{checks.brief(function)}. Give a function that returns a dictionary."
        )
    return _function_task(function, names, points, options, title)


def _scene_task(function: Any, names: tuple[str, ...], points: list[Point], options: Options, title: Any) -> Task:
    if isinstance(function, Scene):
        scene, name = function, repr(function)[1:-1]
    else:
        from mpsim.scene import scenefile  # noqa: PLC0415 - its validator takes a moment to load

        found = scenefile.load(function)
        scene, name = found.scene, found.name
    for each in names:
        if each not in RUN_FIELDS:
            raise InputError(
                f"grid[{each!r}] must be one of {', '.join(RUN_FIELDS)}, where a scene is given."
                f"{_meant(each, RUN_FIELDS)} To vary the scene, give a function that makes it."
            )
    if points[0].seed is not None and not scene.can_redraw:
        scene.redrawn(points[0].seed)  # which raises
    run = _scene_run(None, names, points, options, scene)
    title = {"function": f"scene {scene.digest()}", **title, "runs": _facts(run, scene)}
    return Task(name, run, scene, title, frozenset(names))


def _function_task(function: Any, names: tuple[str, ...], points: list[Point], options: Options, title: Any) -> Task:
    parameters = _parameters(function)
    own: tuple[str, ...] = ()
    if options.given or any(name in RUN_OPTIONS and name not in parameters for name in names):
        own = tuple(name for name in names if name in RUN_FIELDS and name not in parameters)
    makes_scenes = options.given or bool(own)
    name = getattr(_inner(function), "__qualname__", type(function).__qualname__)
    _demand_arguments(name, parameters, [each for each in names if each not in own], points[0].seed is not None)
    call = _scene_run(function, own, points, options, None) if makes_scenes else function
    title = {"function": _identity(function), **title}
    title["runs"] = _facts(call, None) if isinstance(call, SceneRun) else None
    return Task(name, call, None, title, frozenset(names))


def _scene_run(
    make: Callable[..., Any] | None, own: tuple[str, ...], points: list[Point], options: Options, scene: Scene | None
) -> SceneRun:
    settings = settings_for(scene or Recommends(), options.settings)  # checked, also where scenes are made later
    if scene is None and options.settings is None:
        settings = None
    until = None if options.until is None else checks.non_negative("until", options.until, "[time]")
    frames = None if options.frames is None else _frames(options.frames)
    measures = None if options.measures is None else registry.checked(options.measures, scene)
    run = SceneRun(make, settings, until, frames, measures, frozenset(own))
    run.settings_of({})
    for name in own:
        for value in {repr(point.plain[name]): point.values[name] for point in points}.values():
            if name == "until":
                checks.non_negative("until", value, "[time]")
            elif name == "frames":
                _frames(value)
            else:
                run.settings_of({name: value})
    run.length({name: points[0].values[name] for name in own}, scene)
    return run


def _frames(value: Any) -> int:
    return checks.whole("frames", value, 0, MOST_FRAMES_OF_A_RUN, "Ask for 0 or more frames.")


def _facts(run: SceneRun, scene: Scene | None) -> dict[str, Any]:
    """How scenes are run, as plain values: all that changes a result and is no parameter."""
    varied = {name: getattr(Settings(), name) for name in run.own if name not in RUN_OPTIONS}
    no_result: dict[str, Any] = {**varied, "workers": None}
    settings = None if run.settings is None else dataclasses.replace(run.settings, **no_result)
    duration = scene.duration if scene is not None and (run.until, run.frames) == (None, None) else None
    facts = {"settings": settings, "until": run.until, "frames": run.frames, "duration": duration}
    return {name: canonical(name, value) for name, value in {**facts, "measures": run.measures}.items()}


def _parameters(function: Any) -> Mapping[str, inspect.Parameter]:
    """Parameters of a function by name; where they cannot be known, one that takes any."""
    try:
        found = inspect.signature(function).parameters
    except (TypeError, ValueError):  # a function of C
        return {"**": inspect.Parameter("others", inspect.Parameter.VAR_KEYWORD)}
    return found


def _demand_arguments(function: str, parameters: Mapping[str, Any], names: list[str], seeded: bool) -> None:
    """Refuse arguments that a function does not take, and required ones that it would not get."""
    kinds = inspect.Parameter
    takes_any = any(each.kind is kinds.VAR_KEYWORD for each in parameters.values())
    nameable = (kinds.POSITIONAL_OR_KEYWORD, kinds.KEYWORD_ONLY)
    by_name = {name: each for name, each in parameters.items() if each.kind in nameable}
    for name in names:
        if name not in by_name and not takes_any:
            hint = " To run the scene that it makes with it, say how long: until=..." if name in RUN_FIELDS else ""
            raise InputError(
                f"grid[{name!r}] must be an argument of {function}, which takes {', '.join(by_name) or 'none'}; got "
                f"{name!r}.{_meant(name, by_name)}{hint}"
            )
    if seeded and "seed" not in by_name and not takes_any:
        raise InputError(
            f"function must take an argument 'seed' where seeds are asked for; {function} takes "
            f"{', '.join(by_name) or 'none'}. Add it, or leave out seeds."
        )
    given = {*names, *(["seed"] if seeded else [])}
    empty, several = kinds.empty, (kinds.VAR_KEYWORD, kinds.VAR_POSITIONAL)
    lacking = [n for n, p in parameters.items() if p.default is empty and p.kind not in several and n not in given]
    if lacking:
        raise InputError(
            f"grid must hold every argument that {function} needs, by name; it lacks {', '.join(lacking)}. Add it, "
            "give it a value by functools.partial, or, for 'seed', ask for seeds."
        )


def _meant(name: str, words: Iterable[str]) -> str:
    near = checks.near(name, words)
    return f" Did you mean {near!r}?" if near else ""


def _inner(function: Any) -> Any:
    """The function inside of partial ones."""
    while isinstance(function, functools.partial):
        function = function.func
    return function


def _identity(function: Any) -> str:
    """Module and name of a function, with the values that a partial one has."""
    inner = _inner(function)
    named: Any = inner if hasattr(inner, "__qualname__") else inner.__class__
    module = getattr(named, "__module__", "")
    if module == "__main__":
        module = _name_of_main()
    text = f"{module}.{named.__qualname__}"
    while isinstance(function, functools.partial):
        text += f" {[*map(_brief, function.args)]} { {name: _brief(each) for name, each in function.keywords.items()} }"
        function = function.func
    return text


def _brief(value: Any) -> Any:
    """A value of a partial function as it is identified: those that a grid could not hold by their kind alone."""
    try:
        return canonical("function", value)
    except InputError:
        return type(value).__qualname__


def _name_of_main() -> str:
    """The program, by the name by which another one would import it."""
    main = sys.modules["__main__"]
    spec, file = getattr(main, "__spec__", None), getattr(main, "__file__", None)
    return spec.name if spec is not None else Path(file).stem if file else "__main__"


def source_of(function: Any) -> str | None:
    """Digest of the source of a function; None if it has none."""
    inner = _inner(function)
    defined: Any = inner if hasattr(inner, "__qualname__") else inner.__class__
    try:
        text = inspect.getsource(defined)
    except (OSError, TypeError):
        return None
    return hashlib.blake2b(text.encode("utf-8", "replace"), digest_size=8).hexdigest()


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
