"""What a scene may have besides discs in a box: a module for each feature, and the list of them."""

from mpsim.features.absorption import Absorption
from mpsim.features.emitters import Emitter, Emitters
from mpsim.features.feature import Feature
from mpsim.features.friction import Friction
from mpsim.features.obstacles import OBSTACLES, FixedDisc, Polyline
from mpsim.features.piston import PISTON, Piston

__all__ = ["FEATURES", "NUMBERS", "PER_DISC", "Emitter", "Feature", "FixedDisc", "Piston", "Polyline"]

FEATURES: tuple[Feature, ...] = (OBSTACLES, PISTON, Absorption(), Emitters(), Friction())

NUMBERS: dict[str, tuple[float, str]] = {name: each for feature in FEATURES for name, each in feature.numbers.items()}
"""Arguments of Scene that are a number of a feature: default and meaning."""

PER_DISC: dict[str, str] = {name: meaning for feature in FEATURES for name, meaning in feature.per_disc.items()}
"""Arguments of Scene that are a number of each disc of a feature, None where the scene has none: their meaning."""
