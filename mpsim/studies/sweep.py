"""Sweeps: a function, or a scene that is run, at every point of a grid of parameters, through any executor."""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

# Values of grids and results are of any type, and are checked as the program runs.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnnecessaryIsInstance=false
# pyright: reportUnnecessaryComparison=false

from __future__ import annotations

import dataclasses
import functools
import hashlib
import inspect
import itertools
import json
import math
import numbers
import os
import pickle
import re
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from platform import python_version
from typing import Any, ClassVar, cast

import numba
import numpy as np

from mpsim.core import checks
from mpsim.core.deferred_signals import terminated_by_exit
from mpsim.core.progress import checked_progress, shown
from mpsim.core.state import State
from mpsim.core.version import __version__
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import MOST_FRAMES_OF_A_RUN
from mpsim.engine.solvers.methods import in_one_process
from mpsim.errors import InputError, MpsimError, SweepWarning, level_of_caller
from mpsim.measure import registry
from mpsim.measure.statistics import Measure
from mpsim.scene import scenefile
from mpsim.scene.scene import Scene, settings_for
from mpsim.scene.settings import Settings, check_settings
from mpsim.studies.runner import RunFile, Runner, Stopped
from mpsim.studies.table import Table

# --- The points of a sweep: combinations of the values of a grid, and the seed of each
#
# The text of a point is JSON of its values, sorted by name, and contains nothing else. So neither the order of names
# and values nor other values of the grid change the seed of a point, or its row in a file.

MOST_RUNS = 1_000_000
"""More runs than this are taken for a mistake: their rows would not fit into memory."""

Scalar = bool | int | float | str | None

Key = tuple[str, int]
"""What distinguishes a run from all others: the text of its point, and its number there; 0 without seeds."""

Outcome = dict[str, Any]
"""The last fields of a SweepRow, plain values."""


def text_of(point: Mapping[str, Any]) -> str:
    """Values by name as a text, the same for every order of the names.

    >>> text_of({"packing": 0.1, "count": 2.0})
    '{"count":2,"packing":0.1}'
    """
    plain = {name: canonical(f"grid[{name!r}]", value) for name, value in point.items()}
    return json.dumps(plain, sort_keys=True, separators=(",", ":"))


def seed_of(text: str, run: int) -> int:
    """The seed of a run: the first 63 bits of BLAKE2b of the point's text, a space, and the number of the run.

    >>> seed_of('{"packing":0.1}', 0), seed_of('{"packing":0.1}', 1)
    (1570410355820327519, 8174789766741869874)
    """
    return int.from_bytes(hashlib.blake2b(f"{text} {run}".encode(), digest_size=8).digest(), "big") >> 1


def checked_grid(grid: Any) -> dict[str, list[Any]]:
    """The values of a grid."""
    if not isinstance(grid, Mapping) or not grid:
        raise InputError(
            "grid must be a dictionary of lists, by the name of at least one parameter; got "
            f"{checks.brief(grid)}. Write {{'packing': [0.1, 0.3]}}."
        )
    found: dict[str, list[Any]] = {}
    for name, values in grid.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise InputError(f"grid must have names of parameters as its keys; got {checks.brief(name)}.")
        if isinstance(values, str | bytes | Mapping) or not isinstance(values, Iterable):
            raise InputError(
                f"grid[{name!r}] must be a list of values; got {checks.brief(values)}. Write [value] for a single one."
            )
        found[name] = list(itertools.islice(values, MOST_RUNS + 1))
        if not 0 < len(found[name]) <= MOST_RUNS:
            number = "more" if found[name] else "none"
            raise InputError(f"grid[{name!r}] must hold 1 to {MOST_RUNS:,} values; got {number}.")
        different: set[str] = set()
        for value in found[name]:
            if (text := text_of({name: value})) in different:
                raise InputError(
                    f"grid[{name!r}] must hold different values; got {checks.brief(value)} more than once (numbers "
                    "that are equal count as one, as do lists and tuples). Leave one out, or ask for more seeds."
                )
            different.add(text)
    return found


