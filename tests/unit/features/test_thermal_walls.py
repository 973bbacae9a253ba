"""Thermal walls as an argument: of scenes, scene files, checkpoints; what is refused, and what is said."""

import dataclasses
import math

import pytest
from click.testing import CliRunner
from support.refusals import GOOD, assert_says
from support.scenes import gas, simulate

import mpsim
from mpsim import InputError, Scene, State, ThermalWalls
from mpsim.cli.app import main
from mpsim.engine.feature_arrays import feature_specs
from mpsim.measure import driving

WALLS = ThermalWalls(left=1.0, right=4.0, seed=7)


def test_a_scene_without_any_is_what_it_was():
    plain, spelt = Scene(**GOOD), Scene(**GOOD, thermal_walls=None)
    assert plain.thermal_walls is None
    assert spelt.digest() == plain.digest()
    assert vars(spelt).keys() == vars(plain).keys(), "nothing that a pickle or a digest could show"
    assert "thermal_walls" not in feature_specs(plain, 2, "float64")
    assert "thermal_walls" in feature_specs(Scene(**GOOD, thermal_walls=WALLS), 2, "float64")


@pytest.mark.parametrize("change", [{"left": 2.0}, {"right": None}, {"top": 1.0}, {"seed": 8}])
def test_each_number_is_in_the_digest_of_a_scene(change):
    other = dataclasses.replace(WALLS, **change)
    assert Scene(**GOOD, thermal_walls=WALLS).digest() != Scene(**GOOD, thermal_walls=other).digest()


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ({}, ["ThermalWalls must have a temperature", "got none"]),
        ({"seed": 3}, ["ThermalWalls must have a temperature"]),
        ({"left": 0}, ["left of ThermalWalls must be a finite number > 0", "0"]),
        ({"right": -1.0}, ["right of ThermalWalls must be a finite number > 0", "-1"]),
        ({"bottom": math.nan}, ["bottom of ThermalWalls", "nan"]),
        ({"top": math.inf}, ["top of ThermalWalls", "inf"]),
        ({"top": "hot"}, ["top of ThermalWalls", "'hot'"]),
        ({"left": True}, ["left of ThermalWalls", "True"]),
        ({"left": [1.0, 2.0]}, ["left of ThermalWalls"]),
        ({"left": 1.0, "seed": -1}, ["seed of ThermalWalls must be a whole number", "-1"]),
        ({"left": 1.0, "seed": 0.5}, ["seed of ThermalWalls must be a whole number", "0.5"]),
    ],
)
def test_what_cannot_be_is_refused(arguments, parts):
    with pytest.raises(InputError) as caught:
        ThermalWalls(**arguments)
    assert_says(caught, parts)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ({"thermal_walls": 1.0}, ["thermal_walls must be mpsim.ThermalWalls", "1.0"]),
        ({"thermal_walls": {"left": 1.0}}, ["thermal_walls must be mpsim.ThermalWalls"]),
        ({"boundary": "periodic"}, ["thermal_walls must name a wall", "'left'", "periodic along x"]),
        ({"absorbing": "right"}, ["thermal_walls must not be absorbing edges", "'right'"]),
        ({"piston": mpsim.Piston("left", 1, 3)}, ["thermal_walls must be at rest", "'left'", "piston"]),
        ({"wall_friction": 0.5}, ["wall_friction must be 0", "thermal_walls", "0.5"]),
    ],
)
def test_a_scene_refuses_what_does_not_go_with_them(arguments, parts):
    with pytest.raises(InputError) as caught:
        Scene(**GOOD | {"thermal_walls": WALLS} | arguments)
    assert_says(caught, parts)
    Scene(
        **GOOD, thermal_walls=WALLS, absorbing="top", piston=mpsim.Piston("bottom", 1, 3), friction=0.5
    )  # the control


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        ("left = -1.0", ["thermal_walls.left must be a finite number > 0", "-1"]),
        ("right = nan", ["thermal_walls.right", "nan"]),
        ("top = 'hot'", ["thermal_walls.top", "'hot'"]),
        ("seed = 3", ["must have a temperature"]),
        ("left = 1.0\nseed = 0.5", ["thermal_walls.seed", "0.5"]),
        ("lft = 1.0", ["lft", "left"]),
    ],
)
def test_a_file_says_which_key_is_wrong(line, parts, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(f"schema = 1\nwidth = 8\nheight = 6\n[thermal_walls]\n{line}\n")
    with pytest.raises(InputError) as caught:
        Scene.load(path)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.usefixtures("compiled_when_run")
def test_files_and_checkpoints_hold_them(tmp_path):
    scene = Scene(**GOOD, thermal_walls=WALLS)
    scene.save(tmp_path / "a.toml")
    assert Scene.load(tmp_path / "a.toml").digest() == scene.digest()
    with simulate(scene, method="naive", dt=0.1) as sim:
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.scene.thermal_walls == WALLS


def test_show_describes_them(tmp_path):
    Scene(**GOOD, thermal_walls=WALLS).save(tmp_path / "a.toml")
    assert "left 1, right 4, seed 7" in CliRunner().invoke(main, ["show", str(tmp_path / "a.toml")]).output


def test_other_starts_have_other_random_numbers():
    scene = gas(20, 0.1, thermal_walls=WALLS)
    seeds = [scene.thermal_walls.seed, *(scene.redrawn(seed).thermal_walls.seed for seed in range(9))]
    seeds.append(scene.starting_from(State(scene.position, scene.velocity)).thermal_walls.seed)
    assert len(set(seeds)) == 11
    assert scene.redrawn(3).thermal_walls == dataclasses.replace(WALLS, seed=seeds[4])


@pytest.mark.slow
def test_a_gas_between_them_does_not_conserve_its_energy():
    scene = gas(20, 0.1, thermal_walls=WALLS)
    assert driving.is_heated(scene)
    assert not driving.conserves_energy(scene)
    assert driving.thermal_speed(scene) == 2.0
    with simulate(scene, method="naive", dt=0.01) as sim:
        for name in ("energy_drift", "momentum_drift", "pressure_virial"):
            with pytest.raises(InputError) as caught:
                sim.run(frames=1, measures=[name])
            assert_says(caught, [name, "thermal walls"])
