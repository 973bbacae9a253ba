"""Reads discs where a solver stores them, without copies in the order of their numbers."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import Box, State


class InPlace(NamedTuple):
    """N discs where they lie, in any order. Views: they may be read until the solver does something else, not kept.

    Attributes:
        x, y: shape (N,) [length]; along a periodic axis up to a period beyond the border.
        vx, vy: shape (N,) [length/time].
        number: of each disc, int32, shape (N,).
        absent: which discs have left, by number, shape (N,); None: none can.
        box: where the walls are now [length].
        frame, time: frames done, and time [time], since the start.
        radii: radius of each disc, by number, shape (N,) [length].
    """

    x: NDArray[np.floating]
    y: NDArray[np.floating]
    vx: NDArray[np.floating]
    vy: NDArray[np.floating]
    number: NDArray[np.int32]
    absent: NDArray[np.bool_] | None
    box: Box
    frame: int
    time: float
    radii: NDArray[np.float64]


def in_place(state: State, box: Box, frame: int, time: float, radii: NDArray[np.float64]) -> InPlace:
    """The discs of a state, where that has them.

    Args:
        state: of N discs.
        box: where the walls are if the state does not say [length].
        frame, time, radii: as above.

    >>> state = State(np.array([[1.0, 2.0], [3.0, 4.0]]), np.zeros((2, 2)))
    >>> found = in_place(state, (0.0, 5.0, 0.0, 5.0), 0, 0.0, np.full(2, 0.5))
    >>> found.y.tolist(), found.number.tolist(), found.absent
    ([2.0, 4.0], [0, 1], None)
    """
    (x, y), (vx, vy), absent = state.position.T, state.velocity.T, None if state.present.all() else ~state.present
    number = np.arange(len(x), dtype=np.int32)
    return InPlace(x, y, vx, vy, number, absent, box if state.box is None else state.box, frame, time, radii)
