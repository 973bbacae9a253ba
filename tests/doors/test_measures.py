"""Measures of a state, by hand and by slow twins, and measures of a run: which a scene has, and from when on.

tests/twins/test_measures.py puts states and runs of any kind to all of them.
"""

import math
import sys

import numpy as np
import pytest
from support.scenes import At, box_of, drop, gas, scene_of, simulate, state_of

import mpsim
from mpsim import Emitter, FixedDisc, InputError, Piston, Scene, State, measure

pytestmark = pytest.mark.plain

PAIR = [[2, 2], [5, 5]]


def moving(velocity):
    return State(np.zeros_like(velocity, dtype=float), velocity)


# --- overlaps and structure


def test_overlaps_at_one_point_and_of_touching_discs_in_float32_and_of_nobody():
    scene = scene_of([[9, 9], [9, 9]])
    assert measure.overlap(state_of(scene), scene) == measure.Overlap(1, 1.0, 1.0, (0, 1))
    touching = scene_of([[17.3, 11.1], [18.3, 11.1]])
    place = touching.position.astype(np.float32)
    nearer = np.nextafter(place, np.float32([[99, 11.1], [0, 11.1]]))
    for places, pairs in ((nearer, 0), (place - [[0, 0], [1e-3, 0]], 1)):
        assert measure.overlap(State(places.astype(np.float32), touching.velocity), touching).pairs == pairs
    nobody = State(scene.position, scene.velocity, present=np.zeros(2, bool))
    assert measure.overlap(nobody, scene) == measure.Overlap(0, 0.0, 0.0, None)
    assert measure.potential_energy(nobody, scene_of(scene.position, gravity=(0, -1))) == 0


def test_an_ideal_gas_has_no_correlation_within_its_errors():
    walls = drop(800, 20.0, seed=1)
    boxed = measure.pair_correlation([state_of(drop(800, 20.0, seed=k)) for k in range(10)], walls, bins=60, r_max=4.0)
    assert np.abs((boxed.value - 1) / boxed.error).max() < 4
    assert abs(boxed.contact.deviation(1.0)) < 3
    few = measure.pair_correlation(state_of(walls), walls, bins=6, r_max=4.0)
    assert math.isnan(few.contact.value), "too few shells near contact"


def test_pair_correlation_knows_the_box_behind_a_piston():
    half = gas(300, 0.3, seed=2)
    side, arrays = half.width, {"position": half.position, "velocity": half.velocity, "radius": 0.5}
    piston = Scene(width=2 * side, height=side, **arrays, piston=Piston("right", -1.0, side, start=side))
    with simulate(piston, method="naive") as sim:
        state = sim.state
    behind = measure.pair_correlation(state, piston, bins=20, r_max=4.0)
    alone = measure.pair_correlation(State(half.position, half.velocity), half, bins=20, r_max=4.0)
    assert behind.density == alone.density


ROW = math.sqrt(0.75)


def scene_at(places, width, height, boundary="periodic"):
    return Scene(
        width=width, height=height, position=places, velocity=np.zeros_like(places), radius=0.01, boundary=boundary
    )


def random_points(count, seed, boundary="periodic"):
    return scene_at(0.02 + np.random.default_rng(seed).random((count, 2)) * [9.96, 7.96], 10, 8, boundary)


def test_the_structure_factor_is_that_of_its_slow_twin_and_of_points_at_random_one():
    scene = random_points(40, 1)
    found = measure.structure_factor(state_of(scene), scene, bins=7, k_max=6.0)
    sums, numbers = np.zeros(7), np.zeros(7, int)
    for n in range(-20, 21):
        for m in range(-20, 21):
            k = 2 * math.pi * np.array([n / 10, m / 8])
            if 0 < math.hypot(*k) <= 6.0 and (n > 0 or (n == 0 and m > 0)):
                shell = min(math.ceil(math.hypot(*k) / (6 / 7)) - 1, 6)
                sums[shell] += abs(np.exp(1j * scene.position @ k).sum()) ** 2 / 40
                numbers[shell] += 1
    assert found.vectors.tolist() == numbers.tolist()
    assert found.value == pytest.approx(sums / numbers, rel=1e-9)
    states = [state_of(random_points(200, seed)) for seed in range(12)]
    found = measure.structure_factor(states, random_points(200, 2), bins=12, k_max=10.0)
    deviations = (found.value - 1) / found.error
    assert (np.abs(deviations) < 3).all()
    assert 0.5 < deviations.std() < 1.6


