"""Distribution of the columns of the grid to ranks, and the borders between ranks."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.workers.arrays import Grid


class Range(NamedTuple):
    """The columns of a rank: from `first` to before `last`."""

    first: int
    last: int

    @property
    def before(self) -> int:
        """Columns that are not in the rank's own grid: an even number, so that a column keeps its parity."""
        return self.first - self.first % 2


class Border(NamedTuple):
    """Where the columns of a rank meet those of another.

    Attributes:
        other: the rank beyond.
        column: the own column there, in the rank's own grid.
        is_left: whether that is the left one of the two, as the last column is of the first one beyond a periodic
            border.
        is_periodic: whether they meet there.
    """

    other: int
    column: int
    is_left: bool
    is_periodic: bool = False

    @property
    def is_odd(self) -> bool:
        """Whether the odd pass has the bracket of the two, which is that of the left one."""
        return (self.column - (not self.is_left)) % 2 == 1


def columns_of_places(x: NDArray[Any], grid: Grid, width: float, precision: str) -> NDArray[np.int64]:
    """Column of each disc."""
    real = np.dtype(precision).type
    return np.clip((x.astype(real) * real(grid.columns / width)).astype(np.int64), 0, grid.columns - 1)


def dealt(counts: NDArray[np.int64], ranks: int) -> NDArray[np.int64]:
    """First column of each rank, and the end: whole columns, at least one each, in nearly equal numbers of discs.

    counts: discs in each column.
    """
    discs_before = np.concatenate([[0], np.cumsum(counts)])
    middles = (discs_before[:-1] + discs_before[1:]) / 2  # so that the border of columns is taken that is nearest
    firsts = np.searchsorted(middles, np.arange(ranks + 1) * (discs_before[-1] / ranks))
    firsts[0], firsts[-1] = 0, len(counts)
    most = len(counts) - ranks + np.arange(ranks + 1)
    return np.minimum(np.maximum.accumulate(firsts - np.arange(ranks + 1)) + np.arange(ranks + 1), most)


def borders_of(own: Range, rank: int, ranks: int, periodic: bool) -> list[Border]:
    """Where the columns of a rank meet those of others; periodic: whether the last meet the first."""
    first, last = own.first - own.before, own.last - own.before
    meets = periodic and ranks > 1
    left = [Border((rank - 1) % ranks, first, is_left=False, is_periodic=rank == 0)] if rank > 0 or meets else []
    at_end = rank == ranks - 1
    right = [Border((rank + 1) % ranks, last - 1, is_left=True, is_periodic=at_end)] if not at_end or meets else []
    return left + right


def in_turns(borders: list[Border], own: Range) -> list[list[Border]]:
    """The borders at which columns go at a time, in the order of the passes.

    All at once, as no bracket of a pass is at two of them: of two own columns at borders, one that the odd pass needs
    meets no other border's before. Only a single own column is at both: the even pass comes first.
    """
    if own.last - own.first > 1:
        return [borders] if borders else []
    return [turn for odd in (False, True) if (turn := [border for border in borders if border.is_odd == odd])]
