"""The contact-time model as the reference where discs come to rest: by choice, said everywhere, never called exact."""

import csv
import io
import json
import re
from pathlib import Path

import pytest
from support.scenes import gas
from support.selection import long_but

import mpsim
from mpsim import Scene, Settings, tradeoff, tune
from mpsim.scene import scenefile
from mpsim.studies import preliminary
from mpsim.studies.preliminary import preliminary_run

pytestmark = pytest.mark.slow

CONTACT_TIME = 0.02
FINE, COARSE = (Settings(dt=dt, method="grid", passes=2) for dt in (0.01, 0.1))
MODEL = Settings(method="event", contact_time=CONTACT_TIME)


def heap(**features) -> Scene:
    """Grains that fall and are at rest from about 5 on."""
    how = {"restitution": 0.5, "wall_restitution": 0.5, "gravity": (0, -1)} | features
    return Scene.random(count=12, packing=0.3, radius=0.5, seed=2, duration=8.0, **how)


@pytest.fixture(scope="module")
def table():
    return tradeoff(heap(), [MODEL, FINE, COARSE], replicas=2, contact_time=CONTACT_TIME)


def test_a_table_against_the_model_says_so_and_never_that_it_is_exact(table):
    assert [row.failure for row in table.rows] == [None] * 3
    assert table.contact_time == CONTACT_TIME
    first, last = (
        "the contact-time model with contact_time=0.02, which is not exact: ",
        r"\(the guard acted [\d,]+ times",
    )
    assert re.match(first + ".*" + last + r" in a run with [\d,]+ collisions\)$", table.reference)
    assert table.reference in str(table).replace("\n", " ")
    assert json.loads(table.to_json())["contact_time"] == CONTACT_TIME


def test_where_a_contact_time_was_used_the_table_has_it(table):
    rows = list(csv.DictReader(io.StringIO(table.to_csv())))
    assert [row["contact_time"] for row in rows] == ["0.02", "", ""], "steps have none"
    assert table.rows[0].label == "event contact_time=0.02"
    lossless = tradeoff(gas(20, 0.3), [Settings(method="event", contact_time=0.5)], until=2.0, replicas=2)
    assert lossless.rows[0].record()["contact_time"] is None, "of a gas in which nothing needs it"
    usual = tradeoff(heap(), [Settings(method="event")], until=1.0, replicas=2, measures="overlap")
    assert 0 < usual.rows[0].record()["contact_time"] < 1e-5, "the usual one is a contact time too"


def test_the_uncertainty_of_the_model_is_part_of_each_error(table):
    """As of a stepped reference: so much do averages change when the contact time is doubled."""
    steps = [row.errors["pressure"] for row in table.rows[1:]]
    assert all(error.systematic > 0 for error in steps)
    exact = tradeoff(gas(20, 0.3), [FINE], until=4.0, replicas=2, measures="pressure")
    assert exact.rows[0].errors["pressure"].systematic == 0, "the control: the exact solver has none"


def test_a_longer_step_is_further_from_the_model(table):
    fine, coarse = (row.errors["overlap"].value for row in table.rows[1:])
    assert 0 < 2 * fine < coarse
    assert all(error.exact for error in table.rows[0].errors.values()), "from itself it differs by nothing"


def test_tune_against_the_model_neither_calls_it_exact_nor_verified():
    found = tune(heap(), {"overlap": 0.05}, candidates=[MODEL], replicas=2, contact_time=CONTACT_TIME)
    assert (found.exact, found.verified, found.contact_time) == (False, False, CONTACT_TIME)
    assert "0 (the reference itself), budget 0.05 (which is a model, not exact)" in str(found)
    control = tune(gas(20, 0.3), {"overlap": 0.05}, 4.0, [Settings(method="event")], replicas=2)
    assert (control.exact, control.verified, control.contact_time) == (True, False, None)


def test_tune_verifies_steps_by_runs_against_the_model():
    found = tune(heap(), {"overlap": 0.2}, candidates=[Settings(method="grid")], replicas=2, contact_time=CONTACT_TIME)
    assert found.verified
    assert 0 < found.errors["overlap"].value < 0.2


