"""The second stage of a view: it is run beside the first, its errors end it alone, and pages are told of both."""

import math
import threading

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim.viewer import trading
from mpsim.viewer.trading import Trade, demand_one_process, settings_beside

SCENE = gas(50, 0.2)
FIRST = mpsim.Settings(method="grid", contact="push", dt=0.01)
EXACT = mpsim.Settings(method="event", dt=0.04)
PATIENCE = 150.0


class Two:
    def __init__(self, beside, scene=SCENE, first=FIRST):
        self.sim, self.trade, self.looks = mpsim.Simulation(scene, first), Trade(None), []
        self.seen = []
        self.trade.choose(beside)
        self.trade.begin(scene, first)

    def run(self, frames, every=4):
        def look(collisions):
            self.looks.append((self.sim.time, None if self.trade.pair is None else self.trade.pair.sim.time))
            self.seen.append(self.told)

        return self.trade.run(self.sim, frames, every, look)

    @property
    def told(self):
        return self.trade.told(self.sim)


@pytest.fixture
def two():
    made = []

    def begin(*given):
        made.append(Two(*given))
        return made[-1]

    yield begin
    for each in made:
        each.sim.close()
        each.trade.close()


def test_both_stages_are_at_one_time_at_each_look(two):
    t = two({"method": "event"})
    reports, seconds = t.run(20)
    assert [first for first, _ in t.looks] == pytest.approx([0.04, 0.08, 0.12, 0.16, 0.2])
    assert all(first == second for first, second in t.looks)
    assert seconds > sum(each.frame_seconds.sum() for each in reports), "the time of the second stage counts, too"
    told = t.told
    assert (told["first"], told["second"], told["exact"], told["time"]) == ("grid push dt=0.01", "event", True, 0.2)
    assert told["collisions"][0] == sum(each.collisions for each in reports)
    assert 0 < told["distance"] < 0.1
    assert math.isfinite(told["cost_ratio"])


def test_equal_stages_differ_by_nothing_at_every_look(two):
    t = two(FIRST)
    for frames in (20, 3, 30):  # looks at the ends of runs and in between
        t.run(frames)
    assert len(t.seen) == 15
    for told in t.seen:
        first, second = told["collisions"]
        assert first == second > 0
        assert (told["missed"], told["missed_fraction"], told["distance"]) == (0, 0.0, 0.0)
        assert told["pressure"][0] == told["pressure"][1] > 0
        assert told["pressure_difference"] == 0.0


def test_at_every_look_each_stage_has_counted_what_the_library_counts(two):
    coarse = mpsim.Settings(method="grid", contact="push", dt=0.04)
    t = two({"method": "event"}, SCENE, coarse)
    for frames in (20, 3, 30):
        t.run(frames)
    expected = [counted(settings, [told["time"] for told in t.seen]) for settings in (coarse, EXACT)]
    assert [told["collisions"] for told in t.seen] == [list(each) for each in zip(*expected, strict=True)]
    assert any(told["missed_fraction"] > 0.05 for told in t.seen), "negative control: such steps miss collisions"


def counted(settings, times):
    """Collisions up to some times."""
    with mpsim.Simulation(SCENE, settings) as sim:
        return np.cumsum([sim.run(until=time).collisions for time in times]).tolist()


def test_without_a_second_stage_nothing_is_measured(two):
    t = two(None)
    (report,), seconds = t.run(8)
    assert seconds == float(report.frame_seconds.sum())
    assert not report.measures
    assert (t.told["second"], t.trade.shown()) == (None, None)


def test_watching_a_second_stage_changes_no_bit(two):
    t = two({"method": "event"})
    t.run(20)
    with mpsim.Simulation(SCENE, FIRST) as alone:
        alone.run(frames=20)
        assert alone.digest() == t.sim.digest()


def test_a_second_stage_that_cannot_run_the_scene_is_told_and_the_first_one_runs(two):
    t = two(mpsim.Settings(dt=0.02))
    assert t.trade.pair is None
    assert t.told["note"].startswith("dt of a second stage must be that of the first one, 0.01")
    t.run(4)


def test_an_error_of_the_second_stage_ends_it_alone(two):
    t = two({"method": "event"})
    t.trade.pair.sim.close()
    t.run(8)
    assert t.sim.frame == 8
    assert t.trade.pair is None
    assert t.told["note"].startswith("The second stage has ended: this simulation was closed")
    t.trade.changed(t.sim, 1)
    t.trade.remember()
    t.trade.back(1)


def test_changes_and_moments_reach_the_second_stage(two):
    t = two({"method": "event"})
    t.run(4)
    before = t.trade.pair.sim.digest()
    t.trade.remember()
    t.sim.kick(3, (1.0, 0.0))
    t.trade.changed(t.sim, 1)
    assert t.trade.pair.sim.digest() != before
    t.trade.back(1)
    assert t.trade.pair.sim.digest() == before
    t.trade.back(0)
    assert t.trade.pair.sim.digest() == before


def test_the_lyapunov_time_of_the_scene_is_found_meanwhile(two):
    t = two({"method": "event"})
    assert t.told["lyapunov_time"] is None or t.told["lyapunov_time"] > 0
    t.trade._work.wait(PATIENCE)
    told = t.told
    assert 0.1 < told["lyapunov_time"] < 2.0
    assert told["agree_until"] == pytest.approx(20 * told["lyapunov_time"])


def test_what_is_different_beside():
    first = mpsim.Settings(dt=0.02, method="parallel", workers=2, passes=2)
    assert settings_beside(first, {"frames": 4}) == mpsim.Settings(dt=0.005, method="parallel", workers=2, passes=2)
    assert settings_beside(first, {"method": "event"}).workers is None
    assert settings_beside(first, {"contact": "push", "passes": 1}).contact == "push"


def test_ranks_are_refused():
    with pytest.raises(mpsim.InputError, match=r"a view runs in one process; got method 'mpi'"):
        demand_one_process(mpsim.Settings(method="mpi"))


def test_a_scene_that_the_exact_solver_cannot_run_has_no_lyapunov_time_and_ends_no_thread_by_an_error(two, monkeypatch):
    """As a dissipative one, in which discs collide without end: nobody is told of it in the terminal."""
    tried, uncaught = threading.Event(), []

    def stalls(scene, progress):
        tried.set()
        raise mpsim.errors.StalledError("disc 0 collided without end")

    monkeypatch.setattr(trading, "divergence", stalls)
    monkeypatch.setattr(threading, "excepthook", uncaught.append)
    t = two(EXACT)
    assert tried.wait(PATIENCE)
    t.trade._work.wait(PATIENCE)
    assert uncaught == []
    assert t.told["lyapunov_time"] is None
    t.run(4)
