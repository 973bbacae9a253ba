"""What pages do to a session: a second stage, a frame by passes, a moment to go back to, other seeds, a search."""

import json
import time
from pathlib import Path

import pytest
from support.scenes import gas
from support.watching import Watcher, do, step_to

import mpsim
from mpsim.viewer import session as session_module
from mpsim.viewer import tuning, undo, wire
from mpsim.viewer.session import Session

SCENE = gas(300, 0.4)
GRID = mpsim.Settings(method="grid", contact="push", dt=0.01)
EVENT = mpsim.Settings(method="event")
PATIENCE = 150.0


def until(holds):
    end = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.002)


def picture(watcher):
    return wire.unpack(watcher.pictures[-1].packed)


def alone(frames, settings=GRID):
    with mpsim.Simulation(SCENE, settings) as sim:
        sim.run(frames=frames)
        return sim.digest()


def test_both_stages_are_in_one_picture_and_compared(begin):
    session, watcher = begin(beside=EVENT)
    step_to(session, watcher, 20)
    watcher.see(session, lambda w: w.frame == 20)
    shown = watcher.pictures[-1]
    first, second = wire.unpack(shown.packed).header, wire.unpack(shown.second.packed).header
    assert (first.stage, second.stage) == (0, 1)
    assert (first.frame, first.time) == (second.frame, second.time)
    watcher.wait(lambda w: w.told["pair"].get("time") == first.time)
    assert watcher.told["pair"]["second"] == "event"
    other = session._trade.pair.sim
    assert (session._sim.digest(), other.digest()) == (alone(20), alone(20, mpsim.Settings(method="event", dt=0.01)))


def test_a_view_that_plays_compares_equal_stages_as_equal(begin, monkeypatch):
    monkeypatch.setattr(session_module, "COMPARING", (1.0, 0.0))  # at each look
    compared, tell = [], Watcher.tell

    def noted(watcher, kind, text):
        if kind == "pair":
            compared.append(json.loads(text))
        tell(watcher, kind, text)

    monkeypatch.setattr(Watcher, "tell", noted)
    session, _ = begin(beside=GRID)
    do(session, "speed", value=None)
    do(session, "play")
    until(lambda: len(compared) > 12)
    do(session, "pause")
    running = [told for told in compared if told["time"] > 0]
    assert len(running) > 10
    for told in running:
        assert told["collisions"][1] > 0
        assert (told["missed"], told["missed_fraction"], told["pressure_difference"]) == (0, 0.0, 0.0)


def test_a_page_has_a_second_stage_begin_and_end(begin):
    session, watcher = begin()
    step_to(session, watcher, 5)
    assert watcher.told["pair"]["second"] is None
    do(session, "beside", settings={"frames": 2})
    watcher.wait(lambda w: w.told["pair"]["second"] == "grid push dt=0.005")
    assert session._sim.frame == 0, "both begin at the start"
    do(session, "beside", settings=None)
    watcher.wait(lambda w: w.told["pair"]["second"] is None)
    watcher.see(session, lambda w: w.pictures[-1].second is None)


def test_changes_by_hand_and_undo_reach_both(begin):
    session, watcher = begin(beside=EVENT)
    step_to(session, watcher, 3)
    until(lambda: session._trade.pair.sim.frame == 3)
    before = session._trade.pair.sim.digest()
    session.submit(wire.Action("change", {"name": "restitution", "value": 0.5, "same": False}))
    until(lambda: len(session._trade.pair.sim.journal) == 1)
    step_to(session, watcher, 6)
    do(session, "undo")
    until(lambda: session._sim.frame == 3)
    until(lambda: session._trade.pair.sim.frame == 3)
    assert session._trade.pair.sim.digest() == before
    assert not len(session._trade.pair.sim.journal)


