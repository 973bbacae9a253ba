"""Restitution: the fraction of the normal velocity that remains after a contact."""

from typing import Any, ClassVar

from mpsim.features.feature import Feature, SceneLike


class Restitution(Feature):
    """The arguments `restitution` and `wall_restitution`."""

    argument = "restitution"
    several = False
    numbers: ClassVar[dict[str, tuple[float, str]]] = {
        "restitution": (1.0, "for two discs, 0 to 1"),
        "wall_restitution": (1.0, "for a disc and walls, obstacles or a piston, 0 to 1"),
    }

    def is_in(self, scene: SceneLike) -> bool:
        """Whether one of them is below 1."""
        return min(scene.restitution, scene.wall_restitution) < 1

    def cost_examples(self, side: float, pitch: float) -> dict[str, Any]:
        """Of two discs."""
        return {"restitution": 0.95}

    def brief(self, scene: SceneLike) -> str:
        """Nothing: the repr of a scene ends with them."""
        return ""

    def description(self, scene: SceneLike) -> str:
        """Both."""
        return f"{scene.restitution:g} of discs, {scene.wall_restitution:g} of walls"
