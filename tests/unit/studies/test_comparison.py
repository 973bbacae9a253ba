"""Runs of one scene side by side, and the balances of energy and momentum along one run."""

import dataclasses
import math

import numpy as np
import pytest
from support.scenes import gas, simulate
from support.selection import long_but

import mpsim
from mpsim import Scene, Settings
from mpsim.studies.comparison import divergence, short_run, typical_speed

pytestmark = pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # errors of long steps are what is measured
BALANCES = ["energy_drift", "momentum_drift"]


def lone(velocity, **features):
    """One disc of radius 0.5 in a box of 10 x 10."""
    return Scene(width=10, height=10, position=[[5, 5]], velocity=[velocity], radius=0.5, **features)


def drifts(scene, frames, **settings):
    """energy_drift and momentum_drift of a run."""
    with simulate(scene, **settings) as sim:
        measures = sim.run(frames=frames, measures=BALANCES).measures
    return measures["energy_drift"].value, measures["momentum_drift"].value


# How fast runs part


def test_the_exponent_of_a_gas_is_that_of_the_literature():
    """Dellago, Posch & Hoover (1996) and the docstring of `predictability`: 2.9 at packing 0.3, over several starts."""
    rates = [divergence(gas(256, 0.3, seed)).rate.value for seed in range(4)]
    assert np.mean(rates) == pytest.approx(2.9, rel=0.15)
    assert divergence(gas(256, 0.1)).rate.value < 0.6 * np.mean(rates), "a thinner gas should part more slowly"


def test_the_same_seed_gives_the_same_exponent_and_another_seed_another():
    scene = gas(64, 0.3)
    assert divergence(scene, seed=3) == divergence(scene, seed=3)
    assert divergence(scene, seed=3).rate.value != divergence(scene, seed=4).rate.value


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (lone([1, 0.3]), "straight flight"),
        (gas(20, 0.2, acceleration=((0.0, 0.0),) * 20), "acceleration per disc"),
    ],
)
def test_runs_that_do_not_part_or_cannot_be_exact_are_refused_by_name(scene, words):
    with pytest.raises(mpsim.InputError, match=words):
        divergence(scene)


def test_the_typical_speed_counts_what_gravity_adds_over_a_diameter():
    assert typical_speed(lone([3, 4])) == 5
    assert typical_speed(lone([0, 0], gravity=(0, -8))) == pytest.approx(4)  # v^2 = 2 g D
    assert typical_speed(lone([0, 0], acceleration=[[6, 8]])) == pytest.approx(math.sqrt(20))
    assert typical_speed(Scene(width=2, height=2, position=[], velocity=[], radius=0.5)) == 0


# Short runs


def test_a_short_run_finds_the_error_of_a_head_on_collision():
    """Two discs meet in the middle of a frame; push separates the overlap and keeps speeds: off by what it cannot know.

    Discs at 4 and 6 with speeds 1 and -1 touch at t = 0.5. One frame of 0.8 overlaps by 0.6 at x = 4.8 and 5.2; push
    moves both apart to 4.5 and 5.5. Exactly they are at 4.2 and 5.8: off by 0.3 each. Impact is exact here.
    """
    scene = Scene(width=10, height=10, position=[[4, 5], [6, 5]], velocity=[[1, 0], [-1, 0]], radius=0.5)
    push, impact = (
        short_run(scene, Settings(dt=0.8, method="naive", contact=contact), 0.8, rate=1.0)
        for contact in ("push", "impact")
    )
    assert push.error.rms == pytest.approx(0.3, rel=1e-12)
    assert impact.error.rms == pytest.approx(0, abs=1e-14)
    assert push.collisions == impact.collisions == (1, 1)


def test_a_collision_that_the_frames_step_over_is_missed():
    """Two discs cross a corner of each other between two frames: the exact run has one collision, the stepped none."""
    scene = Scene(width=20, height=10, position=[[8, 5.4], [10, 4.6]], velocity=[[4, 0], [-4, 0]], radius=0.5)
    missed = short_run(scene, Settings(dt=0.5, method="naive"), 0.5, rate=1.0)
    seen = short_run(scene, Settings(dt=0.05, method="naive"), 0.5, rate=1.0)
    assert missed.collisions == (0, 1)
    assert seen.collisions == (1, 1)


def test_the_comparison_is_at_a_whole_number_of_frames():
    assert short_run(gas(30, 0.2), Settings(dt=0.3, method="naive"), 0.8, rate=2.0).time == pytest.approx(0.9)
    assert short_run(gas(30, 0.2), Settings(dt=0.3, method="naive"), 0.01, rate=2.0).time == pytest.approx(0.3)


def test_a_comparison_beyond_the_horizon_is_refused_with_the_limit():
    with pytest.raises(mpsim.InputError, match=r"at most 5 .*got 6"):
        short_run(gas(30, 0.2), Settings(dt=0.1), 6.0, rate=2.0)
    with pytest.raises(mpsim.InputError, match="until must be a finite number > 0"):
        short_run(gas(30, 0.2), Settings(dt=0.1), -1.0, rate=2.0)


