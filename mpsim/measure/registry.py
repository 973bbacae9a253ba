"""The registry of all quantities that runs and studies measure, those of the counts of kernels, and drifts."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import Discs
from mpsim.features.edges import EDGES
from mpsim.measure import moments, observables
from mpsim.measure.moments import any_moves, any_present, conserves_energy, has_body_force
from mpsim.measure.statistics import FEWEST_EVENTS, Measure, SlowVariable, average_beside, block_average, ratio_average
from mpsim.scene.scene import Scene

# --- Measures from counts of the kernels in each frame: impulses on walls and between discs, collisions, overlaps
#
# A pressure has a kinetic and a collisional part. The first needs velocities, which are sampled along the run; the
# second is counted.


@dataclass(frozen=True)
class Run:
    """What a measure may use besides the counts.

    Attributes:
        scene: the scene.
        count: number of discs now.
        dt: time of a frame [time].
        kinetic_energy: at the end, without that of a drift along periodic axes, if a measure needs it
            [mass length^2/time^2].
        speed: root mean square of one velocity component, if a measure needs it [length/time].
        flow: `moments.flow_of_momentum` along the run, shape (samples, 3), if a measure needs it
            [mass length^2/time^2].
        every: number of frames between two of these samples; the first is taken after that many frames.
        slow: the energy along the run, if a heat bath changes it.
    """

    scene: Scene
    count: int
    dt: float
    kinetic_energy: float = 0.0
    speed: float = 0.0
    flow: NDArray[np.float64] | None = None
    every: int = 1
    slow: SlowVariable | None = None

    @property
    def walls(self) -> list[int]:
        """Which edges discs bounce off, indices of EDGES."""
        wraps = [self.scene.periodic[0]] * 2 + [self.scene.periodic[1]] * 2
        return [index for index, edge in enumerate(EDGES) if not wraps[index] and edge not in self.scene.absorbing]

    @property
    def perimeter(self) -> float:
        """Length of these edges [length]."""
        if len(self.walls) == len(EDGES):
            return 2 * (self.scene.width + self.scene.height)
        lengths = [self.scene.height] * 2 + [self.scene.width] * 2
        return float(sum(lengths[index] for index in self.walls))


Counts = NDArray[Any]
"""What was counted in each frame: records.COUNTS, shape (frames,)."""


def pressure(counts: Counts, run: Run) -> Measure:
    """Pressure on the walls: their total impulse / (time x their length) [mass/time^2].

    Walls are the edges that are neither periodic nor absorbing. If one axis is periodic, only the other one has walls,
    so a box periodic in x gives P_yy. If both are, it is `pressure_virial`.
    """
    if all(run.scene.periodic):
        return pressure_virial(counts, run)
    scene, scale = run.scene, 1 / (run.dt * run.perimeter)
    mass = float(scene.masses.mean()) if scene.count else 1.0
    hit = (1 + scene.wall_restitution) * mass * run.speed * scale
    hits = counts["wall"][:, run.walls].sum(axis=1) * scale
    alternation = _alternation(float(hits.mean()), mass, run)
    return average_beside(run.slow, hits, event=hit or None, alternation=alternation, constant=True)


def _alternation(pressure: float, mass: float, run: Run) -> float:
    """Number of frames in which momentum from one wall reaches the opposite one; 0: unknown.

    Discs carry it at their speed v, and collisions transfer it over a diameter, together at v P V / (N k T).
    """
    scene = run.scene
    if has_body_force(scene) or not (pressure > 0 and run.speed > 0):
        return 0.0
    passed = pressure * scene.width * scene.height / (run.count * mass * run.speed)
    return max(_free(scene)) / (passed * run.dt)


def pressure_virial(counts: Counts, run: Run) -> Measure:
    """Pressure from the virial of the collisions [mass/time^2], mean over both directions.

    In a box with hard walls, exact for any number of discs of one size (Clausius 1870):
    (W - s) F_x + (H - s) F_y = 2 E + sum r.dp / time, with s the diameter, r.dp = s |dp| of each collision, and F the
    mean force on one wall; here F_x = P H and F_y = P W. Along a periodic axis s is left out and F is the force through
    a section of the box, so that with two periodic axes P = (E + sum r.dp / (2 time)) / area, for discs of any sizes. E
    is the kinetic energy. In a periodic box that of the drift is subtracted, since a common motion of all discs exerts
    no pressure; P is then kT / area below that of a system whose total momentum fluctuates (Ray and Zhang, Phys. Rev. E
    59, 4781, 1999). Where one axis is periodic, the two directions differ (`pressure_xx`, `pressure_yy`), and
    `pressure` is one of them: this is their mean, weighted with (W - s) H and (H - s) W. Valid only without gravity.

    E is constant, so the error is that of the collisional part. If there were few collisions, it is the upper bound for
    few events.
    """
    free_x, free_y = _free(run.scene)
    area = free_x * run.scene.height + free_y * run.scene.width
    kinetic, scale = 2 * run.kinetic_energy / area, _diameter(run) / (run.dt * area)
    if run.count < 2:  # no collisions
        return block_average(np.full(len(counts), kinetic), constant=True)
    event = _impulse(run) * scale
    collisional = block_average(counts["virial"] * scale, event=event or None, constant=True)
    return replace(collisional, value=kinetic + collisional.value)


def _impulse(run: Run) -> float:
    """Root mean square of |dp| over the collisions of a gas of this energy [mass length/time]: 2 m sqrt(kT / m)."""
    return 2 * math.sqrt(float(run.scene.masses.mean()) * max(run.kinetic_energy, 0.0) / run.count)


def pressure_xx(counts: Counts, run: Run) -> Measure:
    """Pressure along x, on a wall or through a section at right angles to x [mass/time^2].

    The virial of one direction, exact for any number of discs of one size: (W - s) H P_xx = sum m v_x v_x +
    sum x dp_x / time, where x dp_x = s |dp| n_x^2 for each collision. If x is periodic, s and the drift along x are
    left out; but with a thermostat or thermal walls the drift is thermal and counts, so that N discs which never
    collide have N kT / area, not (N - 1) kT / area. If x has walls it is the pressure on them. If only y has walls,
    P_xx is less than P_yy, which is physical: no centre comes closer to a wall than a radius, so that less momentum
    flows along it. For 100 discs at packing 0.3 between two walls P_xx is 0.803(2) and P_yy 0.839(2) kT / diameter^2;
    in a larger box they differ less. Valid only without gravity.
    """
    return _component(counts, counts["virial_xx"], 0, _free(run.scene)[0] * run.scene.height, run)


def pressure_yy(counts: Counts, run: Run) -> Measure:
    """Pressure along y, likewise [mass/time^2]: that on walls at the bottom and the top of the box."""
    virial = counts["virial"] - counts["virial_xx"]
    return _component(counts, virial, 1, _free(run.scene)[1] * run.scene.width, run)


def pressure_xy(counts: Counts, run: Run) -> Measure:
    """Shear component of the pressure: flow of x momentum along y [mass/time^2], in a box without walls.

    (sum m v_x v_y + sum x dp_y / time) / area, of mean 0 without shear (Irving and Kirkwood, J. Chem. Phys. 18, 817,
    1950). Smooth walls take up no shear.
    """
    return _component(counts, counts["virial_xy"], 2, run.scene.width * run.scene.height, run)


def _component(counts: Counts, virial: NDArray[np.float64], component: int, area: float, run: Run) -> Measure:
    """A component of the pressure: its kinetic part from the samples, its collisional part from all frames.

    The error is that of their sum. It is settled if there were enough collisions, and the flow has lost the memory of
    its start; or if no disc can collide.
    """
    flow = np.zeros(0) if run.flow is None else run.flow[:, component]
    if not len(flow):
        return Measure(float("nan"), float("nan"), 0, settled=False)
    given = _diameter(run) * virial / run.dt
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


def _diameter(run: Run) -> float:
    return 2 * run.scene.largest_radius


def contact_rate(counts: Counts, run: Run) -> Measure:
    """Contacts in which velocities changed, per disc and time [1/time]; each counts for both discs.

    These are collisions unless discs rest on each other. Such a contact is permanent, and a stepped method resolves it
    again in each step: in a heap the rate then counts contacts per step, and grows as 1 / dt.

    It has two names. `collision_rate` is always a physical rate, and is refused in scenes where discs come to rest on
    each other. `contact_rate` is available in all scenes.
    """
    unit = 2 / (run.dt * max(run.count, 1))
    return average_beside(run.slow, counts["collisions"] * unit, event=unit, constant=True)


def overlap(counts: Counts, run: Run) -> Measure:
    """Mean depth of overlapping pairs when they are detected [length]; 0 with an unknown error if there were none."""
    found, met = ratio_average(counts["depth"], counts["met"]), counts["met"]
    if run.slow is None or not met.any():
        return found
    residues = average_beside(run.slow, counts["depth"] - found.value * met)
    return replace(
        found, error=residues.error / met.mean(), settled=found.settled and residues.settled, upper=residues.upper
    )


def largest_overlap(counts: Counts, run: Run) -> Measure:
    """Largest depth of an overlap detected in the whole run [length]; an extreme value, so without an error."""
    return Measure(float(counts["deepest"].max(initial=0.0)), float("nan"), len(counts), settled=False)


COMPONENTS: tuple[str, ...] = ("pressure_xx", "pressure_yy", "pressure_xy")
"""Measures that need the flow of momentum along the run."""


# --- Drifts of conserved quantities, from the first and last state of a run and the counts in between


class Energies(NamedTuple):
    """Kinetic and potential energy of a state [mass length^2/time^2]."""

    kinetic: float
    potential: float


class Momenta(NamedTuple):
    """Sums of m v, shape (2,), and of m |v| [mass length/time]."""

    total: NDArray[np.float64]
    largest: float


class Drift(NamedTuple):
    """A drift.

    Attributes:
        of: function that gives the value in a state.
        rate: function that gives the drift, from the values in the first and last state of a run and the counts in
            between.
    """

    of: Callable[[Discs, Scene], Any]
    rate: Callable[[Counts, Run, Any, Any], float]


def _energies(discs: Discs, scene: Scene) -> Energies:
    return Energies(observables.kinetic_energy(discs, scene), observables.potential_energy(discs, scene))


def _momenta(discs: Discs, scene: Scene) -> Momenta:
    masses = moments.masses_of("momentum_drift", scene, discs)
    return Momenta(observables.momentum(discs, scene), moments.momenta(discs, masses))


def _energy_drift(counts: Counts, run: Run, before: Energies, after: Energies) -> float:
    """Change of kinetic plus potential energy per time, over the larger of both kinetic energies [1/time]."""
    largest = max(before.kinetic, after.kinetic)
    change = after.kinetic - before.kinetic + after.potential - before.potential
    return change / (largest * run.dt * len(counts)) if largest else 0.0


def _momentum_drift(counts: Counts, run: Run, before: Momenta, after: Momenta) -> float:
    """Change of momentum that is not due to walls or gravity, per time, over the sum of m |v| [1/time], >= 0.

    Newton's third law keeps it at rounding; `reflect` violates that law. The larger sum of both states is taken. Scenes
    with other external impulses (rough or thermal walls, obstacles, a thermostat) are refused by `run_averages`.
    """
    left, right, bottom, top = counts["wall"].sum(axis=0)
    time, given = run.dt * len(counts), np.array([left - right, bottom - top])
    masses = 1.0 if run.scene.mass is None else run.scene.mass
    if run.scene.gravity is not None:
        given += (run.count if run.scene.mass is None else run.scene.mass.sum()) * run.scene.gravity * time
    if run.scene.acceleration is not None:
        given += (run.scene.acceleration.T * masses).sum(axis=1) * time
    largest = max(before.largest, after.largest)
    return float(np.hypot(*(after.total - before.total - given))) / (largest * time) if largest else 0.0


ENERGY_DRIFT = Drift(_energies, _energy_drift)
MOMENTUM_DRIFT = Drift(_momenta, _momentum_drift)


# --- The registry of all quantities that runs and trade-off studies can measure
#
# A run measures by three kinds of functions. *Counted* ones take sums that the kernels keep for each frame on request:
# impulses on walls and between discs, overlaps. *Sampled* ones are functions of a state; the run averages their values
# at fixed frames. *Drifts* compare the final state with the initial one and with the counts in between.

Error = Literal["relative", "difference", "mean", "largest", "depth", "distribution", "short"]
"""How a trade-off study takes the error of an observable from runs of a candidate and of the reference.

