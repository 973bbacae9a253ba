"""What a scene may have besides discs in a box: a module for each feature, and the list of them."""

from mpsim.features.absorption import Absorption
from mpsim.features.emitters import Emitter, Emitters
from mpsim.features.feature import Feature
from mpsim.features.obstacles import OBSTACLES, FixedDisc, Polyline
from mpsim.features.piston import PISTON, Piston

__all__ = ["FEATURES", "Emitter", "Feature", "FixedDisc", "Piston", "Polyline"]

FEATURES: tuple[Feature, ...] = (OBSTACLES, PISTON, Absorption(), Emitters())
