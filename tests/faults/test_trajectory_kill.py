"""A kill while a trajectory is written costs at most the frame in hand, at whatever byte it comes."""

import os
import signal
import warnings

import pytest
from support.processes import run_script
from support.scenes import gas, simulate
from support.trajectories import content, written

import mpsim

SCENE = gas(2, 0.1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A trajectory of frames 0 to 3 and where each of them ends."""
    path = tmp_path_factory.mktemp("whole") / "run.xyz"
    ends = []
    with simulate(SCENE, method="naive", dt=0.02) as sim, mpsim.Trajectory.write(path) as out:
        for frames in (0, 1, 1, 1):
            sim.run(frames=frames, observe=out)
            ends.append(path.stat().st_size)
    return path, ends


def test_cut_at_any_byte_all_whole_frames_are_read(whole, tmp_path):
    path, ends = whole
    text, cut, frames = path.read_bytes(), tmp_path / "cut.xyz", content(path)
    for length in range(ends[-1] + 1):
        cut.write_bytes(text[:length])
        survivors = sum(end <= length for end in ends)
        left = length - ends[survivors - 1] if survivors else length
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = mpsim.Trajectory(cut)
        assert len(found) == survivors, length
        assert [str(each.message) for each in caught] == (
            [
                f"the trajectory '{cut}' ends in the middle of a frame, as after a kill; the last {left} bytes are "
                f"not read. Its {survivors} complete frames can be read."
            ]
            if left
            else []
        )
        if length % 10 == 0 or not left:
            assert [frame.state.digest() for frame in found] == [row[-1] for row in frames[:survivors]]


@pytest.mark.slow
def test_cut_at_any_byte_of_a_frame_it_is_continued_to_the_same_bytes(whole, tmp_path):
    """The run comes back from a checkpoint of frame 2, of which the cut may or may not have taken the frame."""
    path, ends = whole
    text, cut = path.read_bytes(), tmp_path / "cut.xyz"
    with simulate(SCENE, method="naive", dt=0.02) as sim:
        sim.run(frames=2)
        for length in [*range(ends[1], ends[2] + 3), *range(ends[2] + 3, ends[3], 29), ends[3]]:
            cut.write_bytes(text[:length])
            with mpsim.Trajectory.write(cut, mode="a") as out:
                out.look(sim, 0)
            assert cut.read_bytes() == text[: ends[2]], length
        with mpsim.Trajectory.write(cut, mode="a") as out:
            sim.run(frames=1, observe=out)
    assert cut.read_bytes() == text


def test_what_is_wrong_in_the_middle_is_no_tail(whole, tmp_path):
    """Negative control: damage before the end is an error, not a short trajectory."""
    path, ends = whole
    text = path.read_bytes()
    (tmp_path / "a.xyz").write_bytes(text[: ends[0] - 10] + text[ends[0] :])
    with pytest.raises(mpsim.errors.TrajectoryError, match="must give the number of discs where a frame begins"):
        mpsim.Trajectory(tmp_path / "a.xyz")


def test_killed_inside_a_frame_of_gsd_the_others_are_whole(tmp_path):
    path = tmp_path / "run.gsd"
    script = f"""
        import os, signal
        import mpsim
        from support.scenes import gas, simulate

        with simulate(gas(2, 0.1), method="naive", dt=0.02) as sim:
            out = mpsim.Trajectory.write({str(path)!r})
            sim.run(frames=2, observe=out)
            file = out._file._writer._file.file
            file.write_chunk("particles/position", sim.state.position)
            file.flush()
            os.kill(os.getpid(), signal.SIGKILL)
    """
    assert run_script(script, warm=True).code == -signal.SIGKILL
    assert [row[0] for row in content(path)] == [0, 1, 2]
    written(path, SCENE, 5, 1, mode="a", method="naive")
    written(tmp_path / "whole.gsd", SCENE, 5, 1, method="naive")
    assert content(path) == content(tmp_path / "whole.gsd")


class Killer:
    """An observer that kills a worker once, at frame 20."""

    every = 20

    def __init__(self):
        self.killed = False

    def look(self, sim, collisions):
        if sim.frame == 20 and not self.killed:
            self.killed = True
            os.kill(sim.pids[0], signal.SIGKILL)


@pytest.mark.slow
def test_a_run_that_heals_writes_each_frame_once(tmp_path, caplog):
    """Frames since the last snapshot are run, and looked at, again."""
    scene = gas(60, 0.4)
    written(tmp_path / "whole.xyz", scene, 60, 1)
    killer = Killer()
    sim = simulate(scene, method="parallel", workers=2, dt=0.02, on_worker_death="restart")
    with sim, mpsim.Trajectory.write(tmp_path / "healed.xyz") as out:
        sim.run(frames=60, observe=[out, killer])
    assert killer.killed
    assert "on new workers" in caplog.text
    assert (tmp_path / "healed.xyz").read_bytes() == (tmp_path / "whole.xyz").read_bytes()
