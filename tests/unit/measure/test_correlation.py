"""Pair correlation: ideal gases, all pairs, contact values, boxes with walls, pistons and periodic borders."""

import math

import numpy as np
import pytest
from support.scenes import gas, simulate
from support.states import drop, state_of

import mpsim
from mpsim import InputError, Scene
from mpsim.core.state import State
from mpsim.measure import correlation, pairs, reference


def test_a_periodic_ideal_gas_has_no_correlation_and_every_disc_is_a_reference():
    rng = np.random.default_rng(6)
    scene = Scene(width=20, height=20, position=[[1, 1]], velocity=[[0, 0]], radius=0.01, boundary="periodic")
    states = [State(rng.uniform(0, 20, (500, 2)), np.zeros((500, 2))) for _ in range(20)]
    found = correlation.pair_correlation(states, scene, bins=20, r_max=10.0)
    assert found.references == 20 * 500
    assert found.density == pytest.approx(500 / 400)
    away = (found.value - 1 * (499 / 500)) / found.error
    assert np.abs(away).max() < 4
    assert np.abs(away).mean() < 1.2
    # Negative control: taking the box for closed leaves out all pairs across its borders.
    blind = Scene(width=20, height=20, position=[[1, 1]], velocity=[[0, 0]], radius=0.01)
    assert correlation.pair_correlation(states, blind, bins=20, r_max=4.0).references < 5000


def test_an_ideal_gas_has_no_correlation():
    scene = drop(800, 20.0, seed=1)
    states = [state_of(drop(800, 20.0, seed=seed)) for seed in range(20)]
    found = correlation.pair_correlation(states, scene, bins=60, r_max=4.0)
    assert found.density == pytest.approx(800 / 19.0**2, rel=0.03)
    pull = (found.value - 1) / found.error
    assert np.abs(pull).max() < 4
    assert abs(found.contact.deviation(1.0)) < 3


def test_negative_control_counting_without_care_for_the_walls_is_low():
    state = state_of(drop(3000, 20.0, seed=2))
    distance = np.concatenate([d for _, _, d in pairs.close_pairs(state.position, 4.0)])
    edges = np.linspace(1, 4, 21)
    naive = 2 * np.histogram(distance, edges)[0] / (3000 * 3000 / 19.0**2 * math.pi * np.diff(edges**2))
    assert naive[-1] < 0.9


def test_pair_correlation_agrees_with_all_pairs():
    scene = drop(200, 12.0, seed=5)
    found = correlation.pair_correlation(state_of(scene), scene, bins=8, r_max=3.0)
    edges, counts, references = np.linspace(1, 3, 9), np.zeros(8), 0
    for i, place in enumerate(scene.position):
        if ((place >= 3.5) & (place <= 8.5)).all():
            references += 1
            distance = np.hypot(*(np.delete(scene.position, i, axis=0) - place).T)
            counts += np.histogram(distance, edges)[0]
    density = references / 25.0
    assert found.references == references
    assert found.value == pytest.approx(counts / (references * density * math.pi * np.diff(edges**2)), rel=1e-12)


def test_the_contact_value_of_a_dense_gas_is_that_of_the_equation_of_state():
    scenes = [Scene.random(count=600, packing=0.5, radius=0.5, seed=seed) for seed in range(20)]
    found = correlation.pair_correlation([state_of(scene) for scene in scenes], scenes[0], bins=60, r_max=3.0)
    expected = reference.contact_value(found.density * math.pi / 4)
    assert found.contact.error < 0.05 * expected
    assert abs(found.contact.deviation(expected)) < 3, (found.contact, expected)
    assert found.contact.value > 5 * found.contact.error + 2.5  # negative control: not that of packing 0.4, 2.3
    short = found.value[found.r < 1.4].mean()
    assert short < 0.8 * expected  # nor can the mean near contact stand for the value at contact


def test_too_few_shells_near_contact_give_no_contact_value():
    scene = drop(400, 15.0, seed=6)
    found = correlation.pair_correlation(state_of(scene), scene, bins=6, r_max=4.0)
    assert math.isnan(found.contact.value)


def test_pair_correlation_behind_a_piston_that_has_arrived_is_that_of_the_smaller_box():
    """Half the box is closed off: the density was taken to be half of what it is, so g came out near 2."""
    half = gas(600, 0.3, seed=2)
    side = half.width
    scene = mpsim.Scene(
        width=2 * side,
        height=side,
        position=half.position,
        velocity=half.velocity,
        radius=0.5,
        piston=mpsim.Piston("right", -1.0, side, start=side),
    )
    with simulate(scene, method="naive", contact="impact") as sim:
        states = [sim.state for _ in range(8) if sim.run(until=sim.time + 0.5)]
    found = correlation.pair_correlation(states, scene, bins=40, r_max=5.0)
    plain = correlation.pair_correlation([State(s.position, s.velocity) for s in states], half, bins=40, r_max=5.0)
    assert found.density == plain.density
    assert found.value.tolist() == plain.value.tolist()
    assert found.value[-10:].mean() == pytest.approx(1, abs=0.03)
    wide = mpsim.Scene(width=2 * side, height=side, position=half.position, velocity=half.velocity, radius=0.5)
    before = correlation.pair_correlation([State(s.position, s.velocity) for s in states], wide, bins=40, r_max=5.0)
    assert before.value[-10:].mean() > 1.5, "the control: the whole box, as it was"


def test_pair_correlation_is_refused_where_density_is_not_uniform():
    plain = gas(200, 0.2)
    parts = {name: getattr(plain, name) for name in ("width", "height", "position", "velocity", "radius")}
    state = State(plain.position, plain.velocity)
    emitter = mpsim.Emitter(position=(plain.width / 2, plain.width / 2), velocity=(1, 0), interval=1.0)
    for features, words in (
        ({"gravity": (0, -1)}, "has gravity"),
        ({"acceleration": np.ones((200, 2))}, "has acceleration"),
        ({"emitters": emitter}, "has emitters"),
        ({"piston": mpsim.Piston("left", 1, plain.width / 2)}, "needs a box at rest; got a piston on its way"),
    ):
        with pytest.raises(InputError, match=words):
            correlation.pair_correlation(state, mpsim.Scene(**parts, **features), 10, 3.0)
    scene = mpsim.Scene(**parts, absorbing="left")
    assert correlation.pair_correlation(state, scene, 10, 3.0).references > 0, "nobody has left yet"
    gone = State(plain.position, plain.velocity, present=np.arange(200) > 0)
    with pytest.raises(InputError, match=r"discs have left through an absorbing edge \(1 absent in 2 states\)"):
        correlation.pair_correlation([state, gone], scene, 10, 3.0)
    still = mpsim.Scene(**parts, gravity=(0, 0))
    assert correlation.pair_correlation(state, still, 10, 3.0).references > 0, "no pull, no gradient"
