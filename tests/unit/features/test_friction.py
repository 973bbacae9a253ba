"""Friction and spin as arguments: of scenes, scene files, states, added discs; what is refused, and what is said."""

import math

import numpy as np
import pytest
from click.testing import CliRunner
from support.refusals import GOOD, assert_says
from support.scenes import gas, simulate

import mpsim
from mpsim import InputError, Scene, Settings, Simulation, State, measure
from mpsim.cli.app import main
from mpsim.engine.feature_arrays import feature_specs

ROUGH = {"friction": 0.5, "wall_friction": math.inf, "tangential_restitution": 0.25, "spin": [1.5, -2.0]}


def rough(**more):
    return Scene(**GOOD | ROUGH | more)


# --- scenes


def test_a_scene_of_smooth_discs_is_what_it_was():
    plain = Scene(**GOOD)
    assert (plain.friction, plain.wall_friction, plain.tangential_restitution, plain.spin) == (0, 0, 0, None)
    spelt = Scene(**GOOD, friction=0, wall_friction=0.0, tangential_restitution=0, spin=None)
    assert spelt.digest() == plain.digest()
    assert vars(spelt).keys() == vars(plain).keys(), "nothing that a pickle or a digest could show"
    assert "friction" not in repr(plain)


@pytest.mark.parametrize("name", ROUGH)
def test_each_argument_is_in_the_digest_of_a_scene(name):
    other = {"friction": 0.25, "wall_friction": 1.0, "tangential_restitution": 0.5, "spin": [1.5, 2.0]}
    assert rough().digest() != rough(**{name: other[name]}).digest()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [({}, False), ({"friction": 0.1}, True), ({"wall_friction": 1}, True), ({"spin": 0}, True)],
)
def test_discs_spin_where_contacts_or_the_scene_let_them(arguments, expected):
    arrays = feature_specs(Scene(**GOOD, **arguments), 2, "float64")
    assert ("spin" in arrays) == expected
    assert [name for name in arrays if name != "spin"] == [name for name in arguments if name != "spin"]


def test_one_spin_for_all_is_one_each():
    assert rough(spin=3).spin.tolist() == [3.0, 3.0]


@pytest.mark.parametrize(
    ("name", "value", "parts"),
    [
        ("friction", -0.1, ["friction must be a number >= 0", "-0.1"]),
        ("friction", math.nan, ["friction", ">= 0", "nan"]),
        ("friction", "much", ["friction", "'much'"]),
        ("wall_friction", True, ["wall_friction", "True"]),
        ("tangential_restitution", 1.01, ["tangential_restitution", "from -1 to 1", "1.01"]),
        ("tangential_restitution", math.nan, ["tangential_restitution", "nan"]),
        ("spin", [1.0], ["spin", "(2,)", "(1,)"]),
        ("spin", [0.0, math.inf], ["spin must be finite", "inf"]),
        ("spin", "fast", ["spin", "fast"]),
    ],
)
def test_what_cannot_be_is_refused(name, value, parts):
    with pytest.raises(InputError) as caught:
        rough(**{name: value})
    assert_says(caught, parts)


def test_the_law_of_the_report_has_no_impulse_for_friction():
    with pytest.raises(InputError) as caught:
        Simulation(rough(), Settings(law="reflect", method="grid"))
    assert_says(caught, ["law must be 'elastic'", "friction", "'reflect'"])


def test_spins_that_single_precision_cannot_hold_are_refused():
    with pytest.raises(InputError) as caught:
        Simulation(rough(spin=1e30), Settings(precision="float32", method="grid"))
    assert_says(caught, ["spin must be at most", "float32"])


def test_a_scene_starts_from_the_spins_of_a_state():
    scene = rough()
    spins = np.array([0.5, 0.25])
    assert scene.starting_from(State(scene.position, scene.velocity, spin=spins)).spin.tolist() == [0.5, 0.25]
    kept = State(scene.position, scene.velocity, spin=spins, present=np.array([False, True]))
    assert scene.starting_from(kept).spin.tolist() == [0.25]
    assert scene.starting_from(State(scene.position, scene.velocity)).digest() == scene.digest(), "its own otherwise"
    assert Scene(**GOOD).starting_from(State(scene.position, scene.velocity, spin=spins)).spin is None


# --- files


def test_a_scene_file_has_all_of_it(tmp_path):
    scene = rough()
    scene.save(tmp_path / "a.toml")
    assert Scene.load(tmp_path / "a.toml").digest() == scene.digest()
    many = Scene.random(count=100, packing=0.1, radius=0.5, friction=0.5, spin=np.arange(100.0))
    many.save(tmp_path / "b.toml")
    assert (tmp_path / "b.spin.npy").exists()
    assert Scene.load(tmp_path / "b.toml").digest() == many.digest()


def test_groups_of_discs_in_a_file_may_spin_or_not(tmp_path):
    path = tmp_path / "a.toml"
    head = "schema = 1\nwidth = 8\nheight = 6\nfriction = 0.5\n"
    groups = "[[discs]]\nposition = [[2.0, 2.0], [4.0, 3.0]]\nradius = 0.5\nspin = 2.5\n"
    groups += "[[discs]]\nposition = [[6.0, 4.0]]\nradius = 0.5\n"
    path.write_text(head + groups)
    assert Scene.load(path).spin.tolist() == [2.5, 2.5, 0.0]
    path.write_text(head.replace("0.5", "-0.5") + groups.replace("2.5", "[1.0, 2.0, 3.0]"))
    with pytest.raises(InputError, match="friction must be a number >= 0"):
        Scene.load(path)
    path.write_text(head + groups.replace("2.5", "[1.0, 2.0, 3.0]"))
    with pytest.raises(InputError, match="spin must be one number or 2, one per disc; got 3"):
        Scene.load(path)


