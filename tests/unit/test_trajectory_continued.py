"""Who may write to the file of a trajectory: the run that it is of, by one writer that is open."""

import gc
import multiprocessing
import os

import pytest
from support.scenes import simulate
from support.trajectories import content, killed_and_resumed, written

import mpsim
from mpsim.output.recorder import Recorder

ENDINGS = ["xyz", "gsd"]
PLACES, SPEEDS = [[3, 3], [7, 7]], [[1, 0], [0, 1]]


def pair(width=10.0, position=PLACES, velocity=SPEEDS, radius=0.5, **features):
    """Two discs behind walls, or what differs from that."""
    return mpsim.Scene(width=width, height=10, position=position, velocity=velocity, radius=radius, **features)


THREE = {"position": [*PLACES, [5, 2]], "velocity": [*SPEEDS, [0, 0]]}

OTHERS = {
    "a box": (pair(width=11), {}, r"at frame 2 its box is \[0, 10\] x \[0, 10\] and not \[0, 11\] x \[0, 10\]"),
    "a piston": (pair(piston=mpsim.Piston("right", -1, 6)), {}, r"at frame 2 its box is .* and not \[0, 9.96\] x \["),
    "borders": (pair(boundary="periodic"), {}, r"periodic axes \(x, y\) are \(False, False\) and not \(True, True\)"),
    "dt": (pair(), {"dt": 0.2}, r"at frame 2 its time is 0.04 and not 0.4, as dt = 0.2 makes it"),
    "precision": (pair(), {"precision": "float32"}, r"at frame 2 its precision is float64 and not float32"),
    "radii": (pair(radius=0.3), {}, r"at frame 2 its radius of disc 0 is 0.5 and not 0.3"),
    "masses": (pair(mass=[1, 9.0]), {}, r"at frame 2 its mass of disc 1 is 1 and not 9"),
    "more discs": (pair(**THREE), {}, r"at frame 2 it has no disc 2, and the simulation has had it from before"),
    "fewer discs": (pair(position=[[3, 3]], velocity=[[1, 0]]), {}, r"it has a disc 1, and the simulation has only 1"),
    "places": (pair(position=[[3, 4], [7, 7]]), {}, r"its frame 0 shows another start of such a scene"),
    "velocities": (pair(velocity=[[1, 0], [0, 2]]), {}, r"its frame 0 shows another start of such a scene"),
}


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("other", OTHERS)
def test_a_simulation_that_has_come_later_cannot_continue_the_file_of_another(tmp_path, ending, other):
    """The file ends at frame 2, and the simulation is at frame 3: no frame is in both."""
    path, (scene, settings, text) = tmp_path / f"a.{ending}", OTHERS[other]
    written(path, pair(), 2, 1, method="naive")
    before = path.read_bytes()
    with simulate(scene, **{"dt": 0.02, "method": "naive", **settings}) as sim:
        sim.run(frames=3)
        with (
            mpsim.Trajectory.write(path, mode="a") as out,
            pytest.raises(
                mpsim.OutputError, match=rf"can be continued only by the run that wrote it; .*{text}.*mode='w"
            ),
        ):
            sim.run(frames=2, observe=out)
    assert path.read_bytes() == before


@pytest.mark.parametrize("ending", ENDINGS)
def test_later_frames_of_another_are_not_dropped(tmp_path, ending):
    """All frames of the file are later than the simulation: they would have been cut off, and nothing compared."""
    path = tmp_path / f"a.{ending}"
    with simulate(pair(), method="naive", dt=0.02) as sim:
        sim.run(frames=5)
        with mpsim.Trajectory.write(path) as out:
            sim.run(frames=3, observe=out)
    before = path.read_bytes()
    with pytest.raises(mpsim.OutputError, match=r"at frame 5 its mass of disc 1 is 1 and not 9"):
        written(path, pair(mass=[1, 9.0]), 2, 1, mode="a", method="naive")
    assert path.read_bytes() == before
    written(path, pair(), 2, 1, mode="a", method="naive")  # its own run starts anew
    assert [row[0] for row in content(path)] == [0, 1, 2]


OWN = {
    "events": (pair(boundary="periodic"), {"method": "event"}),
    "piston in single precision": (
        pair(radius=[0.5, 0.25], piston=mpsim.Piston("left", 0.7, 2)),
        {"precision": "float32"},
    ),
}


