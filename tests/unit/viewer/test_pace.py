"""Frames are due at the asked speed, whatever the clock does."""

import pytest

from mpsim.viewer.pace import LOOK, MOST_BEHIND, TURN, UNIT, Allowance, Pace


def frames_in(pace: Pace, seconds: float, tick: float) -> int:
    """Frames that are due in so many seconds of a clock that is looked at every tick."""
    pace.start(0.0)
    return sum(pace.due(k * tick) for k in range(round(seconds / tick)))


@pytest.mark.parametrize("speed", [0.01, 0.1, 0.5, 1.0, 3.0, 100.0])
@pytest.mark.parametrize("tick", [0.001, 0.0137])
def test_frames_come_at_the_asked_rate(speed, tick):
    pace = Pace(speed)
    pace.note(1000, 1e-3)
    found = frames_in(pace, 200.0, tick)
    assert abs(found - 200 * speed * UNIT) <= 1 + speed * UNIT * tick


def test_as_fast_as_it_goes_fills_a_turn():
    pace = Pace(None)
    assert pace.due(0.0) == 1, "nothing is known of the time of a frame yet"
    pace.note(10, 10 * TURN / 50)
    assert (pace.due(0.0), pace.frames_between_looks) == (48, 16), "of 50 frames, and of 16.67"
    assert pytest.approx(50 / 3) == 50 * LOOK / TURN
    pace.look = TURN
    assert (pace.due(0.0), pace.frames_between_looks) == (32, 32), "fewer looks"
    pace.note(1, 3.0)
    assert pace.due(0.0) == 1, "a long frame is run, too"
    assert pace.wait(0.0) == 0


def test_who_is_too_slow_does_not_run_on_to_catch_up():
    pace = Pace(1.0)
    pace.start(0.0)
    pace.note(1, 1e-6)
    assert pace.due(0.0) == 1
    assert pace.due(1000.0) <= MOST_BEHIND * UNIT + 1, "the machine slept"
    pace.note(1, 10 * TURN)
    assert pace.due(1001.0) == 1


def test_the_next_frame_is_waited_for():
    pace = Pace(0.01)
    pace.start(5.0)
    assert pace.due(5.0) == 1
    assert pace.wait(5.0) == pytest.approx(100 / UNIT)
    assert pace.due(5.0 + 99 / UNIT) == 0
    assert pace.due(5.0 + 101 / UNIT) == 1


@pytest.mark.parametrize("cost", [0.0, 1e-4, 3e-3, 0.1, 5.0])
def test_uses_take_their_share_and_no_more(cost):
    """By a clock that is looked at each millisecond, for a minute; sending is charged after the use."""
    allowance, share, uses, now = Allowance(at_least=0.01), 1 / 50, 0, 100.0
    while now < 160.0:
        if not allowance.wait(now, share, at_most=20.0):
            allowance.use(now, cost / 2)
            allowance.charge(cost / 2)
            uses += 1
        now += 0.001
    pause = min(max(cost / share, 0.01), 20.0)
    assert uses == pytest.approx(60 / pause, rel=0.12, abs=1)
    if cost / share < 20:
        assert uses * cost <= share * 60 + cost
    else:
        assert uses == 3, "but never longer than at_most"
