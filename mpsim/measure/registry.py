"""The registry of all quantities that runs and trade-off studies can measure.

A run measures by three kinds of functions. *Counted* ones take sums that the kernels keep for each frame on request:
impulses on walls and between discs, overlaps. *Sampled* ones are functions of a state; the run averages their values at
fixed frames. *Drifts* compare the final state with the initial one and with the counts in between.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from mpsim.core.state import Discs
from mpsim.measure import counted, observables
from mpsim.measure.counted import Counts, Run
from mpsim.measure.drifts import ENERGY_DRIFT, MOMENTUM_DRIFT, Drift
from mpsim.measure.driving import conserves_energy
from mpsim.measure.moments import any_moves, any_present
from mpsim.measure.statistics import Measure
from mpsim.scene.scene import Scene

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
    "pressure": Observable(counted=counted.pressure, error="relative"),
    "pressure_virial": Observable(counted=counted.pressure_virial),
    "pressure_xx": Observable(counted=counted.pressure_xx),
    "pressure_yy": Observable(counted=counted.pressure_yy),
    "pressure_xy": Observable(counted=counted.pressure_xy),
    "collision_rate": Observable(counted=counted.contact_rate, error="relative"),
    "contact_rate": Observable(counted=counted.contact_rate),
    "energy_drift": Observable(drift=ENERGY_DRIFT, error="difference", unit="1/time"),
    "momentum_drift": Observable(drift=MOMENTUM_DRIFT, error="mean", unit="1/time"),
    "overlap": Observable(counted=counted.overlap, error="depth", unit="diam."),
    "largest_overlap": Observable(counted=counted.largest_overlap, error="largest", unit="diam."),
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
