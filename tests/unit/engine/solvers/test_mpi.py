"""How the columns of the grid are dealt to ranks, and where they meet."""

import numpy as np
import pytest

from mpsim.engine.solvers.mpi_columns import Border, Range, borders_of, dealt, in_turns


@pytest.mark.parametrize("ranks", [1, 2, 3, 7, 10])
@pytest.mark.parametrize("crowd", ["even", "first", "last", "none"])
def test_each_rank_has_a_column_at_least(ranks, crowd):
    columns = {
        "even": np.arange(100) % 10,
        "first": np.zeros(100, int),
        "last": np.full(100, 9),
        "none": np.zeros(0, int),
    }
    firsts = dealt(np.bincount(columns[crowd], minlength=10), ranks)
    assert (firsts[0], firsts[-1]) == (0, 10)
    assert (np.diff(firsts) >= 1).all()


def test_columns_are_dealt_in_nearly_equal_numbers_of_discs():
    column = np.repeat(np.arange(40), np.arange(40))  # 780 discs, more and more to the right
    discs = np.diff(np.searchsorted(column, dealt(np.bincount(column, minlength=40), 4)))
    assert discs.sum() == 780
    assert abs(discs - 195).max() < 40, "but for one column"


def test_the_border_of_columns_is_taken_that_is_nearest_to_an_equal_share():
    counts = np.random.default_rng(1).integers(1, 40, 200)
    discs_before = np.append(0, np.cumsum(counts))
    for first, share in zip(dealt(counts, 20), counts.sum() * np.arange(21) / 20, strict=True):
        assert abs(discs_before[first] - share) == abs(discs_before - share).min()


def test_a_column_has_in_its_rank_the_parity_that_it_has_in_the_grid():
    for first in range(5):
        own = Range(first, first + 3)
        assert own.before % 2 == 0
        assert 0 <= first - own.before < 2


def test_ranks_meet_those_beside_them():
    own = Range(3, 6)
    left, right = Border(0, 1, is_left=False), Border(2, 3, is_left=True)
    assert borders_of(own, 1, 3, False) == [left, right]
    assert borders_of(own, 0, 3, False) == [Border(1, 3, is_left=True)]
    assert borders_of(own, 2, 3, False) == [Border(1, 1, is_left=False)]
    assert borders_of(own, 0, 1, False) == []


def test_the_last_columns_meet_the_first_ones_beyond_a_periodic_border():
    assert borders_of(Range(3, 6), 1, 2, True) == [Border(0, 1, is_left=False), Border(0, 3, True, True)]
    assert borders_of(Range(0, 3), 0, 2, True) == [Border(1, 0, False, True), Border(1, 2, is_left=True)]
    assert borders_of(Range(6, 9), 2, 3, True) == [Border(1, 0, is_left=False), Border(0, 2, True, True)]
    assert borders_of(Range(0, 9), 0, 1, True) == [], "one rank has both"


def test_columns_go_at_once_but_for_one_that_is_at_two_borders():
    even, odd = Border(0, 1, is_left=False), Border(2, 1, is_left=True)
    assert (even.is_odd, odd.is_odd) == (False, True)
    assert in_turns([odd, even], Range(1, 2)) == [[even], [odd]]
    borders = borders_of(Range(1, 5), 1, 3, False)
    assert in_turns(borders, Range(1, 5)) == [borders]
    assert in_turns([], Range(0, 5)) == in_turns([], Range(0, 1)) == []
