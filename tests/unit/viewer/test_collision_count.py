"""The gauge of all collisions since the start: the library's number, by all methods, and after each way back."""

import numpy as np
import pytest
from support.scenes import gas
from support.watching import do, step_to

import mpsim
from mpsim.scene.recommended import settings_for
from mpsim.viewer import wire
from mpsim.viewer.collision_count import MOST_LOGGED

GRID = mpsim.Settings(method="grid", contact="push", dt=0.01)
MANY = gas(300, 0.4)
FEW = mpsim.Scene(width=4, height=3, position=[[1, 1], [3, 1], [2, 2]], velocity=[[5, 1], [-4, 2], [1, -6]], radius=0.4)


def shown(watcher, frame):
    """The number beside the picture at a frame."""
    watcher.wait(lambda w: w.told["gauges"]["frame"] == frame)
    return watcher.told["gauges"]["collisions"]


def counted(scene, settings, frames):
    """By the library: all that there are of few discs, and between discs of many."""
    log = mpsim.Collisions()
    with mpsim.Simulation(scene, settings) as sim:
        report = sim.run(frames=frames, observe=log if scene.count <= MOST_LOGGED else None)
    return len(log.table) if scene.count <= MOST_LOGGED else report.collisions


@pytest.mark.slow
def test_pi_ends_with_314(begin):
    scene = mpsim.Scene.load("pi")
    usual = settings_for(scene, None)
    session, watcher = begin(scene, usual)
    do(session, "speed", value=None)
    step_to(session, watcher, 4000)
    assert shown(watcher, 4000) == 314 == counted(scene, usual, 4000)
    assert watcher.told["gauges"]["with_walls"] is True
    do(session, "reset")
    assert shown(watcher, 0) == 0


@pytest.mark.slow
@pytest.mark.parametrize("beside", [None, mpsim.Settings(method="grid", contact="push", dt=0.005)], ids=["one", "two"])
@pytest.mark.parametrize("scene", [FEW, MANY], ids=["few", "many"])
def test_of_a_method_with_steps_it_is_that_of_the_library_at_each_reading(begin, scene, beside):
    session, watcher = begin(scene, beside=beside)
    frames = (7, 50, 93)
    for frame in frames:
        step_to(session, watcher, frame)
        assert shown(watcher, frame) == counted(scene, GRID, frame) > 0
    assert watcher.told["gauges"]["with_walls"] is (scene is FEW)
    assert len({counted(scene, GRID, frame) for frame in frames}) == 3, "negative control"


def test_readings_on_the_way_of_a_long_run_are_right(begin, monkeypatch):
    session, watcher = begin(MANY)
    seen = []
    tell = watcher.tell

    def note(kind, text):
        tell(kind, text)
        if kind == "gauges":
            seen.append((watcher.told["gauges"]["frame"], watcher.told["gauges"]["collisions"]))

    monkeypatch.setattr(watcher, "tell", note)
    session._readings = type("Always", (), {"wait": lambda *_: 0.0, "use": lambda *_: None})()
    with monkeypatch.context() as patch:
        patch.setattr(type(session._pace), "frames_between_looks", property(lambda self: 10))
        patch.setattr(type(session._pace), "due", lambda self, now: 100)
        do(session, "play")
        watcher.wait(lambda w: w.told["gauges"]["frame"] >= 100)
        do(session, "pause")
        watcher.wait(lambda w: w.phase == "paused")
    on_the_way = [each for each in seen if each[0] % 100]
    assert len(on_the_way) >= 5
    for frame, number in on_the_way[:3]:
        assert number == counted(MANY, GRID, frame)


@pytest.mark.slow
def test_undo_and_the_marked_moment_bring_their_counts_back(begin):
    for scene in (FEW, MANY):
        session, watcher = begin(scene)
        step_to(session, watcher, 20)
        before = shown(watcher, 20)
        do(session, "snapshot")
        step_to(session, watcher, 40)
        session.submit(wire.Action("change", {"name": "restitution", "value": 0.5, "same": False}))
        watcher.wait(lambda w: w.told["hands"]["undo"] == 1)
        at_change = shown(watcher, 40)
        step_to(session, watcher, 60)
        assert shown(watcher, 60) > at_change > before
        do(session, "undo")
        assert shown(watcher, 40) == at_change
        step_to(session, watcher, 60)
        assert shown(watcher, 60) == counted(scene, GRID, 60), "it goes on from there"
        for _ in range(2):
            do(session, "return")
            assert shown(watcher, 20) == before
            step_to(session, watcher, 30)
            assert shown(watcher, 30) == counted(scene, GRID, 30)


def test_it_is_not_known_of_a_program_s_simulation_nor_after_a_run_that_failed(begin, monkeypatch):
    with mpsim.Simulation(MANY, GRID) as sim:
        sim.run(frames=5)
        session, watcher = begin(sim, None)
        assert shown(watcher, 5) is None
    session, watcher = begin(MANY)
    step_to(session, watcher, 5)
    do(session, "snapshot")
    run = mpsim.Simulation.run

    def fail(sim, **options):
        run(sim, frames=2)
        raise mpsim.InputError("no more")

    with monkeypatch.context() as patch:
        patch.setattr(mpsim.Simulation, "run", fail)
        do(session, "step", frames=1)
        watcher.wait(lambda w: w.told["status"]["note"] == "no more")
    assert shown(watcher, 7) is None
    do(session, "return")
    assert shown(watcher, 5) == counted(MANY, GRID, 5)


def test_a_disc_at_rest_has_none(begin):
    rest = mpsim.Scene(width=9, height=9, position=[[4, 4]], velocity=np.zeros((1, 2)), radius=0.5)
    session, watcher = begin(rest)
    step_to(session, watcher, 5)
    assert shown(watcher, 5) == 0
