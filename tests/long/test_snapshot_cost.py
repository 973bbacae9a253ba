"""What the snapshots cost to which a run goes back when a worker dies."""

import time

import numpy as np
import pytest
from support.scenes import lattice, simulate

from mpsim.engine import coordinator

pytestmark = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # 3.12: fork beside threads


def healing_on_two():
    """100,000 discs on two workers, which are replaced."""
    settings = {"method": "parallel", "workers": 2, "start_method": "fork", "on_worker_death": "restart"}
    return simulate(lattice(400, 250), **settings)


def snapshot_part(sim, seconds):
    """The part of a run of some seconds that its snapshots take, and their number."""
    taken = []

    def timed():
        started = time.perf_counter()
        kept = take()
        taken.append(time.perf_counter() - started)
        return kept

    take, sim._coordinator.snapshot = sim._coordinator.snapshot, timed
    started = time.perf_counter()
    while time.perf_counter() - started < seconds:
        sim.run(frames=500)
    return sum(taken) / (time.perf_counter() - started), len(taken), np.median(taken)


@pytest.mark.long
def test_snapshots_of_a_hundred_thousand_discs_take_no_more_than_two_percent(figures, monkeypatch):
    with healing_on_two() as sim:
        part, number, each = snapshot_part(sim, 20)
    assert part < 0.02
    monkeypatch.setattr(coordinator, "SNAPSHOT_FRACTION", 1.0)
    monkeypatch.setattr(coordinator, "SNAPSHOT_SECONDS", 0.0)
    with healing_on_two() as sim:
        control, _, _ = snapshot_part(sim, 5)
    assert control > 0.02
    figures.note(
        "R11", "parallel on 2", "fraction of the time spent on snapshots of 100,000 discs", "at most 2 %",
        f"{100 * part:.2f} %, {number} of {1000 * each:.2g} ms", f"as often as possible: {100 * control:.0f} %",
    )  # fmt: skip
