"""The particle arrays: their names, dtypes and order in the shared block, and the copies handed out of it."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

import hashlib
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mpsim.errors import InputError, OutputError
from mpsim.kernels import layout

MOST_FRAMES = 4096
"""Frames of one command at most: the length of the array of times in the shared block."""

CELLS_PER_DISC = 2
"""In a dilute scene cells grow beyond one diameter, so that there are about this many per disc."""


@dataclass(frozen=True)
class ArraySpec:
    """dtype and shape of one array of the shared block."""

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
    boundary: tuple[str, str] = ("walls", "walls"),
    outside: bool = False,
) -> Grid:
    """The grid of a scene: cells of one diameter, larger where there are fewer discs than cells / CELLS_PER_DISC.

    A cell is wider than a diameter by the rounding of a coordinate times the number of cells, so that discs two cells
    apart can never overlap. Along a periodic axis there are two or more, and an even number of columns: the last one is
    odd, and meets the first in the odd pass.
    """
    rounding = 8 * float(np.finfo(precision).eps) * max(width, height)
    side = max(diameter + rounding, math.sqrt(width * height / (CELLS_PER_DISC * max(count, 1))))
    least = [2 if word == "periodic" else 1 for word in boundary]
    columns, rows = max(int(width / side), least[0]), max(int(height / side), least[1])
    # In a box so thin that it has one row (or column), as many cells along it as elsewhere: their number must not grow
    # with the aspect of the box.
    most = CELLS_PER_DISC * max(count, 1)
    columns, rows = min(columns, max(most // rows, least[0])), min(rows, max(most // columns, least[1]))
    return Grid(columns - columns % least[0], rows, outside)


def block_arrays(
    capacity: int, grid: Grid, workers: int, precision: str, features: dict[str, ArraySpec], tallied: bool
) -> dict[str, ArraySpec]:
    """Every array of the shared block, by name. `features` holds what only some scenes need.

    tallied: whether measures are gathered, which needs a place for what each worker counts in each frame.
    """
    real, length = np.dtype(precision), capacity + layout.PADDING
    arrays: dict[str, ArraySpec] = {}
    for buffer in ("a", "b"):
        for field in layout.Discs._fields[:-1]:  # the radius is a feature
            integer = field in ("id", "cell")
            arrays[f"{buffer}.{field}"] = ArraySpec(np.dtype(np.int32) if integer else real, (length,))
    arrays["start"] = ArraySpec(np.dtype(np.int32), (grid.table_size,))
    arrays["outbox"] = ArraySpec(np.dtype(np.int32), (length,))
    arrays["parameters"] = ArraySpec(real, (layout.PARAMETERS,))
    word = np.dtype(np.int64)
    arrays["control"] = ArraySpec(word, (layout.CONTROL,))
    arrays["team"] = ArraySpec(word, (workers, layout.TEAM))
    arrays["sent"] = ArraySpec(word, (workers, max(workers, layout.TEAM)))
    arrays["times"] = ArraySpec(word, (workers, MOST_FRAMES, len(layout.PHASES)))
    if tallied:
        arrays["tally"] = ArraySpec(word, (workers, MOST_FRAMES, layout.TALLIES))
    return arrays | features


@dataclass(frozen=True)
class State:
    """Positions and velocities of all discs at one moment: copies, in the order of the scene's discs.

    Attributes:
        position: shape (N, 2) [length], in the precision of the run.
        velocity: shape (N, 2) [length/time].

    >>> import numpy as np
    >>> State(position=np.array([[1.0, 2.0]]), velocity=np.zeros((1, 2))).position.tolist()
    [[1.0, 2.0]]
    """

    position: NDArray[np.floating]
    velocity: NDArray[np.floating]

    def digest(self) -> str:
        """Hex digest of the bits of position and velocity; equal digests mean equal bits.

        >>> import numpy as np
        >>> State(np.zeros((1, 2)), np.ones((1, 2))).digest() == State(np.zeros((1, 2)), np.ones((1, 2))).digest()
        True
        """
        digest = hashlib.blake2b(digest_size=16)
        for array in (self.position, self.velocity):
            little_endian: DTypeLike = array.dtype.newbyteorder("<")
            digest.update(f"{array.dtype.name} {array.shape} ".encode())
            digest.update(np.ascontiguousarray(array, dtype=little_endian).tobytes())
        return digest.hexdigest()

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a NumPy .npz with the arrays position and velocity; an existing file is replaced.

        Raises:
            InputError: if the path does not end in .npz.
            OutputError: if it cannot be written.
        """
        target = _npz(path)
        try:
            with target.open("wb") as file:
                np.savez(file, position=self.position, velocity=self.velocity)
        except OSError as error:
            raise OutputError(
                f"a state must be in a folder that can be written to; got {str(target)!r} ({error.strerror}). "
                "Choose another place."
            ) from error
        return target

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "State":
        """Read what `save` wrote, with the same bits. Nothing in the file is executed.

        Raises:
            InputError: if it is no file of a state.

        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = State(np.zeros((3, 2)), np.ones((3, 2))).save(f"{folder}/final.npz")
        ...     State.load(path).velocity.sum()
        np.float64(6.0)
        """
        source = _npz(path)
        try:
            with np.load(source, allow_pickle=False) as file:
                state = cls(file["position"], file["velocity"])
        except Exception as error:  # what a damaged zip file can raise has no end
            raise InputError(f"a state must be a .npz with position and velocity; {str(source)!r}: {error}.") from None
        shapes, kinds = (
            {getattr(each, name) for each in (state.position, state.velocity)} for name in ("shape", "dtype")
        )
        if len(shapes) > 1 or state.position.shape[1:] != (2,) or len(kinds) > 1 or state.position.dtype.kind != "f":
            raise InputError(
                f"position and velocity of a state must have one shape, (N, 2), and one floating dtype; "
                f"{str(source)!r} holds {sorted(map(str, shapes))} of {sorted(map(str, kinds))}."
            )
        return state


def _npz(path: str | os.PathLike[str]) -> Path:
    if not isinstance(path, str | os.PathLike) or Path(os.fsdecode(path)).suffix != ".npz":
        raise InputError(f"the path of a state must end in .npz; got {path!r}. Use 'state.npz'.")
    return Path(os.fsdecode(path))
