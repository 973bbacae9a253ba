"""Friction, spins, thermostats and thermal walls as arguments: of scenes, files, states; what each brings with it."""

import dataclasses
import math

import numpy as np
import pytest
from support.commands import mpsim_command
from support.refusals import GOOD, assert_refused
from support.scenes import gas, simulate

import mpsim
from mpsim import InputError, Scene, State, ThermalWalls, Thermostat, measure

pytestmark = pytest.mark.plain

BATH = Thermostat(temperature=2.0, rate=0.5, seed=7)
WALLS = ThermalWalls(left=1.0, right=4.0, seed=7)
ROUGH = {"friction": 0.5, "wall_friction": math.inf, "tangential_restitution": 0.25, "spin": [1.5, -2.0]}
FEATURES = {"rough": ROUGH, "bath": {"thermostat": BATH}, "walls": {"thermal_walls": WALLS}}
SHOWN = {
    "rough": "0.5 of discs, inf of walls, tangential restitution 0.25",
    "bath": "temperature 2, rate 0.5, seed 7",
    "walls": "left 1, right 4, seed 7",
}


def scene_of(**more):
    return Scene(**GOOD | more)


# --- what is refused

WRONG = {
    Thermostat: (
        {"temperature": 1.0, "rate": 1.0},
        [
            ({"rate": 0.0}, ["rate of a Thermostat must be a finite number > 0"]),
            ({"seed": 1.5}, ["seed of a Thermostat must be a whole number", "1.5"]),
        ],
    ),
    ThermalWalls: ({}, [({"left": 0}, ["left of ThermalWalls must be a finite number > 0", "0"])]),
    scene_of: (
        {},
        [
            ({"tangential_restitution": 1.01}, ["tangential_restitution", "from -1 to 1", "1.01"]),
            ({"spin": [1.0]}, ["spin", "(2,)", "(1,)"]),
            ({"thermostat": {"temperature": 1.0, "rate": 1.0}}, ["thermostat must be an mpsim.Thermostat"]),
            ({"thermal_walls": WALLS, "boundary": "periodic"}, ["must name a wall", "'left'", "periodic along x"]),
            ({"thermal_walls": WALLS, "absorbing": "right"}, ["must not be absorbing edges", "'right'"]),
            ({"thermal_walls": WALLS, "piston": mpsim.Piston("left", 1, 3)}, ["must be at rest", "'left'", "piston"]),
            ({"thermal_walls": WALLS, "wall_friction": 0.5}, ["wall_friction must be 0", "thermal_walls", "0.5"]),
        ],
    ),
}


@pytest.mark.parametrize("make", WRONG)
def test_what_cannot_be_is_refused(make):
    good, table = WRONG[make]
    for change, parts in table:
        assert_refused(parts, make, **good | change)
    beside = {"absorbing": "top", "piston": mpsim.Piston("bottom", 1, 3), "friction": 0.5}
    scene_of(thermal_walls=WALLS, **beside)  # the control


def test_a_file_says_which_key_is_wrong(tmp_path):
    path = tmp_path / "a.toml"
    for text, parts in (
        ("[thermostat]\ntemprature = 1.0\nrate = 1.0", ["temprature", "temperature"]),
        ("[thermal_walls]\nleft = 1.0\nseed = 0.5", ["thermal_walls.seed", "0.5"]),
        ("[[discs]]\nposition = [[2.0, 2.0]]\nradius = 0.5\nspin = [1.0, 2.0]", ["spin must be one number or 1, one"]),
    ):
        path.write_text(f"schema = 1\nwidth = 8\nheight = 6\n{text}\n")
        with pytest.raises(InputError) as caught:
            Scene.load(path)
        assert all(part in str(caught.value) for part in parts), caught.value


def test_the_law_of_the_report_has_no_impulse_for_friction():
    parts = ["law must be 'elastic'", "friction", "'reflect'"]
    assert_refused(parts, simulate, scene_of(**ROUGH), law="reflect", method="grid")


# --- what a scene is with and without


@pytest.mark.parametrize(
    ("name", "change"),
    [
        *(("rough", change) for change in (
            {"friction": 0.25}, {"wall_friction": 1.0}, {"tangential_restitution": 0.5}, {"spin": [1.5, 2.0]})),
        *(("bath", {"thermostat": dataclasses.replace(BATH, **change)}) for change in (
            {"temperature": 2.5}, {"rate": 0.25}, {"seed": 8})),
        *(("walls", {"thermal_walls": dataclasses.replace(WALLS, **change)}) for change in (
            {"left": 2.0}, {"right": None}, {"top": 1.0}, {"seed": 8})),
    ],
)  # fmt: skip
def test_each_number_is_in_the_digest_of_a_scene(name, change):
    assert scene_of(**FEATURES[name]).digest() != scene_of(**FEATURES[name] | change).digest()


