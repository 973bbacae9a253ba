"""Observables of scenes that discs have left: who counts, and where."""

import dataclasses

import numpy as np
import pytest
from support.scenes import simulate
from support.states import after, box_of

import mpsim
from mpsim.core.state import State
from mpsim.errors import InputError
from mpsim.measure import observables


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_a_free_disc_that_moved_12_in_a_periodic_box_of_10_has_moved_12(method):
    scene = box_of(position=[[2, 4]], velocity=[[3, 0]], boundary="periodic")
    with simulate(scene, method=method, dt=1 / 8) as sim:
        start = sim.state
        sim.run(until=4)
        end = sim.state
    assert observables.mean_squared_displacement(start, end, scene) == pytest.approx(144, rel=1e-12)
    assert observables.mean_squared_displacement(start, end) == pytest.approx(144, rel=1e-12), "no scene is needed"
    bare = [State(state.position, state.velocity) for state in (start, end)]
    assert observables.mean_squared_displacement(*bare, scene) == pytest.approx(4), "the shorter way round, as before"
    assert observables.trajectory_error(end, start, scene).rms == pytest.approx(2), "an error is to the nearest image"


def test_states_of_which_only_one_counts_periods_are_refused():
    scene = box_of(position=[[2, 4]], velocity=[[3, 0]], boundary="periodic")
    end, start = after(scene, 4), State(scene.position, scene.velocity)
    for pair in ((start, end), (end, start)):
        with pytest.raises(InputError, match=r"needs image flags \(State.image\) in both states or in neither"):
            observables.mean_squared_displacement(*pair, scene)
    counted = State(scene.position, scene.velocity, image=np.zeros((1, 2), int), box=scene.box)
    assert observables.mean_squared_displacement(counted, end, scene) == pytest.approx(144)


def test_displacements_are_of_discs_that_are_there_all_along():
    scene = box_of(position=[[2, 2], [8, 6]], velocity=[[1, 0], [0.25, 0]], absorbing="right")
    scene = scene.starting_from(State(scene.position[::-1], scene.velocity[::-1] * [[8, 1], [1, 1]]))
    start, end = (State(scene.position, scene.velocity), after(scene, 3))
    assert end.present.tolist() == [False, True]
    assert observables.mean_squared_displacement(start, end) == pytest.approx(9), "not that of the disc that left"
    error = observables.trajectory_error(end, end)
    assert (error.rms, error.disc) == (0, 1), "one that is absent in both has no place"


@pytest.fixture(scope="module")
def leaking():
    """A gas that has lost some discs through an edge: scene, state, the scene that starts there, and who is left."""
    scene = mpsim.Scene.random(
        count=200, packing=0.3, radius=0.5, seed=4, gravity=(0, -0.25), absorbing="bottom", mass=[1, 2] * 100
    )
    state = after(scene, 4, dt=0.02)
    here = state.present
    assert 40 < here.sum() < 180, here.sum()
    rest = scene.starting_from(state)
    return scene, state, rest, State(state.position[here], state.velocity[here])


@pytest.mark.slow
def test_observables_count_only_discs_that_are_present(leaking):
    scene, state, rest, left = leaking
    everybody = State(state.position, state.velocity)
    for name in ("kinetic_energy", "potential_energy", "temperature", "momentum", "overlap"):
        function = getattr(observables, name)
        found, expected, before = function(state, scene), function(left, rest), function(everybody, scene)
        if name == "overlap":
            numbers = np.flatnonzero(state.present)
            worst = None if expected.worst is None else tuple(numbers[list(expected.worst)].tolist())
            expected = dataclasses.replace(expected, worst=worst)
            assert before.pairs > 10 * found.pairs, "absorbed discs lie on each other, which was counted"
        if name in ("temperature", "potential_energy"):
            assert abs(before - found) > 0.005 * abs(found), f"{name} was wrong, or this tests nothing"
        assert np.all(found == expected), name
    assert observables.temperature(state, scene, remove_drift=True) == observables.temperature(
        left, rest, remove_drift=True
    )
    assert observables.speed_kurtosis(state) == observables.speed_kurtosis(left)
    assert observables.speed_kurtosis(everybody) > 1.1 * observables.speed_kurtosis(left)
    found, expected = observables.speed_distribution(state), observables.speed_distribution(left)
    assert found.distance == expected.distance
    assert found.value.tolist() == expected.value.tolist()


@pytest.mark.slow
def test_an_empty_box_has_no_energy_and_no_temperature():
    scene = box_of(position=[[2, 2], [5, 3]], velocity=[[0, -9], [0, -9]], gravity=(0, -1), absorbing="bottom")
    state = after(scene, 2)
    assert not state.present.any()
    assert observables.potential_energy(state, scene) == 0
    assert observables.potential_energy(State(state.position, state.velocity), scene) > 0.5, "as it was"
    assert observables.overlap(state, scene) == observables.Overlap(0, 0.0, 0.0, None)
    with pytest.raises(InputError, match="temperature needs at least 1 disc; got 0"):
        observables.temperature(state, scene)


def test_a_run_gathers_the_temperature_of_discs_that_are_present():
    """Half of the discs leave at once: the temperature is that of the others, which fly on for ever."""
    scene = box_of(position=[[2, 2], [5, 6]], velocity=[[0, -50], [3, 0]], absorbing="bottom")
    with simulate(scene, method="naive", contact="impact") as sim:
        sim.run(until=0.5)
        report = sim.run(frames=200, measures=["temperature", "speed_kurtosis", "kinetic_energy"])
    assert report.measures["temperature"].value == pytest.approx(4.5, rel=1e-12), "and not half of it"
    assert report.measures["speed_kurtosis"].value == pytest.approx(1, rel=1e-12), "and not 2"
    assert report.measures["kinetic_energy"].value == pytest.approx(4.5, rel=1e-12)


def test_a_run_goes_on_when_all_have_left_and_says_that_the_mean_is_not_defined():
    scene = box_of(position=[[2, 2]], velocity=[[0, -5]], absorbing="bottom")
    with simulate(scene, method="naive") as sim:
        report = sim.run(until=2, measures=["temperature"])
        assert np.isnan(report.measures["temperature"].value)
        assert sim.time == 2


@pytest.mark.slow
def test_a_scene_that_starts_from_a_state_leaves_out_who_has_left(leaking):
    scene, state, rest, left = leaking
    assert rest.count == state.present.sum() < scene.count
    assert rest.position.tolist() == left.position.tolist()
    assert rest.masses.tolist() == scene.masses[state.present].tolist()
    with simulate(rest, method="naive") as sim:
        assert sim.state.present.all()
