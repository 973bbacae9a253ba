"""Edges that absorb discs: an absorbed disc keeps its number, stays where it left, and no longer collides."""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from mpsim.core import checks
from mpsim.core.columns import EXITS, Column
from mpsim.features.edges import EDGES, demand_wall
from mpsim.features.feature import NEED_ALL_DISCS, Feature, Invalidation

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene


class Absorption(Feature):
    """The argument `absorbing`."""

    argument = "absorbing"
    removes_discs = True
    columns: ClassVar[tuple[Column, ...]] = (EXITS,)
    invalidates: ClassVar[tuple[Invalidation, ...]] = (
        Invalidation(
            NEED_ALL_DISCS,
            "absorbing edges, as the number of discs changes",
            "Run until none leaves any more, and measure in a scene without those edges that is made of sim.state.",
        ),
    )

    def has_columns(self, scene: Scene) -> bool:
        return scene._loses_discs

    def description(self, scene: Scene) -> str:
        return ", ".join(scene.absorbing)


def check_edges(absorbing: object, boundary: tuple[str, str]) -> tuple[str, ...]:
    """Names of edges that absorb discs; they must be walls."""
    each_of: Any = absorbing
    names = (each_of,) if isinstance(each_of, str) or not hasattr(each_of, "__iter__") else tuple(each_of)
    for name in names:
        checks.choice("absorbing", name, EDGES)
        demand_wall("absorbing", name, boundary)
    return tuple(dict.fromkeys(names))
