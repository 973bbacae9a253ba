"""What is kept of a view: a session and a program that run again to the same bits, a scene that goes on."""

import io
import subprocess
import sys
import tomllib
import zipfile

import numpy as np
import pytest
from support.scenes import gas, simulate, zoo
from support.sessions import stage
from support.tiles import first_free_place

import mpsim
from mpsim.scene import scenefile
from mpsim.viewer import keep

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")]

SCENES = {"a gas": lambda: gas(80, 0.2), "many features": stage}


def unpacked(kept, folder):
    assert kept.kind == "application/zip"
    with zipfile.ZipFile(io.BytesIO(kept.content)) as archive:
        archive.extractall(folder)
    return sorted(path.name for path in folder.iterdir())


def played(sim):
    """Changes of each kind, with frames between."""
    sim.run(frames=4)
    sim.set([1], velocity=(0.5, 0.1))
    sim.run(frames=3)
    sim.kick([2, 3], (0.25, 0.0))
    sim.change(dt=0.005, gravity=(0.0, -0.5))
    sim.remove([4])
    sim.run(frames=5)
    return sim


@pytest.mark.parametrize("words", SCENES)
def test_a_session_runs_again_to_the_same_bits(words, tmp_path):
    with simulate(SCENES[words](), method="grid") as sim:
        digest = played(sim).digest()
        names = unpacked(keep.session(sim, "a name"), tmp_path)
    assert {"session.toml", "session.scene.toml"} <= set(names)
    for workers in (1, 2):
        with mpsim.Simulation.replay(tmp_path / "session.toml", method="parallel", workers=workers) as again:
            assert again.digest() == digest


def run_as_program(text, folder):
    file = folder / "program.py"
    file.write_text(text)
    command = [sys.executable, "-W", "ignore", file]
    return subprocess.run(command, check=False, capture_output=True, text=True, cwd=folder, timeout=300)


@pytest.mark.parametrize("words", SCENES)
def test_a_program_does_the_same(words, tmp_path):
    with simulate(SCENES[words](), method="grid") as sim:
        text = keep.program(played(sim), "gas").content.decode()
        digest = sim.digest()
    assert "Scene.load" not in text, "the scene is not the one of that name"
    assert digest in text
    outcome = run_as_program(text, tmp_path)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    wrong = run_as_program(text.replace("sim.kick(ids=[2, 3]", "sim.kick(ids=[2, 5]"), tmp_path)
    assert "AssertionError: another version of mpsim" in wrong.stderr, "negative control"


def test_a_program_and_a_scene_have_the_walls_that_were_drawn(tmp_path):
    scene = mpsim.Scene(width=8, height=4, position=[[2, 2]], velocity=[[1, 0]], radius=0.5)
    with simulate(scene, method="grid") as sim:
        sim.add_wall([(4, 0), (4, 4)], thickness=0.25)
        sim.run(frames=200)
        text, digest = keep.program(sim, "").content.decode(), sim.digest()
        unpacked(keep.scene_now(sim, ""), tmp_path)
    assert "    sim.add_wall(points=[[4.0, 0.0], [4.0, 4.0]], thickness=0.25)\n" in text
    assert digest in text
    exec(text, {})  # which ends by comparing digests
    assert scenefile.load(tmp_path / "scene.toml").scene.obstacles == (mpsim.Polyline([(4, 0), (4, 4)], 0.25),)


def test_the_program_of_a_named_scene_names_it(tmp_path):
    with mpsim.Simulation(mpsim.Scene.load("gas"), mpsim.Settings(method="grid", dt=0.02)) as sim:
        text = keep.program(played(sim), "gas").content.decode()
    assert "scene = mpsim.Scene.load('gas')\n" in text
    assert "settings = mpsim.Settings(dt=0.02, method='grid')\n" in text
    assert run_as_program(text, tmp_path).returncode == 0


def test_a_program_of_very_many_numbers_is_refused():
    with simulate(gas(2001, 0.3), method="grid") as sim:
        with pytest.raises(mpsim.InputError, match=r"at most 2000 discs; this scene has 2,001 .*Download the session"):
            keep.program(sim, "")
        assert keep.session(sim, "").content


@pytest.mark.parametrize("words", SCENES)
@pytest.mark.parametrize("added", [False, True])
def test_the_scene_of_this_moment_goes_on_from_it(words, added, tmp_path):
    with simulate(SCENES[words](), method="grid") as sim:
        sim.run(frames=4)
        sim.change(dt=0.005, gravity=(0.0, -0.75))
        sim.remove([4])
        if added:
            sim.add(first_free_place(sim.state), (0.5, 0.0), **({} if words == "a gas" else {"mass": 2.0, "spin": 3.0}))
        state, count, masses = sim.state, sim.count, sim.masses
        assert unpacked(keep.scene_now(sim, "a name"), tmp_path)[-1].startswith("scene")
    found = scenefile.load(tmp_path / "scene.toml")
    assert found.settings.dt == 0.005
    assert (found.scene.gravity.tolist(), found.title) == ([0.0, -0.75], f"a name at time {sim.time:g}")
    here = state.present
    assert found.scene.count == count - 1
    assert np.array_equal(found.scene.position, state.position[here])
    assert np.array_equal(found.scene.velocity, state.velocity[here])
    if words == "many features":
        assert found.scene.box == state.box != stage().box, "the piston is where it was"
        assert np.array_equal(found.scene.mass, masses[here])
        assert np.array_equal(found.scene.spin, state.spin[here])
    with simulate(found.scene, method="grid") as again:
        again.run(frames=3)


def test_a_scene_of_this_moment_that_would_guess_is_refused():
    with simulate(zoo("acceleration", count=5, side=20.0), method="grid") as sim:
        sim.add((1.0, 1.0), (0, 0), (3.0, 0.0))
        with pytest.raises(mpsim.InputError, match="needs the acceleration of each disc"):
            keep.scene_now(sim, "")


def test_session_files_are_toml_that_people_can_read(tmp_path):
    with simulate(gas(80, 0.2), method="grid") as sim:
        unpacked(keep.session(played(sim), ""), tmp_path)
    tables = tomllib.loads((tmp_path / "session.toml").read_text())
    assert [each["what"] for each in tables["change"]] == ["set", "kick", "change", "remove"]
