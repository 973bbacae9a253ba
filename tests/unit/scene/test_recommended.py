"""What scenes recommend: kept, written and read, in no digest, and used by whoever runs the scene."""

import pickle

import pytest
from support.commands import mpsim_command

import mpsim
from mpsim.output.animation import pictures_of
from mpsim.scene import scenefile
from mpsim.scene.recommended import frames_between_pictures, settings_for
from mpsim.viewer.session import Session

SETTINGS = mpsim.Settings(dt=0.02, method="naive", passes=2)
RECOMMENDED = {"duration": 3.0, "settings": SETTINGS, "picture_interval": 0.2, "measures": ("temperature",)}


def gas(**recommended) -> mpsim.Scene:
    return mpsim.Scene.random(count=20, packing=0.2, radius=0.5, seed=1, **recommended)


def recommended_by(scene: mpsim.Scene) -> dict:
    return {name: getattr(scene, name) for name in RECOMMENDED}


def test_recommendations_stay_with_a_scene_and_are_in_no_digest(tmp_path):
    scene, bare = gas(**RECOMMENDED), gas()
    scene.save(tmp_path / "scene.toml")
    others = [scene.redrawn(3), pickle.loads(pickle.dumps(scene)), mpsim.Scene.load(tmp_path / "scene.toml")]
    with mpsim.Simulation(scene) as sim:
        sim.run(frames=2)
        others.append(scene.starting_from(sim.state))
        sim.save(tmp_path / "run.mpsim")
    with mpsim.Simulation.resume(tmp_path / "run.mpsim") as again:
        others.append(again.scene)
    for each in [scene, *others]:
        assert recommended_by(each) == RECOMMENDED
    assert scene.digest() == bare.digest() == again.scene.digest()
    assert recommended_by(bare) == {"duration": None, "settings": None, "picture_interval": None, "measures": ()}


def test_whoever_runs_a_scene_takes_its_settings():
    scene, own = gas(**RECOMMENDED), mpsim.Settings(dt=0.05)
    for given, taken in ((None, SETTINGS), (own, own)):
        with mpsim.Simulation(scene, given) as sim:
            assert sim.settings == taken
        assert Session(scene, given, audience=None)._settings == taken
    assert settings_for(gas(), None) == mpsim.Settings(), "the control"
    with pytest.raises(mpsim.InputError, match=r"settings must be mpsim.Settings; got float. Use Settings"):
        settings_for(scene, 0.01)
    (row,) = mpsim.sweep(scene, {"law": ["elastic"]}, measures=["temperature"]).rows
    assert row.values["frames"] == 150


def test_the_picture_interval_becomes_frames_of_any_step():
    scene = gas(**RECOMMENDED)
    assert frames_between_pictures(scene, SETTINGS) == 10
    assert frames_between_pictures(scene, mpsim.Settings(dt=2.0)) == 1
    assert frames_between_pictures(gas(), SETTINGS) is None
    assert pictures_of(scene, SETTINGS, None, None) == (16, 10)
    assert pictures_of(scene, SETTINGS, 3, 2) == (3, 2)
    assert pictures_of(gas(), SETTINGS, None, None) == (200, 1)


def test_a_command_runs_as_long_as_recommended_and_measures_it(tmp_path):
    gas(**RECOMMENDED).save(tmp_path / "scene.toml")
    path, out = tmp_path / "scene.toml", tmp_path / "run"
    lines = mpsim_command("run", path, "--quiet", "--out", out).stdout.splitlines()
    assert lines[0].startswith("150 frames by naive, ")
    assert lines[2].startswith("temperature: ")
    assert [frame.frame for frame in mpsim.Trajectory(out / "trajectory.xyz")] == list(range(0, 151, 10))
    shorter = mpsim_command("run", path, "--quiet", "--frames", 10, "--measure", "kinetic_energy").stdout
    assert shorter.startswith("10 frames by naive, ")
    assert "temperature" not in shorter
    shown = mpsim_command("show", path).stdout
    assert "pictures     every 0.2\nmeasures     temperature\n" in shown


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"settings": {"dt": 0.1}}, r"settings must be mpsim.Settings; got dict. Use Settings\(dt=...\)"),
        ({"picture_interval": 0}, r"picture_interval must be a finite number > 0 \[time\]; got 0"),
        ({"measures": ["presure"]}, r"measures must be one of .* got 'presure'. Did you mean 'pressure'\?"),
        ({"measures": 3}, r"measures must be names of measures; got 3"),
    ],
)
def test_bad_recommendations_are_refused(given, text):
    with pytest.raises(mpsim.InputError, match=text):
        gas(**given)


def test_a_bad_recommendation_in_a_file_is_named(tmp_path):
    text = (scenefile.reading.PACKAGED / "cradle.toml").read_text()
    (tmp_path / "a.toml").write_text(text.replace('["kinetic_energy"]', '["kinetic_enrgy"]').replace("= 0.2", "= -1.0"))
    with pytest.raises(mpsim.errors.SceneFileError) as caught:
        scenefile.load(tmp_path / "a.toml")
    assert "picture_interval must be a finite number > 0 [time]; got -1.0" in str(caught.value)
    assert "Did you mean 'kinetic_energy'?" in str(caught.value)
