"""The stability map: every method, contact, law and precision on extreme scenes, and how each trial ends.

python scripts/run_stability.py                    all axes, under three minutes on two cores once kernels are compiled
python scripts/run_stability.py --only step map    some of them
python scripts/run_stability.py --full             also millions of discs and a million frames: a quarter of an hour
python scripts/run_stability.py --docs docs/stability.md    and renew that page and its outcomes.json.gz

Everything is written under results/stability/. Exit code 1 if anything forbidden was found.
"""

import gzip
import json
import math
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from queue import Queue
from typing import Any, NamedTuple

import numpy as np
from harness import (
    Apart,
    console,
    exit_code,
    fill_page,
    machine,
    made_by,
    make_folder,
    parser_of,
    progress_bar,
    say,
    table,
)

from mpsim import MpsimError, Scene, Settings, Simulation, State
from mpsim.engine.solvers.event_block import contact_time_at_rest
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.measure.observables import overlap

# --- Extreme scenes, on which the stability map tries every method, contact, law and precision

RADIUS = 0.5
SEED = 5


@dataclass(frozen=True)
class Case:
    """One scene to run, and what is known about it.

    Attributes:
        scene: makes the scene when called, as that may be what is refused.
        dt: of a frame [time].
        frames: number of frames.
        conserves: whether `elastic` conserves the energy; otherwise it may only fall.
        compares: whether collisions and positions are compared with the exact solver's: only in scenes without special
            features, for each of which counting kernels would have to be compiled.
        rests: whether discs come to rest, so that the exact solver is given a contact time.
    """

    scene: Callable[[], Scene]
    dt: float = 0.05 * RADIUS
    frames: int = 400
    conserves: bool = True
    compares: bool = True
    rests: bool = False


@dataclass(frozen=True)
class Axis:
    """One direction in which scenes become extreme.

    Attributes:
        title: what is varied, with its unit.
        values: along it; those of `full` take long and are tried only on request.
        case: makes the case of a value.
    """

    title: str
    values: tuple[Any, ...]
    case: Callable[[Any], Case]
    full: tuple[Any, ...] = ()


def gas(count: int = 100, packing: float = 0.3, speed: float = 1.0, scale: float = 1.0, **more: Any) -> Scene:
    """Discs of radius scale / 2 at random, with a root mean square speed."""
    kind: Any = {"radius": RADIUS * scale, "temperature": speed * speed / 2, "seed": SEED}
    return Scene.random(count=count, packing=packing, **kind, **more)


def step_for(fraction: float, speed: float = 1.0, radius: float = RADIUS) -> float:
    """dt in which a disc of the mean speed moves a fraction of its radius [time]."""
    return fraction * radius / speed


def crystal(packing: float) -> Scene:
    """A hexagonal lattice of 14 x 16 discs, periodic, at any packing up to the densest."""
    columns, rows = 14, 16
    pitch = math.sqrt(math.pi * RADIUS**2 / packing / (math.sqrt(3) / 2))
    row, column = np.divmod(np.arange(columns * rows), columns)
    rise = pitch * math.sqrt(3) / 2
    position = np.stack([(column + 0.5 * (row % 2) + 0.25) * pitch, (row + 0.5) * rise], axis=1)
    size: Any = {"width": columns * pitch, "height": rows * rise}
    return Scene(position=position, velocity=_thermal(len(row)), radius=RADIUS, boundary="periodic", **size)


def random_overlapping(packing: float) -> Scene:
    """150 discs at random positions, overlapping ones included."""
    count = 150
    side = math.sqrt(count * math.pi * RADIUS**2 / packing)
    places = RADIUS + np.random.default_rng(SEED).random((count, 2)) * (side - 2 * RADIUS)
    return Scene(width=side, height=side, position=places, velocity=_thermal(count), radius=RADIUS)


def _thermal(count: int) -> Any:
    velocity = np.random.default_rng(SEED).normal(size=(count, 2)) / math.sqrt(2)
    return velocity - velocity.mean(axis=0)


def _frames(time: float, dt: float, most: int = 2000) -> int:
    """Number of frames in a time, from 10 to `most`."""
    return int(min(max(time / dt, 10), most))


def _packing(packing: float) -> Case:
    if packing > HEXAGONAL:
        return Case(partial(random_overlapping, packing), step_for(0.05), 200, compares=False)
    scene = partial(crystal, packing) if packing > 0.7 else partial(gas, packing=packing, boundary="periodic")
    return Case(scene, step_for(0.02), 400 if packing > 0.7 else 2000)


HEXAGONAL = math.pi / (2 * math.sqrt(3))