def change(session, watcher, value):
    """One gesture."""
    session.submit(wire.Action("change", {"name": "restitution", "value": value, "same": False}))
    name = {"name": "restitution", "value": value}
    watcher.wait(lambda w: any(each.items() >= name.items() for each in w.told["hands"]["parameters"]))


def undo_all(session, watcher):
    """Take all back, which the second stage outlives."""
    while left := watcher.told["hands"]["undo"]:
        do(session, "undo")
        watcher.wait(lambda w, left=left: w.told["hands"]["undo"] < left)
        assert session._trade.pair is not None, session._trade._note
        assert session._trade.pair.sim.frame == session._sim.frame
        assert len(session._trade.pair.sim.journal) == len(session._sim.journal)


def test_undone_changes_push_no_moments_of_the_second_stage_out(begin, monkeypatch):
    monkeypatch.setattr(undo, "MOST_POINTS", 3)
    session, watcher = begin(beside=EVENT)
    for frame in (1, 2, 3):
        step_to(session, watcher, frame)
        change(session, watcher, 1 - frame / 10)
    for _ in range(2):
        do(session, "undo")
        change(session, watcher, 0.5)
    undo_all(session, watcher)
    assert session._sim.frame == 1


def test_moments_of_both_stages_share_their_bytes(begin, monkeypatch):
    session, watcher = begin(beside=EVENT)
    change(session, watcher, 0.9)

    def sizes():
        return session._hands.undo._moments.sizes, session._trade.bytes_of_moments

    monkeypatch.setattr(undo, "MOST_BYTES", 3.5 * sum(each[1] for each in sizes()))
    for k in range(2, 7):
        change(session, watcher, 1 - k / 10)
        assert watcher.told["hands"]["undo"] == min(k, 3)
        first, second = sizes()
        assert first.keys() == second.keys()
        assert sum(first.values()) + sum(second.values()) <= undo.MOST_BYTES
    undo_all(session, watcher)


def test_an_undo_that_fails_moves_no_stage(begin):
    session, watcher = begin(beside=EVENT)
    change(session, watcher, 0.9)
    step_to(session, watcher, 3)
    for path in Path(session._hands.undo._moments._folder.name).iterdir():
        path.unlink()
    do(session, "undo")
    watcher.wait(lambda w: w.told["hands"]["note"] or w.told["status"]["note"])
    assert (session._sim.frame, session._trade.pair.sim.frame) == (3, 3)
    assert len(session._trade.pair.sim.journal) == 1


def test_a_frame_pass_by_pass_ends_where_the_frame_does(begin):
    session, watcher = begin()
    step_to(session, watcher, 7)
    do(session, "pass")
    watcher.wait(lambda w: w.told["pass"]["name"] == "even")
    assert session._sim.digest() == alone(7), "the simulation stays as it is"
    even = picture(watcher)
    assert even.header.frame == 7
    for _ in range(3):  # a page that asks is not shown what comes before
        session.ask()
        time.sleep(0.02)
    assert (picture(watcher).position == even.position).all()
    do(session, "pass")
    watcher.wait(lambda w: w.told["pass"]["name"] == "odd")
    until(lambda: session._sim.frame == 8)
    assert session._sim.digest() == alone(8)
    assert session._note is None
    watcher.see(session, lambda w: w.frame == 8)
    do(session, "step", frames=1)
    watcher.wait(lambda w: w.told["pass"]["name"] is None)
    until(lambda: session._sim.frame == 9)
    assert session._sim.digest() == alone(9)


def test_a_pass_that_was_left_is_forgotten(begin):
    session, watcher = begin()
    step_to(session, watcher, 7)
    do(session, "pass")
    watcher.wait(lambda w: w.told["pass"]["name"] == "even")
    do(session, "remove", id=3, same=False)
    watcher.wait(lambda w: w.told["pass"]["name"] is None)
    watcher.see(session, lambda w: wire.unpack(w.pictures[-1].packed).colour[3] == 255)


