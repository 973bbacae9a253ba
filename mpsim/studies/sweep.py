"""Sweeps: a function, or a scene that is run, at every point of a grid of parameters, through any executor."""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

# Values of grids and results are of any type, and are checked as the program runs.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnnecessaryIsInstance=false
# pyright: reportUnnecessaryComparison=false

from __future__ import annotations

import csv
import dataclasses
import functools
import hashlib
import inspect
import io
import itertools
import json
import math
import numbers
import os
import pickle
import platform
import re
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping, Sized
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path, PurePath
from typing import Any, cast

import numba
import numpy as np

from mpsim.core import checks, files
from mpsim.core.deferred_signals import terminated_by_exit
from mpsim.core.files import CSV, JSON, FileLock, written
from mpsim.core.late import imported
from mpsim.core.machine import usable_cores
from mpsim.core.progress import checked_progress, shown
from mpsim.core.state import State
from mpsim.core.text import json_text
from mpsim.core.version import __version__
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import MOST_FRAMES_OF_A_RUN
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError, MpsimError, OutputError, SweepWarning, level_of_caller, reason_of
from mpsim.measure import registry
from mpsim.measure.statistics import Measure
from mpsim.scene import scenefile
from mpsim.scene.scene import Scene, settings_for
from mpsim.scene.settings import Settings, check_settings
from mpsim.studies.ensemble import Submissions, checked_executor, checked_path
from mpsim.studies.replicas import Stopped

# --- The points of a sweep: combinations of the values of a grid, and the seed of each
#
# The text of a point is JSON of its values, sorted by name, and contains nothing else. So neither the order of names
# and values nor other values of the grid change the seed of a point, or its row in a file.

MOST_POINTS = 10_000_000
"""More runs than this are taken for a mistake: their rows would not fit into memory."""

MOST_SEEDS = 1_000_000

VALUES = "None, True or False, numbers, texts, or tuples, lists, dictionaries and dataclasses of these"
"""What a grid may hold, in words."""


@dataclass(frozen=True)
class Point:
    """One run of a sweep.

    Attributes:
        values: by the names of the grid, as they were given.
        plain: the same as plain values, which identify the point.
        run: number of the run at this point; 0 without seeds.
        seed: derived from both; None without seeds.
    """

    values: dict[str, Any]
    plain: dict[str, Any]
    run: int
    seed: int | None

    @property
    def key(self) -> tuple[str, int]:
        """What distinguishes the run from all others."""
        return text_of(self.plain), self.run


def text_of(plain: Mapping[str, Any]) -> str:
    """Plain values by name as a text, the same for every order of the names.

    >>> text_of({"packing": 0.1, "count": 2})
    '{"count":2,"packing":0.1}'
    """
    return json.dumps(plain, sort_keys=True, separators=(",", ":"))


def seed_of(plain: Mapping[str, Any], run: int) -> int:
    """The seed of a run: the first 63 bits of BLAKE2b of the point's text, a space, and the number of the run.

    >>> seed_of({"packing": 0.1}, 0), seed_of({"packing": 0.1}, 1)
    (1570410355820327519, 8174789766741869874)
    """
    digest = hashlib.blake2b(f"{text_of(plain)} {run}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") >> 1


def points_of(grid: Any, seeds: Any) -> list[Point]:
    """All runs of a grid: every combination of its values, the last name changing fastest, and each of its seeds.

    Raises:
        InputError: if the grid or the seeds break a rule.
    """
    if not isinstance(grid, Mapping):
        raise InputError(
            f"grid must be a dictionary of lists by the name of a parameter; got {checks.brief(grid)}. "
            "Write {'packing': [0.1, 0.3]}."
        )
    if not grid:
        raise InputError("grid must hold at least one parameter; got none. Write {'packing': [0.1, 0.3]}.")
    values = {name: _listed(name, each) for name, each in cast("Mapping[Any, Any]", grid).items()}
    plain = {name: [canonical(f"grid[{name!r}]", each) for each in values[name]] for name in values}
    for name, each in values.items():
        _demand_different(name, each, plain[name])
    runs = _checked_seeds(seeds)
    number = math.prod(map(len, values.values())) * len(runs or (0,))
    if number > MOST_POINTS:
        raise InputError(
            f"grid must have at most {MOST_POINTS:,} runs, those of all seeds together; got {number:,}. "
            "Sweep over fewer values, or over some of the parameters at a time."
        )
    points: list[Point] = []
    for combination in zip(itertools.product(*values.values()), itertools.product(*plain.values()), strict=True):
        here, there = (dict(zip(values, each, strict=True)) for each in combination)
        if runs is None:
            points.append(Point(here, there, 0, None))
        else:
            points += [Point(here, there, run, seed_of(there, run)) for run in runs]
    return points