def test_a_triangular_lattice_is_in_order_at_any_distance_and_points_are_not():
    column, row = np.divmod(np.arange(12 * 14), 14)
    places = np.stack([column + 0.5 * (row % 2) + 0.1, (row + 0.1) * ROW], axis=1)
    start = scene_at(np.mod(places, [12, 14 * ROW]), 12, 14 * ROW)
    found = measure.hexatic_order(state_of(start), start)
    assert found.psi == pytest.approx(np.ones(168))
    assert (found.local, found.whole) == pytest.approx((1.0, 1.0))
    turned = scene_at(start.position[:, ::-1].copy(), start.height, start.width)
    assert measure.hexatic_order(state_of(turned), turned).psi == pytest.approx(-np.ones(168))
    far = measure.hexatic_correlation(state_of(start), start, bins=5, r_max=5.0)
    assert far.value[far.pairs > 0] == pytest.approx(np.ones((far.pairs > 0).sum()))
    assert far.r.tolist() == [0.5, 1.5, 2.5, 3.5, 4.5]
    points, half = random_points(400, 5), np.array([5.0, 4.0])
    gaseous = measure.hexatic_correlation([state_of(points)] * 2, points, bins=4, r_max=4.0)
    assert np.abs(gaseous.value[2:]).max() < 0.05
    place = points.position
    distances = [np.hypot(*(np.mod(place[n + 1 :] - place[n] + half, 2 * half) - half).T) for n in range(400)]
    assert gaseous.pairs.sum() == 2 * (np.concatenate(distances) < 4.0).sum()


@pytest.mark.parametrize("boundary", ["periodic", "walls"])
def test_six_nearest_neighbours_are_those_of_the_slow_twin(boundary):
    scene, images = random_points(60, 4, boundary), boundary == "periodic"
    psi = []
    for n in range(60):
        r = scene.position[:, None] + np.array([(x, y) for x in (-10, 0, 10) for y in (-8, 0, 8)]) * images
        r = r.reshape(-1, 2) - scene.position[n]
        near = np.unique(r[(r != 0).any(axis=1)].round(12), axis=0)
        near = near[np.argsort(np.hypot(*near.T))[:6]]
        psi.append(np.exp(6j * np.arctan2(near[:, 1], near[:, 0])).mean())
    found = measure.hexatic_order(state_of(scene), scene)
    assert found.psi == pytest.approx(psi, abs=1e-9)
    present = np.arange(60) % 3 > 0
    state, fewer = (
        State(scene.position, scene.velocity, present=present),
        scene_at(scene.position[present], 10, 8, boundary),
    )
    found = measure.hexatic_order(state, scene)
    assert found.psi.tolist() == measure.hexatic_order(state_of(fewer), fewer).psi.tolist()
    assert found.disc.tolist() == np.flatnonzero(present).tolist()


# --- refusals


