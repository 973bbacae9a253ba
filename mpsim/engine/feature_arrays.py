"""The arrays that a scene's features need in the shared block, and what stands in them at the start."""

import math
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import Box
from mpsim.engine.workers.arrays import ArraySpec
from mpsim.features import capsules
from mpsim.features.edges import EDGES
from mpsim.kernels import layout
from mpsim.scene.scene import Scene

FEW_GIANTS = 8
"""Discs that may be giants in any scene; in large ones, one in GIANTS_PER as well."""

GIANTS_PER = 500

GIANT = 2.0
"""A giant's radius is more than this times that of the largest disc of the grid: below, larger cells cost less."""


_made: "weakref.WeakKeyDictionary[Scene, tuple[Any, dict[str, NDArray[Any]]]]" = weakref.WeakKeyDictionary()
"""`obstacle_arrays` of scenes that are in use, and what they were made of: each block asks for them twice."""


def has_radii(scene: Scene) -> bool:
    """Whether discs of the scene differ in size, those of its emitters included."""
    return np.ndim(scene.radius) > 0 or any(
        emitter.radius is not None and emitter.radius != scene.radius for emitter in scene.emitters
    )


def has_masses(scene: Scene) -> bool:
    """Whether discs of the scene have masses other than 1, those of its emitters included."""
    return scene.mass is not None or any(emitter.mass is not None and emitter.mass != 1 for emitter in scene.emitters)


def giant_radius(radii: NDArray[np.float64]) -> float | None:
    """Radius above which discs are kept out of the grid, or None where no disc is far larger than all but a few.

    A function of the radii alone, so that the same discs are giants on every machine and after every resume.
    """
    most = FEW_GIANTS + len(radii) // GIANTS_PER
    if len(radii) <= 2 * most:
        return None
    ordered = np.sort(radii)
    largest_of_the_grid = float(ordered[-most - 1])
    if ordered[-1] <= GIANT * largest_of_the_grid:
        return None
    return float(ordered[ordered <= GIANT * largest_of_the_grid][-1])


def feature_specs(scene: Scene, capacity: int, workers: int, precision: str) -> dict[str, ArraySpec]:
    """dtype and shape of every array that only this scene's features need."""
    real = np.dtype(precision)
    shapes: dict[str, tuple[int, ...]] = {}
    integers: dict[str, tuple[int, ...]] = {}
    if scene.gravity is not None:
        shapes["gravity"] = (2,)
    if scene.acceleration is not None:
        shapes["acceleration"] = (2, capacity)
    if has_masses(scene):
        shapes["mass"] = (capacity,)
    if has_radii(scene):
        shapes |= {f"{buffer}.radius": (capacity + layout.PADDING,) for buffer in "ab"}
        shapes["giants"] = (1,)
    for axis, boundary in zip("xy", scene.boundary, strict=True):
        if boundary == "periodic":
            shapes[f"wrap_{axis}"] = (1,)
            integers["image"] = (2, capacity)
    if scene.absorbing:
        shapes["exits"] = (3, capacity)
    if scene.piston is not None:
        shapes["piston"] = (layout.PISTON,)
    specs = {name: ArraySpec(real, shape) for name, shape in shapes.items()}
    specs |= {name: ArraySpec(np.dtype(np.int64), shape) for name, shape in integers.items()}
    for name, values in obstacle_arrays(scene).items():
        dtype = real if values.dtype.kind == "f" else values.dtype
        specs[f"obstacles.{name}"] = ArraySpec(np.dtype(dtype), values.shape)
    return specs


