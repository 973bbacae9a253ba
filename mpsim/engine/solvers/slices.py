"""Times and counts of one command of a solver."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.kernels import layout, records

MOST_COUNTED = 2.0**61
"""The largest sum of momenta, in units of the counts: of impulses twice as large the sum fits into 63 bits."""


@dataclass(frozen=True)
class Slice:
    """What one command of a solver took and counted.

    Attributes:
        times: int64 [ns], shape (workers, frames, phases), zero for workers at rest.
        contacts: contacts resolved.
        tally: COUNTS, shape (frames,), in the scene's units, or None if nothing was to be counted.
    """

    times: NDArray[np.int64]
    contacts: int
    tally: NDArray[Any] | None


def totals(tally: NDArray[Any], scale: float, diameter: float) -> NDArray[Any]:
    """What all workers counted in each frame, in the scene's units: COUNTS, shape (frames,).

    Args:
        tally: TALLY, shape (workers, frames), in units of the kernels.
        scale: by which impulses were multiplied.
        diameter: of the largest disc [length].
    """
    found = np.zeros(tally.shape[1], records.COUNTS)
    for name in records.COUNTS.names or ():
        found[name] = tally[name].sum(axis=0)
    found["deepest"] = tally["deepest"].max(axis=0)
    for name in records.IMPULSES:
        found[name] /= scale
    for name in records.DEPTHS:
        found[name] *= diameter / layout.DEPTH_SCALE
    return found
