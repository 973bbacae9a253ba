"""The declaration of all columns: numbers of each disc that are stored by disc number.

Block, discs that enter, snapshots and with them checkpoints, states, their digests and files, and the frames of
trajectories follow from the declarations. Which scenes have a column its feature says (`Feature.columns`). What every
kernel needs at once, places and speeds, lies in the order of the grid instead: `mpsim.kernels.layout.Discs`.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.errors import InputError


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
        """What is given for so many discs, of shape `rows`: one number for all or one each; of pairs one each.

        Raises:
            InputError: naming the column.
        """
        if self.components:
            shape = self.rows(count)
            return checks.finite_array(self.name, checks.rows(value), shape, f"{shape}, as position has")
        each = np.full(count, value) if checks.dimensions(value) == 0 else value
        return checks.finite_array(self.name, each, (count,), f"() or ({count},), one per row of position")

    def of_state(self, values: Any, count: int) -> NDArray[Any]:
        """What a state of so many discs is to hold, as an array.

        Raises:
            InputError: for another shape, or another kind of numbers.
        """
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


class StateColumns(TypedDict, total=False):
    """Types of the columns that a state is made of by name, for type checkers."""

    spin: NDArray[np.floating] | None


class GivenColumns(TypedDict, total=False):
    """Types of the columns that `Simulation.add` is given by name, for type checkers."""

    spin: ArrayLike | None


def in_state() -> list[Column]:
    """Those of a state."""
    return [column for column in COLUMNS if column.in_state]


def given() -> list[Column]:
    """Those that are arguments of Scene and of `Simulation.add`."""
    return [column for column in COLUMNS if column.given]


def check_names(function: str, names: Iterable[str], own: Iterable[str], known: Iterable[Column]) -> None:
    """Refuse arguments by name that are neither a function's `own` nor such columns.

    Raises:
        UnknownArgumentError: naming the first.
    """
    checks.known_arguments(function, names, [*own, *(column.name for column in known)])
