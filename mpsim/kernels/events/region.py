"""The region of a store: the cells that are in it, those that are the tile's own, and the bands along its borders.

Cells are numbered column by column, from the first column and row of the region on. The region of a store that holds
the whole box is None, and the compiler drops the code that uses it.
"""

from mpsim.kernels.compiling import inlined

BAND = 3
"""Cells on either side of a border between two tiles in which both must find the same. A disc looks at the cells
around its own, so what is left of the band never looks at what is right of it."""

OUTER_LOW, INNER_LOW, MIDDLE, INNER_HIGH, OUTER_HIGH, ELSEWHERE = 0, 1, 2, 3, 4, -1


@inlined
def place_along(axis, cell, region, box):
    """Column or row of a cell, counted from the first one here; -1 if it is not here."""
    if region is None:
        return cell
    place = cell - region.first[axis]
    if place < 0:
        place += box.columns if axis == 0 else box.rows
    return place if place < region.here[axis] else -1


@inlined
def number_of_cell(column_place, row, region, box):
    """Number of the cell of a row in the column at such a place; -1 if it is not here."""
    if region is None:
        return column_place * box.rows + row
    row_place = place_along(1, row, region, box)
    return column_place * region.here[1] + row_place if column_place >= 0 and row_place >= 0 else -1


@inlined
def here_along(axis, region, box):
    """Columns or rows of cells that are here."""
    if region is None:
        return box.columns if axis == 0 else box.rows
    return region.here[axis]


@inlined
def counts(region):
    """1 if the current event counts here; 0 if it belongs to another tile."""
    if region is None:
        return 1
    return region.counts


@inlined
def begin_event(cell, region, box):
    """Before an event in a cell: it counts if the cell is the tile's own."""
    if region is not None:
        region.counts = is_own(cell, region, box)


@inlined
def band_along(axis, cell, region, box):
    """Where a cell lies along an axis: in the tile, in a band along a border of it, or ELSEWHERE. Only for tiles."""
    if region.differs[axis] == 0:
        return MIDDLE
    place = place_along(axis, cell, region, box)
    if place < 0:
        return ELSEWHERE
    place -= region.own_first[axis]
    own = region.own[axis]
    if place < -BAND or place >= own + BAND:
        return ELSEWHERE
    # OUTER_LOW, INNER_LOW, ... In plain Python the sum of NumPy's truths is their `or`.
    return int(place >= 0) + int(place >= BAND) + int(place >= own - BAND) + int(place >= own)


@inlined
def is_own(cell, region, box):
    """Whether a cell is the tile's own. Only for tiles."""
    for axis in range(2):
        place = place_along(axis, cell[axis], region, box) - region.own_first[axis]
        if place < 0 or place >= region.own[axis]:
            return False
    return True