def checked_seeds(seeds: Any) -> list[int] | None:
    """Numbers of the runs at each point; None without seeds."""
    if seeds is None:
        return None
    remedy = "4 makes four runs at each point, 0 to 3."
    if isinstance(seeds, str | bytes | Mapping) or not isinstance(seeds, Iterable):
        return list(range(checks.whole("seeds", seeds, 1, MOST_RUNS, remedy)))
    found = [checks.whole("a number in seeds", each, 0, 2**63 - 1, remedy) for each in seeds]
    if not found or len(set(found)) < len(found):
        raise InputError(
            f"seeds must be a number of runs, or different numbers of them; got {checks.brief(found)}. {remedy}"
        )
    return found


def rows_of(grid: dict[str, list[Any]], runs: list[int] | None) -> dict[Key, SweepRow]:
    """Rows without outcome: each combination of the values of a grid, the last name changing fastest, and its runs."""
    number = math.prod(map(len, grid.values())) * len(runs or (0,))
    if number > MOST_RUNS:
        raise InputError(
            f"grid must have at most {MOST_RUNS:,} runs, those of all seeds together; got {number:,}. "
            "Sweep over fewer values, or over some of the parameters at a time."
        )
    rows: dict[Key, SweepRow] = {}
    for values in itertools.product(*grid.values()):
        point = dict(zip(grid, values, strict=True))
        text = text_of(point)
        for run in runs or (0,):
            rows[text, run] = SweepRow(point, run, None if runs is None else seed_of(text, run))
    return rows


