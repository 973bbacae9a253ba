"""What is painted of discs in memory is what NumPy makes of them in order."""

import numpy as np
import pytest

from mpsim.kernels.painting import paint_places, paint_speeds

WIDTH, HEIGHT, STEPS = 30.0, 7.0, 65535


def discs(count, precision, beyond):
    """Coordinates in a wrong order, some of them outside of the box, with the numbers of the discs."""
    rng = np.random.default_rng(count)
    x = (rng.random(count) * (1 + 2 * beyond) - beyond) * WIDTH
    y = (rng.random(count) * (1 + 2 * beyond) - beyond) * HEIGHT
    return x.astype(precision), y.astype(precision), rng.permutation(count).astype(np.int32)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("wraps", [(False, False), (True, False), (False, True)])
def test_places_are_fractions_in_the_order_of_numbers(precision, wraps):
    x, y, number = discs(500, precision, 0.1)
    out = np.zeros(1000, np.uint16)
    paint_places(x, y, number, WIDTH, HEIGHT, *wraps, STEPS, out)
    expected = np.zeros((500, 2))
    for axis, (here, length) in enumerate([(x.astype(float), WIDTH), (y.astype(float), HEIGHT)]):
        seen = np.mod(here, length) if wraps[axis] else np.clip(here, 0, length)
        expected[number, axis] = np.floor(seen / length * STEPS + 0.5)
    assert np.abs(out.reshape(-1, 2) - expected).max() <= 1
    assert (out.reshape(-1, 2) == expected).mean() > 0.99
    unsorted = np.stack([expected[number, 0], expected[number, 1]], axis=1)
    assert np.abs(out.reshape(-1, 2) - unsorted).max() > 1000, "negative control"


def test_rows_of_an_array_of_pairs_are_read_as_well():
    x, y, number = discs(100, "float64", 0.0)
    pairs, one, other = np.stack([x, y], axis=1), np.zeros(200, np.uint16), np.zeros(200, np.uint16)
    paint_places(x, y, number, WIDTH, HEIGHT, False, False, STEPS, one)
    paint_places(pairs[:, 0], pairs[:, 1], number, WIDTH, HEIGHT, False, False, STEPS, other)
    assert (one == other).all()


def test_what_is_no_number_is_somewhere():
    strange, number = np.array([np.nan, np.inf, -np.inf]), np.arange(3, dtype=np.int32)
    places, colours = np.ones(6, np.uint16), np.zeros(3, np.uint8)
    paint_places(strange, strange, number, WIDTH, HEIGHT, False, False, STEPS, places)
    paint_speeds(strange, strange, number, 2.0, 223, 10.0, 254, colours)
    assert places.tolist() == [0, 0, STEPS, STEPS, 0, 0]
    assert colours.tolist() == [254, 254, 254]


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_speeds_are_on_a_scale_of_two_parts(precision):
    vx, vy, number = discs(500, precision, 0.3)
    out = np.zeros(500, np.uint8)
    speed = np.hypot(vx.astype(float), vy.astype(float))
    paint_speeds(vx, vy, number, 20.0, 223, 62.0, 254, out)
    expected = np.interp(speed, [0, 20.0, 30.0], [0, 223, 254])
    assert np.abs(out[number] - expected).max() <= 0.51
    assert np.abs(out - expected).max() > 50, "negative control: in the order of memory"
