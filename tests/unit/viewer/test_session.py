"""The thread of a view: it does what is asked for, shows it, is asked for, rests unseen, and changes no bit."""

import time

import numpy as np
import pytest
from support.scenes import gas, lattice
from support.watching import Watcher, do, step_to

import mpsim
from mpsim import measure
from mpsim.viewer import broadcast, wire
from mpsim.viewer.session import Session

PATIENCE = 150.0
GRID = mpsim.Settings(method="grid")


@pytest.fixture
def start():
    """Starts sessions, and ends them after the test."""
    open_ones = []

    def started(source, settings=None, watched=1, **options):
        watcher = Watcher()
        session = Session(source, settings, audience=watcher, **options)
        open_ones.append(session)
        session.watched_by(watched)
        session.start()
        return session, watcher

    yield started
    for session in open_ones:
        session.close()
        assert not session._thread.is_alive()


def test_a_watched_run_has_the_bits_of_one_alone(start):
    scene, frames = gas(300, 0.4), 150
    with mpsim.Simulation(scene, GRID) as alone:
        alone.run(frames=frames)
        expected, state = alone.digest(), alone.state
    session, watcher = start(scene, GRID, playing=False)
    step_to(session, watcher, frames)
    assert session._sim.digest() == expected
    watcher.see(session, lambda w: w.frame == frames)
    found = wire.unpack(watcher.pictures[-1].packed)
    assert np.abs(found.position - state.position).max() <= 0.501 * max(scene.width, scene.height) / 65535
    assert len(watcher.pictures) > 2, "and it was looked at on the way"


def test_one_played_at_any_speed_has_them_too(start):
    scene = gas(100, 0.4)
    session, watcher = start(scene, GRID)
    for speed in (None, 3.0, 0.5, None):
        do(session, "speed", value=speed)
        session.ask()
        before = session._sim.frame if session._sim else 0
        watcher.wait(lambda w: w.frame >= 0 and session._sim is not None)
        end = time.monotonic() + PATIENCE
        while session._sim.frame < before + 5 and time.monotonic() < end:
            session.ask()
            time.sleep(0.01)
    do(session, "pause")
    watcher.wait(lambda w: w.phase == "paused")
    frames, digest = session._sim.frame, session._sim.digest()
    assert frames > 15
    with mpsim.Simulation(scene, GRID) as alone:
        alone.run(frames=frames)
        assert alone.digest() == digest
        alone.run(frames=1)
        assert alone.digest() != digest, "negative control"


def test_pages_are_told_the_dt_in_force(start):
    """After a change, after undo, and after a reset."""
    session, watcher = start(gas(50, 0.2), GRID, playing=False)
    watcher.wait(lambda w: w.told.get("scene", {}).get("dt") == 0.01)
    for action, values, dt in (
        ("change", {"name": "dt", "value": 0.02, "same": False}, 0.02),
        ("undo", {}, 0.01),
        ("change", {"name": "dt", "value": 0.005, "same": False}, 0.005),
        ("reset", {}, 0.01),
    ):
        session.submit(wire.Action(action, values))
        watcher.wait(lambda w, dt=dt: w.told["scene"]["dt"] == dt)
        assert watcher.told["hands"]["dt"] == session._sim.settings.dt == dt


def test_the_first_picture_is_the_scene_before_anything_runs(start):
    scene = gas(50, 0.2)
    _, watcher = start(scene, GRID, watched=0)
    watcher.wait(lambda w: w.pictures)
    first = wire.unpack(watcher.pictures[0].packed)
    assert (first.header.frame, first.header.walls) == (0, scene.box)
    assert np.abs(first.position - scene.position).max() <= 0.501 * scene.width / 65535


def test_nothing_runs_and_nothing_is_packed_while_nobody_watches(start, monkeypatch):
    session, watcher = start(gas(50, 0.2), GRID)
    watcher.see(session, lambda w: w.frame > 0)
    session.watched_by(0)
    time.sleep(0.1)
    before, frame, pictures = time.process_time(), session._sim.frame, len(watcher.pictures)
    for _ in range(5):
        session.ask()  # a page that cannot be seen and asks nevertheless
        time.sleep(0.1)
    assert (session._sim.frame, len(watcher.pictures)) == (frame, pictures)
    assert time.process_time() - before < 0.1, "it costs nothing"
    session.watched_by(1)
    watcher.see(session, lambda w: w.frame > frame)


def test_a_picture_is_made_only_when_it_is_asked_for(start):
    session, watcher = start(gas(50, 0.2), GRID)
    watcher.wait(lambda w: "gauges" in w.told and w.told["gauges"]["frame"] > 10)
    assert len(watcher.pictures) == 1, "that of the start"
    session.ask()
    watcher.wait(lambda w: len(w.pictures) == 2)


def test_numbers_are_those_of_the_state_that_is_shown(start):
    scene = gas(100, 0.3)
    session, watcher = start(scene, GRID, playing=False)
    step_to(session, watcher, 30)
    watcher.wait(lambda w: w.told.get("gauges", {}).get("frame") == 30)
    found = watcher.told["gauges"]
    assert found["temperature"] == measure.temperature(session._sim.state, scene)
    assert found["time"] == session._sim.time