@pytest.mark.parametrize("name", FEATURES)
def test_show_tells_it(name, tmp_path):
    scene_of(**FEATURES[name]).save(tmp_path / "a.toml")
    assert SHOWN[name] in mpsim_command("show", tmp_path / "a.toml").output


def test_spins_of_many_are_in_a_file_beside_and_groups_may_spin_or_not(tmp_path):
    many = Scene.random(count=100, packing=0.1, radius=0.5, friction=0.5, spin=np.arange(100.0))
    many.save(tmp_path / "b.toml")
    assert (tmp_path / "b.spin.npy").exists()
    assert Scene.load(tmp_path / "b.toml").digest() == many.digest()
    groups = "[[discs]]\nposition = [[2.0, 2.0], [4.0, 3.0]]\nradius = 0.5\nspin = 2.5\n"
    groups += "[[discs]]\nposition = [[6.0, 4.0]]\nradius = 0.5\n"
    (tmp_path / "a.toml").write_text("schema = 1\nwidth = 8\nheight = 6\nfriction = 0.5\n" + groups)
    assert Scene.load(tmp_path / "a.toml").spin.tolist() == [2.5, 2.5, 0.0]
    assert scene_of(spin=3).spin.tolist() == [3.0, 3.0]


@pytest.mark.parametrize("name", ["bath", "walls"])
def test_other_starts_have_other_random_numbers(name):
    """Else the discs of all runs of an ensemble would get the same velocities, and their mean would not be one."""
    attribute = {"bath": "thermostat", "walls": "thermal_walls"}[name]
    scene = gas(20, 0.1, **FEATURES[name])
    given = getattr(scene, attribute)
    other = scene.starting_from(State(scene.position, -scene.velocity))
    starts = [scene, *map(scene.redrawn, range(9)), scene.starting_from(State(scene.position, scene.velocity)), other]
    seeds = [getattr(start, attribute).seed for start in starts]
    assert len(set(seeds)) == 12
    assert getattr(scene.redrawn(3), attribute) == dataclasses.replace(given, seed=seeds[4])
    assert scene.redrawn(3).digest() == scene.redrawn(3).digest()


# --- spins in states and trajectories


def test_a_scene_starts_from_the_spins_of_a_state():
    scene, spins = scene_of(**ROUGH), np.array([0.5, 0.25])
    flight = scene.position, scene.velocity
    assert scene.starting_from(State(*flight, spin=spins)).spin.tolist() == [0.5, 0.25]
    assert scene.starting_from(State(*flight, spin=spins, present=np.array([False, True]))).spin.tolist() == [0.25]
    assert scene.starting_from(State(*flight)).digest() == scene.digest(), "its own otherwise"
    assert scene_of().starting_from(State(*flight, spin=spins)).spin is None
    for wrong in (np.zeros(1), np.zeros(2, int)):
        with pytest.raises(InputError, match="spin of a state must be real numbers of shape"):
            State(*flight, spin=wrong)


@pytest.mark.parametrize("suffix", ["xyz", "gsd"])
def test_a_trajectory_in_single_precision_has_all_to_the_bit_and_spins(suffix, tmp_path):
    with simulate(scene_of(**ROUGH), method="naive", dt=0.1, precision="float32") as sim:
        with mpsim.Trajectory.write(tmp_path / f"a.{suffix}", every=3) as out:
            sim.run(frames=9, observe=out)
        last = mpsim.Trajectory(tmp_path / f"a.{suffix}")[-1]
        assert last.state.digest() == sim.digest()
        assert (last.spin.dtype, last.velocity.dtype) == ("float32", "float32")


def test_a_trajectory_of_smooth_discs_says_where_spins_would_be(tmp_path):
    with simulate(scene_of(), method="naive") as sim, mpsim.Trajectory.write(tmp_path / "a.xyz") as out:
        sim.run(frames=1, observe=out)
    with pytest.raises(mpsim.errors.TrajectoryError, match="spin must be in a trajectory") as caught:
        _ = mpsim.Trajectory(tmp_path / "a.xyz")[0].spin
    where = "the column spin:R:1 (extended XYZ) or log/particles/mpsim/spin (GSD)"
    assert str(caught.value).endswith(f"Have the program that wrote it write {where}, too.")


