"""Observables of mixtures and periodic boxes: worked by hand, against slow twins; refusals."""

import math

import numpy as np
import pytest

from mpsim import FixedDisc, InputError, Scene
from mpsim.core.state import State
from mpsim.measure import correlation, observables

MIXTURE = Scene(
    width=10,
    height=8,
    position=[[1, 1], [5, 5], [8, 2]],
    velocity=[[3, 4], [0, 1], [-2, 0]],
    radius=[0.5, 1.0, 0.25],
    mass=[2.0, 4.0, 1.0],
    gravity=(0, -10),
)

STATE = State(MIXTURE.position, MIXTURE.velocity)
MORE = State(np.concatenate([MIXTURE.position, [[2, 6]]]), np.zeros((4, 2)))


def test_energies_momentum_and_temperature_of_a_mixture():
    assert observables.kinetic_energy(STATE, MIXTURE) == 0.5 * (2 * 25 + 4 * 1 + 1 * 4)
    assert observables.potential_energy(STATE, MIXTURE) == 10 * (2 * 1 + 4 * 5 + 1 * 2)
    assert observables.momentum(STATE, MIXTURE).tolist() == [2 * 3 - 2, 2 * 4 + 4]
    assert observables.temperature(STATE, MIXTURE) == (50 + 4 + 4) / 6
    drift = np.array([4.0, 12.0]) / 7
    rest = (MIXTURE.masses[:, None] * (MIXTURE.velocity - drift) ** 2).sum() / 4
    assert observables.temperature(STATE, MIXTURE, remove_drift=True) == pytest.approx(rest, rel=1e-14)
    own = Scene(width=9, height=9, position=[[1, 2], [5, 5]], velocity=np.zeros((2, 2)), radius=0.5, mass=[2.0, 1.0],
                acceleration=[[1, 0], [0, -3]])  # fmt: skip
    assert observables.potential_energy(State(own.position, own.velocity), own) == -2 * 1 * 1 + 3 * 5


@pytest.mark.parametrize("name", ["kinetic_energy", "potential_energy", "momentum", "temperature", "overlap"])
def test_a_state_with_discs_whose_mass_or_size_nobody_knows_is_refused(name):
    with pytest.raises(InputError, match=rf"{name} needs one (mass|radius) of the scene per disc; got 3 and 4 discs"):
        getattr(observables, name)(MORE, MIXTURE)


def test_a_field_along_a_periodic_axis_has_no_energy():
    scene = Scene(width=9, height=9, position=[[1, 2]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1),
                  boundary=("walls", "periodic"))  # fmt: skip
    with pytest.raises(InputError, match=r"potential_energy needs fields.*along a periodic axis.*walls"):
        observables.potential_energy(State(scene.position, scene.velocity), scene)
    across = Scene(width=9, height=9, position=[[1, 2]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1),
                   boundary=("periodic", "walls"))  # fmt: skip
    assert observables.potential_energy(State(across.position, across.velocity), across) == 2


@pytest.mark.parametrize("boundary", ["walls", "periodic", ("periodic", "walls"), ("walls", "periodic")])
def test_overlaps_of_several_sizes_agree_with_all_pairs(boundary):
    rng = np.random.default_rng(3)
    radius = rng.uniform(0.1, 0.9, 200)
    position = rng.uniform(0.9, [19.1, 11.1], (200, 2))
    position[:60] = (
        np.where(rng.random((60, 2)) < 0.5, [0.9, 0.9], [19.1, 11.1]) if boundary == "walls" else position[:60]
    )
    if boundary == "periodic":
        position[:100] = rng.uniform(0, [20, 12], (100, 2))
    scene = Scene(width=20, height=12, position=position, velocity=np.zeros((200, 2)), radius=radius, boundary=boundary)
    r = position[:, None] - position[None]
    for axis, length in enumerate((20.0, 12.0)):
        if scene.periodic[axis]:
            r[..., axis] -= length * np.round(r[..., axis] / length)
    depth = (radius[:, None] + radius[None] - np.hypot(r[..., 0], r[..., 1]))[np.triu_indices(200, 1)]
    found = observables.overlap(State(position, np.zeros((200, 2))), scene)
    assert found.pairs == (depth > 0).sum() > 20
    assert found.largest == pytest.approx(depth.max(), rel=1e-12)
    assert found.mean == pytest.approx(depth[depth > 0].mean(), rel=1e-12)
    i, j = found.worst
    assert radius[i] + radius[j] - np.hypot(*r[i, j]) == pytest.approx(depth.max(), rel=1e-12)


def test_displacements_go_the_short_way_round_where_a_scene_says_so():
    scene = Scene(
        width=10, height=8, position=[[0.5, 4]], velocity=[[0, 0]], radius=0.5, boundary=("periodic", "walls")
    )
    before, after = (State(np.array([place]), np.zeros((1, 2))) for place in ([0.5, 1.0], [9.5, 7.0]))
    assert observables.mean_squared_displacement(before, after, scene) == 1 + 36
    assert observables.mean_squared_displacement(before, after) == 81 + 36
    assert observables.trajectory_error(before, after, scene).rms == pytest.approx(math.sqrt(37))
    assert observables.trajectory_error(before, after).rms == pytest.approx(math.sqrt(117))


def test_pair_correlation_refuses_what_it_cannot_do():
    with pytest.raises(InputError, match=r"discs of one radius; got radii from 0.25 to 1\. Give it a scene"):
        correlation.pair_correlation(STATE, MIXTURE, 10, 3.0)
    scene = Scene(width=9, height=9, position=[[1, 1]], velocity=[[0, 0]], radius=0.5, obstacles=FixedDisc((5, 5), 1))
    with pytest.raises(InputError, match=r"box without obstacles.*got 1\. Leave them out"):
        correlation.pair_correlation(State(scene.position, scene.velocity), scene, 10, 3.0)
    torus = Scene(width=9, height=9, position=[[1, 1]], velocity=[[0, 0]], radius=0.5, boundary="periodic")
    with pytest.raises(InputError, match=r"r_max must lie above one diameter, 1, and below 4\.5.*its own images"):
        correlation.pair_correlation(State(torus.position, torus.velocity), torus, 10, 4.6)
