"""A recording on a page: its time line, following a run that is being written, and what it refuses."""

import signal
import time

import numpy as np
import pytest
from support.commands import mpsim_command
from support.processes import Script, assert_clean
from support.scenes import gas, simulate
from support.trajectories import written
from support.viewing import Visitor, fetch, viewed

import mpsim
from mpsim import measure
from mpsim.viewer.recording import Recording

GAS = gas(100, 0.3)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    found = tmp_path_factory.mktemp("recorded") / "run.xyz"
    written(found, GAS, frames=100, every=5)
    return found


@pytest.fixture
def page(path, capsys):
    with viewed(mpsim.Trajectory(path), playing=False) as view, Visitor(view.address) as visitor:
        visitor.view = view
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame == 0 and "timeline" in v.last)
        yield visitor


def place(visitor):
    return visitor.last["timeline"]["index"]


def test_every_frame_can_be_reached_and_is_that_of_the_file(page, path):
    frames = mpsim.Trajectory(path)
    assert page.last["timeline"] == {"type": "timeline", "count": 21, "index": 0, "follow": False}
    assert (page.last["scene"]["name"], page.last["scene"]["recording"]) == ("run.xyz", "run.xyz")
    for index in (7, 20, 3, 10_000, 0):
        page.say("seek", index=index)
        there = min(index, 20)
        page.hear_until(lambda v, there=there: v.frame == 5 * there and place(v) == there)
        page.hear_until(lambda v, there=there: v.last.get("gauges", {}).get("frame") == 5 * there)
        frame = frames[there]
        assert np.abs(page.picture.position - frame.position).max() <= 0.501 * GAS.width / 65535
        assert page.picture.header.time == frame.time
        assert page.last["gauges"]["temperature"] == measure.temperature(frame.state, GAS)
        assert page.last["gauges"]["collisions_per_second"] is None
    page.say("step", frames=2)
    page.hear_until(lambda v: v.frame == 10)
    page.say("reset")
    page.hear_until(lambda v: v.frame == 0)
    assert page.phase == "paused"


@pytest.mark.parametrize("speed", [1.0, None])
def test_it_plays_to_its_end_and_again_from_the_start(page, speed):
    page.say("speed", value=speed)
    seen = []
    page.say("play")
    page.hear_until(lambda v: seen.append(v.frame) or (v.frame == 100 and v.phase == "paused"))
    assert seen == sorted(seen)
    assert len(set(seen)) > 8 if speed else set(seen) == set(range(0, 101, 5)), "at full speed each frame is shown"
    page.say("play")
    page.hear_until(lambda v: v.phase == "playing" and v.frame < 50)


def test_the_speed_is_that_of_recorded_frames(page):
    page.say("speed", value=0.2)  # 12 a second
    started = time.monotonic()
    page.say("play")
    page.hear_until(lambda v: v.frame == 60)
    assert 0.7 < time.monotonic() - started < 5


def test_a_recording_refuses_what_only_a_simulation_can(page):
    page.say("remove", id=3, same=False)
    page.hear_until(lambda v: "a recording cannot remove: it only shows" in (v.last["status"]["note"] or ""))
    page.say("seek", index=4)
    page.hear_until(lambda v: v.frame == 20 and v.last["status"]["note"] is None)
    answer = fetch(page.view.address, path="keep/session.zip")
    assert (answer.status, answer.body[:27]) == (409, b"a recording has no session,")
    assert fetch(page.view.address, path="keep/film.gif").body[:4] == b"GIF8"


def test_a_run_that_is_being_written_is_followed(tmp_path, capsys):
    path = tmp_path / "run.xyz"
    with simulate(GAS, method="grid", dt=0.02) as sim, mpsim.Trajectory.write(path, every=5) as out:
        sim.run(frames=10, observe=out)
        with viewed(Recording(path, GAS, follow=True)) as view, Visitor(view.address) as visitor:
            visitor.say("visible", value=True)
            visitor.hear_until(lambda v: v.frame == 10 and v.last["timeline"]["follow"])
            sim.run(frames=15, observe=out)
            visitor.hear_until(lambda v: v.frame == 25 and place(v) == 5)
            visitor.say("pause")
            visitor.hear_until(lambda v: not v.last["timeline"]["follow"])
            sim.run(frames=5, observe=out)
            visitor.hear_until(lambda v: v.last["timeline"]["count"] == 7)
            assert visitor.frame == 25, "no longer followed"
            visitor.say("follow", value=True)
            visitor.hear_until(lambda v: v.frame == 30)


