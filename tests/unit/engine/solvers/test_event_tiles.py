"""How the box of the exact solver is divided."""

import itertools
import math

import numpy as np
import pytest
from support.scenes import gas, simulate

from mpsim.engine.solvers import event_block, event_tiles
from mpsim.engine.solvers.event_tiles import HALO, WHOLE, Tiling, tiling_of

BOUNDARIES = list(itertools.product([False, True], repeat=2))
SHAPES = [(10, 10), (19, 400), (20, 20), (39, 39), (40, 40), (41, 75), (140, 140), (1000, 20), (9, 5000), (700, 700)]


@pytest.mark.parametrize("periodic", BOUNDARIES)
@pytest.mark.parametrize("cells", SHAPES)
def test_no_tile_is_narrower_than_its_halo(cells, periodic):
    for workers, density in itertools.product((1, 2, 3, 8, 64), (0.3, 1.0, 3.0)):
        tiling = tiling_of(int(density * math.prod(cells)), cells, periodic, workers)
        for number, along, around in zip(tiling, cells, periodic, strict=True):
            widths = np.diff(np.arange(number + 1) * along // number)
            assert number == 1 or widths.min() >= HALO
            assert number == 1 or not around or widths.max() + 2 * HALO <= along, "a cell would be there twice"


@pytest.mark.parametrize("periodic", BOUNDARIES)
@pytest.mark.parametrize("workers", [2, 3, 4, 8, 16])
def test_every_worker_has_a_tile_where_there_is_room(workers, periodic):
    for side in (300, 1000):
        assert tiling_of(side**2, (side, side), periodic, workers).number >= workers


def test_where_it_does_not_pay_a_box_is_left_whole():
    for workers in (1, 2, 8):
        assert tiling_of(100, (10, 10), (False, False), workers) == WHOLE
        assert tiling_of(0, (40, 40), (True, True), workers) == WHOLE
    assert tiling_of(3000, (55, 55), (False, False), 1) == WHOLE
    assert tiling_of(5000, (9, 555), (False, False), 4).columns == 1


def test_two_tiles_around_a_periodic_axis_need_room_for_both_halos(monkeypatch):
    """Where anything is cheaper than the whole: a halo on both sides, of the one other tile."""
    monkeypatch.setattr(event_tiles, "_cost", lambda count, cells, periodic, workers, tiling: -tiling.number)
    for cells, expected in ((39, {1, 3}), (40, {1, 2, 3, 4})):
        assert set(event_tiles._numbers_along(cells, periodic=True)) <= expected
        assert (2 in event_tiles._numbers_along(cells, periodic=True)) == (cells == 40)
        assert 2 in event_tiles._numbers_along(cells, periodic=False)
    assert tiling_of(10, (25, 39), (True, False), 1) == (1, 3)
    assert tiling_of(10, (25, 39), (False, False), 1) == (2, 3)


def test_a_tiling_in_which_a_cell_would_be_there_twice_is_none(monkeypatch):
    monkeypatch.setattr(event_block, "tiling_of", lambda *arguments: Tiling(2, 1))
    with pytest.raises(AssertionError, match="no cell may be in a region twice"):
        simulate(gas(500, 0.3, boundary="periodic"), method="event")
