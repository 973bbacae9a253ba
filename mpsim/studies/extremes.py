"""Extreme scenes, on which the stability map tries every method, contact, law and precision."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.scene.scene import Scene

RADIUS = 0.5
SEED = 5


@dataclass(frozen=True)
class Case:
    """One scene to run, and what is known about it.

    Attributes:
        scene: makes the scene when called, as that may be what is refused.
        dt: of a frame [time].
        frames: number of frames.
        conserves: whether `elastic` conserves the energy; otherwise it may only fall.
        compares: whether collisions and positions are compared with the exact solver's: only in scenes without special
            features, for each of which counting kernels would have to be compiled.
        rests: whether discs come to rest, so that the exact solver is given a contact time.
    """

    scene: Callable[[], Scene]
    dt: float
    frames: int
    conserves: bool = True
    compares: bool = True
    rests: bool = False


@dataclass(frozen=True)
class Axis:
    """One direction in which scenes become extreme.

    Attributes:
        name: for files and options.
        title: what is varied, with its unit.
        values: along it; those of `full` take long and are tried only on request.
        case: makes the case of a value.
    """

    name: str
    title: str
    values: tuple[Any, ...]
    case: Callable[[Any], Case]
    full: tuple[Any, ...] = ()


def gas(count: int = 100, packing: float = 0.3, speed: float = 1.0, scale: float = 1.0, **more: Any) -> Scene:
    """Discs of radius scale / 2 at random, with a root mean square speed."""
    return Scene.random(
        count=count, packing=packing, radius=RADIUS * scale, temperature=speed * speed / 2, seed=SEED, **more
    )


def step_for(fraction: float, speed: float = 1.0, radius: float = RADIUS) -> float:
    """dt in which a disc of the mean speed moves a fraction of its radius [time]."""
    return fraction * radius / speed


def crystal(packing: float) -> Scene:
    """A hexagonal lattice of 14 x 16 discs, periodic, at any packing up to the densest."""
    columns, rows = 14, 16
    pitch = math.sqrt(math.pi * RADIUS**2 / packing / (math.sqrt(3) / 2))
    row, column = np.divmod(np.arange(columns * rows), columns)
    rise = pitch * math.sqrt(3) / 2
    position = np.stack([(column + 0.5 * (row % 2) + 0.25) * pitch, (row + 0.5) * rise], axis=1)
    size: Any = {"width": columns * pitch, "height": rows * rise}
    return Scene(position=position, velocity=_thermal(len(row)), radius=RADIUS, boundary="periodic", **size)


def random_overlapping(packing: float) -> Scene:
    """150 discs at random positions, overlapping ones included."""
    count = 150
    side = math.sqrt(count * math.pi * RADIUS**2 / packing)
    places = RADIUS + np.random.default_rng(SEED).random((count, 2)) * (side - 2 * RADIUS)
    return Scene(width=side, height=side, position=places, velocity=_thermal(count), radius=RADIUS)


def _thermal(count: int) -> Any:
    velocity = np.random.default_rng(SEED).normal(size=(count, 2)) / math.sqrt(2)
    return velocity - velocity.mean(axis=0)


def _frames(time: float, dt: float, most: int = 2000) -> int:
    """Number of frames in a time, from 10 to `most`."""
    return int(min(max(time / dt, 10), most))


def _step(fraction: float) -> Case:
    dt = step_for(fraction)
    return Case(gas, dt, _frames(20.0, dt, 400))


def _packing(packing: float) -> Case:
    if packing > HEXAGONAL:
        return Case(partial(random_overlapping, packing), step_for(0.05), 200, compares=False)
    scene = partial(crystal, packing) if packing > 0.7 else partial(gas, packing=packing, boundary="periodic")
    return Case(scene, step_for(0.02), 400 if packing > 0.7 else 2000)


HEXAGONAL = math.pi / (2 * math.sqrt(3))


def step_and_packing(fraction: float, packing: float) -> Case:
    """The case of a step, as a fraction of a radius, and a packing."""
    case = _packing(packing)
    dt = step_for(fraction)
    return Case(case.scene, dt, _frames(4.0 if packing > 0.7 else 20.0, dt, 1000))


def _count(count: int) -> Case:
    if count > 5000:
        return Case(partial(gas, count), step_for(0.1), 10, compares=False)
    return Case(partial(gas, count), step_for(0.05), 200)


def _unit_of_length(scale: float) -> Case:
    return Case(partial(gas, scale=scale, speed=scale), step_for(0.05), 400)


def _far(ratio: float) -> Case:
    """A small gas in the far corner of a box `ratio` radii wide, where coordinates have the lowest resolution."""

    def scene() -> Scene:
        near = gas(30)
        side = ratio * RADIUS
        return Scene(
            width=side,
            height=side,
            position=side - near.width + near.position,
            velocity=near.velocity,
            radius=RADIUS,
        )

    return Case(scene, step_for(0.05), 60)


def _aspect(aspect: float) -> Case:
    height = 4.0

    def scene() -> Scene:
        count = int(min(aspect * height * height * 0.3 / (math.pi * RADIUS**2), 300))
        return gas_in(count, height * aspect, height)

    return Case(scene, step_for(0.05), 400)


def gas_in(count: int, width: float, height: float) -> Scene:
    """A gas in a box of given size."""
    return Scene.random(count=count, width=width, height=height, radius=RADIUS, temperature=0.5, seed=SEED)


def _unit_of_time(speed: float) -> Case:
    return Case(partial(gas, speed=speed), step_for(0.05, speed), 400)


def _radii(ratio: float) -> Case:
    def scene() -> Scene:
        radius = np.full(60, RADIUS / ratio)
        radius[:4] = RADIUS
        side = max(6 * RADIUS, math.sqrt(math.pi * float((radius**2).sum()) / 0.3))
        box: Any = {"width": side, "height": side, "boundary": "periodic", "temperature": 0.5, "seed": SEED}
        return Scene.random(count=60, radius=radius, **box)

    return Case(scene, step_for(0.05, 1.0, RADIUS / ratio), 400, compares=False)


def _masses(ratio: float) -> Case:
    def scene() -> Scene:
        mass = np.where(np.arange(100) % 2, 1.0, ratio)
        even = gas(100, boundary="periodic")
        box: Any = {"width": even.width, "height": even.height, "radius": RADIUS, "boundary": "periodic"}
        return Scene(position=even.position, velocity=even.velocity, mass=mass, **box)

    return Case(scene, step_for(0.02), 1000, compares=False)


def _restitution(e: float) -> Case:
    """Without any restitution discs cling to each other, and their collisions are not to be counted."""
    scene = partial(gas, restitution=e, wall_restitution=e)
    return Case(scene, step_for(0.05), 400, conserves=e == 1, compares=e > 0)


def _corner(acceleration: float) -> Case:
    """Gravity towards one corner."""
    scene = partial(gas, gravity=(acceleration, -acceleration), restitution=0.9, wall_restitution=0.9)
    dt = step_for(0.05, math.sqrt(1 + 10 * acceleration))
    return Case(scene, dt, 2000, conserves=False, compares=False, rests=True)


def _places(kind: str) -> Case:
    return Case(partial(degenerate_start, kind), step_for(0.05), 400, compares=False)


_SIDE = 12.0


def _degenerate_positions() -> dict[str, NDArray[np.float64]]:
    """Centres of 36 discs: coinciding, aligned or touching, or on the edges of cells and walls."""
    count, side = 36, _SIDE
    site = np.stack(np.divmod(np.arange(count), 6), axis=1).astype(float)
    places = {
        "one point": np.full((count, 2), side / 2),
        "one corner": np.full((count, 2), RADIUS),
        "one line": np.stack([np.linspace(RADIUS, side - RADIUS, count), np.full(count, side / 2)], axis=1),
        "one cell": side / 2 + 0.01 * site,
        "cell edges": 1.0 + 2 * site - (site == 5) * 0.5,
        "wall edges": np.where(site % 2 == 0, RADIUS, side - RADIUS),
        "touching": RADIUS + site,
        "pairs in one place": np.repeat(1.0 + RADIUS + 2 * site[:18], 2, axis=0),
    }
    return {kind: np.clip(position, RADIUS, side - RADIUS) for kind, position in places.items()}


PLACES = tuple(_degenerate_positions())


def degenerate_start(kind: str) -> Scene:
    """A special start, one of PLACES: discs in one point, in a line, touching, ...."""
    position = _degenerate_positions()[kind]
    velocity = np.where(np.arange(len(position))[:, None] % 2, [1.0, -0.5], [-1.0, 0.5])
    return Scene(width=_SIDE, height=_SIDE, position=position, velocity=velocity, radius=RADIUS)


PLACES = (
    "one point",
    "one corner",
    "one line",
    "one cell",
    "cell edges",
    "wall edges",
    "touching",
    "pairs in one place",
)


def _drift(frames: float) -> Case:
    return Case(partial(gas, 10), step_for(0.1), int(frames), compares=False)


def _numbers(text: str) -> Case:
    """A small scene with one number at the limit of floating point."""
    name, value = text.split("=")
    number = float(value)
    near: Any = {
        "width": 6.0,
        "height": 6.0,
        "position": [[2, 3], [3.5, 3]],
        "velocity": [[1, 0], [-1, 0]],
        "radius": 0.5,
    }
    changes: dict[str, Any] = {
        "velocity": {"velocity": [[number, 0], [-number, 0]]},
        "one velocity": {"velocity": [[number, 0], [1, 0]]},
        "mass": {"mass": [number, 1.0]},
        "gravity": {"gravity": (0.0, -number)},
        "radius": {"radius": number, "position": [[2, 3], [4, 3]]},
        "box": {"width": number, "height": number},
        "dt": {},
    }[name]
    dt = number if name == "dt" else 0.01
    # Where only a unit has changed, the step scales with it.
    if name == "velocity" and number < 1:
        dt = 0.01 / max(number, 1e-300)
    return Case(
        lambda: Scene(**{**near, **changes}),
        dt,
        100,
        conserves=name != "gravity",
        compares=name not in ("mass", "gravity"),
    )


NUMBERS = (
    "velocity=1e-320",
    "velocity=1e-40",
    "one velocity=1e18",
    "one velocity=1e30",
    "one velocity=1e150",
    "one velocity=1e300",
    "mass=1e-320",
    "mass=1e-30",
    "mass=1e38",
    "mass=1e300",
    "gravity=1e-320",
    "gravity=1e-12",
    "gravity=1e15",
    "gravity=1e300",
    "radius=1e-320",
    "radius=1e-20",
    "radius=1e-9",
    "box=1e8",
    "box=1e200",
    "dt=1e-320",
    "dt=1e-30",
    "dt=1e30",
    "dt=1e300",
)

AXES = {
    axis.name: axis
    for axis in (
        Axis(
            "step",
            "mean displacement in a step, in radii",
            (1e-6, 1e-4, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1, 3, 10, 100),
            _step,
        ),
        Axis(
            "packing",
            "packing fraction (above 0.9069: overlapping starts)",
            (0.001, 0.01, 0.1, 0.3, 0.5, 0.7, 0.8, 0.85, 0.88, 0.9, 0.906, 1.0, 1.5, 3.0),
            _packing,
        ),
        Axis("count", "number of discs", (0, 1, 2, 10, 1000), _count, (100_000, 1_000_000, 5_000_000)),
        Axis("length", "unit of length", (1e-6, 1e-3, 1.0, 1e3, 1e6), _unit_of_length, (1e-18, 1e-12, 1e12, 1e18)),
        Axis("box", "side of the box, in radii", (1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e9, 1e12, 1e15), _far),
        Axis("aspect", "width over height of the box", (1, 100, 1e4, 1e6, 1e9), _aspect),
        Axis("speed", "unit of speed", (1e-20, 1e-10, 1e-3, 1.0, 1e3, 1e8, 1e15), _unit_of_time),
        Axis("radii", "largest over smallest radius", (1, 10, 100, 1000), _radii),
        Axis("masses", "lightest over heaviest mass", (1.0, 1e-3, 1e-6, 1e-9), _masses),
        Axis("restitution", "restitution of discs and walls", (0.0, 0.1, 0.5, 0.9, 1.0), _restitution),
        Axis("gravity", "gravity towards one corner", (1e-3, 1.0, 1e3, 1e6), _corner),
        Axis("places", "special starts: discs in one point, in a line, in pairs, ...", PLACES, _places),
        Axis("drift", "frames of a gas of 10 discs", (1e3, 1e4, 1e5), _drift, (1e6,)),
        Axis("numbers", "one number near the limits of floating point", NUMBERS, _numbers),
    )
}

STEP_FRACTIONS = (0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 3.0, 10.0, 100.0)
PACKINGS = (0.01, 0.1, 0.3, 0.5, 0.7, 0.8, 0.85, 0.88, 0.9)
"""The two axes of the map of steps and packings."""
