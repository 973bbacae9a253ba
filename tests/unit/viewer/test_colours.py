"""The scale of colours follows the speeds, and leaves none out."""

import numpy as np
import pytest
from support.viewing import placed

import mpsim
from mpsim.viewer.colours import ABSORBED, FASTEST, KNEE, scale_of


def moving(speeds, **others) -> mpsim.State:
    speeds = np.asarray(speeds, float)
    return mpsim.State(np.zeros((len(speeds), 2)), np.stack([0 * speeds, -speeds], axis=1), **others)


def colours_of(state: mpsim.State, scale=None):
    out = np.zeros(len(state.position), np.uint8)
    (scale or scale_of(state)).colours(placed(state), out)
    return out


def test_colours_rise_with_speed_and_only_the_fastest_disc_has_the_last_one():
    speeds = np.sort(np.random.default_rng(0).rayleigh(size=5000))
    colours = colours_of(moving(speeds))
    assert (np.diff(colours.astype(int)) >= 0).all()
    assert colours[-1] == FASTEST
    assert (colours == FASTEST).mean() < 0.001, "none is saturated"
    assert abs((colours <= KNEE).mean() - 0.98) < 0.005


def test_one_fast_disc_does_not_darken_all_others():
    colours = colours_of(moving([*np.linspace(1, 2, 1000), 100.0]))
    assert colours[:-1].max() >= KNEE - 1
    assert colours[-1] == FASTEST


@pytest.mark.parametrize("speeds", [[], [0.0], [0.0, 0.0, 3.0], [1e-300, 2e-300], [1e150], [5.0, 5.0]])
def test_any_speeds_have_colours(speeds):
    state = moving(speeds)
    colours = colours_of(state)
    assert len(colours) == len(speeds)
    assert (colours[state.velocity[:, 1] == 0] == 0).all()
    assert (colours < ABSORBED).all()


def test_absorbed_discs_neither_count_nor_show():
    state = moving([1.0, 2.0, 500.0], present=np.array([True, True, False]))
    assert scale_of(state).fastest < 3
    assert colours_of(state)[2] == ABSORBED


def test_who_has_become_faster_since_is_shown_as_the_fastest():
    assert colours_of(moving([1e9, 1e300]), scale_of(moving([1.0, 2.0]))).tolist() == [FASTEST, FASTEST]
