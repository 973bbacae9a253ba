"""The arrays of the shared block: their names, dtypes and shapes; and the grid, which sets the shape of one."""

import math
from dataclasses import dataclass

import numpy as np

from mpsim.features.edges import WALLED, wraps_of
from mpsim.kernels import layout, records
from mpsim.kernels.frame.incremental_sort import BUCKET
from mpsim.kernels.frame.sharing import FEW

MOST_FRAMES = 4096
"""Frames of one command at most: the length of the array of times in the shared block."""

WORDS = records.LINE_PAIR // 8
"""int64 words that one worker's row of an array is a multiple of."""

CELLS_PER_DISC = 2
"""In a dilute scene cells grow beyond one diameter, so that there are about this many per disc."""


@dataclass(frozen=True)
class ArraySpec:
    """dtype and shape of one array of the shared block; of shape () it is a record."""

    dtype: np.dtype
    shape: tuple[int, ...]

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return self.dtype.itemsize * math.prod(self.shape)


@dataclass(frozen=True)
class Grid:
    """Cells of the broad phase. A function of box, diameter, precision and number of discs only: never of history."""

    columns: int
    rows: int
    outside: bool = False

    @property
    def table_size(self) -> int:
        """Length of the table of cell starts, with a ghost cell below and above each column and a ghost column.

        outside: and a column for discs that are not in the grid, giants and those that have left.
        """
        return (self.columns + 1 + self.outside) * (self.rows + 2) + 1


def grid_for(
    count: int,
    width: float,
    height: float,
    diameter: float,
    precision: str,
    boundary: tuple[str, str] = WALLED,
    outside: bool = False,
) -> Grid:
    """The grid of a scene: cells of one diameter, larger where there are fewer discs than cells / CELLS_PER_DISC.

    A cell is wider than a diameter by the rounding of a coordinate times the number of cells, so that discs two cells
    apart can never overlap. Along an axis that wraps there are two or more, and along x an even number: the last column
    is odd, and meets the first in the odd pass, in which no other column touches either.
    """
    rounding = 8 * float(np.finfo(precision).eps) * max(width, height)
    side = max(diameter + rounding, math.sqrt(width * height / (CELLS_PER_DISC * max(count, 1))))
    wraps_x, wraps_y = wraps_of(boundary)
    fewest_columns, fewest_rows = 1 + wraps_x, 1 + wraps_y
    columns, rows = max(int(width / side), fewest_columns), max(int(height / side), fewest_rows)
    # In a box so thin that it has one row (or column), as many cells along it as elsewhere: their number must not grow
    # with the aspect of the box.
    most = CELLS_PER_DISC * max(count, 1)
    columns, rows = min(columns, max(most // rows, fewest_columns)), min(rows, max(most // columns, fewest_rows))
    return Grid(columns - columns % 2 if wraps_x else columns, rows, outside)


def block_arrays(
    capacity: int, grid: Grid, workers: int, precision: str, features: dict[str, ArraySpec]
) -> dict[str, ArraySpec]:
    """Every array and record of the shared block, by name. `features` holds what only some scenes need."""
    real, length = np.dtype(precision), capacity + layout.PADDING
    arrays: dict[str, ArraySpec] = {}
    for buffer in ("a", "b"):
        for column in layout.Discs._fields:
            if column not in layout.OPTIONAL:  # those are features
                dtype = np.dtype(np.int32) if column in layout.WHOLE else real
                arrays[f"{buffer}.{column}"] = ArraySpec(dtype, (length,))
    arrays["start"] = ArraySpec(np.dtype(np.int32), (grid.table_size,))
    for name in layout.Changes._fields:
        arrays[name] = ArraySpec(np.dtype(np.int32), (capacity // FEW + 1,))
    arrays["first_arrival"] = ArraySpec(np.dtype(np.int32), (grid.table_size // BUCKET + workers + 1,))
    arrays["outbox"] = ArraySpec(np.dtype(np.int32), (length,))
    arrays["parameters"] = ArraySpec(records.parameters_in(precision), ())
    arrays["control"] = ArraySpec(records.CONTROL, ())
    arrays["team"] = ArraySpec(records.MEMBER, (workers,))
    word = np.dtype(np.int64)
    arrays["sent"] = ArraySpec(word, (workers, -(-workers // WORDS) * WORDS))
    arrays["times"] = ArraySpec(word, (workers, MOST_FRAMES, len(layout.PHASES)))
    arrays["tally"] = ArraySpec(records.TALLY, (workers, MOST_FRAMES))
    return arrays | features