def canonical(name: str, value: Any) -> Any:
    """A value as JSON can hold it, the same for numbers that are equal, and for a list and a tuple.

    name: of the value. Scenes and states are known by their digest, other objects by their repr, if that is the same in
    each process.

    >>> canonical("x", (1.0, np.float32(0.5), True, None, float("inf")))
    [1, 0.5, True, None, {'float': 'inf'}]
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [canonical(name, each) for each in value]
    if isinstance(value, float) and math.isfinite(value):
        return int(value) if value == int(value) else float(value)
    if value is None or type(value) in (bool, int, str):
        return value
    if isinstance(value, Mapping):
        return {str(each): canonical(name, part) for each, part in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type | Scene | State):  # whose repr may round numbers
        fields = [each.name for each in dataclasses.fields(value) if each.compare]
        return {type(value).__name__: {each: canonical(name, getattr(value, each)) for each in fields}}
    text = value.digest() if isinstance(value, Scene | State) else repr(value)
    if " at 0x" in text:
        raise InputError(
            f"{name} must hold None, True or False, numbers, texts, or lists, dictionaries and dataclasses of these; "
            f"got {checks.brief(value)}, a {type(value).__name__}. Sweep over its name or number, and make the object "
            "in the function."
        )
    return {type(value).__name__: text}


# --- One run of a sweep, wherever the executor runs it
#
# Whatever goes wrong in a run becomes part of its outcome: fields of a SweepRow, plain values that can always be sent
# back. So a failed run does not end the others.

MEASURES = ("pressure", "collision_rate", "kinetic_energy", "overlap")
"""What a run measures if nothing is asked for, as far as its scene can have it."""

LENGTHS: dict[str, Callable[[Any], float]] = {
    "until": lambda value: checks.non_negative("until", value, "[time]"),
    "frames": lambda value: checks.whole("frames", value, 0, MOST_FRAMES_OF_A_RUN, "Ask for 0 or more frames."),
}
"""Arguments that give the length of a run, and what checks them."""

RUN_FIELDS: tuple[str, ...] = (*(field.name for field in dataclasses.fields(Settings)), *LENGTHS)
"""Names of a grid that vary how a scene is run."""

VERSIONS: dict[str, str] = {
    "mpsim": __version__,
    "numpy": np.__version__,
    "numba": numba.__version__,
    "python": python_version(),
}
"""Versions, in this process, of everything that may change a result."""

OWN: tuple[str, ...] = ("run", "seed", "wall_seconds", "failure", *(f"{name}_version" for name in VERSIONS))
"""Columns that every sweep has, besides those of the grid and of the results."""

LONGEST_FAILURE, LONGEST_TRACEBACK = 1000, 4000
"""Characters that are kept of an error in words, its beginning, and of a traceback, its end."""

_COLUMNS_BY_UNIT = {
    "time": "dt until",
    "mass/time^2": "pressure pressure_virial pressure_xx pressure_yy pressure_xy",
    "1/time": "collision_rate contact_rate energy_drift momentum_drift",
    "length": "overlap largest_overlap",
    "mass length^2/time^2": "kinetic_energy temperature",
    "1": "speed_kurtosis frames collisions",
}
UNITS = {name: unit for unit, names in _COLUMNS_BY_UNIT.items() for name in names.split()}
"""Units of what a run of a scene takes and gives, in those of the scene."""


class WrongResult(InputError):  # noqa: N818 - said of what a function returned
    """A function returned what cannot be a row of a table."""


@dataclass(frozen=True)
class SceneRun:
    """How each point of a sweep becomes a run of a scene.

    Attributes:
        make: gives the scene of a point; None where the argument `scene` is one.
        settings: of the runs, where the grid does not vary them; None: those that the scene of a point recommends.
        length: until [time] or frames, where the grid does not vary it; empty: the scene's duration.
        measures: names; None: MEASURES, as far as the scene can have them.
        own: names of the grid that vary settings and length.
    """

    make: Callable[..., Any] | None
    settings: Settings | None
    length: dict[str, Any]
    measures: tuple[str, ...] | None
    own: tuple[str, ...]

    def __call__(self, stop: threading.Event | None = None, **arguments: Any) -> dict[str, Any]:
        """Measures of the run, and how many frames and collisions it had."""
        varied = {name: arguments.pop(name) for name in self.own}
        scene = arguments["scene"] if self.make is None else self.make(**arguments)
        if not isinstance(scene, Scene):
            raise WrongResult(
                f"a function whose scenes are to be run must return an mpsim.Scene; got {type(scene).__name__}. "
                "Return one, or leave out until, frames, measures and settings."
            )
        possible = (name for name in MEASURES if registry.refusal(name, scene) is None)
        names = tuple(possible) if self.measures is None else self.measures

        def stop_if_asked(done: int, of: int) -> None:
            if stop is not None and stop.is_set():
                raise Stopped

        with Simulation(scene, self.settings_of(varied, scene)) as sim:
            report = sim.run(**self.length_of(varied, scene), measures=names, progress=stop_if_asked)
        found = {name: report.measures[name] for name in names}
        found |= {"frames": report.frames, "collisions": int(report.collisions)}
        return {name: value for name, value in found.items() if name not in varied}

    def settings_of(self, varied: Mapping[str, Any], scene: Scene | None) -> Settings:
        """The settings of a point, of one process unless they ask for more: the bits are the same.

        scene: of the point; None: it is not made yet.
        """
        usual = check_settings(self.settings or Settings()) if scene is None else settings_for(scene, self.settings)
        changes = {name: value for name, value in varied.items() if name not in LENGTHS}
        settings = in_one_process(dataclasses.replace(usual, **changes), "each run of a sweep")
        return settings if settings.workers else dataclasses.replace(settings, workers=1)

    def length_of(self, varied: Mapping[str, Any], scene: Scene | None) -> dict[str, Any]:
        """The length of a run, as an argument of `Simulation.run`; empty if it is that of a scene not made yet."""
        length = self.length | {name: value for name, value in varied.items() if name in LENGTHS}
        if not length and (scene is None or scene.duration is not None):
            return {} if scene is None else {"until": scene.duration}
        if len(length) != 1:
            raise InputError(
                "a sweep of runs must have their length, as one of until and frames; got "
                f"{' and '.join(length) or 'neither'}, and a scene without duration. Say until=... [time], or let the "
                "grid vary it."
            )
        return length

    def facts(self, scene: Scene | None) -> dict[str, Any]:
        """How scenes are run: all that changes a result and is no parameter."""
        no_result = {name: getattr(Settings(), name) for name in ("workers", *self.own) if name not in LENGTHS}
        settings = None if self.settings is None else dataclasses.replace(self.settings, **no_result)
        duration = scene.duration if scene is not None and not self.length else None
        facts = {"settings": settings, "length": self.length, "duration": duration, "measures": self.measures}
        return {name: canonical(name, value) for name, value in facts.items()}


def run_point(
    function: Callable[..., Any], arguments: dict[str, Any], taken: frozenset[str], stop: threading.Event | None = None
) -> Outcome:
    """The outcome of one run.

    Args:
        function: that gives the results of a point by name.
        arguments: its arguments by name.
        taken: names that results must not have.
        stop: ends a SceneRun early, by the exception Stopped.

    Raises:
        WrongResult: if what the function returned cannot be a row.
    """
    started = time.perf_counter()
    values: dict[str, Scalar] = {}
    failure, text = None, ""
    try:
        call = functools.partial(function, stop=stop) if isinstance(function, SceneRun) else function
        values = scalars(call(**arguments), taken)
    except (Stopped, WrongResult):
        raise
    except (Exception, SystemExit) as error:
        failure = described(error)
        text = "".join(traceback.format_exception(error))[-LONGEST_TRACEBACK:]
    return _outcome(values, failure, text, time.perf_counter() - started)


def failed_elsewhere(error: BaseException, stop: threading.Event | None = None) -> Outcome:
    """The outcome of a run that has no result, and no traceback of its own."""
    return _outcome({}, described(error))


def _outcome(values: dict[str, Scalar], failure: str | None, text: str = "", seconds: float = math.nan) -> Any:
    """Fields of a SweepRow."""
    found = {"values": values, "failure": failure, "traceback": text, "wall_seconds": seconds}
    return {**found, "versions": VERSIONS}


def described(error: BaseException) -> str:
    """An error in words: its class, and the beginning of its text if it has one.

    >>> described(ValueError("too small")), described(KeyError())
    ('ValueError: too small', 'KeyError')
    """
    try:
        text = str(error)
    except Exception:
        text = "its text cannot be had"
    text = text if len(text) <= LONGEST_FAILURE else f"{text[:LONGEST_FAILURE]} ... ({len(text):,} characters)"
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def scalars(result: Any, taken: frozenset[str]) -> dict[str, Scalar]:
    """What a function returned, as plain values by name. A Measure becomes its value, and its error beside it.

    >>> scalars({"pressure": Measure(2.5, 0.5, 20), "count": np.int32(7)}, frozenset())
    {'pressure': 2.5, 'pressure_error': 0.5, 'count': 7}
    """
    if not isinstance(result, Mapping):
        scene = " To run scenes, say how long: until=... or frames=..." if isinstance(result, Scene) else ""
        raise WrongResult(
            "the result of the function must be a dictionary of numbers, texts or truth values by name; got "
            f"{checks.brief(result)}, a {type(result).__name__}. Return {{'name': value}}.{scene}"
        )
    found: dict[Any, Scalar] = {}
    for name, value in result.items():
        if isinstance(value, Measure):
            found |= {name: float(value.value), f"{name}_error": float(value.error)}
        else:
            found[name] = _scalar(name, value)
    for name in found:
        if not isinstance(name, str) or not name or name in taken or name in OWN:
            raise WrongResult(
                f"the names of results must be texts, and not those of parameters or of {', '.join(OWN)}; got "
                f"{checks.brief(name)}. Choose another name."
            )
    return found


def _scalar(name: Any, value: Any) -> Scalar:
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, numbers.Real):
        return int(value) if isinstance(value, numbers.Integral) else float(value)
    raise WrongResult(
        f"the result {name!r} must be a number, a text, True, False or None; got {checks.brief(value)}, a "
        f"{type(value).__name__}. Return one name for each number, or keep arrays in a file of your own."
    )


# --- The file of a sweep: one line for each finished run

VERSION = 1
"""Of its lines."""


def _finished(file: RunFile, task: Task) -> dict[Key, Outcome]:
    """The outcomes in a file of this task; if it has another source of the function, a warning is raised."""
    outcomes: dict[Key, Outcome] = {}

    def take(row: dict[str, Any]) -> None:
        point = json.dumps(dict(row["point"]), sort_keys=True, separators=(",", ":"))
        outcomes[point, int(row["run"])] = {
            "values": dict(row["values"]),
            "failure": None if row["failure"] is None else str(row["failure"]),
            "traceback": str(row["traceback"]),
            "wall_seconds": float(row["wall_seconds"]),
            "versions": dict(row["versions"]),
        }

    file.begin(task.title, take, source=task.source)
    if outcomes and task.source is not None and file.head.get("source") not in (None, task.source):
        file.warn(
            f"the source of {task.title['function']} has changed since {{path}} was begun: its rows come from the "
            "earlier version. Remove the file, or give another path, to run them again."
        )
    return outcomes


# --- The result of a sweep: a table with one row for each run


@dataclass(frozen=True)
class SweepRow:
    """One run of a sweep.

    Attributes:
        point: values of the parameters, as the grid gave them.
        run: number of the run at this point, from 0 on.
        seed: that the run was given; None without seeds.
        values: its results by name; empty if it failed.
        failure: why it failed, as "ValueError: ..."; None if it did not.
        traceback: the last lines of the traceback of a failure; "" without any.
        wall_seconds: time that it took [s]; NaN if that is unknown.
        versions: of mpsim, numpy, numba and python, where it ran.
    """

    point: dict[str, Any]
    run: int
    seed: int | None
    values: dict[str, Scalar] = field(default_factory=dict[str, Scalar])
    failure: str | None = None
    traceback: str = ""
    wall_seconds: float = math.nan
    versions: dict[str, str] = field(default_factory=dict[str, str])

    def record(self) -> dict[str, Scalar]:
        """The row as plain values by column name; what is not a number, text or truth value is given as its repr."""
        found: dict[str, Scalar] = {name: _shown(value) for name, value in self.point.items()}
        found |= {"run": self.run, "seed": found.get("seed", self.seed), **self.values}
        found |= {"wall_seconds": self.wall_seconds, "failure": self.failure}
        return found | {f"{name}_version": self.versions.get(name) for name in VERSIONS}


def _shown(value: Any) -> Scalar:
    """A value of the grid as a table shows it."""
    found: Any = cast("Any", value).item() if isinstance(value, np.generic) else value
    return found if found is None or isinstance(found, bool | int | float | str) else repr(found)


@dataclass(frozen=True, repr=False)
class Sweep(Table):
    """The rows of a sweep, in the order of the grid: its last name changes fastest, and the runs of a point in it.

    Attributes:
        function: what was run, by name.
        parameters: names of the grid.
        rows: one for each run, failed ones included.
        units: units by the name of a column, where known; "1" means dimensionless.

    >>> import mpsim
    >>> def area(width, height):
    ...     return {"area": width * height}
    >>> table = mpsim.sweep(area, {"width": [1.0, 2.0], "height": [3.0, 0.0]}, units={"area": "length^2"})
    >>> table
    <Sweep: 4 runs of area over width, height>
    >>> [(row.point["width"], row.point["height"], row.values["area"]) for row in table.rows]
    [(1.0, 3.0, 3.0), (1.0, 0.0, 0.0), (2.0, 3.0, 6.0), (2.0, 0.0, 0.0)]
    >>> table.to_csv().splitlines()[0].split(",")[:5]
    ['width', 'height', 'run', 'seed', 'area [length^2]']
    """

    _what: ClassVar[str] = "the table of a sweep"

    function: str
    parameters: tuple[str, ...]
    rows: tuple[SweepRow, ...]
    units: dict[str, str] = field(default_factory=dict[str, str])

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results, in the order in which the rows have them."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.values))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of the table: parameters, run, seed, results, wall_seconds, failure, versions."""
        return tuple(dict.fromkeys((*self.parameters, *OWN[:2], *self.results, *OWN[2:])))

    @property
    def failed(self) -> tuple[SweepRow, ...]:
        """The rows whose run failed."""
        return tuple(row for row in self.rows if row.failure is not None)

    def _heads(self) -> list[str]:
        return [f"{name} [{self.units[name]}]" if name in self.units else name for name in self.columns]

    def _records(self) -> list[dict[str, Any]]:
        return [row.record() for row in self.rows]

    def _facts(self) -> dict[str, Any]:
        return {"function": self.function, "parameters": self.parameters, "units": self.units}

    def __repr__(self) -> str:
        failed = f", {len(self.failed)} failed" if self.failed else ""
        return f"<Sweep: {len(self.rows)} runs of {self.function} over {', '.join(self.parameters)}{failed}>"


