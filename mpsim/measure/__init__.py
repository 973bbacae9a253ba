"""Measuring how right a run is: functions of states, statistics, closed forms and published values.

`reference` and `reference_motion` hold the values; `benchmark` (how fast a run is) is not imported here.
"""

from mpsim.measure import reference, reference_motion
from mpsim.measure.correlation import PairCorrelation, pair_correlation
from mpsim.measure.observables import (
    Overlap,
    SpeedDistribution,
    TrajectoryError,
    kinetic_energy,
    mean_squared_displacement,
    momentum,
    overlap,
    potential_energy,
    speed_distribution,
    speed_kurtosis,
    temperature,
    trajectory_error,
)
from mpsim.measure.predictability import Predictability, comparable_until, predictability, require_predictable
from mpsim.measure.statistics import (
    Measure,
    block_average,
    block_errors,
    fit_order,
    independent_average,
    ratio_average,
)

__all__ = [
    "Measure",
    "Overlap",
    "PairCorrelation",
    "Predictability",
    "SpeedDistribution",
    "TrajectoryError",
    "block_average",
    "block_errors",
    "comparable_until",
    "fit_order",
    "independent_average",
    "kinetic_energy",
    "mean_squared_displacement",
    "momentum",
    "overlap",
    "pair_correlation",
    "potential_energy",
    "predictability",
    "ratio_average",
    "reference",
    "reference_motion",
    "require_predictable",
    "speed_distribution",
    "speed_kurtosis",
    "temperature",
    "trajectory_error",
]
