"""Trials of the stability map: outcomes of every method, contact, law and precision on extreme scenes.

correct   all errors are within TOLERANCE, with or without a warning
degraded  an error is larger, and a warning was raised before or during the run
refused   an exception of mpsim names the limit and the remedy
Forbidden: not finite, a disc lost or outside the box, a hang, a crash, and degraded without a warning ("silent").
"""

import json
import math
import multiprocessing
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from itertools import product
from multiprocessing.connection import wait
from typing import Any

import numpy as np

from mpsim.core import checks
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.event_scene import contact_time_at_rest
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import MpsimError
from mpsim.measure.observables import overlap
from mpsim.measure.pairs import lengths_of, to_nearest_image
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.extremes import AXES, PACKINGS, STEP_FRACTIONS, Case, step_and_packing

KINDS = ("correct", "degraded", "refused")
FORBIDDEN = ("not finite", "lost", "hang", "crash", "silent")

TOLERANCE = {
    "energy float64": 1e-9,
    "energy float32": 1e-3,
    "energy gained": 0.02,
    "momentum float64": 1e-9,
    "momentum float32": 1e-3,
    "collisions": 0.2,
    "trajectory": 0.2,
    "overlap": 0.2,
}
"""Largest errors of a correct run: energy and momentum relative; energy gained, where it may only fall, relative to the
largest; collisions relative to the exact solver's, in addition to noise; distance from the exact solver's positions,
and deepest overlap at the end, in diameters."""

FEW_COLLISIONS = 0.25
"""Collisions per disc up to which positions are compared with the exact solver's: most discs have not collided then,
and the median disc must be where the exact solver has it. With more collisions their number is compared, as a long free
path amplifies errors of direction."""

HANG_SECONDS = 180.0
"""Seconds after which a trial counts as a hang: far more than the slowest takes, compilation included."""

MAP = "map"
"""Name of the axis pair of steps and packings."""


@dataclass(frozen=True)
class Row:
    """A combination of method, contact, law, precision and on_fast."""

    method: str
    contact: str = "impact"
    law: str = "elastic"
    precision: str = "float64"
    on_fast: str = "warn"

    @property
    def label(self) -> str:
        """The row in words."""
        if not capabilities_of(self.settings(1.0)).has_steps:  # nothing else of the row changes what it does
            return self.method
        words = [self.method, self.contact, self.law, self.precision]
        return " ".join(words + (["substep"] if self.on_fast == "substep" else []))

    def settings(self, dt: float) -> Settings:
        """Settings for a step."""
        return Settings(dt=dt, workers=2 if self.method == "parallel" else None, **asdict(self))


ROWS = (
    *(
        Row(method, contact, law, precision)
        for method, contact, law, precision in product(
            ("naive", "grid"), ("impact", "push"), ("elastic", "reflect"), ("float64", "float32")
        )
    ),
    Row("parallel"),
    Row("parallel", "push", "reflect", "float32"),
    Row("grid", on_fast="substep"),
    Row("event"),
)

MAP_ROWS = (Row("grid"), Row("grid", "push"), Row("grid", on_fast="substep"), Row("event"))
"""Rows of the map of steps and packings."""


@dataclass(frozen=True)
class Trial:
    """One run: axis, value and row. For MAP the value is (displacement in a step, packing)."""

    axis: str
    value: Any
    row: Row

    def case(self) -> Case:
        """The case to run."""
        return step_and_packing(*self.value) if self.axis == MAP else AXES[self.axis].case(self.value)


@dataclass
class Outcome:
    """The outcome of a trial.

    Attributes:
        axis, value, row: of the trial.
        kind: one of KINDS or of FORBIDDEN.
        errors: errors that could be determined, by name.
        worst: name of the error that is largest relative to its tolerance; "" without errors.
        told: names of the warnings raised.
        text: of the refusal or failure.
    """

    axis: str
    value: Any
    row: str
    kind: str = "correct"
    errors: dict[str, float] = field(default_factory=dict)
    worst: str = ""
    told: tuple[str, ...] = ()
    text: str = ""