# --- The task of a sweep: a function or a scene, checked before anything runs


@dataclass(frozen=True)
class Task:
    """What is done at each point.

    Attributes:
        name: of the function or scene.
        call: the function, or how scenes are run.
        title: plain values that identify the sweep in its file.
        taken: names that results must not have.
        source: digest of the source of the function; None if it has none.
        scene: that is run; None: `call` makes one, or needs none.
    """

    name: str
    call: Callable[..., Any]
    title: dict[str, Any]
    taken: frozenset[str]
    source: str | None = None
    scene: Scene | None = None

    def submission(self, row: SweepRow) -> tuple[Any, ...]:
        """What an executor is given for a row. A scene is redrawn here, because a scene that was sent cannot be."""
        arguments = dict(row.point)
        if self.scene is not None:
            try:
                arguments["scene"] = self.scene if row.seed is None else self.scene.redrawn(row.seed)
            except MpsimError as error:  # there was no room for its discs
                return failed_elsewhere, error
        elif row.seed is not None:
            arguments["seed"] = row.seed
        return run_point, self.call, arguments, self.taken

    def unpicklable(self, error: BaseException) -> InputError:
        """The error for a function, or values, that cannot be sent to another process."""
        return InputError(
            "function and the values of the grid must be what pickle can send to other processes; got "
            f"{self.name} ({described(error):.200}). Define the function at the top of a module, or sweep in threads."
        )


