"""Observables and gathered measures of mixtures and periodic boxes: worked by hand, against slow twins; refusals."""

import math

import numpy as np
import pytest

from mpsim import Emitter, FixedDisc, InputError, Piston, Scene
from mpsim.core.state import State
from mpsim.kernels import layout
from mpsim.measure import correlation, counted, observables, pairs, run_averages

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


@pytest.mark.parametrize("lengths", [(None, None), (9.0, None), (None, 7.0), (9.0, 7.0)])
def test_close_pairs_find_each_pair_once_by_its_nearest_images(lengths):
    position = np.random.default_rng(8).uniform(0, [9, 7], (120, 2))
    found = [np.concatenate(part) for part in zip(*pairs.close_pairs(position, 3.4, lengths), strict=True)]
    i, j = np.triu_indices(120, 1)
    distance = np.hypot(*pairs.to_nearest_image(position[i] - position[j], lengths).T)
    expected = {(a, b): d for a, b, d in zip(i.tolist(), j.tolist(), distance, strict=True) if d < 3.4}
    got = {(min(a, b), max(a, b)): d for a, b, d in zip(*(part.tolist() for part in found), strict=True)}
    assert len(found[0]) == len(got)
    assert got.keys() == expected.keys()
    assert max(abs(got[pair] - expected[pair]) for pair in got) < 1e-12


def test_displacements_go_the_short_way_round_where_a_scene_says_so():
    scene = Scene(
        width=10, height=8, position=[[0.5, 4]], velocity=[[0, 0]], radius=0.5, boundary=("periodic", "walls")
    )
    before, after = (State(np.array([place]), np.zeros((1, 2))) for place in ([0.5, 1.0], [9.5, 7.0]))
    assert observables.mean_squared_displacement(before, after, scene) == 1 + 36
    assert observables.mean_squared_displacement(before, after) == 81 + 36
    assert observables.trajectory_error(before, after, scene).rms == pytest.approx(math.sqrt(37))
    assert observables.trajectory_error(before, after).rms == pytest.approx(math.sqrt(117))


def test_a_periodic_ideal_gas_has_no_correlation_and_every_disc_is_a_reference():
    rng = np.random.default_rng(6)
    scene = Scene(width=20, height=20, position=[[1, 1]], velocity=[[0, 0]], radius=0.01, boundary="periodic")
    states = [State(rng.uniform(0, 20, (500, 2)), np.zeros((500, 2))) for _ in range(20)]
    found = correlation.pair_correlation(states, scene, bins=20, r_max=10.0)
    assert found.references == 20 * 500
    assert found.density == pytest.approx(500 / 400)
    away = (found.g - 1 * (499 / 500)) / found.error
    assert np.abs(away).max() < 4
    assert np.abs(away).mean() < 1.2
    # Negative control: taking the box for closed leaves out all pairs across its borders.
    blind = Scene(width=20, height=20, position=[[1, 1]], velocity=[[0, 0]], radius=0.01)
    assert correlation.pair_correlation(states, blind, bins=20, r_max=4.0).references < 5000


def test_pair_correlation_refuses_what_it_cannot_do():
    with pytest.raises(InputError, match=r"discs of one radius; got radii from 0.25 to 1\. Give it a scene"):
        correlation.pair_correlation(STATE, MIXTURE, 10, 3.0)
    scene = Scene(width=9, height=9, position=[[1, 1]], velocity=[[0, 0]], radius=0.5, obstacles=FixedDisc((5, 5), 1))
    with pytest.raises(InputError, match=r"box without obstacles.*got 1\. Leave them out"):
        correlation.pair_correlation(State(scene.position, scene.velocity), scene, 10, 3.0)
    torus = Scene(width=9, height=9, position=[[1, 1]], velocity=[[0, 0]], radius=0.5, boundary="periodic")
    with pytest.raises(InputError, match=r"r_max must lie above one diameter, 1, and below 4\.5.*images of itself"):
        correlation.pair_correlation(State(torus.position, torus.velocity), torus, 10, 4.6)


# --- gathered measures


def scene_of(**changes):
    arguments = {"width": 10.0, "height": 8.0, "position": [[2, 2], [5, 5]], "velocity": np.ones((2, 2)), "radius": 0.5}
    return Scene(**(arguments | changes))


VIRIALS = ["pressure_virial", "pressure_xx", "pressure_yy"]