@pytest.mark.parametrize("name", OWN)
def test_a_run_resumed_between_two_frames_of_its_file_continues_it(tmp_path, name):
    scene, settings = OWN[name]
    written(tmp_path / "whole.xyz", scene, 40, 3, **{"method": "naive", **settings})
    killed_and_resumed(tmp_path / "a.xyz", scene, **{"method": "naive", **settings})
    assert (tmp_path / "a.xyz").read_bytes() == (tmp_path / "whole.xyz").read_bytes()


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_file_of_another_program_is_not_continued(tmp_path, ending):
    """It was, by frames that hold more than its own."""
    path = tmp_path / f"a.{ending}"
    written(path, pair(), 1, 1, method="naive")
    if ending == "gsd":
        hoomd = pytest.importorskip("gsd.hoomd")
        with hoomd.open(str(path), "r") as file:
            frame = file[0]
        frame.log = {}
        with hoomd.open(str(path), "w") as file:
            file.append(frame)
        text = "times, numbers of discs"
    else:
        path.write_text(path.read_text().replace("id:I:1", "tag:I:1").replace("velo:R:3", "speed:R:3"))
        text = "velocities, numbers of discs"
    with simulate(pair(), method="naive", dt=0.02) as sim:
        sim.run(frames=3)
        with (
            mpsim.Trajectory.write(path, mode="a") as out,
            pytest.raises(mpsim.OutputError, match=f"must hold {text} to be continued, so that"),
        ):
            sim.run(frames=1, observe=out)


# --- a writer that was closed, and two on one file


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_closed_writer_says_that_it_was_closed_and_how_to_go_on(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    with simulate(pair(), method="naive", dt=0.02) as sim:
        with mpsim.Trajectory.write(path) as out:
            sim.run(frames=1, observe=out)
            sim.run(frames=1, observe=out)
        with pytest.raises(
            mpsim.OutputError,
            match=r"the trajectory '.*' must be open to be written to, and was closed, as by the end of its `with` "
            r"block; got <Simulation: 2 .*frame 2.* mpsim.Trajectory.write\('.*', mode='a'\)",
        ):
            sim.run(frames=2, observe=out)
        assert sim.frame == 2, "refused before any frame was run"
        with mpsim.Trajectory.write(path, mode="a") as out:
            sim.run(frames=2, observe=out)
    assert [row[0] for row in content(path)] == [0, 1, 2, 3, 4]


def test_a_closed_table_says_that_it_was_closed(tmp_path):
    with simulate(pair(), method="naive") as sim:
        with Recorder(tmp_path / "a.csv", 1, sim) as table:
            sim.run(frames=1, observe=table)
        with pytest.raises(mpsim.OutputError, match=r"the table '.*' must be open to be written to, and was closed"):
            sim.run(frames=1, observe=table)


def refusal(path, mode):
    """The error of opening a writer, or None."""
    try:
        mpsim.Trajectory.write(path, mode=mode).close()
    except mpsim.OutputError as error:
        return str(error)
    return None


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("mode", ["w", "a"])
def test_a_file_has_one_writer_at_a_time(tmp_path, ending, mode):
    path = tmp_path / f"a.{ending}"
    written(path, pair(), 2, 1, method="naive")
    with simulate(pair(), method="naive", dt=0.02) as sim:
        with mpsim.Trajectory.write(path, mode=mode) as out:
            sim.run(frames=1, observe=out)  # with mode "a" the file is cut, of GSD by another in its place
            for other in ("w", "a"):
                with pytest.raises(
                    mpsim.OutputError, match=r"is being written by another writer.* Close that one first"
                ):
                    mpsim.Trajectory.write(path, mode=other)
            sim.run(frames=1, observe=out)
            assert len(mpsim.Trajectory(path)) == 3, "which readers may see"
        assert [row[0] for row in content(path)] == [0, 1, 2]
        assert refusal(path, "w") is None


def test_a_file_that_another_process_writes_is_refused(tmp_path):
    path = tmp_path / "a.xyz"
    with mpsim.Trajectory.write(path), multiprocessing.get_context("spawn").Pool(1) as pool:
        assert "another writer, of this process or another" in pool.apply(refusal, (path, "w"))


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_writer_that_is_gone_has_no_file(tmp_path, ending):
    """As one does that a cell of a notebook has left open."""
    path = tmp_path / f"a.{ending}"
    out = mpsim.Trajectory.write(path)
    assert refusal(path, "w") is not None
    del out
    gc.collect()
    assert refusal(path, "w") is None


def test_a_fork_leaves_the_file_to_its_writer(tmp_path):
    path = tmp_path / "a.xyz"
    out = mpsim.Trajectory.write(path)
    child = os.fork()
    if not child:
        out.close()
        os._exit(0)
    os.waitpid(child, 0)
    assert refusal(path, "w") is not None
    out.close()
    assert refusal(path, "w") is None


def test_where_there_are_no_locks_files_are_written_all_the_same(tmp_path, monkeypatch):
    def none(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("mpsim.output.ownership.fcntl.flock", none)
    path = tmp_path / "a.xyz"
    with mpsim.Trajectory.write(path):
        assert refusal(path, "a") is None