def _listed(name: Any, values: Any) -> list[Any]:
    """The values of one name of a grid, both checked."""
    if not isinstance(name, str) or not name.isidentifier():
        raise InputError(f"grid must have names of parameters as its keys; got {checks.brief(name)}.")
    if isinstance(values, str | bytes | Mapping | Scene) or not isinstance(values, Iterable):
        raise InputError(
            f"grid[{name!r}] must be a list of values; got {checks.brief(values)}. Write [value] for a single one."
        )
    too_many = isinstance(values, Sized) and len(values) > MOST_POINTS
    found: list[Any] = [] if too_many else list(itertools.islice(values, MOST_POINTS + 1))
    if too_many or len(found) > MOST_POINTS:
        raise InputError(f"grid[{name!r}] must have at most {MOST_POINTS:,} values; got more. Sweep over fewer.")
    if not found:
        raise InputError(f"grid[{name!r}] must hold at least one value; got none. Give one, or leave the name out.")
    return found


def _demand_different(name: str, values: list[Any], plain: list[Any]) -> None:
    texts = [text_of({"value": each}) for each in plain]
    if len(set(texts)) < len(texts):
        index = next(index for index, text in enumerate(texts) if text in texts[:index])
        raise InputError(
            f"grid[{name!r}] must hold different values; got {checks.brief(values[index])} more than once (numbers "
            "that are equal count as one, as do lists and tuples). Leave one out, or ask for more seeds."
        )


def _checked_seeds(seeds: Any) -> list[int] | None:
    """Numbers of the runs at each point; None without seeds."""
    if seeds is None:
        return None
    remedy = "4 makes four runs at each point, 0 to 3."
    if isinstance(seeds, str | bytes | Mapping) or not isinstance(seeds, Iterable):
        return list(range(checks.whole("seeds", seeds, 1, MOST_SEEDS, remedy)))
    found = [checks.whole("a number in seeds", each, 0, 2**63 - 1, remedy) for each in seeds]
    if not found or len(set(found)) < len(found):
        raise InputError(
            f"seeds must be a number of runs, or different numbers of them; got {checks.brief(found)}. {remedy}"
        )
    return found


