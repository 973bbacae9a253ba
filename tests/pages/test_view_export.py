"""What is kept of a view: a session and a program that run again to the same bits, and films."""

import io
import tomllib

import numpy as np
import pytest
from PIL import Image, ImageSequence
from support.scenes import gas, simulate
from support.sessions import stage
from support.visitor import downloaded, fetch, paused, unpacked

import mpsim

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")]

SCENES = {"a gas": lambda: gas(20, 0.2), "many features": lambda: stage(20)}
GROUND, CLOSED, SOLID = (255, 255, 255), (154, 163, 173), (58, 63, 69)
SLOWEST, FAST = (0x44, 0x01, 0x54), (187, 222, 46)
"""Of viridis: a disc at rest, and the faster one of two discs, which is at 0.89 of the scale."""


def played(sim):
    """Changes of each kind, with frames between."""
    sim.run(frames=4)
    sim.set([1], velocity=(0.5, 0.1))
    sim.run(frames=3)
    sim.kick([2, 3], (0.25, 0.0))
    sim.change(dt=0.005, gravity=(0.0, -0.5))
    sim.remove([4])
    sim.add_wall(mpsim.Polyline([(0, 0.01), (0.4, 0.01)], thickness=0.01))
    sim.run(frames=5)
    sim.change(
        obstacles=[*sim.scene.obstacles, mpsim.FixedDisc((0.1, 0.1), 0.05, motion=mpsim.Rotation((0.2, 0.2), 1))]
    )
    sim.run(frames=5)
    return sim


@pytest.mark.parametrize("words", SCENES)
def test_a_session_and_a_program_run_again_to_the_same_bits(words, tmp_path):
    with simulate(SCENES[words](), method="grid") as sim, paused(played(sim), name="gas") as page:
        digest, address = sim.digest(), page.view.address
        answer = fetch(address, path="keep/session.zip")
        assert answer.headers["Content-Type"] == "application/zip"
        names = unpacked(answer.body, tmp_path)
        text = downloaded(address, "program.py").decode()
    assert {"session.toml", "session.scene.toml"} <= set(names)
    with mpsim.Simulation.replay(tmp_path / "session.toml", method="parallel", workers=1) as again:
        assert again.digest() == digest
    tables = tomllib.loads((tmp_path / "session.toml").read_text())
    assert [each["what"] for each in tables["change"]] == ["set", "kick", "change", "remove", "add_wall", "change"]
    assert (tables["frame"], tables["digest"]) == (17, digest)
    assert "Scene.load" not in text, "the scene is not the one of that name"
    wall = "mpsim.Polyline(points=[[0.0, 0.01], [0.4, 0.01]], thickness=0.01)"
    assert f"    sim.add_wall(wall={wall})\n" in text
    peg = "mpsim.FixedDisc(motion=mpsim.Rotation(centre=[0.2, 0.2], rate=1.0), position=[0.1, 0.1], radius=0.05)"
    assert f"{wall}, {peg}])\n" in text
    assert f'    assert sim.digest() == "{digest}", ' in text
    exec(compile(text, "program.py", "exec"), {})  # it ends by comparing digests
    with pytest.raises(AssertionError, match="another version of mpsim"):
        exec(text.replace("sim.kick(ids=[2, 3]", "sim.kick(ids=[2, 5]"), {})


def test_the_program_of_a_named_scene_names_it_and_one_of_very_many_numbers_is_refused():
    with paused(mpsim.Scene.load("gas"), mpsim.Settings(method="grid", dt=0.02), name="gas") as page:
        page.do("remove", id=3, same=False)
        page.step_to(2)
        text = downloaded(page.view.address, "program.py").decode()
        assert text.startswith('"""')
        assert "scene = mpsim.Scene.load('gas')\n" in text
        assert "settings = mpsim.Settings(dt=0.02, method='grid')\n" in text
        exec(text, {})
    place = np.stack(np.divmod(np.arange(2001), 50), axis=1) * 1.5 + 0.75
    large = mpsim.Scene(width=75, height=75, position=place, velocity=np.zeros((2001, 2)), radius=0.5)
    with paused(large, mpsim.Settings(method="naive")) as page:
        answer = fetch(page.view.address, path="keep/program.py")
        assert answer.status == 409
        assert b"at most 2000 discs; this scene has 2,001 and does not come with mpsim. Download the ses" in answer.body
        assert downloaded(page.view.address, "session.zip")[:2] == b"PK"


