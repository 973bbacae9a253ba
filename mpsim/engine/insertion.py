"""Discs that are added to a simulation: checked against the scene before anything is changed."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.columns import MASS, Column, check_names, given
from mpsim.engine.columns import columns_of
from mpsim.engine.solvers.base import NewDiscs
from mpsim.errors import InputError
from mpsim.features import FEATURES, feature
from mpsim.features.masses import has_masses
from mpsim.features.radii import has_radii
from mpsim.scene.scene import Scene

Floats = NDArray[np.float64]


def checked(
    scene: Scene,
    precision: str,
    time: float,
    present: Floats,
    position: ArrayLike,
    velocity: ArrayLike,
    radius: ArrayLike | None,
    mass: ArrayLike | None,
    others: Mapping[str, Any],
) -> NewDiscs:
    """What `Simulation.add` was given, as arrays.

    Args:
        scene, precision: of the simulation.
        time: at which they are added, as the scene counts it [time].
        present: radii of the discs that are there, shape (N,) [length].
        position, velocity, radius, mass: what was given.
        others: what was given of other columns, by name; None: nothing.

    Raises:
        InputError: naming the argument, its rule and the value received.
        UnknownArgumentError: for the name of no column that can be given.
    """
    check_names("Simulation.add", others, ("position", "velocity", "acceleration", "radius", "mass"), given())
    places = checks.finite_array("position", checks.rows(position), (None, 2), "(2,) or (K, 2)")
    count = len(places)
    speeds = checks.finite_array("velocity", checks.rows(velocity), (count, 2), f"({count}, 2), as position has")
    radii = _one_each("radius", radius, scene.largest_radius, count, has_radii(scene))
    masses = _one_each("mass", mass, 1.0, count, has_masses(scene))
    _check_new(scene, time, present, "position", places, radii)
    checks.fitting("velocity", speeds, precision)
    brought = {
        column.name: _brought(scene, precision, column, others[column.name], count)
        for column in given()
        if others.get(column.name) is not None
    }
    return NewDiscs(places, speeds, radii, {MASS.name: masses, **brought})


def arguments_of(scene: Scene, new: NewDiscs) -> dict[str, Any]:
    """The arguments of `Simulation.add` for discs that have been checked: those that it would be given."""
    found: dict[str, Any] = {"position": new.position, "velocity": new.velocity}
    found |= {"radius": new.radius} if has_radii(scene) else {}
    return found | {name: values for name, values in new.columns.items() if name != MASS.name or has_masses(scene)}


def _brought(scene: Scene, precision: str, column: Column, value: ArrayLike, count: int) -> Floats:
    """What was given of a column, as `Column.one_each`."""
    if column not in columns_of(scene):
        raise InputError(
            f"{column.name} can be given for added discs only in a scene {column.scenes}, and got "
            f"{checks.brief(value)}. {column.remedy}"
        )
    values = column.one_each(value, count)
    checks.fitting(column.name, values, precision)
    return values


def _check_new(scene: Scene, time: float, present: Floats, name: str, position: Floats, radius: Floats) -> None:
    """Refuse discs that are not in the box as it is now, or for which a feature of the scene leaves no room."""
    scene.check_inside(name, position, radius, time)
    new = feature.NewDiscs(name, position, radius, present)
    for each in FEATURES:
        each.check_room(scene, new)


def hindrance(scene: Scene, time: float, present: Floats, name: str, position: Floats, radius: float) -> str | None:
    """Why there is no room for a disc at a time, whoever is there: words for a warning, or None.

    Args:
        scene: in whose box it is to enter.
        time: at which it is to enter [time].
        present: radii of the discs that are there, shape (N,) [length].
        name: of the position, for the words.
        position, radius: of the disc, shape (2,) and () [length].
    """
    try:
        _check_new(scene, time, present, name, position[None], np.array([radius]))
    except InputError as error:
        return str(error)
    return None


def _one_each(name: str, value: ArrayLike | None, common: float, count: int, own: bool) -> Floats:
    """Radii or masses, shape (count,): the given ones where discs have their own, otherwise the common one."""
    if not own:
        if value is not None:
            raise InputError(
                f"{name} can be given for added discs only in a scene whose discs have one each; here all have "
                f"the same, and got {value!r}. Leave it out, or give the scene {name}=numpy.full(N, ...) with "
                "different values."
            )
        return np.full(count, common)
    if value is None:
        raise InputError(f"{name} must be given for added discs, as the discs of this scene have one each; got None.")
    each = np.full(count, value) if checks.dimensions(value) == 0 else value
    array = checks.finite_array(name, each, (count,), f"() or ({count},)")
    largest = common if name == "radius" else math.inf
    if (array <= 0).any() or (array > largest).any():
        limit = f" and at most that of the scene's largest disc, {largest:g}" if name == "radius" else ""
        raise InputError(f"{name} of added discs must be > 0{limit}; got {array.tolist()}.")
    return array
