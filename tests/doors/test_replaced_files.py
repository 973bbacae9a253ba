"""A file that was replaced after it was opened: nothing waits for a pipe, and the error is mpsim's own."""

import gzip
import os
import threading

import pytest
from support.scenes import gas
from support.trajectories import written
from support.visitor import Visitor, viewed

import mpsim


def in_time(act, seconds=20):
    """What a function raises, or None; fails if it does not return."""
    raised = []

    def run():
        try:
            act()
        except Exception as error:
            raised.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds)
    assert not thread.is_alive(), "it waits"
    return raised[0] if raised else None


REPLACED = {"pipe": os.mkfifo, "device": lambda path: path.symlink_to("/dev/zero"), "folder": lambda path: path.mkdir()}


@pytest.fixture(params=REPLACED)
def replace(request):
    def replace(path):
        path.unlink()
        REPLACED[request.param](path)

    return replace


@pytest.mark.parametrize("ending", ["xyz", "xyz.gz"])
def test_a_trajectory_in_text_that_was_replaced(ending, replace, tmp_path):
    written(path := tmp_path / "run.xyz", gas(20, 0.2), frames=4)
    if ending != "xyz":
        (path := tmp_path / f"run.{ending}").write_bytes(gzip.compress((tmp_path / "run.xyz").read_bytes()))
    trajectory = mpsim.Trajectory(path)
    replace(path)
    for act in (lambda: trajectory[1], lambda: list(trajectory), trajectory.refresh, lambda: list(trajectory[1:])):
        error = in_time(act)
        assert isinstance(error, mpsim.errors.TrajectoryError)
        assert error.errno is None
        assert "run.xyz" in str(error)
    with pytest.raises(IndexError):
        trajectory[9]


def test_an_open_gsd_stays_readable_and_is_not_opened_again(replace, tmp_path):
    pytest.importorskip("gsd")
    written(path := tmp_path / "run.gsd", gas(20, 0.2), frames=4)
    trajectory = mpsim.Trajectory(path)
    replace(path)
    for _ in range(2):
        error = in_time(trajectory.refresh)
        assert isinstance(error, mpsim.errors.TrajectoryError)
        assert str(error).count("a trajectory") == 1
        assert len(list(trajectory)) == len(trajectory) == 3
    trajectory.close()


def test_a_view_whose_recording_was_replaced_by_a_pipe(tmp_path, capsys):
    written(path := tmp_path / "run.xyz", gas(20, 0.2), frames=20)
    with viewed(mpsim.Trajectory(path), playing=False) as view, Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame == 0)
        path.unlink()
        os.mkfifo(path)
        visitor.say("seek", index=3)
        visitor.hear_until(lambda v: "named pipe" in (v.last["status"]["note"] or ""))
        path.unlink()
        written(path, gas(20, 0.2), frames=20)
        visitor.hear_until(lambda v: v.last["status"]["note"] is None)
        visitor.say("seek", index=2)
        visitor.hear_until(lambda v: v.frame == 4)
        path.unlink()
        os.mkfifo(path)
        visitor.say("seek", index=5)
        assert in_time(view.close) is None
        assert not [each.name for each in threading.enumerate() if each.name.startswith("mpsim view")]
