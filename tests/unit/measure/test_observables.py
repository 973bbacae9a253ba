"""What one state shows: numbers worked by hand, slow obvious twins, gases with a known answer."""

import math

import numpy as np
import pytest
from support.scenes import gas, simulate
from support.states import drop, scene_of, state_of

import mpsim
from mpsim.core.state import State
from mpsim.errors import InputError
from mpsim.measure import correlation, observables, reference


def moving(velocity):
    velocity = np.asarray(velocity, dtype=float)
    return State(np.zeros_like(velocity), velocity)


SCENE = scene_of([[5.0, 5.0]])


def test_energy_and_momentum_by_hand():
    state = moving([[3, 4], [0, -2]])
    assert observables.kinetic_energy(state, SCENE) == 14.5
    assert observables.momentum(state, SCENE).tolist() == [3.0, 2.0]


def test_sums_of_a_float32_state_are_taken_in_float64():
    velocity = np.full((200_000, 2), 0.1, np.float32)
    state = State(np.zeros_like(velocity), velocity)
    exact = 200_000 * float(np.float32(0.1))
    assert observables.momentum(state, SCENE)[0] == pytest.approx(exact, rel=1e-13)
    assert observables.kinetic_energy(state, SCENE) == pytest.approx(exact * float(np.float32(0.1)), rel=1e-13)
    running = np.cumsum(velocity[:, 0])[-1]  # negative control: the same sum, run up in float32
    assert abs(running - exact) > 1e-4 * exact


def test_temperature_with_and_without_drift():
    state = moving([[3, 1], [1, 1]])
    assert observables.temperature(state, SCENE) == 3.0
    assert observables.temperature(state, SCENE, remove_drift=True) == 1.0


def test_temperature_without_drift_is_unbiased():
    rng = np.random.default_rng(2)
    found = [observables.temperature(moving(rng.normal(5, 2, (3, 2))), SCENE, remove_drift=True) for _ in range(4000)]
    assert np.mean(found) == pytest.approx(4, abs=5 * np.std(found) / math.sqrt(4000))


def test_potential_energy_in_gravity_and_own_accelerations():
    position = np.array([[1.0, 2.0], [3.0, 5.0]])
    state = State(position, np.zeros((2, 2)))
    assert observables.potential_energy(state, scene_of(position)) == 0.0
    assert observables.potential_energy(state, scene_of(position, gravity=(0, -10))) == 70.0
    assert observables.potential_energy(state, scene_of(position, gravity=(2, 0))) == -8.0
    own = scene_of(position, acceleration=[[0, 1], [2, 0]])
    assert observables.potential_energy(state, own) == -8.0


def test_potential_and_kinetic_energy_of_a_fall_add_up_to_a_constant():
    gravity, acceleration = np.array([0.5, -9.0]), np.array([[1.0, 2.0]])
    scene = scene_of([[10.0, 10.0]], [[1.0, 3.0]], gravity=gravity, acceleration=acceleration)
    total = []
    for t in (0.0, 0.4, 0.9):
        a = gravity + acceleration
        state = State(scene.position + scene.velocity * t + a * t * t / 2, scene.velocity + a * t)
        total.append(observables.kinetic_energy(state, scene) + observables.potential_energy(state, scene))
    assert np.ptp(total) < 1e-12


def test_overlap_by_hand():
    found = observables.overlap(*_state_and_scene([[2, 2], [2.75, 2], [2, 2.5], [9, 9], [9, 9], [15, 3]]))
    deep = [0.25, 0.5, 1 - math.hypot(0.75, 0.5), 1.0]
    assert (found.pairs, found.largest, found.worst) == (4, 1.0, (3, 4))
    assert found.mean == pytest.approx(np.mean(deep), rel=1e-15)
    assert observables.overlap(*_state_and_scene([[2, 2], [3, 2]])) == observables.Overlap(0, 0.0, 0.0, None)


def _state_and_scene(position):
    scene = scene_of(position)
    return state_of(scene), scene


@pytest.mark.parametrize(("count", "side"), [(300, 6.0), (300, 60.0), (2, 1.5), (1, 5.0)])
def test_overlap_agrees_with_all_pairs(count, side):
    scene = drop(count, side, seed=count)
    i, j = np.triu_indices(count, 1)
    depth = 1 - np.hypot(*(scene.position[i] - scene.position[j]).T)
    depth = depth[depth > 0]
    found = observables.overlap(state_of(scene), scene)
    assert found.pairs == len(depth)
    assert found.mean == pytest.approx(depth.mean() if len(depth) else 0, rel=1e-12)
    assert found.largest == pytest.approx(depth.max(initial=0), rel=1e-12)


def test_touching_discs_of_a_float32_state_do_not_overlap():
    scene = scene_of([[17.3, 11.1], [18.3, 11.1]])
    state = State(np.nextafter(scene.position.astype(np.float32), np.float32([[99, 11.1], [0, 11.1]])), scene.velocity)
    assert state.position[1, 0] - state.position[0, 0] < 1
    assert observables.overlap(state, scene).pairs == 0
    deep = State(scene.position.astype(np.float32) - np.float32([[0, 0], [1e-3, 0]]), scene.velocity)
    assert observables.overlap(deep, scene).pairs == 1


def test_speed_kurtosis_by_hand_and_at_extremes():
    assert observables.speed_kurtosis(moving([[1, 0], [0, 3]])) == pytest.approx((1 + 81) / 2 / 25, rel=1e-15)
    assert observables.speed_kurtosis(moving([[1, 0], [0, -1]])) == 1
    for scale in (1e-200, 1e200):
        assert observables.speed_kurtosis(moving(scale * np.array([[1, 0], [0, 3]]))) == pytest.approx(1.64, rel=1e-14)


