"""The table of a trade, for people and for programs, and what no other row of it beats."""

import csv
import html
import io
import json
import math
import re

import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mpsim
from mpsim import Settings
from mpsim.measure import Measure
from mpsim.measure.registry import ERRORS
from mpsim.output import tables
from mpsim.output.tables import measure_text
from mpsim.studies.cost import Cost
from mpsim.studies.deviations import Deviation
from mpsim.studies.tradeoff import Row, Tradeoff


@pytest.mark.parametrize(
    ("measure", "text"),
    [
        (Measure(2.239912, 0.016, 500), "2.240(16)"),
        (Measure(100 + 3e-14, 2.8e-14, 500), "100(0)"),
        (Measure(12345.678, 210.0, 500), "12346(210)"),
        (
            Measure(2.24, 0.016, 500, settled=False),
            "2.240(>16) (error at least 0.016, not settled: run longer or start later)",
        ),
        (
            Measure(0.0, 0.018, 500, settled=False, upper=True),
            "0(<0.018) (error at most 0.018, not settled: run longer or start later)",
        ),
        (Measure(0.3, math.nan, 500, settled=False), "0.3 (error unknown)"),
        (Measure(0.3, math.nan, 3, settled=False), "0.3 (too few samples for an error)"),
    ],
)
def test_an_error_in_words(measure, text):
    assert measure_text("pressure", measure) == text


@pytest.mark.parametrize(
    ("name", "samples", "why"),
    [
        ("energy_drift", 1, "one number per run, without an error"),
        ("momentum_drift", 1, "one number per run, without an error"),
        ("largest_overlap", 5000, "one number per run, without an error"),
        ("overlap", 0, "no overlaps"),
        ("overlap", 7, "too few samples for an error"),
        ("overlap", 5000, "error unknown"),
    ],
)
def test_why_a_measure_has_no_error(name, samples, why):
    assert measure_text(name, Measure(0.0, math.nan, samples, settled=False)) == f"0 ({why})"


COARSE, FINE = Settings(dt=0.1, method="grid"), Settings(dt=0.02, method="grid")
PUSH = Settings(dt=0.05, method="grid", contact="push")
REFLECT = Settings(dt=0.05, method="grid", contact="push", law="reflect")
CHEAP, DEAR = Cost(12345.6, 12300, 12400, 210, "grid", 1), Cost(1.523, 1.5, 1.54, 210, "grid", 1)


def made(rows, scene="<Scene>", measures=("pressure", "overlap")):
    return Tradeoff(scene, "the exact solver", 2.0, 0.5, measures, tuple(rows))


def plain(settings, price, **errors):
    return Row(settings, price, {name: Deviation(*pair) for name, pair in errors.items()})


ROWS = [
    plain(COARSE, CHEAP, pressure=(0.0192, 0.0006), overlap=(0.05, 0.001)),
    plain(FINE, DEAR, pressure=(0.0004, 0.0006), overlap=(0.0, 0.0)),
    Row(PUSH, failure="DivergedError: [/red] a|b <b>bold</b>, and so on"),
]


def test_csv_and_json_can_be_read_back():
    found = made([*ROWS, plain(REFLECT, DEAR, pressure=(float("inf"), float("nan")), overlap=(0.1, 0.01))])
    lines = list(csv.DictReader(io.StringIO(found.to_csv())))
    assert [float(line["dt"]) for line in lines] == [0.1, 0.02, 0.05, 0.05]
    assert lines[0] | {"pressure": "0.0192", "pressure_error": "0.0006", "pressure_resolved": "True"} == lines[0]
    assert lines[1]["pressure_resolved"] == "False"
    assert (lines[2]["cost"], lines[2]["failure"]) == ("", ROWS[2].failure)
    values = json.loads(found.to_json(), parse_constant=pytest.fail)
    assert [row["cost"] for row in values["rows"]] == [12345.6, 1.523, None, 1.523]
    assert values["rows"][3]["pressure"] is None
    assert values["reference"] == "the exact solver"


def test_parquet_holds_the_columns_of_csv(tmp_path):
    table = made([*ROWS, plain(REFLECT, DEAR, pressure=(float("inf"), float("nan")), overlap=(0.1, 0.01))])
    table.to_parquet(tmp_path / "table.parquet")
    found = pandas.read_parquet(tmp_path / "table.parquet")
    assert tuple(found.columns) == table.columns
    assert found["cost"].tolist()[:2] == [12345.6, 1.523]
    assert found["pressure"].tolist()[:2] == [0.0192, 0.0004]
    assert found["failure"].isna().tolist() == [True, True, False, True]
    for name in ("csv", "json", "parquet"):
        with pytest.raises(mpsim.errors.OutputError, match="the table of a trade-off study must be a file that"):
            getattr(table, f"to_{name}")(tmp_path / "none" / f"table.{name}")


