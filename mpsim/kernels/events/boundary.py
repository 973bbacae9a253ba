"""The box of the exact solver, and its boundaries: walls, or a periodic border along an axis.

This file says where a centre can be, what lies beyond a border, whether a border is a wall, and what happens to a disc
that leaves through it. The impact on a wall is in impacts.py. An axis has walls or is periodic, and an image is shifted
along an axis, in position only: impacts.py, prediction.py and cells.py pass on `box.periodic_x` and `box.periodic_y` by
name. A boundary whose images differ in more than position must change those files too.
"""

from collections import namedtuple

import numpy as np

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.features.hooks import through_border
from mpsim.kernels.events.records import RIGHT, TOP

COARSE = 2.0**-20
"""Unit of a sum, in parts of a typical summand."""

Box = namedtuple(
    "Box",
    "width height periodic_x periodic_y columns rows radius impulse_unit virial_unit",
    defaults=(COARSE, COARSE),
)
"""width, height [length]; periodic_x, periodic_y: bool; columns, rows of cells; radius of every disc, if the scene does
not give one for each [length]; units of sums of impulses [mass length/time] and virials [mass length^2/time]."""


@inlined
def along(axis, box):
    """The box along an axis: (length, cells, whether it is periodic)."""
    if axis == 0:
        return box.width, box.columns, box.periodic_x
    return box.height, box.rows, box.periodic_y


# --- positions and images ---------------------------------------------------------------------------


@inlined
def range_in_cell(cell, cells, length, periodic, radius):
    """Along one axis, where the centre of a disc in a cell can be: (low, high), borders of the cell or walls."""
    cell_length = length / cells
    low = cell * cell_length
    high = (cell + 1) * cell_length
    if not periodic:
        low = max(low, radius)
        high = min(high, length - radius)
    return low, high


@inlined
def neighbour(cell, cells, length, periodic):
    """A cell that may lie beyond the box, along one axis: (the cell found there or -1, shift of its image)."""
    if cell < 0:
        return (cell + cells, -length) if periodic else (-1, 0.0)
    if cell >= cells:
        return (cell - cells, length) if periodic else (-1, 0.0)
    return cell, 0.0


# --- a disc at a border -------------------------------------------------------------------------------------------


@inlined
def is_wall(side, cell, box):
    """Whether the border of a cell at `side` is a wall."""
    axis = side >> 1
    cells = box.columns if axis == 0 else box.rows
    periodic = box.periodic_x if axis == 0 else box.periodic_y
    return not periodic and cell[axis] == (cells - 1 if side in (RIGHT, TOP) else 0)


@inlined
def cell_beyond(i, axis, direction, store, box, features):
    """The cell that disc i enters upward (direction = 1) or downward (-1) along an axis.

    Through a periodic border, its centre enters on the opposite side.
    """
    length, cells, _ = along(axis, box)
    cell = store.event[i].cell[axis] + direction
    if cell < 0 or cell >= cells:
        cell -= direction * cells
        store.disc[i].position[axis] -= direction * length
        through_border(i, axis, direction, features)
    return cell


# --- all discs, outside of events ---------------------------------------------------------------------------------


def are_inside(position, radius, axis, box):
    """Which positions [length], shape (N,), along an axis are in the box, within rounding."""
    length, _, periodic = along(axis, box)
    low = 0.0 if periodic else radius
    slack = 1e-12 * length
    return (position >= low - slack) & (position <= length - low + slack)


def brought_back(flown, radius, axis, box):
    """Positions [length] of shape (N,) along an axis inside the box, and by how many periods: (positions, periods)."""
    length, _, periodic = along(axis, box)
    # Only rounding can have put a centre beyond a limit.
    inside = np.mod(flown, length) if periodic else np.clip(flown, radius, length - radius)
    if not periodic:
        return inside, np.zeros(len(flown), np.int64)
    inside[inside == length] = 0.0
    # If a position is not finite, or has no digit in the box, no period is counted.
    periods = np.rint((flown - inside) / length)
    return inside, np.where(np.abs(periods) < 2.0**53, periods, 0.0).astype(np.int64)