def test_show_describes_it(tmp_path):
    rough().save(tmp_path / "a.toml")
    shown = CliRunner().invoke(main, ["show", str(tmp_path / "a.toml")])
    assert "0.5 of discs, inf of walls, tangential restitution 0.25" in shown.output
    assert '"friction": 0.5' in CliRunner().invoke(main, ["show", str(tmp_path / "a.toml"), "--json"]).output


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["xyz", "gsd"])
@pytest.mark.parametrize("precision", [pytest.param("float32", marks=pytest.mark.long), "float64"])
def test_a_trajectory_has_the_spins_to_the_bit(suffix, precision, tmp_path):
    with simulate(rough(), method="naive", dt=0.1, precision=precision) as sim:
        with mpsim.Trajectory.write(tmp_path / f"a.{suffix}", every=3) as out:
            sim.run(frames=9, observe=out)
        last = mpsim.Trajectory(tmp_path / f"a.{suffix}")[-1]
        assert last.state.digest() == sim.digest()
        assert last.spin.dtype == precision


def test_a_trajectory_of_smooth_discs_says_that_it_has_no_spins(tmp_path):
    writer = mpsim.Trajectory.write(tmp_path / "a.xyz", every=3)
    with simulate(Scene(**GOOD), method="naive", dt=0.1) as sim, writer as out:
        sim.run(frames=3, observe=out)
    with pytest.raises(mpsim.errors.TrajectoryError, match="spin must be in a trajectory"):
        _ = mpsim.Trajectory(tmp_path / "a.xyz")[0].spin


@pytest.mark.parametrize("spin", [np.zeros(1), np.zeros(2, int), np.zeros((2, 2))])
def test_a_state_has_a_spin_of_each_disc(spin):
    with pytest.raises(InputError, match="spin of a state must be real numbers of shape"):
        State(np.zeros((2, 2)), np.zeros((2, 2)), spin=spin)


# --- simulations


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_when_run")
@pytest.mark.parametrize("method", ["naive", "event"])
def test_discs_are_added_with_a_spin_or_without(method):
    with simulate(rough(), method=method, dt=0.1) as sim:
        sim.add([6.0, 4.0], [0.0, 0.0], spin=2.5)
        sim.add([[6.0, 1.5], [1.0, 4.5]], np.zeros((2, 2)))
        assert sim.state.spin.tolist() == [1.5, -2.0, 2.5, 0.0, 0.0]


@pytest.mark.usefixtures("compiled_when_run")
@pytest.mark.parametrize(
    ("arguments", "spin", "match"),
    [
        ({}, 1.0, "only in a scene of rough discs"),
        (ROUGH, [1.0, 2.0], "spin must have shape"),
        (ROUGH, math.nan, "spin must be finite"),
    ],
)
def test_spins_of_added_discs_are_checked(arguments, spin, match):
    with simulate(Scene(**GOOD, **arguments), method="naive", dt=0.1) as sim:
        with pytest.raises(InputError, match=match):
            sim.add([6.0, 4.0], [0.0, 0.0], spin=spin)
        assert sim.count == 2


@pytest.mark.slow
def test_the_virial_is_refused_and_the_pressure_on_walls_is_not():
    with simulate(rough(wall_friction=0.5), method="naive", dt=0.1) as sim:
        with pytest.raises(InputError, match="friction"):
            sim.run(frames=1, measures=["pressure_virial"])
        assert sim.run(frames=10, measures=["pressure"]).measures["pressure"].value >= 0


# --- energy


def test_kinetic_energy_counts_the_rotation_of_uniform_discs():
    scene = Scene(**GOOD | {"mass": [1.0, 4.0], "velocity": [[2, 0], [0, 0]], "spin": [3.0, 2.0]})
    state = State(scene.position, scene.velocity, spin=scene.spin)
    assert measure.rotational_energy(state, scene) == 0.25 * (0.25 * 9 + 4 * 0.25 * 4)
    assert measure.kinetic_energy(state, scene) == 2 + measure.rotational_energy(state, scene)
    assert measure.temperature(state, scene) == measure.temperature(State(scene.position, scene.velocity), scene)
    assert measure.rotational_energy(State(scene.position, scene.velocity), scene) == 0
    gone = State(scene.position, scene.velocity, spin=scene.spin, present=np.array([True, False]))
    assert measure.rotational_energy(gone, scene) == 0.25 * 0.25 * 9


@pytest.mark.long
def test_the_energy_drift_of_rough_elastic_discs_is_rounding():
    scene = gas(40, 0.3, friction=math.inf, tangential_restitution=1.0, spin=2.0)
    with simulate(scene, method="naive", dt=0.02, contact="impact") as sim:
        assert abs(sim.run(frames=50, measures=["energy_drift"]).measures["energy_drift"].value) < 1e-12
    assert scene.dissipates, "energy of translation is not kept"