def test_an_error_that_is_not_measurable_is_in_every_form_with_its_reason():
    reason = "all <runs> are one run"
    found = made([Row(COARSE, CHEAP, {"pressure": Deviation.unknown(reason), "overlap": Deviation(0.05, 0.001)})])
    (line,) = csv.DictReader(io.StringIO(found.to_csv()))
    assert (line["pressure"], line["pressure_reason"], line["overlap_reason"]) == ("nan", reason, "")
    (row,) = json.loads(found.to_json(), parse_constant=pytest.fail)["rows"]
    assert (row["pressure"], row["pressure_reason"], row["overlap_reason"]) == (None, reason, "")
    assert f"n/m, pressure: {reason}" in str(found)
    assert "n/m, pressure: all &lt;runs&gt; are one run" in found._repr_html_()


def test_a_difference_below_its_noise_is_not_resolved_in_every_form():
    text = str(made(ROWS))
    assert "1.920(60)" in text
    assert "< 0.16" in text
    assert "0.04" not in text, "a figure that is not resolved is not shown as one"
    assert "<: not resolved" in " ".join(text.split())
    assert "&lt; 0.16" in made(ROWS)._repr_html_()
    assert tables.error_text("pressure", Deviation(0.0, 0.01)) == "< 2", "nothing seen is not nothing"
    assert tables.error_text("pressure", Deviation(0.0, 0.0)) == "0"
    assert tables.error_text("trajectory", Deviation(1.54254, 5e-7)) == "1.54254000(50)", "a small error is not none"


def test_the_title_says_what_is_not_resolved_and_what_few_runs_need():
    """The number is the rule itself: so many standard errors are resolved, and fewer are not."""
    many, two = Deviation(0.04, 0.01, freedom=15), Deviation(0.02, 0.001, freedom=1)
    found = made([Row(COARSE, CHEAP, {"pressure": many, "overlap": two})])
    assert "n/m: not measurable" in tables.title(found)
    for text in (tables.title(found), found._repr_html_()):
        assert re.search(r"not resolved, below 3 standard errors, or \d+ with so few runs", html.unescape(text))
    needed = int(re.search(r"or (\d+) with so few runs", tables.title(found))[1])
    assert not Deviation(needed * 0.00099, 0.001, freedom=1).resolved
    assert Deviation(needed * 0.00101, 0.001, freedom=1).resolved
    enough = made([Row(COARSE, CHEAP, {"pressure": many, "overlap": Deviation.unknown("nothing moves")})])
    assert "below 3 standard errors; n/m" in tables.title(enough)


def test_units_and_reasons_with_brackets_are_text_not_markup():
    text, page = str(made(ROWS)), made(ROWS, scene="<script>")._repr_html_()
    for words in ("[diam.]", "[%]", "[/red] a|b <b>bold</b>", "(disc"):
        assert words in " ".join(text.split()), words
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert "<b>" not in page
    assert page.count("<tr>") == 4
    assert r"a\|b" in tables.markdown_table(made(ROWS))


@pytest.mark.parametrize("width", [60, 80, 120, 400])
def test_no_line_is_wider_than_the_terminal_and_nothing_is_lost(width, monkeypatch):
    errors = dict.fromkeys(ERRORS, (0.01, 0.001))
    found = made([plain(COARSE, CHEAP, **errors), ROWS[2]], measures=ERRORS)
    monkeypatch.setenv("COLUMNS", str(width))
    lines = str(found).splitlines()
    assert max(map(len, lines)) <= width
    for name in ERRORS:
        assert all(word in str(found) for word in name.split("_")), name
    assert sum("1.00(10)" in line for line in lines) >= 1
    assert "…" not in str(found)


def test_a_terminal_of_one_column_is_no_reason_to_fail(monkeypatch):
    monkeypatch.setenv("COLUMNS", "1")
    assert "1.920(60)" in str(made(ROWS))


# What nothing beats

points = st.lists(st.tuples(st.integers(1, 6), st.integers(-6, 6).filter(bool)), min_size=1, max_size=12)


@given(points)
def test_the_front_is_what_no_other_row_beats(values):
    rows = [
        plain(COARSE, Cost(price, price, price, 1, "grid", 1), pressure=(error, 0.0), overlap=(0.0, 0.0))
        for price, error in values
    ]
    front = [(row.cost.median, abs(row.errors["pressure"].value)) for row in made(rows).frontier("pressure")]
    sizes = {(price, abs(error)) for price, error in values}
    beaten = {
        (price, error)
        for price, error in sizes
        if any(p <= price and e <= error and (p, e) != (price, error) for p, e in sizes)
    }
    assert front == sorted(sizes - beaten)


def test_noise_does_not_choose_the_front_and_an_unknown_measure_is_refused():
    prices = [Cost(price, price, price, 1, "grid", 1) for price in (1.0, 2.0, 3.0)]
    pairs = [(0.002, 0.001), (-0.0001, 0.001), (0.004, 0.0001)]
    rows = [plain(COARSE, price, pressure=pair, overlap=(0, 0)) for price, pair in zip(prices, pairs, strict=True)]
    assert made(rows).frontier("pressure") == rows[:1], "the second is smaller by chance alone"
    with pytest.raises(mpsim.InputError, match="Did you mean 'pressure'"):
        made(rows).frontier("presure")
