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
    trajectory_error,
)
from mpsim.measure.order import (
    HexaticCorrelation,
    HexaticOrder,
    PairCorrelation,
    StructureFactor,
    hexatic_correlation,
    hexatic_order,
    pair_correlation,
    structure_factor,
    to_freud,
)
from mpsim.measure.statistics import (
    Equilibration,
    Measure,
    Predictability,
    block_average,
    block_errors,
    comparable_until,
    equilibration,
    fit_order,
    independent_average,
    predictability,
    ratio_average,
    require_predictable,
)

__all__ = [
    "Equilibration",
    "HexaticCorrelation",
    "HexaticOrder",
    "Measure",
    "Overlap",
    "PairCorrelation",
    "Predictability",
    "Series",
    "SpeedDistribution",
    "StructureFactor",
    "TimeCorrelation",
    "TrajectoryDeviation",
    "block_average",
    "block_errors",
    "comparable_until",
    "equilibration",
    "fit_order",
    "hexatic_correlation",
    "hexatic_order",
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
    "require_predictable",
    "rotational_energy",
    "speed_distribution",
    "speed_kurtosis",
    "structure_factor",
    "temperature",
    "to_freud",
    "trajectory_error",
]


calls.explain_wrong_calls(sys.modules[__name__], __all__)
