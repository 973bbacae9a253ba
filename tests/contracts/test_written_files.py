"""Files that an earlier version wrote are read, and what they hold goes on to the pinned digests.

`written/` has them: scene files, checkpoints of every method with every feature, trajectories, the folder of a run,
and what a trade keeps. They stay as they are for as long as their formats are to be read; only where a format is given
up on purpose are they written anew:

    python -m support.written contracts/written        (in the folder tests)
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from support import written
from support.checkpoints import rewrite
from support.goldens import FRAMES, SCENES, pins
from support.written import CANDIDATE, CHECKPOINTS, EVERY, TRADED, TRAJECTORIES, checkpoint_name, frames_of, words

import mpsim
from mpsim.cli.app import main
from mpsim.scene import scenefile

FOLDER = Path(__file__).parent / "written"
EXPECTED = json.loads((FOLDER / "expected.json").read_text())
PINNED = pins()["digests"]

pytestmark = [
    pytest.mark.plain,
    pytest.mark.timeout(400),
    pytest.mark.filterwarnings(
        "ignore::mpsim.errors.EmitterWarning", "ignore::mpsim.FastWarning", "ignore::mpsim.OverlapWarning"
    ),
]


# --- scene files


@pytest.mark.parametrize("name", written.scenes())
def test_a_scene_file_is_the_scene_it_was_written_from(name):
    file = scenefile.load(FOLDER / f"{name}.toml")
    assert file.scene.digest() == written.scenes()[name].digest() == EXPECTED["scenes"][name]
    assert file.scene.duration == written.scenes()[name].duration
    assert file.scene.settings == mpsim.Settings(dt=1 / 32, contact="push")
    assert (file.title, file.text, file.look_for) == ("A title", "Text.", "This.")


def test_scene_files_are_written_to_the_same_bytes(tmp_path):
    written.write_scenes(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == sorted(path.name for path in FOLDER.iterdir() if path.suffix in (".toml", ".npy"))
    assert len(names) > 10, "large arrays have files of their own"
    for name in names:
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name


# --- states


def test_a_state_is_read_to_the_bit():
    assert mpsim.State(**np.load(FOLDER / "state.npz")).digest() == written.state().digest()
    assert mpsim.State(**np.load(FOLDER / "state.npz")).box == written.state().box


# --- checkpoints


@pytest.mark.parametrize(
    ("name", "how"), CHECKPOINTS, ids=lambda each: each if isinstance(each, str) else each["method"]
)
def test_a_checkpoint_goes_on_to_the_pinned_digest(name, how):
    with mpsim.Simulation.resume(FOLDER / checkpoint_name(name, how)) as sim:
        assert sim.frame == FRAMES // 2
        sim.run(frames=FRAMES - FRAMES // 2)
        digest = sim.digest()
    assert digest == PINNED[name][words(name, how).replace("parallel", "grid")].split()[0]


def test_there_is_a_checkpoint_of_every_method_and_feature_and_all_files_together_are_small():
    assert {how["method"] for _, how in CHECKPOINTS} == {"naive", "grid", "parallel", "event"}
    names = [checkpoint_name(*case) for case in CHECKPOINTS]
    assert sorted(names) == sorted(path.name for path in FOLDER.glob("*.mpsim"))
    assert sum(path.stat().st_size for path in FOLDER.rglob("*") if path.is_file()) < 310_000


def test_one_bit_of_a_checkpoint_changes_the_digest_of_its_run(tmp_path):
    """The control."""
    name, how = CHECKPOINTS[1]
    path = Path(shutil.copy(FOLDER / checkpoint_name(name, how), tmp_path))

    def nudge(header, arrays):
        velocity = arrays["solver.velocity"]
        fastest = np.unravel_index(np.abs(velocity).argmax(), velocity.shape)
        velocity[fastest] = np.nextafter(velocity[fastest], 0)

    digests = []
    for change in (lambda header, arrays: None, nudge):
        rewrite(path, change)
        with mpsim.Simulation.resume(path) as sim:
            sim.run(frames=12)
            digests.append(sim.digest())
    pinned = PINNED[name]["grid impact float64"].split()[0]
    assert digests[0] == pinned != digests[1]


# --- trajectories


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_a_trajectory_is_read_to_the_bit(name):
    frames = frames_of(FOLDER / name)
    assert frames == EXPECTED["trajectories"][name]
    assert [frame[0] for frame in frames] == [0, 6, 12]


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_a_trajectory_is_written_to_the_same_bytes_and_continued_by_the_run_that_wrote_it(name, tmp_path):
    written.write_trajectories(tmp_path, name)
    path = tmp_path / name
    same = path.read_bytes() == (FOLDER / name).read_bytes()
    assert same or name.endswith(".gsd"), "whose library may lay it out anew"
    assert frames_of(path) == EXPECTED["trajectories"][name]
    start = FOLDER / checkpoint_name(path.stem, {"method": "parallel"})
    path = Path(shutil.copy(FOLDER / name, tmp_path))
    with mpsim.Simulation.resume(start) as sim, mpsim.Trajectory.write(path, EVERY, mode="a") as out:
        sim.run(frames=FRAMES - FRAMES // 2, observe=out)
        last, here = sim.state, sim.state.present
    image = None if last.image is None else last.image[here]
    rest = mpsim.State(last.position[here], last.velocity[here], image=image, box=last.box)
    frames = frames_of(path)
    assert frames[:3] == EXPECTED["trajectories"][name]
    assert [frame[0] for frame in frames] == [0, 6, 12, 18, 24]
    assert frames[-1][-1] == rest.digest()


# --- the folder of a run, and a trade


def test_the_folder_of_a_run_is_gone_on_with(tmp_path):
    copy = shutil.copytree(FOLDER / "run", tmp_path / "run")
    CliRunner().invoke(main, ["resume", str(copy), "--frames", "12", "--quiet"], catch_exceptions=False)
    before, after = (json.loads((folder / "run.json").read_text()) for folder in (FOLDER / "run", copy))
    with mpsim.Simulation.resume(FOLDER / "run" / "checkpoint.mpsim") as sim:
        sim.run(frames=12)
        assert after["digest"] == sim.digest() != before["digest"]
    assert (before["frame"], after["frame"], after["status"]) == (12, 24, "done")
    assert len(after["parts"]) == 2
    assert repr(after["parts"][0]) == repr(before["parts"][0])  # NaN and all
    kept = ("scene", "scene_digest", "every", "measures", "versions")
    assert {name: after[name] for name in kept} == {name: before[name] for name in kept}
    assert after["settings"] == before["settings"]
    assert [frame[0] for frame in frames_of(copy / after["trajectory"])] == [0, 4, 8, 12, 16, 20, 24]
    rows = (copy / "measures.csv").read_text().splitlines()
    assert len(rows) == 1 + 7, "a head, and a row for each of these frames"
    assert mpsim.State(**np.load(FOLDER / "run" / "final.npz")).digest() == before["digest"]


@pytest.mark.slow
def test_a_trade_goes_on_from_what_it_kept(tmp_path):
    """Costs are times, so they are the same only where nothing was run again."""
    trade, expected = shutil.copy(FOLDER / "trade.json", tmp_path), json.loads((FOLDER / "table.json").read_text())
    found = json.loads(mpsim.tradeoff(SCENES["bare"].scene(), [CANDIDATE], path=trade, **TRADED).to_json())
    assert found.keys() == expected.keys()
    for got, row in zip(found["rows"], expected["rows"], strict=True):
        kept = {name: pytest.approx(value) if isinstance(value, float) else value for name, value in row.items()}
        assert got == kept