@pytest.mark.parametrize(
    ("settings", "method"),
    [
        (mpsim.Settings(method="event", dt=0.01), "exact solver"),
        (mpsim.Settings(method="naive", contact="push", dt=0.01), "method naive"),
    ],
    ids=["event", "naive"],
)
def test_where_the_method_has_no_passes_another_start_with_one_that_has_them_is_offered(begin, settings, method):
    session, watcher = begin(settings=settings)
    step_to(session, watcher, 3)
    do(session, "pass")
    watcher.wait(lambda w: method in w.told["pass"].get("offer", ""))
    assert (session._sim.frame, session._note) == (3, None), "nothing else has happened"
    do(session, "grid")
    watcher.wait(lambda w: w.told["pass"]["name"] == "even")
    assert watcher.told["scene"]["method"] == "grid"
    assert watcher.phase == "paused"
    do(session, "pass")
    watcher.wait(lambda w: w.told["pass"]["name"] == "odd")
    assert (session._sim.frame, session._note) == (1, None)


def test_passes_are_refused_where_another_method_would_have_none_either(begin):
    emitter = mpsim.Emitter(position=(2, 2), velocity=(1, 0), interval=1.0)
    scene = mpsim.Scene(width=20, height=20, position=[[9, 9]], velocity=[[0, 1]], radius=0.5, emitters=[emitter])
    session, watcher = begin(scene, mpsim.Settings(method="naive"))
    do(session, "pass")
    watcher.wait(lambda w: w.told["status"]["note"])
    assert "method 'naive', which has no columns" in watcher.told["status"]["note"]
    assert "offer" not in watcher.told["pass"]


def test_passes_of_a_program_s_simulation_are_refused(begin):
    with mpsim.Simulation(SCENE, mpsim.Settings(method="naive")) as sim:
        session, watcher = begin(sim, None)
        for name, why in (("pass", "which has no columns"), ("grid", "belongs to a program")):
            do(session, name)
            watcher.wait(lambda w, why=why: why in (w.told["status"]["note"] or ""))


def test_back_to_a_moment_again_and_again_on_both_stages(begin):
    session, watcher = begin(beside=EVENT)
    step_to(session, watcher, 4)
    do(session, "snapshot")
    watcher.wait(lambda w: w.told["status"]["snapshot"] == 4)
    for _ in range(2):
        step_to(session, watcher, 9)
        do(session, "return")
        until(lambda: session._sim.frame == 4 and session._trade.pair.sim.frame == 4)
    assert session._sim.digest() == alone(4)
    assert session._trade.pair.sim.digest() == alone(4, mpsim.Settings(method="event", dt=0.01))
    do(session, "reset")
    watcher.wait(lambda w: w.told["status"]["snapshot"] is None)
    do(session, "return")
    watcher.wait(lambda w: w.told["status"]["note"])
    assert "remembered moment" in watcher.told["status"]["note"]


def test_other_random_numbers_and_back_to_the_scene(begin):
    session, watcher = begin()
    do(session, "seed", value=5)
    watcher.wait(lambda w: w.told["scene"]["seed"] == 5)
    with mpsim.Simulation(SCENE.redrawn(5), GRID) as again:
        assert session._sim.digest() == again.digest() != alone(0)
    do(session, "seed", value=0)
    watcher.wait(lambda w: w.told["scene"]["seed"] == 0)
    assert session._sim.digest() == alone(0)


@pytest.fixture
def finds(monkeypatch):
    """Has the search find a dt."""

    def set_up(dt):
        def search(scene, budgets, seconds, progress):
            progress(1, 2, "halfway")
            return type("Found", (), {"settings": mpsim.Settings(method="grid", dt=dt)})()

        monkeypatch.setattr(tuning, "tune", search)

    return set_up


