"""Reads checkpoints of older formats."""

import hashlib
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.archive import Arrays
from mpsim.kernels.events.boundary import COARSE
from mpsim.kernels.events.records import ENTRIES, FINE

TALLY, SEEN = "solver.tally", "solver.seen"


def in_this_format(arrays: Arrays, version: int) -> Arrays:
    """Arrays of a file of a format."""
    for since, convert in _CONVERSIONS:
        if version <= since:
            arrays = convert(arrays)
    return arrays


def digest_at_once(header: bytes, arrays: Arrays) -> str:
    """The digest of a file up to format 6: over the text of its header and the bytes of all its arrays."""
    digest = hashlib.blake2b(header, digest_size=16)
    for name in sorted(arrays):
        array = arrays[name]
        content: Any = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        digest.update(f"{name} {array.dtype.str} {array.shape or (1,)}".encode())
        digest.update(content)
    return digest.hexdigest()


def _with_virials(arrays: Arrays) -> Arrays:
    """The exact solver counted no virials by component, and does from there on."""
    end = 5  # of the entries that were there already, four walls and the virial; in `seen` the collisions follow them
    shapes = {TALLY: (end,), SEEN: (end + 1,)}
    counts = {name: arrays[name] for name, shape in shapes.items() if name in arrays and arrays[name].shape == shape}
    return arrays | {name: np.insert(array, end, [0.0, 0.0]) for name, array in counts.items()}


def _without_lists(arrays: Arrays) -> Arrays:
    """The exact solver kept its lists of cells, which follow from the discs."""
    return {name: array for name, array in arrays.items() if name not in ("solver.cell_head", "solver.cell_next")}


def _with_discs_first(arrays: Arrays) -> Arrays:
    """Solvers that step had two columns in the order of their block: components first."""
    if "solver.position" not in arrays:
        return arrays
    columns = {name: arrays[name] for name in ("solver.image", "solver.exits") if name in arrays}
    return arrays | {name: array.T for name, array in columns.items() if array.ndim == 2}


def _in_fixed_point(arrays: Arrays) -> Arrays:
    """The exact solver counted in real numbers, now in whole multiples of a unit."""
    shapes = {TALLY: (ENTRIES,), SEEN: (ENTRIES + 1,)}
    found = {name: arrays[name] for name, shape in shapes.items() if name in arrays and arrays[name].shape == shape}
    if len(found) < len(shapes) or not all(np.isfinite(array).all() for array in found.values()):
        return arrays
    most = max(float(np.abs(array[:ENTRIES]).max()) for array in found.values())
    unit = math.ldexp(COARSE, math.frexp(most)[1])
    parts = {name: np.concatenate([_parts(array[:ENTRIES], unit), array[ENTRIES:]]) for name, array in found.items()}
    counts = {name: array.astype(np.int64) for name, array in parts.items()}
    return arrays | counts | {"solver.units": np.array([unit, unit])}


def _parts(values: NDArray[np.float64], unit: float) -> NDArray[np.float64]:
    """Numbers as coarse and fine parts; see kernels/events/sums.py."""
    coarse = np.floor(values / unit)
    return np.concatenate([coarse, (values / unit - coarse) * 2.0**FINE])


_CONVERSIONS: tuple[tuple[int, Callable[[Arrays], Arrays]], ...] = (
    (1, _with_virials),
    (5, _without_lists),
    (5, _in_fixed_point),
    (6, _with_discs_first),
)
"""For files up to this format, one after the other."""
