"""Discs sorted by cell are taken as if they were tried one after the other."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mpsim.kernels.placement import by_cell
from mpsim.scene.placement import _sort_by_cell

SIZE = (9.0, 7.0)


def points_at(places, diameter):
    """Sorted in parts of 7, as many places come."""
    parts = lambda: [places[first : first + 7] for first in range(0, len(places), 7)]  # noqa: E731
    return _sort_by_cell(len(places), SIZE, diameter, parts)


def random_places(seed, count):
    return np.random.default_rng(seed).random((count, 2)) * SIZE


def taken_twin(places, diameter):
    """Numbers of the candidates that are taken, by trying each after the other."""
    taken = []
    for number, place in enumerate(places):
        if all(math.dist(place, places[other]) >= diameter for other in taken):
            taken.append(number)
    return taken


@given(st.integers(0, 2**32), st.integers(1, 150), st.floats(0.01, 12), st.integers(1, 3))
def test_those_are_taken_that_random_sequential_addition_takes(seed, count, diameter, waiting):
    """However few of them may wait for one another."""
    places = random_places(seed, count)
    points = points_at(places, diameter)
    state = np.full(count, by_cell.UNDECIDED, np.int8)
    while not by_cell.take_sequentially(points, state, np.empty(waiting, np.int32), diameter, 0, count):
        pass
    assert sorted(points.number[state == by_cell.TAKEN]) == taken_twin(places, diameter)


def test_points_lie_in_the_order_of_cells_and_there_of_their_numbers():
    places = random_places(1, 100)
    points = points_at(places, 1.0)
    assert (np.column_stack([points.x, points.y]) == places[points.number]).all()
    cells = (points.x * points.per_x).astype(int) * points.rows + (points.y * points.per_y).astype(int)
    assert (np.lexsort((points.number, cells)) == np.arange(100)).all()
    assert points.start[0] == 0
    assert (np.diff(points.start) == np.bincount(cells, minlength=points.columns * points.rows)).all()


@pytest.mark.parametrize("most", [0, 3, 1000])
def test_discs_get_the_first_places_that_are_taken(most):
    places = random_places(2, 200)
    points = points_at(places, 1.5)
    state = np.full(200, by_cell.UNDECIDED, np.int8)
    assert by_cell.take_sequentially(points, state, np.empty(1000, np.int32), 1.5, 0, 200)
    order = np.empty(200, np.int32)
    placed = by_cell.number_taken(points, state, order, most)
    wanted = taken_twin(places, 1.5)[:most]
    assert placed == len(wanted)
    x, y = np.zeros(placed), np.zeros(placed)
    by_cell.copy_taken(points, order, x, y)
    assert (np.column_stack([x, y]) == places[wanted]).all()


@given(st.integers(0, 2**32), st.floats(0.1, 9))
def test_what_is_kept_is_sorted_still_and_rejects_what_overlaps_it(seed, diameter):
    places = random_places(seed, 60)
    points = points_at(places, diameter)
    order = np.where(np.arange(60) % 3 == 0, np.arange(60) // 3, -1).astype(np.int32)
    assert by_cell.keep_taken(points, order) == 20
    kept = points._replace(x=points.x[:20], y=points.y[:20], number=points.number[:20])
    assert (np.column_stack([kept.x, kept.y]) == places[::3][kept.number]).all()
    others = random_places(seed + 1, 40)
    candidates = points_at(others, diameter)
    state = np.full(40, by_cell.UNDECIDED, np.int8)
    by_cell.reject_overlapping(candidates, state, kept, diameter, 0, 40)
    twin = [any(math.dist(place, disc) < diameter for disc in places[::3]) for place in others]
    assert (state == by_cell.REJECTED).tolist() == [twin[number] for number in candidates.number]


def test_of_pairs_that_are_equally_deep_the_first_is_named():
    places = np.array([[6.0, 5.0], [1.0, 1.0], [1.5, 1.0], [6.5, 5.0]])
    worst = np.zeros(2, np.int64)
    assert by_cell.find_overlaps(points_at(places, 1.0), 1.0, worst, 0, len(places)) == (2, 0.5)
    assert worst.tolist() == [1, 2]
