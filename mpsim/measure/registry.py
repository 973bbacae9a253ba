"""All quantities that runs and studies measure, and their averages during a run.

A run measures by three kinds of functions. *Counted* ones take sums that the kernels keep for each frame on request:
impulses on walls and between discs, overlaps. *Sampled* ones are functions of a state; the run averages their values
at fixed frames. *Drifts* compare the final state with the initial one and with the counts in between. A pressure has a
kinetic part, from velocities that are sampled, and a collisional one, which is counted.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.core.columns import equal_sizes
from mpsim.core.state import Discs, count_of
from mpsim.errors import InputError
from mpsim.features import FEATURES
from mpsim.features.edges import EDGES
from mpsim.features.feature import (
    adds_discs,
    conserves_energy,
    has_body_force,
    has_losses,
    is_inelastic,
    mean_mass,
)
from mpsim.features.obstacles import Circle
from mpsim.kernels import records
from mpsim.measure import observables
from mpsim.measure.observables import parts
from mpsim.measure.statistics import (
    FEWEST_BLOCKS,
    FEWEST_EVENTS,
    Measure,
    SlowVariable,
    average_beside,
    block_average,
    energy_in_bath,
    ratio_average,
)
from mpsim.scene.scene import Scene

OfDiscs = Callable[[Callable[[Discs], Any]], Any]
"""Calls a function with the present state, or what reads it in chunks. Where several processes share the simulation,
one of them calls the function, and all get its value."""

UNKNOWN = Measure(float("nan"), float("nan"), 0, settled=False)

# --- Measures from counts of the kernels in each frame: impulses on walls and between discs, collisions, overlaps


@dataclass(frozen=True)
class Run:
    """What a measure may use besides the counts.

    Attributes:
        scene: the scene.
        count: number of discs now.
        dt: time of a frame [time].
        of_discs: gives the value of a function of the final state.
        flow: `observables.flow_of_momentum` along the run, shape (samples, 3), if a measure needs it
            [mass length^2/time^2].
        every: number of frames between two samples; the first is taken after that many frames.
        slow: the energy along the run, if a heat bath changes it.
    """

    scene: Scene
    count: int
    dt: float
    of_discs: OfDiscs
    flow: Floats
    every: int
    slow: SlowVariable | None

    @cached_property
    def kinetic_energy(self) -> float:
        """At the end, without that of the mean flow along periodic axes, which no collision changes."""

        def energy_without_drift(discs: Discs) -> float:
            energy = observables.kinetic_energy(discs, self.scene)
            mass = float(self.scene.masses.sum()) if self.scene.mass is not None else count_of(discs)
            flow = observables.momentum(discs, self.scene)[list(self.scene.periodic)]
            return energy - float((flow**2).sum()) / (2 * mass) if mass else energy

        return self.of_discs(energy_without_drift)


def _walls(scene: Scene) -> list[int]:
    """Which edges discs bounce off, indices of EDGES."""
    wraps = [scene.periodic[0]] * 2 + [scene.periodic[1]] * 2
    return [index for index, edge in enumerate(EDGES) if not wraps[index] and edge not in scene.absorbing]


Counts = NDArray[Any]  # what was counted in each frame: records.COUNTS, shape (frames,)


def pressure(counts: Counts, run: Run) -> Measure:
    """Pressure on the walls: their total impulse / (time x their length) [mass/time^2].

    Walls are the edges that are neither periodic nor absorbing. If one axis is periodic, only the other one has walls,
    so a box periodic in x gives P_yy. If both are, it is `pressure_virial`.
    """
    if all(run.scene.periodic):
        return pressure_virial(counts, run)
    scene, walls = run.scene, _walls(run.scene)
    lengths = [scene.height] * 2 + [scene.width] * 2
    all_round = 2 * (scene.width + scene.height)  # rounded once
    scale = 1 / (run.dt * (all_round if len(walls) == len(EDGES) else sum(lengths[index] for index in walls)))
    count, squares = run.of_discs(lambda discs: observables.number_and_squares(discs, equal_sizes(1, count_of(discs))))
    speed = math.sqrt(squares / (2 * count)) if count else 0.0  # root mean square of one component
    mass = mean_mass(scene)
    hit = (1 + scene.wall_restitution) * mass * speed * scale
    hits = counts["wall"][:, walls].sum(axis=1) * scale
    mean, alternation = float(hits.mean()), 0.0
    if mean > 0 and speed > 0 and not has_body_force(scene):
        # Discs carry momentum from wall to wall at their speed v, and collisions transfer it over a diameter: together
        # at v P V / (N k T).
        passed = mean * scene.width * scene.height / (count * mass * speed)
        alternation = max(_free(scene)) / (passed * run.dt)
    return average_beside(run.slow, hits, event=hit or None, alternation=alternation, constant=True)


def pressure_virial(counts: Counts, run: Run) -> Measure:
    """Pressure from the virial of the collisions [mass/time^2], mean over both directions.

    In a box with hard walls, exact for any number of discs of one size (Clausius 1870):
    (W - s) F_x + (H - s) F_y = 2 E + sum r.dp / time, with s the diameter, r.dp = s |dp| of each collision, E the
    kinetic energy, and F_x = P H, F_y = P W the mean forces on one wall. Along a periodic axis s is left out and F is
    the force through a section of the box: with two periodic axes P = (E + sum r.dp / (2 time)) / area, for discs of
    any sizes. The energy of the drift is then left out, which exerts no pressure; P is kT / area below that of a system
    whose total momentum fluctuates (Ray and Zhang, Phys. Rev. E 59, 4781, 1999). Where one axis is periodic, this is
    the mean of `pressure_xx` and `pressure_yy`, weighted with (W - s) H and (H - s) W. Valid only without gravity.

    E is constant, so the error is that of the collisional part, an upper bound if there were few collisions.
    """
    free_x, free_y = _free(run.scene)
    area = free_x * run.scene.height + free_y * run.scene.width
    kinetic, scale = 2 * run.kinetic_energy / area, 2 * run.scene.largest_radius / (run.dt * area)
    if run.count < 2:  # no collisions
        return block_average(np.full(len(counts), kinetic), constant=True)
    # Root mean square of |dp| over the collisions of a gas of this energy: 2 m sqrt(kT / m).
    event = 2 * math.sqrt(mean_mass(run.scene) * max(run.kinetic_energy, 0.0) / run.count) * scale
    collisional = block_average(counts["virial"] * scale, event=event or None, constant=True)
    return replace(collisional, value=kinetic + collisional.value)


def pressure_xx(counts: Counts, run: Run) -> Measure:
    """Pressure along x, on a wall or through a section at right angles to x [mass/time^2].

    The virial of one direction, exact for any number of discs of one size: (W - s) H P_xx = sum m v_x v_x +
    sum x dp_x / time, where x dp_x = s |dp| n_x^2 for each collision. If x is periodic, s and the drift along x are
    left out, except with a thermostat or thermal walls, where the drift is thermal. If x has walls it is the pressure
    on them. If only y has walls, P_xx is less than P_yy, which is physical: no centre comes closer to a wall than a
    radius, so that less momentum flows along it. Valid only without gravity.
    """
    return _component(counts, counts["virial_xx"], 0, _free(run.scene)[0] * run.scene.height, run)


def pressure_yy(counts: Counts, run: Run) -> Measure:
    """Pressure along y, likewise [mass/time^2]: that on walls at the bottom and the top of the box."""
    return _component(counts, counts["virial"] - counts["virial_xx"], 1, _free(run.scene)[1] * run.scene.width, run)


def pressure_xy(counts: Counts, run: Run) -> Measure:
    """Shear component of the pressure: flow of x momentum along y [mass/time^2], in a box without walls.

    (sum m v_x v_y + sum x dp_y / time) / area, of mean 0 without shear (Irving and Kirkwood, J. Chem. Phys. 18, 817,
    1950). Smooth walls take up no shear.
    """
    return _component(counts, counts["virial_xy"], 2, run.scene.width * run.scene.height, run)


def _component(counts: Counts, virial: Floats, component: int, area: float, run: Run) -> Measure:
    """A component of the pressure: its kinetic part from the samples, its collisional part from all frames.

    The error is that of their sum. It is settled if there were enough collisions, and the flow has lost the memory of
    its start; or if no disc can collide.
    """
    if not len(run.flow):
        return UNKNOWN
    flow = run.flow[:, component]
    given = 2 * run.scene.largest_radius * virial / run.dt
    between = given[: len(flow) * run.every].reshape(len(flow), run.every).mean(axis=1)
    alone, enough = run.count < 2, np.count_nonzero(counts["collisions"]) >= FEWEST_EVENTS
    found = average_beside(run.slow, (flow + between) / area, constant=alone)
    found = replace(found, value=float(flow.mean() + given.mean()) / area)
    if alone or (enough and average_beside(run.slow, flow, constant=True).settled):
        return found
    return replace(found, settled=False, upper=False)


def _free(scene: Scene) -> tuple[float, float]:
    """Lengths that are accessible to centres along x and y."""
    lengths = zip((scene.width, scene.height), scene.periodic, strict=True)
    free_x, free_y = (length if wraps else length - 2 * scene.largest_radius for length, wraps in lengths)
    return free_x, free_y


def contact_rate(counts: Counts, run: Run) -> Measure:
    """Contacts in which velocities changed, per disc and time [1/time]; each counts for both discs.

    A stepped method resolves the contacts of discs that rest on each other again in each step: in a heap the rate grows
    as 1 / dt. `collision_rate`, the other name, is refused in such scenes.
    """
    unit = 2 / (run.dt * max(run.count, 1))
    return average_beside(run.slow, counts["collisions"] * unit, event=unit, constant=True)


def overlap(counts: Counts, run: Run) -> Measure:
    """Mean depth of overlapping pairs when they are detected [length]; 0 with an unknown error if there were none."""
    found, met = ratio_average(counts["depth"], counts["met"]), counts["met"]
    if run.slow is None or not met.any():
        return found
    residues = average_beside(run.slow, counts["depth"] - found.value * met)
    settled = found.settled and residues.settled
    return replace(found, error=residues.error / met.mean(), settled=settled, upper=residues.upper)


def largest_overlap(counts: Counts, run: Run) -> Measure:
    """Largest depth of an overlap detected in the whole run [length]; an extreme value, so without an error."""
    return Measure(float(counts["deepest"].max(initial=0.0)), float("nan"), len(counts), settled=False)


COMPONENTS: tuple[str, ...] = ("pressure_xx", "pressure_yy", "pressure_xy")
"""Measures that need the flow of momentum along the run."""


# --- Sampled measures, NaN in a state in which they are undefined, and drifts of conserved quantities


def _temperature(discs: Discs, scene: Scene) -> float:
    return observables.temperature(discs, scene) if any(part.number for part in parts(discs)) else math.nan


def _speed_kurtosis(discs: Discs, scene: Scene) -> float:
    return observables.speed_kurtosis(discs) if any(part.velocity.any() for part in parts(discs)) else math.nan


def _energies(discs: Discs, scene: Scene) -> tuple[float, float]:
    """Kinetic and potential energy [mass length^2/time^2]."""
    return observables.kinetic_energy(discs, scene), observables.potential_energy(discs, scene)


def _energy_drift(counts: Counts, run: Run, before: tuple[float, float], after: tuple[float, float]) -> float:
    """Change of kinetic plus potential energy per time, over the larger of both kinetic energies [1/time]."""
    largest = max(before[0], after[0])
    change = after[0] - before[0] + after[1] - before[1]
    return change / (largest * run.dt * len(counts)) if largest else 0.0


def _momenta(discs: Discs, scene: Scene) -> tuple[Floats, float]:
    """Sums of m v, shape (2,), and of m |v| [mass length/time]."""
    masses = observables.masses_of("momentum_drift", scene, discs)
    sizes = observables.total(discs, lambda part: float((part.of(masses) * np.hypot(*part.velocity.T)).sum()))
    return observables.momentum(discs, scene), sizes


def _momentum_drift(counts: Counts, run: Run, before: tuple[Floats, float], after: tuple[Floats, float]) -> float:
    """Change of momentum that is not due to walls or gravity, per time, over the sum of m |v| [1/time], >= 0.

    Newton's third law keeps it at rounding; `reflect` violates that law. The larger sum of both states is taken. Scenes
    with other external impulses (rough or thermal walls, obstacles, a thermostat) are refused.
    """
    left, right, bottom, top = counts["wall"].sum(axis=0)
    time, given = run.dt * len(counts), np.array([left - right, bottom - top])
    masses = 1.0 if run.scene.mass is None else run.scene.mass
    if run.scene.gravity is not None:
        given += (run.count if run.scene.mass is None else run.scene.mass.sum()) * run.scene.gravity * time
    if run.scene.acceleration is not None:
        given += (run.scene.acceleration.T * masses).sum(axis=1) * time
    largest = max(before[1], after[1])
    return float(np.hypot(*(after[0] - before[0] - given))) / (largest * time) if largest else 0.0


# --- The registry of all quantities that runs and trade-off studies can measure

Error = Literal["relative", "difference", "mean", "largest", "depth", "distribution", "short"]
"""How a trade-off study takes the error of an observable from runs of a candidate and of the reference.

