"""`mpsim tune` and `mpsim tradeoff`: what they ask of the library, print and write."""

import json
import sys

import pandas
import pytest
from support.commands import mpsim_command

import mpsim
from mpsim.cli import trade
from mpsim.measure.registry import ERRORS
from mpsim.studies.cost import Cost
from mpsim.studies.deviations import Deviation
from mpsim.studies.tradeoff import Row, Tradeoff
from mpsim.studies.tuned import Trial, Tuned

SETTINGS = mpsim.Settings(dt=0.05, contact="push")
ROW = Row(SETTINGS, Cost(10.0, 9.0, 11.0, 100.0, "grid", 1), {"pressure": Deviation(0.004, float("inf"))})


@pytest.fixture
def asked(monkeypatch) -> dict:
    """What the library was asked for by the commands, in place of hours of work."""
    calls: dict = {}

    def tune(scene, budgets, **options):
        calls.update(scene=scene, budgets=budgets, **options)
        if options["progress"]:
            options["progress"](1, 2, "accuracy")
        if budgets.get("overlap", 1) < 1e-9:
            raise mpsim.errors.BudgetError("max_error must be within reach: ...")
        return Tuned(SETTINGS, ROW.cost, ROW.errors, {"pressure": 0.01}, "event", (Trial(ROW, "inside", True),), 1.5)

    def tradeoff(scene, candidates, until, measures, **options):
        calls.update(scene=scene, candidates=candidates, until=until, measures=measures, **options)
        return Tradeoff("a scene", "event", 5.0, 1.0, ("pressure",), (ROW,))

    monkeypatch.setattr(trade.tuning, "tune", tune)
    monkeypatch.setattr(trade.tradeoffs, "tradeoff", tradeoff)
    return calls


# --- tune


def test_budgets_are_options_for_every_measure(asked):
    options = [word for name in ERRORS for word in (f"--{name.replace('_', '-')}", "5%")]
    result = mpsim_command("tune", "cradle", *options, "--until", "12.5", "--replicas", "3", "--quiet")
    assert result.exit_code == 0
    assert asked["budgets"] == dict.fromkeys(ERRORS, 0.05)
    assert (asked["until"], asked["replicas"], asked["progress"]) == (12.5, 3, None)
    assert asked["scene"].digest() == mpsim.Scene.load("cradle").digest()


@pytest.mark.parametrize(
    ("text", "value"), [("1%", 0.01), ("7%", 0.07), ("0.05", 0.05), (" 2.5 %", 0.025), ("1e-3", 0.001)]
)
def test_a_budget_may_be_per_cent(asked, text, value):
    assert mpsim_command("tune", "cradle", "--pressure", text).exit_code == 0
    assert asked["budgets"] == {"pressure": value}


def test_tune_prints_the_answer_and_how_to_use_it(asked):
    result = mpsim_command("tune", "cradle", "--pressure", "1%")
    run, python = result.stdout.splitlines()[-2:]
    assert run == "to run it: mpsim run cradle --dt=0.05 --contact=push"
    assert python == "in Python: Settings(dt=0.05, contact='push')"
    assert result.stdout.startswith("auto push dt=0.05: 10 ns per disc and unit of time (grid)\n")


def test_tune_as_json(asked):
    found = json.loads(mpsim_command("tune", "cradle", "--pressure", "1%", "--json").stdout)
    assert found["settings"]["dt"] == 0.05
    error = found["errors"]["pressure"]
    assert (error["value"], error["error"]) == (0.004, None)  # infinite, which JSON lacks
    assert found["tried"][0]["verdict"] == "inside"


def test_budgets_out_of_reach_are_exit_code_1(asked):
    result = mpsim_command("tune", "cradle", "--overlap", "1e-12")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == "Error: max_error must be within reach: ...\n"


@pytest.mark.parametrize(("command", "most"), [("tune", 64), ("tradeoff", 100_000)])
def test_the_range_of_replicas_is_that_of_the_command(asked, command, most):
    options = ["cradle", *(["--pressure", "1%"] if command == "tune" else [])]
    assert f"2<=x<={most}]" in "".join(mpsim_command(command, "--help").stdout.split())
    refused = mpsim_command(command, *options, "--replicas", most + 1)
    assert f"'{most + 1}' must be a whole number from 2 to {most}." in refused.stderr
    assert (refused.exit_code, asked) == (2, {})
    assert mpsim_command(command, *options, "--replicas", most).exit_code == 0


