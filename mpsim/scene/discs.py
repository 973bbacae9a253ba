"""The discs of a scene at its start: given arrays, or a lattice of which any range can be computed."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.sizes import equal_sizes
from mpsim.scene import recommended
from mpsim.scene.lattice import Lattice

Floats = NDArray[np.float64]


class Start(Protocol):
    """Places and velocities of discs at the start."""

    @property
    def count(self) -> int:
        """Number of discs."""
        ...

    @property
    def position(self) -> Floats:
        """Of all discs, shape (N, 2), read-only [length]."""
        ...

    @property
    def velocity(self) -> Floats:
        """Of all discs, shape (N, 2), read-only [length/time]."""
        ...

    def positions(self, first: int, last: int) -> Floats:
        """Of discs first to last - 1, shape (last - first, 2) [length]."""
        ...

    def velocities(self, first: int, last: int) -> Floats:
        """Of discs first to last - 1, shape (last - first, 2) [length/time]."""
        ...

    def pieces(self) -> Iterator[tuple[int, int]]:
        """Pieces of all discs, in their order, as (first disc, one after the last); at least one piece."""
        ...


@dataclass(frozen=True, eq=False)
class GivenStart:
    """Places and velocities that were given, which are one piece: arrays of shape (N, 2), read-only."""

    position: Floats
    velocity: Floats

    @property
    def count(self) -> int:
        """Number of discs."""
        return len(self.position)

    def positions(self, first: int, last: int) -> Floats:
        """A view."""
        return self.position[first:last]

    def velocities(self, first: int, last: int) -> Floats:
        """A view."""
        return self.velocity[first:last]

    def pieces(self) -> Iterator[tuple[int, int]]:
        """All discs at once."""
        yield 0, self.count


def start_of(position: Any, velocity: Any) -> Start:
    """What a scene starts from: arrays, checked, or the lattice that Scene.lattice hands over in place of both.

    Raises:
        InputError: naming the argument.
    """
    if isinstance(position, Lattice):
        return position
    places = checks.finite_array("position", position, (None, 2), "(N, 2)")
    rows = f"({len(places)}, 2), one row per row of position"
    return GivenStart(places, checks.finite_array("velocity", velocity, (len(places), 2), rows))


class HasDiscs:
    """The discs of a scene."""

    _start: Start
    radius: float | Floats
    mass: Floats | None
    emitters: tuple[Any, ...]

    @property
    def count(self) -> int:
        """Number of discs."""
        return self._start.count

    @property
    def position(self) -> Floats:
        """Centres, shape (N, 2), read-only [length]. Those of a lattice are computed when first needed, and kept."""
        return self._start.position

    @property
    def velocity(self) -> Floats:
        """Velocities, shape (N, 2), read-only [length/time], as `position`."""
        return self._start.velocity

    def start_anew(self, position: Floats, velocity: Floats) -> None:
        """Let the scene, a copy that nothing else refers to, start from arrays of shape (N, 2)."""
        self._start = GivenStart(position, velocity)

    @property
    def on_lattice(self) -> Lattice | None:
        """The lattice on which the discs start; None if their places were given."""
        return self._start if isinstance(self._start, Lattice) else None

    def rows(self, first: int, last: int) -> tuple[Floats, Floats]:
        """Positions and velocities of some discs, without those of the others where the scene is `Scene.lattice`.

        Args:
            first, last: the first disc and the one after the last, 0 <= first <= last <= count.

        Returns:
            Two arrays of shape (last - first, 2) [length], [length/time]: views of arrays that were given.

        Raises:
            InputError: if the scene has no such discs.

        >>> import mpsim
        >>> scene = mpsim.Scene.lattice(count=1_000_000, packing=0.5, radius=0.5)
        >>> position, velocity = scene.rows(500_000, 500_003)
        >>> position.shape, bool((abs(position[:, 0] - scene.width / 2) < 1).all())
        ((3, 2), True)
        """
        first = checks.whole("first", first, 0, self.count, "Give the number of a disc.")
        last = checks.whole("last", last, first, self.count, "Give the number after that of a disc.")
        return self._start.positions(first, last), self._start.velocities(first, last)

    def pieces(self) -> Iterator[tuple[int, int]]:
        """Pieces of all discs, as (first disc, one after the last); arrays that were given are one piece."""
        return self._start.pieces()

    def velocities_in_pieces(self) -> Iterator[tuple[int, Floats]]:
        """The first disc of each piece, and the velocities of the discs in it, shape (K, 2) [length/time]."""
        return ((first, self._start.velocities(first, last)) for first, last in self._start.pieces())

    def digest(self) -> str:
        """Hex digest of everything that a run depends on, without recommendations; equal digests mean equal bits.

        >>> import mpsim
        >>> made = mpsim.Scene.random(count=100, packing=0.4, radius=0.5, seed=1)
        >>> mpsim.Scene.load("gas").digest() == made.digest()
        True
        """
        digest = hashlib.blake2b(digest_size=16)
        made = {"position": self._start.positions, "velocity": self._start.velocities}
        for name in sorted(self.__getstate__().keys() - {*recommended.NAMES, "_start"} | made.keys()):
            digest.update(f"{name} ".encode())
            if name in made:
                digest.update(f"{(self.count, 2)} ".encode())
                for first, last in self._start.pieces():
                    digest.update(np.ascontiguousarray(made[name](first, last), "<f8").tobytes())
                continue
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                array = np.ascontiguousarray(value, "<f8")
                digest.update(f"{array.shape} ".encode() + array.tobytes())
            else:
                digest.update(f"{value!r} ".encode())  # in which floats lose no bit
        return digest.hexdigest()

    def __getstate__(self) -> dict[str, Any]:
        """All that the scene holds, without how it was made; of a lattice its numbers, without arrays."""
        derived = ("_redraw", "_capsules", "_capsule_index", "_overlaps")
        return {name: value for name, value in vars(self).items() if name not in derived}

    @property
    def largest_radius(self) -> float:
        """Radius of the largest disc, emitters' discs included [length]."""
        radii = np.append(np.ravel(self.radius), [e.radius for e in self.emitters if e.radius is not None])
        return float(radii.max(initial=0.0))

    @property
    def smallest_radius(self) -> float:
        """Radius of the smallest disc, emitters' discs included [length]."""
        radii = np.append(np.ravel(self.radius), [e.radius for e in self.emitters if e.radius is not None])
        return float(radii.min(initial=self.largest_radius))

    @property
    def radii(self) -> Floats:
        """Radius of each disc, shape (N,), read-only [length]."""
        return self.radius if isinstance(self.radius, np.ndarray) else equal_sizes(self.radius, self.count)

    @property
    def masses(self) -> Floats:
        """Mass of each disc, shape (N,), read-only [mass]."""
        return equal_sizes(1.0, self.count) if self.mass is None else self.mass

    def packing_in(self, width: float, height: float) -> float:
        """Area of the discs over that of a box [length]."""
        radii = self.radii
        parts = (radii[first:last] / width * (radii[first:last] / height) for first, last in self.pieces())
        return math.pi * sum(float(part.sum()) for part in parts)
