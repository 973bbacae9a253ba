"""Recordings on a page: every frame of the file, the time line, files that grow, are damaged, or are of others."""

import gsd.hoomd
import numpy as np
import pytest
from support.commands import mpsim_command
from support.scenes import gas, simulate, zoo
from support.trajectories import written
from support.visitor import ABSORBED, fetch, paused

import mpsim
from mpsim import measure

pytestmark = pytest.mark.plain

GAS = gas(20, 0.2)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    found = tmp_path_factory.mktemp("recorded") / "run.xyz"
    written(found, GAS, frames=100, every=5, method="naive")
    return found


@pytest.fixture
def page(path):
    with paused(mpsim.Trajectory(path)) as found:
        yield found


def place(visitor):
    return visitor.last["timeline"]["index"]


def test_every_frame_can_be_reached_and_is_that_of_the_file(page, path):
    frames = mpsim.Trajectory(path)
    assert page.last["timeline"] == {"type": "timeline", "count": 21, "index": 0, "follow": False}
    assert page.last["scene"] == {
        "type": "scene", "version": 1, "name": "run.xyz", "width": GAS.width, "height": GAS.height,
        "periodic": [False, False], "recording": "run.xyz", "can_reset": True,
        "theme": {"ground": "#ffffff", "behind": "#9aa3ad"},
    }  # fmt: skip
    for index in (7, 20, 3, 10_000, 0):
        page.say("seek", index=index)
        there = min(index, 20)
        page.hear_until(lambda v, there=there: v.frame == 5 * there and place(v) == there)
        gauges, frame = page.gauges_at(5 * there), frames[there]
        assert np.abs(page.picture.position - frame.position).max() <= 0.501 * GAS.width / 65535
        assert page.picture.time == frame.time
        assert gauges["temperature"] == measure.temperature(frame.state, GAS)
        assert gauges["frames_per_second"] is None
    page.say("step", frames=2)
    page.hear_until(lambda v: v.frame == 10)
    page.say("reset")
    page.hear_until(lambda v: v.frame == 0)
    assert page.phase == "paused"


def test_it_plays_to_its_end_and_again_from_the_start(page):
    for speed in (1.0, None):
        page.say("reset")
        page.say("speed", value=speed)
        page.hear_until(lambda v, speed=speed: v.frame == 0 and v.last["status"]["speed"] == speed)
        seen = []
        page.say("play")
        page.hear_until(lambda v, seen=seen: seen.append(v.frame) or (v.frame == 100 and v.phase == "paused"))
        assert seen == sorted(seen)
        assert set(seen) <= set(range(0, 101, 5))
    assert set(seen) == set(range(0, 101, 5)), "at full speed each frame is shown"
    page.say("speed", value=0.2)
    page.say("play")
    page.hear_until(lambda v: v.phase == "playing" and v.frame < 50)


def test_a_recording_refuses_what_only_a_simulation_can(page, path):
    assert "a recording cannot remove: it only shows" in page.refused("remove", id=3, same=False)
    page.say("seek", index=4)
    page.hear_until(lambda v: v.frame == 20 and v.last["status"]["note"] is None)
    answer = fetch(page.view.address, path="keep/session.zip")
    assert (answer.status, answer.body[:27]) == (409, b"a recording has no session,")
    assert fetch(page.view.address, path="keep/film.gif").body[:4] == b"GIF8"
    for given, text in (
        ({"settings": mpsim.Settings()}, "settings can be given only with a scene; got it with a trajectory"),
        ({"colour": [1.0] * 20}, "colour can be given only with a scene; got it with a trajectory"),
        ({"beside": mpsim.Settings()}, "beside can be given only with a scene; got it with a trajectory"),
    ):
        with pytest.raises(mpsim.InputError, match=text):
            mpsim.view(mpsim.Trajectory(path), **given)


@pytest.mark.parametrize("ending", ["xyz", "gsd"])
def test_a_run_that_is_being_written_is_followed(tmp_path, ending):
    path = tmp_path / f"run.{ending}"
    with simulate(GAS, method="naive", dt=0.02) as sim, mpsim.Trajectory.write(path, every=5) as out:
        sim.run(frames=10, observe=out)
        with paused(mpsim.Trajectory(path)) as page:
            page.say("follow", value=True)
            page.hear_until(lambda v: v.frame == 10 and v.last["timeline"]["follow"])
            sim.run(frames=15, observe=out)
            page.hear_until(lambda v: v.frame == 25 and place(v) == 5)
            page.say("pause")
            page.hear_until(lambda v: not v.last["timeline"]["follow"])
            sim.run(frames=5, observe=out)
            page.hear_until(lambda v: v.last["timeline"]["count"] == 7)
            assert page.frame == 25, "no longer followed"
            page.say("follow", value=True)
            page.hear_until(lambda v: v.frame == 30)


