"""The discs of a scene at its start: given arrays, or a lattice of which any range can be computed."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.scene.starts import Sites, thermal_velocities, widest_spacing

# --- Equal discs on a lattice that fills the box; each is computed from its number alone
#
# They are numbered column by column, so that consecutive discs form a strip of the box. Random numbers come from
# blocks of discs: each has a stream of its own (Philox, Salmon et al. 2011), which only the seed and the number of the
# block determine. In each block, and so in total, velocities have zero momentum and the exact temperature.

Floats = NDArray[np.float64]

BLOCK = 4096
"""Discs of a block at most, whose random numbers are drawn together."""

BLOCKS_OF_A_PIECE = 16
"""Blocks that are looked at together where all discs are looked at."""

DISPLACEMENT = 0.9
"""Largest displacement from a site, as a fraction of half of the gap between two discs on their sites."""

LEAST_GAP = 1e-7, 128 * 2.0**-52
"""Gap between two discs on their sites, as fractions of their diameter and of the box: it covers all rounding."""

PLACES, VELOCITIES = 0, 1
"""What a stream of random numbers is for."""


@dataclass(frozen=True)
class Lattice:
    """Discs near the sites of a hexagonal lattice.

    Args:
        count: number of discs, >= 0.
        radius: of each [length].
        width, height: of the box [length], which holds the discs: see `demand_sites`.
        periodic: whether x, and whether y, is.
        temperature: kT: the mean of v_x^2 and v_y^2, masses being 1 [length^2/time^2].
        seed: of the random numbers, from 0 to 2^63 - 1.

    >>> lattice = Lattice(1000, 0.5, 60.0, 20.0, (False, False), 1.0, seed=1)
    >>> lattice.positions(990, 1000).round(2).tolist() == lattice.position[990:].round(2).tolist()
    True
    """

    count: int
    radius: float
    width: float
    height: float
    periodic: tuple[bool, bool]
    temperature: float
    seed: int

    def __getstate__(self) -> dict[str, Any]:
        """The numbers above, without arrays that were made of them."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def position(self) -> Floats:
        """Centres of all discs, shape (count, 2), read-only [length]."""
        return _read_only(self.positions(0, self.count))

    @cached_property
    def velocity(self) -> Floats:
        """Velocities of all discs, shape (count, 2), read-only [length/time]."""
        return _read_only(self.velocities(0, self.count))

    def positions(self, first: int, last: int) -> Floats:
        """Centres of discs first to last - 1, shape (last - first, 2) [length]."""
        sites, low, high, most = self._sites, *self._region, self._largest_displacement

        def made(begin: int, end: int, rng: np.random.Generator) -> Floats:
            displacement = most * (2 * rng.random((end - begin, 2)) - 1)
            # Columns of the box are the rows of the lattice.
            place = np.minimum(low + sites.between(begin, end)[:, ::-1], high) + displacement
            for axis in (0, 1):
                if not self.periodic[axis]:  # a wall mirrors displacements, which makes none of them longer
                    along = high[axis] - np.abs(high[axis] - (low[axis] + np.abs(place[:, axis] - low[axis])))
                    place[:, axis] = np.clip(along, low[axis], high[axis])
            return place

        return self._in_blocks(PLACES, made, first, last)

    def velocities(self, first: int, last: int) -> Floats:
        """Velocities of discs first to last - 1, shape (last - first, 2) [length/time]."""

        def made(begin: int, end: int, rng: np.random.Generator) -> Floats:
            return thermal_velocities(end - begin, self.temperature, None, rng)

        return self._in_blocks(VELOCITIES, made, first, last)

    def digest_of_some(self) -> str:
        """Hex digest of the first discs, which shows whether the same numbers are drawn as elsewhere."""
        some = 0, min(self.count, BLOCK)
        digest = hashlib.blake2b(digest_size=16)
        for array in (self.positions(*some), self.velocities(*some)):
            digest.update(np.ascontiguousarray(array, "<f8").tobytes())
        return digest.hexdigest()

    def pieces(self) -> Iterator[tuple[int, int]]:
        """Pieces of all discs, as (first disc, one after the last), each of at most BLOCKS_OF_A_PIECE blocks."""
        blocks = self._blocks
        ends = [*range(0, blocks, BLOCKS_OF_A_PIECE), blocks]
        return pairwise(self._first_of(block) for block in ends)

    def _in_blocks(
        self, stream: int, make: Callable[[int, int, np.random.Generator], Floats], first: int, last: int
    ) -> Floats:
        """What `make` makes of discs begin to end - 1, whole blocks of them, cut to first to last - 1."""
        found = np.empty((last - first, 2))
        block = ((first + 1) * self._blocks - 1) // max(self.count, 1)
        begin = self._first_of(block)
        while begin < last:
            end = self._first_of(block + 1)
            bits = np.random.Philox(key=_words(self.seed, stream), counter=_words(0, 0, 0, block))
            low, high = max(begin, first), min(end, last)
            found[low - first : high - first] = make(begin, end, np.random.Generator(bits))[low - begin : high - begin]
            block, begin = block + 1, end
        return found

    @property
    def _blocks(self) -> int:
        """Number of blocks, of nearly equal sizes, so that only a single disc is alone in one."""
        return max(-(-self.count // BLOCK), 1)

    def _first_of(self, block: int) -> int:
        return self.count * block // self._blocks

    @cached_property
    def _sites(self) -> Sites:
        spacing = widest_spacing("hexagonal", self._lengths, max(self.count, 1))
        return Sites.fitting("hexagonal", *self._lengths(spacing), spacing)

    @property
    def most(self) -> int:
        """Number of discs that the box would hold in this way."""
        return Sites.fitting("hexagonal", *self._lengths(self._least_spacing), self._least_spacing).number

    @property
    def _least_spacing(self) -> float:
        of_diameter, of_box = LEAST_GAP
        return 2 * self.radius * (1 + of_diameter) + of_box * max(self.width, self.height)

    def _lengths(self, spacing: float) -> tuple[float, float]:
        """Lengths of the region of the sites along y and along x, between walls or periodic borders [length]."""
        x, y = (
            length - (spacing if wraps else 2 * self.radius)
            for length, wraps in zip((self.width, self.height), self.periodic, strict=True)
        )
        return y, x

    @cached_property
    def _region(self) -> tuple[Floats, Floats]:
        """Lower left and upper right corner of the region of the sites [length]."""
        low = np.where(self.periodic, self._sites.spacing / 2, self.radius)
        return low, np.array([self.width, self.height]) - low

    @cached_property
    def _largest_displacement(self) -> Floats:
        """Along x and along y: no disc goes farther than DISPLACEMENT of half of the gap, whatever the direction."""
        low, high = self._region
        gap = max(self._sites.spacing - 2 * self.radius, 0.0)  # a single disc has no neighbour
        return np.minimum(DISPLACEMENT * gap / 2 / math.sqrt(2), np.where(self.periodic, np.inf, (high - low) / 2))


def demand_sites(lattice: Lattice, packing: float | None) -> None:
    """Refuse more discs than there is room for on a lattice in their box. packing: that was given for it, if any."""
    if lattice.count > lattice.most:
        name, remedy = "count", "Use fewer or smaller discs, or a larger box"
        if packing is not None:
            name, remedy = "packing", f"Use one below {packing:g}"
        raise InputError(
            f"{name} must leave room for a hexagonal lattice, which has at most {lattice.most} discs of radius "
            f"{lattice.radius:g} in a box of {lattice.width:g} x {lattice.height:g}; got {lattice.count}. {remedy}."
        )


def demand_equal_discs(radius: Any, others: dict[str, Any]) -> None:
    """Refuse, by name, arguments of Scene for which discs on a lattice would differ or have no place."""
    if np.ndim(radius):
        raise InputError(
            f"radius of discs on a lattice must be one number for all; got an array of shape {np.shape(radius)}. Use "
            "Scene.random, or give the places of discs of several sizes."
        )
    if others.get("mass") is not None:
        raise InputError(
            "mass must be left out for discs on a lattice, which have mass 1 each; got one or more. Use Scene.random, "
            "or give places and velocities of discs of other masses."
        )


def demand_whole_box(scene: Any) -> None:
    """Refuse anything inside the box of a scene with discs on a lattice: capsules, or a wall that starts inside."""
    if len(scene._capsules_at(0.0)):
        raise InputError(
            "obstacles must be left out for discs on a lattice, which fills the box; got one or more. Use "
            "Scene.random, whose discs keep clear of them."
        )
    for wall in scene._moving_walls:
        if (place := wall.place(0.0)) != (0.0, scene.width, 0.0, scene.height)[wall.edge]:
            raise InputError(
                f"start of the {wall.name} must be its wall for discs on a lattice, which fills the box; got "
                f"{place:g}. Leave it out, or give the places of the discs."
            )


def _words(*numbers: int) -> NDArray[np.uint64]:
    return np.array(numbers, np.uint64)


def _read_only(array: Floats) -> Floats:
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class GivenStart:
    """Places and velocities that were given, arrays of shape (N, 2), read-only, with the methods of a Lattice."""

    position: Floats
    velocity: Floats

    @property
    def count(self) -> int:
        return len(self.position)

    def positions(self, first: int, last: int) -> Floats:
        return self.position[first:last]

    def velocities(self, first: int, last: int) -> Floats:
        return self.velocity[first:last]

    def pieces(self) -> Iterator[tuple[int, int]]:
        return iter([(0, self.count)])


Start = Lattice | GivenStart


def start_of(position: Any, velocity: Any) -> Start:
    """What a scene starts from: arrays, checked, or the lattice that Scene.lattice hands over in place of both."""
    if isinstance(position, Lattice):
        return position
    places = checks.finite_array("position", position, (None, 2), "(N, 2)")
    rows = f"({len(places)}, 2), one row per row of position"
    return GivenStart(places, checks.finite_array("velocity", velocity, (len(places), 2), rows))
