"""Values of columns, and arrays, of a scene, which its features determine."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.workers.shared import Specs
from mpsim.features.feature import acceleration_bound, mean_mass, thermal_speed
from mpsim.features.properties import has_radii
from mpsim.kernels.records import PADDING, row_of
from mpsim.scene.scene import Scene


def given_in(scene: Scene) -> dict[str, Any]:
    """What a scene gives of its columns, by name; what it leaves out is zero."""
    values = {column.name: getattr(scene, column.name, None) for column in scene._columns if column.given}
    return {name: value for name, value in values.items() if value is not None}


# --- The arrays that features of a scene need in the shared block, and their initial values

FEW_GIANTS = 8  # discs that may be giants in any scene; in large ones, one in GIANTS_PER as well

GIANTS_PER = 500

GIANT = 2.0
"""A giant's radius is more than this times that of the largest disc of the grid: below, larger cells cost less."""


def giant_radius(radii: NDArray[np.float64]) -> float | None:
    """Radius above which discs are kept out of the grid, or None where no disc is far larger than all but a few.

    A function of the radii alone, so that the same discs are giants on every machine and after every resume.
    """
    most = FEW_GIANTS + len(radii) // GIANTS_PER
    if len(radii) <= 2 * most or radii.max() <= GIANT * radii.min():
        return None
    ordered = np.sort(radii)
    largest_of_the_grid = float(ordered[-most - 1])
    if ordered[-1] <= GIANT * largest_of_the_grid:
        return None
    return float(ordered[ordered <= GIANT * largest_of_the_grid][-1])


def feature_specs(scene: Scene, capacity: int, precision: str) -> Specs:
    """dtype and shape of every array that only this scene's features need."""
    real = np.dtype(precision)
    specs: Specs = {name: (each.dtype, each.shape) for name, each in _constant_in(scene, real).items()}
    specs |= {each.name: (each.dtype(real), each.shape(capacity)) for each in scene._columns}
    if has_radii(scene):
        specs |= {f"{buffer}.radius": (real, (capacity + PADDING,)) for buffer in "ab"}
        specs["giants"] = (real, (1,))
    return specs


def fill_features(arrays: dict[str, Any], scene: Scene) -> None:
    """Write what does not change with the number of discs."""
    for name, values in _constant_in(scene, arrays["parameters"].dtype["dt"]).items():
        (row_of(arrays[name]) if values.shape == () else arrays[name])[...] = values


def _constant_in(scene: Scene, real: np.dtype) -> dict[str, NDArray[Any]]:
    """What does not change with the number of discs, by name, with floats of dtype `real`."""
    axes = zip("xy", (scene.width, scene.height), scene.periodic, strict=True)
    arrays = {f"wrap_{axis}": np.array([length], real) for axis, length, wraps in axes if wraps}
    for feature in scene._features:
        arrays |= feature.arrays(scene, real)
    return arrays


def wall_limits(scene: Scene) -> tuple[float, float, float, float]:
    """Least and largest centre along x and y: the walls, a radius inwards where all discs have the same [length]."""
    margin = 0.0 if has_radii(scene) else scene.largest_radius
    x, y = (0.0 if wraps else margin for wraps in scene.periodic)
    return x, scene.width - x, y, scene.height - y


def _rms_momentum(scene: Scene) -> float:
    """Root mean square of the components of the momenta at the start; 0 without discs [mass length/time]."""
    squares = 0.0
    for first, velocity in scene._velocities_in_pieces():
        mass = None if scene.mass is None else scene.mass[first : first + len(velocity), None]
        squares += float(((velocity if mass is None else velocity * mass) ** 2).sum())
    return math.sqrt(squares / (2 * scene.count)) if scene.count else 0.0


def unit_of_work(scene: Scene, dt: float) -> float:
    """What the work of surfaces is counted in: a millionth of a typical energy, a power of two [energy]."""
    exponent = 2 * math.frexp(typical_momentum(scene, dt))[1] - math.frexp(mean_mass(scene))[1] - 20
    return math.ldexp(1.0, min(max(exponent, -900), 900))


def typical_momentum(scene: Scene, dt: float) -> float:
    """What impulses are counted in: a momentum like those that discs have or come to have [mass length/time], > 0.

    The largest of the mean at the start, that of a fall through the box, and those of discs that emitters, surfaces or
    a thermostat set in motion. Where nothing can move by itself: of one that moves its radius in a step of dt [time].
    """
    mass, fall = mean_mass(scene), math.sqrt(acceleration_bound(scene) * max(scene.width, scene.height))
    speeds = [fall, thermal_speed(scene), scene._driving_speed]
    momenta = [_rms_momentum(scene)]
    if scene.emitters:
        masses = np.array([1.0 if emitter.mass is None else emitter.mass for emitter in scene.emitters])
        velocities = np.array([emitter.velocity for emitter in scene.emitters], float)
        momenta += [float((masses * np.hypot(*velocities.T)).max()), float(masses.max()) * max(speeds)]
    momenta += [mass * speed for speed in speeds if scene.count]
    return max(momenta) or mass * (scene.largest_radius or 1.0) / dt
