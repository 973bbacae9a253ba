"""The task of a sweep: a function or a scene, checked before anything runs."""

import dataclasses
import functools
import hashlib
import inspect
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpsim.core import checks
from mpsim.engine.frame_count import MOST_FRAMES_OF_A_RUN
from mpsim.errors import InputError, MpsimError
from mpsim.measure import run_averages
from mpsim.scene.recommended import Recommends, settings_for
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.sweep_points import Point, canonical
from mpsim.studies.sweep_runs import RUN_FIELDS, RUN_OPTIONS, SceneRun, described, failed_elsewhere, run_point
from mpsim.studies.sweep_table import OWN


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
    measures = None if options.measures is None else run_averages.checked(options.measures, scene)
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
    named = inner if hasattr(inner, "__qualname__") else type(inner)
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
    try:
        text = inspect.getsource(inner if hasattr(inner, "__qualname__") else type(inner))
    except (OSError, TypeError):
        return None
    return hashlib.blake2b(text.encode("utf-8", "replace"), digest_size=8).hexdigest()