def test_pressure_and_overlap_are_counted_when_they_are_asked_for(start):
    session, watcher = start(gas(300, 0.4), GRID)
    watcher.wait(lambda w: w.told.get("gauges", {}).get("waiting") is not None)
    assert (watcher.told["gauges"]["pressure"], watcher.told["gauges"]["counting"]) == (None, False)
    assert len(watcher.told["gauges"]["workers"]) == 1
    do(session, "count", value=True)
    watcher.wait(lambda w: w.told["gauges"]["pressure"] is not None and w.told["gauges"]["largest_overlap"] is not None)
    assert 0.2 < watcher.told["gauges"]["pressure"] / watcher.told["gauges"]["bulk_pressure"] < 5
    do(session, "count", value=False)
    watcher.wait(lambda w: w.told["gauges"]["pressure"] is None)


def test_colours_are_those_that_were_asked_for(start):
    session, watcher = start(gas(300, 0.4), GRID)
    watcher.see(session, lambda w: w.told.get("colours", {}).get("by") == "speed")
    do(session, "colour", by="collision")
    watcher.see(session, lambda w: w.told["colours"]["by"] == "collision" and w.told["colours"]["values"][-1] > 0.5)
    least, _, _, most = watcher.told["colours"]["values"]
    assert least < 0.2 * most, "some have just collided"
    do(session, "pause")
    watcher.wait(lambda w: w.phase == "paused")
    do(session, "colour", by="own")
    watcher.wait(lambda w: w.told["status"]["note"])
    assert "by of colour must be one of" in watcher.told["status"]["note"]


def test_reset_goes_back_to_the_start(start):
    scene = gas(50, 0.3)
    session, watcher = start(scene, GRID, playing=False)
    step_to(session, watcher, 10)
    first = session._sim.digest()
    do(session, "reset")
    watcher.see(session, lambda w: w.frame == 0 and session._run == 2)
    step_to(session, watcher, 10)
    assert session._sim.digest() == first


def test_a_wall_that_is_drawn_is_shown_and_gone_after_undo_and_reset(start):
    scene, wall = gas(50, 0.2), {"ax": 2.0, "ay": 0.0, "bx": 2.0, "by": 14.0}
    scene = mpsim.Scene(
        width=20, height=scene.height, position=scene.position + np.array([4, 0]), velocity=scene.velocity, radius=0.5
    )
    with mpsim.Simulation(scene, GRID) as alone:
        alone.run(frames=5)
        alone.add_wall([(2, 0), (2, 14)], thickness=0.25)
        alone.run(frames=200)
        expected = alone.digest()
    session, watcher = start(scene, GRID, playing=False)
    step_to(session, watcher, 5)
    for way in ("undo", "reset"):
        assert watcher.told["scene"]["capsules"] == []
        do(session, "wall", **wall)
        watcher.wait(lambda w: w.told["scene"]["capsules"] == [[2.0, 0.0, 2.0, 14.0, 0.125]])
        watcher.see(session, lambda w: w.pictures[-1].capsules.tolist() == session._sim.scene.capsules.tolist())
        step_to(session, watcher, 205)
        if way == "undo":
            assert session._sim.digest() == expected, "with a page as without"
        do(session, way)
        watcher.wait(lambda w: w.told["scene"]["capsules"] == [])
        assert watcher.told["status"]["phase"] == "paused"
        assert session._sim.scene.obstacles == ()
    do(session, "wall", **(wall | {"by": 99.0}))
    watcher.wait(lambda w: "must be in the box" in (w.told["hands"]["note"] or ""))


def test_a_simulation_of_the_program_is_shown_and_stays_its_own(start):
    with mpsim.Simulation(gas(50, 0.3), GRID) as sim:
        sim.run(frames=5)
        session, watcher = start(sim, playing=False)
        assert watcher.told == {} or not watcher.told["scene"]["can_reset"]
        watcher.see(session, lambda w: w.frame == 5)
        session.ask()
        sim.run(frames=7)  # by the program
        watcher.wait(lambda w: w.frame == 12)
        do(session, "reset")
        watcher.wait(lambda w: w.told["status"]["note"])
        assert "belongs to a program" in watcher.told["status"]["note"]
        session.close()
        sim.run(frames=1)
        assert sim.frame == 13


def test_a_simulation_that_its_program_closes_is_over_on_the_page(start):
    sim = mpsim.Simulation(gas(50, 0.3), GRID)
    session, watcher = start(sim)
    watcher.see(session, lambda w: w.frame > 0)
    while True:
        try:
            sim.close()
            break
        except mpsim.errors.BusyError:  # it is playing
            time.sleep(0.001)
    watcher.wait(lambda w: w.phase == "over")
    assert "was closed" in watcher.told["status"]["note"]
    do(session, "play")
    time.sleep(0.05)
    assert session.error is None


