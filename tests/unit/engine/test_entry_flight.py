"""The flight of a disc that entered inside a frame."""

import numpy as np

from mpsim.engine import entry_flight


def test_a_flight_ends_where_one_look_after_the_other_ends_it():
    """The twin bisects one step at a time."""
    rng = np.random.default_rng(10)
    for _ in range(200):
        flown, beyond = np.sort(10 ** rng.uniform(-6, 2, 2)).tolist()
        end, rounding = rng.uniform(flown, beyond), rng.choice([0.0, 1e-16, 1e-3]) * beyond
        found = entry_flight._last_clear(lambda times, end=end: times < end, flown, beyond, rounding)
        while beyond - flown > rounding and flown < (middle := 0.5 * (flown + beyond)) < beyond:
            flown, beyond = (middle, beyond) if middle < end else (flown, middle)
        assert found == flown
