"""Contact `push` takes energy from a disc that bounces under gravity: it is said, and the trade's table shows it."""

import warnings

import numpy as np
import pytest

import mpsim

pytestmark = pytest.mark.plain

DROP, G = 8.0, 10.0


def ball(**features):
    """One disc that falls on the floor, without losses."""
    return mpsim.Scene(width=10, height=10, position=[[5, 0.5 + DROP]], velocity=[[0, 0]], radius=0.5,
                       gravity=(0, -G), **features)  # fmt: skip


def energy_of(settings, until, scene):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.FastWarning)
        with mpsim.Simulation(scene, settings) as sim:
            sim.run(until=until)
            return mpsim.measure.kinetic_energy(sim.state, scene) + mpsim.measure.potential_energy(sim.state, scene)


@pytest.mark.parametrize("dt", [0.02, 0.002])
def test_the_warning_names_the_contact_gravity_and_what_to_do(dt):
    text = r"contact='push' takes 0\.\d+ of its energy or more .* under gravity .* Use contact='impact'"
    with pytest.warns(mpsim.FastWarning, match=text):
        mpsim.Simulation(ball(), mpsim.Settings(dt=dt, contact="push", method="naive")).close()


@pytest.mark.parametrize(
    ("settings", "features"),
    [
        ({"contact": "impact", "dt": 0.02}, {}),
        ({"contact": "push", "dt": 0.0005}, {}),
        ({"contact": "push", "dt": 0.02, "substeps": 40}, {}),
        ({"contact": "push", "dt": 0.02}, {"wall_restitution": 0.5}),
        ({"contact": "push", "dt": 0.02}, {"boundary": "periodic"}),
    ],
)
def test_nothing_is_said_where_little_or_nothing_is_lost(settings, features):
    mpsim.Simulation(ball(**features), mpsim.Settings(method="naive", **settings)).close()  # warnings are errors


def test_a_bounce_takes_g_dt_over_v_on_average():
    """So that the energy falls by g^2 dt / 4 per time, whatever the height; by impact it stays."""
    dt, until, lost = 0.01, 12.0, []
    for height in np.linspace(5.0, 9.0, 6):
        scene = mpsim.Scene(width=10, height=10, position=[[5, height]], velocity=[[0, 0]], radius=0.5, gravity=(0, -G))
        before = energy_of(mpsim.Settings(dt=dt, contact="push", method="naive"), 0.0, scene)
        lost.append(before - energy_of(mpsim.Settings(dt=dt, contact="push", method="naive"), until, scene))
    assert np.mean(lost) == pytest.approx(G**2 * dt / 4 * until, rel=0.3)
    kept = energy_of(mpsim.Settings(dt=dt, method="naive"), until, ball())
    assert kept == pytest.approx(energy_of(mpsim.Settings(dt=dt, method="naive"), 0.0, ball()), rel=1e-9)


@pytest.mark.slow
def test_the_table_of_a_trade_shows_it():
    dt = 0.02
    scene = mpsim.Scene.random(count=6, width=10, height=10, radius=0.5, seed=1, gravity=(0, -G))
    pair = [mpsim.Settings(dt=dt, contact=contact, method="naive") for contact in ("push", "impact")]
    table = mpsim.tradeoff(scene, pair, 5.0, ["energy_drift"], replicas=6)
    push, impact = (row.errors["energy_drift"] for row in table.rows)
    assert push.resolved
    assert push.value < -1e-3
    assert abs(impact.value) < abs(push.value) / 20