def trials(axes: Iterable[str] | None = None, full: bool = False) -> list[Trial]:
    """All trials along some axes (None: all axes, and the map of steps and packings)."""
    names = [*AXES, MAP] if axes is None else list(axes)
    for name in names:
        checks.choice("axes", name, [*AXES, MAP])
    found = []
    for name in names:
        if name == MAP:
            found += [Trial(MAP, pair, row) for row in MAP_ROWS for pair in product(STEP_FRACTIONS, PACKINGS)]
            continue
        axis = AXES[name]
        values = sorted(axis.values + axis.full) if full and axis.full else axis.values
        found += [Trial(name, value, row) for value in values for row in ROWS if _sensible(name, value, row)]
    return found


def _sensible(axis: str, value: Any, row: Row) -> bool:
    """Whether a trial is feasible: not all pairs of a million discs."""
    return not (axis == "count" and value > 5000 and row.method == "naive")


def attempt(trial: Trial) -> Outcome:
    """Run one trial and judge it."""
    outcome = Outcome(trial.axis, trial.value, trial.row.label)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            case = trial.case()
            scene = case.scene()
            counted = case.compares and trial.row.law == "elastic"
            start, end, collisions = _run(scene, _settings(trial.row, case, scene), case.frames, counted)
        except MpsimError as error:
            outcome.kind, outcome.text = "refused", f"{type(error).__name__}: {error}"
            return outcome
        except Exception as error:
            outcome.kind, outcome.text = "crash", f"{type(error).__name__}: {error}"
            return outcome
    outcome.told = tuple(sorted({each.category.__name__ for each in caught}))
    wrong = _violation(scene, end, trial.row.precision)
    if wrong:
        outcome.kind, outcome.text = wrong
        return outcome
    outcome.errors = _errors(trial, case, scene, start, end, collisions)
    _judge(outcome)
    return outcome


def _settings(row: Row, case: Case, scene: Scene) -> Settings:
    """Of the row; for the exact solver with a contact time where discs come to rest."""
    settings = row.settings(case.dt)
    if not (case.rests and capabilities_of(settings).is_exact):
        return settings
    return replace(settings, contact_time=contact_time_at_rest(scene, case.dt))


def _run(scene: Scene, settings: Settings, frames: int, counted: bool = True) -> tuple[State, State, int]:
    """States before and after, and, if counted, the number of collisions in which velocities changed."""
    with Simulation(scene, settings) as sim:
        start = sim.state
        if not counted:
            sim.run(frames=frames)
            return start, sim.state, 0
        rate = sim.run(frames=frames, measures=["collision_rate"]).measures["collision_rate"].value
        return start, sim.state, round(rate * frames * settings.dt * scene.count / 2) if math.isfinite(rate) else 0


def _violation(scene: Scene, state: State, precision: str) -> tuple[str, str] | None:
    """A forbidden state, as (kind, text), or None."""
    for name, values in (("position", state.position), ("velocity", state.velocity)):
        if len(values) != scene.count:
            return "lost", f"{len(values)} of {scene.count} discs are left"
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            return "not finite", f"{name}{bad[0].tolist()} is {values[tuple(bad[0])]}"
    low, high = scene.limits(scene.radii)
    slack = 4 * float(np.finfo(precision).eps) * max(scene.width, scene.height)
    outside = ((state.position < low - slack) | (state.position > high + slack)).any(axis=1)
    if outside.any():
        return (
            "lost",
            f"disc {int(outside.argmax())} is outside the box, at {state.position[outside.argmax()].tolist()}",
        )
    return None


def _errors(trial: Trial, case: Case, scene: Scene, start: State, end: State, collisions: int) -> dict[str, float]:
    row = trial.row
    masses = scene.masses / scene.masses.max(initial=np.finfo(float).tiny)
    errors = {}
    if not scene.count:
        return errors
    errors |= _conserved(case, scene, start, end, masses, row)
    depth = overlap(end, scene).largest if scene.count < 10_000 else 0.0
    errors["overlap"] = depth / (2 * scene.smallest_radius)
    if not case.compares or row.law != "elastic" or capabilities_of(row.settings(case.dt)).is_exact:
        return errors
    exact = _exact(trial.axis, trial.value)
    if exact is None:
        return errors
    state, met = exact
    if met <= FEW_COLLISIONS * scene.count:
        errors["trajectory"] = _median_distance(end, state, scene) / (2 * scene.smallest_radius)
    else:
        errors["collisions"] = max(abs(collisions / met - 1) - 3 / math.sqrt(met), 0.0)
    return errors


