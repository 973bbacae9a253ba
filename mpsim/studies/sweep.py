"""Sweeps: a function at every point of a grid of parameters, through any executor."""

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
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mpsim import __version__
from mpsim.core import checks
from mpsim.core.checks import brief, refusal
from mpsim.core.deferred_signals import terminated_by_exit
from mpsim.core.late import imported
from mpsim.core.progress import checked_progress, shown
from mpsim.core.state import State
from mpsim.engine.checkpoint import VERSIONS
from mpsim.errors import InputError
from mpsim.measure.statistics import Measure
from mpsim.scene.scene import Scene
from mpsim.studies.runner import RunFile, Runner

FILE = "sweep", 2  # kind and version of the file of a sweep
MOST_RUNS = 1_000_000  # more runs than this are taken for a mistake: their rows would not fit into memory

OWN = ("run", "seed", "wall_seconds", "failure")
"""Columns that every sweep has, besides those of the grid and of the results."""

LONGEST_FAILURE = 1000  # characters that are kept of an error

Scalar = bool | int | float | str | None

Key = tuple[str, int]
"""What distinguishes a run from all others: the text of its point, and its number there; 0 without seeds."""

Outcome = dict[str, Any]  # the last fields of a SweepRow, plain values


@dataclass(frozen=True)
class SweepRow:
    """One run of a sweep.

    Attributes:
        point: values of the parameters, as the grid gave them.
        run: number of the run at this point, from 0 on.
        seed: that the run was given; None without seeds.
        values: its results by name; empty if it failed.
        failure: why it failed, as "ValueError: ..."; None if it did not.
        wall_seconds: time that it took [s]; NaN if that is unknown.
    """

    point: dict[str, Any]
    run: int
    seed: int | None
    values: dict[str, Scalar] = field(default_factory=dict[str, Scalar])
    failure: str | None = None
    wall_seconds: float = math.nan


@dataclass(frozen=True, repr=False)
class Sweep:
    """The rows of a sweep, in the order of the grid: its last name changes fastest, and the runs of a point in it.

    Attributes:
        function: what was run, by name.
        parameters: names of the grid.
        rows: one for each run, failed ones included.

    >>> def area(width, height):
    ...     return {"area": width * height}
    >>> table = sweep(area, {"width": [1.0, 2.0], "height": [3.0, 0.0]})
    >>> table
    <Sweep: 4 runs of area over width, height>
    >>> [(row.point["width"], row.point["height"], row.values["area"]) for row in table.rows]
    [(1.0, 3.0, 3.0), (1.0, 0.0, 0.0), (2.0, 3.0, 6.0), (2.0, 0.0, 0.0)]
    """

    function: str
    parameters: tuple[str, ...]
    rows: tuple[SweepRow, ...]

    @property
    def failed(self) -> tuple[SweepRow, ...]:
        """The rows whose run failed."""
        return tuple(row for row in self.rows if row.failure is not None)

    def to_pandas(self) -> Any:
        """The table as a pandas.DataFrame: run, seed, parameters, wall_seconds, failure and results of each run.

        Its `attrs` hold the function, the parameters, and the versions of mpsim, NumPy, Numba and Python.

        Raises:
            OutputError: if pandas is not installed.
        """
        pandas = imported("pandas", "a DataFrame", "sweep", "use its rows")
        records: list[dict[str, Any]] = []
        for row in self.rows:
            point = {name: _shown(value) for name, value in row.point.items()}
            own = {"wall_seconds": row.wall_seconds, "failure": row.failure}
            records.append({"run": row.run, "seed": row.seed, **point, **own, **row.values})
        frame = pandas.DataFrame(records)
        versions = {"mpsim": __version__, **VERSIONS}
        frame.attrs = {"function": self.function, "parameters": list(self.parameters), "versions": versions}
        return frame

    def __repr__(self) -> str:
        failed = f", {len(self.failed)} failed" if self.failed else ""
        return f"<Sweep: {len(self.rows)} runs of {self.function} over {', '.join(self.parameters)}{failed}>"