def test_a_run_that_fails_pauses_with_the_reason_and_can_be_reset(start, monkeypatch):
    session, watcher = start(lattice(3, 3), GRID, playing=False)
    step_to(session, watcher, 1)
    broken = mpsim.DivergedError(3, 1, (np.nan, 0.0), (0.0, 0.0))

    def run(*_, **__):
        raise broken

    monkeypatch.setitem(vars(session._sim), "run", run)
    do(session, "play")
    watcher.wait(lambda w: w.phase == "paused" and w.told["status"]["note"])
    assert watcher.told["status"]["note"] == str(broken)
    do(session, "reset")
    watcher.see(session, lambda w: w.frame == 0 and w.told["status"]["note"] is None and len(w.pictures) > 1)
    step_to(session, watcher, 2)


def test_what_cannot_start_ends_the_session_with_its_error(start):
    session, watcher = start(gas(50, 0.2), mpsim.Settings(method="event", contact="push", dt=0.01, law="reflect"))
    assert session.wait(PATIENCE)
    assert isinstance(session.error, mpsim.InputError)
    assert watcher.phase == "over"
    assert watcher.told["status"]["note"] == str(session.error)


def test_discs_that_enter_are_shown(start):
    scene = mpsim.Scene(
        width=8, height=8, position=[[1, 1]], velocity=[[0, 0]], radius=0.25,
        emitters=[mpsim.Emitter((4, 6), (0, -1), interval=0.6)],
    )  # fmt: skip
    session, watcher = start(scene, GRID, playing=False)
    step_to(session, watcher, 130)
    watcher.see(session, lambda w: w.frame == 130)
    found = wire.unpack(watcher.pictures[-1].packed)
    assert len(found.position) == session._sim.count > 1
    assert wire.unpack_radii(watcher.pictures[-1].radii).tolist() == [0.25]


def test_a_moving_wall_is_where_the_state_says(start):
    place = [[x, y] for x in (0.5, 1.5, 2.5) for y in (0.5, 1.5, 2.5, 3.5)]
    piston = mpsim.Piston("right", -1.0, 4.0)
    scene = mpsim.Scene(width=8, height=4, position=place, velocity=np.zeros((12, 2)), radius=0.25, piston=piston)
    session, watcher = start(scene, GRID, playing=False)
    step_to(session, watcher, 50)
    watcher.see(session, lambda w: w.frame == 50)
    assert wire.unpack(watcher.pictures[-1].packed).header.walls == session._sim.state.box
    assert watcher.told["scene"]["wall"] == 1


def test_very_many_deeds_do_not_pile_up(start):
    session, _ = start(gas(50, 0.2), GRID, watched=0)
    with session._wake:
        for _ in range(5000):
            do(session, "reset")  # which counts once
        assert len(session._actions) == 1
        for _ in range(999):
            do(session, "step", frames=1)
        with pytest.raises(mpsim.InputError, match="at most 1000 actions may wait; got one more, step"):
            do(session, "step", frames=1)


def test_pictures_of_a_run_at_full_speed_take_a_small_part_of_it(start, monkeypatch):
    """The part is that of FULL_SPEED, however slow a picture is."""
    real = wire.pack

    def slow(*arguments, **options):
        end = time.thread_time() + 0.02
        while time.thread_time() < end:
            pass
        return real(*arguments, **options)

    monkeypatch.setattr(broadcast.wire, "pack", slow)
    session, watcher = start(gas(50, 0.2), GRID)
    do(session, "speed", value=None)
    watcher.wait(lambda w: w.phase == "playing")
    before, end = len(watcher.pictures), time.monotonic() + 2.5
    while time.monotonic() < end:
        session.ask()
        time.sleep(0.01)
    assert 2 <= len(watcher.pictures) - before <= 7, "one in half a second, as each takes 20 ms"
    do(session, "speed", value=1.0)
    watcher.wait(lambda w: w.told["status"]["speed"] == 1.0)
    before, end = len(watcher.pictures), time.monotonic() + 2.0
    while time.monotonic() < end:
        session.ask()
        time.sleep(0.01)
    assert len(watcher.pictures) - before > 10, "ten a second, as one that waits for its next frame has the time"


def test_settings_beside_a_simulation_and_ranks_are_refused():
    beside = pytest.raises(
        mpsim.InputError, match="settings can be given only with a scene; got them with a simulation"
    )
    with mpsim.Simulation(gas(50, 0.2), GRID) as sim, beside:
        Session(sim, GRID, audience=Watcher())
    with pytest.raises(mpsim.InputError, match="a view runs in one process; got method 'mpi'"):
        Session(gas(50, 0.2), mpsim.Settings(method="mpi"), audience=Watcher())


def test_workers_end_with_the_session(start):
    """The guard in conftest.py looks for processes and blocks that are left."""
    session, watcher = start(gas(300, 0.3), mpsim.Settings(method="parallel", workers=2))
    watcher.see(session, lambda w: w.frame > 0)
    assert len(session._sim.pids) == 1
    pids = session._sim.pids
    do(session, "reset")
    watcher.wait(lambda w: session._run == 2)
    assert session._sim.pids != pids
