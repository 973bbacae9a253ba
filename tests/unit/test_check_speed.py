"""When scripts/check_speed.py fails: on a loss that three turns confirm, never on a slow turn, and it always tells."""

import contextlib
import re
import shutil
from pathlib import Path

import pytest
from support.script_server import PACKAGE_PARENT
from support.scripts import fixture_of

TOP = Path(__file__).parents[2]


script = fixture_of("check_speed")


def decide(script, **ratios):
    """Losses, lines, and scenes of each turn, where scenes have these ratios turn by turn, and the others none."""
    names = dict(zip(("grid", "workers", "friction"), script.SCENES, strict=True))
    of = {names[short]: turns for short, turns in ratios.items()}
    lines, timed = [], []

    def time_turn(turn, asked):
        timed.append(list(asked))
        return {name: 10.0 * of.get(name, [1.0] * 3)[turn] for name in asked}, dict.fromkeys(asked, 10.0)

    return script.confirmed_losses(time_turn, lines.append), lines, timed


def test_no_loss_is_one_turn_that_tells_every_ratio(script):
    losses, lines, timed = decide(script, grid=[1.29], friction=[0.5])
    assert losses == []
    assert timed == [list(script.SCENES)]
    assert lines[0] == "turn 1: bare, grid: 12.90 ns per disc and frame, 1.29 of 10.00"
    assert [line.split(" frame, ")[1][:4] for line in lines] == ["1.29", "1.00", "0.50"]


def test_a_loss_in_three_turns_is_one(script):
    losses, lines, timed = decide(script, workers=[1.3, 2.0, 1.31])
    assert losses == ["bare, 2 workers"]
    assert timed[1:] == [["bare, 2 workers"]] * 2, "the others need no more turns"
    assert len(lines) == len(script.SCENES) + 2


@pytest.mark.parametrize("ratios", [[3.0, 1.0], [1.4, 1.4, 1.29]])
def test_a_slow_turn_is_none(script, ratios):
    losses, lines, _ = decide(script, friction=ratios)
    assert losses == []
    assert len(lines) == len(script.SCENES) + len(ratios) - 1


def test_losses_of_several_scenes_are_all_told(script, monkeypatch):
    found = decide(script, grid=[2.0] * 3, friction=[2.0] * 3)[0]
    assert found == ["bare, grid", "friction and gravity"]
    lines = []
    monkeypatch.setattr(script, "compare", lambda here, there, say: found)
    monkeypatch.setattr(script.feature_cost, "checkout_of", lambda revision: contextlib.nullcontext(TOP))
    assert script.check(TOP, "HEAD~1", lines.append) == 1
    assert lines == [f"{name}: slower by 1.3 or more than HEAD~1 in 3 turns out of 3." for name in found]
    monkeypatch.setattr(script, "compare", lambda here, there, say: [])
    assert script.check(TOP, "HEAD~1", lines.append) == 0


def test_a_revision_that_is_not_there_passes_and_is_told(script):
    lines = []
    assert script.check(TOP, "no-such-revision", lines.append) == 0
    assert len(lines) == 1
    assert lines[0].startswith("nothing to compare with: --before must be a git revision of this checkout; got 'no-suc")


def test_a_version_that_cannot_run_the_scenes_passes_and_is_told(script, monkeypatch, tmp_path):
    lines = []
    monkeypatch.setattr(script, "timer_of", lambda names: "import os; assert os.path.exists('pyproject.toml'), 'old'")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(script.feature_cost, "checkout_of", lambda revision: contextlib.nullcontext(tmp_path))
        assert script.check(TOP, "v0", lines.append) == 0
        assert lines == ["nothing to compare with: v0 cannot run these scenes: AssertionError: old"]
        patch.setattr(script.feature_cost, "checkout_of", lambda revision: contextlib.nullcontext(TOP))
        with pytest.raises(RuntimeError, match="old"):  # it is this version that cannot
            script.check(tmp_path, "v0", lines.append)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_version_that_was_slowed_on_purpose_fails(script, tmp_path, monkeypatch):
    """Contacts are looked for four times as often. One scene, as each has kernels of its own to compile."""
    shutil.copytree(PACKAGE_PARENT / "mpsim", tmp_path / "mpsim", ignore=shutil.ignore_patterns("__pycache__"))
    file = tmp_path / "mpsim" / "kernels" / "frame" / "stepping.py"
    slowed, changes = re.subn(r"for _ in range\(control\.passes", "for _ in range(4 * control.passes", file.read_text())
    assert changes == 1
    file.write_text(slowed)
    monkeypatch.setattr(script, "SCENES", {"bare, grid": script.SCENES["bare, grid"]})
    lines = []
    assert script.compare(tmp_path, PACKAGE_PARENT, lines.append) == ["bare, grid"], lines
    assert script.compare(PACKAGE_PARENT, PACKAGE_PARENT, lines.append) == [], "the same version has lost nothing"
