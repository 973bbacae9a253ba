"""Two stages compared: distances, what was missed, and the moment from which positions mean nothing."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim.measure import Measure
from mpsim.viewer import comparison as module
from mpsim.viewer.comparison import PARTED, SATURATED, Comparison, Count, RunningMean, measures_of

SCENE = gas(50, 0.2)
START = mpsim.State(SCENE.position, SCENE.velocity)


def moved(distance):
    """All discs so many diameters away."""
    return mpsim.State(SCENE.position + np.array([distance, 0.0]), SCENE.velocity)


@dataclass
class Ran:
    """What a run reports."""

    collisions: int
    seconds: float
    pressure: float | None = None
    measures: dict = field(default_factory=dict)

    def __post_init__(self):
        self.frame_seconds = np.full(2, self.seconds / 2)
        if self.pressure is not None:
            self.measures["pressure"] = Measure(self.pressure, math.nan, 1)


def test_distances_are_in_diameters():
    position = SCENE.position.copy()
    position[7] += [0.3, 0.4]
    one = mpsim.State(position, SCENE.velocity)
    found = Comparison(SCENE).look(one, START, 1.0)
    assert (found.disc, found.largest) == (7, pytest.approx(0.5))
    assert found.mean == pytest.approx(0.5 / math.sqrt(50))


def test_a_distance_through_a_periodic_edge_is_short():
    scene = mpsim.Scene(width=10, height=10, position=[[0.1, 5]], velocity=[[0, 0]], radius=0.5, boundary="periodic")
    one, other = (mpsim.State(np.array([[x, 5.0]]), scene.velocity) for x in (0.1, 9.9))
    assert Comparison(scene).look(one, other, 1.0).mean == pytest.approx(0.2)


def test_they_part_once_and_for_good():
    comparison = Comparison(SCENE)
    assert comparison.look(moved(0.99 * PARTED), START, 1.0) is not None
    assert comparison.parted is None
    assert comparison.look(moved(PARTED), START, 2.0) is None
    assert comparison.parted == 2.0
    assert comparison.look(START, START, 3.0) is None, "a distance after they have parted is chance"
    assert comparison.parted == 2.0
    told = comparison.read(START, START, 3.0)
    assert (told["distance"], told["missed"], told["parted"]) == (None, None, 2.0)


def test_caged_discs_have_parted_when_two_correct_solvers_would_have():
    """Discs in cages may never be half a diameter apart."""
    comparison = Comparison(SCENE)
    assert comparison.look(moved(0.1), START, 2.0, agree_until=2.1) is not None
    assert comparison.look(moved(0.1), START, 2.2) is not None, "negative control: without the prediction"
    assert comparison.look(moved(0.1), START, 2.2, agree_until=2.1) is None
    assert comparison.parted == 2.1


def test_a_prediction_that_comes_late_still_counts():
    comparison = Comparison(SCENE)
    comparison.look(moved(0.1), START, 1.0)
    comparison.look(moved(PARTED), START, 5.0)
    assert comparison.read(moved(PARTED), START, 6.0, agree_until=2.1)["parted"] == 2.1
    early = Comparison(SCENE)
    early.look(moved(PARTED), START, 1.0)
    assert early.read(moved(PARTED), START, 6.0, agree_until=2.1)["parted"] == 1.0


@pytest.mark.parametrize("distance", [0.0, 0.9 * SATURATED])
def test_stages_that_still_agree_have_not_parted_whatever_is_predicted(distance):
    comparison = Comparison(SCENE)
    assert comparison.look(moved(distance), START, 9.0, agree_until=2.1).mean == pytest.approx(distance)
    assert comparison.parted is None
    assert comparison.look(moved(SATURATED * 1.01), START, 10.0, agree_until=2.1) is None
    assert comparison.parted == 10.0


def test_discs_that_one_stage_alone_has_are_not_compared():
    fewer = mpsim.State(SCENE.position[1:], SCENE.velocity[1:])
    comparison = Comparison(SCENE)
    assert comparison.look(fewer, START, 1.0) is None
    assert comparison.parted is None


def test_missed_collisions_costs_and_pressures():
    comparison = Comparison(SCENE)
    comparison.first.note(Ran(90, 0.2, 1.5), 4.0)
    comparison.second.note(Ran(60, 1.0, 2.0), 2.0)
    comparison.second.note(Ran(40, 1.0, 3.0), 2.0)
    told = comparison.read(START, START, 4.0)
    assert (told["missed"], told["missed_fraction"]) == (10, 0.1)
    assert told["cost_ratio"] == pytest.approx(10.0)
    assert told["pressure"] == [1.5, 2.5]
    assert told["pressure_difference"] == -1.0
    assert math.isnan(told["difference_error"]), "three values have no error"


def test_a_pressure_of_zero_is_no_measurement():
    comparison = Comparison(SCENE)
    comparison.first.note(Ran(0, 0.2, 0.0), 4.0)
    comparison.second.note(Ran(1, 1.0, 2.0), 4.0)
    told = comparison.read(START, START, 4.0)
    assert math.isnan(told["pressure"][0])
    assert told["pressure"][1] == 2.0
    assert math.isnan(told["pressure_difference"])


def test_before_the_first_frame_there_is_nothing_but_a_distance():
    told = Comparison(SCENE).read(START, START, 0.0)
    assert told["distance"] == 0.0
    assert all(math.isnan(told[name]) for name in ("missed_fraction", "pressure_difference", "cost_ratio"))


@pytest.mark.parametrize("length", [100, 1000, 20_000])
def test_the_error_of_a_mean_is_that_of_its_values(length):
    mean, rng = RunningMean(), np.random.default_rng(length)
    for value in rng.normal(5.0, 2.0, length):
        mean.note(value, 0.25)
    found = mean.read()
    assert found.value == pytest.approx(5.0, abs=5 * 2 / math.sqrt(length))
    assert found.error == pytest.approx(2 / math.sqrt(length), rel=0.6)
    assert len(mean._blocks) < module.MOST_BLOCKS


def test_a_mean_weighs_by_time():
    mean = RunningMean()
    mean.note(1.0, 3.0)
    mean.note(5.0, 1.0)
    mean.note(math.nan, 10.0)
    mean.note(7.0, 0.0)
    assert mean.read().value == 2.0


def test_the_pressure_is_measured_where_it_is_defined():
    assert measures_of(SCENE, SCENE.count) == ("pressure",)
    falling = gas(50, 0.2, boundary="periodic", gravity=(0.0, -1.0))
    assert measures_of(falling, 50) == ()


def test_a_count_without_a_run_costs_nothing_that_is_known():
    assert math.isnan(Count().cost)