ONE, POINTS, WALLS = scene_of([[5, 5]]), random_points(20, 1), random_points(20, 1, "walls")
FALLING_ROUND = scene_of([[5, 5]], gravity=(0, -1), boundary=("walls", "periodic"))
SIZES = scene_of([[5, 5], [9, 9], [3, 3]], radius=[0.5, 1.0, 0.25], mass=[2.0, 4.0, 1.0])
THIN = scene_at(np.stack([np.arange(20) + 0.5, np.full(20, 0.5)], axis=1), 20, 1)
P, IN_9 = state_of(POINTS), State([[5, 5]], [[0, 0]], box=(0, 9, 0, 9))
P_IN_BOX = State(P.position, P.velocity, image=np.zeros((20, 2), int), box=POINTS.box)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: measure.temperature(moving(np.zeros((0, 2))), ONE), "temperature needs at least 1 disc; got 0"),
        (lambda: measure.kinetic_energy(moving([[1, math.nan]]), ONE), r"velocity of a state\[0, 1\] is nan"),
        (lambda: measure.speed_kurtosis(moving([[0, 0]])), "needs a disc that moves"),
        (lambda: measure.mean_squared_displacement(P, P_IN_BOX), r"image flags \(State.image\) in both"),
        (lambda: measure.potential_energy(state_of(FALLING_ROUND), FALLING_ROUND), "along a periodic axis.*walls"),
        (lambda: measure.temperature(P, SIZES), "needs one mass of the scene per disc; got 3 and 20 discs"),
        (lambda: measure.overlap(IN_9, ONE), "whose box is 9 x 9; got one of 20"),
        (lambda: measure.pair_correlation(state_of(SIZES), SIZES, 10, 3.0), "of one radius; got radii from 0.25 to 1"),
        (lambda: measure.pair_correlation(P, POINTS, 10, 4.1), r"r_max must lie above .* and below 4.*its own images"),
        (lambda: measure.structure_factor(state_of(WALLS), WALLS, 50, 5.0), "periodic in both axes"),
        (lambda: measure.structure_factor([P, 3], POINTS, 50, 5.0), r"states\[1\] must be a State; got int"),
        (lambda: measure.hexatic_order(state_of(THIN), THIN), r"6 neighbours .* half of each periodic axis, 0\.5"),
        (lambda: measure.hexatic_correlation(P, POINTS, 5, 4.1), "r_max must be at most half of a periodic axis, 4"),
    ],
)  # fmt: skip
def test_what_a_measure_cannot_take_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_pair_correlation_is_refused_where_density_is_not_uniform():
    plain = gas(60, 0.1)
    parts = {name: getattr(plain, name) for name in ("width", "height", "position", "velocity", "radius")}
    state, middle = State(plain.position, plain.velocity), plain.width / 2
    for features, words in (
        ({"gravity": (0, -1)}, "has gravity"),
        ({"emitters": Emitter((middle, middle), (1, 0), interval=1.0)}, "has emitters"),
        ({"piston": Piston("left", 1, middle)}, "needs a box at rest; got a piston on its way"),
        ({"obstacles": FixedDisc((middle, middle), 0.1)}, r"box without obstacles.*got 1\. Leave them out"),
    ):
        with pytest.raises(InputError, match=words):
            measure.pair_correlation(state, Scene(**parts, **features), 10, 3.0)
    leaky = Scene(**parts, absorbing="left")
    assert measure.pair_correlation(state, leaky, 10, 3.0).references > 0, "nobody has left yet"
    gone = State(plain.position, plain.velocity, present=np.arange(60) > 0)
    with pytest.raises(InputError, match=r"discs have left through an absorbing edge \(1 absent in 2 states\)"):
        measure.pair_correlation([state, gone], leaky, 10, 3.0)


def test_without_freud_the_error_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "freud", None)
    with pytest.raises(mpsim.errors.NotMeasurableError, match="pip install freud-analysis"):
        measure.to_freud(P, POINTS)


# --- measures of runs

VIRIALS = ["pressure_virial", "pressure_xx", "pressure_yy"]
COUNTED = ["pressure", "collision_rate", "contact_rate", "overlap", "largest_overlap"]
SAMPLED = ["kinetic_energy", "temperature", "speed_kurtosis"]
DRIFTS = ["energy_drift", "momentum_drift"]
NAMES = [*COUNTED, *VIRIALS, "pressure_xy", *SAMPLED, *DRIFTS]
FLOWING = [*VIRIALS, "collision_rate", "contact_rate", "energy_drift", "momentum_drift"]

