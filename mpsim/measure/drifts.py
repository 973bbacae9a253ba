"""Drifts of conserved quantities, from the first and last state of a run and the counts in between."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import Discs
from mpsim.measure import moments, observables
from mpsim.measure.counted import Counts, Run
from mpsim.scene.scene import Scene


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