def test_speeds_at_equilibrium_have_the_kurtosis_of_their_number():
    rng = np.random.default_rng(3)
    found = [observables.speed_kurtosis(moving(rng.normal(size=(3, 2)))) for _ in range(6000)]
    assert np.mean(found) == pytest.approx(reference.speed_kurtosis(3), abs=4 * np.std(found) / math.sqrt(6000))
    assert abs(np.mean(found) - 2) > 0.4  # negative control: not that of a large gas


def test_the_maxwell_density_is_close_and_equal_speeds_are_far():
    rng = np.random.default_rng(4)
    count = 20_000
    found = observables.speed_distribution(moving(rng.normal(0, 2.0, (count, 2))), bins=20)
    assert found.distance < 1.28 / math.sqrt(count)
    assert (np.diff(found.edges) @ found.value) == pytest.approx(1, rel=1e-12)
    error = np.sqrt(found.maxwell / np.diff(found.edges) / count)
    assert (np.abs(found.value - found.maxwell) < 4 * error + 1e-4).all()
    angle = rng.uniform(0, 2 * np.pi, count)
    equal = observables.speed_distribution(moving(np.stack([np.cos(angle), np.sin(angle)], axis=1)))
    assert equal.distance == pytest.approx(1 - math.exp(-1), abs=1e-9)


def test_speed_distribution_by_hand():
    found = observables.speed_distribution(moving([[2, 0], [0, 2]]), bins=[0, 1, 3])
    assert found.value.tolist() == [0.0, 0.5]
    below = [1 - math.exp(-1 / 4), 1 - math.exp(-9 / 4)]
    assert found.maxwell == pytest.approx([below[0], (below[1] - below[0]) / 2], rel=1e-14)


def test_displacement_and_trajectory_error_by_hand():
    before, after = moving(np.zeros((3, 2))), State(np.array([[3.0, 4.0], [0, 0], [0, -1]]), np.zeros((3, 2)))
    assert observables.mean_squared_displacement(before, after) == pytest.approx(26 / 3, rel=1e-15)
    found = observables.trajectory_error(after, before)
    assert (found.largest, found.disc) == (5.0, 0)
    assert found.rms == pytest.approx(math.sqrt(26 / 3), rel=1e-15)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: observables.temperature(moving(np.zeros((0, 2))), SCENE), "temperature needs at least 1 disc; got 0"),
        (lambda: observables.temperature(moving([[1, 1]]), SCENE, remove_drift=True), "at least 2 discs; got 1"),
        (lambda: observables.kinetic_energy(moving([[1, math.nan]]), SCENE), r"state.velocity\[0, 1\] is nan"),
        (lambda: observables.speed_kurtosis(moving([[0, 0]])), "needs a disc that moves"),
        (lambda: observables.temperature(SCENE, SCENE), r"must be a State; got Scene\. Use sim\.state of a Simulation"),
        (lambda: observables.overlap(SCENE, SCENE), "state must be a State; got Scene"),
        (lambda: observables.speed_kurtosis([[1, 0]]), "state must be a State; got list"),
        (lambda: observables.speed_distribution(moving([[0, 0]])), "needs a disc that moves"),
        (lambda: observables.speed_distribution(moving([[1, 0]]), bins=0), "bins must be a whole number"),
        (lambda: observables.speed_distribution(moving([[1, 0]]), bins=[1.0, 1.0]), "rising edges"),
        (lambda: observables.mean_squared_displacement(moving([[1, 0]]), moving([[1, 0]] * 2)), "got 1 and 2 discs"),
        (lambda: observables.trajectory_error(*[moving(np.zeros((0, 2)))] * 2), "trajectory_error needs at least 1"),
        (lambda: correlation.pair_correlation(state_of(SCENE), SCENE, 10, 1.0), "r_max must lie above one diameter"),
        (lambda: correlation.pair_correlation(state_of(SCENE), SCENE, 10, 9.6), "below 9.5"),
        (lambda: correlation.pair_correlation(state_of(SCENE), SCENE, 10, 6.0), "needs discs at least"),
        (lambda: correlation.pair_correlation(state_of(SCENE), SCENE, 0, 3.0), "bins must be a whole number"),
        (
            lambda: observables.potential_energy(moving(np.zeros((2, 2))), scene_of([[5, 5]], acceleration=[[0, 1]])),
            "got 1 and 2 discs",
        ),
    ],
)
def test_bad_input_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()


@pytest.mark.parametrize(
    "measured",
    [
        mpsim.measure.temperature,
        mpsim.measure.kinetic_energy,
        mpsim.measure.overlap,
        mpsim.measure.hexatic_order,
        lambda state, scene: mpsim.measure.pair_correlation(state, scene, bins=5, r_max=3.0),
        lambda state, scene: mpsim.measure.trajectory_error(state, state, scene),
    ],
)
def test_the_scene_of_another_box_is_refused(measured):
    scene, other = gas(100, 0.4), gas(100, 0.1)
    with simulate(scene) as sim:
        state = sim.state
    measured(state, scene)  # the control: its own
    measured(mpsim.State(state.position, state.velocity), scene)  # of unknown box
    with pytest.raises(
        mpsim.InputError, match=r"scene must be that of the state, whose box is 14.* x 14.*; got one of 28"
    ):
        measured(state, other)


def test_the_walls_of_a_piston_are_where_the_state_has_them():
    scene = mpsim.Scene.load("piston")
    with mpsim.Simulation(scene) as sim:
        sim.run(until=30.0)
        assert sim.state.box != scene.box
        assert mpsim.measure.temperature(sim.state, sim.scene) > 0