def task_of(function: Any, grid: dict[str, list[Any]], seeded: bool, how: dict[str, Any]) -> Task:
    """What is done at each of the points.

    Args:
        function, grid: of the sweep.
        seeded: whether it has seeds.
        how: until, frames, measures and settings, as `sweep` was given them.
    """
    for name in grid:
        if name in OWN and (name != "seed" or seeded):
            raise InputError(
                f"grid must not have the names {', '.join(OWN)}, which are columns of each sweep ('seed' only without "
                f"seeds); got {name!r}. Choose another name, or leave out seeds."
            )
    title = {"parameters": sorted(grid), "seeded": seeded}
    if isinstance(function, Scene | str | os.PathLike):
        return _scene_task(function, grid, title, how)
    if not callable(function):
        raise InputError(
            "function must be a function, an mpsim.Scene, or the name or path of one; got "
            f"{checks.brief(function)}. Give a function that returns a dictionary."
        )
    return _function_task(function, grid, title, how)


def _scene_task(
    source: Scene | str | os.PathLike[str], grid: dict[str, list[Any]], title: dict[str, Any], how: dict[str, Any]
) -> Task:
    if isinstance(source, Scene):
        scene, name = source, repr(source)[1:-1]
    else:
        found = scenefile.load(source)
        scene, name = found.scene, found.name
    for each in grid:
        if each not in RUN_FIELDS:
            meant = checks.near(each, RUN_FIELDS)
            hint = f"Did you mean {meant!r}? " if meant else ""
            rule = f"be one of {', '.join(map(repr, RUN_FIELDS))}, where a scene is given"
            instead = f"{hint}To vary the scene, give a function that makes it."
            raise checks.refusal(f"grid[{each!r}]", rule, repr(each), instead)
    if title["seeded"] and scene._redraw is None:
        scene.redrawn(0)  # which raises
    run = _scene_run(None, tuple(grid), grid, how, scene)
    title = {"function": f"scene {scene.digest()}", **title, "runs": run.facts(scene)}
    return Task(name, run, title, frozenset(grid), scene=scene)


