"""Tables for people and for programs: of a report, as text, in pandas and in a notebook, and of a trade-off."""

import csv
import dataclasses
import io
import json
import math
import re

import numpy as np
import pytest
from support.campaign import COARSE, FINE, PIECES, PUSH, REFLECT, SCENE, Costs, MadeUp
from support.scenes import gas, simulate

import mpsim
from mpsim.measure import Measure

pytestmark = pytest.mark.compiled  # the exact solver, for seconds


# --- the measures of a report


@pytest.fixture(scope="module")
def report():
    with simulate(gas(20, 0.2), method="grid") as sim:
        return sim.run(frames=10, measures=["temperature"])


@pytest.mark.parametrize(
    ("name", "measure", "text"),
    [
        ("pressure", Measure(2.239912, 0.016, 500), "2.240(16)"),
        ("pressure", Measure(100 + 3e-14, 2.8e-14, 500), "100(0)"),
        (
            "pressure",
            Measure(2.24, 0.016, 500, settled=False),
            "2.240(&gt;16) (error at least 0.016, not settled: run longer or start later)",
        ),
        (
            "pressure",
            Measure(0.0, 0.018, 500, settled=False, upper=True),
            "0(&lt;0.018) (error at most 0.018, not settled: run longer or start later)",
        ),
        ("pressure", Measure(0.3, math.nan, 3, settled=False), "0.3 (too few samples for an error)"),
        ("largest_overlap", Measure(0.0, math.nan, 5000, settled=False), "0 (one number per run, without an error)"),
        ("overlap", Measure(0.0, math.nan, 0, settled=False), "0 (no overlaps)"),
        ("overlap", Measure(0.0, math.nan, 7, settled=False), "0 (too few samples for an error)"),
    ],
)
def test_an_error_in_words(report, name, measure, text):
    assert f"<th>{name}</th><td>{text}</td>" in dataclasses.replace(report, measures={name: measure})._repr_html_()


def test_a_report_in_a_notebook_is_a_small_table(report):
    text = report._repr_html_()
    assert text.startswith("<table>")
    for word in (
        "<th>method</th><td>grid, 1 worker</td>",
        "<td>median ",
        "even columns ",
        "<th>temperature</th><td>1 ",
    ):
        assert word in text
    assert "compiling" not in dataclasses.replace(report, compile_seconds=0.0)._repr_html_()
    cold = dataclasses.replace(report, compile_seconds=6.25)
    assert "<th>compiling before</th><td>6.2 s</td>" in cold._repr_html_()
    assert len(text) < 2000
    with simulate(gas(20, 0.2), method="event") as sim:
        assert "<th>frames</th><td>0</td>" in sim.run(frames=0)._repr_html_()
        assert "columns" not in sim.run(frames=2)._repr_html_()


@pytest.mark.parametrize("workers", [1, 2])
def test_times_as_csv_are_those_of_the_report(workers, tmp_path):
    with simulate(gas(200, 0.4), method="parallel", workers=workers) as sim:
        report = sim.run(frames=3)
    text = report.to_csv(tmp_path / "times.csv", first_frame=11)
    assert (tmp_path / "times.csv").read_text() == text
    rows = list(csv.DictReader(text.splitlines()))
    assert [row["frame"] for row in rows] == ["11", "12", "13"]
    assert [float(row["seconds"]) for row in rows] == report.frame_seconds.tolist()
    for name, seconds in report.phase_seconds.items():
        for worker in range(workers):
            assert [float(row[f"{name.replace(' ', '_')}_{worker}"]) for row in rows] == seconds[:, worker].tolist()


def test_places_that_cannot_be_written_are_refused(report, tmp_path):
    with pytest.raises(mpsim.InputError, match=r"a table of times must .*Use 'times\.csv'\."):
        report.to_csv(tmp_path / "times.parquet")
    with pytest.raises(mpsim.errors.OutputError, match="a table of times must be a file that can be written; got "):
        report.to_csv(tmp_path / "none" / "times.csv")