def _shown(value: Any) -> Scalar:
    """A value of the grid as a table shows it: what is not a number, text or truth value as its repr."""
    found: Any = value.item() if isinstance(value, np.generic) else value
    return found if found is None or isinstance(found, bool | int | float | str) else repr(found)


# --- The points of a sweep: combinations of the values of a grid, and the seed of each
#
# The text of a point is JSON of its values, sorted by name, and contains nothing else. So neither the order of names
# and values nor other values of the grid change the seed of a point, or its row in a file.


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


def checked_grid(grid: Any, seeded: bool) -> dict[str, list[Any]]:
    """The values of a grid."""
    if not isinstance(grid, Mapping) or not grid:
        rule = "be a dictionary of lists, by the name of at least one parameter"
        raise refusal("grid", rule, brief(grid), "Write {'packing': [0.1, 0.3]}.")
    found: dict[str, list[Any]] = {}
    for name, values in grid.items():
        if not isinstance(name, str) or not name.isidentifier() or (name in OWN and (seeded or name != "seed")):
            rule = f"have names of parameters as its keys, and none of {', '.join(OWN)} ('seed' only without seeds)"
            raise refusal("grid", rule, brief(name))
        if isinstance(values, str | bytes | Mapping) or not isinstance(values, Iterable):
            raise refusal(f"grid[{name!r}]", "be a list of values", brief(values), "Write [value] for a single one.")
        found[name] = list(itertools.islice(values, MOST_RUNS + 1))
        if not 0 < len(found[name]) <= MOST_RUNS:
            raise refusal(f"grid[{name!r}]", f"hold 1 to {MOST_RUNS:,} values", "more" if found[name] else "none")
        different: set[str] = set()
        for value in found[name]:
            if (text := text_of({name: value})) in different:
                got = f"{brief(value)} more than once (numbers that are equal count as one, as do lists and tuples)"
                raise refusal(f"grid[{name!r}]", "hold different values", got, "Leave one out, or ask for more seeds.")
            different.add(text)
    return found


def rows_of(grid: dict[str, list[Any]], seeds: int | None) -> dict[Key, SweepRow]:
    """Rows without outcome: each combination of the values of a grid, the last name changing fastest, and its runs."""
    number = math.prod(map(len, grid.values())) * (seeds or 1)
    if number > MOST_RUNS:
        rule, instead = f"have at most {MOST_RUNS:,} runs, those of all seeds together", "Sweep over fewer values."
        raise refusal("grid", rule, f"{number:,}", instead)
    rows: dict[Key, SweepRow] = {}
    for values in itertools.product(*grid.values()):
        point = dict(zip(grid, values, strict=True))
        text = text_of(point)
        for run in range(seeds or 1):
            rows[text, run] = SweepRow(point, run, None if seeds is None else seed_of(text, run))
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
        rule = "hold None, True or False, numbers, texts, or lists, dictionaries and dataclasses of these"
        instead = "Sweep over its name or number, and make the object in the function."
        raise refusal(name, rule, f"{brief(value)}, a {type(value).__name__}", instead)
    return {type(value).__name__: text}


# --- One run of a sweep, wherever the executor runs it


def run_point(
    function: Callable[..., Any], arguments: dict[str, Any], taken: Iterable[str], stop: object = None
) -> Outcome:
    """The outcome of one run. An error that the function raises is part of it, so that it does not end the others.

    taken: names that results must not have; stop: which a `Runner` adds to the arguments, but a function does not heed.
    """
    started = time.perf_counter()
    try:
        result = function(**arguments)
    except (Exception, SystemExit) as error:
        return failed(error) | {"wall_seconds": time.perf_counter() - started}
    return {"values": scalars(result, taken), "failure": None, "wall_seconds": time.perf_counter() - started}


def failed(error: BaseException) -> Outcome:
    """The outcome of a run that has no result."""
    text = f"{type(error).__name__}: {error}".removesuffix(": ")[:LONGEST_FAILURE]
    return {"values": {}, "failure": text, "wall_seconds": math.nan}


