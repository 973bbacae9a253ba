"""Detects discs that are pressed into each other or into obstacles, which smaller steps cannot cure.

Because of steps discs overlap, by as much as they move in a few of them; discs that overlap more are pressed. Moving
walls, emitters and added discs can cause it. So scenes with these are checked, in the frames in which speeds are
checked too, and after the frame, as added discs may overlap others until then.
"""

import math

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.engine.solvers.base import Solver
from mpsim.features import FEATURES
from mpsim.measure.observables import Overlap, overlap
from mpsim.scene.placement import overlaps
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

Floats = NDArray[np.float64]

DEEP = 0.2
"""Overlap from which on discs are pressed, as a fraction of the smaller one's radius, beyond what steps explain."""

STEPS = 4.0
"""Steps at the rms speed that explain an overlap. In gases below the bounds of speed, at packings 0.3 to 0.78, the
deepest was 3.5 (docs/stability.md)."""

MEAN_OVERLAP = 0.1
"""Overlap for each disc, on average over all, as a fraction of the smallest radius, from which on they are pressed at
any speed, or steps are far too long. In those gases it was 0.015 at most, and 0.024 in lossy discs that a wall
holds at packing 0.785."""

CROWDED = 0.4
"""Packing of discs and capsules from which on all looks are taken. Discs between flat walls have room up to 0.54: two
of them in the smallest square. Below, a disc may still be caught between a moving wall and a capsule."""

SELDOM = 8
"""How many times rarer looks are below that packing."""

NONE = Overlap(0, 0.0, 0.0, None)


def may_be_pressed(scene: Scene, count: int) -> bool:
    """Whether discs can have come to lack room: by a moving wall, emitters, or added discs."""
    return scene.moving_wall is not None or bool(scene.emitters) or count > scene.count


def is_crowded(scene: Scene, radii: Floats, time: float) -> bool:
    """Whether discs and capsules fill so much of the box at a time that most discs can be pressed."""
    low, high = scene.walls_at(time)
    ax, ay, bx, by, radius = scene.capsules.T
    solid = math.pi * radius**2 + 2 * radius * np.hypot(bx - ax, by - ay)
    area = math.pi * float((radii * radii).sum()) + float(solid.sum())
    return area > CROWDED * float((high - low).prod())


def pressed(solver: Solver, scene: Scene, settings: Settings) -> str | None:
    """Which discs are pressed into each other or into a capsule now, and what to do, in words; None if none are."""
    state, radii = solver.state(), solver.radii
    if not state.present.any():
        return None
    displacement = np.hypot(*state.velocity.T.astype(np.float64)) * settings.dt / solver.substeps
    mean = float(np.sqrt((displacement[state.present] ** 2).mean()))
    found = overlap(state, scene, radii) if _overlap_at_all(state, scene, radii) else NONE
    words = _deepest_pair(found, radii, displacement, mean) or _into_capsules(state, scene, radii, displacement, mean)
    cause = "They were placed that way, or there is no room for them: smaller steps and on_fast='substep' do not help"
    if words is None:
        words = _most_of_them(found, radii[state.present])
        cause += ", or steps are far too long"
    if words is None:
        return None
    relief = ", ".join(sorted(feature.relief for feature in FEATURES if feature.relief))
    return (
        f"discs are pressed into each other: at time {solver.time:g} {words}, and discs move {mean:.3g} in a step on "
        f"average. {cause}. {relief[0].upper()}{relief[1:]}, or use smaller ones or a larger box."
    )


def _overlap_at_all(state: State, scene: Scene, radii: Floats) -> bool:
    """Whether overlaps are so deep, or so many, that the slow search is worth while."""
    here = state.present
    position, diameter = state.position[here].astype(np.float64), 2 * radii[here]
    common = float(diameter[0]) if (diameter == diameter[0]).all() else diameter
    pairs, _, depth = overlaps(position, scene.width, scene.height, common, scene.periodic)
    smallest = 0.5 * float(diameter.min())
    return depth > DEEP * smallest or pairs * depth > MEAN_OVERLAP * smallest * len(position)


def _deepest_pair(found: Overlap, radii: Floats, displacement: Floats, mean: float) -> str | None:
    if found.worst is None:
        return None
    i, j = found.worst
    smaller = float(min(radii[i], radii[j]))
    if found.largest <= DEEP * smaller + STEPS * max(mean, float(displacement[[i, j]].max())):
        return None
    return f"discs {i} and {j} overlap by {found.largest:.3g}, {found.largest / smaller:.2g} of a radius"


def _most_of_them(found: Overlap, radii: Floats) -> str | None:
    if found.worst is None or found.pairs * found.mean <= MEAN_OVERLAP * float(radii.min()) * len(radii):
        return None
    i, j = found.worst
    return (
        f"{found.pairs} pairs overlap by {found.mean:.3g} on average, discs {i} and {j} deepest, by {found.largest:.3g}"
    )


def _into_capsules(state: State, scene: Scene, radii: Floats, displacement: Floats, mean: float) -> str | None:
    if not len(scene.capsules):
        return None
    discs = np.flatnonzero(state.present)
    position = state.position[discs].astype(np.float64)
    found = scene.deepest(position, radii[discs])
    if found is None:
        return None
    disc, depth = int(discs[found.disc]), found.depth
    if depth <= DEEP * radii[disc] + STEPS * max(mean, float(displacement[disc])):
        return None
    return f"disc {disc} is {depth:.3g} deep in {found.where}, {depth / radii[disc]:.2g} of its radius"