def _step_and_packing(pair: tuple[float, float]) -> Case:
    """The case of a step, as a fraction of a radius, and a packing."""
    fraction, packing = pair
    case = _packing(packing)
    dt = step_for(fraction)
    return Case(case.scene, dt, _frames(4.0 if packing > 0.7 else 20.0, dt, 1000))


def _count(count: int) -> Case:
    if count > 5000:
        return Case(partial(gas, count), step_for(0.1), 10, compares=False)
    return Case(partial(gas, count), frames=200)


def _far(ratio: float) -> Case:
    """A small gas in the far corner of a box `ratio` radii wide, where coordinates have the lowest resolution."""

    def scene() -> Scene:
        near, side = gas(30), ratio * RADIUS
        position = side - near.width + near.position
        return Scene(width=side, height=side, position=position, velocity=near.velocity, radius=RADIUS)

    return Case(scene, frames=60)


def _aspect(aspect: float) -> Case:
    height = 4.0
    count = int(min(aspect * height * height * 0.3 / (math.pi * RADIUS**2), 300))
    box: Any = {"count": count, "width": height * aspect, "height": height, "radius": RADIUS}
    return Case(partial(Scene.random, temperature=0.5, seed=SEED, **box))


def _radii(ratio: float) -> Case:
    def scene() -> Scene:
        radius = np.full(60, RADIUS / ratio)
        radius[:4] = RADIUS
        side = max(6 * RADIUS, math.sqrt(math.pi * float((radius**2).sum()) / 0.3))
        box: Any = {"width": side, "height": side, "boundary": "periodic", "temperature": 0.5, "seed": SEED}
        return Scene.random(count=60, radius=radius, **box)

    return Case(scene, step_for(0.05, radius=RADIUS / ratio), compares=False)


def _masses(ratio: float) -> Case:
    def scene() -> Scene:
        even = gas(100, boundary="periodic")
        box: Any = {"width": even.width, "height": even.height, "radius": RADIUS, "boundary": "periodic"}
        mass = np.where(np.arange(100) % 2, 1.0, ratio)
        return Scene(position=even.position, velocity=even.velocity, mass=mass, **box)

    return Case(scene, step_for(0.02), 1000, compares=False)


def _corner(acceleration: float) -> Case:
    """Gravity towards one corner."""
    scene = partial(gas, gravity=(acceleration, -acceleration), restitution=0.9, wall_restitution=0.9)
    dt = step_for(0.05, math.sqrt(1 + 10 * acceleration))
    return Case(scene, dt, 2000, conserves=False, compares=False, rests=True)


_SIDE = 12.0
_SITES = np.stack(np.divmod(np.arange(36), 6), axis=1).astype(float)

PLACES = {
    "one point": np.full((36, 2), _SIDE / 2),
    "one corner": np.full((36, 2), RADIUS),
    "one line": np.stack([np.linspace(RADIUS, _SIDE - RADIUS, 36), np.full(36, _SIDE / 2)], axis=1),
    "one cell": _SIDE / 2 + 0.01 * _SITES,
    "cell edges": 1.0 + 2 * _SITES - (_SITES == 5) * 0.5,
    "wall edges": np.where(_SITES % 2 == 0, RADIUS, _SIDE - RADIUS),
    "touching": RADIUS + _SITES,
    "pairs in one place": np.repeat(1.0 + RADIUS + 2 * _SITES[:18], 2, axis=0),
}
"""Centres of 36 discs by name: coinciding, aligned or touching, or on the edges of cells and walls."""


def _places(kind: str) -> Case:
    position = np.clip(PLACES[kind], RADIUS, _SIDE - RADIUS)
    velocity = np.where(np.arange(36)[:, None] % 2, [1.0, -0.5], [-1.0, 0.5])
    box: Any = {"width": _SIDE, "height": _SIDE, "radius": RADIUS}
    return Case(partial(Scene, position=position, velocity=velocity, **box), compares=False)


def _numbers(text: str) -> Case:
    """A small scene with one number at the limit of floating point."""
    name, value = text.split("=")
    number = float(value)
    near: Any = {"width": 6.0, "height": 6.0, "position": [[2, 3], [3.5, 3]], "velocity": [[1, 0], [-1, 0]]}
    changes: dict[str, Any] = {
        "velocity": {"velocity": [[number, 0], [-number, 0]]},
        "one velocity": {"velocity": [[number, 0], [1, 0]]},
        "mass": {"mass": [number, 1.0]},
        "gravity": {"gravity": (0.0, -number)},
        "radius": {"radius": number, "position": [[2, 3], [4, 3]]},
        "box": {"width": number, "height": number},
        "dt": {},
    }[name]
    dt = number if name == "dt" else 0.01
    if name == "velocity" and number < 1:  # only a unit has changed, with which the step scales
        dt = 0.01 / max(number, 1e-300)
    scene = partial(Scene, **{"radius": 0.5, **near, **changes})
    return Case(scene, dt, 100, conserves=name != "gravity", compares=name not in ("mass", "gravity"))