def canonical(name: str, value: Any) -> Any:
    """A value as JSON can hold it, the same for values that are equal: 1 and 1.0, a list and a tuple.

    Fields of a dataclass that have their default are left out, so that a new one changes no point.

    Args:
        name: of the value, for the error.
        value: one of VALUES, a NumPy array or scalar, a member of an enumeration, a path, a Scene or a State.

    Raises:
        InputError: if it is something else.

    >>> canonical("x", (1.0, np.float32(0.5), True, None, float("inf")))
    [1, 0.5, True, None, {'float': 'inf'}]
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, Enum):
        return {"enum": f"{_name_of_type(value)}.{value.name}"}
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, float) and math.isfinite(value):
        return int(value) if value == int(value) else float(value)
    return str(value) if isinstance(value, str) else _of_compound(name, value)


def _of_compound(name: str, value: Any) -> Any:
    if isinstance(value, float):
        return {"float": repr(float(value))}
    if isinstance(value, list | tuple):
        return [canonical(name, each) for each in value]
    if isinstance(value, Mapping) and all(isinstance(each, str) for each in value):
        return {"dict": {each: canonical(name, part) for each, part in value.items()}}
    if isinstance(value, PurePath):
        return {"path": str(value)}
    if isinstance(value, Scene | State):
        return {type(value).__name__: value.digest()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [each for each in dataclasses.fields(value) if each.compare]
        parts = {each.name: canonical(name, getattr(value, each.name)) for each in fields}
        defaults = {
            each.name: canonical(name, each.default) for each in fields if each.default is not dataclasses.MISSING
        }
        return {
            "dataclass": _name_of_type(value),
            **{each: part for each, part in parts.items() if each not in defaults or defaults[each] != part},
        }
    raise InputError(
        f"{name} must hold {VALUES}; got {checks.brief(value)}, a {type(value).__name__}. Sweep over its name or "
        "number, and make the object in the function."
    )


def _name_of_type(value: object) -> str:
    return f"{type(value).__module__}.{type(value).__qualname__}"


# --- One run of a sweep, wherever the executor runs it
#
# Whatever goes wrong in a run becomes part of its outcome. An outcome holds only plain values, so it can always be
# sent back, and a failed run does not end the others.

MEASURES = ("pressure", "collision_rate", "kinetic_energy", "overlap")
"""What a run measures if nothing is asked for, as far as its scene can have it."""

RUN_OPTIONS = ("until", "frames")

RUN_FIELDS: tuple[str, ...] = (*(field.name for field in dataclasses.fields(Settings)), *RUN_OPTIONS)
"""Names of a grid that vary how a scene is run."""

LONGEST_FAILURE = 1000
"""Characters of an error in words that are kept: its beginning."""

LONGEST_TRACEBACK = 4000
"""Characters of a traceback that are kept: its end."""

_ENERGY = "mass length^2/time^2"
UNITS = {
    "dt": "time",
    "until": "time",
    "pressure": "mass/time^2",
    "pressure_virial": "mass/time^2",
    "pressure_xx": "mass/time^2",
    "pressure_yy": "mass/time^2",
    "pressure_xy": "mass/time^2",
    "collision_rate": "1/time",
    "contact_rate": "1/time",
    "energy_drift": "1/time",
    "momentum_drift": "1/time",
    "overlap": "length",
    "largest_overlap": "length",
    "kinetic_energy": _ENERGY,
    "temperature": _ENERGY,
    "speed_kurtosis": "1",
    "frames": "1",
    "collisions": "1",
}
"""Units of what a run of a scene takes and gives, in those of the scene."""


@dataclass(frozen=True)
class SceneRun:
    """How each point of a sweep becomes a run of a scene.

    Attributes:
        make: gives the scene of a point; None where the argument `scene` is one.
        settings: of the runs, where the grid does not vary them; None: those that the scene of a point recommends.
        until, frames: length of a run [time], where the grid does not vary it; None: the scene's duration.
        measures: names; None: MEASURES, as far as the scene can have them.
        own: names of the grid that vary settings and length.
    """

    make: Callable[..., Any] | None
    settings: Settings | None
    until: float | None
    frames: int | None
    measures: tuple[str, ...] | None
    own: frozenset[str]

    def __call__(self, stop: threading.Event | None = None, **arguments: Any) -> dict[str, Scalar]:
        """Measures of the run with their errors, and how many frames and collisions it had."""
        scene = self._scene({name: value for name, value in arguments.items() if name not in self.own})
        varied = {name: value for name, value in arguments.items() if name in self.own}
        length = self.length(varied, scene)
        settings = self.settings_of(varied, scene)
        names = registry.checked(MEASURES, None) if self.measures is None else self.measures
        if self.measures is None:
            names = tuple(name for name in names if registry.refusal(name, scene) is None)

        def stop_if_asked(done: int, of: int) -> None:
            if stop is not None and stop.is_set():
                raise Stopped

        with Simulation(scene, settings) as sim:
            report = sim.run(**length, measures=names, progress=stop_if_asked)
        found: dict[str, Scalar] = {}
        for name in names:
            measure = report.measures[name]
            found |= {name: float(measure.value), f"{name}_error": float(measure.error)}
        found |= {"frames": report.frames, "collisions": int(report.collisions)}
        return {name: value for name, value in found.items() if name not in varied}

    def settings_of(self, varied: Mapping[str, Any], scene: Scene | None = None) -> Settings:
        """The settings of a point, of one process unless they ask for more: the bits are the same.

        scene: of the point; None: it is not made yet.

        Raises:
            InputError: if a value breaks a rule of Settings, or the method runs on ranks.
        """
        changes = {name: value for name, value in varied.items() if name not in RUN_OPTIONS}
        settings = dataclasses.replace(_settings_for(scene, self.settings), **changes)
        if capabilities_of(settings).on_ranks:
            raise InputError(
                f"method must be one that runs in a process, as each run of a sweep does; got {settings.method!r}. Use "
                "'grid', which has the same bits."
            )
        return settings if settings.workers else dataclasses.replace(settings, workers=1)

    def length(self, varied: Mapping[str, Any], scene: Scene | None) -> dict[str, Any]:
        """The length of a run, as an argument of `Simulation.run`; scene: None if it is not made yet.

        Raises:
            InputError: if there is none, or there are two.
        """
        given = {"until": self.until, "frames": self.frames} | {n: v for n, v in varied.items() if n in RUN_OPTIONS}
        chosen = {name: value for name, value in given.items() if value is not None}
        if not chosen and scene is None:
            return {}
        if not chosen and scene is not None and scene.duration is not None:
            return {"until": scene.duration}
        if len(chosen) != 1:
            raise InputError(
                "a sweep of runs must have their length, as one of until and frames; got "
                f"{' and '.join(chosen) or 'neither'}, and a scene without duration. Say until=... [time], or let the "
                "grid vary it."
            )
        return chosen

    def _scene(self, arguments: dict[str, Any]) -> Scene:
        scene = arguments["scene"] if self.make is None else self.make(**arguments)
        if not isinstance(scene, Scene):
            raise WrongResult(
                f"a function whose scenes are to be run must return an mpsim.Scene; got {type(scene).__name__}. "
                "Return one, or leave out until, frames, measures and settings."
            )
        return scene


class WrongResult(InputError):  # noqa: N818 - said of what a function returned
    """A function returned what cannot be a row of a table."""


def run_point(
    function: Callable[..., Any], arguments: dict[str, Any], taken: frozenset[str], stop: threading.Event | None = None
) -> dict[str, Any]:
    """The outcome of one run.

    Args:
        function: that gives the results of a point by name.
        arguments: its arguments by name.
        taken: names that results must not have.
        stop: ends a SceneRun early, by the exception Stopped.

    Returns:
        "values" (results by name), or "failure" and "traceback", and "wrong" if the results were of a wrong kind;
        "seconds" and "versions" always.
    """
    started = time.perf_counter()
    outcome: dict[str, Any]
    try:
        call = functools.partial(function, stop=stop) if isinstance(function, SceneRun) else function
        outcome = {"values": scalars(call(**arguments), taken)}
    except Stopped:
        raise
    except WrongResult as error:
        outcome = {"failure": f"InputError: {error}", "traceback": "", "wrong": True}
    except (Exception, SystemExit) as error:
        text = "".join(traceback.format_exception(error))
        outcome = {"failure": described(error), "traceback": _encodable(text[-LONGEST_TRACEBACK:])}
    return {**outcome, "seconds": time.perf_counter() - started, "versions": versions()}


def described(error: BaseException) -> str:
    """An error in words: its class, and the beginning of its text if it has one.

    >>> described(ValueError("too small")), described(KeyError())
    ('ValueError: too small', 'KeyError')
    """
    try:
        text = str(error)
    except Exception:
        text = "its text cannot be had"
    if len(text) > LONGEST_FAILURE:
        text = f"{text[:LONGEST_FAILURE]} ... ({len(text):,} characters)"
    return f"{type(error).__name__}: {_encodable(text)}" if text else type(error).__name__


def _encodable(text: str) -> str:
    """A text that every file can hold: lone surrogates, as in names of files that are not UTF-8, are written out."""
    return text.encode("utf-8", "backslashreplace").decode()


@functools.cache
def versions() -> dict[str, str]:
    """Versions, in this process, of everything that may change a result."""
    python = platform.python_version()
    return {"mpsim": __version__, "numpy": np.__version__, "numba": numba.__version__, "python": python}


def scalars(result: Any, taken: frozenset[str]) -> dict[str, Scalar]:
    """What a function returned, as plain values by name. A Measure becomes its value, and its error beside it.

    Raises:
        WrongResult: if it is not a mapping from names to scalars, or a name is taken.

    >>> scalars({"pressure": Measure(2.5, 0.5, 20), "count": np.int32(7)}, frozenset())
    {'pressure': 2.5, 'pressure_error': 0.5, 'count': 7}
    """
    if not isinstance(result, Mapping):
        scene = " To run scenes, say how long: until=... or frames=..." if isinstance(result, Scene) else ""
        raise WrongResult(
            "the result of the function must be a dictionary of numbers, texts or truth values by name; got "
            f"{checks.brief(result)}, a {type(result).__name__}. Return {{'name': value}}.{scene}"
        )
    found: dict[str, Scalar] = {}
    items: Mapping[Any, Any] = result
    for name, value in items.items():
        if isinstance(value, Measure):
            found |= {name: float(value.value), f"{name}_error": float(value.error)}
        else:
            found[name] = _scalar(name, value)
    for name in found:
        if not isinstance(name, str) or not name:
            raise WrongResult(f"the names of results must be texts; got {checks.brief(name)}. Use a word.")
        if name in taken or name in OWN:
            raise WrongResult(
                f"the names of results must not be those of parameters, or of {', '.join(OWN)}; got {name!r}. "
                "Choose another name."
            )
    return found


def _scalar(name: Any, value: Any) -> Scalar:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, np.number | np.bool_ | np.str_) and not isinstance(value, np.complexfloating):
        value = value.item()
    if isinstance(value, str):
        return _encodable(value)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real | np.floating):
        return float(value)
    raise WrongResult(
        f"the result {name!r} must be a number, a text, True, False or None; got {checks.brief(value)}, a "
        f"{type(value).__name__}. Return one name for each number, or keep arrays in a file of your own."
    )


def failed_elsewhere(error: BaseException) -> dict[str, Any]:
    """The outcome of a run that the executor could not bring back."""
    return {"failure": described(error), "traceback": "", "seconds": math.nan, "versions": versions()}


# --- The file of a sweep: a header, and one line of JSON for each finished run
#
# A line is written by one system call when its run is done. So Ctrl-C leaves complete lines, and a kill leaves at most
# one incomplete line, which the next sweep removes with a warning. Only one sweep at a time may use the file.

FORMAT = "mpsim sweep 1"

MOST_BYTES = 2**32
"""Largest size of a file: some ten million runs."""

_BEGIN = '{"format": "mpsim sweep '
"""With this every file begins: text that does not is no sweep, and is left alone."""


class SweepFile:
    """The finished runs of a sweep, in memory and, if there is a path, in a file.

    Args:
        path: of the file, or None.
        title: of what the runs are: "function", "parameters", "seeded" and further facts, plain values.
        source: digest of the source of the function; if the file has another one, a warning is raised.

    Attributes:
        outcomes: of the finished runs, as `run_point` gives them, by the key of their points.

    Raises:
        InputError: if the file is one of another sweep, is damaged, cannot be written to, or is in use.
    """

    def __init__(self, path: str | os.PathLike[str] | None, title: dict[str, Any], source: str | None):
        self.outcomes: dict[tuple[str, int], dict[str, Any]] = {}
        self._path: Path | None = None
        self._descriptor = -1
        if path is not None:
            self._open(checked_path(path), title, source)

    def __enter__(self) -> SweepFile:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def put(self, point: Point, outcome: dict[str, Any]) -> None:
        """Add the outcome of a run, in the file as well.

        Raises:
            OutputError: if it cannot be written; the file is as it was before.
        """
        self.outcomes[point.key] = outcome
        if self._path is not None:
            kept = {name: value for name, value in outcome.items() if name != "wrong"}
            self._append({"point": point.plain, "run": point.run, "seed": point.seed, **kept})

    def close(self) -> None:
        """Hand the file to the disk, and to the next sweep."""
        if self._descriptor >= 0:
            descriptor, self._descriptor = self._descriptor, -1
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
                self._lock.release()

    def _open(self, path: Path, title: dict[str, Any], source: str | None) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            self._descriptor = os.open(path, flags, 0o666)
            self._lock = FileLock(path)
        except OutputError:
            os.close(self._descriptor)
            raise InputError(
                f"path must be a file that no other sweep has; {path} is being written by another one, of this process "
                "or another. Wait for its end, or give another path."
            ) from None
        except OSError as error:
            raise InputError(
                f"path must be a file that can be written to; got {str(path)!r} ({error.strerror}). Give another path."
            ) from None
        self._path = path
        try:
            whole = self._read(path, title, source)
            os.ftruncate(self._descriptor, whole)
            if not whole:
                self._append({"format": FORMAT, **title, "source": source})
        except BaseException:
            self.close()
            raise

    def _read(self, path: Path, title: dict[str, Any], source: str | None) -> int:
        """Take what is there; returns the length of its whole lines, in bytes."""
        try:
            content = files.content(path, MOST_BYTES)
        except (OSError, ValueError) as error:
            raise _unreadable(path, reason_of(error)) from None
        if content and not (content.startswith(_BEGIN.encode()) or _BEGIN.encode().startswith(content)):
            raise _unreadable(path, f"it does not begin with {_BEGIN}")
        whole, _, torn = content.rpartition(b"\n")
        if torn:
            warnings.warn(
                f"the last line of {path} was cut off, as by a kill, and is dropped: its run is repeated.",
                SweepWarning,
                stacklevel=level_of_caller(),
            )
        if not whole:
            return 0
        first, *lines = whole.split(b"\n")
        head = _value(path, 1, first)
        _demand_same(path, head, title)
        if not lines:
            return 0  # the head is written anew, for a function that was put right before any run was done
        _warn_if_changed(path, head, title, source)
        for number, line in enumerate(lines, start=2):
            self._take(path, number, _value(path, number, line))
        return len(whole) + 1

    def _take(self, path: Path, number: int, row: dict[str, Any]) -> None:
        try:
            key = text_of(dict(row["point"])), int(row["run"])
            seconds, versions = float(row["seconds"]), dict(row["versions"])
            outcome: dict[str, Any] = {"seconds": seconds, "versions": versions}
            if "failure" in row:
                outcome |= {"failure": str(row["failure"]), "traceback": str(row["traceback"])}
            else:
                outcome["values"] = dict(row["values"])
        except (KeyError, TypeError, ValueError) as error:
            raise _unreadable(path, f"line {number} is not a row: {type(error).__name__} {error}") from None
        self.outcomes[key] = outcome

    def _append(self, line: dict[str, Any]) -> None:
        content = (json.dumps(line) + "\n").encode()
        before = os.fstat(self._descriptor).st_size
        try:
            written = 0
            while written < len(content):
                written += os.write(self._descriptor, content[written:])
        except OSError as error:
            os.ftruncate(self._descriptor, before)
            raise OutputError(
                f"the file of a sweep must have room on its disk; {self._path} cannot be written ({error.strerror}). "
                "Make room and call again: the runs that it holds are not repeated."
            ) from error


def _value(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        value = json.loads(line)
        if not isinstance(value, dict):
            raise ValueError("it is not a JSON object")
    except (ValueError, RecursionError) as error:
        raise _unreadable(path, f"line {number}: {error}") from None
    return value


def _demand_same(path: Path, head: dict[str, Any], title: dict[str, Any]) -> None:
    """Refuse the file of another sweep, by the first fact in which it differs."""
    for name, wanted in {"format": FORMAT, **title}.items():
        found = head.get(name)
        if found != json.loads(json.dumps(wanted)):
            has, asked = (f"{name} {json.dumps(each, ensure_ascii=False):.200}" for each in (found, wanted))
            raise InputError(
                f"path must be a file of the same sweep, or none yet; {path} has {has}, and this sweep {asked}. Give "
                "another path, or remove the file."
            )


def _warn_if_changed(path: Path, head: dict[str, Any], title: dict[str, Any], source: str | None) -> None:
    """Warn of rows that may be those of another function of the same name."""
    if source is not None and head.get("source") not in (None, source):
        warnings.warn(
            f"the source of {title['function']} has changed since {path} was begun: its rows come from the earlier "
            "version. Remove the file, or give another path, to run them again.",
            SweepWarning,
            stacklevel=level_of_caller(),
        )


def _unreadable(path: Path, reason: str) -> InputError:
    return InputError(
        f"path must be a file of an earlier sweep, or none yet; {path} cannot be read as one ({reason:.200}). Give "
        "another path, or remove the file."
    )


# --- The result of a sweep: a table with one row for each run

TABLE = "the table of a sweep"

VERSIONS = ("mpsim", "numpy", "numba", "python")
"""What has versions in each row."""

OWN: tuple[str, ...] = ("run", "seed", "wall_seconds", "failure", *(f"{name}_version" for name in VERSIONS))
"""Columns that every sweep has, besides those of the grid and of the results."""

Scalar = bool | int | float | str | None


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
    values: dict[str, Scalar]
    failure: str | None = None
    traceback: str = ""
    wall_seconds: float = math.nan
    versions: dict[str, str] = field(default_factory=dict[str, str])

    def record(self) -> dict[str, Scalar]:
        """The row as plain values by column name; what is not a number, text or truth value is given as its repr."""
        found: dict[str, Scalar] = {name: plain(value) for name, value in self.point.items()}
        found |= {"run": self.run, "seed": found.get("seed", self.seed), **self.values}
        found["wall_seconds"] = self.wall_seconds
        versions = {f"{name}_version": self.versions.get(name) for name in VERSIONS}
        return {**found, "failure": self.failure, **versions}


@dataclass(frozen=True, repr=False)
class Sweep:
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

    @property
    def versions(self) -> dict[str, tuple[str, ...]]:
        """Versions of mpsim, numpy, numba and python that made the rows: one of each, unless a file mixes several."""
        found = {name: {row.versions[name] for row in self.rows if name in row.versions} for name in VERSIONS}
        return {name: tuple(sorted(each)) for name, each in found.items()}

    def to_csv(self, path: str | Path | None = None) -> str:
        """The table as CSV, one line for each run; also written to `path`, if given.

        The header of a column whose unit is known is "name [unit]". Missing results of failed runs are empty.

        Raises:
            InputError: if the path has the ending of another format.
            OutputError: if the file cannot be written.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        columns = self.columns
        writer.writerow([f"{name} [{self.units[name]}]" if name in self.units else name for name in columns])
        for row in self.rows:
            record = row.record()
            writer.writerow([record.get(name) for name in columns])
        return written(text.getvalue(), path, TABLE, CSV)

    def to_json(self, path: str | Path | None = None) -> str:
        """The table as JSON: function, parameters, units, versions, and rows of plain values; also written to `path`.

        Numbers that are not finite become null.

        Raises:
            InputError: if the path has the ending of another format.
            OutputError: if the file cannot be written.
        """
        values = {"function": self.function, "parameters": self.parameters, "units": self.units}
        values |= {"versions": self.versions, "rows": [row.record() for row in self.rows]}
        return written(json_text(values) + "\n", path, TABLE, JSON)

    def to_pandas(self) -> Any:
        """The table as a pandas.DataFrame, one line for each run; its `attrs` hold units and versions.

        Raises:
            OutputError: if pandas is not installed.
        """
        pandas = imported("pandas", "a DataFrame", "sweep", "use to_csv or to_json, which need nothing")
        records = [row.record() for row in self.rows]
        frame = pandas.DataFrame({name: [record.get(name) for record in records] for name in self.columns})
        versions = {name: list(each) for name, each in self.versions.items()}
        frame.attrs = {"function": self.function, "units": dict(self.units), "versions": versions}
        return frame

    def __repr__(self) -> str:
        failed = f", {len(self.failed)} failed" if self.failed else ""
        return f"<Sweep: {len(self.rows)} runs of {self.function} over {', '.join(self.parameters)}{failed}>"