def test_a_file_that_is_damaged_meanwhile_pauses_with_the_reason(tmp_path):
    path = tmp_path / "run.xyz"
    written(path, GAS, frames=10, every=1, method="naive")
    with paused(mpsim.Trajectory(path)) as page:
        text, other = path.read_text(), tmp_path / "other.xyz"
        other.write_text(text[: len(text) // 2].replace("X ", "X x", 150))
        other.replace(path)  # at once: of an empty file the first frame is sought
        page.say("seek", index=1)
        page.hear_until(lambda v: v.last["status"]["note"])
        other.write_text(text)
        other.replace(path)
        page.say("seek", index=2)
        page.hear_until(lambda v: v.frame == 2 and v.last["status"]["note"] is None)
        path.unlink()
        page.say("seek", index=3)
        page.hear_until(lambda v: "it no longer exists" in (v.last["status"]["note"] or ""))
        path.write_text("")
        page.say("seek", index=5)
        page.hear_until(lambda v: v.last["timeline"]["count"] == 0)
        path.write_text(text)
        page.hear_until(lambda v: v.last["timeline"]["count"] == 11 and v.last["status"]["note"] is None)
        assert not page.view.wait(0)


# --- what files hold


@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning", "ignore::mpsim.FastWarning")
def test_discs_keep_their_numbers_where_some_enter_and_leave(tmp_path):
    path = tmp_path / "run.xyz"
    written(path, zoo("absorbing emitters acceleration", count=10), frames=60, every=20, method="naive")
    with paused(mpsim.Trajectory(path)) as page:
        absent = 0
        for index, frame in enumerate(mpsim.Trajectory(path)):
            page.say("seek", index=index)
            page.hear_until(lambda v, frame=frame: v.frame == frame.frame)
            here = page.picture.colour != ABSORBED
            assert np.flatnonzero(here).tolist() == frame.ids.tolist()
            assert np.abs(page.picture.position[here] - np.clip(frame.position, 0, 8)).max() < 1e-3
            absent += (~here).sum()
        assert absent > 0


def test_files_of_other_programs_are_shown_in_their_box(tmp_path):
    """From the corner, inside where it is periodic, at the edge where there are walls, in order if numbers are wild."""
    (tmp_path / "a.extxyz").write_text(
        '2\nLattice="10 0 0 0 6 0 0 0 1" Origin="-5 -3 0" pbc="T F F" Properties=id:I:1:pos:R:3:velo:R:3:radius:R:1\n'
        "7000000 -6.0 -4.0 0 1 0 0 0.5\n3 0.0 1.0 0 0 1 0 0.5\n"
    )
    with paused(mpsim.Trajectory(tmp_path / "a.extxyz")) as page:
        assert page.last["scene"]["periodic"] == [True, False]
        assert (page.picture.extent, page.radii[0].tolist()) == ((10.0, 6.0), [0.5])
        assert np.abs(page.picture.position - [[5, 4], [9, 0]]).max() < 1e-3
        assert page.gauges_at(0)["time"] is None
    made = gsd.hoomd.Frame()
    made.configuration.box, made.particles.N = [10, 6, 0, 0, 0, 0], 2
    made.particles.position, made.particles.diameter = [[-4, 0, 0], [0, 0, 0]], [0.9] * 2
    with gsd.hoomd.open(str(tmp_path / "b.gsd"), "w") as file:
        file.append(made)
    with paused(mpsim.Trajectory(tmp_path / "b.gsd")) as page:
        assert np.abs(page.picture.position - [[1, 3], [5, 3]]).max() < 1e-3


def test_discs_without_velocities_are_shown_and_their_gauges_are_empty(tmp_path):
    (tmp_path / "plain.xyz").write_text("2\nplain\nAr 1 1 0\nAr 3 2 0\n" * 3)
    with paused(mpsim.Trajectory(tmp_path / "plain.xyz", box=(8, 6), radius=0.5)) as page:
        gauges = page.gauges_at(0)
        assert gauges["discs"] == 2
        assert gauges["temperature"] is gauges["energy"] is gauges["speeds"] is None
        page.say("seek", index=2)
        page.hear_until(lambda v: v.frame == 2)
    for words, said in (
        (["--radius", "0.5"], "must hold the box"),
        (["--box", "8,6"], "radius must be in a trajectory"),
        (["--box", "8;6"], "'8;6' must be numbers, such as 10,8."),
        (["--box", "8"], "with sides above 0; got [8.0]"),
    ):
        assert said in mpsim_command("view", tmp_path / "plain.xyz", *words).stderr


def test_a_frame_with_another_period_is_not_shown_in_the_box_of_the_first(tmp_path):
    path = tmp_path / "pressed.xyz"
    head = 'Lattice="{0} 0 0 0 6 0 0 0 1" Properties=species:S:1:pos:R:3:radius:R:1 pbc="{1} F F"'
    frame = f"2\n{head}\nA 1 1 0 .5\nA {{0}} 2 0 .5\n"
    for periodic in ("T", "F"):  # a wall may move
        path.write_text(frame.format(8, periodic) + frame.format(6, periodic))
        with paused(mpsim.Trajectory(path)) as page:
            page.say("seek", index=1)
            if periodic == "T":
                page.hear_until(lambda v: "periods of the box that is shown, 8 x 6; it has 6 x 6" in str(v.last))
                page.say("seek", index=0)
                page.hear_until(lambda v: v.last["status"]["note"] is None)
            else:
                page.hear_until(lambda v: v.frame == 1)


def test_what_is_missing_is_named(tmp_path):
    empty, bare = tmp_path / "empty.xyz", tmp_path / "bare.xyz"
    empty.touch()
    with pytest.raises(mpsim.InputError, match=r"a recording must hold a frame; '.*empty.xyz' holds none yet. Let the"):
        mpsim.view(mpsim.Trajectory(empty))
    bare.write_text('1\nLattice="10 0 0 0 6 0 0 0 1" Properties=pos:R:3:velo:R:3\n1 1 0 0 0 0\n')
    with pytest.raises(
        mpsim.errors.TrajectoryError, match=r"radius must be in a trajectory.*, or give Trajectory\(pat"
    ):
        mpsim.view(mpsim.Trajectory(bare))


# --- the command


def test_the_command_refuses_settings_and_folders_of_other_things(tmp_path, path):
    for words, said in (
        ([path, "--dt", "0.1"], "--dt can be given only with a scene; "),
        ([tmp_path], "the folder of a run must hold run.json"),
        ([tmp_path / "none.xyz"], "must be a file that can be read"),
    ):
        refused = mpsim_command("view", *words)
        assert (refused.exit_code > 0, said in refused.stderr) == (True, True), refused.stderr
