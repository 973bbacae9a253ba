"""The folder of a run: what is refused as one, who may write to it, what its record says."""

import json

import pytest
from support.commands import SHORT, library_digest, mpsim_command

import mpsim
from mpsim.cli.runfolder import RunFolder


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


def test_a_run_that_fails_says_so_in_its_record(tmp_path, monkeypatch):
    def fail(self, *arguments, **options):
        if options.get("observe"):
            raise mpsim.errors.WorkerStalledError("worker 1 was not ready")
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
    (tmp_path / "run.json").write_text(
        '{"format": 1, "scene": "gas", "every": 1, "trajectory": "a", "parts": [], "settings": {}}'
    )
    assert "run.json must hold measures, settings, status, target; that in " in mpsim_command(command, tmp_path).stderr
