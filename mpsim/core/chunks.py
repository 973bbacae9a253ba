"""Arrays with a row per disc that are read in chunks, because no process holds them completely."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

CHUNK = 2**16
"""Rows that are read at a time."""


def ranges(count: int, length: int | None = None) -> list[tuple[int, int]]:
    """First row and the one after the last of each chunk of so many rows.

    length: of a chunk; None: CHUNK.

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

    def __init__(
        self,
        dtype: np.dtype[Any],
        shape: tuple[int, ...],
        read: Callable[[int, int], NDArray[Any]],
    ):
        self.dtype: np.dtype[Any] = dtype
        self.shape: tuple[int, ...] = shape
        self._read = read

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

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
        yield from (np.ascontiguousarray(self._read(*each)) for each in ranges(len(self)))


Array = NDArray[Any] | ChunkedArray


def chunks_of(array: Array) -> Iterator[NDArray[Any]]:
    """An array in the order of C, in contiguous arrays: one of them if it lies in memory.

    >>> [chunk.tolist() for chunk in chunks_of(np.array([[1, 2], [3, 4]]).T)]
    [[[1, 3], [2, 4]]]
    """
    return array.chunks() if isinstance(array, ChunkedArray) else iter([np.asarray(array, order="C")])