def scalars(result: Any, taken: Iterable[str]) -> dict[str, Scalar]:
    """What a function returned, as plain values by name. A Measure becomes its value, and its error beside it.

    >>> scalars({"pressure": Measure(2.5, 0.5, 20), "count": np.int32(7)}, ())
    {'pressure': 2.5, 'pressure_error': 0.5, 'count': 7}
    """
    if not isinstance(result, Mapping):
        rule = "be a dictionary of numbers, texts or truth values by name"
        got = f"{brief(result)}, a {type(result).__name__}"
        raise refusal("the result of the function", rule, got, "Return {'name': value}.")
    found: dict[Any, Scalar] = {}
    for name, value in result.items():
        if isinstance(value, Measure):
            found |= {name: float(value.value), f"{name}_error": float(value.error)}
        else:
            found[name] = _scalar(name, value)
    for name in found:
        if not isinstance(name, str) or not name or name in taken or name in OWN:
            rule = f"be texts, and not those of parameters or of {', '.join(OWN)}"
            raise refusal("the names of results", rule, brief(name), "Choose another name.")
    return found


def _scalar(name: Any, value: Any) -> Scalar:
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, numbers.Real):
        return int(value) if isinstance(value, numbers.Integral) else float(value)
    got = f"{brief(value)}, a {type(value).__name__}"
    instead = "Return one name for each number, or keep arrays in a file of your own."
    raise refusal(f"the result {name!r}", "be a number, a text, True, False or None", got, instead)


# --- The function


def names_of(function: Any) -> tuple[str, str]:
    """The name of a function, or of the class of an object; and with the values of partial ones, which a file has."""
    values = ""
    while isinstance(function, functools.partial):
        values += re.sub(" at 0x[0-9a-f]+", "", f" {function.args} {function.keywords}")
        function = function.func
    name = function.__qualname__ if hasattr(function, "__qualname__") else type(function).__qualname__
    return name, name + values


def _demand_arguments(function: Any, given: list[str]) -> None:
    """Refuse arguments that a function does not take, and required ones that it would not get."""
    if not callable(function):
        raise refusal("function", "be a function", brief(function), "Give one that returns a dictionary.")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # a function of C, whose arguments are not known
        return
    try:
        signature.bind(**dict.fromkeys(given))
    except TypeError as error:
        rule = f"give {names_of(function)[0]} its arguments by name, {', '.join(signature.parameters) or 'none'}"
        remedy = "Give fixed ones by functools.partial, and a 'seed' by seeds=..."
        raise refusal("grid, and seeds for a 'seed',", rule, f"{', '.join(given)} ({error})", remedy) from None


