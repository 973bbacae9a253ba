"""Files of other programs in the live view, also without velocities, box and radii."""

import gzip

import pytest
from support.commands import mpsim_command
from support.viewing import Visitor, viewed

import mpsim

PLAIN = "2\nplain\nAr 1 1 0\nAr 3 2 0\n" * 3


@pytest.fixture
def plain(tmp_path):
    path = tmp_path / "plain.xyz.gz"
    path.write_bytes(gzip.compress(PLAIN.encode()))
    return path


def test_discs_without_velocities_are_shown_and_their_gauges_are_empty(plain, capsys):
    trajectory = mpsim.Trajectory(plain, box=(8, 6), radius=0.5)
    with viewed(trajectory, playing=False) as view, Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame == 0 and "gauges" in v.last)
        gauges = visitor.last["gauges"]
        assert gauges["discs"] == 2
        assert gauges["temperature"] is gauges["energy"] is gauges["speeds"] is None
        visitor.say("seek", index=2)
        visitor.hear_until(lambda v: v.frame == 2)


def test_the_command_takes_what_a_file_lacks_and_refuses_it_with_a_scene(plain):
    assert "must hold the box" in mpsim_command("view", str(plain), "--radius", "0.5").stderr
    assert "radius must be in a trajectory" in mpsim_command("view", str(plain), "--box", "8,6").stderr
    assert "'8;6' must be numbers, such as 10,8." in mpsim_command("view", str(plain), "--box", "8;6").stderr
    assert "with sides above 0; got [8.0]" in mpsim_command("view", str(plain), "--box", "8").stderr
    for scene in ("gas", "?scene=gas"):
        outcome = mpsim_command("view", scene, "--box", "8,6")
        assert outcome.exit_code == 2
        assert "--box can be given only with the file of a trajectory." in outcome.stderr


def test_a_frame_with_another_period_is_not_shown_in_the_box_of_the_first(tmp_path, capsys):
    path = tmp_path / "pressed.xyz"
    head = 'Lattice="{0} 0 0 0 6 0 0 0 1" Properties=species:S:1:pos:R:3:radius:R:1 pbc="{1} F F"'
    frame = f"2\n{head}\nA 1 1 0 .5\nA {{0}} 2 0 .5\n"
    for periodic, refused in (("T", True), ("F", False)):  # a wall may move
        path.write_text(frame.format(8, periodic) + frame.format(6, periodic))
        with viewed(mpsim.Trajectory(path), playing=False) as view, Visitor(view.address) as visitor:
            visitor.say("visible", value=True)
            visitor.hear_until(lambda v: v.frame == 0)
            visitor.say("seek", index=1)
            if refused:
                visitor.hear_until(lambda v: "periods of the box that is shown, 8 x 6; it has 6 x 6" in str(v.last))
                visitor.say("seek", index=0)
                visitor.hear_until(lambda v: v.last["status"]["note"] is None)
            else:
                visitor.hear_until(lambda v: v.frame == 1)
