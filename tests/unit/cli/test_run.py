"""`mpsim run` and `mpsim resume`: what they write and print; how Ctrl-C leaves a run."""

import csv
import json
import re

import numpy as np
import pytest
from PIL import Image
from support.commands import SHORT, library_digest, mpsim_command

import mpsim
from mpsim.cli.run import pictures_of
from mpsim.engine.frame_count import frames_until
from mpsim.output.recorder import COLUMNS, read_table
from mpsim.scene import scenefile

# --- run


def test_run_tells_what_it_did_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = mpsim_command("run", "gas", "--method", "grid", "--frames", 30, "--measure", "kinetic_energy")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[0].startswith("30 frames by grid, median ")
    assert lines[1].startswith("frame 30, time 0.3, 100 discs; ")
    assert lines[2] == "kinetic_energy: 100(0)"
    assert lines[3] == f"digest {library_digest(30)}"
    assert not list(tmp_path.iterdir())


def test_settings_are_the_scenes_but_for_those_given():
    found = json.loads(
        mpsim_command(
            "run", "gas", *SHORT[:4], "--dt", 0.02, "--precision", "float32", "--measure", "temperature", "--json"
        ).stdout
    )
    assert found["settings"]["dt"] == 0.02
    assert found["settings"]["contact"] == scenefile.load("gas").settings.contact
    assert found["digest"] == library_digest(30, dt=0.02, precision="float32")
    assert (found["from_frame"], found["to_frame"], found["method"]) == (0, 30, "grid")


@pytest.mark.parametrize(("until", "frames"), [(0.3, 30), (0.301, 31), (0.299, 30), (1e-9, 1)])
def test_until_is_the_first_frame_that_reaches_it(until, frames):
    assert frames_until(until, 0.01) == frames
    with mpsim.Simulation(mpsim.Scene.load("gas"), mpsim.Settings(method="naive")) as sim:
        sim.run(until=until)
        assert sim.frame == frames, "as the library does"


def test_measures_are_taken_from_a_start_on_also_where_the_run_is_continued(tmp_path, ctrl_c, monkeypatch):
    measured = ("--measure", "collision_rate")
    with mpsim.Simulation(mpsim.Scene.load("gas"), mpsim.Settings(method="grid")) as sim:
        expected = sim.run(frames=30, measures="collision_rate", start=0.2).measures["collision_rate"]
        late = sim.digest()
    found = json.loads(mpsim_command("run", "gas", *SHORT[:4], *measured, "--start", 0.2, "--json").stdout)
    assert found["measures"]["collision_rate"]["value"] == expected.value
    all_of_it = json.loads(mpsim_command("run", "gas", *SHORT[:4], *measured, "--json").stdout)
    assert all_of_it["measures"]["collision_rate"]["value"] != expected.value, "negative control"
    out = tmp_path / "run"
    ctrl_c(3)
    mpsim_command("run", "gas", *SHORT, *measured, "--start", 0.2, "--out", out)
    monkeypatch.undo()
    assert mpsim_command("resume", out, "--frames", 2, "--quiet").exit_code == 0
    result = mpsim_command("resume", out, "--quiet")
    assert f"digest {late}\n" in result.stdout
    parts = json.loads((out / "run.json").read_text())["parts"]
    assert parts[-2]["measures"] == {}, "a part that ends before the start"
    assert parts[-1]["measures"]["collision_rate"]["value"] == expected.value


def test_a_start_at_0_is_that_of_the_whole_run():
    words = ("run", "gas", *SHORT[:4], "--measure", "collision_rate", "--json")
    whole, same = (json.loads(mpsim_command(*words, *more).stdout)["measures"] for more in ((), ("--start", 0)))
    assert same == whole


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--start", "0.3"], "--start must lie before the end of the run, at time 0.3; got 0.3"),
        (["--start", "-1"], "Invalid value for '--start'"),
        (["--start", "soon"], "Invalid value for '--start'"),
    ],
)
def test_a_start_that_leaves_nothing_to_measure_writes_nothing(tmp_path, words, text):
    result = mpsim_command("run", "gas", *SHORT, *words, "--out", tmp_path / "run")
    assert result.exit_code == 2
    assert text in result.stderr
    assert not (tmp_path / "run").exists()