def _function_task(
    function: Callable[..., Any], grid: dict[str, list[Any]], title: dict[str, Any], how: dict[str, Any]
) -> Task:
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # a function of C, whose arguments are not known
        signature = inspect.Signature([inspect.Parameter("others", inspect.Parameter.VAR_KEYWORD)])
    defined, identity = _identity(function)
    further = [name for name in grid if name not in signature.parameters]
    makes_scenes = any(each is not None for each in how.values()) or any(name in LENGTHS for name in further)
    own = tuple(name for name in further if name in RUN_FIELDS) if makes_scenes else ()
    given = [name for name in grid if name not in own] + (["seed"] if title["seeded"] else [])
    _demand_arguments(defined.__qualname__, signature, given)
    call = _scene_run(function, own, grid, how, None) if makes_scenes else function
    runs = call.facts(None) if isinstance(call, SceneRun) else None
    title = {"function": identity, **title, "runs": runs}
    return Task(defined.__qualname__, call, title, frozenset(grid), _source_of(defined))


def _scene_run(
    make: Callable[..., Any] | None,
    own: tuple[str, ...],
    grid: dict[str, list[Any]],
    how: dict[str, Any],
    scene: Scene | None,
) -> SceneRun:
    """How scenes are run, checked for each value of the grid."""
    length = {name: check(how[name]) for name, check in LENGTHS.items() if how[name] is not None}
    measures = None if how["measures"] is None else registry.checked(how["measures"], scene)
    settings = how["settings"] if scene is None else settings_for(scene, how["settings"])
    run = SceneRun(make, settings, length, measures, own)
    run.settings_of({}, scene)
    for name in own:
        for value in grid[name]:
            if name in LENGTHS:
                LENGTHS[name](value)
            else:
                run.settings_of({name: value}, scene)
    run.length_of({name: grid[name][0] for name in own}, scene)
    return run