def plain(value: Any) -> Scalar:
    """A value of the grid as a table shows it."""
    found: Any = cast("Any", value).item() if isinstance(value, np.generic) else value
    return found if found is None or isinstance(found, bool | int | float | str) else repr(found)


def checked_units(units: Any, known: Mapping[str, str]) -> dict[str, str]:
    """Units by the name of a column: the known ones, and those given by the caller."""
    if units is None:
        return dict(known)
    given = cast("Mapping[Any, Any]", units)
    if not isinstance(units, Mapping) or not all(isinstance(each, str) for pair in given.items() for each in pair):
        raise InputError(
            f"units must be a dictionary of texts by the name of a column; got {checks.brief(units)}. "
            "Write {'pressure': 'mass/time^2'}."
        )
    return {**known, **given}


# --- The task of a sweep: a function or a scene, checked before anything runs


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

    def unpicklable(self, error: BaseException) -> InputError:
        """The error for a function, or values, that cannot be sent to another process."""
        return InputError(
            "function and the values of the grid must be what pickle can send to other processes; got "
            f"{self.name} ({described(error):.200}). Define the function at the top of a module, or sweep in threads."
        )


def task_of(function: Any, points: list[Point], how: dict[str, Any]) -> Task:
    """What is done at each of the points.

    Args:
        function, points: of the sweep.
        how: until, frames, measures and settings, as `sweep` was given them.

    Raises:
        InputError: if the function, its arguments, or what is in `how` break a rule.
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
        return _scene_task(function, names, points, how, title)
    if not callable(function):
        raise InputError(
            "function must be a function, an mpsim.Scene, or the name or path of one; got "
            f"{checks.brief(function)}. Give a function that returns a dictionary."
        )
    return _function_task(function, names, points, how, title)


def _scene_task(function: Any, names: tuple[str, ...], points: list[Point], how: dict[str, Any], title: Any) -> Task:
    if isinstance(function, Scene):
        scene, name = function, repr(function)[1:-1]
    else:
        found = scenefile.load(function)
        scene, name = found.scene, found.name
    for each in names:
        if each not in RUN_FIELDS:
            raise InputError(
                f"grid[{each!r}] must be one of {', '.join(RUN_FIELDS)}, where a scene is given."
                f"{_meant(each, RUN_FIELDS)} To vary the scene, give a function that makes it."
            )
    if points[0].seed is not None and not scene._can_redraw:
        scene.redrawn(points[0].seed)  # which raises
    run = _scene_run(None, names, points, how, scene)
    title = {"function": f"scene {scene.digest()}", **title, "runs": _facts(run, scene)}
    return Task(name, run, scene, title, frozenset(names))


def _function_task(function: Any, names: tuple[str, ...], points: list[Point], how: dict[str, Any], title: Any) -> Task:
    parameters = _parameters(function)
    own: tuple[str, ...] = ()
    makes_scenes = any(each is not None for each in how.values())
    if makes_scenes or any(name in RUN_OPTIONS and name not in parameters for name in names):
        own = tuple(name for name in names if name in RUN_FIELDS and name not in parameters)
    name = getattr(_inner(function), "__qualname__", type(function).__qualname__)
    _demand_arguments(name, parameters, [each for each in names if each not in own], points[0].seed is not None)
    call = _scene_run(function, own, points, how, None) if makes_scenes or own else function
    title = {"function": _identity(function), **title}
    title["runs"] = _facts(call, None) if isinstance(call, SceneRun) else None
    return Task(name, call, None, title, frozenset(names))


def _settings_for(scene: Scene | None, settings: Settings | None) -> Settings:
    """Those given, or recommended by the scene; None: it is not made yet."""
    return check_settings(settings or Settings()) if scene is None else settings_for(scene, settings)


def _scene_run(
    make: Callable[..., Any] | None, own: tuple[str, ...], points: list[Point], how: dict[str, Any], scene: Scene | None
) -> SceneRun:
    settings = _settings_for(scene, how["settings"])  # checked, also where scenes are made later
    if scene is None and how["settings"] is None:
        settings = None
    until = None if how["until"] is None else checks.non_negative("until", how["until"], "[time]")
    frames = None if how["frames"] is None else _frames(how["frames"])
    measures = None if how["measures"] is None else registry.checked(how["measures"], scene)
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
    how = {"until": until, "frames": frames, "measures": measures, "settings": settings}
    task = task_of(function, points, how)
    named = checked_units(units, UNITS if isinstance(task.call, SceneRun) else {})
    show = checked_progress(progress, "progress(done, of, what)")
    retry_failed = checks.truth("retry_failed", retry_failed)
    if isinstance(executor, ProcessPoolExecutor):
        try:
            pickle.dumps((task.call, points[0].values))
        except (pickle.PicklingError, AttributeError, TypeError, RecursionError) as error:
            raise task.unpicklable(error) from error
    with terminated_by_exit(), SweepFile(path, task.title, source_of(function)) as file, shown(show) as say:
        known_runs = file.outcomes
        missing = [p for p in points if p.key not in known_runs or (retry_failed and "failure" in known_runs[p.key])]
        done, failed, any_good = len(points) - len(missing), 0, len(missing) < len(points)

        def take(point: Point, outcome: dict[str, Any]) -> None:
            nonlocal done, failed, any_good
            if "wrong" in outcome and not any_good:
                raise InputError(outcome["failure"].partition(": ")[2])
            any_good = any_good or "values" in outcome
            file.put(point, outcome)
            done, failed = done + 1, failed + ("failure" in outcome)
            say(done, len(points), f"runs, {failed} failed" if failed else "runs")

        say(done, len(points), "runs")
        if missing:
            _run(task, missing, executor, take, file)
        rows = tuple(_row(point, known_runs[point.key]) for point in points)
    units_here = {*points[0].values, *OWN, *(name for row in rows for name in row.values)}
    known = {name: unit for name, unit in named.items() if name in units_here}
    known |= {"wall_seconds": "s"}
    known |= {f"{name}_error": unit for name, unit in known.items() if f"{name}_error" in units_here}
    return Sweep(task.name, tuple(points[0].values), rows, known)


def _run(
    task: Task,
    missing: list[Point],
    executor: Executor | None,
    take: Callable[[Point, dict[str, Any]], None],
    file: SweepFile,
) -> None:
    """Run points, in threads without an executor, and `take` each outcome; an interrupt keeps those that are done."""
    stop = threading.Event()
    threads, extra = None, ()
    if executor is None:
        executor = threads = ThreadPoolExecutor(usable_cores(), "mpsim-sweep")
        extra = (stop,)  # an event cannot be sent to another process
    submitted = Submissions(executor, ((point, task.submission(point, *extra)) for point in missing))
    lost: list[BrokenExecutor] = []
    try:
        for point, future in submitted.finished():
            take(point, _outcome(task, future, lost))
    finally:
        stop.set()
        submitted.cancel()
        try:
            if threads is not None:
                threads.shutdown(cancel_futures=True)
        finally:
            for point, future in submitted.left():
                file.put(point, future.result())
    if lost:
        warnings.warn(
            f"the executor broke, and {len(lost)} runs failed with it: {described(lost[-1]):.200} The other rows are "
            "kept. Call again with a new executor and the same path to run these.",
            SweepWarning,
            stacklevel=level_of_caller(),
        )


def _outcome(task: Task, future: Future[Any], lost: list[BrokenExecutor]) -> dict[str, Any]:
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
        lost.append(error)
    elif isinstance(error, pickle.PicklingError) or _NO_PICKLE.search(str(error)):
        raise task.unpicklable(error) from error
    return failed_elsewhere(error)


def _row(point: Point, outcome: dict[str, Any]) -> SweepRow:
    values, failure, text = outcome.get("values", {}), outcome.get("failure"), outcome.get("traceback", "")
    return SweepRow(point.values, point.run, point.seed, values, failure, text, outcome["seconds"], outcome["versions"])