REFUSED = {
    "gravity": ({"gravity": (0, -1)}, [*VIRIALS], "gravity and acceleration"),
    "obstacles": ({"obstacles": FixedDisc((8, 8), 1)}, [*VIRIALS, "momentum_drift"], "obstacles"),
    "losses under gravity": ({"restitution": 0.9, "gravity": (0, -1)}, [*VIRIALS, "collision_rate"], ""),
    "sizes": ({"radius": [0.5, 0.4]}, [*VIRIALS], "several sizes"),
    "piston": ({"piston": Piston("left", 1, 3)}, ["pressure", *VIRIALS, "energy_drift"], "piston"),
    "absorbing": ({"absorbing": "left"}, FLOWING, "absorbing edges"),
    "no wall": ({"absorbing": ["left", "right", "bottom", "top"]}, ["pressure", *FLOWING], "absorbing edges"),
    "emitters": ({"emitters": Emitter((8, 6), (0, 0), every=1)}, FLOWING, "emitters"),
    "emitters of masses": ({"mass": 2.0, "emitters": Emitter((8, 6), (0, 0), every=1, mass=1.0)},
                           [*FLOWING, "kinetic_energy", "temperature"], ""),
    "falling round": ({"gravity": (0, -1), "boundary": ("walls", "periodic")}, [*VIRIALS, "energy_drift"], ""),
    "periodic, sizes": ({"boundary": "periodic", "radius": [0.5, 0.4]}, [], ""),
    "periodic, losses": ({"boundary": "periodic", "restitution": 0.9}, ["pressure", *VIRIALS], "losses"),
    "periodic, obstacles": ({"boundary": "periodic", "obstacles": FixedDisc((8, 7), 1)},
                            ["pressure", *VIRIALS, "momentum_drift"], "obstacles"),
    "channel": ({"boundary": ("periodic", "walls")}, [], ""),
    "rough discs": ({"friction": 0.5}, [*VIRIALS], "friction"),
    "rough walls": ({"wall_friction": 0.5}, [*VIRIALS, "momentum_drift"], ""),
    "bath": ({"thermostat": mpsim.Thermostat(2.0, 0.5)}, ["pressure_virial", *DRIFTS], "thermostat"),
    "thermal walls": ({"thermal_walls": mpsim.ThermalWalls(left=2.0)}, ["pressure_virial", *DRIFTS], "thermal walls"),
    "an obstacle that moves": ({"obstacles": FixedDisc((8, 6), 1, motion=mpsim.Oscillation((0.5, 0), 1.0))},
                               [*VIRIALS, *DRIFTS], ""),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_scene_has_the_measures_that_mean_something_in_it_and_no_others(case):
    changes, names, word = REFUSED[case]
    scene = box_of(position=PAIR, velocity=np.ones((2, 2)), **changes)
    smooth = [] if all(scene.periodic) and VIRIALS[0] not in names else ["pressure_xy"]  # walls take up none
    texts = {}
    with simulate(scene, method="naive") as sim:
        for name in NAMES:
            try:
                sim.run(frames=0, measures=name)
            except InputError as error:
                texts[name] = str(error)
    assert texts.keys() == {*names, *smooth}
    assert all(text.startswith(f"measures may hold {name!r} only") for name, text in texts.items())
    assert all(word in texts[name] for name in names)


def drifts(scene, frames, **settings):
    """energy_drift and momentum_drift of a run."""
    with simulate(scene, **settings) as sim:
        measures = sim.run(frames=frames, measures=DRIFTS).measures
    return measures["energy_drift"].value, measures["momentum_drift"].value


def test_balances_by_hand():
    """A fall by push is n g dt^2/2 too low: -0.2 of 2 in a time of 1; a bounce at 1/2 leaves a quarter of the energy.

    Under `reflect` a disc at rest stays at rest and the other turns round: 2 m v = 4 over the speeds, 2, and 0.5.
    """
    energy, momentum = drifts(box_of(position=[[5, 4]], velocity=[[0, 0]], gravity=(0, -2)), 10, dt=0.1, method="naive")
    assert (energy, momentum) == (pytest.approx(-0.1, rel=1e-12), pytest.approx(0, abs=1e-14))
    bounce = box_of(position=[[8.5, 1.5]], velocity=[[2, 0]], wall_restitution=0.5)
    for method in ("grid", "event"):
        energy, momentum = drifts(bounce, 8, dt=0.25, method=method, contact="impact")
        assert (energy, momentum) == (pytest.approx(-0.375), pytest.approx(0, abs=1e-9))
    hit = box_of(position=[[4, 5], [5.5, 5]], velocity=[[2, 0], [0, 0]])
    assert drifts(hit, 5, dt=0.1, method="naive", law="reflect")[1] == pytest.approx(4, rel=1e-9)
    assert drifts(hit, 5, dt=0.1, method="naive", law="elastic")[1] < 1e-12
    assert drifts(box_of(position=[[4, 5]], velocity=[[0, 0]]), 3, dt=0.1, method="naive") == (0, 0)


def values(report):
    return {name: repr(each) for name, each in report.measures.items()}  # in which NaN equals NaN


@pytest.mark.parametrize("method", ["grid", "event"])
def test_measures_from_a_start_on_are_those_of_a_run_that_begins_there_and_change_no_bit(method):
    scene, names = gas(12, 0.4), [*COUNTED, *SAMPLED, *DRIFTS]
    plain, whole, parts = (simulate(scene, method=method) for _ in range(3))
    with plain, whole, parts:
        start = 7.5 * whole.settings.dt  # inside a frame: the next one counts
        found = whole.run(frames=40, measures=names, start=start)
        parts.run(frames=8)
        expected = parts.run(frames=32, measures=names)
        assert values(found) == values(expected)
        assert (found.frames, list(found.measures)) == (40, names)
        again = whole.run(frames=10, measures=names, start=start)
        assert values(again) == values(parts.run(frames=10, measures=names)), "a start that is over counts all"
        everything = plain.run(frames=40, measures=names)
        assert values(everything) != values(expected), "the control"
        plain.run(frames=10)
        assert plain.digest() == whole.digest() == parts.digest()


def test_measures_that_cannot_be_taken_are_refused():
    with simulate(gas(8, 0.2), method="naive", dt=0.01) as sim:
        for arguments, text in (
            ({"start": 0.1}, "start needs measures, which are taken from then on; got start=0.1 and none"),
            ({"start": 0.2, "measures": "pressure"}, r"start must lie before the end of the run, at time 0\.2; got 0"),
        ):
            with pytest.raises(InputError, match=text):
                sim.run(frames=20, **arguments)
        assert sim.frame == 0
        report = sim.run(frames=1, measures="temperature")
        with pytest.raises(mpsim.errors.NotRecordedError, match=r"pressure was not recorded.*measures=\['pressure'\]"):
            report.measures["pressure"]


def test_what_has_left_does_not_count_in_a_run():
    """Half of the discs leave at once: the temperature is that of the others, which fly on for ever."""
    with simulate(box_of(position=[[2, 2], [5, 6]], velocity=[[0, -50], [3, 0]], absorbing="bottom"),
                  method="naive", contact="impact") as sim:  # fmt: skip
        sim.run(until=0.5)
        found = sim.run(frames=60, measures=SAMPLED).measures
        assert [found[name].value for name in SAMPLED] == pytest.approx([4.5, 4.5, 1], rel=1e-12)
        sim.remove(1)
        report = sim.run(frames=3, measures=["temperature"])
        assert np.isnan(report.measures["temperature"].value), "of nobody"


@pytest.mark.parametrize(
    ("change", "lost"),
    [
        (lambda sim: None, set()),  # the control
        (lambda sim: sim.kick(0, (0.5, 0.0)), {"pressure_virial", "energy_drift"}),
        (lambda sim: sim.change(gravity=(0.0, -1.0)), {"pressure_virial", "pressure_xx", "energy_drift"}),
        (lambda sim: sim.remove([3, 4]), {"pressure_virial", "pressure_xx", "energy_drift", "collision_rate"}),
        (lambda sim: sim.add((2.0, sim.scene.height - 2), (0.0, 0.0), mass=2.0),
         {"pressure_virial", "pressure_xx", "energy_drift", "kinetic_energy"}),
    ],
    ids=["nothing", "kick", "gravity", "remove", "add"],
)  # fmt: skip
def test_what_a_change_in_the_run_makes_wrong_is_nan_and_nothing_else(change, lost):
    names = {"pressure", "pressure_virial", "pressure_xx", "collision_rate", "kinetic_energy", "energy_drift"}
    below = gas(16, 0.35, seed=3)
    scene = Scene(width=below.width, height=below.height + 6, position=below.position, velocity=below.velocity,
                  radius=0.5, mass=np.linspace(1, 2, 16))  # fmt: skip
    with simulate(scene, method="naive", dt=0.05) as sim:
        found = sim.run(frames=20, measures=names, observe=At(10, change)).measures
        assert {name for name in names if np.isnan(found[name].value)} == lost
        if sim.count > 16:
            with pytest.raises(InputError, match=r"only where the scene holds the mass of every disc; it has 16"):
                sim.run(frames=1, measures="temperature")