def test_kinetic_energy_counts_the_rotation_of_uniform_discs():
    """m r^2 w^2 / 4 of each disc."""
    scene = scene_of(mass=[1.0, 4.0], velocity=[[2, 0], [0, 0]], spin=[3.0, 2.0])
    flight = scene.position, scene.velocity
    state = State(*flight, spin=scene.spin)
    assert measure.rotational_energy(state, scene) == 0.25 * (0.25 * 9 + 4 * 0.25 * 4)
    assert measure.kinetic_energy(state, scene) == 2 + measure.rotational_energy(state, scene)
    assert measure.temperature(state, scene) == measure.temperature(State(*flight), scene)
    assert measure.rotational_energy(State(*flight), scene) == 0
    gone = State(*flight, spin=scene.spin, present=np.array([True, False]))
    assert measure.rotational_energy(gone, scene) == 0.25 * 0.25 * 9


# --- measures and observers of rough walls: what a wall takes from a disc, along its normal and across


def oblique(**features):
    """One disc that hits the left wall obliquely."""
    return mpsim.Scene(width=10, height=10, radius=0.5, position=[[1, 5]], velocity=[[-1, 1]], **features)


@pytest.mark.parametrize(
    ("study", "asked"),
    [(mpsim.tradeoff, {"measures": ["momentum_drift"]}), (mpsim.tune, {"max_error": {"momentum_drift": 1e-3}})],
)
def test_studies_refuse_momentum_drift_where_rough_walls_take_momentum(study, asked):
    with pytest.raises(mpsim.InputError, match="only without rough walls, whose tangential impulses are not counted"):
        study(oblique(wall_friction=0.5), **asked)


def test_momentum_drift_remains_where_only_discs_are_rough():
    scene = mpsim.Scene.random(count=12, packing=0.3, radius=0.5, seed=1, wall_friction=0.5, boundary="periodic")
    with simulate(scene, method="event") as sim:
        assert sim.run(until=2.0, measures=["momentum_drift"]).measures["momentum_drift"].value < 1e-8


TAKING = {"rough": {"wall_friction": 0.7}, "thermal": {"thermal_walls": mpsim.ThermalWalls(left=2.0)}}


def rough(walls):
    """Rough discs of two masses that meet each other, such walls, and an obstacle."""
    return mpsim.Scene.random(
        count=16, width=6, height=6, radius=0.5, seed=2, mass=np.where(np.arange(16) % 2, 1.0, 3.0), friction=0.4,
        restitution=0.9, obstacles=mpsim.FixedDisc((3, 3), 0.4), **TAKING[walls],
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
@pytest.mark.parametrize(
    ("method", "contact", "walls"),
    [
        ("event", "impact", "rough"),
        ("grid", "impact", "rough"),
        ("naive", "push", "rough"),
        ("event", "impact", "thermal"),
        ("grid", "impact", "thermal"),
    ],
)
def test_both_impulses_of_all_collisions_are_the_change_of_each_momentum(method, contact, walls):
    scene, seen = rough(walls), mpsim.Collisions()
    sensors = [mpsim.Sensor(wall="bottom"), mpsim.Sensor(wall="left"), mpsim.Sensor(obstacle=0)]
    with simulate(scene, method=method, contact=contact, dt=0.02) as sim:
        sim.run(frames=60, observe=[seen, *sensors])
        gained = scene.masses[:, None] * (sim.state.velocity - scene.velocity)
    table = seen.table
    given = {name: np.zeros((scene.count, 2)) for name in ("impulse", "tangential_impulse")}
    for name, total in given.items():
        np.add.at(total, table["i"], table[name])
        discs = table[table["kind"] == 0]
        np.subtract.at(total, discs["j"], discs[name])
    assert gained == pytest.approx(given["impulse"] + given["tangential_impulse"], abs=1e-9)
    assert np.abs(gained - given["impulse"]).max() > 0.1, "the control: without friction it does not add up"
    across = (table["impulse"] * table["tangential_impulse"]).sum(axis=1)
    assert np.abs(across).max() < 1e-9, "they are at right angles"
    chosen = (table["kind"] == 1) & (table["j"] == 2), (table["kind"] == 1) & (table["j"] == 0), table["kind"] == 2
    for sensor, rows in zip(sensors, chosen, strict=True):
        for name in given:
            assert getattr(sensor, name).sum() == pytest.approx(np.hypot(*table[name][rows].T).sum())
            assert (getattr(sensor, name).sum() > 0) == (name == "impulse" or walls == "rough" or sensor is sensors[1])


def test_smooth_discs_have_no_tangential_impulse():
    seen = mpsim.Collisions()
    with simulate(oblique(), method="event") as sim:
        sim.run(until=1.0, observe=seen)
    assert (len(seen.table), seen.table["impulse"].tolist()) == (1, [[2.0, 0.0]])
    assert np.signbit(seen.table["tangential_impulse"]).tolist() == [[False, False]]
    assert not seen.table["tangential_impulse"].any()
