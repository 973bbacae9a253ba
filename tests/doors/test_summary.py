"""The summary of `mpsim run`: one line says where the time went, and its parts add up."""

import re

import pytest
from support.commands import mpsim_command


@pytest.mark.parametrize("out", [False, True])
def test_the_times_add_up(out, tmp_path):
    folder = ("--out", tmp_path / "run") if out else ()
    text = mpsim_command("run", "gas", "--frames", 30, "--quiet", *folder).stdout
    assert text.count("compiling") <= 1
    (times,) = re.findall(r"discs; ([\d.]+) s: (.+)\n", text)
    parts = {name: float(seconds) for name, seconds in re.findall(r"(\w+) ([\d.]+)", times[1])}
    assert ("writing" in parts) is out
    assert {"simulating"} <= parts.keys() <= {"compiling", "simulating", "writing", "other"}
    rounding = 0.0004 + sum(0.05 if each >= 1 else 0.05 * each for each in (float(times[0]), *parts.values()))
    assert sum(parts.values()) == pytest.approx(float(times[0]), abs=rounding)
