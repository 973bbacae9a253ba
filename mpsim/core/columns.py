"""Columns, the quantities that discs have one each: declared, kept in sizes, read in chunks."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.errors import InputError

# --- Radii and masses of discs, stored as one number if all are equal


def equal_sizes(size: float, count: int) -> NDArray[np.float64]:
    """The same number `count` times, read-only, in the memory of one."""
    # Not np.broadcast_to, which runs Python code: an interrupt in there would be lost.
    sizes = np.ndarray((count,), np.float64, np.array([size], np.float64), strides=(0,))
    sizes.setflags(write=False)
    return sizes


def kept_sizes(*parts: ArrayLike) -> NDArray[np.float64]:
    """Numbers one after the other, of arrays of shape (K,) or numbers; a copy, read-only.

    >>> kept_sizes([1, 1], 2).tolist(), kept_sizes([2, 2], 2).strides
    ([1.0, 1.0, 2.0], (0,))
    """
    arrays = [np.atleast_1d(np.asarray(part, np.float64)) for part in parts]
    different = [part[:1] if part.strides == (0,) else part for part in arrays if part.size]
    if different and min(map(np.min, different)) == (size := max(map(np.max, different))):
        return equal_sizes(float(size), sum(part.size for part in arrays))
    return checks.read_only(np.concatenate(arrays))


# --- Arrays with a row per disc that are read in chunks, because no process holds them completely

CHUNK = 2**16  # rows that are read at a time


def ranges(count: int, length: int | None = None) -> list[tuple[int, int]]:
    """First row and the one after the last of each chunk of `length` rows, by default CHUNK.

    >>> ranges(CHUNK + 1), ranges(0), ranges(3, 2)
    ([(0, 65536), (65536, 65537)], [], [(0, 2), (2, 3)])
    """
    length = CHUNK if length is None else length
    return [(first, min(first + length, count)) for first in range(0, count, length)]


class ChunkedArray:
    """An array of which any range of rows can be read. Slices are arrays; `numpy.asarray` reads all of it.

    Args:
        dtype, shape: of the whole.
        read: called with (first, last), returns these rows, shape (last - first, *shape[1:]).

    >>> squares = ChunkedArray(np.dtype(np.int64), (10,), lambda first, last: np.arange(first, last) ** 2)
    >>> squares[2:5], len(squares), int(np.asarray(squares).sum())
    (array([ 4,  9, 16]), 10, 285)
    """

    def __init__(self, dtype: np.dtype[Any], shape: tuple[int, ...], read: Callable[[int, int], NDArray[Any]]):
        self.dtype: np.dtype[Any] = dtype
        self.shape: tuple[int, ...] = shape
        self._read = read

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """A range of rows."""
        first, last, step = rows.indices(len(self))
        assert step == 1  # nobody asks for others
        return self._read(first, last)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        rows = self[:]
        return rows if dtype is None else rows.astype(dtype, copy=False)

    def chunks(self) -> Iterator[NDArray[Any]]:
        """All of it in the order of C, in contiguous arrays."""
        yield from (np.ascontiguousarray(self[first:last]) for first, last in ranges(len(self)))


Array = NDArray[Any] | ChunkedArray


def chunks_of(array: Array) -> Iterator[NDArray[Any]]:
    """An array in the order of C, in contiguous arrays: one of them if it lies in memory.

    >>> [chunk.tolist() for chunk in chunks_of(np.array([[1, 2], [3, 4]]).T)]
    [[[1, 3], [2, 4]]]
    """
    return array.chunks() if isinstance(array, ChunkedArray) else iter([np.asarray(array, order="C")])


# --- The declaration of all columns: numbers of each disc that are stored by disc number
#
# Block, discs that enter, snapshots and with them checkpoints, states, their digests and files, and the frames of
# trajectories follow from the declarations. Which scenes have a column its feature says (`Feature.columns`). What
# every kernel needs at once, places and speeds, lies in the order of the grid instead: `mpsim.kernels.records.Discs`.


class Column(NamedTuple):
    """Numbers of each disc in an array of the block, of shape (*components, capacity).

    Attributes:
        name: of the array, in snapshots, of the attribute of State, in trajectories whose format has no name of its
            own for it, and of the argument where it is given.
        meaning: what it is, in words.
        components: () for one number of each disc.
        integer: int64; else of the precision of the run.
        kept: whether a snapshot holds it: frames change it, or discs that enter bring it.
        in_state: whether states have it, and so digests, files of states and trajectories: a number of each disc, or
            two.
        rests: whether absorbed discs keep it in a state; else it is 0 of them.
        given: whether it is an argument of Scene and of `Simulation.add`; what is not given is zero.
        scenes: which scenes have it, and what others are, for the refusal of one that is given in others.
        remedy: how a scene comes to have it.
        absent: what is so where a state has none.
    """

    name: str
    meaning: str
    components: tuple[int, ...] = ()
    integer: bool = False
    kept: bool = True
    in_state: bool = True
    rests: bool = False
    given: bool = False
    scenes: str = "that has it; this one has not"
    remedy: str = "Give the scene one."
    absent: str = "there is none"

    def dtype(self, real: np.dtype[Any]) -> np.dtype[Any]:
        """Of its numbers, those of the run being `real`."""
        return np.dtype(np.int64) if self.integer else real

    def rows(self, count: int) -> tuple[int, ...]:
        """Shape of the numbers of so many discs, one row for each, as states, scenes and snapshots have them."""
        return (count, *self.components)

    def shape(self, count: int) -> tuple[int, ...]:
        """Of the array of a block for so many discs."""
        return (*self.components, count)

    # --- in the block and in snapshots

    @staticmethod
    def take(array: NDArray[Any], count: int) -> NDArray[Any]:
        """A copy of an array of the block for a snapshot."""
        return array[..., :count].T.copy()

    @staticmethod
    def put(array: NDArray[Any], kept: NDArray[Any]) -> None:
        """Write back what a snapshot holds."""
        array[..., : len(kept)] = kept.T

    # --- of people

    def one_each(self, value: ArrayLike, count: int) -> NDArray[np.float64]:
        """What is given for `count` discs, of shape `rows`: one number for all or one each; of pairs one each."""
        if self.components:
            shape = self.rows(count)
            return checks.finite_array(self.name, checks.rows(value), shape, f"{shape}, as position has")
        each = np.full(count, value) if checks.dimensions(value) == 0 else value
        return checks.finite_array(self.name, each, (count,), f"() or ({count},), one per row of position")

    def of_state(self, values: Any, count: int) -> NDArray[Any]:
        """What a state of `count` discs holds, as an array; an InputError for another shape or kind of numbers."""
        array, shape = np.asarray(values), self.rows(count)
        if array.shape != shape or array.dtype.kind not in ("iu" if self.integer else "f"):
            raise InputError(
                f"{self.name} of a state must {'hold whole' if self.integer else 'be real'} numbers of shape {shape}, "
                f"one {'pair ' if self.components else ''}per disc; got {array.dtype} of shape {array.shape}. Leave it "
                f"out where {self.absent}."
            )
        return array.astype(np.int64) if self.integer else array


MASS = Column("mass", "mass", kept=False, in_state=False, given=True)  # snapshots have those of all discs, in float64
ACCELERATION = Column(
    "acceleration",
    "acceleration of its own",
    (2,),
    in_state=False,
    given=True,
    scenes="that has acceleration per disc; this one has none",
    remedy="Give the scene acceleration=numpy.zeros((N, 2)).",
)
IMAGE = Column("image", "image flags", (2,), integer=True, rests=True, absent="image flags were not kept")
EXITS = Column("exits", "whether a disc has left, and where", (3,), in_state=False)
SPIN = Column(
    "spin",
    "angular velocity, counter-clockwise",
    given=True,
    scenes="of rough discs; here they are smooth",
    remedy="Give the scene friction, wall_friction or spin.",
    absent="discs are smooth",
)

COLUMNS: tuple[Column, ...] = (MASS, ACCELERATION, IMAGE, EXITS, SPIN)
"""All of them, in the order in which states and files have them."""


IN_STATE = tuple(column for column in COLUMNS if column.in_state)  # those of a state

GIVEN = tuple(column for column in COLUMNS if column.given)
"""Those that are arguments of Scene and of `Simulation.add`."""


class GivenColumns(TypedDict, total=False):
    """Types of the columns that `Simulation.add` is given by name, for type checkers."""

    spin: ArrayLike | None
