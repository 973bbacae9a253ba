"""Drifts: what the final state of a run and the counts in between say about its conservation laws."""

import numpy as np

from mpsim.core.state import State
from mpsim.measure import observables
from mpsim.measure.counted import Counts, Run


def energy_drift(counts: Counts, run: Run, before: State, after: State) -> float:
    """Change of kinetic plus potential energy per time, over the larger of both kinetic energies [1/time]."""
    kinetic = [observables.kinetic_energy(state, run.scene) for state in (before, after)]
    potential = [observables.potential_energy(state, run.scene) for state in (before, after)]
    change = kinetic[1] - kinetic[0] + potential[1] - potential[0]
    return change / (max(kinetic) * run.dt * len(counts)) if max(kinetic) else 0.0


def momentum_drift(counts: Counts, run: Run, before: State, after: State) -> float:
    """Change of momentum that is not due to walls or gravity, per time, over the sum of m |v| [1/time], >= 0.

    Newton's third law keeps it at rounding; `reflect` violates that law. The larger sum of both states is taken.
    """
    left, right, bottom, top = counts["wall"].sum(axis=0)
    time, given = run.dt * len(counts), np.array([left - right, bottom - top])
    masses = 1.0 if run.scene.mass is None else run.scene.mass
    if run.scene.gravity is not None:
        given += (run.count if run.scene.mass is None else run.scene.mass.sum()) * run.scene.gravity * time
    if run.scene.acceleration is not None:
        given += (run.scene.acceleration.T * masses).sum(axis=1) * time
    gained = observables.momentum(after, run.scene) - observables.momentum(before, run.scene)
    momenta = max(float((masses * np.hypot(*state.velocity.astype(float).T)).sum()) for state in (before, after))
    return float(np.hypot(*(gained - given))) / (momenta * time) if momenta else 0.0