def test_a_budget_far_below_the_uncertainty_of_the_model_is_refused_with_what_helps():
    words = (
        r"reference with contact_time=0.5 is itself uncertain by .*when contact_time is doubled. Allow a larger error, "
        "give a shorter contact_time"
    )
    with pytest.raises(mpsim.errors.NotMeasurableError, match=words):
        tune(heap(), {"pressure": 1e-6}, candidates=[FINE], replicas=16, contact_time=0.5)
    with pytest.raises(mpsim.InputError, match="contact_time must be at most 1 here: the uncertainty"):
        tune(heap(), {"pressure": 1e-6}, candidates=[FINE], replicas=8, contact_time=1.01)


def test_a_scene_that_needs_no_guard_has_the_exact_reference_whatever_the_contact_time():
    found = tradeoff(gas(20, 0.3), [Settings(method="event"), FINE], 2.0, "overlap", replicas=2, contact_time=0.5)
    assert (found.reference, found.contact_time) == ("the exact solver", None)
    assert found.rows[0].errors["overlap"].exact


def test_a_contact_time_too_short_names_one_that_is_not(monkeypatch):
    monkeypatch.setattr(preliminary, "BOUNCES", 1e9)
    refused = pytest.raises(
        mpsim.InputError, match=r"contact_time must be so long that .* reaches the end of a run; with 1e-09 "
    )
    with refused as caught:
        preliminary_run(heap(), 8.0, seconds=10.0, contact_time=1e-9)
    longer = re.search(r"such as ([^,]+),", str(caught.value))
    assert longer is not None
    found = preliminary_run(heap(), 8.0, seconds=10.0, contact_time=float(longer[1]))
    assert found.contact_time == float(longer[1]), "the control: as was said"


def test_more_discs_for_longer_are_given_a_longer_contact_time():
    few, many = (preliminary._longer_contact_time(heap(), until, 10.0) for until in (8.0, 8e6))
    assert few < many / 50


@pytest.mark.parametrize(
    ("scene", "contact_time", "text"),
    [
        (
            gas(20, 0.3, acceleration=((0.0, -1.0),) * 20),
            0.01,
            "not usable: .*acceleration per disc.* Or leave contact_",
        ),
        (gas(20, 0.3), 0.0, r"contact_time must be a finite number > 0 \[time\]; got 0"),
        (gas(20, 0.3), "long", "contact_time must be"),
    ],
    ids=["acceleration", "zero", "text"],
)
def test_a_contact_time_that_cannot_be_is_refused_by_name(scene, contact_time, text):
    with pytest.raises(mpsim.InputError, match=text):
        tradeoff(scene, [FINE], until=1.0, replicas=2, contact_time=contact_time)


def test_runs_of_another_contact_time_are_not_mixed(tmp_path):
    how = {"until": 2.0, "replicas": 2, "measures": "overlap", "path": tmp_path / "kept"}
    first = tradeoff(heap(), [FINE], contact_time=CONTACT_TIME, **how)
    again = tradeoff(heap(), [FINE], contact_time=CONTACT_TIME, **how)
    assert again.rows[0].record() == first.rows[0].record()
    for other in (2 * CONTACT_TIME, None):
        with pytest.raises(mpsim.InputError, match="path must be a file of the same scene"):
            tradeoff(heap(), [FINE], contact_time=other, **how)


# --- named scenes

RESTING = {"galton": 0.004, "hopper": 0.003, "rough-hopper": 0.003, "rough-sediment": 0.02, "sediment": 0.007}
"""Those whose discs come to rest, with the contact time that docs/accuracy.md names."""


def test_the_page_on_accuracy_says_what_each_named_scene_is_compared_with():
    page = (Path(__file__).parents[3] / "docs" / "accuracy.md").read_text()
    for name in scenefile.names():
        given = f"`contact_time={RESTING[name]:g}`" if name in RESTING else "the exact solver"
        assert f"| {name} | {given} |" in page, name


@pytest.mark.parametrize("name", long_but(["channel", "piston", "hopper"], "piston"))
def test_a_named_scene_is_compared_with_the_exact_solver(name):
    """A part of its duration, before grains come to rest. As before: losses under gravity were compared with steps."""
    assert preliminary_run(Scene.load(name), 0.5).reference_name.startswith("the exact solver")


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", scenefile.names())
def test_each_named_scene_has_that_reference_for_its_whole_duration(name):
    scene, given = Scene.load(name), RESTING.get(name)
    found = preliminary_run(scene, scene.duration, contact_time=given)
    assert (found.exact, found.contact_time) == (given is None, given)
    if given is not None:
        without = preliminary_run(scene, scene.duration)
        assert "come to rest, and collide without end. Give contact_time=" in without.reference_name, "the control"