@pytest.mark.parametrize(("found", "second"), [(0.013, 0.013 / 3), (0.002, 0.002), (0.02, 0.005)])
def test_a_second_stage_with_a_dt_of_its_own_fits_the_settings_that_were_found(begin, finds, found, second):
    session, watcher = begin(beside=mpsim.Settings(method="grid", contact="push", dt=0.005))
    for dt in (0.0007, found):  # the second search starts from what was asked for, too
        finds(dt)
        do(session, "tune", measure="pressure", budget=0.02)
        watcher.wait(lambda w, dt=dt: w.told["scene"]["dt"] == dt)
    assert watcher.told["pair"]["note"] is None
    assert session._trade.pair.sim.settings.dt == pytest.approx(second, rel=1e-12)


def test_settings_that_were_found_are_applied(begin, finds):
    finds(0.02)
    session, watcher = begin(beside=EVENT)
    step_to(session, watcher, 4)
    do(session, "tune", measure="pressure", budget=0.02)
    watcher.wait(lambda w: w.told.get("tune", {}).get("phase") == "found")
    watcher.wait(lambda w: w.told["scene"]["dt"] == 0.02)
    assert (session._sim.frame, session._sim.settings.dt, session._trade.pair.sim.settings.dt) == (0, 0.02, 0.02)


def test_an_answer_that_comes_after_its_search_was_given_up_changes_nothing(begin, finds):
    finds(0.02)
    session, watcher = begin()
    late = session._tuning.number
    do(session, "tune", measure="pressure", budget=0.02)
    watcher.wait(lambda w: w.told["scene"]["dt"] == 0.02)
    counted = session._tuning.number
    do(session, "seed", value=5)  # gives any search up
    watcher.wait(lambda w: w.told["scene"]["seed"] == 5)
    for number in (late, counted):
        do(session, "found", number=number, settings=mpsim.Settings(method="grid", dt=0.005))
    step_to(session, watcher, 2)
    assert session._sim.settings.dt == 0.02


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of time steps that the search tries
def test_a_search_runs_to_its_end_and_its_answer_is_applied_to_both_stages(begin, monkeypatch):
    monkeypatch.setattr(tuning, "SECONDS", 3.0)
    session, watcher = begin(gas(50, 0.2), beside=mpsim.Settings(method="grid", contact="push", dt=0.005))
    step_to(session, watcher, 4)
    do(session, "tune", measure="pressure", budget=0.2)
    watcher.wait(lambda w: w.told.get("tune", {}).get("phase") == "searching")
    session._tuning._work.wait(2 * PATIENCE)
    watcher.wait(lambda w: w.told["tune"]["phase"] != "searching")
    assert watcher.told["tune"]["phase"] == "found", watcher.told["tune"]["text"]
    watcher.wait(lambda w: w.told["scene"]["dt"] > GRID.dt)  # which the budget allows
    assert session._sim.frame == 0
    assert watcher.told["pair"]["note"] is None
    first, second = session._sim, session._trade.pair.sim
    assert first.settings.dt / second.settings.dt == pytest.approx(round(first.settings.dt / 0.005))
    step_to(session, watcher, 3)
    until(lambda: second.time == pytest.approx(first.time))


@pytest.mark.parametrize(
    ("name", "values"),
    [("snapshot", {}), ("seed", {"value": 1}), ("beside", {"settings": None}), ("reset", {})],
    ids=lambda given: given if isinstance(given, str) else "",
)
def test_what_needs_a_scene_is_refused_of_a_simulation(begin, name, values):
    with mpsim.Simulation(SCENE, GRID) as sim:
        session, watcher = begin(sim, None)
        do(session, name, **values)
        watcher.wait(lambda w: w.told["status"]["note"])
        assert watcher.told["status"]["note"].startswith(f"{name} needs a scene to start from")
        session.close()


def test_a_second_stage_beside_a_simulation_is_refused():
    with (
        mpsim.Simulation(SCENE, GRID) as sim,
        pytest.raises(mpsim.InputError, match=r"beside needs a scene, from which both stages start"),
    ):
        Session(sim, beside=EVENT, audience=Watcher())