relative: as a fraction of the reference's value. difference: from that value. mean, largest: the observable itself,
which is 0 in an exact run by definition; its mean, or its largest value. depth: likewise, the mean over overlapping
pairs. distribution: the largest difference of two cumulative distributions. short: from two short runs with one start.
"""


@dataclass(frozen=True)
class Observable:
    """What is known about one observable.

    Attributes:
        counted, sampled: its function of the counts, or of a state.
        drift: its function of the counts and of two values of `conserved`, in the first and the last state.
        conserved: a function of a state. A trade-off study alone has observables without any of these.
        constant: whether physics keeps a sampled value constant in a run. If not, a series that has not changed so far
            may still change, and its error is unknown.
        error: how a trade-off study computes its error; None: it does not.
        unit: of that error; "%" for a dimensionless quantity.
    """

    counted: Callable[[Counts, Run], Measure] | None = None
    sampled: Callable[[Discs, Scene], float] | None = None
    drift: Callable[[Counts, Run, Any, Any], float] | None = None
    conserved: Callable[[Discs, Scene], Any] | None = None
    constant: Callable[[Run], bool] = lambda run: conserves_energy(run.scene)
    error: Error | None = None
    unit: str = "%"


OBSERVABLES: dict[str, Observable] = {
    "pressure": Observable(counted=pressure, error="relative"),
    "pressure_virial": Observable(counted=pressure_virial),
    "pressure_xx": Observable(counted=pressure_xx),
    "pressure_yy": Observable(counted=pressure_yy),
    "pressure_xy": Observable(counted=pressure_xy),
    "collision_rate": Observable(counted=contact_rate, error="relative"),
    "contact_rate": Observable(counted=contact_rate),
    "energy_drift": Observable(drift=_energy_drift, conserved=_energies, error="difference", unit="1/time"),
    "momentum_drift": Observable(drift=_momentum_drift, conserved=_momenta, error="mean", unit="1/time"),
    "overlap": Observable(counted=overlap, error="depth", unit="diam."),
    "largest_overlap": Observable(counted=largest_overlap, error="largest", unit="diam."),
    "kinetic_energy": Observable(sampled=observables.kinetic_energy),
    "temperature": Observable(sampled=_temperature),
    "speed_kurtosis": Observable(  # which collisions change: they need two discs
        sampled=_speed_kurtosis, constant=lambda run: run.count == 1 and conserves_energy(run.scene)
    ),
    "speed_distribution": Observable(error="distribution"),
    "trajectory": Observable(error="short", unit="diam."),
    "missed_collisions": Observable(error="short"),
}
"""In the order of the columns of a trade-off study."""

COUNTED = {name: each.counted for name, each in OBSERVABLES.items() if each.counted}
SAMPLED = {name: each.sampled for name, each in OBSERVABLES.items() if each.sampled}
DRIFTS = {name: each.drift for name, each in OBSERVABLES.items() if each.drift}

NAMES: tuple[str, ...] = (*COUNTED, *SAMPLED, *DRIFTS)  # what a run can measure


def names() -> tuple[str, ...]:
    """What a run can measure, for modules below this one."""
    return NAMES


ERRORS: tuple[str, ...] = tuple(name for name, each in OBSERVABLES.items() if each.error)
"""What a trade-off study can measure the error of: LONG ones from long runs, SHORT ones from short ones."""

LONG: tuple[str, ...] = tuple(name for name in ERRORS if OBSERVABLES[name].error != "short")
SHORT: tuple[str, ...] = tuple(name for name in ERRORS if OBSERVABLES[name].error == "short")


# --- Which measures a scene has


def _fills(scene: Scene, axis: int) -> bool:
    """Whether the largest disc fills the box along an axis with walls."""
    return not scene.periodic[axis] and (scene.width, scene.height)[axis] <= 2 * scene.largest_radius


def _has_container(scene: Scene) -> bool:
    """Whether a container keeps discs from all walls of the box."""
    half = np.array([scene.width, scene.height]) / 2
    rings = [each for each in scene.obstacles if isinstance(each, Circle) and each.inside]
    return any((np.abs(np.subtract(each.centre, half)) + each.radius <= half).all() for each in rings)


def _has_sizes_between_walls(scene: Scene) -> bool:
    return scene.smallest_radius < scene.largest_radius and not all(scene.periodic)


_VIRIALS = ("pressure_virial", *COMPONENTS)  # measures that "virial" stands for

_BY_WALLS = "Use 'pressure', the impulses on the walls."
_REST = "losses under gravity or acceleration, where discs come to rest on each other and are in contact all the time"
_SIZES = "discs of several sizes between walls, which each keep the centres at a distance of their own"
_LOSSES = "losses (a restitution below 1), as the virial takes the kinetic energy for constant"

_REFUSALS: tuple[tuple[Callable[[Scene], bool], tuple[str, ...], str, str], ...] = (
    (has_body_force, ("virial",), "gravity and acceleration, which the virial leaves out", _BY_WALLS),
    (is_inelastic, ("virial",), _LOSSES, _BY_WALLS),
    (_has_sizes_between_walls, ("virial",), _SIZES, _BY_WALLS),
    (
        lambda scene: _fills(scene, 0) and _fills(scene, 1),
        ("pressure_virial",),
        "discs as wide and high as the box, which have no room to move",
        _BY_WALLS,
    ),
    (
        lambda scene: _fills(scene, 0),
        ("pressure_xx",),
        "discs as wide as the box, which have no room to move along x",
        "Use 'pressure_yy', along which they have.",
    ),
    (
        lambda scene: _fills(scene, 1),
        ("pressure_yy",),
        "discs as high as the box, which have no room to move along y",
        "Use 'pressure_xx', along which they have.",
    ),
    (
        lambda scene: any(wall.speed for wall in scene._moving_walls),
        ("pressure", "virial", "energy_drift"),
        "moving walls (a piston), which do work and change the box",
        "Run until the piston rests, and measure in a scene without it, made of sim.state, in a box of that size.",
    ),
    (
        _has_container,
        ("pressure",),
        "a container, which keeps discs from the walls",
        "Use a Sensor(obstacle=...) on it: its impulse over length and time.",
    ),
    *((of.is_in, each.measures, each.what, each.remedy) for of in FEATURES for each in of.invalidates),
    (
        lambda scene: any(each.works(scene) for each in scene._features if not each.heats),
        ("energy_drift",),
        "surfaces that move, which do work",
        "Compare kinetic energies, from sim.state.",
    ),
    (
        lambda scene: scene._loses_discs and not scene.absorbing,
        ("virial", "collision_rate", "contact_rate"),
        "removed discs, which its number of discs counts",
        "Measure in a scene without them, scene.starting_from(sim.state).",
    ),
    (
        lambda scene: not all(scene.periodic),
        ("pressure_xy",),
        "walls, which are smooth and take up no such momentum",
        "Use 'pressure_xx' and 'pressure_yy', or a box with boundary='periodic'.",
    ),
    (
        lambda scene: has_losses(scene) and has_body_force(scene),
        ("collision_rate", "missed_collisions"),
        _REST,
        "Use 'overlap'; or in a run 'contact_rate', which counts a resting contact once per step.",
    ),
    (
        lambda scene: scene.wall_friction > 0 and not all(scene.periodic),
        ("momentum_drift",),
        "rough walls, whose tangential impulses are not counted",
        "Measure 'pressure' or 'energy_drift', or give the walls wall_friction=0.",
    ),
    (
        observables.has_periodic_field,
        ("energy_drift",),
        "fields along periodic axes, along which discs fall without end",
        "Give such an axis walls.",
    ),
    (
        lambda scene: not all(scene.periodic) and not _walls(scene),
        ("pressure",),
        "absorbing edges all round, which leave no wall",
        "Give the scene a wall.",
    ),
)
"""Scenes in which measures are wrong: which scenes, which measures, what is in the way, and what to do instead."""


def refusal(name: str, scene: Scene, count: int | None = None) -> str | None:
    """Why a measure would be wrong in a scene, or None.

    Args:
        name: of the measure, or of an error of a trade-off study (`registry.ERRORS`).
        scene: the scene.
        count: number of discs now; None: that of the scene.

    >>> refusal("pressure", Scene.random(count=3, packing=0.1, radius=0.5)) is None
    True
    """
    virial = name == "pressure" and all(scene.periodic)
    called = "pressure_virial" if virial else name
    names = {called, "virial"} if called in _VIRIALS else {called}
    for is_in, measures, what, remedy in _REFUSALS:
        if not names.isdisjoint(measures) and is_in(scene):
            hint = "Without walls it is the virial: give the scene walls." if virial else remedy
            return f"measures may hold {name!r} only without {what}; this scene has them. {hint}"
    grown = count not in (None, scene.count) or adds_discs(scene)
    weighed = called in ("kinetic_energy", "temperature", *_VIRIALS, *DRIFTS)
    accelerated = name in DRIFTS and scene.acceleration is not None
    if grown and (accelerated or (weighed and (scene.mass is not None or any(e.mass for e in scene.emitters)))):
        what = "acceleration" if accelerated else "mass"
        return (
            f"measures may hold {name!r} only where the scene holds the {what} of every disc; it has {scene.count} "
            f"discs, and others are added. Make a scene of all discs, and measure there."
        )
    return None


def checked(names: Iterable[str] | None, scene: Scene | None = None, count: int | None = None) -> tuple[str, ...]:
    """Names of measures, checked.

    Args:
        names: one, several, or None for none.
        scene: refuse measures that would be wrong in it.
        count: number of discs now; None: that of the scene.

    Raises:
        InputError: for an unknown name, or a measure that the scene cannot have, with the reason.
    """
    if names is None:
        return ()
    each_of = names if isinstance(names, Iterable) and not isinstance(names, str) else [names]
    chosen = tuple(checks.choice("measures", name, NAMES) for name in each_of)
    for name in chosen:
        if scene is not None and (reason := refusal(name, scene, count)):
            raise InputError(reason)
    return chosen


# --- Averages during a run
#
# States are sampled at fixed frames, so that neither the number of workers nor the length of a slice can change an
# average.

SAMPLES = 200
"""Approximate number of states sampled in a run: each costs a copy of all positions and velocities, chunk by chunk on
ranks."""

FLOW_SAMPLES = 1000  # the same for the flow of momentum, the kinetic part of a pressure, which fluctuates more


class RunAverages:
    """Collects the data of the requested measures, slice by slice.

    Args:
        names: of measures, checked.
        frames: of the run; states are sampled about every frames / SAMPLES frames.
        scene: the scene of the run.
        of_discs: gives the value of a function of the present state.
        whole: whether the run begins with a whole frame. After Ctrl-C inside a frame it does not; the counts then
            include all of that frame: rates are right, but drifts between two states are not.
        skipped: frames at the beginning that do not count.
    """

    def __init__(
        self, names: tuple[str, ...], frames: int, scene: Scene, of_discs: OfDiscs, whole: bool = True, skipped: int = 0
    ):
        self._names, self._skipped, self._scene, self._of_discs = names, skipped, scene, of_discs
        self.counting: bool = any(name not in SAMPLED for name in names)  # whether the kernels must count
        conserved = {name: OBSERVABLES[name].conserved for name in names if whole or skipped}
        self._conserved = {name: function for name, function in conserved.items() if function is not None}
        self._before = self._of_all(self._conserved)
        self._lost: set[str] = set()
        self._counts: list[Counts] = []
        self._sampled: dict[str, Callable[[Discs, Scene], Any]] = {n: SAMPLED[n] for n in names if n in SAMPLED}
        if any(name in COMPONENTS for name in names):
            self._sampled["flow"] = observables.flow_of_momentum
        known = observables.is_heated(scene) and refusal("kinetic_energy", scene) is None
        if known and any(name not in DRIFTS for name in names):
            self._sampled["bath"] = observables.kinetic_energy
        self._samples: list[dict[str, Any]] = []
        self._every = max((frames - skipped) // (FLOW_SAMPLES if "flow" in self._sampled else SAMPLES), 1)

    def interrupted(self, scene: Scene, count: int) -> None:
        """Record that discs or parameters have been changed during the run.

        From then on these are NaN: drifts, since the change made is not a drift; the virial, which assumes a constant
        kinetic energy; and all measures that a run of the new scene could not have.

        Args:
            scene: from now on.
            count: number of discs now.
        """
        self._conserved = {}
        virials = {"pressure_virial", "pressure"} if all(scene.periodic) else {"pressure_virial"}
        self._lost |= {name for name in self._names if name in virials or refusal(name, scene, count)}
        flows = self._lost.issuperset(set(COMPONENTS) & set(self._names))
        bath = refusal("kinetic_energy", scene, count) is not None
        for name in [*self._lost, *(["flow"] if flows else []), *(["bath"] if bath else [])]:
            self._sampled.pop(name, None)

    def frames_to_sample(self, done: int) -> int:
        """Number of frames until the next sample, or until frames count; very large if neither is needed."""
        if done < self._skipped:
            return self._skipped - done
        return self._every - (done - self._skipped) % self._every if self._sampled else 2**62

    def take(self, counts: Counts | None, done: int) -> None:
        """Add the counts of a slice, and sample the state if it is due."""
        if done <= self._skipped:
            if done == self._skipped:
                self._before = self._of_all(self._conserved)
            return
        if counts is not None:
            self._counts.append(counts)
        if self._sampled and (done - self._skipped) % self._every == 0:
            self._samples.append(self._of_all(self._sampled))

    def mark(self) -> tuple[int, int]:
        """The amount of data collected so far, for `rewind`."""
        return len(self._counts), len(self._samples)

    def rewind(self, mark: tuple[int, int]) -> None:
        """Discard the data collected after a mark."""
        del self._counts[mark[0] :], self._samples[mark[1] :]

    def measures(self, scene: Scene, count: int, dt: float) -> dict[str, Measure]:
        """The measures at the end of the run, of its scene and number of discs now and the time of a frame."""
        counts = np.concatenate(self._counts) if self._counts else np.zeros(0, records.COUNTS)
        series = {name: np.array([sample[name] for sample in self._samples]) for name in self._sampled}
        slow = self._slow(series.get("bath", np.zeros(0)), count, dt)
        run = Run(scene, count, dt, self._of_discs, series.get("flow", np.zeros(0)), self._every, slow)
        after = self._of_all(self._conserved) if len(counts) else {}
        results: dict[str, Measure] = {}
        # Without frames, a mean over no discs, or of a scene that cannot have it
        unknown = {name for name, values in series.items() if not len(values) or np.isnan(values).any()} | self._lost
        unknown |= set() if len(counts) else set(COUNTED)
        for name in self._names:
            if name in unknown:
                results[name] = UNKNOWN
            elif name in COUNTED:
                results[name] = COUNTED[name](counts, run)
            elif name in SAMPLED:
                results[name] = average_beside(slow, series[name], constant=OBSERVABLES[name].constant(run))
            else:
                value = DRIFTS[name](counts, run, self._before[name], after[name]) if name in after else math.nan
                results[name] = Measure(value, math.nan, 1, settled=False)
        return results

    def _slow(self, energy: Floats, count: int, dt: float) -> SlowVariable | None:
        """The energy along the run, which a bath changes slowly; None without one."""
        if len(energy) < FEWEST_BLOCKS or not energy.mean() > 0:
            return None
        memory = observables.memory_of_baths(self._scene, energy.mean() / count)
        return energy_in_bath(energy, memory / (len(energy) * self._every * dt), count)

    def _of_all(self, functions: Mapping[str, Callable[[Discs, Scene], Any]]) -> dict[str, Any]:
        """The values of functions of the present state, by name."""
        if not functions:
            return {}
        return self._of_discs(lambda now: {name: each(now, self._scene) for name, each in functions.items()})