def _conserved(case: Case, scene: Scene, start: State, end: State, masses: Any, row: Row) -> dict[str, float]:
    """Relative changes of energy and momentum that should be conserved."""
    errors = {}
    unit = float(np.abs(start.velocity.astype(float)).max()) or 1.0  # squares must neither vanish nor overflow
    before, after = (_energy(state, scene, masses, unit) for state in (start, end))
    scale = max(abs(before), abs(after)) or 1.0
    if case.conserves and row.law == "elastic":
        errors[f"energy {row.precision}"] = abs(after - before) / (abs(before) or 1.0)
    else:
        errors["energy gained"] = max(after - before, 0.0) / scale
    if all(scene.periodic) and row.law == "elastic" and scene.gravity is None:
        sums = [(masses[:, None] * state.velocity / unit).sum(axis=0) for state in (start, end)]
        whole = float((masses * np.hypot(*start.velocity.astype(float).T) / unit).sum())
        errors[f"momentum {row.precision}"] = float(np.hypot(*(sums[1] - sums[0]))) / (whole or 1.0)
    return errors


def _median_distance(one: State, other: State, scene: Scene) -> float:
    """Median distance of the discs between two states, to nearest images along periodic axes [length]."""
    apart = to_nearest_image(np.subtract(one.position, other.position, dtype=np.float64), lengths_of(scene))
    return float(np.median(np.hypot(*apart.T)))


def _energy(state: State, scene: Scene, masses: Any, unit: float) -> float:
    """Kinetic energy and potential energy, which is 0 in the corner to which gravity points; velocities in `unit`."""
    velocity = state.velocity.astype(float) / unit
    energy = 0.5 * float((masses * (velocity**2).sum(axis=1)).sum())
    if scene.gravity is not None:
        low, high = scene.limits(scene.radii)
        foot = np.where(scene.gravity > 0, high, low)
        energy += float((masses[:, None] * (foot - state.position) * scene.gravity / unit / unit).sum())
    return energy


@lru_cache(maxsize=4)
def _exact(axis: str, value: Any) -> tuple[State, int] | None:
    """Final state and collisions of the exact solver; None if it refuses the scene."""
    case = Trial(axis, value, Row("event")).case()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _run(case.scene(), Settings(dt=case.dt * case.frames, method="event"), 1)[1:]
    except MpsimError:
        return None


def _judge(outcome: Outcome) -> None:
    excess = {name: value / TOLERANCE[name] for name, value in outcome.errors.items()}
    if any(math.isnan(value) for value in excess.values()):
        outcome.kind, outcome.text = "crash", f"an error is not a number: {outcome.errors}"
    elif excess:
        outcome.worst = max(excess, key=lambda name: excess[name])
        if excess[outcome.worst] > 1:
            outcome.kind = "degraded" if outcome.told else "silent"


# --- many trials, in processes of their own: a hang or crash must not affect the others

Progress = Callable[[int, int, str], None] | None


def run_trials(chosen: Sequence[Trial], workers: int = 2, progress: Progress = None) -> list[Outcome]:
    """Outcomes of trials, in their order.

    Args:
        chosen: see `trials`.
        workers: processes.
        progress: called as progress(done, of, what).
    """
    context = multiprocessing.get_context("spawn")
    waiting, found = list(enumerate(chosen))[::-1], {}
    processes: list[_TrialProcess] = []
    try:
        while waiting or any(each.busy for each in processes):
            while len(processes) < workers:
                processes.append(_TrialProcess(context))
            for each in processes:
                if not each.busy and waiting:
                    each.give(*waiting.pop())
            wait([each.pipe for each in processes if each.busy], timeout=1.0)
            for each in list(processes):
                if each.busy and (outcome := each.result()) is not None:
                    found[each.number] = outcome
                    each.busy = False
                    if outcome.kind in ("hang", "crash"):
                        each.end()
                        processes.remove(each)
                    if progress is not None:
                        progress(len(found), len(chosen), f"{outcome.axis} {outcome.value}")
    finally:
        for each in processes:
            each.end()
    return [found[number] for number in range(len(chosen))]