def test_a_folder_holds_all_of_a_run(tmp_path):
    out = tmp_path / "run"
    result = mpsim_command("run", "gas", *SHORT, "--out", out, "--measure", "pressure")
    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    assert (
        f"written to {out}/: trajectory.xyz, measures.csv, averages.csv, timings.csv, final.npz, final.png; 8 frames"
        in result.stdout
    )
    record = json.loads((out / "run.json").read_text())
    assert record["scene_digest"] == mpsim.Scene.load("gas").digest()
    assert record["settings"]["method"] == "grid"
    assert (record["status"], record["frame"], record["digest"]) == ("done", 30, library_digest(30))
    assert record["versions"].keys() == {"python", "mpsim", "numpy", "numba"}
    pressure = record["parts"][0]["measures"]["pressure"]
    assert pressure["value"] > 0
    with (out / "averages.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["measure"], row["from_frame"], row["to_frame"]) == ("pressure", "0", "30")
    assert {name: str(value) for name, value in pressure.items()}.items() <= row.items()
    assert mpsim.State.load(out / "final.npz").digest() == record["digest"]
    assert [frame.frame for frame in mpsim.Trajectory(out / "trajectory.xyz")] == [0, 4, 8, 12, 16, 20, 24, 28]
    with (out / "timings.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frame"]) for row in rows] == list(range(1, 31))
    assert all(float(row["seconds"]) > 0 for row in rows)
    table = read_table(out / "measures.csv")
    assert table["frame"].tolist() == [0, 4, 8, 12, 16, 20, 24, 28]
    assert table["kinetic_energy"] == pytest.approx(np.full(8, 100.0))
    assert table["discs"].tolist() == [100] * 8
    rate = table["collision_rate"][1:] * 100 * 4 * 0.01 / 2
    assert rate == pytest.approx(rate.round()), "a whole number of collisions in each row"
    assert 0 < rate.sum() <= record["parts"][0]["collisions"]
    with Image.open(out / "final.png") as picture:
        assert min(picture.size) > 300


def test_gsd_can_be_chosen(tmp_path):
    result = mpsim_command("run", "gas", *SHORT, "--out", tmp_path / "run", "--format", "gsd", "--json")
    assert json.loads(result.stdout)["trajectory"] == "trajectory.gsd"
    assert len(mpsim.Trajectory(tmp_path / "run" / "trajectory.gsd")) == 8


def test_a_run_that_is_there_is_not_overwritten_unasked(tmp_path):
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    refused = mpsim_command("run", "gas", *SHORT, "--out", out)
    assert refused.exit_code == 2
    assert refused.stderr == (
        f"Error: --out already holds a run: '{out}' is not overwritten. Give another name, --force to replace it, or "
        f"continue it: mpsim resume {out}\n"
    )
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert mpsim_command("run", "gas", *SHORT, "--dt", "0.02", "--out", out, "--force").exit_code == 0
    assert json.loads((out / "run.json").read_text())["settings"]["dt"] == 0.02
    assert mpsim.Trajectory(out / "trajectory.xyz")[1].time == 0.08


# --- resume, Ctrl-C


def test_ctrl_c_is_one_line_and_the_run_goes_on_to_the_same_bits(tmp_path, ctrl_c, monkeypatch):
    whole, out = tmp_path / "whole", tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", whole)
    ctrl_c(3)
    stopped = mpsim_command("run", "gas", *SHORT, "--out", out)
    frame = json.loads((out / "run.json").read_text())["frame"]
    assert 3 <= frame < 30
    assert (stopped.exit_code, stopped.stdout) == (130, "")
    assert stopped.stderr == f"Interrupted at frame {frame} of 30. Continue with: mpsim resume {out}\n"
    assert json.loads((out / "run.json").read_text())["status"] == "interrupted"
    assert not (out / "final.npz").exists()
    plotted = mpsim_command("plot", out)  # what there is so far
    assert plotted.exit_code == 0, plotted.stderr
    monkeypatch.undo()
    resumed = mpsim_command("resume", out, "--quiet", "--json")
    record = json.loads(resumed.stdout)
    assert (record["status"], record["frame"], record["parts"][-1]["from_frame"]) == ("done", 30, frame)
    assert record["digest"] == json.loads((whole / "run.json").read_text())["digest"]
    assert (out / "trajectory.xyz").read_bytes() == (whole / "trajectory.xyz").read_bytes()
    here, there = read_table(out / "measures.csv"), read_table(whole / "measures.csv")
    for name in set(COLUMNS) - {"collision_rate"}:  # which after a resume is of fewer frames
        assert np.array_equal(here[name], there[name]), name


def test_ctrl_c_without_a_folder_says_that_nothing_is_kept(ctrl_c):
    ctrl_c(1)
    stopped = mpsim_command("run", "gas", "--frames", 5000, "--method", "grid")
    assert (stopped.exit_code, stopped.stdout) == (130, "")
    assert stopped.stderr.endswith(" of 5000. Nothing is kept without --out FOLDER.\n")


