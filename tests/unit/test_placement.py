"""Overlaps of given places against all pairs, and the limits of random ones."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mpsim import InputError
from mpsim.scene import placement


def overlaps_twin(position, diameter):
    """Number of overlapping pairs, the deepest pair and its depth, by looking at all pairs."""
    pairs, deepest, depth = 0, (0, 0), 0.0
    for j in range(len(position)):
        for i in range(j):
            distance = math.dist(position[i], position[j])
            if distance < diameter:
                pairs += 1
                if diameter - distance > depth:
                    deepest, depth = (i, j), diameter - distance
    return pairs, deepest, depth


@given(st.integers(0, 2**32), st.integers(0, 60), st.floats(1, 40), st.floats(1, 40), st.floats(0.05, 1))
def test_overlaps_are_those_of_all_pairs(seed, count, width, height, diameter):
    rng = np.random.default_rng(seed)
    position = rng.random((count, 2)) * [width, height]
    pairs, deepest, depth = placement.overlaps(position, width, height, diameter)
    expected_pairs, expected_deepest, expected_depth = overlaps_twin(position, diameter)
    assert pairs == expected_pairs
    if pairs:
        assert deepest == expected_deepest
        assert depth == pytest.approx(expected_depth, abs=1e-12)


def test_random_places_fill_the_box_evenly():
    """Chi-squared over 10 x 10 fields: sequential addition at this packing spreads more evenly than chance."""
    places = placement.random_places(5000, 200.0, 200.0, 0.5, np.random.default_rng(1))
    counts = np.histogram2d(*places.T, bins=10, range=[[0, 200]] * 2)[0]
    assert ((counts - 50) ** 2 / 50).sum() < 150


@pytest.mark.parametrize(("count", "width", "height"), [(4, 1.9, 2.5), (3, 1.5, 2.2), (100, 9.3, 9.3)])
def test_discs_that_fit_no_arrangement_are_refused_with_the_gap(count, width, height):
    with pytest.raises(InputError, match=rf"{count} discs of radius 0.5 do not fit.*is needed.*larger box"):
        placement.random_places(count, width, height, 0.5, np.random.default_rng(1))


@pytest.mark.parametrize(("count", "width", "height"), [(1, 1.0, 1.0), (4, 2.001, 2.001), (12, 12.1, 1.01)])
def test_discs_that_just_fit_are_placed(count, width, height):
    places = placement.random_places(count, width, height, 0.5, np.random.default_rng(1))
    assert places.shape == (count, 2)
    assert overlaps_twin(places, 1.0)[0] == 0
    assert ((places >= 0.5) & (places <= np.array([width, height]) - 0.5)).all()


def test_the_largest_packing_is_reached():
    side = math.sqrt(3000 * math.pi / 4 / placement.LARGEST_PACKING)
    places = placement.random_places(3000, side, side, 0.5, np.random.default_rng(2))
    assert placement.overlaps(places, side, side, 1.0)[0] == 0
