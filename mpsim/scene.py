"""Scene: what is simulated."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim import checks, placement
from mpsim.errors import InputError

LARGEST_COUNT = 100_000_000
"""More discs than this is taken for a mistake (a scene of this size needs some 10 GB)."""


class Scene:
    """Equal discs of mass 1 in a box with hard walls. Checked when made; its arrays are read-only copies.

    Args:
        width, height: inner size of the box, x in [0, width], y in [0, height] [length], > 0.
        position: centres, shape (N, 2) [length], each in [radius, width - radius] x [radius, height - radius]; N may
            be 0. Discs may overlap: the first frames push them apart.
        velocity: shape (N, 2) [length/time].
        radius: of every disc [length], > 0, at most half of the box.
        gravity: (gx, gy), one acceleration for all discs [length/time^2]; None: none, and no cost.
        restitution: of two discs, from 0 (they part at rest against each other) to 1 (no loss) [dimensionless].
        wall_restitution: of a disc and a wall, likewise.
        acceleration: one per disc, shape (N, 2) [length/time^2]; None: none, and no cost.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> scene = Scene(width=4, height=3, position=[[1, 1], [3, 2]], velocity=[[1, 0], [0, 0]], radius=0.5)
    >>> scene.count, round(scene.packing, 3)
    (2, 0.131)
    """

    def __init__(
        self,
        *,
        width: float,
        height: float,
        position: ArrayLike,
        velocity: ArrayLike,
        radius: float,
        gravity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        restitution: float = 1.0,
        wall_restitution: float = 1.0,
    ):
        self.width: float = checks.positive("width", width, "[length]")
        self.height: float = checks.positive("height", height, "[length]")
        self.radius: float = checks.positive("radius", radius, "[length]")
        if 2 * self.radius > min(self.width, self.height):
            raise InputError(
                f"radius must be at most half the box, {min(self.width, self.height) / 2:g} here; got {radius!r}. "
                "Use smaller discs or a larger box."
            )
        self.position: NDArray[np.float64] = checks.finite_array("position", position, (None, 2), "(N, 2)")
        count = len(self.position)
        checks.whole("the number of discs", count, 0, LARGEST_COUNT, "Simulate fewer discs.")
        self.velocity: NDArray[np.float64] = checks.finite_array(
            "velocity", velocity, (count, 2), f"({count}, 2), one row per row of position"
        )
        self.gravity: NDArray[np.float64] | None = None
        if gravity is not None:
            self.gravity = checks.finite_array("gravity", gravity, (2,), "(2,)")
        self.acceleration: NDArray[np.float64] | None = None
        if acceleration is not None:
            self.acceleration = checks.finite_array(
                "acceleration", acceleration, (count, 2), f"({count}, 2), one row per row of position"
            )
        self.restitution = checks.fraction("restitution", restitution)
        self.wall_restitution = checks.fraction("wall_restitution", wall_restitution)
        self.check_inside("position", self.position)

    def check_inside(self, name: str, position: NDArray[np.float64]) -> None:
        """Raise InputError, naming the first offender, unless every centre is at least one radius from each wall."""
        high = np.array([self.width, self.height]) - self.radius
        # A centre may touch the wall to within rounding of the box's own coordinates.
        slack = 4 * np.finfo(np.float64).eps * max(self.width, self.height)
        outside = np.argwhere(((position < self.radius - slack) | (position > high + slack)).any(axis=1))
        if len(outside):
            index = int(outside[0, 0])
            raise InputError(
                f"{name}[{index}] must lie in [{self.radius:g}, {high[0]:g}] x [{self.radius:g}, {high[1]:g}] (one "
                f"radius from the walls); got {tuple(position[index].tolist())} ({len(outside)} discs outside). "
                "Move the disc or enlarge the box."
            )

    @property
    def count(self) -> int:
        """Number of discs."""
        return len(self.position)

    @property
    def packing(self) -> float:
        """Packing fraction: area of the discs over area of the box."""
        return self.count * math.pi * self.radius**2 / (self.width * self.height)

    def __repr__(self) -> str:
        extras = [name for name in ("gravity", "acceleration") if getattr(self, name) is not None]
        return (
            f"<Scene: {self.count} discs of radius {self.radius:g} in {self.width:g} x {self.height:g}, "
            f"packing {self.packing:.3g}{''.join(', ' + name for name in extras)}>"
        )

    @classmethod
    def random(
        cls,
        *,
        count: int,
        radius: float,
        temperature: float = 1.0,
        seed: int = 0,
        packing: float | None = None,
        width: float | None = None,
        height: float | None = None,
        **features: Any,
    ) -> "Scene":
        """Discs at random places without overlap, with thermal velocities.

        Args:
            count: number of discs, >= 0.
            radius: [length], > 0.
            temperature: kT in units of the disc's mass: the mean square of one velocity component
                [length^2/time^2], >= 0. Velocities are normally distributed, without drift from 2 discs on, and scaled
                so that this mean square is exact.
            seed: of the random numbers, >= 0; the same seed gives the same scene.
            packing: packing fraction of a square box made to fit, 0 < packing <= 0.8.
            width, height: the box, instead of packing.
            features: further arguments of Scene, such as gravity.

        Places are drawn by random sequential addition up to packing 0.4; denser scenes start from a hexagonal lattice
        and take Monte Carlo steps (Metropolis et al. 1953), so they are near equilibrium.

        Raises:
            InputError: naming the argument, its rule and the value received.

        >>> scene = Scene.random(count=1000, packing=0.3, radius=0.5, seed=7)
        >>> round(scene.packing, 12), round(float((scene.velocity**2).mean()), 12)
        (0.3, 1.0)
        """
        count = checks.whole("count", count, 0, LARGEST_COUNT, "Simulate fewer discs.")
        seed = checks.whole("seed", seed, 0, 2**63 - 1, "Any whole number will do.")
        radius = checks.positive("radius", radius, "[length]")
        temperature = checks.non_negative("temperature", temperature, "[length^2/time^2]")
        width, height = _box(count, radius, packing, width, height)
        rng = np.random.default_rng(seed)
        position = placement.random_places(count, width, height, radius, rng)
        velocity = rng.normal(size=(count, 2))
        if count > 1:
            velocity -= velocity.mean(axis=0)
            velocity *= math.sqrt(temperature) / math.sqrt((velocity**2).mean())
        else:
            velocity *= math.sqrt(temperature)
        return cls(width=width, height=height, position=position, velocity=velocity, radius=radius, **features)


def _box(
    count: int, radius: float, packing: float | None, width: float | None, height: float | None
) -> tuple[float, float]:
    """Width and height from either a packing fraction (square box) or the two lengths themselves."""
    if (packing is None) == (width is None and height is None) or (width is None) != (height is None):
        raise InputError(
            "the box must be given either by packing or by width and height; "
            f"got packing={packing!r}, width={width!r}, height={height!r}."
        )
    if width is not None and height is not None:
        width, height = checks.positive("width", width, "[length]"), checks.positive("height", height, "[length]")
        packing = count * math.pi * radius**2 / (width * height)
    else:
        packing = checks.positive("packing", packing, "(a fraction of the area)")
        width = height = max(math.sqrt(count * math.pi * radius**2 / packing), 2 * radius)
    if packing > placement.LARGEST_PACKING:
        raise InputError(
            f"packing must be at most {placement.LARGEST_PACKING} for random places; got {packing:.3g}. "
            "Use fewer or smaller discs, a larger box, or give the positions yourself."
        )
    return width, height
