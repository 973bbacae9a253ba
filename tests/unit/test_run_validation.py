"""scripts/run_validation.py: its theory against known values, a short row, chi^2 and the page."""

import json
import math
import sys

import numpy as np
import pytest
from support.scripts import fixture_of

from mpsim.measure import Measure, reference

script = fixture_of("run_validation")
rows = fixture_of("validation_rows")
theory = fixture_of("validation_theory")


@pytest.mark.parametrize(
    ("chi2", "degrees", "probability"),
    [(3.841459, 1, 0.05), (5.991465, 2, 0.05), (18.307038, 10, 0.05), (24.995790, 15, 0.05), (15.0, 15, 0.451417)],
)
def test_probabilities_of_chi2_are_those_of_tables(theory, chi2, degrees, probability):
    assert theory.chi2_probability(chi2, degrees) == pytest.approx(probability, abs=1e-6)


def test_collisions_slow_a_disc_at_their_rate_at_first_and_more_slowly_later(theory):
    operator = theory.collision_operator()
    assert operator[0, 0] == pytest.approx(1, rel=1e-12)
    assert operator == pytest.approx(operator.T, abs=1e-12)
    assert np.linalg.eigvalsh(operator).min() > 0
    assert theory.decay(0.0) == pytest.approx(1, rel=1e-12)
    assert theory.decay(0.001) == pytest.approx(math.exp(-0.001), abs=1e-7)
    assert theory.decay(1.0) > math.exp(-1) + 0.004


def test_a_dilute_gas_diffuses_as_collisions_of_random_velocities_say(theory):
    """The operator against 1,600,000 collisions drawn at random: -<v (v - v')> of v and of v (2 - v^2/2)."""
    rng = np.random.default_rng(1)
    v, other = rng.normal(size=(2, 1_600_000, 2))
    along = (v - other)[:, :1]
    after = np.concatenate([other[:, :1], v[:, 1:]], axis=1)
    rate = np.abs(along) / np.abs(along).mean()

    def second(velocity):
        return velocity * (2 - (velocity**2).sum(axis=1, keepdims=True) / 2) / 2

    found = [
        float((rate * f(v) * (g(v) - g(after))).sum(axis=1).mean())
        for f, g in ((lambda u: u / math.sqrt(2), second), (second, second))
    ]
    operator = theory.collision_operator()
    assert found == pytest.approx([operator[0, 1], operator[1, 1]], abs=0.05)
    assert abs(operator[0, 1]) > 0.1


def test_the_bulk_has_the_error_of_its_series(theory):
    for packing in (0.1, 0.3, 0.5, 0.6):
        found = theory.bulk(packing)
        assert found.value == pytest.approx(reference.compressibility(packing), rel=1e-12)
    assert theory.bulk(0.3).error < 1e-6
    assert 1e-4 < theory.bulk(0.5).error < 1e-3


def test_few_discs_meet_as_in_any_gas_but_for_one_over_n(theory):
    assert theory.third_moment(10**6) == pytest.approx(1, abs=1e-6)
    speeds = np.random.default_rng(1).normal(size=(200_000, 6))
    speeds *= math.sqrt(6) / np.linalg.norm(speeds, axis=1, keepdims=True)
    expected = (np.abs(speeds) ** 3).mean() / (2 * math.sqrt(2 / math.pi))
    assert theory.third_moment(6) == pytest.approx(expected, rel=5e-3)
    assert theory.transfer_rate(0.3, 10**6) == pytest.approx(reference.enskog_rate(0.3), rel=1e-5)


def test_an_elastic_gas_does_not_cool(theory):
    assert theory.haff_rate(0.05, 1000, 1.0) == 0
    assert theory.haff_rate(0.05, 10**6, 0.99) == pytest.approx(
        (1 - 0.99**2) / 4 * reference.enskog_rate(0.05), rel=2e-3
    )


def short(rows, collisions=6e5):
    """72 discs at packing 0.65 in a short run, and as if published for another box."""
    found = rows.pressure(72, 0.65, 1.0, collisions)
    yield rows.Row("72 discs", rows.LI, rows.known(*rows.PRESSURES[72, "1 : 1", 0.65]), found)
    yield rows.Row("kT = E/N", rows.LI, rows.known(1.4), found, control=True)


def run(script, monkeypatch, tmp_path, *words):
    out, page = tmp_path / "rows.json", tmp_path / "validation.md"
    words = [*words, "--out", str(out), "--page", str(page)]
    monkeypatch.setattr(sys, "argv", ["run_validation.py", *words])
    assert script.main() == 0
    return json.loads(out.read_text()), page.read_text()


def test_a_short_run_has_the_published_pressure_and_no_other(script, rows, tmp_path, monkeypatch):
    page = tmp_path / "validation.md"
    names = ("summary", "dense", "controls")
    page.write_text("".join(f"<!-- run_validation: {name} -->\n<!-- end -->\n" for name in names))
    monkeypatch.setattr(script, "GROUPS", {"dense": lambda share: short(rows)})
    kept, text = run(script, monkeypatch, tmp_path, "--only", "dense")
    found = script.row_of(kept["dense"]["rows"][0])
    assert found.found.settled
    assert found.found.error < 0.02
    assert abs(found.deviation) < 3.5
    assert abs(found.found.deviation(rows.DENSER[0])) > 4, "another packing must fail"
    assert "| 72 discs | Li 2022 | 6.901074(71) | 6." in text
    assert "for 1 rows;" in text
    assert "Controls that deviate by more than 5: 1 of 1." in text
    assert "minutes of one core" in text


def test_chi2_leaves_out_controls_and_errors_that_are_not_known(script, rows):
    one = rows.known(1.0)
    made = [
        rows.Row("two off", "", one, Measure(1.2, 0.1, 9)),
        rows.Row("three off with both errors", "", Measure(1.0, 0.3, 9), Measure(2.5, 0.4, 9)),
        rows.Row("not settled", "", one, Measure(9.0, 0.1, 9, settled=False)),
        rows.Row("control", "", one, Measure(1.4, 0.1, 9), control=True),
    ]
    words = script.summary(made)
    assert "χ² = 13.0 for 2 rows; probability of a larger one: 0.0015" in words
    assert "largest deviation is 3.0" in words
    assert "errors are not settled: 1." in words
    assert "more than 5: 0 of 1." in words


def test_groups_that_are_not_measured_stay_in_the_file(script, rows, tmp_path, monkeypatch):
    def made(value):
        return lambda share: iter([rows.Row("a", "b", rows.known(value), Measure(value, 0.1, 9))])

    monkeypatch.setattr(script, "GROUPS", {"dense": made(1.0), "two": made(2.0)})
    run(script, monkeypatch, tmp_path)
    monkeypatch.setattr(script, "GROUPS", {"dense": made(3.0), "two": made(4.0)})
    kept, _ = run(script, monkeypatch, tmp_path, "--only", "two")
    assert [kept[name]["rows"][0]["expected"]["value"] for name in ("dense", "two")] == [1.0, 4.0]


@pytest.mark.long
def test_quick_rows_of_all_groups_agree(script, rows):
    for name, group in rows.GROUPS.items():
        for row in group(0.02):
            if row.found.settled and not row.control:
                assert abs(row.deviation) < 4.5, f"{name}: {row.what}"
