"""The list of all features in scene files."""

from mpsim.features import FEATURES
from mpsim.scene.scenefile.emitters import EmittersPart
from mpsim.scene.scenefile.obstacles import ObstaclesPart
from mpsim.scene.scenefile.part import Part, SinglePart

PARTS: tuple[Part, ...] = (
    ObstaclesPart(),
    EmittersPart(),
    *(SinglePart(feature) for feature in FEATURES if feature.keys),
)
