"""A scene that continues from a state of a run of it: with what the present discs have at that time."""

from collections.abc import Callable, Mapping
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.state import State, no_state
from mpsim.errors import InputError
from mpsim.features import FEATURES
from mpsim.features.emitters import check_emitters
from mpsim.features.fields import check_gravity
from mpsim.features.obstacles import check_obstacles
from mpsim.features.piston import check_piston
from mpsim.scene.walls import placed


def move_to_state(scene: Any, state: State) -> None:
    """Change a scene, a copy that nothing else refers to, so that it starts from a state: see `Scene.starting_from`.

    Raises:
        InputError: if the number of discs differs, or a number is not finite.
    """
    if not isinstance(state, State):  # pyright: ignore[reportUnnecessaryIsInstance] - callers without a checker
        raise no_state("state must be a State", state)
    count, shape, meaning = scene.count, (scene.count, 2), f"({scene.count}, 2)"
    if len(state.position) != count:
        raise InputError(
            f"a state for starting_from must hold the scene's {count} discs; got {len(state.position)}. "
            "Make a new Scene for another number of discs."
        )
    written, state = state.position[state.present], placed(state, scene)
    position = checks.finite_array("position", state.position, shape, meaning)
    velocity = checks.finite_array("velocity", state.velocity, shape, meaning)
    for feature in [each for each in FEATURES if each.is_in(scene)]:
        if state.box is not None:
            vars(scene)[feature.argument] = feature.continued(scene, state.box)
        for column in feature.columns:
            if column.given and column.in_state and (values := getattr(state, column.name)) is not None:
                shape = column.rows(count)
                vars(scene)[column.name] = checks.finite_array(column.name, values, shape, f"{shape}")
    vary(scene, lambda: f"state {state.digest()}")
    _keep(scene, state.present)
    low, high = scene.limits(scene.radius)
    inside = np.clip(position[state.present], low, high)
    rounding = 8 * checks.resolution(written) * np.abs(written).max(initial=max(scene.width, scene.height))
    moved = np.abs(inside - position[state.present])
    scene.start_anew(np.where(moved <= rounding, inside, position[state.present]), velocity[state.present])
    for array in (scene.position, scene.velocity):
        array.flags.writeable = False


def vary(scene: Any, variation: Callable[[], str]) -> None:
    """Give a scene, a copy that nothing else refers to, other random numbers for its run, derived from a text."""
    for feature in FEATURES:
        if feature.draws and feature.is_in(scene):
            vars(scene)[feature.argument] = feature.redrawn(scene, variation())


CHANGEABLE: dict[str, Callable[[Any, Any], Any]] = {
    "gravity": lambda scene, value: check_gravity(value),
    "restitution": lambda scene, value: checks.fraction("restitution", value),
    "wall_restitution": lambda scene, value: checks.fraction("wall_restitution", value),
    "friction": lambda scene, value: value,
    "wall_friction": lambda scene, value: value,
    "obstacles": lambda scene, value: check_obstacles(value, scene.width, scene.height),
    "emitters": lambda scene, value: check_emitters(value),
    "piston": lambda scene, value: check_piston(value, scene.boundary, scene.width, scene.height, scene.absorbing),
    "piston_began": lambda scene, value: value,
    "thermostat": lambda scene, value: value,
    "thermal_walls": lambda scene, value: value,
    "has_gaps": lambda scene, value: value,
}
"""The arguments that `change_to` can change, and the check of each; the caller has checked those that are kept."""


def change_to(scene: Any, values: Mapping[str, Any]) -> None:
    """Give a scene, a copy that nothing else refers to, other values of some arguments.

    Raises:
        InputError: naming the argument, its rule and the value received.
    """
    for name, value in values.items():
        checks.choice("an argument of Scene.replace", name, CHANGEABLE)
        vars(scene)[name] = CHANGEABLE[name](scene, value)


def _keep(scene: Any, kept: NDArray[np.bool_]) -> None:
    """Keep what the discs of a mask, shape (count,), have of their own, and drop the others."""
    if kept.all():
        return
    for name, each in chain.from_iterable(feature.all_per_disc.items() for feature in FEATURES):
        values = getattr(scene, name)
        if isinstance(values, np.ndarray):
            vars(scene)[name] = each.check(values[kept], int(kept.sum()))
