"""Images of discs beyond periodic borders."""

import pytest

from mpsim.kernels.nearest_image import nearest_image


@pytest.mark.parametrize(("difference", "nearest"), [(7.0, -5.0), (-7.0, 5.0), (5.0, 5.0)])
def test_the_nearest_image_is_less_than_half_a_period_away(difference, nearest):
    assert nearest_image(difference, 12.0, True) == nearest
    assert nearest_image(difference, 12.0, False) == difference
