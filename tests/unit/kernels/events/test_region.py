"""Cells of a tile with its halo, and its bands, against lists of them."""

import itertools

import numpy as np
import pytest
from support.internals import machine_code

from mpsim.kernels.events import records, region, tiles
from mpsim.kernels.events.boundary import Box

place_along, band_along, is_own = map(machine_code, (region.place_along, region.band_along, region.is_own))
set_region = machine_code(tiles.set_region)

HALO = 10
BOXES = list(itertools.product([(40, 2), (41, 2), (30, 3), (33, 3), (64, 4), (64, 1), (75, 5)], [False, True]))


def regions_of(cells, number, periodic, axis):
    """Of each tile along an axis: first cell, number of cells, and the region with its box."""
    sizes = [50, 50]
    sizes[axis] = cells
    box = Box(50.0, 50.0, periodic, periodic, *sizes, 0.5)
    plan = np.zeros((), records.PLAN)[()]
    plan.tiles[:] = 1
    plan.tiles[axis], plan.halo = number, HALO
    edges = np.arange(number + 1) * cells // number
    for first, end in itertools.pairwise(edges):
        tile, found = np.zeros((), records.TILE)[()], np.zeros((), records.REGION)[()]
        tile.own[:] = 50
        tile.own_first[axis], tile.own[axis] = first, end - first
        set_region(found, tile, plan, box)
        yield int(first), int(end - first), found, box


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("shape", "periodic"), BOXES)
def test_places_and_bands_are_those_of_lists_of_cells(shape, periodic, axis):
    cells, number = shape
    for first, own, found, box in regions_of(cells, number, periodic, axis):

        def wrapped(low, high, cells=cells):
            return [cell % cells for cell in range(low, high) if periodic or 0 <= cell < cells]

        here = wrapped(first - HALO, first + own + HALO) if number > 1 else list(range(cells))
        assert len(set(here)) == len(here), "a cell is there once"
        bands = {
            region.OUTER_LOW: wrapped(first - region.BAND, first),
            region.INNER_LOW: wrapped(first, first + region.BAND),
            region.INNER_HIGH: wrapped(first + own - region.BAND, first + own),
            region.OUTER_HIGH: wrapped(first + own, first + own + region.BAND),
            region.MIDDLE: wrapped(first + region.BAND, first + own - region.BAND),
        }
        for cell in range(cells):
            assert place_along(axis, cell, found, box) == (here.index(cell) if cell in here else -1)
            expected = [band for band, those in bands.items() if cell in those] or [region.ELSEWHERE]
            assert [band_along(axis, cell, found, box)] == (expected if number > 1 else [region.MIDDLE])
            where = np.array([cell, 7] if axis == 0 else [7, cell])
            assert bool(is_own(where, found, box)) == (first <= cell < first + own)


def test_two_tiles_give_one_cell_the_bands_that_are_compared():
    """A cell in the outer band of one is in the inner band of the other, three bands further."""
    seen = 0
    for periodic in (False, True):
        one, other = regions_of(40, 2, periodic, 0)
        for cell in range(40):
            here, there = (band_along(0, cell, each[2], each[3]) for each in (one, other))
            if here in (region.INNER_HIGH, region.OUTER_HIGH):
                assert there == here - 3
                seen += 1
            if periodic and here in (region.INNER_LOW, region.OUTER_LOW):
                assert there == here + 3
                seen += 1
    assert seen == 3 * 2 * region.BAND
