"""Optional features of a scene: a module for each, and the list of them."""

from mpsim.features.baths import ThermalWallsFeature, ThermostatFeature
from mpsim.features.emitters import Absorption, Emitters
from mpsim.features.feature import Feature, PerDisc
from mpsim.features.obstacles import OBSTACLES
from mpsim.features.piston import PISTON
from mpsim.features.properties import Acceleration, Friction, Gravity, Masses, Radii, Restitution

FEATURES: tuple[Feature, ...] = (
    Radii(),
    Masses(),
    Gravity(),
    Acceleration(),
    Restitution(),
    OBSTACLES,
    PISTON,
    Absorption(),
    Emitters(),
    Friction(),
    ThermostatFeature(),
    ThermalWallsFeature(),
)

NUMBERS: dict[str, float] = {name: each for feature in FEATURES for name, each in feature.numbers.items()}
"""Arguments of Scene that are a number of a feature, and their defaults."""

VECTORS: tuple[str, ...] = tuple(name for feature in FEATURES for name in feature.vectors)
"""Arguments of Scene that are (x, y) of a feature, None where the scene has none."""

PER_DISC: dict[str, PerDisc] = {
    name: each
    for feature in FEATURES
    for name, each in (
        {column.name: PerDisc(column.one_each) for column in feature.columns if column.given} | feature.per_disc
    ).items()
}
"""Arguments of Scene that are a value for each disc of a feature, None where the scene has none."""
