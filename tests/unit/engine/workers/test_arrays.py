"""The grid of cells."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mpsim.engine.workers.arrays import grid_for


@given(
    st.integers(0, 3000),
    st.floats(1, 1e4),
    st.floats(1, 1e4),
    st.floats(1e-3, 1),
    st.sampled_from(["float32", "float64"]),
)
def test_cells_are_never_narrower_than_a_diameter_and_never_many_more_than_discs(
    count, width, height, diameter, precision
):
    grid = grid_for(count, width, height, diameter, precision)
    assert grid.columns >= 1
    assert grid.rows >= 1
    for cells, length in ((grid.columns, width), (grid.rows, height)):
        # The index int(x * cells / length) of two discs two cells apart is wrong by rounding at most this much:
        rounding = 4 * float(np.finfo(precision).eps) * length
        assert cells == 1 or length / cells >= diameter + rounding
    if min(grid.columns, grid.rows) > 1:
        assert grid.columns * grid.rows <= 2 * max(count, 1)
    assert grid.table_size == (grid.columns + 1) * (grid.rows + 2) + 1


def test_cells_are_about_a_diameter_wide_in_a_dense_scene():
    grid = grid_for(10_000, 100, 100, 1.0, "float64")
    assert (grid.columns, grid.rows) == (99, 99)
    assert grid_for(100, 1000, 1000, 1.0, "float64").columns == int(1000 / math.sqrt(1000 * 1000 / 200))


def test_a_larger_scene_never_has_a_smaller_grid():
    """So a block made for more discs has room for the table of fewer."""
    sizes = [grid_for(count, 30, 50, 0.5, "float64").table_size for count in range(5000)]
    assert sizes == sorted(sizes)
