"""Whatever is written where there is no room: an error of mpsim that names the file, and nothing is left behind."""

import errno
import os
import resource
import sys

import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.core import atomic

SCENE = gas(80, 0.2, seed=1)


with simulate(SCENE, method="naive") as sim:
    REPORT = sim.run(frames=30)

TABLE = mpsim.sweep(lambda x: {"y": x}, {"x": range(30)})

DOORS = {
    "state.npz": lambda path: mpsim.State(SCENE.position, SCENE.velocity).save(path),
    "scene.toml": SCENE.save,
    "times.csv": REPORT.to_csv,
    "times.parquet": REPORT.to_parquet,
    "sweep.csv": TABLE.to_csv,
    "sweep.json": TABLE.to_json,
    "sweep.parquet": TABLE.to_parquet,
}


@pytest.mark.parametrize("name", DOORS)
def test_what_does_not_fit_is_an_error_and_leaves_no_file(name, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # of modules that are imported now: it would be cut off
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        with pytest.raises(mpsim.errors.OutputError, match="File too large") as refused:
            DOORS[name](tmp_path / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert str(tmp_path) in str(refused.value)
    assert list(tmp_path.iterdir()) == []
    DOORS[name](tmp_path / name)
    assert (tmp_path / name).stat().st_size > 100, "with room it is written"


@pytest.mark.parametrize("name", [name for name in DOORS if name.endswith((".csv", ".parquet"))])
def test_what_is_no_path_is_refused(name):
    with pytest.raises(mpsim.InputError, match=r"must be a str or a Path; got 7\."):
        DOORS[name](7)


def test_an_animation_that_does_not_fit_is_an_error_and_leaves_no_file(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(atomic.os, "fsync", full)
        with pytest.raises(
            mpsim.errors.OutputError, match=r"with room on its disk; got .*gas.gif' \(No space left on device"
        ):
            mpsim.animate(SCENE, mpsim.Settings(method="naive"), tmp_path / "gas.gif", frames=1, pixels=100)
    assert list(tmp_path.iterdir()) == []


def test_arrays_of_a_scene_of_which_a_part_fits_say_why(tmp_path, monkeypatch):
    """Numpy wrote what fits, and said "160 requested and 72 written" in place of the system's reason."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (700, limits[1]))
    try:
        with pytest.raises(mpsim.errors.OutputError, match="File too large"):
            SCENE.save(tmp_path / "scene.toml")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_a_trajectory_whose_disk_fails_at_the_end_says_so_and_is_let_go(tmp_path, monkeypatch):
    """Network disks say only when a file is flushed or closed that there is no room."""

    def failing(descriptor):
        raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))

    path = tmp_path / "a.xyz"
    with simulate(SCENE, method="naive") as sim:
        out = mpsim.Trajectory.write(path, every=1)
        sim.run(frames=1, observe=out)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", failing)
            with pytest.raises(mpsim.errors.OutputError, match=r"a\.xyz.*quota exceeded"):
                out.close()
        with mpsim.Trajectory.write(path, every=1, mode="a") as out:  # neither locked nor open any more
            sim.run(frames=1, observe=out)
    trajectory = mpsim.Trajectory(path)
    assert len(trajectory) == 3
    path.unlink()
    for read in (lambda: trajectory[0], lambda: list(trajectory)):
        with pytest.raises(mpsim.errors.TrajectoryError, match=r"a\.xyz' cannot \(No such file"):
            read()