relative: as a fraction of the reference's value. difference: from that value. mean, largest: the observable itself,
which is 0 in an exact run by definition; its mean, or its largest value. depth: likewise, the mean over overlapping
pairs. distribution: the largest difference of two cumulative distributions. short: from two short runs with one start.
"""


Needs = Literal["nothing", "discs", "motion"]
"""What a sampled observable is undefined without: nothing, as a sum over discs; any disc; any disc that moves."""


_NEEDED: dict[Needs, Callable[[Discs], bool]] = {
    "nothing": lambda discs: True,
    "discs": any_present,
    "motion": any_moves,
}


def _never(run: Run) -> bool:
    return False


def _with_energy(run: Run) -> bool:
    """Of what depends only on the kinetic energy and the discs."""
    return conserves_energy(run.scene)


def _of_one_disc(run: Run) -> bool:
    """Of what collisions change: they need two discs."""
    return run.count == 1 and conserves_energy(run.scene)


@dataclass(frozen=True)
class Observable:
    """What is known about one observable.

    Attributes:
        counted, sampled, drift: the function, of one of the kinds; none of them where only a trade-off study has it.
        constant: whether physics keeps a sampled value constant in a run. If not, which is the default, a series that
            has not changed so far may still change, and its error is unknown.
        needs: what a sampled value requires to be defined; without it the value is NaN, and the run continues.
        error: how a trade-off study computes its error; None: it does not.
        unit: of that error; "%" for a dimensionless quantity.
    """

    counted: Callable[[Counts, Run], Measure] | None = None
    sampled: Callable[[Discs, Scene], float] | None = None
    drift: Drift | None = None
    constant: Callable[[Run], bool] = _never
    needs: Needs = "motion"
    error: Error | None = None
    unit: str = "%"

    def sample(self, discs: Discs, scene: Scene) -> float:
        """The sampled value of a state; NaN where it is undefined."""
        assert self.sampled is not None  # `SAMPLED` has no other
        return self.sampled(discs, scene) if _NEEDED[self.needs](discs) else float("nan")


OBSERVABLES: dict[str, Observable] = {
    "pressure": Observable(counted=pressure, error="relative"),
    "pressure_virial": Observable(counted=pressure_virial),
    "pressure_xx": Observable(counted=pressure_xx),
    "pressure_yy": Observable(counted=pressure_yy),
    "pressure_xy": Observable(counted=pressure_xy),
    "collision_rate": Observable(counted=contact_rate, error="relative"),
    "contact_rate": Observable(counted=contact_rate),
    "energy_drift": Observable(drift=ENERGY_DRIFT, error="difference", unit="1/time"),
    "momentum_drift": Observable(drift=MOMENTUM_DRIFT, error="mean", unit="1/time"),
    "overlap": Observable(counted=overlap, error="depth", unit="diam."),
    "largest_overlap": Observable(counted=largest_overlap, error="largest", unit="diam."),
    "kinetic_energy": Observable(sampled=observables.kinetic_energy, constant=_with_energy, needs="nothing"),
    "temperature": Observable(sampled=observables.temperature, constant=_with_energy, needs="discs"),
    "speed_kurtosis": Observable(
        sampled=lambda state, scene: observables.speed_kurtosis(state), constant=_of_one_disc, needs="motion"
    ),
    "speed_distribution": Observable(error="distribution"),
    "trajectory": Observable(error="short", unit="diam."),
    "missed_collisions": Observable(error="short"),
}
"""In the order of the columns of a trade-off study."""

COUNTED = {name: each.counted for name, each in OBSERVABLES.items() if each.counted}
SAMPLED = {name: each.sample for name, each in OBSERVABLES.items() if each.sampled}
DRIFTS = {name: each.drift for name, each in OBSERVABLES.items() if each.drift}

NAMES: tuple[str, ...] = (*COUNTED, *SAMPLED, *DRIFTS)
"""What a run can measure."""


def names() -> tuple[str, ...]:
    """What a run can measure, for modules below this one."""
    return NAMES


ERRORS: tuple[str, ...] = tuple(name for name, each in OBSERVABLES.items() if each.error)
"""What a trade-off study can measure the error of: LONG ones from long runs, SHORT ones from short ones."""

LONG: tuple[str, ...] = tuple(name for name in ERRORS if OBSERVABLES[name].error != "short")
SHORT: tuple[str, ...] = tuple(name for name in ERRORS if OBSERVABLES[name].error == "short")
