"""The film of the last seconds: its pictures are those that were shown."""

import io
import subprocess

import numpy as np
import pytest
from PIL import Image, ImageSequence
from support.viewing import packed

import mpsim
from mpsim.output import ffmpeg
from mpsim.viewer import film, wire
from mpsim.viewer.broadcast import Shown, Stage
from mpsim.viewer.colours import SpeedScale

SCENE = mpsim.Scene(
    width=20, height=10, position=[[2, 5], [18, 5]], velocity=[[1, 0], [0, 0]], radius=1.0,
    obstacles=mpsim.FixedDisc((10, 8), 1.0), piston=mpsim.Piston("right", -0.5, 12.0),
)  # fmt: skip


def shown(serial, x, present=(True, True), scene=SCENE, second=None):
    """A scene with its first disc at some x, and its right wall at 19; on a second stage the disc is elsewhere."""
    header = wire.Header(serial, serial, 0.0, (0.0, 19.0, 0.0, 10.0), (20.0, 10.0), SpeedScale(2.0, 4.0))
    state = mpsim.State(np.array([[x, 5.0], [15, 5]]), np.array([[4.0, 0], [0, 0]]), present=np.array(present))
    radii = wire.pack_radii(np.array([1.0, 1.0]), header)
    other = shown(serial, second) if second is not None else None
    beside = None if other is None else Stage(other.packed, other.radii)
    return Shown(serial, packed(header, state), radii, scene.capsules, beside)


def frames_of(content):
    return [np.asarray(each.convert("RGB"), int) for each in ImageSequence.Iterator(Image.open(io.BytesIO(content)))]


def near(pixel, colour):
    return np.abs(pixel - colour).max() < 24


def test_discs_walls_and_obstacles_are_where_they_were():
    places = [3.0, 6.0, 9.0]
    frames = frames_of(film.gif([shown(k, x) for k, x in enumerate(places)]))
    assert len(frames) == 3
    assert frames[0].shape == (240, 480, 3)
    for x, frame in zip(places, frames, strict=True):
        for other in places:
            fast = near(frame[120, int(other * 24)], film.VIRIDIS[-1])
            assert fast == (other == x), "the fast disc, in the colour of the fastest"
        assert near(frame[120, int((x + 0.9) * 24)], film.VIRIDIS[-1]), "at true radius"
        assert near(frame[120, int((x + 1.1) * 24)], film.GROUND), "and no larger"
        assert near(frame[120, 15 * 24], film.VIRIDIS[0]), "one at rest"
        assert near(frame[2 * 24, 10 * 24], film.SOLID)
        assert near(frame[120, int(19.5 * 24)], film.CLOSED)
        assert near(frame[20, 20], film.GROUND)


def test_two_stages_are_side_by_side():
    frames = frames_of(film.gif([shown(k, x, second=x + 4) for k, x in enumerate((3.0, 5.0))]))
    for x, frame in zip((3.0, 5.0), frames, strict=True):
        assert frame.shape == (240, 480 + film.GAP + 480, 3)
        for stage, at in ((0, x), (480 + film.GAP, x + 4)):
            for other in (3.0, 5.0, 7.0, 9.0):
                fast = near(frame[120, stage + int(other * 24)], film.VIRIDIS[-1])
                assert fast == (abs(other - at) < 1), (stage, other)
            assert near(frame[2 * 24, stage + 10 * 24], film.SOLID)
        assert near(frame[120, 480 + film.GAP // 2], film.CLOSED)


def test_each_picture_has_the_walls_of_its_time():
    bare = mpsim.Scene(width=20, height=10, position=SCENE.position, velocity=SCENE.velocity, radius=1.0)
    frames = frames_of(film.gif([shown(1, 3.0, scene=bare), shown(2, 3.1)]))
    assert [near(frame[2 * 24, 10 * 24], film.SOLID) for frame in frames] == [False, True]


def test_a_film_begins_where_a_second_stage_begins_or_ends():
    kept = film.Film()
    for k, second in enumerate([None, None, 5.0, 6.0]):
        kept.add(shown(k, 3.0, second=second), now=float(k))
    assert [each.serial for each in kept.pictures()] == [2, 3]
    kept.add(shown(4, 3.0), now=4.0)
    assert [each.serial for each in kept.pictures()] == [4]


def test_bytes_of_both_stages_count(monkeypatch):
    one = shown(1, 3.0, second=4.0)
    own = 2 * len(one.packed) + 2 * len(one.radii)
    monkeypatch.setattr(film, "MOST_BYTES", 5.5 * own + one.capsules.nbytes)
    kept = film.Film()
    for k in range(20):
        kept.add(shown(k, 3.0, second=4.0), now=float(k))
    assert [each.serial for each in kept.pictures()] == [15, 16, 17, 18, 19]


def test_an_mp4_has_the_same_pictures(tmp_path):
    pictures = [shown(k, x) for k, x in enumerate([3.0, 6.0, 9.0])]
    path = tmp_path / "film.mp4"
    path.write_bytes(film.mp4(pictures))
    decode = [ffmpeg.executable("wait"), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(decode, capture_output=True, check=True).stdout
    found = np.frombuffer(raw, np.uint8).reshape(3, 240, 480, 3).astype(int)
    expected = np.array(frames_of(film.gif(pictures)))
    differences = np.abs(found[:, None] - expected[None]).mean((2, 3, 4))
    same = np.eye(3, dtype=bool)
    assert differences[same].max() < 1.5, "what is lost by encoding"
    assert differences[~same].min() > 2.5, "the control: another picture"


def test_an_mp4_of_an_encoder_that_fails_says_so(tmp_path, monkeypatch):
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\ncat >/dev/null\necho Unknown encoder >&2\nexit 8\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    with pytest.raises(mpsim.errors.OutputError, match=r"encodes H.264; it ended with 8 \('Unknown encoder.*as a GIF"):
        film.mp4([shown(1, 3.0)])


def test_a_disc_that_has_left_is_not_drawn():
    (frame,) = frames_of(film.gif([shown(1, 4.0, present=(False, True))]))
    assert near(frame[120, 4 * 24], film.GROUND)


def test_the_last_seconds_are_kept_at_so_many_pictures_a_second():
    kept = film.Film()
    for k in range(60 * 10):
        kept.add(shown(k, 3.0), now=k / 60)
    serials = [each.serial for each in kept.pictures()]
    assert len(serials) == film.SECONDS * film.PICTURES_A_SECOND
    assert serials[-1] >= 597
    assert set(np.diff(serials)) <= {2, 3, 4}
    assert np.diff(serials).mean() == pytest.approx(3, abs=0.05)


def test_large_pictures_are_fewer(monkeypatch):
    own = shown(1, 3.0)
    monkeypatch.setattr(film, "MOST_BYTES", 5 * (len(own.packed) + len(own.radii)) + own.capsules.nbytes)
    kept = film.Film()
    for k in range(20):
        kept.add(shown(k, 3.0), now=float(k))
    assert [each.serial for each in kept.pictures()] == [15, 16, 17, 18, 19]
    monkeypatch.setattr(film, "MOST_DISCS", 50)
    assert len(frames_of(film.gif([shown(k, 2.0 + k) for k in range(10)]))) < 10


def test_without_pictures_there_is_no_film():
    with pytest.raises(mpsim.InputError, match="a film needs pictures"):
        film.gif([])