def test_a_run_that_has_ended_goes_on_where_it_is_told_to(tmp_path):
    mpsim_command("run", "gas", *SHORT, "--out", tmp_path / "run")
    refused = mpsim_command("resume", tmp_path / "run")
    assert refused.exit_code == 2
    assert (
        "is at frame 30, time 0.3; it was to go to frame 30. Say how far it is to continue: --frames or"
        in refused.stderr
    )
    assert mpsim_command("resume", tmp_path / "run", "--frames", 10, "--quiet").exit_code == 0
    last = mpsim_command("resume", tmp_path / "run", "--until", 0.5, "--quiet")
    assert f"digest {library_digest(50)}\n" in last.stdout
    assert "13 frames in the trajectory" in last.stdout
    timings = (tmp_path / "run" / "timings.csv").read_text().splitlines()
    assert [int(line.split(",")[0]) for line in timings[1:]] == list(range(1, 51))


def test_a_part_of_the_way_leaves_the_end_that_was_asked_for(tmp_path, ctrl_c, monkeypatch):
    out = tmp_path / "run"
    ctrl_c(3)
    mpsim_command("run", "gas", *SHORT, "--out", out)
    monkeypatch.undo()
    assert mpsim_command("resume", out, "--frames", 2, "--quiet").exit_code == 0
    record = json.loads((out / "run.json").read_text())
    assert (record["status"], record["target"]) == ("paused", 30)
    assert mpsim_command("resume", out, "--quiet").exit_code == 0
    record = json.loads((out / "run.json").read_text())
    assert (record["status"], record["frame"]) == ("done", 30)
    refused = mpsim_command("resume", out, "--until", 0.1)
    assert "is at frame 30, time 0.3; --until 0.1 is frame 10. Say how far it is to continue" in refused.stderr


def test_a_run_goes_on_by_another_method_that_has_its_bits(tmp_path):
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out)
    last = mpsim_command("resume", out, "--frames", 10, "--method", "parallel", "--workers", 2, "--quiet")
    assert f"digest {library_digest(40)}\n" in last.stdout, last.stderr
    record = json.loads((out / "run.json").read_text())
    assert (record["settings"]["method"], record["parts"][-1]["method"]) == ("parallel", "parallel")
    again = mpsim_command("resume", out, "--frames", 5, "--quiet", "--json")
    assert json.loads(again.stdout)["parts"][-1]["method"] == "parallel", "the one so far"
    assert mpsim_command("resume", out, "--frames", 5, "--method", "naive").exit_code == 2
    mpsim_command("run", "gas", *SHORT[2:], "--method", "naive", "--out", out, "--force")
    refused = mpsim_command("resume", out, "--frames", 5, "--method", "grid")
    assert refused.exit_code == 2
    assert "method must be that of the checkpoint, 'naive', or both must be among 'grid', 'parallel', 'mpi'" in (
        refused.stderr
    )


def test_frames_that_a_kill_makes_the_run_compute_again_are_told(tmp_path):
    """The checkpoint of the start beside a trajectory of all frames, as a kill before the next checkpoint leaves it."""
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out)
    trajectory = (out / "trajectory.xyz").read_bytes()
    with mpsim.Simulation(scenefile.load("gas").scene, mpsim.Settings(method="grid")) as sim:
        sim.save(out / "checkpoint.mpsim")
    resumed = mpsim_command("resume", out, "--frames", 30)
    assert resumed.exit_code == 0
    assert "Continuing from the checkpoint of frame 0: " in resumed.stderr
    assert "Its 7 recorded frames after that, up to 28, are computed again, to the same bits.\n" in resumed.stderr
    assert (out / "trajectory.xyz").read_bytes() == trajectory


def test_a_measure_of_too_few_samples_says_so(tmp_path):
    done = mpsim_command("run", "gas", "--frames", 3, "--method", "grid", "--measure", "pressure", "--quiet")
    assert "(too few samples for an error)\n" in done.stdout
    assert "nan" not in done.stdout


def test_what_is_not_settled_is_shown_as_such(tmp_path):
    done = mpsim_command("run", "gas", "--frames", 30, "--method", "grid", "--measure", "pressure", "--quiet")
    line = next(line for line in done.stdout.splitlines() if line.startswith("pressure: "))
    assert re.fullmatch(r"pressure: \S+ \(error at (least|most) \S+, not settled: run longer or start later\)", line)
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out, "--measure", "pressure")
    assert json.loads((out / "run.json").read_text())["parts"][0]["measures"]["pressure"]["settled"] is False


def test_large_scenes_are_written_less_often():
    assert [pictures_of(count) for count in (0, 100, 10_000, 50_000, 10**6)] == [100, 100, 100, 20, 10]
