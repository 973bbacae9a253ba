"""Columns by id: numbers of each disc that lie in the block in the order of the discs' numbers, each declared once.

The block, discs that enter, snapshots and with them checkpoints follow from the declaration. What every kernel needs at
once, places and speeds, lies in the order of the grid instead: `mpsim.kernels.layout.Discs`.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Column(NamedTuple):
    """Numbers of each disc in an array of the block, of shape (*components, capacity).

    Attributes:
        name: of the array, and in a snapshot. Discs that enter bring the attribute of that name, shape
            (K, *components); where they have none, or it is None, they begin with zeros.
        components: () for one number of each disc.
        integer: int64; else of the precision of the run.
        kept: whether a snapshot holds it: frames change it, or discs that enter bring it.
        discs_first: whether its shape is (N, *components) there, as in the scene; else as in the block.
    """

    name: str
    components: tuple[int, ...] = ()
    integer: bool = False
    kept: bool = True
    discs_first: bool = False

    def dtype(self, real: np.dtype[Any]) -> np.dtype[Any]:
        """Of its numbers, those of the run being `real`."""
        return np.dtype(np.int64) if self.integer else real

    def shape(self, count: int) -> tuple[int, ...]:
        """Of the array of a block for so many discs."""
        return (*self.components, count)

    def kept_shape(self, count: int) -> tuple[int, ...]:
        """Of the array of a snapshot of so many discs."""
        return (count, *self.components) if self.discs_first else self.shape(count)

    def enter(self, arrays: Mapping[str, Any], new: object, first: int, last: int) -> None:
        """Write what discs bring that enter as `first`, `first` + 1, ..., if the block has the column."""
        if self.name in arrays:
            brought = getattr(new, self.name, None)
            arrays[self.name][..., first:last] = 0 if brought is None else brought.T

    def take(self, arrays: Mapping[str, Any], count: int) -> NDArray[Any]:
        """A copy for a snapshot."""
        found = arrays[self.name][..., :count]
        return (found.T if self.discs_first else found).copy()

    def put(self, arrays: Mapping[str, Any], kept: NDArray[Any]) -> None:
        """Write back what a snapshot holds."""
        values = kept.T if self.discs_first else kept
        arrays[self.name][..., : values.shape[-1]] = values