def test_what_has_ended_keeps_nothing():
    with simulate(gas(20, 0.2), method="naive") as sim, paused(sim) as page:
        sim.close()
        answer = fetch(page.view.address, path="keep/session.zip")
        assert answer.status == 409
        assert b"closed" in answer.body or b"ended" in answer.body


# --- films

TABLE = mpsim.Scene(
    width=20, height=10, position=[[2, 5], [15, 5]], velocity=[[100, 0], [0, 0]], radius=1.0,
    obstacles=mpsim.FixedDisc((10, 8), 1.0), piston=mpsim.Piston("right", -5.0, 12.0),
)  # fmt: skip
PLAIN = mpsim.Settings(method="naive", dt=0.01)


def frames_of(content):
    return [np.asarray(each.convert("RGB"), int) for each in ImageSequence.Iterator(Image.open(io.BytesIO(content)))]


def at(frame, x, y, stage=0):
    """The colour of a film at a place of the box, 24 pixels for a unit of length."""
    return frame[int((10 - y) * 24), stage * (480 + 8) + int(x * 24)]


def near(pixel, colour):
    return np.abs(pixel - colour).max() < 24


def film_of(page, places):
    """A film whose last pictures show some frames, each of them long enough to be kept."""
    for frame in places:
        page.step_to(frame)
        page.hear_for(0.12)
    return downloaded(page.view.address, "film.gif")


@pytest.mark.filterwarnings("ignore::mpsim.errors.FastWarning")  # beside the thin wall
def test_a_film_shows_discs_walls_and_obstacles_where_they_were():
    with paused(TABLE, PLAIN) as page:
        frames = frames_of(film_of(page, (0, 3, 6)))
        for index, x in ((0, 2.0), (-1, 8.0)):
            frame = frames[index]
            assert frame.shape == (240, 480, 3)
            assert [near(at(frame, other, 5), FAST) for other in (2.0, 5.0, 8.0)] == [other == x for other in (2, 5, 8)]
            assert near(at(frame, x + 0.9, 5), FAST), "at true radius"
            assert near(at(frame, x + 1.15, 5), GROUND), "and no larger"
            assert near(at(frame, 15, 5), SLOWEST)
            assert near(at(frame, 10, 8), SOLID)
            assert near(at(frame, 1, 9), GROUND)
        assert near(at(frames[-1], 19.85, 5), CLOSED), "behind the wall"
        page.do("wall", ax=4.0, ay=0.0, bx=4.0, by=3.0)
        page.do("remove", id=0, same=False)
        frames = frames_of(film_of(page, (7,)))
        assert near(at(frames[-1], 4, 2), SOLID), "each picture has the walls of its time"
        assert not any(near(at(frame, 4, 2), SOLID) for frame in frames[:3])
        assert near(at(frames[-1], 9, 5), GROUND), "a disc that has left is not drawn"


def test_two_stages_are_side_by_side_and_a_film_begins_with_them():
    with paused(TABLE, PLAIN) as page:
        film_of(page, (0, 1))
        page.say("beside", settings="frames=2")
        page.hear_until(lambda v: v.last["pair"]["second"] and v.frame == 0)
        frames = frames_of(film_of(page, (3, 6)))
        assert {frame.shape for frame in frames} == {(240, 480 + 8 + 480, 3)}, "none of one stage alone"
        for stage in (0, 1):
            assert near(at(frames[-1], 8, 5, stage), FAST)
            assert near(at(frames[-1], 10, 8, stage), SOLID)
        assert near(frames[-1][120, 480 + 4], CLOSED)
