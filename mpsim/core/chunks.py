"""Arrays with a row for each disc that are read in chunks, as no process holds them whole."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

CHUNK = 2**16
"""Rows that are read at a time."""


def ranges(count: int) -> list[tuple[int, int]]:
    """First row and the one after the last of each chunk of so many rows.

    >>> ranges(CHUNK + 1), ranges(0)
    ([(0, 65536), (65536, 65537)], [])
    """
    return [(first, min(first + CHUNK, count)) for first in range(0, count, CHUNK)]


class ChunkedArray:
    """An array of which any range of rows can be read. Slices are arrays; `numpy.asarray` reads all of it.

    Args:
        dtype, shape: of the whole.
        read: called with (first, last), returns these rows, one for each disc, shape (last - first, *components).
        rows_last: whether discs are along the last axis of `shape`, not the first, as in columns of a block.

    >>> squares = ChunkedArray(np.dtype(np.int64), (10,), lambda first, last: np.arange(first, last) ** 2)
    >>> squares[2:5], len(squares), int(np.asarray(squares).sum())
    (array([ 4,  9, 16]), 10, 285)
    """

    def __init__(
        self,
        dtype: np.dtype[Any],
        shape: tuple[int, ...],
        read: Callable[[int, int], NDArray[Any]],
        rows_last: bool = False,
    ):
        self.dtype: np.dtype[Any] = dtype
        self.shape: tuple[int, ...] = shape
        self._read = read
        self._rows_last = rows_last

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """A range of rows, discs first."""
        first, last, step = rows.indices(self.shape[-1 if self._rows_last else 0])
        assert step == 1  # nobody asks for others
        return self._read(first, last)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        rows = self[:]
        whole = np.ascontiguousarray(rows.T) if self._rows_last else rows
        return whole if dtype is None else whole.astype(dtype, copy=False)

    def chunks(self) -> Iterator[NDArray[Any]]:
        """All of it in the order of C, in contiguous arrays."""
        parts = ranges(self.shape[-1 if self._rows_last else 0])
        if not self._rows_last or self.ndim == 1:
            yield from (np.ascontiguousarray(self._read(*each)) for each in parts)
            return
        for component in np.ndindex(self.shape[:-1]):
            yield from (np.ascontiguousarray(self._read(*each)[(slice(None), *component)]) for each in parts)


Array = NDArray[Any] | ChunkedArray


def chunks_of(array: Array) -> Iterator[NDArray[Any]]:
    """An array in the order of C, in contiguous arrays: one of them if it lies in memory.

    >>> [chunk.tolist() for chunk in chunks_of(np.array([[1, 2], [3, 4]]).T)]
    [[[1, 3], [2, 4]]]
    """
    return array.chunks() if isinstance(array, ChunkedArray) else iter([np.asarray(array, order="C")])
