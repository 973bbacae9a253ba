"""The stability map: what counts as what, and that the forbidden kinds would be seen."""

import json
import multiprocessing
import os
import signal
import warnings

import numpy as np
import pytest
from support.commands import mpsim_command
from support.processes import wait_until

import mpsim
from mpsim.output import stability_map
from mpsim.studies import stability
from mpsim.studies.stability import Row, Trial, attempt

GRID = Row("grid")


def test_a_small_step_is_correct_and_a_large_one_degraded_and_told():
    good, bad = (attempt(Trial("step", part, GRID)) for part in (0.03, 10))
    assert (good.kind, good.told) == ("correct", ())
    assert (bad.kind, bad.told) == ("degraded", ("FastWarning",))
    assert bad.errors["collisions"] > 0.2
    assert attempt(Trial("step", 10, Row("grid", on_fast="substep"))).kind == "correct"


def test_what_cannot_be_is_refused_with_its_text():
    outcome = attempt(Trial("box", 1e15, GRID))
    assert outcome.kind == "refused"
    assert outcome.text.startswith("InputError: radius must be at least 0.888")


def test_a_wrong_result_without_a_warning_is_silent(monkeypatch):
    monkeypatch.setattr(warnings, "warn", lambda *args, **how: None)
    assert attempt(Trial("step", 10, GRID)).kind == "silent"


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda p, v: (p[1:], v[1:]), "lost"),
        (lambda p, v: (p + 1e3, v), "lost"),
        (lambda p, v: (p * np.nan, v), "not finite"),
        (lambda p, v: (p, v * np.inf), "not finite"),
        (lambda p, v: (p, v * 1.001), "silent"),
    ],
)
def test_what_must_never_be_is_seen(monkeypatch, change, kind):
    ran = stability._run

    def spoiled(*args):
        start, end, collisions = ran(*args)
        return start, mpsim.State(*change(end.position, end.velocity)), collisions

    monkeypatch.setattr(stability, "_run", spoiled)
    assert attempt(Trial("count", 10, GRID)).kind == kind


def test_an_exception_of_another_kind_is_a_crash(monkeypatch):
    monkeypatch.setattr(stability, "_run", lambda *args: 1 / 0)
    outcome = attempt(Trial("count", 10, GRID))
    assert (outcome.kind, outcome.text) == ("crash", "ZeroDivisionError: division by zero")


@pytest.mark.parametrize(("blow", "kind"), [(signal.SIGKILL, "crash"), (signal.SIGSTOP, "hang")])
def test_a_process_that_dies_or_hangs_is_an_outcome(blow, kind):
    attendant = stability._TrialProcess(multiprocessing.get_context("spawn"))
    try:
        os.kill(attendant.process.pid, signal.SIGSTOP)  # so that it cannot be quicker than the blow
        attendant.give(0, Trial("count", 10, GRID))
        os.kill(attendant.process.pid, blow)
        if blow == signal.SIGSTOP:
            assert attendant.result() is None, "its time is not up"
            attendant._end = 0
        assert wait_until(lambda: attendant.result() is not None, 30)
        assert attendant.result().kind == kind
    finally:
        attendant.end()


def test_trials_in_processes_of_their_own_come_back_in_order(tmp_path):
    chosen = [Trial("count", value, row) for value in (0, 2) for row in (GRID, Row("event"))]
    outcomes = stability.run_trials(chosen, workers=1)
    assert [(each.value, each.row) for each in outcomes] == [(t.value, t.row.label) for t in chosen]
    assert stability.counts(outcomes)["correct"] == 4
    assert json.loads(stability.to_json(outcomes))["counts"]["correct"] == 4
    assert "| number of discs | 4 | 4 | 0 | 0 | 0 |" in stability.counts_table(outcomes)


@pytest.mark.parametrize("axis", ["length", "count", "drift"])
def test_further_values_of_the_long_map_stand_in_order(axis):
    values, more = ([trial.value for trial in stability.trials([axis], full=full)] for full in (False, True))
    assert set(values) < set(more)
    assert more == sorted(more)


@pytest.mark.slow
def test_a_trial_of_masses_lasts_until_light_discs_are_fast():
    """Else it would end before anything could go wrong."""
    outcomes = [attempt(Trial("masses", ratio, GRID)) for ratio in (1.0, 1e-9)]
    assert [(each.kind, each.told) for each in outcomes] == [("correct", ()), ("degraded", ("FastWarning",))]
    assert attempt(Trial("masses", 1e-9, Row("grid", on_fast="substep"))).kind == "correct"


def test_an_unknown_axis_is_refused():
    with pytest.raises(
        mpsim.InputError, match=r"axes must be one of 'step', 'packing', .* got 'stepp'. Did you mean 'step'"
    ):
        stability.trials(["stepp"])
    refused = mpsim_command("stability", "--only", "stepp")
    assert refused.exit_code == 2
    assert "Error: --only must be one of 'step', 'packing', " in refused.stderr


def test_outcomes_kept_as_json_are_drawn_again(tmp_path):
    rows = ("event", "grid impact elastic float64")
    step = [
        stability.Outcome("step", value, row, errors={"overlap": 0.3}, worst="overlap")
        for value in range(14)
        for row in rows
    ]
    step[3] = stability.Outcome("step", 1, rows[1], "refused", told=("FastWarning",), text="InputError: too far")
    pairs = [stability.Outcome(stability.MAP, (0.1, 0.3), "event")]
    kept = stability.from_json(stability.to_json([*step, *pairs]))
    assert kept[: len(step)] == step
    assert tuple(kept[-1].value) == (0.1, 0.3)
    assert [path.name for path in stability_map.save(kept, tmp_path)] == ["step.png", "map.png"]


def test_values_of_an_axis_are_divided_among_panels_of_equal_width(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(stability_map, "_finish", lambda figure, path: drawn.append(figure))
    for count in (12, 13, 25):
        outcomes = [stability.Outcome("step", value, "event") for value in range(count)]
        stability_map.save(outcomes, tmp_path)
    assert [len(figure.axes) for figure in drawn] == [1, 2, 3]
    assert [[len(panel.get_xticks()) for panel in figure.axes] for figure in drawn] == [[12], [7, 6], [9, 9, 7]]
    assert all(
        label.get_fontsize() >= 9 for figure in drawn for panel in figure.axes for label in panel.get_yticklabels()
    )
