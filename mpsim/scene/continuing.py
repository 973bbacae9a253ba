"""A scene that continues from a state of a run of it: what the discs that are present have by then."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.errors import InputError
from mpsim.core.state import State
from mpsim.features import FEATURES, PER_DISC


def continue_from(scene: Any, state: State) -> None:
    """Let a scene, which is nobody else's yet, start from a state: see `Scene.starting_from`.

    Raises:
        InputError: if the number of discs differs, or a number is not finite.
    """
    count, shape, meaning = scene.count, (scene.count, 2), f"({scene.count}, 2)"
    if len(state.position) != count:
        raise InputError(
            f"a state for starting_from must hold the scene's {count} discs; got {len(state.position)}. "
            "Make a new Scene for another number of discs."
        )
    position = checks.finite_array("position", state.position, shape, meaning)
    velocity = checks.finite_array("velocity", state.velocity, shape, meaning)
    for feature in [each for each in FEATURES if each.is_in(scene)]:
        if state.box is not None:
            setattr(scene, feature.argument, feature.continued(scene, state.box))
        for name in feature.per_disc:
            if (values := getattr(state, name)) is not None:
                setattr(scene, name, checks.finite_array(name, values, (count,), f"({count},)"))
    _keep(scene, state.present)
    low, high = scene.limits(scene.radius)
    inside = np.clip(position[state.present], low, high)
    rounding = 8 * checks.resolution(position[state.present]) * max(scene.width, scene.height)
    moved = np.abs(inside - position[state.present])
    scene.position = np.where(moved <= rounding, inside, position[state.present])
    scene.velocity = velocity[state.present]
    for array in (scene.position, scene.velocity):
        array.flags.writeable = False


def _keep(scene: Any, kept: NDArray[np.bool_]) -> None:
    """Keep what the discs of a mask, shape (count,), have of their own, and drop the others."""
    if kept.all():
        return
    count = int(kept.sum())
    if isinstance(scene.radius, np.ndarray):
        scene.radius = checks.one_or_each("radius", scene.radius[kept], count, "[length]")
    if scene.mass is not None:
        scene.mass = checks.masses(scene.mass[kept], count)
    if scene.acceleration is not None:
        scene.acceleration = checks.finite_array("acceleration", scene.acceleration[kept], (count, 2), "(N, 2)")
    for name in PER_DISC:
        if (values := getattr(scene, name)) is not None:
            setattr(scene, name, checks.finite_array(name, values[kept], (count,), "(N,)"))
