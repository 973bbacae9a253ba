"""Radii and masses of discs, stored as one number if all are equal."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def equal_sizes(size: float, count: int) -> NDArray[np.float64]:
    """So many equal numbers, read-only.

    >>> equal_sizes(0.5, 3)
    array([0.5, 0.5, 0.5])
    """
    # Not np.broadcast_to, which runs Python code: an interrupt in there would be lost.
    sizes = np.ndarray((count,), np.float64, np.array([size], np.float64), strides=(0,))
    sizes.flags.writeable = False
    return sizes


def kept_sizes(*parts: ArrayLike) -> NDArray[np.float64]:
    """Numbers one after the other, a copy, read-only.

    Args:
        parts: of each array or number, shape (K,) or ().

    >>> kept_sizes([1, 1], 2).tolist(), kept_sizes([2, 2], 2).strides
    ([1.0, 1.0, 2.0], (0,))
    """
    arrays = [np.atleast_1d(np.asarray(part, np.float64)) for part in parts]
    ends = [(float(part.min()), float(part.max())) for part in arrays if part.size]
    if ends and min(low for low, _ in ends) == max(high for _, high in ends):
        return equal_sizes(ends[0][0], sum(part.size for part in arrays))
    sizes = np.concatenate(arrays)
    sizes.flags.writeable = False
    return sizes


def of_each_disc(arrays: Mapping[str, NDArray[Any]], names: Iterable[str], discs: Any) -> dict[str, NDArray[Any]]:
    """Arrays of a file, those of these names repeated for each disc where they are one number, which takes no memory.

    Raises:
        ValueError: if no array in the file is for so many discs: what follows makes room for them.
    """
    once = [name for name in names if name in arrays and not arrays[name].ndim]
    # A list: an interrupt while a generator that is not at its end is thrown away would be lost.
    if once and not any([array.ndim and len(array) == discs for array in arrays.values()]):
        raise ValueError(f"it has no array for {discs!r:.30} discs")
    return {name: np.broadcast_to(array, discs) if name in once else array for name, array in arrays.items()}