# --- tradeoff


def test_tradeoff_prints_a_table_csv_or_json(asked):
    table = mpsim_command("tradeoff", "cradle")
    assert "auto push dt=0.05" in table.stdout
    assert asked["measures"] is None
    assert mpsim_command("tradeoff", "cradle", "--csv").stdout.startswith("method,contact,law,")
    assert json.loads(mpsim_command("tradeoff", "cradle", "--json").stdout)["reference"] == "event"
    mpsim_command(
        "tradeoff", "cradle", "--measure", "overlap", "--measure", "pressure", "--keep", "kept", "--until", "3"
    )
    assert (asked["measures"], str(asked["path"]), asked["until"]) == (("overlap", "pressure"), "kept", 3.0)


def test_tradeoff_writes_a_file_as_its_name_says(asked, tmp_path):
    result = mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "a.csv"))
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr == f"1 candidate written to {tmp_path}/a.csv\n"
    assert (tmp_path / "a.csv").read_text().startswith("method,contact,law,")
    mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "a.json"))
    assert json.loads((tmp_path / "a.json").read_text())["reference"] == "event"
    mpsim_command("tradeoff", "cradle", "--json", "--out", str(tmp_path / "a.txt"))
    assert (tmp_path / "a.txt").read_text().startswith("{")


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("t.xlsx", [], "--out must end in one of .csv, .json, .parquet, .txt; got '{}'. Use t.csv.\n"),
        ("t", [], "--out must end in one of .csv, .json, .parquet, .txt; got '{}'. Use t.csv.\n"),
        ("t.parquet", ["--json"], "--out must end in one of .json, .txt with --json; got '{}'. Use t.json.\n"),
        ("t.json", ["--csv"], "--out must end in one of .csv, .txt with --csv; got '{}'. Use t.csv.\n"),
    ],
)
def test_a_file_that_ends_as_no_table_does_is_refused_before_the_work(asked, tmp_path, name, options, said):
    result = mpsim_command("tradeoff", "cradle", *options, "--out", tmp_path / name)
    assert said.format(tmp_path / name) in result.stderr
    assert (result.exit_code, asked) == (2, {})


def test_a_table_that_is_there_is_not_overwritten_unasked(asked, tmp_path):
    (tmp_path / "a.csv").write_text("weeks of work")
    result = mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "a.csv"))
    assert result.exit_code == 2
    assert f"'{tmp_path}/a.csv' exists already, and is not overwritten. Give another name, or --force." in result.stderr
    assert ((tmp_path / "a.csv").read_text(), asked) == ("weeks of work", {})
    assert mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "a.csv"), "--force").exit_code == 0
    assert (tmp_path / "a.csv").read_text().startswith("method,")


def test_the_ending_chooses_parquet_and_what_it_lacks_is_told_before_the_work(asked, tmp_path, monkeypatch):
    result = mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "a.parquet"))
    assert result.exit_code == 0, result.stderr
    assert list(pandas.read_parquet(tmp_path / "a.parquet").columns)[:2] == ["method", "contact"]
    asked.clear()
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    result = mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "b.parquet"))
    assert "a Parquet file needs the package pyarrow, which cannot be imported" in result.stderr
    assert (result.exit_code, asked) == (1, {})


def test_a_file_that_cannot_be_written_is_refused_before_the_work(asked, tmp_path):
    result = mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "none" / "a.csv"))
    assert result.exit_code == 1
    assert result.stderr == (
        f"Error: --out must be a file that can be written; got '{tmp_path}/none/a.csv' (No such file or directory). "
        "Choose another place.\n"
    )
    assert not asked
    mpsim_command("tradeoff", "nonsense", "--out", str(tmp_path / "b.csv"))
    assert not (tmp_path / "b.csv").exists()


@pytest.mark.long
def test_tune_and_tradeoff_do_what_they_say(tmp_path):
    path = tmp_path / "small.toml"
    mpsim.Scene.random(count=20, packing=0.2, radius=0.5).save(path)
    short = ["--until", "5", "--replicas", "2", "--quiet"]
    tuned = mpsim_command("tune", str(path), "--overlap", "0.2", "--json", *short)
    assert json.loads(tuned.stdout)["errors"]["overlap"]["value"] <= 0.2
    table = mpsim_command("tradeoff", str(path), "--measure", "overlap", "--json", *short)
    assert len(json.loads(table.stdout)["rows"]) > 5
