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
        with pytest.raises(mpsim.OutputError, match="File too large") as refused:
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
        with pytest.raises(mpsim.OutputError, match=r"with room on its disk; got .*gas.gif' \(No space left on device"):
            mpsim.animate(SCENE, mpsim.Settings(method="naive"), tmp_path / "gas.gif", frames=1, pixels=100)
    assert list(tmp_path.iterdir()) == []
