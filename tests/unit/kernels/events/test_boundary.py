"""Walls and periodic borders of the exact solver."""

import numpy as np

from mpsim.kernels.events import boundary
from mpsim.kernels.events.records import BOTTOM, LEFT, RIGHT, TOP

BOX = boundary.Box(12.0, 8.0, True, False, 4, 2, 0.5)


def test_beyond_a_periodic_border_lies_the_opposite_cell_and_beyond_a_wall_none():
    assert boundary.neighbour(4, 4, 12.0, True) == (0, 12.0)
    assert boundary.neighbour(-1, 4, 12.0, True) == (3, -12.0)
    assert boundary.neighbour(-1, 2, 8.0, False)[0] == boundary.neighbour(2, 2, 8.0, False)[0] == -1
    assert boundary.neighbour(1, 2, 8.0, False) == (1, 0.0)


def test_a_border_is_a_wall_at_the_end_of_an_axis_that_is_not_periodic():
    found = {(side, cell) for side in (LEFT, RIGHT, BOTTOM, TOP) for cell in [(0, 0), (3, 1)]
             if boundary.is_wall(side, cell, BOX)}  # fmt: skip
    assert found == {(BOTTOM, (0, 0)), (TOP, (3, 1))}


def test_a_centre_stays_a_radius_from_walls():
    assert boundary.range_in_cell(0, 2, 8.0, False, 0.5) == (0.5, 4.0)
    assert boundary.range_in_cell(1, 2, 8.0, False, 0.5) == (4.0, 7.5)
    assert boundary.range_in_cell(3, 4, 12.0, True, 0.5) == (9.0, 12.0)


def test_what_has_flown_out_is_brought_back_with_its_periods():
    inside, periods = boundary.brought_back(np.array([-1.0, 5.0, 12.0, 37.0, -1e-300]), 0.5, 0, BOX)
    assert inside.tolist() == [11.0, 5.0, 0.0, 1.0, 0.0]
    assert periods.tolist() == [-1, 0, 1, 3, 0]
    inside, periods = boundary.brought_back(np.array([0.4999, 7.5001, 3.0]), 0.5, 1, BOX)
    assert inside.tolist() == [0.5, 7.5, 3.0]
    assert not periods.any()


def test_who_is_inside_follows_from_walls_and_radius():
    places = np.array([0.4, 0.5, 7.5, 7.6])
    assert boundary.are_inside(places, 0.5, 1, BOX).tolist() == [False, True, True, False]
    assert boundary.are_inside(places, np.array([0.4, 0.6, 0.5, 0.3]), 1, BOX).tolist() == [True, False, True, True]
    assert boundary.are_inside(places, 0.5, 0, BOX).all()