# --- the table of a trade-off


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A table of made-up runs."""

    def law(settings, number):
        return {"pressure": np.full(PIECES, 1.0 + settings.dt + 0.001 * number), "overlap": np.full(PIECES, 0.01)}

    folder = tmp_path_factory.mktemp("study")
    costs = Costs(folder)
    path = costs.write(folder / "study.json", [COARSE], lambda settings: 10.0)
    options = {"measures": ["pressure", "overlap"], "replicas": 2, **costs.how}
    return mpsim.tradeoff(SCENE, COARSE, executor=MadeUp(law), path=path, **options)


@pytest.fixture(scope="module")
def made(study):
    """Tables like the study, with other rows."""
    (like,) = study.rows
    deviation = type(like.errors["pressure"])

    def row(settings, price=None, failure=None, **errors):
        if failure is not None:
            return type(like)(settings, failure=failure)
        found = {name: each if isinstance(each, deviation) else deviation(*each) for name, each in errors.items()}
        return dataclasses.replace(like, settings=settings, cost=price or like.cost, errors=found)

    def table(rows, **others):
        return dataclasses.replace(study, rows=tuple(rows), **others)

    table.row, table.deviation, table.price = row, deviation, lambda ns: dataclasses.replace(
        like.cost, median=ns, low=ns, high=ns
    )  # fmt: skip
    return table


@pytest.fixture(scope="module")
def rows(made):
    return [
        made.row(COARSE, made.price(12345.6), pressure=(0.0192, 0.0006), overlap=(0.05, 0.001)),
        made.row(FINE, made.price(1.523), pressure=(0.0004, 0.0006), overlap=(0.0, 0.0)),
        made.row(PUSH, failure="DivergedError: [/red] a|b <b>bold</b>, and so on"),
    ]


def test_csv_and_json_hold_the_same(made, rows):
    found = made([*rows, made.row(REFLECT, made.price(1.523), pressure=(math.inf, math.nan), overlap=(0.1, 0.01))])
    lines = list(csv.DictReader(io.StringIO(found.to_csv())))
    assert [float(line["dt"]) for line in lines] == [0.1, 0.02, 0.05, 0.05]
    assert lines[0] | {"pressure": "0.0192", "pressure_error": "0.0006", "pressure_resolved": "True"} == lines[0]
    assert lines[1]["pressure_resolved"] == "False"
    assert (lines[2]["cost"], lines[2]["failure"]) == ("", rows[2].failure)
    values = json.loads(found.to_json(), parse_constant=pytest.fail)
    assert [row["cost"] for row in values["rows"]] == [12345.6, 1.523, None, 1.523]
    assert values["rows"][3]["pressure"] is None


def test_an_error_that_is_not_measurable_is_in_every_form_with_its_reason(made):
    reason = "all <runs> are one run"
    found = made([made.row(COARSE, pressure=made.deviation.unknown(reason), overlap=(0.05, 0.001))])
    (line,) = csv.DictReader(io.StringIO(found.to_csv()))
    assert (line["pressure"], line["pressure_reason"], line["overlap_reason"]) == ("nan", reason, "")
    (row,) = json.loads(found.to_json(), parse_constant=pytest.fail)["rows"]
    assert (row["pressure"], row["pressure_reason"], row["overlap_reason"]) == (None, reason, "")
    assert f"n/m, pressure: {reason}" in str(found)


def test_a_difference_below_its_noise_is_not_resolved_in_every_form(made, rows):
    text = str(made(rows))
    assert "1.920(60)" in text
    assert "< 0.16" in text
    assert "0.04" not in text, "a figure that is not resolved is not shown as one"
    assert "<: not resolved" in " ".join(text.split())
    seen = str(made([made.row(COARSE, pressure=(0.0, 0.01), overlap=(0.0, 0.0))]))
    assert "< 2" in seen, "nothing seen is not nothing"


def test_the_title_says_what_is_not_resolved_and_what_few_runs_need(made):
    """The number is the rule itself: so many standard errors are resolved, and fewer are not."""
    many, two = made.deviation(0.04, 0.01, freedom=15), made.deviation(0.02, 0.001, freedom=1)
    words = " ".join(str(made([made.row(COARSE, pressure=many, overlap=two)])).split())
    needed = int(re.search(r"not resolved, below 3 standard errors, or (\d+) with so few runs", words)[1])
    assert not made.deviation(needed * 0.00099, 0.001, freedom=1).resolved
    assert made.deviation(needed * 0.00101, 0.001, freedom=1).resolved
    enough = made([made.row(COARSE, pressure=many, overlap=made.deviation.unknown("nothing moves"))])
    assert "below 3 standard errors; n/m" in " ".join(str(enough).split())


def test_units_and_reasons_with_brackets_are_text_not_markup(made, rows):
    text = str(made(rows))
    for words in ("[diam.]", "[%]", "[/red] a|b <b>bold</b>", "(disc"):
        assert words in " ".join(text.split()), words


@pytest.mark.parametrize("width", [1, 60, 400])
def test_no_line_is_wider_than_the_terminal_and_nothing_is_lost(made, rows, width, monkeypatch):
    names = ("pressure", "collision_rate", "energy_drift", "momentum_drift", "overlap", "largest_overlap",
             "speed_distribution", "trajectory", "missed_collisions")  # fmt: skip
    found = made([made.row(COARSE, **dict.fromkeys(names, (0.01, 0.001))), rows[2]], measures=names)
    monkeypatch.setenv("COLUMNS", str(width))
    lines = str(found).splitlines()
    assert width == 1 or max(map(len, lines)) <= width
    assert all(word in str(found) for name in names for word in name.split("_"))
    assert any("1.00(10)" in line for line in lines)
    assert "…" not in str(found)


def test_the_frontier_is_what_no_other_row_beats_and_noise_does_not_choose_it(made):
    rng = np.random.default_rng(1)
    for _ in range(40):
        sizes = {(int(p), int(e)) for p, e in rng.integers(1, 7, (rng.integers(1, 13), 2))}
        found = made(
            made.row(COARSE, made.price(p), pressure=(e * rng.choice([-1, 1]), 0.0), overlap=(0.0, 0.0))
            for p, e in sizes
        ).frontier("pressure")
        beaten = {(p, e) for p, e in sizes if any(a <= p and b <= e and (a, b) != (p, e) for a, b in sizes)}
        assert [(row.cost.median, abs(row.errors["pressure"].value)) for row in found] == sorted(sizes - beaten)
    pairs = [(0.002, 0.001), (-0.0001, 0.001), (0.004, 0.0001)]
    noisy = [made.row(COARSE, made.price(k + 1.0), pressure=pair, overlap=(0, 0)) for k, pair in enumerate(pairs)]
    assert made(noisy).frontier("pressure") == noisy[:1], "the second is smaller by chance alone"
