"""Where discs enter and leave: emitters, which are checked when made and immutable, and absorbing edges."""

# pyright: reportPrivateUsage=false, reportUnnecessaryIsInstance=false
# Names of Scene with an underscore are for all of mpsim; arguments are checked for callers without a type checker, too.

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, fields
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mpsim.core import checks
from mpsim.core.columns import EXITS, Column
from mpsim.errors import InputError
from mpsim.features.capsules import check_clear
from mpsim.features.edges import EDGES, demand_wall
from mpsim.features.feature import NEED_ALL_DISCS, Feature, Invalidation

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene

# --- Emitters: places where discs enter


@dataclass(frozen=True)
class Emitter:
    """A place at which discs enter, one after the other.

    With `interval`, disc k enters at time k * interval, for any time step and method. The exact solver stops at that
    time. The other methods add the disc at the end of the frame, after a free flight: at position + v s + g s^2/2 with
    velocity v + g s, where s is the time since it entered and g the scene's gravity. A flight that reaches a wall or an
    obstacle ends there.

    With `every`, a disc enters once every `every` frames, so the scene depends on dt.

    A disc whose place is occupied waits and delays the discs after it, which is reported once by an EmitterWarning. It
    tries again every interval / 8 (with `every`: before each frame).

    Args:
        position: centre of the new disc (x, y) [length], a radius from walls and capsules. Once a moving wall has
            passed it, no more discs enter, and a warning says so.
        velocity: of the new disc v (vx, vy) [length/time].
        interval: time between two discs [time], > 0.
        every: frames between two discs, >= 1, instead of interval.
        limit: total number of discs, >= 1; None: no limit.
        radius, mass: of the new discs [length], [mass]; None: those of the scene, if all its discs share one.

    Raises:
        InputError: naming the argument, its rule and the value received; both or neither of interval and every.

    >>> Emitter(position=(1, 2), velocity=(3, 0), interval=0.25, limit=5)
    Emitter(position=(1.0, 2.0), velocity=(3.0, 0.0), interval=0.25, limit=5, radius=None, mass=None)
    """

    position: ArrayLike
    velocity: ArrayLike
    _: KW_ONLY
    interval: float | None = None
    every: int | None = None
    limit: int | None = None
    radius: float | None = None
    mass: float | None = None

    def __post_init__(self) -> None:
        checks.keep_fields(self, position=checks.point, velocity=checks.point)
        if (self.interval is None) == (self.every is None):
            both = f"both, {checks.brief(self.interval)} and {checks.brief(self.every)}"
            raise InputError(
                "an Emitter must have either interval, the time between two discs, or every, the frames between two; "
                f"got {'neither' if self.interval is None else both}. Give one of them."
            )
        checks.keep_fields(
            self,
            interval="[time]",
            every=partial(checks.whole, low=1, high=10**12, remedy="One disc every `every` frames."),
            limit=partial(checks.whole, low=1, high=10**8, remedy="Leave it out for no end."),
            radius="[length]",
            mass="[mass]",
        )

    def __repr__(self) -> str:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        del values["every" if self.every is None else "interval"]  # a scene's digest depends only on what it uses
        return f"Emitter({', '.join(f'{name}={value!r}' for name, value in values.items())})"


class Emitters(Feature):
    """The argument `emitters`."""

    argument = "emitters"
    kinds: ClassVar[tuple[type[Any], ...]] = (Emitter,)
    examples: ClassVar[tuple[Any, ...]] = (Emitter((0, 0), (0, 0), interval=1), Emitter((0, 0), (0, 0), every=1))
    adds_discs = True
    drives = "emitters"
    relief = "let fewer discs enter"
    invalidates: ClassVar[tuple[Invalidation, ...]] = (
        Invalidation(
            NEED_ALL_DISCS,
            "emitters, as the number of discs changes",
            "Run until they have ended, and measure in a scene without them that is made of sim.state.",
        ),
    )

    def check(self, scene: Scene) -> None:
        emitters: tuple[Emitter, ...] = self.of(scene)
        for name, common in (("radius", np.ndim(scene.radius) == 0), ("mass", scene.mass is None)):
            lacking = [] if common else [index for index, each in enumerate(emitters) if getattr(each, name) is None]
            if lacking:
                raise InputError(f"emitters[{lacking[0]}] must have a {name}, as each disc of the scene; got None.")
        position = np.array([each.position for each in emitters])
        radius = np.array([scene.radius if each.radius is None else each.radius for each in emitters])
        scene._check_inside("the position of emitters", position, radius)
        check_clear(scene._deepest(position, radius), "the position of emitters", position, radius)

    def description(self, scene: Scene) -> str:
        words: list[str] = []
        for emitter in self.of(scene):
            limit = "no end" if emitter.limit is None else f"{emitter.limit} in all"
            often = f"every {emitter.interval:g} of time" if emitter.every is None else f"every {emitter.every} frames"
            words.append(f"one disc {often}, {limit}")
        return "; ".join(words)


# --- Edges that absorb: an absorbed disc keeps its number, stays where it left, and no longer collides


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
