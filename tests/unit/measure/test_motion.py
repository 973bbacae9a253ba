"""Functions and diffusion constants of discs whose motion is known: discs that drift, and discs that walk at random."""

import numpy as np
import pytest

import mpsim
from mpsim.measure.motion import OVERLAP, SQUARES, VELOCITIES, WAVES, Motion, TimeCorrelation, correlator
from mpsim.measure.statistics import Measure


def motion_of(velocities, interval=0.5, wave_numbers=(), constant=False):
    """Of discs that have these velocities, shape (samples, D, 2), each for one interval."""
    found = correlator(np.array(wave_numbers, np.float64), 16, 8)
    places = np.concatenate([np.zeros_like(velocities[:1]), np.cumsum(velocities[:-1], axis=0) * interval])
    for place, velocity in zip(places, velocities, strict=True):
        found.add(np.stack([place, velocity]))
    discs = velocities.shape[1]
    return Motion(found, np.arange(discs), np.zeros((2, discs, 2)), interval, constant)


@pytest.fixture(scope="module")
def walk():
    """Steps that are all independent: D = interval <v^2>/4 = 0.25 from the first lag on."""
    return motion_of(np.random.default_rng(1).normal(size=(6000, 20, 2)), wave_numbers=[0.5])


def test_a_random_walk_has_its_diffusion_constant_by_both_routes(walk):
    """The trapezoidal rule gives the sample at lag 0 half its weight: for a walk all of the integral."""
    for route in ("displacement", "velocity"):
        found = walk.diffusion(None, None, route)
        assert found.settled
        assert found.error < 0.02
        assert abs(found.deviation(0.25)) < 3
        assert abs(found.deviation(0.5)) > 10
    first = walk.diffusion(0.0, 0.5, "displacement")
    assert first.value == pytest.approx(walk.measure(SQUARES, 1).value / 2)
    assert abs(first.deviation(0.25)) < 3


def test_scattering_of_a_random_walk(walk):
    """exp(-k^2 D t), as steps are Gaussian."""
    found = walk.function(WAVES)
    for index in (1, 4, 12):
        expected = np.exp(-(0.5**2) * 0.25 * found.lag[index])
        assert abs(found[index].deviation(expected)) < 3
        assert abs(found[index].deviation(expected**1.1)) > 3


def test_errors_of_displacements_are_unknown_where_time_origins_overlap(walk):
    squares, velocities = walk.function(SQUARES), walk.function(VELOCITIES)
    long = squares.lag * OVERLAP > 6000 * 0.5
    assert 0 < long.sum() < len(long)
    assert not squares.settled[long].any()
    assert squares.settled[~long].mean() > 0.9
    assert velocities.settled[long].mean() > 0.9
    assert not walk.diffusion(100.0, 200.0, "displacement").settled


def test_discs_that_drift_never_diffuse():
    steady = motion_of(np.tile([[1.0, 0.0], [0.0, -2.0]], (500, 1, 1)), constant=True)
    squares, velocities = steady.function(SQUARES), steady.function(VELOCITIES)
    assert squares.value == pytest.approx(2.5 * squares.lag**2)
    assert squares[0] == Measure(0.0, 0.0, 500)
    assert velocities.value == pytest.approx(np.full(len(velocities), 2.5))
    assert velocities[0] == Measure(2.5, 0.0, 500)
    assert np.isnan(velocities.error[1])  # nothing has varied, and nobody knows whether it will
    assert not steady.diffusion(None, None, "velocity").settled


def test_widths_are_those_of_the_averages_over_velocities(walk):
    """Level 1 averages over 2 samples: products of four pairs, of which the farthest are one interval from the lag."""
    squares, velocities = walk.function(SQUARES), walk.function(VELOCITIES)
    assert not squares.width.any()
    assert velocities.width[[0, 15, 16, 23, 24]].tolist() == [0.0, 0.0, 0.5, 0.5, 1.5]
    assert (velocities.width <= velocities.lag / 8).all()


def test_lags_of_a_diffusion_constant_must_be_there(walk):
    for start, end, words in (
        (None, 1e9, "end must be a lag that the run has reached, at most 960; got 1000000000.0"),
        (1e9, 2.0, "start must be a lag that the run has reached"),
        (2.0, 2.0, "start must be before end, by one gathered lag at least; got start = 2.0 and end = 2"),
        (3.0, 2.0, "start must be before end"),
        (-1.0, 2.0, "start must be a finite number >= 0"),
        (0.0, np.nan, "end must be a finite number >= 0"),
        ("0", 2.0, "start must be a number >= 0"),
    ):
        with pytest.raises(mpsim.InputError) as caught:
            walk.diffusion(start, end, "displacement")
        assert words in str(caught.value)


def test_too_few_looks_give_no_diffusion_constant_by_themselves():
    short = motion_of(np.random.default_rng(1).normal(size=(39, 5, 2)))
    with pytest.raises(
        mpsim.errors.NotRecordedError, match="at least 40 samples, or an end after the first lag; got 39 samples"
    ):
        short.diffusion(None, None, "displacement")
    assert not short.diffusion(0.5, 5.0, "displacement").settled
    with pytest.raises(mpsim.errors.NotRecordedError, match=r"end = 0\.0"):
        short.diffusion(None, 0.0, "displacement")


def test_a_correlation_function_is_read_by_index_or_as_arrays():
    measures = (Measure(1.0, 0.1, 9), Measure(0.5, 0.2, 8, settled=False))
    found = TimeCorrelation(np.array([0.0, 1.0]), np.zeros(2), measures)
    assert (len(found), found[-1]) == (2, measures[1])
    with pytest.raises(IndexError, match="the correlation has 2 lags; got index 9999"):
        found[9999]
    assert (found.value.tolist(), found.error.tolist(), found.settled.tolist()) == (
        [1.0, 0.5],
        [0.1, 0.2],
        [True, False],
    )
