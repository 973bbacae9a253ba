"""Scenes that are no gas in equilibrium: an answer that means something, or a reason, never a zero that is verified."""

import re
import time

import pytest
from support.scenes import gas

import mpsim
from mpsim import Emitter, Scene, Settings, tune
from mpsim.errors import NotMeasurableError
from mpsim.measure.registry import ERRORS
from mpsim.scene import scenefile
from mpsim.studies import ensemble, preliminary
from mpsim.studies import tune as chooser
from mpsim.studies.preliminary import preliminary_run
from mpsim.studies.replicas import available

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def few_runs(monkeypatch):
    """A quarter of the runs that `tune` makes for so short ones; no test here is about noise."""
    monkeypatch.setattr(chooser, "MOST_REPLICAS", 16)


GRAINS = {"radius": 0.5, "restitution": 0.5, "wall_restitution": 0.5, "gravity": (0, -1)}


def falling(count=6) -> Scene:
    """Grains at rest high above the floor, with room between them."""
    return Scene(
        width=9, height=20, position=[[1 + 1.4 * k, 15] for k in range(count)], velocity=[[0, 0]] * count, **GRAINS
    )


def test_a_time_in_which_nothing_is_hit_is_no_pressure():
    """As before: all runs give 0, and so does the reference."""
    with pytest.raises(
        NotMeasurableError, match=r"pressure is 0 in all 32 runs of the reference.*longer runs \(until="
    ):
        tune(falling(), {"pressure": 0.01}, until=1.0)


def test_grains_with_losses_that_come_to_rest_have_a_stepped_reference_and_others_the_exact_one(soon_too_slow):
    """The exact solver follows each of the countless bounces in which a disc at rest hovers."""
    for until, reference in ((25.0, "two passes at dt=.*not usable: .* come to rest.*Give contact_time=0.0"),
                             (3.0, "the exact solver$")):  # fmt: skip
        table = mpsim.tradeoff(falling(), [Settings(dt=0.05)], until=until, replicas=2, measures="speed_distribution")
        assert re.match(reference, table.reference), (until, table.reference)
        assert table.contact_time is None


@pytest.fixture
def soon_too_slow(monkeypatch):
    """The exact solver is called too slow after a third of a second, which no test waits ten times as long for."""
    monkeypatch.setattr(preliminary, "EXACT_SECONDS", 0.3)


def test_grains_that_come_to_rest_have_a_trade_of_all_that_means_something_there(soon_too_slow):
    """Trajectories can be compared there; collisions cannot be counted where discs are in contact all the time."""
    scene = Scene.random(count=12, packing=0.3, seed=2, **GRAINS)
    fine, coarse = (Settings(dt=dt, method="grid") for dt in (0.02, 0.2))
    table = mpsim.tradeoff(scene, [fine, coarse], until=6.0, replicas=2)
    assert [row.failure for row in table.rows] == [None, None]
    assert table.measures == tuple(name for name in ERRORS if name not in ("collision_rate", "missed_collisions"))
    errors = [row.errors["trajectory"].value for row in table.rows]
    assert 0 < 2 * errors[0] < errors[1], "the control: a longer step is further off"
    with pytest.raises(mpsim.InputError, match=r"'missed_collisions' only without losses under gravity.*Use 'overlap'"):
        mpsim.tradeoff(scene, [fine], until=1.0, measures="missed_collisions")
    found = tune(scene, {"trajectory": 0.5}, until=6.0, candidates=[fine], replicas=2)
    assert 0 < found.errors["trajectory"].value < 0.5


def test_a_run_of_the_reference_that_takes_far_too_long_is_given_up_with_a_reason(monkeypatch):
    """Of an unusual start the exact solver may never come to an end."""
    scene = Scene.random(count=20, packing=0.3, radius=0.5, duration=7.0)
    settings = [Settings(method="grid")]
    for name in ("TIME_LIMIT_FACTOR", "LEAST_TIME_LIMIT"):
        monkeypatch.setattr(ensemble, name, 0.0)
    with pytest.raises(NotMeasurableError, match=r"reference failed, RunTooLong: .*its start is unusual.*shorter runs"):
        tune(scene, {"overlap": 0.1}, candidates=settings, replicas=4)
    monkeypatch.undo()
    assert tune(scene, {"overlap": 0.1}, candidates=settings, replicas=4).verified, "the control"


def test_a_scene_whose_runs_are_all_one_run_has_no_spread_to_verify_with():
    """In Newton's cradle the same number of pushes is handed to the walls wherever the discs start exactly."""
    with pytest.raises(NotMeasurableError, match=r"is the same in all 32 runs of the reference.*other starts"):
        tune(Scene.load("cradle"), {"pressure": 0.01})


def test_a_scene_that_changes_and_has_no_duration_asks_for_one():
    with pytest.raises(NotMeasurableError, match=r"still changes with time .*until=..., or Scene\(duration=...\)"):
        tune(
            Scene.random(count=40, packing=0.2, radius=0.5, restitution=0.8),
            {"collision_rate": 0.1},
            candidates=[Settings(method="event")],
        )


def test_the_duration_of_the_scene_is_how_long_runs_are():
    scene = Scene.random(count=20, packing=0.3, radius=0.5, duration=7.0)
    found = tune(scene, {"overlap": 0.1}, candidates=[Settings(method="grid")], replicas=4)
    assert found.until == 7
    assert "averages over other starts of the same kind, runs of 7" in str(found)
    assert tune(scene, {"overlap": 0.1}, until=5.0, candidates=[Settings(method="grid")], replicas=4).until == 5


