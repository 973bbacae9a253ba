"""The calendar of events against a search of all."""

import math

import numpy as np
import pytest
from support.exact import Run
from support.internals import machine_code

from mpsim.kernels.events import calendar

earliest, reschedule = map(machine_code, (calendar.earliest, calendar.reschedule))
fit_lap, shift_times = map(machine_code, (calendar.fit_lap, calendar.shift_times))


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 8, 512])
def test_the_calendar_finds_the_earliest_of_all(steps):
    # One step is a heap of all discs, 512 steps are lists of hardly one. Few distinct times: many ties.
    rng = np.random.default_rng(20)
    count = 150
    run = Run(np.full((count, 2), 5.0), np.zeros((count, 2)), 10.0, 10.0, radius=1e-6, steps=steps)
    disc, clock = run.store.disc, run.store.clock
    clock.lap, clock.step = 1.0, 1.0 / steps
    disc["crossing_time"] = math.inf
    disc["collision_time"] = rng.integers(0, 2000, count) / 1024
    calendar.begin_turn(0.0, run.store)
    laps = 0
    for _ in range(6000):
        i = earliest(run.store)
        expected = np.lexsort((np.arange(count), disc["collision_time"]))[0]
        if i < 0:
            assert disc[expected].collision_time >= clock.lap
            for each in disc:
                shift_times(each, clock.lap)
            fit_lap(run.store)
            calendar.begin_turn(0.0, run.store)
            laps += 1
            continue
        assert i == expected
        now = disc[i].collision_time
        for j in (i, *rng.integers(0, count, 3)):
            disc[j].collision_time = now + rng.integers(0, 400) / 1024
            reschedule(j, run.store)
    assert laps >= 1
