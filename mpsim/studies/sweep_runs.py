"""One run of a sweep, wherever the executor runs it.

Whatever goes wrong in a run becomes part of its outcome. An outcome holds only plain values, so it can always be sent
back, and a failed run does not end the others.
"""

import dataclasses
import functools
import math
import numbers
import platform
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from mpsim.core import checks
from mpsim.core.version import __version__
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError
from mpsim.measure import run_averages
from mpsim.measure.statistics import Measure
from mpsim.scene.recommended import Recommends, settings_for
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.replicas import Stopped
from mpsim.studies.sweep_table import OWN, Scalar

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
        names = run_averages.checked(MEASURES, None) if self.measures is None else self.measures
        if self.measures is None:
            names = tuple(name for name in names if run_averages.refusal(name, scene) is None)

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
        settings = dataclasses.replace(settings_for(scene or Recommends(), self.settings), **changes)
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
    for name, value in result.items():
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
