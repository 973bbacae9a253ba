"""`mpsim bench`, `mpsim warmup`, `mpsim completion`."""

import json

import pytest
from support.commands import mpsim_command

import mpsim
from mpsim.studies import benchmark


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