def sweep(
    function: Callable[..., Mapping[str, Any]],
    grid: Mapping[str, Iterable[Any]],
    seeds: int | None = None,
    executor: Executor | None = None,
    path: str | os.PathLike[str] | None = None,
    *,
    progress: bool | Callable[[int, int, str], None] | None = None,
) -> Sweep:
    """Call a function at every point of a grid: a table with a row for each run.

    A point is one combination of the grid's values. The function is called with them as its arguments by name, and with
    `seed` if there are seeds, and returns a dictionary of numbers, texts, truth values or None by name; of a
    `measure.Measure` the row holds its value and, under name_error, its error. If the function raises an error, only
    that run fails, and its row says why. If it returns something else, the sweep ends.

    Args:
        function: called at each point. For executors of processes it must be in a module that they can import.
        grid: name of a parameter -> its values, at least one, all different. Values are None, truth values, numbers,
            texts, or tuples, lists, dictionaries and dataclasses of these. Equal numbers are one value.
        seeds: number of runs at each point, >= 1. The seed of a run, from 0 to 2^63 - 1, follows from its point and its
            number alone: the first 63 bits of the BLAKE2b hash of the point as JSON with sorted names, a space, and the
            number. None: one run at each point, without a seed.
        executor: any concurrent.futures.Executor: of threads, processes, Dask, mpi4py, loky; None: threads, one for
            each core. It is not shut down.
        path: file to which each run is written as soon as it is done. Runs in the file are not repeated unless they
            failed, even if the grid now has other values. A file of another function, or of other names of parameters,
            is refused.
        progress: True: shown on standard error; or a function, called as progress(done, of, what).

    Returns:
        The rows, in the order of the grid, whatever the order in which runs ended.

    Raises:
        InputError: naming the argument and its rule; nothing was run. Or the function returned what cannot be a row.
        OutputError: if the file cannot be written.
        KeyboardInterrupt: Ctrl-C. Runs that have not started are cancelled; finished ones are in the file.

    >>> def distance(speed, time, seed):
    ...     return {"distance": speed * time, "odd": bool(seed % 2)}
    >>> table = sweep(distance, {"speed": [1.0, 2.0], "time": [3.0]}, seeds=2)
    >>> [(row.point["speed"], row.run, row.values["distance"]) for row in table.rows]
    [(1.0, 0, 3.0), (1.0, 1, 3.0), (2.0, 0, 6.0), (2.0, 1, 6.0)]
    """
    seeds = None if seeds is None else checks.whole("seeds", seeds, 1, MOST_RUNS, "4 makes four runs at each point.")
    seeded = seeds is not None
    values = checked_grid(grid, seeded)
    rows = rows_of(values, seeds)
    _demand_arguments(function, [*values, *(["seed"] * seeded)])
    name, identity = names_of(function)
    show = checked_progress(progress, "progress(done, of, what)")
    runner = Runner[Key](executor)

    def task_of(row: SweepRow) -> tuple[Any, ...]:
        return run_point, function, row.point | ({"seed": row.seed} if seeded else {}), tuple(values)

    if isinstance(executor, ProcessPoolExecutor):
        try:
            pickle.dumps(task_of(next(iter(rows.values()))))
        except (pickle.PicklingError, AttributeError, TypeError, RecursionError) as error:
            rule, got = "be what pickle can send to other processes", f"{name} ({error!s:.200})"
            instead = "Define the function at the top of a module, or sweep in threads."
            raise refusal("function and the values of the grid", rule, got, instead) from error
    with terminated_by_exit(), RunFile(path, *FILE) as file, shown(show) as say, runner:
        outcomes = _finished(file, {"function": identity, "parameters": sorted(values), "seeded": seeded})
        done = {key for key in rows if key in outcomes and outcomes[key]["failure"] is None}
        failures = 0

        def keep(key: Key, future: Future[Any]) -> None:
            nonlocal failures
            try:
                outcome = future.result()
            except InputError:  # the function returned what cannot be a row
                raise
            except Exception as error:  # the executor has lost the run
                outcome = failed(error)
            outcomes[key] = outcome
            file.append({"point": json.loads(key[0]), "run": key[1], "seed": rows[key].seed, **outcome})
            failures += outcome["failure"] is not None

        def show_done(number: int) -> None:
            say(len(done) + number, len(rows), f"runs, {failures} failed" if failures else "runs")

        show_done(0)
        runner.run(((key, task_of(row)) for key, row in rows.items() if key not in done), keep, show_done)
    return Sweep(name, tuple(values), tuple(dataclasses.replace(row, **outcomes[key]) for key, row in rows.items()))


def _finished(file: RunFile, title: dict[str, Any]) -> dict[Key, Outcome]:
    """The outcomes in the file of a sweep."""
    outcomes: dict[Key, Outcome] = {}

    def take(line: dict[str, Any]) -> None:
        text = json.dumps(dict(line["point"]), sort_keys=True, separators=(",", ":"))
        outcomes[text, int(line["run"])] = {
            "values": dict(line["values"]),
            "failure": None if line["failure"] is None else str(line["failure"]),
            "wall_seconds": float(line["wall_seconds"]),
        }

    file.begin(title, take)
    return outcomes
