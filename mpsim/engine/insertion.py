"""Discs that are added to a simulation: checked against the scene before anything is changed."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.errors import InputError
from mpsim.engine.columns import columns_of, has_masses
from mpsim.engine.feature_arrays import has_radii
from mpsim.features import FEATURES, feature
from mpsim.features.friction import spins
from mpsim.scene.scene import Scene

Floats = NDArray[np.float64]


class NewDiscs(NamedTuple):
    """K discs: position, velocity, acceleration and image of shape (K, 2), radius, mass and spin of shape (K,).

    Acceleration and spin are None where none was given; radius and mass are those of all discs in a scene without own
    ones.
    image: periodic borders that each has crossed before it entered, as in State.
    """

    position: Floats
    velocity: Floats
    acceleration: Floats | None
    radius: Floats
    mass: Floats
    image: NDArray[np.int64]
    spin: Floats | None = None


def checked(
    scene: Scene,
    precision: str,
    time: float,
    present: Floats,
    position: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike | None,
    radius: ArrayLike | None,
    mass: ArrayLike | None,
    spin: ArrayLike | None = None,
) -> NewDiscs:
    """What `Simulation.add` was given, as arrays.

    Args:
        scene, precision: of the simulation.
        time: at which they are added [time].
        present: radii of the discs that are there, shape (N,) [length].
        position, velocity, acceleration, radius, mass, spin: what was given.

    Raises:
        InputError: naming the argument, its rule and the value received.
    """
    places = checks.finite_array("position", np.atleast_2d(position), (None, 2), "(2,) or (K, 2)")
    shape, meaning = (len(places), 2), f"({len(places)}, 2), as position has"
    speeds = checks.finite_array("velocity", np.atleast_2d(velocity), shape, meaning)
    kicks = None
    if acceleration is not None:
        if scene.acceleration is None:
            raise InputError(
                "acceleration can be given for added discs only in a scene that has acceleration per disc; this "
                f"one has none, and got {acceleration!r}. Give the scene acceleration=numpy.zeros((N, 2))."
            )
        kicks = checks.finite_array("acceleration", np.atleast_2d(acceleration), shape, meaning)
    radii = _one_each("radius", radius, scene.largest_radius, len(places), has_radii(scene))
    masses = _one_each("mass", mass, 1.0, len(places), has_masses(scene))
    _check_room(scene, time, present, "position", places, radii)
    checks.fitting("velocity", speeds, precision)
    turns = None if spin is None else _spins(scene, precision, spin, len(places))
    return NewDiscs(places, speeds, kicks, radii, masses, np.zeros(shape, np.int64), turns)


def _spins(scene: Scene, precision: str, spin: ArrayLike, count: int) -> Floats:
    """Spins of added discs, shape (count,)."""
    if not any(column.name == "spin" for column in columns_of(scene)):
        raise InputError(
            f"spin can be given for added discs only in a scene of rough discs; here they are smooth, and got "
            f"{checks.brief(spin)}. Give the scene friction, wall_friction or spin."
        )
    turns = spins("spin", spin, count)
    checks.fitting("spin", turns, precision)
    return turns


def _check_room(scene: Scene, time: float, present: Floats, name: str, position: Floats, radius: Floats) -> None:
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
        _check_room(scene, time, present, name, position[None], np.array([radius]))
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
    each = np.full(count, value) if np.ndim(value) == 0 else value
    array = checks.finite_array(name, each, (count,), f"() or ({count},)")
    largest = common if name == "radius" else math.inf
    if (array <= 0).any() or (array > largest).any():
        limit = f" and at most that of the scene's largest disc, {largest:g}" if name == "radius" else ""
        raise InputError(f"{name} of added discs must be > 0{limit}; got {array.tolist()}.")
    return array
