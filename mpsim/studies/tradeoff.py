"""The trade-off between speed and accuracy: cost and errors of many settings on a scene, as a table."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mpsim.core import checks
from mpsim.core.late import imported, view
from mpsim.core.text import json_text
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError, MpsimError
from mpsim.measure.registry import ERRORS
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.deviations import Deviation
from mpsim.studies.ensemble import CandidateFailed, Cost, Ensemble, available, demand_available, ensemble
from mpsim.studies.preliminary import StartsGiven, quietly

# --- The settings that a trade-off study compares by default

STEP_FRACTIONS = (0.2, 0.1, 0.05, 0.02, 0.01)
"""Steps of the default candidates, in units of the time in which a disc at typical speed moves one diameter."""


def step(scene: Scene, speed: float, h: float) -> float:
    """dt for h = dt x speed / smallest diameter, rounded to two digits [time]."""
    return float(f"{h * 2 * scene.smallest_radius / speed:.2g}")


def families(dt: float = 0.01) -> list[Settings]:
    """Families of stepped settings that are useful at any step: one of each contact, and a second pass."""
    fine = Settings(dt=dt)
    return [fine, replace(fine, passes=2), replace(fine, contact="push")]


def default_candidates(scene: Scene, speed: float, contact_time: float | None = None) -> list[Settings]:
    """The exact solver, each family over STEP_FRACTIONS, and rows for law, precision, substeps and method.

    speed: root mean square of one velocity component [length/time].
    """
    steps = [step(scene, speed, h) for h in STEP_FRACTIONS]
    candidates = [Settings(method="event", contact_time=contact_time)]
    candidates += [replace(family, dt=dt) for family in families() for dt in steps]
    middle = Settings(dt=steps[2])
    candidates += [
        replace(middle, precision="float32"),
        replace(middle, precision="float32", dt=steps[-1]),
        replace(middle, law="reflect", contact="push"),
        replace(middle, dt=2 * middle.dt, substeps=2),
    ]
    further = ("naive", "grid", "parallel") if scene.count <= NAIVE_UP_TO else ("grid", "parallel")
    return [*candidates, *(replace(middle, method=each) for each in further)]


NAIVE_UP_TO = 3000
"""Number of discs above which testing all pairs is left out: it would take longer than all other rows together."""


# --- The trade-off between speed and accuracy: cost and errors of many settings on a scene, as a table

MOST_REPLICAS = 100_000  # largest number of runs per candidate

SETTINGS = ("method", "contact", "law", "passes", "substeps", "dt", "precision", "workers")
"""Settings that are columns of the table."""


@dataclass(frozen=True)
class Row:
    """One candidate.

    Attributes:
        settings: of the candidate.
        cost: its cost; None if it failed.
        errors: measure -> its error against the reference.
        failure: why it could not be run to the end; None if it could.
        verdict: of `tune`: "inside all budgets", or the budget that it exceeds and by how much.
        inside: whether all budgets are met, standard errors included.
        warning: what mpsim warns of with these settings, if they are inside; or "".
    """

    settings: Settings
    cost: Cost | None = None
    errors: dict[str, Deviation] = field(default_factory=dict[str, Deviation])
    failure: str | None = None
    verdict: str = ""
    inside: bool = False
    warning: str = ""

    @property
    def label(self) -> str:
        """Short name of the settings, such as "grid impact x2 dt=0.05"."""
        return label(self.settings)

    def record(self) -> dict[str, Any]:
        """The row as plain values by column name."""
        values: dict[str, Any] = {name: getattr(self.settings, name) for name in SETTINGS}
        cost = dataclasses.asdict(self.cost) if self.cost else {}
        values |= {"cost": cost.get("median"), "cost_low": cost.get("low"), "cost_high": cost.get("high")}
        values["contact_time"] = (cost.get("contact_time") if cost else self.settings.contact_time) or None
        values["memory"] = cost.get("memory")
        values["ran"] = f"{cost['method']} x{cost['workers']}" if cost else None
        for name, deviation in self.errors.items():
            values[name], values[f"{name}_error"] = deviation.value, deviation.error
            values[f"{name}_resolved"], values[f"{name}_reason"] = deviation.resolved, deviation.reason
        values["failure"] = self.failure
        return values


@dataclass(frozen=True, repr=False)
class Tradeoff:
    """Costs and errors of candidates on one scene.

    Attributes:
        scene: in words.
        reference: of the errors, in words.
        until: length of a long run [time].
        short: length of a short run [time].
        measures: names of the errors.
        rows: one per candidate, in the order given.
        starts: of the runs, in words.
        contact_time: that was given for the reference, which makes it a model, not exact [time]; None if none was
            given.
    """

    scene: str
    reference: str
    until: float
    short: float
    measures: tuple[str, ...]
    rows: tuple[Row, ...]
    starts: str = ""
    contact_time: float | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of the table."""
        parts = ("", "_error", "_resolved", "_reason")
        errors = [name + part for name in self.measures for part in parts]
        return (*SETTINGS, "contact_time", "cost", "cost_low", "cost_high", "memory", "ran", *errors, "failure")

    def frontier(self, measure: str) -> list[Row]:
        """The Pareto front: rows for which no other is both cheaper and more accurate, cheapest first.

        An error that is not resolved counts with its upper bound. Of two errors that are not resolved, one is better
        only if its noise is smaller too; otherwise chance would decide.

        Raises:
            InputError: if the table has no such measure.
        """
        checks.choice("measure", measure, self.measures)
        fit = [row for row in self.rows if row.cost is not None and measure in row.errors]
        fit.sort(key=lambda row: (row.cost.median if row.cost else math.inf, row.errors[measure].magnitude))
        front: list[Row] = []
        for row in fit:
            error = row.errors[measure]
            smaller = not front or error.magnitude < front[-1].errors[measure].noise_floor
            if math.isfinite(error.magnitude) and smaller:
                front.append(row)
        return front

    def to_csv(self) -> str:
        """The table as CSV, one line for each candidate. Values that a row does not have are empty."""
        text = io.StringIO()
        writer = csv.DictWriter(text, self.columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(row.record() for row in self.rows)
        return text.getvalue()

    def to_json(self) -> str:
        """The attributes of the table as JSON, its rows as plain values; numbers that are not finite become null."""
        return json_text({**vars(self), "rows": [row.record() for row in self.rows]}) + "\n"

    def to_pandas(self) -> Any:
        """The table as a pandas.DataFrame, one line for each candidate; its `attrs` hold the other attributes.

        Raises:
            OutputError: if pandas is not installed.
        """
        pandas = imported("pandas", "a DataFrame", "sweep", "use to_csv or to_json, which need nothing")
        frame = pandas.DataFrame([row.record() for row in self.rows], columns=list(self.columns))
        frame.attrs = {name: value for name, value in json.loads(self.to_json()).items() if name != "rows"}
        return frame

    def __repr__(self) -> str:
        return view("trade_text", self)


def label(settings: Settings) -> str:
    """Short name of settings, without default values, and for a method without steps only those that matter for it."""
    if not capabilities_of(settings).has_steps:
        model = "" if settings.contact_time is None else f" contact_time={settings.contact_time:g}"
        return settings.method + model
    words = [settings.method, settings.contact]
    words += [f"x{settings.passes}"] if settings.passes > 1 else []
    words += [settings.law] if settings.law != "elastic" else []
    words += [f"/{settings.substeps}"] if settings.substeps > 1 else []
    words += [settings.precision] if settings.precision != "float64" else []
    words += [f"{settings.workers} workers"] if settings.workers else []
    return " ".join([*words, f"dt={settings.dt:.3g}"])


def tradeoff(
    scene: Scene,
    candidates: Iterable[Settings] | None = None,
    until: float | None = None,
    measures: Iterable[str] | None = None,
    *,
    starts: StartsGiven = None,
    executor: Executor | None = None,
    replicas: int = 16,
    seconds: float = 150.0,
    contact_time: float | None = None,
    path: str | Path | None = None,
    progress: bool | Callable[[int, int, str], None] | None = None,
) -> Tradeoff:
    """Cost and errors of each candidate on a scene.

    Errors are those of averages over `replicas` runs of length `until` from independent starts, compared with twice as
    many runs of the exact solver. If that cannot run the scene, or is too slow (as where discs that lose energy come to
    rest), the finest affordable stepped run is the reference, and the table says so. With a `contact_time`, the
    reference is the exact solver with that contact time, a model in which discs at rest do not collide without end. A
    reference that is not exact has as many runs as each candidate. Its own uncertainty, found by doubling its step or
    contact time, is part of each error. A thermostat acts once a frame: with one, the exact solver runs in frames of a
    twentieth of the time in which a disc moves its diameter, and `dt` of a candidate with method `event` matters. A
    difference below three standard errors (more for few replicas) is "not resolved". On a scene that changes with time,
    the errors of pressure, collision_rate, overlap and speed_distribution are means over windows along its duration,
    given with the largest error of a window; energy_drift, momentum_drift and largest_overlap are always taken from
    whole runs, trajectory and missed_collisions from short ones. An error that is meaningless on the scene is "not
    measurable", with the reason.

    pressure, collision_rate
        relative difference of the averages [1]
    energy_drift
        difference of the relative change of energy per time [1/time]
    momentum_drift
        momentum not due to walls or gravity, per time, over the sum of all |v| [1/time]
    overlap, largest_overlap
        mean and largest depth of overlaps [diameters]
    speed_distribution
        largest difference of the cumulative distributions of speeds [1]
    trajectory
        distance of the discs from the exact solver's positions after a short time, rms [diameters]; from states along
        one run of the scene, whatever `starts` is
    missed_collisions
        fraction of the exact solver's collisions that did not happen in that time; < 0: too many [1]; from the same
        states

    Cost is measured after all accuracy runs, one candidate at a time.

    Args:
        scene: the scene.
        candidates: settings to compare; None: a selection of contacts, steps, passes, laws, precisions and methods.
        until: length of one run [time], > 0; None: the scene's duration; without one, long enough to determine the
            pressure to about a thousandth.
        measures: names of errors; None: all that the scene can have.
        starts: "kind": other starts of the same kind (see `Scene.redrawn`), so that errors hold for the kind; "same":
            this start, each disc displaced by up to a thousandth of a diameter; a function from a number to a Scene;
            None: "kind" where the scene was drawn at random, else "same".
        executor: any concurrent.futures.Executor for the accuracy runs, which are independent; None: threads, one per
            core. The costs are always measured in this process.
        replicas: runs per candidate, >= 2.
        seconds: approximate time that runs of the reference may take, which determines the step of a stepped one [s].
        contact_time: of the exact solver, as the reference and among the default candidates [time], > 0 (see
            `Settings`); None: the solver's own, far below any time between collisions.
        path: file to which each run is written as soon as it is done; an interrupted call continues from it.
        progress: True: shown on standard error; or a function, called as progress(done, of, what).

    Raises:
        InputError: naming the argument and its rule; if a candidate cannot run this scene; if the exact solver cannot
            run it with this contact time, or not in the time it may take.

    >>> scene = Scene.random(count=30, packing=0.2, radius=0.5, seed=1)
    >>> pair = [Settings(dt=dt, method="naive") for dt in (0.2, 0.02)]
    >>> table = tradeoff(scene, pair, until=20.0, measures=["overlap", "missed_collisions"], replicas=2)
    >>> coarse, fine = table.rows
    >>> coarse.cost.median < fine.cost.median, coarse.errors["overlap"].value > fine.errors["overlap"].value
    (True, True)
    """
    names = _measures(measures, scene)
    how: dict[str, Any] = {"executor": executor, "starts": starts, "contact_time": contact_time, "seconds": seconds}
    how |= {"most": MOST_REPLICAS, "replicas": replicas, "path": path, "progress": progress}
    with ensemble(scene, until, names, **how) as run:
        if candidates is None:
            speed = run.preliminary.thermal_velocity
            settings = [run.framed(each) for each in default_candidates(scene, speed, contact_time)]
        else:
            settings = checked_candidates(candidates, scene)
        run.assess(settings)
        run.time(settings)
    rows = tuple(row_of(run, each) for each in settings)
    return Tradeoff(
        scene=repr(scene),
        reference=run.preliminary.reference_name,
        until=run.until,
        short=run.preliminary.short,
        measures=names,
        rows=rows,
        starts=run.starts.name,
        contact_time=run.preliminary.contact_time,
    )


def row_of(run: Ensemble, settings: Settings) -> Row:
    """The row of one candidate of an ensemble."""
    try:
        return Row(settings, errors=run.errors(settings), cost=run.cost(settings))
    except CandidateFailed as failed:
        return Row(settings, failure=str(failed))


def _measures(measures: Iterable[str] | None, scene: Scene) -> tuple[str, ...]:
    if measures is None:
        return available(scene)
    names = list(measures) if isinstance(measures, Iterable) and not isinstance(measures, str) else [measures]
    if not names:
        raise InputError(f"measures must name at least one error; got none. Choose from {', '.join(ERRORS)}.")
    chosen = tuple(dict.fromkeys(checks.choice("measures", name, ERRORS) for name in names))
    demand_available(chosen, scene)
    return chosen


def checked_candidates(candidates: Iterable[Settings], scene: Scene | None = None) -> list[Settings]:
    """The candidates as a list; scene: that each must be able to run."""
    chosen: list[Any] = list(candidates) if isinstance(candidates, Iterable) else [candidates]
    if not chosen:
        raise InputError("candidates must hold at least one Settings; got none. Leave it out for the default ones.")
    for index, candidate in enumerate(chosen):
        if not isinstance(candidate, Settings):
            raise InputError(f"candidates[{index}] must be an mpsim.Settings; got {type(candidate).__name__}.")
        if scene is None:
            continue
        try:
            with quietly():
                Simulation(scene, replace(candidate, workers=1)).close()
        except MpsimError as error:
            raise InputError(f"candidates[{index}] ({label(candidate)}) cannot run this scene: {error}") from error
    return chosen