NUMBERS = [
    f"{name}={value}"
    for name, values in {
        "velocity": ("1e-320", "1e-40"),
        "one velocity": ("1e18", "1e30", "1e150", "1e300"),
        "mass": ("1e-320", "1e-30", "1e38", "1e300"),
        "gravity": ("1e-320", "1e-12", "1e15", "1e300"),
        "radius": ("1e-320", "1e-20", "1e-9"),
        "box": ("1e8", "1e200"),
        "dt": ("1e-320", "1e-30", "1e30", "1e300"),
    }.items()
    for value in values
]

MAP = "map"
"""Name of the axis of pairs of steps and packings."""

STEP_FRACTIONS = (0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 3.0, 10.0, 100.0)
PACKINGS = (0.01, 0.1, 0.3, 0.5, 0.7, 0.8, 0.85, 0.88, 0.9)

AXES = {
    "step": Axis(
        "mean displacement in a step, in radii",
        (1e-6, 1e-4, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1, 3, 10, 100),
        lambda part: Case(gas, step_for(part), _frames(20.0, step_for(part), 400)),
    ),
    "packing": Axis(
        "packing fraction (above 0.9069: overlapping starts)",
        (0.001, 0.01, 0.1, 0.3, 0.5, 0.7, 0.8, 0.85, 0.88, 0.9, 0.906, 1.0, 1.5, 3.0),
        _packing,
    ),
    "count": Axis("number of discs", (0, 1, 2, 10, 1000), _count, (100_000, 1_000_000, 5_000_000)),
    "length": Axis(
        "unit of length",
        (1e-6, 1e-3, 1.0, 1e3, 1e6),
        lambda unit: Case(partial(gas, scale=unit, speed=unit)),
        (1e-18, 1e-12, 1e12, 1e18),
    ),
    "box": Axis("side of the box, in radii", (1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e9, 1e12, 1e15), _far),
    "aspect": Axis("width over height of the box", (1, 100, 1e4, 1e6, 1e9), _aspect),
    "speed": Axis(
        "unit of speed",
        (1e-20, 1e-10, 1e-3, 1.0, 1e3, 1e8, 1e15),
        lambda unit: Case(partial(gas, speed=unit), step_for(0.05, unit)),
    ),
    "radii": Axis("largest over smallest radius", (1, 10, 100, 1000), _radii),
    "masses": Axis("lightest over heaviest mass", (1.0, 1e-3, 1e-6, 1e-9), _masses),
    # Discs without any restitution cling to each other, and their collisions are not to be counted.
    "restitution": Axis(
        "restitution of discs and walls",
        (0.0, 0.1, 0.5, 0.9, 1.0),
        lambda e: Case(partial(gas, restitution=e, wall_restitution=e), conserves=e == 1, compares=e > 0),
    ),
    "gravity": Axis("gravity towards one corner", (1e-3, 1.0, 1e3, 1e6), _corner),
    "places": Axis("special starts: discs in one point, in a line, in pairs, ...", tuple(PLACES), _places),
    "drift": Axis(
        "frames of a gas of 10 discs",
        (1e3, 1e4, 1e5),
        lambda frames: Case(partial(gas, 10), step_for(0.1), int(frames), compares=False),
        (1e6,),
    ),
    "numbers": Axis("one number near the limits of floating point", tuple(NUMBERS), _numbers),
    MAP: Axis("steps and packings", tuple(product(STEP_FRACTIONS, PACKINGS)), _step_and_packing),
}
"""By the names of options and files."""

# --- Trials of the stability map: outcomes of every method, contact, law and precision on extreme scenes
#
# correct    all errors are within TOLERANCE, with or without a warning
# degraded   an error is larger, and a warning was raised before or during the run
# refused    an exception of mpsim names the limit and the remedy
#
# Forbidden: not finite, a disc lost or outside the box, a hang, a crash, and degraded without a warning ("silent").

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


class Trial(NamedTuple):
    """One run: axis, value along it, and row."""

    axis: str
    value: Any
    row: Row


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
    """All trials along some axes; None: all axes."""
    found = []
    for name in axes or AXES:
        axis = AXES[name]
        values = sorted(axis.values + axis.full) if full and axis.full else axis.values
        found += [Trial(name, value, row) for value in values for row in (MAP_ROWS if name == MAP else ROWS)]
    # All pairs of a million discs would take too long.
    return [each for each in found if each.axis != "count" or each.value <= 5000 or each.row.method != "naive"]