def fill_features(arrays: dict[str, Any], scene: Scene) -> None:
    """Write what does not change with the number of discs."""
    if scene.gravity is not None:
        arrays["gravity"][:] = scene.gravity
    for axis, length in (("wrap_x", scene.width), ("wrap_y", scene.height)):
        if axis in arrays:
            arrays[axis][0] = length
    for name, values in obstacle_arrays(scene).items():
        arrays[f"obstacles.{name}"][...] = values
    if scene.piston is not None:
        wall = EDGES.index(scene.piston.wall)
        inward = -1 if wall in (1, 3) else 1
        margin = 0.0 if has_radii(scene) else scene.largest_radius
        arrays["piston"][layout.PISTON_WALL] = layout.X_LOW + wall
        arrays["piston"][layout.PISTON_START] = scene.box[wall] + inward * margin
        arrays["piston"][layout.PISTON_SPEED] = scene.piston.speed
        arrays["piston"][layout.PISTON_STOP] = scene.piston.stop + inward * margin


def box_now(scene: Scene, arrays: dict[str, Any]) -> Box:
    """Where the walls are after the steps done; the kernels' own limit is where the piston will be one step later."""
    edges = list(scene.box)
    if scene.piston is not None:
        wall, stop = EDGES.index(scene.piston.wall), scene.piston.stop
        step = float(arrays["piston"][layout.PISTON_SPEED] * arrays["parameters"][layout.DT])
        place = edges[wall] + step * int(arrays["control"][layout.STEPS])
        edges[wall] = max(place, stop) if step < 0 else min(place, stop)
    return edges[0], edges[1], edges[2], edges[3]


def wall_limits(scene: Scene) -> tuple[float, float, float, float]:
    """Least and largest centre along x and y: the walls, a radius inwards where all discs have the same [length]."""
    margin = 0.0 if has_radii(scene) else scene.largest_radius
    x, y = (margin if word == "walls" else 0.0 for word in scene.boundary)
    return x, scene.width - x, y, scene.height - y


def obstacle_arrays(scene: Scene) -> dict[str, NDArray[Any]]:
    """Capsules, images beyond periodic borders included, and the grid of which ones are near a place; {} without any.

    The same grid whatever the method and the number of discs. A cell lists every capsule that a disc with its centre in
    the cell can touch.
    """
    made_of = (id(scene.capsules), scene.width, scene.height, scene.periodic, scene.largest_radius)
    if scene not in _made or _made[scene][0] != made_of:
        _made[scene] = made_of, _obstacle_arrays(scene)
    return _made[scene][1]


def _obstacle_arrays(scene: Scene) -> dict[str, NDArray[Any]]:
    size = (scene.width, scene.height)
    images = capsules.with_images(scene.capsules, size, scene.periodic, scene.largest_radius)
    if not len(images.capsule):
        return {}
    lists = capsules.cell_lists(images.capsule, size, scene.largest_radius)
    grid = {"near": lists.near, "index": lists.listed, "grid": lists.grid, "per_length": lists.per_length}
    return {"capsule": images.capsule, **grid}


def typical_momentum(scene: Scene, dt: float) -> float:
    """What impulses are counted in: a momentum like those that discs have or come to have [mass length/time], > 0.

    The largest of the mean at the start, that of a fall through the box, and those of discs that emitters or the piston
    set in motion. Where nothing can move by itself: of a disc that moves its radius in a step of dt [time].
    """
    mass = float(scene.masses.mean()) if scene.count else 1.0
    fields = [np.atleast_2d(field) for field in (scene.gravity, scene.acceleration) if field is not None]
    pull = sum(float(np.hypot(*field.T).max(initial=0.0)) for field in fields)
    fall = math.sqrt(pull * max(scene.width, scene.height))
    speeds = [fall] if scene.piston is None else [fall, abs(scene.piston.speed)]
    momenta = [math.sqrt(float(((scene.velocity * scene.masses[:, None]) ** 2).mean())) if scene.count else 0.0]
    if scene.emitters:
        masses = np.array([1.0 if emitter.mass is None else emitter.mass for emitter in scene.emitters])
        velocities = np.array([emitter.velocity for emitter in scene.emitters], float)
        momenta += [float((masses * np.hypot(*velocities.T)).max()), float(masses.max()) * max(speeds)]
    momenta += [mass * speed for speed in speeds if scene.count]
    return max(momenta) or mass * (scene.largest_radius or 1.0) / dt
