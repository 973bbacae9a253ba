"""A file has one writer at a time, and an observer one simulation."""

import gc
import multiprocessing
import os

import pytest
from support.scenes import gas, simulate
from support.trajectories import ENDINGS, content, pair, written

import mpsim
from mpsim.output.recorder import Recorder


def refusal(path, mode):
    """The error of opening a writer, or None."""
    try:
        mpsim.Trajectory.write(path, mode=mode).close()
    except mpsim.errors.OutputError as error:
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
                    mpsim.errors.OutputError, match=r"is being written by another writer.* Close that one first"
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

    monkeypatch.setattr("mpsim.core.file_lock.fcntl.flock", none)
    path = tmp_path / "a.xyz"
    with mpsim.Trajectory.write(path):
        assert refusal(path, "a") is None


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_trajectory_takes_frames_of_one_simulation_only(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    with (
        simulate(gas(5, 0.1), method="naive") as one,
        simulate(gas(6, 0.1), method="naive") as two,
        mpsim.Trajectory.write(path) as out,
    ):
        one.run(frames=3, observe=out)
        with pytest.raises(
            mpsim.errors.OutputError,
            match=r"the trajectory '.*' belongs to one simulation, <Simulation: 5 discs by naive, frame 3, time .*>; "
            r"got another, <Simulation: 6 discs by naive, frame 0, time 0>. Open one for each by mpsim.Trajectory",
        ):
            two.run(frames=9, observe=out)
        one.run(frames=2, observe=out)  # whose trajectory is as it was
    assert [(frame.frame, len(frame.ids)) for frame in mpsim.Trajectory(path)] == [(each, 5) for each in range(6)]


def test_a_simulation_that_is_gone_still_owns_its_trajectory(tmp_path):
    with mpsim.Trajectory.write(tmp_path / "a.xyz") as out:
        with simulate(gas(5, 0.1), method="naive") as sim:
            sim.run(frames=3, observe=out)
        del sim
        gc.collect()
        with (
            simulate(gas(5, 0.1), method="naive") as other,
            pytest.raises(
                mpsim.errors.OutputError, match="belongs to one simulation, which is gone by now; got another, <Sim"
            ),
        ):
            other.run(frames=9, observe=out)
    assert len(mpsim.Trajectory(tmp_path / "a.xyz")) == 4


def test_a_table_takes_rows_of_its_own_simulation_only(tmp_path):
    with simulate(gas(5, 0.1), method="naive") as one, simulate(gas(6, 0.1), method="naive") as two:
        with Recorder(tmp_path / "a.csv", 1, one) as table:
            one.run(frames=3, observe=table)
            before = (tmp_path / "a.csv").read_text()
            with pytest.raises(
                mpsim.errors.OutputError, match=r"the table '.*a.csv' belongs to one simulation, <Simulation: 5"
            ):
                two.run(frames=9, observe=table)
        assert (tmp_path / "a.csv").read_text() == before