def attempt(trial: Trial) -> Outcome:
    """Run one trial and judge it."""
    outcome = Outcome(trial.axis, trial.value, trial.row.label)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            case = AXES[trial.axis].case(trial.value)
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
        disc = int(outside.argmax())
        return "lost", f"disc {disc} is outside the box, at {state.position[disc].tolist()}"
    return None


def _errors(trial: Trial, case: Case, scene: Scene, start: State, end: State, collisions: int) -> dict[str, float]:
    if not scene.count:
        return {}
    row = trial.row
    errors = _conserved(case, scene, start, end, scene.masses / scene.masses.max(), row)
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
    apart = scene._to_nearest_image(np.subtract(one.position, other.position, dtype=np.float64))
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
    case = AXES[axis].case(value)
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


def run_trials(chosen: Sequence[Trial], workers: int, progress: Callable[[str], None]) -> list[Outcome]:
    """Outcomes of trials, in their order; `progress` is called with the words for each that has ended."""
    idle: Queue[Apart] = Queue()
    for _ in range(workers):
        idle.put(Apart())

    def tried(trial: Trial) -> Outcome:
        process = idle.get()
        try:
            return process.call(HANG_SECONDS, attempt, trial)
        except (BrokenProcessPool, TimeoutError) as error:
            kind, text = ("hang", "no end in sight") if isinstance(error, TimeoutError) else ("crash", str(error))
            return Outcome(trial.axis, trial.value, trial.row.label, kind, text=text)
        finally:
            idle.put(process)
            progress(f"{trial.axis} {trial.value}")

    with ThreadPoolExecutor(workers) as threads:
        try:
            return list(threads.map(tried, chosen))
        finally:
            threads.shutdown(cancel_futures=True)
            while not idle.empty():
                idle.get().close()


def counts(outcomes: Iterable[Outcome]) -> dict[str, int]:
    """Number of outcomes of each kind, forbidden ones included."""
    found = Counter(outcome.kind for outcome in outcomes)
    return {kind: found[kind] for kind in (*KINDS, *FORBIDDEN)}


def counts_table(outcomes: Sequence[Outcome]) -> str:
    """Counts of outcomes by axis, in Markdown."""
    rows = []
    for name in [*dict.fromkeys(outcome.axis for outcome in outcomes), "all"]:
        chosen = [outcome for outcome in outcomes if name in ("all", outcome.axis)]
        title = "**all**" if name == "all" else AXES[name].title
        rows.append((title, len(chosen), *counts(chosen).values()))
    return table(("axis", "trials", *KINDS, *FORBIDDEN), rows)


def main() -> int:
    """Run the trials, write everything; 1 if an outcome is forbidden."""
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", choices=AXES, metavar="AXIS", help=", ".join(AXES))
    parser.add_argument("--full", action="store_true", help="also the long trials")
    parser.add_argument("--workers", type=int, default=2, help="processes that try at the same time (default: 2)")
    parser.add_argument("--out", type=Path, default=Path("results/stability"), help="default: results/stability")
    parser.add_argument("--docs", type=Path, help="page whose table is renewed: docs/stability.md")
    options = parser.parse_args()
    make_folder(options.out)
    started, chosen = time.perf_counter(), trials(options.only, options.full)
    with progress_bar() as progress:
        task = progress.add_task("starting", total=len(chosen))
        tick = lambda words: progress.update(task, advance=1, description=words)  # noqa: E731
        outcomes = run_trials(chosen, options.workers, tick)
    machine_now, found, text = machine(), counts(outcomes), counts_table(outcomes)
    kept = json.dumps({"counts": found, "outcomes": list(map(asdict, outcomes)), "machine": machine_now}, indent=1)
    (options.out / "stability.json").write_text(kept)
    say(text)
    for outcome in outcomes:
        if outcome.kind in FORBIDDEN:
            say(f"{outcome.kind}: {outcome.axis} {outcome.value}, {outcome.row}: {outcome.text or outcome.errors}")
    if options.docs:
        fill_page(options.docs, {"counts": text, "made": made_by(machine_now)})
        folder = options.docs.with_suffix("")
        folder.mkdir(exist_ok=True)
        (folder / "outcomes.json.gz").write_bytes(gzip.compress(kept.encode(), mtime=0))
    console.print(f"{time.perf_counter() - started:.1f} s; all is in {options.out}/")
    return int(any(found[kind] for kind in FORBIDDEN))


if __name__ == "__main__":
    sys.exit(exit_code(main))
