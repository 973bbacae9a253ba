"""`mpsim plot` and `mpsim animate`."""

import json
import sys

from PIL import Image
from support.commands import SHORT, mpsim_command


def test_plot_draws_what_a_run_recorded(tmp_path):
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out)
    assert mpsim_command("plot", out).stdout == f"written: {out}/plot.png\n"
    with Image.open(out / "plot.png") as picture:
        assert picture.size == (1200, 768)
    other = tmp_path / "other.pdf"
    assert json.loads(mpsim_command("plot", out, "--out", other, "--json").stdout) == {"picture": str(other)}
    refused = mpsim_command("plot", out, "--out", other)
    assert refused.exit_code == 2
    assert f"'{other}' exists already, and is not overwritten. Give another name, or --force." in refused.stderr
    assert mpsim_command("plot", out, "--out", other, "--force").exit_code == 0
    for wrong in (tmp_path / "a.xls", tmp_path / "none" / "a.png"):
        refused = mpsim_command("plot", out, "--out", wrong)
        assert refused.exit_code == 1
        assert "a picture must be a file that can be written, such as a .png; got " in refused.stderr


def test_animate_writes_an_animation_once(tmp_path):
    path = tmp_path / "a.gif"
    few = ("--frames", 3, "--every", 5, "--pixels", 100, "--method", "grid", "--quiet")
    result = mpsim_command("animate", "gas", path, *few, "--colour", "parity")
    assert result.stdout == f"written: {path}, 3 pictures, {path.stat().st_size / 1000:.0f} kB\n"
    with Image.open(path) as film:
        assert film.n_frames == 3
    refused = mpsim_command("animate", "gas", path, *few)
    assert refused.exit_code == 2
    assert "exists already, and is not overwritten. Give another name, or --force." in refused.stderr
    again = mpsim_command("animate", "gas", path, *few, "--force", "--json")
    assert json.loads(again.stdout) == {"animation": str(path), "pictures": 3, "bytes": path.stat().st_size}


def test_what_cannot_be_animated_is_told_before_any_picture(tmp_path, monkeypatch, ctrl_c):
    monkeypatch.setenv("PATH", str(tmp_path))  # without ffmpeg ...
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # ... of any kind
    result = mpsim_command("animate", "gas", tmp_path / "a.mp4")
    assert result.exit_code == 1
    assert "an .mp4 needs the package imageio_ffmpeg, which cannot be imported" in result.stderr
    assert f"`pip install 'mpsim[film]'`, or install ffmpeg, or write '{tmp_path}/a.gif'." in result.stderr
    result = mpsim_command("animate", "gas", tmp_path / "a.avi")
    assert result.exit_code == 2
    assert "an animation's path must end in .gif or .mp4; got " in result.stderr
    result = mpsim_command("animate", "gas", tmp_path / "a.gif", "--colour", "worker", "--method", "naive")
    assert result.exit_code == 2
    assert "columns are there only in methods that sort discs into them, 'grid' and 'parallel'" in result.stderr
    ctrl_c(1)
    result = mpsim_command("animate", "gas", tmp_path / "a.gif", "--method", "naive")
    assert (result.exit_code, result.stderr) == (130, f"Interrupted; '{tmp_path}/a.gif' was not written.\n")
    assert not list(tmp_path.iterdir())
