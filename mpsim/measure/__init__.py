"""Observables of states, statistics, and in `reference` closed forms and published values."""

import sys

from mpsim.core import calls
from mpsim.measure import reference
from mpsim.measure.correlations import Series, TimeCorrelation
from mpsim.measure.observables import (
    Overlap,
    SpeedDistribution,
    TrajectoryDeviation,
    kinetic_energy,
    mean_squared_displacement,
    momentum,
    overlap,
    potential_energy,
    rotational_energy,
    speed_distribution,
    speed_kurtosis,
    temperature,
    to_freud,
    trajectory_error,
)
from mpsim.measure.statistics import (
    Equilibration,
    Measure,
    block_average,
    block_errors,
    equilibration,
    independent_average,
    ratio_average,
)

__all__ = [
    "Equilibration",
    "Measure",
    "Overlap",
    "Series",
    "SpeedDistribution",
    "TimeCorrelation",
    "TrajectoryDeviation",
    "block_average",
    "block_errors",
    "equilibration",
    "independent_average",
    "kinetic_energy",
    "mean_squared_displacement",
    "momentum",
    "overlap",
    "potential_energy",
    "ratio_average",
    "reference",
    "rotational_energy",
    "speed_distribution",
    "speed_kurtosis",
    "temperature",
    "to_freud",
    "trajectory_error",
]


calls.explain_wrong_calls(sys.modules[__name__], __all__)
