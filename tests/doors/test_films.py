"""Animations: what their pictures show, how many there are, which are refused, and what a notebook shows."""

import base64
import shutil
import subprocess

import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter
from PIL import Image

import mpsim

pytestmark = pytest.mark.plain

GRID = mpsim.Settings(method="grid", dt=0.01)
PAIR = mpsim.Scene(width=8, height=8, position=[[2, 4], [6, 1]], velocity=[[1, 0], [0, 0]], radius=1.0)
SMALL = {"pixels": 100, "progress": False}


def frames_of(path):
    with Image.open(path) as film:
        found = []
        for index in range(film.n_frames):
            film.seek(index)
            found.append(np.asarray(film.convert("RGB"), int))
        return found


def middle_of_upper_disc(frame):
    """Its x in pixels: discs are the coloured things, and the other one is below."""
    coloured = frame.max(axis=2) - frame.min(axis=2) > 60
    return np.argwhere(coloured[: 2 * len(frame) // 3])[:, 1].mean()


def test_pictures_follow_the_run_and_share_their_colours(tmp_path):
    path = mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 3, every=100, pictures_per_second=20, colour=None, pixels=200)
    assert path == tmp_path / "a.gif"
    frames = frames_of(path)
    with Image.open(path) as film:
        assert (film.n_frames, film.info["duration"]) == (3, 50)
    places = [middle_of_upper_disc(frame) for frame in frames]
    assert np.diff(places) == pytest.approx(np.diff(places)[0], abs=0.5), "one unit of length to the right in each"
    assert 200 / 8 - 1 < np.diff(places)[0] < 200 / 8 + 4
    again = mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 1, **SMALL)
    assert len(frames_of(again)) == 1, "an existing file is replaced"


def test_the_scale_of_speeds_is_that_of_all_pictures(tmp_path):
    """A disc that falls gets faster: in the first picture the same speed has a colour of the whole run."""
    falling = mpsim.Scene(
        width=4, height=20, position=[[2, 18], [1, 0.5]], velocity=[[0, 0], [0, 0]], radius=0.5, gravity=(0, -1)
    )
    first, last = frames_of(mpsim.animate(falling, GRID, tmp_path / "a.gif", 2, every=200, **SMALL))
    colours = {tuple(each) for each in first.reshape(-1, 3)}
    assert {tuple(each) for each in last.reshape(-1, 3)} - colours, "the fast disc has another colour"


def test_a_dark_picture_is_dark_and_its_words_are_light(tmp_path):
    for theme, dark in (("light", False), ("dark", True)):
        (frame,) = frames_of(mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 1, theme=theme, **SMALL))
        assert (frame[0, 0].max() < 60) == dark
        assert ((frame.min(axis=2) > 200).mean() < 0.5) == dark


def pictures(tmp_path, scene, **arguments):
    path = mpsim.animate(scene, GRID, tmp_path / "a.gif", pixels=100, colour=None, progress=False, **arguments)
    return len(frames_of(path))


def test_until_and_frames_say_how_many_pictures_there_are(tmp_path):
    assert pictures(tmp_path, PAIR, until=0.2, every=10) == 3
    assert pictures(tmp_path, PAIR, until=0.04, frames=225) == 5, "there are no more frames"
    lasting = mpsim.Scene(
        width=8, height=8, position=[[2, 4]], velocity=[[1, 0]], radius=1.0, duration=0.3, picture_interval=0.1
    )
    assert pictures(tmp_path, lasting) == 4, "as many as the duration of the scene needs"
    assert pictures(tmp_path, lasting, until=0.2) == 3
    assert 4 <= pictures(tmp_path, lasting, frames=5, until=1.0) <= 5


def test_progress_can_be_watched_and_nothing_is_printed(tmp_path, capsys):
    seen = []
    mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 2, pixels=100, progress=lambda *now: seen.append(now))
    mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 1, pixels=100)
    assert seen == [(1, 2), (2, 2)]
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"frames": 4, "until": 3.0, "every": 2}, r"every must not come with both frames and until; got 2. Leave one"),
        ({"until": 3000.0, "every": 1}, r"until must be at most 999.99 with every=1, 100,000 pictures; got 3000"),
        ({"scale": "log", "colour": None}, r"scale='log' must come with colour='speed'; got colour=None"),
        ({"pictures_per_second": 51}, r"pictures_per_second must be a whole number from 1 to 50; got 51"),
        ({"path": "a.png"}, r"must end in .gif or .mp4; got 'a.png'. Use a.gif. One picture is made by mpsim.draw"),
        ({"path": ""}, r"animate must be given a path; got ''. Write path='animation.gif'."),
        ({"settings": "a.gif"}, r"settings must be mpsim.Settings or None; got 'a.gif'. Write path='a.gif'."),
    ],
)
def test_animations_refuse_what_makes_none(arguments, text, tmp_path):
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.animate(**{"scene": PAIR, "settings": None, "path": tmp_path / "a.gif", **arguments})
    assert not (tmp_path / "a.gif").exists()
    with pytest.raises(mpsim.errors.OutputError, match="an animation must be a file in a folder that exists"):
        mpsim.animate(PAIR, None, tmp_path / "none" / "a.gif")


def test_a_notebook_shows_an_animation(tmp_path):
    path = mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 1, **SMALL)
    formatter = DisplayFormatter()
    text = formatter.format(path)[0]["text/html"]
    assert base64.b64decode(text.split("base64,")[1].split('"')[0]) == path.read_bytes()
    assert "text/html" not in formatter.format(path.with_suffix(".gone"))[0]
    with path.open("ab") as file:
        file.truncate(20_000_001)
    assert "text/html" not in formatter.format(path)[0], "too large for the output of a cell"


@pytest.mark.slow
def test_mp4_is_written_by_an_ffmpeg_of_the_system_or_of_the_package(tmp_path, monkeypatch):
    pytest.importorskip("imageio_ffmpeg", reason="the extra film is not installed")
    import imageio_ffmpeg  # noqa: PLC0415

    program = shutil.which("ffmpeg") or imageio_ffmpeg.get_ffmpeg_exe()
    written = mpsim.animate(PAIR, GRID, tmp_path / "a.mp4", 5, every=10, **SMALL)
    counted = subprocess.run(
        [program, "-i", str(written), "-f", "null", "-"], capture_output=True, text=True, check=True
    )
    assert "frame=    5" in counted.stderr
    monkeypatch.setenv("PATH", str(tmp_path))
    assert mpsim.animate(PAIR, GRID, tmp_path / "b.mp4", 1, **SMALL).stat().st_size > 1000
