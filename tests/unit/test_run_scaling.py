"""scripts/run_scaling.py: shares as the solver deals them, the model against what it is made from, and its table."""

import os
import sys

import numpy as np
import pytest
from support.scenes import gas
from support.scripts import fixture_of

import mpsim

script = fixture_of("run_scaling")


def test_the_largest_share_is_that_of_the_solver(script):
    with mpsim.Simulation(gas(3000, 0.4), mpsim.Settings(method="parallel", workers=2)) as sim:
        sim.run(frames=5)
        columns = sim.columns()
        most = np.bincount(columns.owner).max() * 2 / 3000
        assert script.largest_share(columns.of_disc, 2) == most > 1
        assert script.largest_share(columns.of_disc, 1) == 1


def test_columns_that_cannot_be_divided_are_one_share(script):
    assert script.largest_share(np.zeros(100, np.int64), 4) == 4
    assert script.largest_share(np.repeat(np.arange(8), 10), 4) == 1


@pytest.fixture
def timings(script):
    """Of 1,000 discs: 10 µs alone, 6 µs on two workers, of which 1 µs is waiting."""
    column = np.repeat(np.arange(100), 10)
    return [script.Timing(1000, *each, column) for each in ((1, 10e-6, 0.0), (2, 6e-6, 1e-6))]


def test_the_model_is_work_plus_waiting_for_two_workers(script, timings):
    model = script.Model.of(*timings, barriers=0.4e-6, line=0.0)
    assert model.seconds(1000, 1, 1.0) == pytest.approx(10e-6)
    assert model.seconds(1000, 2, 1.0) == pytest.approx(5e-6 + 1e-6)
    assert model.seconds(1000, 2, 1.2) == pytest.approx(6e-6 + 1e-6), "the one with the most discs"


def test_the_model_takes_barriers_longer_and_spreads_smaller_for_more_workers(script, timings):
    only_barriers = script.Model.of(*timings, barriers=2e-6, line=0.0)
    assert only_barriers.spread == 0, "all waiting is that of barriers"
    assert only_barriers.seconds(1000, 8, 1.0) == pytest.approx(10e-6 / 8 + 4 * 2e-6)
    only_spread = script.Model.of(*timings, barriers=0.0, line=0.0)
    assert only_spread.seconds(1000, 8, 1.0) == pytest.approx(10e-6 / 8 + 1e-6 * (1.424 / 0.564) / 2)


def test_the_model_fetches_a_column_for_each_border(script, timings):
    """Columns of 10 discs of 20 bytes each are 3.125 lines: one border with two workers, two with more."""
    model, free = (script.Model.of(*timings, barriers=0.0, line=line) for line in (1e-6, 0.0))
    beyond = [model.seconds(1000, workers, 1.0) - free.seconds(1000, workers, 1.0) for workers in (1, 2, 4, 16)]
    assert beyond == pytest.approx([0.0, 3.125e-6, 6.25e-6, 6.25e-6])


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="a line goes from one core to another")
def test_a_line_of_another_core_takes_longer_than_an_own_one(script):
    """By the lower quartile of tries, as other programs make some longer. The control: an own line twice."""
    one, another = sorted(os.sched_getaffinity(0))[:2]
    tries = [[script.seconds_of_a_line(one, core) for core in (one, one, another)] for _ in range(12)]
    own, again, others = np.quantile(tries, 0.25, axis=0)
    assert 1.4 * max(own, again) < others < 1e-6, tries


def test_the_table_has_a_row_for_each_number_of_workers_measured_or_not(script, tmp_path, monkeypatch, capsys):
    page = tmp_path / "scaling.md"
    monkeypatch.setattr(script, "EACH", 500)
    monkeypatch.setattr(script, "TURNS", 2)
    monkeypatch.setattr(script, "TURN", 5000)
    monkeypatch.setattr(script, "usable_cores", lambda: 2)
    monkeypatch.setattr(sys, "argv", ["run_scaling.py", "--discs", "600", "--workers", "8", "--page", str(page)])
    assert script.main() == 0
    assert capsys.readouterr().out
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.read_text().splitlines() if "|" in line]
    found = {(row[0], row[1]): row for row in rows if row[0].replace(",", "").isdecimal()}
    assert list(found) == [("600", "1"), ("600", "2"), ("600", "4"), ("600", "8"), ("500", "1"), ("1,000", "2")]
    assert all(len(row) == 9 for row in rows)
    measured = {key for key, row in found.items() if row[2]}
    assert measured == set(found) - {("600", "4"), ("600", "8")}, "there are two cores"
    assert all(row[7] for key, row in found.items() if key[0] == "600")
    assert found["600", "1"][3] == "1.00"


@pytest.mark.parametrize("words", [["--discs", "3"], ["--discs", "0"], ["--workers", "3"]])
def test_what_cannot_be_measured_is_wrong_usage(script, words, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["run_scaling.py", *words])
    with pytest.raises(SystemExit) as ended:
        script.main()
    assert ended.value.code == 2
    assert words[0] in capsys.readouterr().err
