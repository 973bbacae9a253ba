"""Places come back into a periodic box."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mpsim.kernels.features.boundary import wrap_places


@pytest.mark.slow
@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_places_come_back_into_a_periodic_box(real):
    length = np.array([7.3], real)
    below = np.nextafter(length[0], real(0))
    places = np.array([0.0, 2.5, -1e-20, 7.3, below, -1.0, 8.0, 3 * 7.3, 1e6 * 7.3, -1e30, 1e30], real)
    found, image = places.copy(), np.zeros((2, len(places)), np.int64)
    wrap_places(found, image, 0, length)
    assert ((found >= 0) & (found < length[0])).all(), found
    assert found[:5].tolist() == [0, 2.5, 0, 0, below]
    assert found[5:7] == pytest.approx([6.3, 0.7], rel=1e-6)
    assert image[0, :7].tolist() == [0, 0, 0, 1, 0, -1, 1], "no period for what rounding alone has put at 0"
    unwrapped = found[:9] + image[0, :9] * float(length[0])
    assert unwrapped == pytest.approx(places[:9].astype(float), abs=1e-6, rel=1e-6)
    assert not image[1].any(), "the other axis has its own counts"
    assert not image[0, 9:].any(), "of a place without a digit in the box no period is counted"
    again, before = found.copy(), image.copy()
    wrap_places(again, image, 0, length)
    assert again.tolist() == found.tolist(), "doing it twice must change nothing"
    assert (image == before).all()
    lost = np.array([np.nan, np.inf, -np.inf], real)
    wrap_places(lost, image[:, :3], 1, length)
    assert np.isnan(lost).all(), "what is not finite must stay so, to be found"
    assert not image[1].any()


@given(st.floats(-1e300, 1e300), st.floats(1e-3, 1e6))
def test_any_place_comes_back_into_any_periodic_box_for_good(place, length):
    places, wrap, image = np.array([place]), np.array([length]), np.zeros((2, 1), np.int64)
    wrap_places(places, image, 0, wrap)
    first, counted = places[0], int(image[0, 0])
    wrap_places(places, image, 0, wrap)
    assert 0 <= first < length
    assert (places[0], image[0, 0]) == (first, counted)
    if abs(place) < 1e15 * length:
        assert abs(first + counted * length - place) <= 1e-15 * (abs(place) + length), "unwrapped, it goes on"
