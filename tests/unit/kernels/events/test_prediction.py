"""Predictions: discs looked at together, without branches, and one by one, are the same partner to the same bit."""

import numpy as np
import pytest
from support.exact import Run

from mpsim.kernels.compiling import compiled
from mpsim.kernels.events.cells import block_to_search, is_inside
from mpsim.kernels.events.prediction import earliest_one_by_one, earliest_partner
from mpsim.kernels.events.records import BOTTOM, LEFT, MOST_NEAR, RIGHT, TOP

SIDES = (-1, LEFT, RIGHT, BOTTOM, TOP)


@compiled
def predict_all(side, now, store, box, features, times, partners, inside):
    """Of each disc both answers: the time of its impact with a disc in the cells beyond a side, and its partner."""
    for i in range(store.disc.shape[0]):
        i = np.int64(i)  # noqa: PLW2901
        block = block_to_search(i, np.int64(side), store.event)
        times[i, 0], partners[i, 0] = earliest_partner(i, now, *block, store, box, features)
        times[i, 1], partners[i, 1] = earliest_one_by_one(i, now, *block, store, box, features)
        inside[i] = is_inside(i, store, box)


def both(run, side, now):
    count = len(run.store.disc)
    times, partners, inside = np.zeros((count, 2)), np.zeros((count, 2), np.int64), np.zeros(count, bool)
    predict_all(side, now, *run.system, times, partners, inside)
    return times, partners, inside


def crowd(count, radii, width=20.0, **options):
    """Discs at random places, whether they overlap or not: a prediction does not mind."""
    rng = np.random.default_rng(count)
    margin = np.max(radii)
    position = rng.uniform(margin, width - margin, (count, 2))
    return Run(position, rng.normal(size=(count, 2)), width, width, radius=radii, **options)


RUNS = {
    "walls": lambda: crowd(200, 0.5),
    "periodic": lambda: crowd(200, 0.5, periodic=(True, True)),
    "periodic, two cells": lambda: crowd(8, 1.0, width=5.0, periodic=(True, True)),
    "sizes": lambda: crowd(400, np.where(np.arange(400) % 5 == 0, 0.75, 0.25)),
    "gravity": lambda: crowd(200, 0.5, gravity=(0.25, -1.0)),
    "more than are looked at together": lambda: crowd(3000, np.where(np.arange(3000) == 0, 2.0, 0.05)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_partners_are_the_same_to_the_bit(name):
    run = RUNS[name]()
    for side in SIDES:
        times, partners, inside = both(run, side, 0.375)
        assert times[:, 0].tobytes() == times[:, 1].tobytes()
        assert (partners[:, 0] == partners[:, 1]).all()
        assert (partners >= 0).any(), "no impact, which tells nothing"
        assert inside.any() == ("two cells" not in name)


def test_more_discs_than_are_looked_at_together_are_all_seen():
    run = RUNS["more than are looked at together"]()
    cells = np.bincount(run.store.event["cell"] @ [run.box.rows, 1])
    assert cells.max() > MOST_NEAR, "too few to overflow"


@pytest.mark.parametrize("direction", [(1, 0), (0, 1), (1, 1), (1, -1)])
def test_equal_times_go_to_the_lower_number(direction):
    """Two discs fly at a third one from both sides, and meet it at once. Of some the higher number is seen first."""
    direction = np.array(direction, float)
    position = 5.0 + 1.25 * np.array([[0, 0], -direction, direction])
    run = Run(position, [[0, 0], direction, -direction], 10.0, 10.0, cells=(8, 8))
    times, partners, inside = both(run, -1, 0.0)
    resting = int(np.argmin(np.abs(run.store.disc["velocity"]).sum(axis=1)))
    numbers = run.store.event["number"]
    expected = min((k for k in range(3) if k != resting), key=lambda k: numbers[k])
    assert inside[resting]
    assert times[resting, 0] == times[resting, 1]
    assert partners[resting].tolist() == [expected, expected]