def _demand_arguments(function: str, signature: inspect.Signature, given: list[str]) -> None:
    """Refuse arguments that a function does not take, and required ones that it would not get."""
    try:
        signature.bind(**dict.fromkeys(given))
    except TypeError as error:
        unknown = [name for name in given if name not in signature.parameters]
        near = checks.near(unknown[0], signature.parameters) if unknown else None
        remedy = "Leave it out, or give it its value by functools.partial, or a 'seed' by seeds=..."
        if near:
            remedy = f"Did you mean {near!r}?"
        elif set(unknown) & set(RUN_FIELDS):
            remedy = "To run the scene that it makes, say how long: until=..."
        raise InputError(
            f"grid, and seeds for a 'seed', must give {function} its arguments by name, "
            f"{', '.join(signature.parameters) or 'none'}; got {', '.join(given)} ({error}). {remedy}"
        ) from None


def _identity(function: Any) -> tuple[Any, str]:
    """The function, or the class of an object, inside of partial ones; and both as a text, with the values added."""
    values = ""
    while isinstance(function, functools.partial):
        values += re.sub(" at 0x[0-9a-f]+", "", f" {function.args} {function.keywords}")
        function = function.func
    defined: Any = function if hasattr(function, "__qualname__") else type(function)
    module = defined.__module__
    if module == "__main__":  # the program, by the name by which another one would import it
        main = sys.modules["__main__"]
        spec, file = getattr(main, "__spec__", None), getattr(main, "__file__", None)
        module = spec.name if spec is not None else Path(file).stem if file else module
    return defined, f"{module}.{defined.__qualname__}{values}"


def _source_of(defined: Any) -> str | None:
    try:
        text = inspect.getsource(defined)
    except (OSError, TypeError):
        return None
    return hashlib.blake2b(text.encode("utf-8", "replace"), digest_size=8).hexdigest()


