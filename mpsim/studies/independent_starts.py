"""Independent starts of a scene, over which a trade-off study averages."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

import dataclasses
import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mpsim.core.state import State
from mpsim.errors import InputError
from mpsim.features.emitters import Emitter
from mpsim.scene import placement
from mpsim.scene.scene import Scene

VARIATION = 1e-3
"""Displacement of a disc, in diameters of the smallest, and relative change of its velocity, between two variations of
one start: too small to matter, large enough for collisions to decorrelate them soon."""

KINDS = ("kind", "same")

StartsGiven = str | Callable[[int], Scene] | Sequence[Scene] | None
"""The argument `starts`: see `Starts`."""


class Starts:
    """Numbered starts of one scene. The same number always gives the same start.

    For "kind" and "same", number 0 is the scene itself.

    Args:
        scene: the scene.
        given: "kind": other starts of the same kind (`Scene.redrawn`); "same": this start with small variations
            (VARIATION); a function from a number to a Scene, or a list of Scenes; None: "kind" if the scene knows how
            it was made, else "same".

    Attributes:
        name: the starts in words.
        key: a text that identifies the starts; functions are distinguished by the first two starts that they make.
        same: whether they are variations of one start, so that their runs are initially correlated.
        number: of starts; None if there is no limit.

    Raises:
        InputError: if the scene has no other starts, or `given` is not one of these.
    """

    def __init__(self, scene: Scene, given: StartsGiven = None):
        kind = ("kind" if scene.can_redraw else "same") if given is None else given
        if isinstance(kind, str) and kind not in KINDS:
            raise InputError(f"starts must be 'kind', 'same', a function or a list of Scenes; got {given!r}.")
        self.same: bool = isinstance(kind, str) and kind == "same"
        self.number: int | None = None
        self._made: dict[int, Scene] = {}
        if callable(kind):
            self._make: Callable[[int], Scene] = _of_one_number(kind)
            self.name: str = "starts that were given by a function"
        elif isinstance(kind, str) and kind == "kind":
            self._made = {0: scene, 1: scene.redrawn(1)}  # which raises if there is no other
            self._make = scene.redrawn
            self.name = "other starts of the same kind"
        elif isinstance(kind, str):
            self._made, self._make = {0: scene}, functools.partial(varied, scene)
            self.name = f"this start, each disc displaced by up to {VARIATION:g} of a diameter"
        else:
            chosen = _listed(kind)
            self._made = dict(enumerate(chosen))
            self._make = lambda number: _too_few(len(chosen), number)
            self.number = len(chosen)
            self.name = f"the {len(chosen)} starts that were given"
        known = [] if isinstance(kind, str) else [self[number] for number in range(self.number or 2)]
        self.key: str = " ".join([self.name, *(each.digest() for each in known)])

    def __getitem__(self, number: int) -> Scene:
        """The start of a number, >= 0.

        Raises:
            InputError: if what was given for it is not a Scene, or there are too few starts.
        """
        if number not in self._made:
            made: Any = self._make(number)
            if not isinstance(made, Scene):
                raise InputError(f"starts must give Scenes; for {number} it gave {type(made).__name__}.")
            self._made[number] = made
        return self._made[number]


def varied(scene: Scene, seed: int) -> Scene:
    """The scene with positions and velocities varied by VARIATION, at the same kinetic energy.

    Displacements that would lead to an overlap, or out of the box, are rejected. Emitters are varied likewise.
    """
    rng = np.random.default_rng(seed)
    moves = rng.uniform(-1, 1, (scene.count, 2)) * (VARIATION * 2 * scene.smallest_radius)
    solid = np.vstack([scene.capsules, *_wall_as_capsule(scene)])
    position = placement.displaced(
        scene.position, scene.radii, (scene.width, scene.height), scene.periodic, solid, moves
    )
    velocity = scene.velocity * (1 + VARIATION * rng.normal(size=scene.velocity.shape))
    masses = 1.0 if scene.mass is None else scene.mass[:, None]
    energy = float((masses * velocity**2).sum())
    if energy > 0:
        velocity *= np.sqrt(float((masses * scene.velocity**2).sum()) / energy)
    common = scene.largest_radius
    emitters = tuple(_varied_emitter(scene, emitter, common, rng) for emitter in scene.emitters)
    return scene.starting_from(State(position, velocity)).replace(emitters=emitters)


def _wall_as_capsule(scene: Scene) -> list[list[float]]:
    """A capsule along the start of a moving wall, which discs must not overlap."""
    wall = scene.moving_wall
    if wall is None:
        return []
    (left, bottom), (right, top) = scene.walls_at(0.0)
    ends = (
        (left, bottom, left, top),
        (right, bottom, right, top),
        (left, bottom, right, bottom),
        (left, top, right, top),
    )
    return [[*ends[wall.edge], 0.0]]


def _varied_emitter(scene: Scene, emitter: Emitter, common: float, rng: np.random.Generator) -> Emitter:
    """The emitter with varied position and velocity; it stays where it is if the new disc would overlap a capsule."""
    radius = common if emitter.radius is None else emitter.radius
    before, speed = np.array(emitter.position), np.array(emitter.velocity)
    place = np.clip(before + rng.uniform(-1, 1, 2) * VARIATION * 2 * radius, *scene.limits(radius))
    if scene.deepest(place[None], np.array([radius])) is not None:
        place = before
    return dataclasses.replace(emitter, position=place, velocity=speed * (1 + VARIATION * rng.normal(size=2)))


def _listed(given: Any) -> list[Scene]:
    try:
        chosen = list(given)
    except TypeError:
        chosen = []
    if len(chosen) < 2 or not all(isinstance(each, Scene) for each in chosen):
        raise InputError(f"starts must be 'kind', 'same', a function or a list of two Scenes or more; got {given!r}.")
    return chosen


def _of_one_number(given: Callable[[int], Scene]) -> Callable[[int], Scene]:
    try:
        inspect.signature(given).bind(0)
    except TypeError as error:
        raise InputError(
            f"starts must be a function of one number, from 0 on, that returns a Scene; got {given!r} ({error})."
        ) from None
    except ValueError:  # one without a signature, as some of C have
        pass
    return given


def _too_few(there: int, number: int) -> Scene:
    raise InputError(
        f"starts must hold a Scene for every run; {there} were given, and number {number} is needed. Give a function "
        "that makes them, or fewer replicas."
    )