def test_a_file_that_is_damaged_meanwhile_pauses_with_the_reason(tmp_path, capsys):
    path = tmp_path / "run.xyz"
    written(path, GAS, frames=10, every=1)
    with viewed(mpsim.Trajectory(path), playing=False) as view, Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame == 0)
        text = path.read_text()
        path.write_text(text[: len(text) // 2].replace("X ", "X x", 150))
        visitor.say("seek", index=1)
        visitor.hear_until(lambda v: v.last["status"]["note"])
        path.write_text(text)
        visitor.say("seek", index=2)
        visitor.hear_until(lambda v: v.frame == 2 and v.last["status"]["note"] is None)
        path.unlink()
        visitor.say("seek", index=3)
        visitor.hear_until(lambda v: "it no longer exists" in (v.last["status"]["note"] or ""))
        path.write_text("")
        visitor.say("seek", index=5)
        visitor.hear_until(lambda v: v.last["timeline"]["count"] == 0)
        path.write_text(text)
        visitor.hear_until(lambda v: v.last["timeline"]["count"] == 11 and v.last["status"]["note"] is None)
    assert view._session.error is None


def test_a_simulation_has_no_time_line(capsys):
    with viewed(GAS, mpsim.Settings(method="grid"), playing=False) as view, Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.phase == "paused")
        for name, values in (("seek", {"index": 3}), ("follow", {"value": True})):
            visitor.say(name, **values)
            visitor.hear_until(lambda v, name=name: f"a simulation cannot {name}" in (v.last["status"]["note"] or ""))
        assert "timeline" not in visitor.last


def test_settings_and_colours_beside_a_trajectory_are_refused(path):
    with pytest.raises(mpsim.InputError, match="settings can be given only with a scene; got them with a trajectory"):
        mpsim.view(mpsim.Trajectory(path), mpsim.Settings())
    with pytest.raises(
        mpsim.InputError, match="colour can be given only with a scene or a simulation; got it with a trajectory"
    ):
        mpsim.view(mpsim.Trajectory(path), colour=[1.0] * 100)


# --- the command

COMMAND = """
from mpsim.cli.app import main
main(["view", {!r}, "--no-browser", "--paused"])
"""


def test_the_command_shows_the_folder_of_a_run_with_its_obstacles_and_a_file(tmp_path):
    folder = tmp_path / "run"
    assert mpsim_command("run", "gas", "--frames", "20", "--every", "5", "--out", str(folder)).exit_code == 0
    for path, name in ((folder, "run"), (folder / "trajectory.xyz", "trajectory.xyz")):
        with Script(COMMAND.format(str(path))) as script, Visitor(script.line().split()[-1]) as visitor:
            visitor.say("visible", value=True)
            visitor.hear_until(lambda v: v.frame == 0 and "timeline" in v.last)
            assert visitor.last["scene"]["name"] == name
            assert visitor.last["timeline"]["count"] == 5
            assert not visitor.last["timeline"]["follow"]
            script.send(signal.SIGINT)
            outcome = script.finish()
        assert_clean(outcome)


def test_the_command_refuses_settings_and_folders_of_other_things(tmp_path, path):
    refused = mpsim_command("view", str(path), "--dt", "0.1")
    assert refused.exit_code == 2
    assert "--dt can be given only with a scene; " in refused.stderr
    assert "the folder of a run must hold run.json" in mpsim_command("view", str(tmp_path)).stderr
    assert "must be a file that can be read" in mpsim_command("view", str(tmp_path / "none.xyz")).stderr
