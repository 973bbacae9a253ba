"""`mpsim plot` and `mpsim animate`."""

import json
import sys

import pytest
from PIL import Image
from support.commands import SHORT, mpsim_command

import mpsim


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
    refused = mpsim_command("plot", out, "-o", tmp_path / "none" / "a.png")
    assert refused.exit_code == 1
    assert "a picture must be a file that can be written, such as a .png; got " in refused.stderr
    for ending, begin in ((".svg", b"<?xml"), (".pdf", b"%PDF"), (".PNG", b"\x89PNG")):
        assert mpsim_command("plot", out, "-o", tmp_path / f"b{ending}").exit_code == 0
        assert (tmp_path / f"b{ending}").read_bytes().startswith(begin)


@pytest.mark.parametrize("name", ["a.xls", "a", "a.rgba"])
def test_a_picture_of_no_known_format_is_refused_before_any_work(name, tmp_path):
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out)
    refused = mpsim_command("plot", out, "-o", tmp_path / name)
    assert refused.exit_code == 2
    assert "a picture's path must end in one of .png, .pdf, .svg, .eps, " in refused.stderr
    assert f"'{tmp_path}/{name}'. Use a.png, or a.pdf for print." in refused.stderr
    assert not (tmp_path / name).exists()


def test_the_picture_of_a_tall_box_has_the_box_beside_the_curves(tmp_path):
    for name, sides in (("tall", (4, 12)), ("flat", (24, 4))):
        scene = mpsim.Scene(
            width=sides[0], height=sides[1], position=[[1, 1], [3, 3]], velocity=[[1, 0], [0, 1]], radius=0.5
        )
        scene.save(tmp_path / f"{name}.toml")
        mpsim_command("run", tmp_path / f"{name}.toml", "--method", "naive", *SHORT, "--out", tmp_path / name)
        mpsim_command("plot", tmp_path / name)
        with Image.open(tmp_path / name / "plot.png") as picture:
            assert (picture.size[0] < picture.size[1] * 1.2) == (name == "tall")


def test_animate_writes_an_animation_once(tmp_path):
    path = tmp_path / "a.gif"
    few = ("--frames", 3, "--every", 5, "--pixels", 100, "--method", "grid", "--quiet")
    result = mpsim_command("animate", "gas", path, *few, "--colour", "parity")
    assert result.stdout == f"written: {path}, 3 pictures, 0.12 s, {path.stat().st_size / 1000:.0f} kB\n"
    with Image.open(path) as film:
        assert film.n_frames == 3
    refused = mpsim_command("animate", "gas", path, *few)
    assert refused.exit_code == 2
    assert "exists already, and is not overwritten. Give another name, or --force." in refused.stderr
    again = mpsim_command("animate", "gas", path, *few, "--force", "--json")
    assert json.loads(again.stdout) == {
        "animation": str(path),
        "pictures": 3,
        "seconds": 0.12,
        "bytes": path.stat().st_size,
    }


def test_the_file_of_an_animation_is_given_once_in_either_way(tmp_path):
    path = tmp_path / "a.gif"
    few = ("--frames", 2, "--every", 5, "--pixels", 100, "--method", "grid", "--quiet")
    assert mpsim_command("animate", "gas", "-o", path, *few).stdout.startswith(f"written: {path}, 2 pictures")
    for given in ((), (tmp_path / "b.gif", "--out", tmp_path / "c.gif")):
        refused = mpsim_command("animate", "gas", *given, *few)
        assert refused.exit_code == 2
        assert refused.stderr.endswith("Error: Give the file to write once, as OUT or by --out, such as gas.gif.\n")
    assert [each.name for each in tmp_path.iterdir()] == ["a.gif"]


def test_an_animation_has_a_length_and_a_theme(tmp_path):
    path = tmp_path / "a.gif"
    few = ("--fps", 5, "--pixels", 100, "--method", "grid", "--quiet", "--theme", "dark", "--scale", "log")
    result = mpsim_command("animate", "gas", path, "--seconds", 0.6, "--until", 1, *few, "--json")
    assert json.loads(result.stdout)["pictures"] == 3
    for option in (("--seconds", 0), ("--seconds", "nan"), ("--until", -1), ("--fps", 0), ("--theme", "blue")):
        refused = mpsim_command("animate", "gas", tmp_path / "b.gif", *option)
        assert refused.exit_code == 2
        assert f"Invalid value for '{option[0]}'" in refused.stderr
    refused = mpsim_command("animate", "gas", tmp_path / "b.gif", "--seconds", 2, "--frames", 5)
    assert (refused.exit_code, "--frames must not come with --until or --seconds" in refused.stderr) == (2, True)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--until", "1e300"), "--until must be at most 1,000,000,000,000 frames of 0.01; got 1e+300."),
        (("--until", "1e308"), "--until must be at most 1,000,000,000,000 frames of 0.01; got 1e+308."),
        (("--until", "1e300", "--seconds", 1), "--until must be at most 1,000,000,000,000 frames of 0.01; got 1e+300."),
        (("--dt", "1e-300"), "the scene's duration must be at most 1,000,000,000,000 frames of 1e-300; got 100."),
        (
            ("--until", "1e9", "--every", 2),
            "--until must be at most 1999.98 with --every 2, 100,000 pictures; got 1e+09.",
        ),
    ],
)
def test_a_time_that_no_animation_reaches_is_named(tmp_path, options, said):
    refused = mpsim_command("animate", "gas", tmp_path / "b.gif", *options)
    assert refused.exit_code == 2
    assert f"Error: {said}" in refused.stderr


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
    assert "mpsim plot" not in result.stderr
    result = mpsim_command("animate", "gas", tmp_path / "a.pdf")
    assert "Use a.gif. One picture is made by mpsim.draw or `mpsim plot`." in result.stderr
    result = mpsim_command("animate", "gas", tmp_path / "a.gif", "--colour", "worker", "--method", "naive")
    assert result.exit_code == 2
    assert "columns are there only in methods that sort discs into them, 'grid' and 'parallel'" in result.stderr
    ctrl_c(1)
    result = mpsim_command("animate", "gas", tmp_path / "a.gif", "--method", "naive")
    assert (result.exit_code, result.stderr) == (130, f"Interrupted; '{tmp_path}/a.gif' was not written.\n")
    assert not list(tmp_path.iterdir())
