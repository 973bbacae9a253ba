"""A thermostat acts once a frame: `tradeoff` compares with a reference that has such a bath in time."""

import math

import pytest

import mpsim

RATE, E = 1.0, 0.7


def lossy(**features):
    """A gas that collisions cool and a bath heats."""
    bath = mpsim.Thermostat(temperature=1.0, rate=RATE)
    kind = {"boundary": "periodic", "restitution": E, "thermostat": bath} | features
    return mpsim.Scene.random(count=40, packing=0.3, radius=0.5, seed=1, **kind)


@pytest.mark.slow
def test_the_reference_has_a_bath_in_time_and_frames_that_are_too_long_are_seen():
    """In frames of dt, a bath of rate a and losses of rate b leave 1 - f(a dt) f(b dt)/f((a + b) dt) of the energy.

    f(x) = (1 - exp(-x))/x; so that the collision rate, which follows its root, errs by about -a b dt^2/24.
    """
    until, coarse = 32.0, 2.0
    short, steps, long = (mpsim.Settings(dt=dt, method=method) for dt, method in
                          ((0.05, "event"), (0.02, "grid"), (coarse, "event")))  # fmt: skip
    table = mpsim.tradeoff(lossy(), [short, steps, long], until, ["collision_rate"], replicas=16, seconds=30.0)
    assert "a thermostat acts once a frame" in table.reference
    fine, stepped, wrong = (row.errors["collision_rate"] for row in table.rows)
    for error in (fine, stepped):
        assert abs(error.value) < 4 * error.error < 0.05
    assert wrong.resolved, "the control: its bath acts sixteen times in a run"
    decay = RATE * coarse
    assert -decay / 4 < wrong.value < -0.02, "fewer collisions, as the gas cools between the frames of its bath"
    assert math.isfinite(wrong.bound)


@pytest.mark.slow
def test_trajectories_beside_a_bath_are_those_of_the_same_kicks():
    """Errors of short runs fall with the step: a reference whose bath acted at other times would differ at any step."""
    candidates = [mpsim.Settings(dt=dt, method="grid") for dt in (0.05, 0.005)]
    names = ["trajectory", "missed_collisions"]
    table = mpsim.tradeoff(lossy(), candidates, 8.0, names, replicas=2, seconds=30.0)
    coarse, fine = (row.errors["trajectory"].value for row in table.rows)
    assert fine < coarse / 4
    assert fine < 0.02


@pytest.mark.slow
def test_the_default_exact_candidate_is_the_reference_and_tune_names_its_frames():
    exact = mpsim.Settings(method="event")
    found = mpsim.tune(lossy(), {"collision_rate": 0.05}, until=8.0, candidates=[exact], replicas=6, seconds=20.0)
    assert found.exact
    assert f"dt={found.settings.dt:.3g}" in found.reference, "the answer has the frames of the reference"
