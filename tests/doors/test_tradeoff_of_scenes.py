"""Studies of scenes that are no gas in equilibrium: an answer that means something, or a reason in words."""

import csv
import io
import json
import re
from pathlib import Path

import pytest
from support.scenes import gas

import mpsim
from mpsim import Scene, Settings, tradeoff, tune
from mpsim.errors import NotMeasurableError

pytestmark = pytest.mark.compiled

CONTACT_TIME = 0.02
MODEL = Settings(method="event", contact_time=CONTACT_TIME)
FINE, COARSE = (Settings(dt=dt, method="grid") for dt in (0.01, 0.1))
GRAINS = {"radius": 0.5, "restitution": 0.5, "wall_restitution": 0.5, "gravity": (0, -1)}
SCENES = sorted(path.stem for path in (Path(mpsim.__file__).parent / "scene" / "named").glob("*.toml"))
RESTING = {
    "brazil-nut": 0.003,
    "drum": 0.003,
    "galton": 0.004,
    "hopper": 0.003,
    "rough-hopper": 0.003,
    "rough-sediment": 0.02,
    "sediment": 0.007,
}
"""Named scenes whose discs come to rest, with the contact time of docs/accuracy.md."""


def heap() -> Scene:
    """Grains that fall and are at rest from about 5 on."""
    return Scene.random(count=8, packing=0.3, seed=2, duration=6.0, **GRAINS)


def test_the_page_on_accuracy_says_what_each_named_scene_is_compared_with():
    page = (Path(__file__).parents[2] / "docs" / "accuracy.md").read_text()
    for name in SCENES:
        assert (f"| {name} | `contact_time={RESTING.get(name, 0):g}` |" in page) == (name in RESTING), name


# --- the contact-time model as the reference


@pytest.fixture(scope="module")
def table():
    return tradeoff(heap(), [MODEL, FINE, COARSE], replicas=2, contact_time=CONTACT_TIME)


@pytest.mark.long
def test_a_table_against_the_model_says_so_and_never_that_it_is_exact(table):
    assert [row.failure for row in table.rows] == [None] * 3
    words = (
        r"the contact-time model with contact_time=0\.02, which is not exact: .*"
        r"\(the guard acted [\d,]+ times in a run with [\d,]+ collisions\)$"
    )
    assert re.match(words, table.reference)
    assert table.reference in str(table).replace("\n", " ")
    assert table.contact_time == json.loads(table.to_json())["contact_time"] == CONTACT_TIME
    assert [row["contact_time"] for row in csv.DictReader(io.StringIO(table.to_csv()))] == ["0.02", "", ""]
    assert table.rows[0].label == "event contact_time=0.02"
    assert all(error.exact for error in table.rows[0].errors.values()), "from itself it differs by nothing"
    fine, coarse = (row.errors for row in table.rows[1:])
    assert 0 < 2 * fine["overlap"].value < coarse["overlap"].value
    assert fine["pressure"].systematic > 0, "so much does the average change when the contact time is doubled"


@pytest.mark.long
def test_tune_against_the_model_neither_calls_it_exact_nor_verified():
    how = {"replicas": 2, "contact_time": CONTACT_TIME}
    found = tune(heap(), {"overlap": 0.05}, candidates=[MODEL], **how)
    assert (found.exact, found.verified, found.contact_time) == (False, False, CONTACT_TIME)
    assert "0 (the reference itself), budget 0.05 (which is a model, not exact)" in str(found)
    steps = tune(heap(), {"overlap": 0.2}, candidates=[Settings(method="grid")], **how)
    assert steps.verified
    assert 0 < steps.errors["overlap"].value < 0.2


# --- grains that come to rest, emitters, scenes that change


@pytest.mark.long
def test_grains_that_come_to_rest_have_a_stepped_reference_and_all_that_means_something():
    """The exact solver follows each of the countless bounces in which a disc at rest hovers."""
    scene = Scene.random(count=8, packing=0.3, seed=2, **GRAINS)
    assert tradeoff(scene, [FINE], 2.0, "overlap", replicas=2).reference == "the exact solver"
    # all is compiled now: six seconds are those of a preliminary run
    stepped = tradeoff(scene, [FINE, COARSE], until=25.0, replicas=2, seconds=6.0)
    assert re.match("two passes at dt=.*not usable: .* come to rest.*Give contact_time=0.0", stepped.reference)
    assert not {"collision_rate", "missed_collisions"} & set(stepped.measures)
    assert 0 < 2 * stepped.rows[0].errors["trajectory"].value < stepped.rows[1].errors["trajectory"].value
    assert float(re.search(r"dt=([\d.e-]+),", stepped.reference)[1]) <= 0.02, "it resolves a fall"
    with pytest.raises(mpsim.InputError, match=r"'missed_collisions' only without losses under gravity.*Use 'overlap'"):
        tradeoff(scene, [FINE], until=1.0, measures="missed_collisions")
    with pytest.raises(mpsim.InputError, match=r"it may take 1e-05 s\. Give it more time \(seconds="):
        tradeoff(scene, [FINE], until=100.0, replicas=2, measures="pressure", seconds=1e-5)


@pytest.mark.long
def test_a_real_answer_stays_inside_its_budgets_in_a_long_run():
    scene, budgets = gas(20, 0.3), {"overlap": 0.05, "trajectory": 0.2}
    found = tune(scene, budgets, until=5, replicas=2, candidates=[Settings(method="grid", contact="push")])
    assert all(found.errors[name].value <= budget for name, budget in budgets.items())
    with mpsim.Simulation(scene, found.settings) as sim:
        depth = sim.run(until=50, measures=["overlap"]).measures["overlap"]
    assert depth.value / (2 * scene.radius) == pytest.approx(found.errors["overlap"].value, rel=0.1)
    reflect = Settings(law="reflect", contact="push", method="grid")
    with pytest.raises(mpsim.errors.BudgetError, match=r"no candidate stays inside momentum_drift 1e-06\. The best of"):
        tune(scene, {"momentum_drift": 1e-6}, until=2, replicas=2, candidates=[reflect])


# --- named scenes


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", SCENES)
def test_each_named_scene_has_an_answer_or_a_reason(name):
    scene, given = Scene.load(name), RESTING.get(name)
    table = tradeoff(scene, [Settings(method="event", contact_time=given)], measures="overlap", replicas=2,
                     contact_time=given, seconds=600)  # fmt: skip
    assert table.contact_time == given
    measure = "collision_rate" if name in ("piston", "cooling") else "pressure"
    try:
        found = tune(scene, {measure: 0.1}, seconds=40.0)
    except (NotMeasurableError, mpsim.errors.BudgetError, mpsim.InputError) as refused:
        meant = any(remedy in str(refused) for remedy in ("Allow", "Ask for", "Give it more time", "only"))
    else:
        meant = found.exact or (found.verified and found.errors[measure].error > 0)
    assert meant