_NO_PICKLE = re.compile("pickle|serializ|get attribute", re.IGNORECASE)
"""In texts of errors of executors that could not send something."""


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
            to 2^63 - 1, follows from its point and its number alone: the first 63 bits of the BLAKE2b hash of the point
            as JSON with sorted names, a space, and the number. A Scene is drawn again with it (`Scene.redrawn`). None:
            one run at each point, without a seed, of a Scene as it is.
        executor: any concurrent.futures.Executor: of threads, processes, Dask, mpi4py, loky; None: threads, one for
            each core. It is not shut down.
        path: file to which each run is written as soon as it is done. Runs in the file are not repeated, even if the
            grid now has other values. A file of another function, names of parameters, or other runs is refused.
        until: length of a run of a scene [time], >= 0; None: as given by `frames`, the grid, or the scene's duration.
        frames: length in frames instead, >= 0.
        measures: names of what to measure, as for `Simulation.run`; None: pressure, collision_rate, kinetic_energy and
            overlap, if the scene can have them.
        settings: of all runs, where the grid does not vary them; None: the scene's, or the defaults.
        units: name of a column -> its unit, for the header of the table. Those of a scene's measures are known.
        retry_failed: whether failed runs in the file are run again.
        progress: True: shown on standard error; or a function, called as progress(done, of, what).

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
    values, runs = checked_grid(grid), checked_seeds(seeds)
    rows = rows_of(values, runs)
    how = {"until": until, "frames": frames, "measures": measures, "settings": settings}
    task = task_of(function, values, runs is not None, how)
    named = _checked_units(units, UNITS if isinstance(task.call, SceneRun) else {})
    show = checked_progress(progress, "progress(done, of, what)")
    retry_failed = checks.truth("retry_failed", retry_failed)
    runner, lost, failed = Runner[Key](executor), list[BrokenExecutor](), 0
    if isinstance(executor, ProcessPoolExecutor):
        try:
            pickle.dumps(task.submission(next(iter(rows.values()))))
        except (pickle.PicklingError, AttributeError, TypeError, RecursionError) as error:
            raise task.unpicklable(error) from error
    with terminated_by_exit(), RunFile(path, "sweep", VERSION) as file, shown(show) as say, runner:
        outcomes = _finished(file, task)
        missing = {
            key: row
            for key, row in rows.items()
            if key not in outcomes or (retry_failed and outcomes[key]["failure"] is not None)
        }

        def keep(key: Key, future: Future[Any]) -> None:
            nonlocal failed
            outcomes[key] = outcome = _outcome_of(future, task, outcomes, lost)
            file.append({"point": json.loads(key[0]), "run": key[1], "seed": rows[key].seed, **outcome})
            failed += outcome["failure"] is not None

        def show_done(done: int) -> None:
            say(len(rows) - len(missing) + done, len(rows), f"runs, {failed} failed" if failed else "runs")

        show_done(0)
        runner.run(((key, task.submission(row)) for key, row in missing.items()), keep, show_done)
        done = tuple(dataclasses.replace(row, **outcomes[key]) for key, row in rows.items())
    if lost:
        warnings.warn(
            f"the executor broke, and {len(lost)} runs failed with it: {described(lost[-1]):.200} The other rows are "
            "kept. Call again with a new executor and the same path to run these.",
            SweepWarning,
            stacklevel=level_of_caller(),
        )
    columns = {*values, *OWN, *(name for row in done for name in row.values)}
    known = {name: unit for name, unit in {**named, "wall_seconds": "s"}.items() if name in columns}
    known |= {f"{name}_error": unit for name, unit in known.items() if f"{name}_error" in columns}
    return Sweep(task.name, tuple(values), done, known)


def _checked_units(units: Any, known: Mapping[str, str]) -> dict[str, str]:
    """Units by the name of a column: the known ones, and those given by the caller."""
    given = {} if units is None else units
    if not isinstance(given, Mapping) or not all(isinstance(each, str) for pair in given.items() for each in pair):
        raise InputError(
            f"units must be a dictionary of texts by the name of a column; got {checks.brief(units)}. "
            "Write {'pressure': 'mass/time^2'}."
        )
    return {**known, **given}


def _outcome_of(future: Future[Any], task: Task, finished: dict[Key, Outcome], lost: list[BrokenExecutor]) -> Outcome:
    """The outcome in a future, or why there is none; errors of an executor that broke are added to `lost`.

    Raises:
        InputError: if the task cannot be sent, or its result is of a wrong kind and no run has succeeded.
    """
    try:
        error = future.exception()
    except CancelledError as cancelled:
        error = cancelled
    if error is None:
        return future.result()
    if isinstance(error, KeyboardInterrupt):
        raise error
    if isinstance(error, WrongResult):
        error = InputError(str(error))
        if all(each["failure"] is not None for each in finished.values()):
            raise error
    elif isinstance(error, BrokenExecutor):
        lost.append(error)
    elif isinstance(error, pickle.PicklingError) or _NO_PICKLE.search(str(error)):
        raise task.unpicklable(error) from error
    return failed_elsewhere(error)