@pytest.mark.slow
def test_another_reference_stands_in_where_the_exact_solver_cannot():
    scene = gas(30, 0.2, acceleration=((0.0, -1.0),) * 30)
    with pytest.raises(mpsim.InputError, match="acceleration per disc"):
        short_run(scene, Settings(dt=0.1, method="naive"), 0.5, rate=2.0)
    fine = Settings(dt=0.001, method="naive", contact="push")
    coarse, same = (
        short_run(scene, dataclasses.replace(fine, dt=dt), 0.5, rate=2.0, reference=fine) for dt in (0.1, 0.001)
    )
    assert same.error.rms < 1e-9 < coarse.error.rms


# Balances of one run


@pytest.mark.long
def test_a_falling_disc_drifts_by_what_the_stepping_adds():
    """v += g dt, then p += v dt (`push`): after n frames the disc is g n (n + 1) / 2 dt^2 lower, n dt^2 g / 2 too low.

    From rest at g = 2, dt = 0.1, 10 frames: v = 2, kinetic 2; fallen 2 x 0.01 x 55 = 1.1 instead of 1: energy
    2 - 2 x 1.1 = -0.2, over the larger kinetic energy 2 and time 1: -0.1. Momentum: all of it is gravity's.
    """
    energy, momentum = drifts(lone([0, 0], gravity=(0, -2)), 10, dt=0.1, method="grid", contact="push")
    assert energy == pytest.approx(-0.1, rel=1e-12)
    assert momentum < 1e-14
    energy, momentum = drifts(lone([0, 0], acceleration=[[0, -2]]), 10, dt=0.1, method="grid", contact="push")
    assert energy == pytest.approx(-0.1, rel=1e-12)
    assert momentum < 1e-14


@pytest.mark.slow
def test_a_lossy_wall_drifts_by_the_energy_that_it_takes():
    """One bounce at restitution 0.5 leaves a quarter of the energy: -3/4 of the larger one, in a time of 2."""
    scene = Scene(width=10, height=3, position=[[8.5, 1.5]], velocity=[[2, 0]], radius=0.5, wall_restitution=0.5)
    for method in ("grid", "event"):
        energy, momentum = drifts(scene, 8, dt=0.25, method=method)
        assert energy == pytest.approx(-0.375, rel=1e-12), method
        assert momentum < 1e-9, f"{method}: the wall's impulse is known, so it is no drift"


def test_reflect_makes_momentum_from_nothing():
    """A disc at rest is hit head-on and stays at rest, the other one turns round: momentum changes by 2 m v = -4.

    Over the sum of speeds, 2, and the time, 0.5: 4.
    """
    scene = Scene(width=10, height=10, position=[[4, 5], [5.5, 5]], velocity=[[2, 0], [0, 0]], radius=0.5)
    assert drifts(scene, 5, dt=0.1, method="naive", law="reflect")[1] == pytest.approx(4, rel=1e-9)
    assert drifts(scene, 5, dt=0.1, method="naive", law="elastic")[1] < 1e-12


KEPT = {"nothing": {}, "gravity": {"gravity": (0.5, -2.0)}, "losses": {"restitution": 0.9, "wall_restitution": 0.8}}


@pytest.mark.slow
@pytest.mark.parametrize("method", long_but(["naive", "grid", "parallel", "event"], "grid", "parallel", "event"))
@pytest.mark.parametrize("name", long_but(KEPT, "nothing"))
def test_momentum_is_kept_to_rounding_by_the_law_of_action_and_reaction(method, name):
    features = KEPT[name]
    settings = {} if method == "event" else {"contact": "impact", "workers": 2 if method == "parallel" else None}
    _, momentum = drifts(gas(200, 0.3, **features), 200, dt=0.02, method=method, **settings)
    # Impulses are counted in steps of 2^-32 of a typical momentum, and that of a fall through this box is eight times
    # as large as the others.
    assert 0 <= momentum < 1e-10 * (8 if "gravity" in features else 1)


@pytest.mark.slow
def test_momentum_drifts_under_reflect_and_less_so_in_float32_by_its_roundings():
    reflect = drifts(gas(200, 0.3), 100, dt=0.02, method="grid", law="reflect")[1]
    single = drifts(gas(200, 0.3), 100, dt=0.02, method="grid", precision="float32")[1]
    double = drifts(gas(200, 0.3), 100, dt=0.02, method="grid")[1]
    assert double < 1e-10 < single < 1e-5
    assert reflect > 1e-3


def test_balances_of_nothing_are_nothing():
    empty = Scene(width=2, height=2, position=[], velocity=[], radius=0.5)
    assert drifts(empty, 3, dt=0.1, method="grid") == (0, 0)
    assert drifts(lone([0, 0]), 3, dt=0.1, method="grid") == (0, 0)
    with simulate(lone([1, 0]), method="grid") as sim:
        assert math.isnan(sim.run(frames=0, measures=BALANCES).measures["energy_drift"].value)


def test_balances_do_not_depend_on_the_workers_nor_on_how_a_run_was_cut():
    scene = gas(500, 0.4)
    values = {drifts(scene, 60, dt=0.02, method="parallel", workers=workers) for workers in (1, 2, 3)}
    assert len(values) == 1
    with simulate(scene, dt=0.02, method="grid") as sim:
        sim.run(frames=30)
        later = sim.run(frames=30, measures=BALANCES).measures
    assert later["momentum_drift"].value < 1e-10, "a second run balances against its own start"