REFUSED = {
    "gravity": ({"gravity": (0, -1)}, [*VIRIALS], "gravity and acceleration"),
    "obstacles": ({"obstacles": FixedDisc((8, 8), 1)}, [*VIRIALS, "momentum_drift"], "obstacles"),
    "losses": ({"restitution": 0.9}, [*VIRIALS], "losses"),
    "losses under gravity": (
        {"restitution": 0.9, "gravity": (0, -1)}, [*VIRIALS, "collision_rate"], ""),
    "losses at walls under acceleration": (
        {"wall_restitution": 0.9, "acceleration": np.ones((2, 2))}, [*VIRIALS, "collision_rate"], ""),
    "sizes": ({"radius": [0.5, 0.4]}, [*VIRIALS], "several sizes"),
    "sizes, channel": ({"radius": [0.5, 0.4], "boundary": ("walls", "periodic")}, [*VIRIALS], "several sizes"),
    "piston": ({"piston": Piston("left", 1, 3)}, ["pressure", *VIRIALS, "energy_drift"], "piston"),
    "absorbing": (
        {"absorbing": "left"},
        [*VIRIALS, "collision_rate", "contact_rate", "energy_drift", "momentum_drift"],
        "absorbing edges",
    ),
    "no wall": (
        {"absorbing": ["left", "right", "bottom", "top"]},
        ["pressure", *VIRIALS, "collision_rate", "contact_rate", "energy_drift",
         "momentum_drift"],
        "absorbing edges",
    ),
    "emitters": (
        {"emitters": Emitter((8, 6), (0, 0), every=1)},
        [*VIRIALS, "collision_rate", "contact_rate", "energy_drift", "momentum_drift"],
        "emitters",
    ),
    "emitters of masses": (
        {"mass": 2.0, "emitters": Emitter((8, 6), (0, 0), every=1, mass=1.0)},
        [*VIRIALS, "collision_rate", "contact_rate", "energy_drift", "momentum_drift", "kinetic_energy", "temperature"],
        "",
    ),
    "falling round": (
        {"gravity": (0, -1), "boundary": ("walls", "periodic")}, [*VIRIALS, "energy_drift"], ""),
    "periodic": ({"boundary": "periodic"}, [], ""),
    "periodic, sizes": ({"boundary": "periodic", "radius": [0.5, 0.4]}, [], ""),
    "periodic, losses": ({"boundary": "periodic", "restitution": 0.9}, ["pressure", *VIRIALS], "losses"),
    "periodic, obstacles": (
        {"boundary": "periodic", "obstacles": FixedDisc((8, 7), 1)},
        ["pressure", *VIRIALS, "momentum_drift"],
        "obstacles",
    ),
    "channel": ({"boundary": ("periodic", "walls")}, [], ""),
    "masses": ({"mass": [1.0, 9.0]}, [], ""),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_scene_has_the_measures_that_mean_something_in_it_and_no_others(case):
    changes, names, word = REFUSED[case]
    scene = scene_of(**changes)
    reasons = {name: run_averages.refusal(name, scene) for name in run_averages.NAMES}
    smooth = [] if all(scene.periodic) and VIRIALS[0] not in names else ["pressure_xy"]  # walls take up none
    assert {name for name, reason in reasons.items() if reason} == {*names, *smooth}
    for name in names:
        with pytest.raises(InputError) as raised:
            run_averages.checked([name], scene)
        text = str(raised.value)
        assert text.startswith(f"measures may hold {name!r} only")
        assert word in text


def test_masses_of_added_discs_are_asked_for():
    with pytest.raises(InputError, match=r"'temperature' only where the scene holds the mass of every disc; it has 2"):
        run_averages.checked("temperature", scene_of(mass=2.0), count=3)
    assert run_averages.checked("temperature", scene_of(), count=3) == ("temperature",)


def counts_of(**values):
    counts = np.zeros((4, layout.TALLIES))
    for name, value in values.items():
        counts[:, getattr(layout, name)] = value
    return counts


def test_pressure_is_that_on_the_walls_that_there_are():
    counts = counts_of(LEFT=9.0, RIGHT=7.0, BOTTOM=3.0, TOP=5.0)
    for changes, expected in (
        ({}, 24 / 36),
        ({"boundary": ("periodic", "walls")}, 8 / 20),
        ({"boundary": ("walls", "periodic")}, 16 / 16),
        ({"absorbing": "left"}, 15 / 28),
    ):
        run = counted.Run(scene_of(**changes), 2, 0.5)
        assert counted.pressure(counts, run).value == pytest.approx(expected / 0.5)


def test_the_virial_of_a_torus_has_no_margins_and_counts_the_largest_diameter():
    counts, scene = counts_of(VIRIAL=3.0), scene_of(boundary="periodic", radius=[0.5, 0.25])
    run = counted.Run(scene, 2, 0.5, kinetic_energy=7.0)
    assert counted.pressure(counts, run).value == pytest.approx((7 + 3 * 1.0 / (2 * 0.5)) / 80)
    channel = counted.Run(scene_of(boundary=("periodic", "walls")), 2, 0.5, kinetic_energy=7.0)
    assert counted.pressure_virial(counts, channel).value == pytest.approx((14 + 6) / (10 * 8 + 7 * 10))