def test_a_cooling_gas_is_compared_in_windows():
    scene = Scene.random(count=20, packing=0.3, radius=0.5, restitution=0.85, duration=20.0)
    found = tune(scene, {"collision_rate": 0.2}, candidates=[Settings(method="grid")], replicas=4)
    error = found.errors["collision_rate"]
    assert error.largest is not None
    assert found.verified
    assert error.error > 0
    assert "mean over windows, 0 to 20" in str(found)


def test_emitters_that_count_frames_are_refused_and_those_that_count_time_are_not():
    place = {"width": 12, "height": 12, "position": [], "velocity": [], "radius": 0.5}
    frames = Scene(**place, emitters=Emitter((2, 2), (3, 2), every=5))
    with pytest.raises(mpsim.InputError, match=r"emitters\[0\] counts frames \(every=5\).*Use Emitter\(interval="):
        tune(frames, {"pressure": 0.1}, until=5)
    scene = Scene(**place, emitters=Emitter((2, 2), (3, 2), interval=0.8, limit=30), duration=20.0)
    found = tune(scene, {"pressure": 0.3}, candidates=[Settings(method="grid")], replicas=4)
    assert found.verified
    assert found.errors["pressure"].error > 0


def test_settings_of_which_mpsim_warns_are_not_recommended_where_others_meet_the_budget():
    """Long steps meet the budget too, but discs may pass through each other: the answer has a shorter one."""
    scene = Scene.random(count=20, packing=0.1, radius=0.5, duration=30.0, seed=1)
    found = tune(scene, {"overlap": 0.45}, candidates=[Settings(method="grid", contact="push")], replicas=4)
    assert found.warning == ""
    assert found.errors["overlap"].inside(0.45)
    warned = [each for each in found.tried if each.warning]
    assert warned, "the control: there are such steps"
    assert all("inside all budgets, but mpsim warns: in frame 0 disc" in each.verdict for each in warned)
    assert "method='event' has no such limit" in warned[0].warning, "in the words of the warning"
    assert warned[0].verdict in str(found)
    with mpsim.Simulation(scene, found.settings) as sim:  # where a warning is an error
        sim.run(until=30)
    with pytest.warns(mpsim.FastWarning), mpsim.Simulation(scene, warned[0].row.settings) as sim:
        sim.run(until=1)
    careful = [Settings(method="grid", contact="push", on_fast="substep")]
    assert not any(each.warning for each in tune(scene, {"overlap": 0.45}, candidates=careful, replicas=4).tried)


@pytest.mark.parametrize("measure", ["overlap", "speed_distribution"])
def test_where_nobody_meets_no_error_is_measurable(measure):
    with pytest.raises(NotMeasurableError, match=f"{measure} is not measurable here: .*Ask for"):
        tune(falling(), {measure: 0.01}, until=0.5, candidates=[Settings(method="grid")])


@pytest.mark.long
@pytest.mark.parametrize("name", scenefile.names())
def test_each_named_scene_gets_an_answer_or_a_reason_in_about_the_time_it_may_take(name):
    """docs/accuracy.md has the times with the default of 150 s; a machine that does other things needs longer."""
    scene = Scene.load(name)
    measure = next(each for each in ("pressure", "collision_rate") if each in available(scene))
    started = time.monotonic()
    try:
        found = tune(scene, {measure: 0.1}, seconds=40.0)
    except (NotMeasurableError, mpsim.errors.BudgetError, mpsim.InputError) as refused:
        meant = any(remedy in str(refused) for remedy in ("Allow", "Ask for", "Give it more time"))
    else:
        meant = found.exact or (found.verified and found.errors[measure].error > 0)
    assert meant
    assert time.monotonic() - started < 120


@pytest.mark.parametrize("measure", ["energy_drift", "overlap", "trajectory"])
def test_where_nothing_has_happened_yet_nothing_is_verified(measure):
    """As before: dt=0.46 for a run of 0.01, verified."""
    scene = Scene.random(count=20, packing=1e-4, radius=0.5, seed=2)
    with pytest.raises(NotMeasurableError, match=f"{measure} is not measurable here: no collisions occurred in"):
        tune(scene, {measure: 1e-3}, until=0.01, candidates=[Settings(method="grid")], replicas=4)


def test_no_step_is_longer_than_a_piece_of_a_run():
    found = tune(gas(20, 0.3), {"overlap": 0.5}, until=2.0, candidates=[Settings(method="grid")], replicas=4)
    assert max(each.row.settings.dt for each in found.tried) <= 2.0 / 16


def test_the_reference_of_grains_at_rest_resolves_a_fall(soon_too_slow):
    """As before: its step was 1.8, by the speeds of a settled heap."""
    heap = Scene(width=3, height=9, position=[[0.5, 0.5], [1.5, 0.5], [2.5, 0.5]], velocity=[[0, 0]] * 3, **GRAINS)
    reference = preliminary_run(heap, 3.0).reference
    assert reference.method != "event"
    assert reference.dt <= 0.02


def test_more_time_can_be_given_for_a_table_too():
    scene = Scene(width=9, height=9, position=[[4, 4], [6, 4]], velocity=[[1, 0], [0, 1]], **GRAINS)
    with pytest.raises(mpsim.InputError, match=r"it may take 1e-05 s\. Give it more time \(seconds="):
        mpsim.tradeoff(scene, [Settings(dt=0.05)], until=100.0, replicas=2, measures="pressure", seconds=1e-5)
    with pytest.raises(mpsim.InputError, match="seconds must be a finite number > 0"):
        mpsim.tradeoff(scene, [Settings(dt=0.05)], until=1.0, seconds=0)
