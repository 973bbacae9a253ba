"""`mpsim run`, `resume`, `plot`, `animate` and the rest: what they write, print, refuse; how Ctrl-C leaves a run."""

import contextlib
import csv
import json
import math
import re

import numpy as np
import pytest
from click.testing import CliRunner, Result
from PIL import Image

import mpsim
from mpsim.cli import terminal
from mpsim.cli.app import main
from mpsim.cli.run import pictures_of
from mpsim.cli.runfolder import RunFolder
from mpsim.engine.run_loop import frames_until
from mpsim.engine.workers import shared
from mpsim.measure import Measure
from mpsim.output.recorder import COLUMNS, read_table
from mpsim.output.tables import measure_text
from mpsim.scene import scenefile
from mpsim.studies import benchmark

SHORT = ("--method", "grid", "--frames", "30", "--every", "4", "--quiet")


def mpsim_command(*arguments: object) -> Result:
    """Run the command in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture
def ctrl_c(monkeypatch):
    """Call it with a number of frames: Ctrl-C comes when the next run has done so many."""

    def at(frames: int) -> None:
        @contextlib.contextmanager
        def progress(quiet):
            def show(done, of, what):
                if done >= frames:
                    raise KeyboardInterrupt

            yield show

        monkeypatch.setattr(terminal, "progress", progress)

    yield at
    monkeypatch.undo()


def library_digest(frames: int, **settings) -> str:
    file = scenefile.load("gas")
    with mpsim.Simulation(file.scene, mpsim.Settings(**{**vars(file.settings), "method": "grid", **settings})) as sim:
        sim.run(frames=frames)
        return sim.digest()


# --- run


def test_run_tells_what_it_did_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = mpsim_command("run", "gas", "--method", "grid", "--frames", 30, "--measure", "kinetic_energy")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[0].startswith("30 frames by grid, median ")
    assert lines[1].startswith("frame 30, time 0.3, 100 discs; ")
    assert lines[2].startswith("kinetic_energy: 100 +- ")
    assert lines[3] == f"digest {library_digest(30)}"
    assert not list(tmp_path.iterdir())


def test_settings_are_the_scenes_but_for_those_given():
    found = json.loads(
        mpsim_command("run", "gas", *SHORT[:4], "--dt", "0.02", "--precision", "float32", "--json").stdout
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


def test_a_folder_holds_all_of_a_run(tmp_path):
    out = tmp_path / "run"
    result = mpsim_command("run", "gas", *SHORT, "--out", out, "--measure", "pressure")
    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    assert (
        f"written to {out}/: trajectory.xyz, measures.csv, timings.csv, final.npz, final.png; 8 frames" in result.stdout
    )
    record = json.loads((out / "run.json").read_text())
    assert record["scene_digest"] == mpsim.Scene.load("gas").digest()
    assert record["settings"]["method"] == "grid"
    assert (record["status"], record["frame"], record["digest"]) == ("done", 30, library_digest(30))
    assert record["versions"].keys() == {"python", "mpsim", "numpy", "numba"}
    assert record["parts"][0]["measures"]["pressure"]["value"] > 0
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
        f"Error: --out holds a run already: '{out}' is not overwritten. Give another name, --force to replace it, or "
        f"go on with it: mpsim resume {out}\n"
    )
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert mpsim_command("run", "gas", *SHORT, "--dt", "0.02", "--out", out, "--force").exit_code == 0
    assert json.loads((out / "run.json").read_text())["settings"]["dt"] == 0.02
    assert mpsim.Trajectory(out / "trajectory.xyz")[1].time == 0.08


def test_a_folder_of_something_else_is_never_overwritten(tmp_path):
    (tmp_path / "thesis.tex").write_text("years")
    refused = mpsim_command("run", "gas", *SHORT, "--out", tmp_path, "--force")
    assert refused.exit_code == 2
    assert "holds other files, which are not overwritten. Give another name." in refused.stderr
    refused = mpsim_command("run", "gas", *SHORT, "--out", tmp_path / "thesis.tex")
    assert refused.exit_code == 2
    assert "--out must be a folder; " in refused.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    refused = mpsim_command("run", "gas", *SHORT, "--out", tmp_path / "thesis.tex" / "run")
    assert refused.exit_code == 1
    assert "--out must be a folder that can be written to, with room on its disk; got " in refused.stderr


# --- resume, Ctrl-C


def test_ctrl_c_is_one_line_and_the_run_goes_on_to_the_same_bits(tmp_path, ctrl_c, monkeypatch):
    whole, out = tmp_path / "whole", tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", whole)
    ctrl_c(3)
    stopped = mpsim_command("run", "gas", *SHORT, "--out", out)
    frame = json.loads((out / "run.json").read_text())["frame"]
    assert 3 <= frame < 30
    assert (stopped.exit_code, stopped.stdout) == (130, "")
    assert stopped.stderr == f"Interrupted at frame {frame} of 30. Go on with: mpsim resume {out}\n"
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
        "is at frame 30, time 0.3; it was to go to frame 30. Say how far it is to go on: --frames or" in refused.stderr
    )
    assert mpsim_command("resume", tmp_path / "run", "--frames", 10, "--quiet").exit_code == 0
    last = mpsim_command("resume", tmp_path / "run", "--until", 0.5, "--quiet")
    assert f"digest {library_digest(50)}\n" in last.stdout
    assert "13 frames in the trajectory" in last.stdout
    timings = (tmp_path / "run" / "timings.csv").read_text().splitlines()
    assert [int(line.split(",")[0]) for line in timings[1:]] == list(range(1, 51))


def test_only_one_process_writes_to_a_folder(tmp_path):
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    with RunFolder.claim(out):  # as a run that goes on holds it
        for command in (("resume", out, "--frames", 5), ("run", "gas", *SHORT, "--out", out, "--force")):
            refused = mpsim_command(*command)
            assert refused.exit_code == 2
            assert f"another one is writing to '{out}' at this moment. Wait for its end" in refused.stderr
        assert mpsim_command("plot", out).exit_code == 0, "looking is free"
        (out / "plot.png").unlink()
        assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert mpsim_command("resume", out, "--frames", 5, "--quiet").exit_code == 0


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
    assert "is at frame 30, time 0.3; --until 0.1 is frame 10. Say how far it is to go on" in refused.stderr


def test_frames_that_a_kill_makes_the_run_compute_again_are_told(tmp_path):
    """The checkpoint of the start beside a trajectory of all frames, as a kill before the next checkpoint leaves it."""
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out)
    trajectory = (out / "trajectory.xyz").read_bytes()
    with mpsim.Simulation(scenefile.load("gas").scene, mpsim.Settings(method="grid")) as sim:
        sim.save(out / "checkpoint.mpsim")
    resumed = mpsim_command("resume", out, "--frames", 30)
    assert resumed.exit_code == 0
    assert "Going on from the checkpoint of frame 0: " in resumed.stderr
    assert "Its 7 recorded frames after that, up to 28, are computed again, to the same bits.\n" in resumed.stderr
    assert (out / "trajectory.xyz").read_bytes() == trajectory


@pytest.mark.parametrize("damage", [b"\0" * 5000 + b"\n", b"1,2\n", b"x,0,0,0,0,0,0\n", b"\xff\xfe,\n"])
def test_a_damaged_table_is_one_short_error(tmp_path, damage):
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out)
    with (out / "measures.csv").open("ab") as file:
        file.write(damage)
    for command in (("resume", out, "--frames", 5, "--quiet"), ("plot", out)):
        refused = mpsim_command(*command)
        assert refused.exit_code == 2
        assert (
            f"line 10 of '{out / 'measures.csv'}' must be a row of 7 numbers that a run has written" in refused.stderr
        )
        assert len(refused.stderr) < 700


def test_a_measure_of_too_few_samples_says_so(tmp_path):
    done = mpsim_command("run", "gas", "--frames", 3, "--method", "grid", "--measure", "pressure", "--quiet")
    assert "(too few samples for an error)\n" in done.stdout
    assert "nan" not in done.stdout


def test_what_is_not_settled_is_shown_as_such(tmp_path):
    done = mpsim_command("run", "gas", "--frames", 30, "--method", "grid", "--measure", "pressure", "--quiet")
    line = next(line for line in done.stdout.splitlines() if line.startswith("pressure: "))
    assert re.fullmatch(r"pressure: \S+ \(error at (least|most) \S+, not settled: run longer\)", line)
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out, "--measure", "pressure")
    assert json.loads((out / "run.json").read_text())["parts"][0]["measures"]["pressure"]["settled"] is False


@pytest.mark.parametrize(
    ("measure", "text"),
    [
        (Measure(2.24, 0.016, 500), "2.24 +- 0.016"),
        (Measure(2.24, 0.016, 500, settled=False), "2.24 (error at least 0.016, not settled: run longer)"),
        (Measure(0.0, 0.018, 500, settled=False, upper=True), "0 (error at most 0.018, not settled: run longer)"),
        (Measure(0.3, math.nan, 500, settled=False), "0.3 (error unknown)"),
        (Measure(0.3, math.nan, 3, settled=False), "0.3 (too few samples for an error)"),
    ],
)
def test_an_error_in_words(measure, text):
    assert measure_text(measure) == text


def test_a_run_that_fails_says_so_in_its_record(tmp_path, monkeypatch):
    def fail(self, *arguments, **options):
        if options.get("observe"):
            raise mpsim.WorkerStalled("worker 1 was not ready")
        return run(self, *arguments, **options)

    run = mpsim.Simulation.run
    monkeypatch.setattr(mpsim.Simulation, "run", fail)
    result = mpsim_command("run", "gas", *SHORT, "--out", tmp_path / "run")
    assert (result.exit_code, result.stderr) == (1, "Error: worker 1 was not ready\n")
    assert json.loads((tmp_path / "run" / "run.json").read_text())["status"] == "ended early"
    monkeypatch.undo()
    assert f"digest {library_digest(30)}\n" in mpsim_command("resume", tmp_path / "run", "--quiet").stdout


@pytest.mark.parametrize("command", ["resume", "plot"])
def test_a_folder_that_is_no_run_is_refused(tmp_path, command):
    result = mpsim_command(command, tmp_path)
    assert result.exit_code == 2
    assert "Error: the folder of a run must hold run.json; " in result.stderr
    assert "Give a folder that `mpsim run --out` has made." in result.stderr
    (tmp_path / "run.json").write_text('{"format": 99}')
    assert "is of format 99; this mpsim reads up to 1. Use a newer" in mpsim_command(command, tmp_path).stderr
    (tmp_path / "run.json").write_text('{"format": 1, "scene": "gas", "every": 1, "trajectory": "a", "parts": []}')
    assert "run.json must hold measures, status, target; that in " in mpsim_command(command, tmp_path).stderr


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["run", "gas", "--frames", 3, "--until", 2], "Give --frames or --until, not both."),
        (["resume", "gas", "--frames", 3, "--until", 2], "Give --frames or --until, not both."),
        (["run", "gas", "--every", 3], "--every needs --out, the folder to write to."),
        (["run", "gas", "--force"], "--force needs --out"),
        (["run", "gas", "--format", "gsd"], "--format needs --out"),
        (["run", "gas", "--dt", "0"], "'--dt': '0' must be a number > 0, such as 0.05."),
        (["run", "gas", "--frames", "0"], "0 is not in the range x>=1"),
        (["run", "gsa"], "got 'gsa'. Did you mean 'gas'?"),
        (["run", "none.toml"], "scene must be a file that can be read; got 'none.toml' (No such file or directory)."),
        (["animate", "gsa", "a.gif"], "got 'gsa'. Did you mean 'gas'?"),
        (["run", "gas", "--method", "gird"], "'--method': 'gird' is not one of"),
        (["completion", "tcsh"], "'tcsh' is not one of 'bash', 'zsh', 'fish'."),
    ],
)
def test_wrong_usage_and_input_are_exit_code_2(arguments, text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = mpsim_command(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert text in result.stderr
    assert not list(tmp_path.iterdir())


# --- plot and animate


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
    assert f"'{other}' is there already, and is not overwritten. Give another name, or --force." in refused.stderr
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
    assert "is there already, and is not overwritten. Give another name, or --force." in refused.stderr
    again = mpsim_command("animate", "gas", path, *few, "--force", "--json")
    assert json.loads(again.stdout) == {"animation": str(path), "pictures": 3, "bytes": path.stat().st_size}


def test_what_cannot_be_animated_is_told_before_any_picture(tmp_path, monkeypatch, ctrl_c):
    monkeypatch.setenv("PATH", str(tmp_path))  # without ffmpeg
    result = mpsim_command("animate", "gas", tmp_path / "a.mp4")
    assert result.exit_code == 1
    assert f"needs ffmpeg, which is not on the PATH. Write '{tmp_path}/a.gif' or install ffmpeg." in result.stderr
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


# --- bench, warmup, completion


def test_bench_tells_how_fast_each_method_is(monkeypatch):
    arguments = ("bench", "--frames", 60, "--workers", 2, "--quiet")
    found = json.loads(mpsim_command(*arguments, "--json").stdout)
    digests = {row["method"]: row["digest"] for row in found["methods"]}
    assert digests["grid"] == digests["parallel"] != digests["naive"]
    assert all(row["median_seconds"] > 0 for row in found["methods"])
    measured = benchmark.fixed(mpsim.Settings(method="grid", contact="push"), 2, lambda word: None, 20)
    monkeypatch.setattr(benchmark, "fixed", lambda *given: measured)
    lines = mpsim_command(*arguments).stdout.splitlines()
    assert [line.split()[0] for line in lines[1:4]] == ["naive", "grid", "parallel"]
    assert all(" us a frame, mean " in line for line in lines[1:4])
    assert lines[4] == f"grid and parallel gave the same bits: {measured.timings['grid'].digest}"


def test_warmup_says_how_long_each_scene_took():
    result = mpsim_command("warmup", "gas", "--method", "grid", "--quiet")
    assert result.exit_code == 0
    assert result.stdout.startswith("gas ")
    assert result.stdout.endswith(" kernels compiled or loaded\n")
    (found,) = json.loads(mpsim_command("warmup", "gas", "--method", "grid", "--quiet", "--json").stdout)
    assert (found["scene"], found["kernels"]) == ("gas", 0), "the second time nothing is missing"
    assert found["seconds"] > 0


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_what_the_shell_needs(shell):
    text = mpsim_command("completion", shell).stdout
    assert "_MPSIM_COMPLETE" in text
    assert "mpsim" in text


def test_scenes_are_completed():
    from click.shell_completion import ShellComplete  # noqa: PLC0415

    words = [item.value for item in ShellComplete(main, {}, "mpsim", "_MPSIM_COMPLETE").get_completions(["run"], "ga")]
    assert {"galton", "gas"} <= set(words)
    assert "pi" not in words


@pytest.mark.parametrize("command", ["run", "resume", "plot", "animate", "bench", "warmup", "completion"])
def test_help_has_examples(command):
    result = mpsim_command(command, "--help")
    assert result.exit_code == 0
    assert f"Examples:\n    mpsim {command}" in result.stdout


def test_clean_can_tell_in_json(monkeypatch):
    block = shared.StaleBlock("mpsim-7-0123abcd", 7, 4096)
    monkeypatch.setattr(shared, "stale_blocks", lambda: [block])
    found = json.loads(mpsim_command("clean", "--dry-run", "--json").stdout)
    assert found == [{"name": "mpsim-7-0123abcd", "pid": 7, "nbytes": 4096}]


def test_large_scenes_are_written_less_often():
    assert [pictures_of(count) for count in (0, 100, 10_000, 50_000, 10**6)] == [100, 100, 100, 20, 10]