class _TrialProcess:
    """A process that runs one trial after the other."""

    def __init__(self, context: Any):
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_attempt_each, args=(theirs,))
        self.process.start()
        theirs.close()
        self.busy, self.number = False, -1

    def give(self, number: int, trial: Trial) -> None:
        self.number, self.trial, self.busy = number, trial, True
        self._end = time.monotonic() + HANG_SECONDS
        self.pipe.send(trial)

    def result(self) -> Outcome | None:
        """The outcome, if the trial has ended, crashed or hung; else None."""
        failed = Outcome(self.trial.axis, self.trial.value, self.trial.row.label)
        try:
            if self.pipe.poll():
                return self.pipe.recv()
        except (EOFError, ConnectionError):
            self.process.join(5)
            failed.kind, failed.text = "crash", f"its process ended with exit code {self.process.exitcode}"
            return failed
        if time.monotonic() > self._end:
            failed.kind, failed.text = "hang", "no end in sight"
            return failed
        return None

    def end(self) -> None:
        self.pipe.close()
        self.process.join(0.5)
        if self.process.is_alive():
            self.process.kill()
        self.process.join()


def _attempt_each(pipe: Any) -> None:
    """The main function of such a process."""
    try:
        while True:
            pipe.send(attempt(pipe.recv()))
    except (EOFError, ConnectionError, KeyboardInterrupt):
        return


def counts(outcomes: Iterable[Outcome]) -> dict[str, int]:
    """Number of outcomes of each kind, forbidden ones included."""
    found = Counter(outcome.kind for outcome in outcomes)
    return {kind: found[kind] for kind in (*KINDS, *FORBIDDEN)}


def to_json(outcomes: Iterable[Outcome], **more: Any) -> str:
    """All outcomes as JSON."""
    listed = [asdict(outcome) for outcome in outcomes]
    return json.dumps({**more, "counts": counts(outcomes), "outcomes": listed}, indent=1)


def from_json(text: str) -> list[Outcome]:
    """The outcomes in a text of `to_json`; values along an axis come back as they were, pairs as lists."""
    return [Outcome(**{**each, "told": tuple(each["told"])}) for each in json.loads(text)["outcomes"]]


def counts_table(outcomes: Sequence[Outcome]) -> str:
    """Counts of outcomes by axis, in Markdown."""
    lines = [
        "| axis | trials | " + " | ".join((*KINDS, *FORBIDDEN)) + " |",
        "|---" * (2 + len(KINDS) + len(FORBIDDEN)) + "|",
    ]
    names = list(dict.fromkeys(outcome.axis for outcome in outcomes))
    for name in [*names, "all"]:
        chosen = [outcome for outcome in outcomes if name in ("all", outcome.axis)]
        found = counts(chosen)
        title = {MAP: "steps and packings", "all": "**all**"}.get(name) or AXES[name].title
        lines.append(f"| {title} | {len(chosen)} | " + " | ".join(str(found[kind]) for kind in found) + " |")
    return "\n".join(lines)


def findings_table(outcomes: Sequence[Outcome]) -> str:
    """Outcomes that are not correct, one line for each value of an axis and kind, in Markdown."""
    groups: dict[tuple[str, str, str], list[Outcome]] = {}
    for outcome in outcomes:
        if outcome.kind != "correct" and outcome.axis != MAP:
            groups.setdefault((outcome.axis, str(outcome.value), outcome.kind), []).append(outcome)
    lines = ["| axis | value | outcome | rows | largest error, or the message |", "|---|---|---|---|---|"]
    for (axis, value, kind), group in groups.items():
        warned = ", ".join(sorted({name for outcome in group for name in outcome.told}))
        worst = max(group, key=lambda outcome: outcome.errors.get(outcome.worst, 0.0))
        text = f"{worst.worst} {worst.errors.get(worst.worst, 0.0):.2g} ({worst.row}); warned: {warned}"
        if worst.text:
            text = worst.text if len(worst.text) < 160 else f"{worst.text[:157]}..."
        lines.append(f"| {axis} | {value} | {kind} | {len(group)} | {text} |")
    return "\n".join(lines)
