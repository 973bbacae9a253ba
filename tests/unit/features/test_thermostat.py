"""A thermostat as an argument: of scenes, scene files, checkpoints; what is refused, and what is said."""

import dataclasses
import math

import numpy as np
import pytest
from click.testing import CliRunner
from support.refusals import GOOD, assert_says
from support.scenes import gas, simulate

import mpsim
from mpsim import InputError, Scene, State, Thermostat
from mpsim.cli.app import main
from mpsim.engine.feature_arrays import feature_specs
from mpsim.engine.step_limits import StepLimits
from mpsim.features.thermostat import probability_of
from mpsim.measure import driving

BATH = Thermostat(temperature=2.0, rate=0.5, seed=7)


def test_a_scene_without_one_is_what_it_was():
    plain, spelt = Scene(**GOOD), Scene(**GOOD, thermostat=None)
    assert plain.thermostat is None
    assert spelt.digest() == plain.digest()
    assert vars(spelt).keys() == vars(plain).keys(), "nothing that a pickle or a digest could show"
    assert "thermostat" not in feature_specs(plain, 2, "float64")
    assert "thermostat" in feature_specs(Scene(**GOOD, thermostat=BATH), 2, "float64")


@pytest.mark.parametrize("change", [{"temperature": 2.5}, {"rate": 0.25}, {"seed": 8}])
def test_each_number_is_in_the_digest_of_a_scene(change):
    other = dataclasses.replace(BATH, **change)
    assert Scene(**GOOD, thermostat=BATH).digest() != Scene(**GOOD, thermostat=other).digest()


WRONG = [
    ({"temperature": -1.0}, ["temperature of a Thermostat must be a finite number > 0", "-1"]),
    ({"temperature": 0}, ["temperature of a Thermostat must be a finite number > 0"]),
    ({"temperature": math.nan}, ["temperature of a Thermostat", "nan"]),
    ({"temperature": "warm"}, ["temperature of a Thermostat", "'warm'"]),
    ({"temperature": True}, ["temperature of a Thermostat", "True"]),
    ({"rate": 0.0}, ["rate of a Thermostat must be a finite number > 0"]),
    ({"rate": -0.5}, ["rate of a Thermostat must be a finite number > 0", "-0.5"]),
    ({"rate": math.inf}, ["rate of a Thermostat", "inf"]),
    ({"rate": [1.0, 2.0]}, ["rate of a Thermostat"]),
    ({"seed": -1}, ["seed of a Thermostat must be a whole number", "-1"]),
    ({"seed": 1.5}, ["seed of a Thermostat must be a whole number", "1.5"]),
    ({"seed": 2**63}, ["seed of a Thermostat"]),
    ({"seed": "seven"}, ["seed of a Thermostat", "'seven'"]),
]


@pytest.mark.parametrize(("change", "parts"), WRONG)
def test_what_cannot_be_is_refused(change, parts):
    with pytest.raises(InputError) as caught:
        Thermostat(**{"temperature": 1.0, "rate": 1.0} | change)
    assert_says(caught, parts)


@pytest.mark.parametrize("value", [1.0, "andersen", {"temperature": 1.0, "rate": 1.0}, mpsim.Piston("left", 1, 2)])
def test_a_scene_takes_nothing_but_a_thermostat(value):
    with pytest.raises(InputError) as caught:
        Scene(**GOOD, thermostat=value)
    assert_says(caught, ["thermostat must be an mpsim.Thermostat"])


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        ("temperature = -1.0\nrate = 1.0", ["thermostat.temperature must be a finite number > 0", "-1"]),
        ("temperature = nan\nrate = 1.0", ["thermostat.temperature", "nan"]),
        ("temperature = 'warm'\nrate = 1.0", ["thermostat.temperature", "'warm'"]),
        ("temperature = 1.0\nrate = 0", ["thermostat.rate must be a finite number > 0"]),
        ("temperature = 1.0", ["thermostat.rate"]),
        ("temperature = 1.0\nrate = 1.0\nseed = 0.5", ["thermostat.seed"]),
        ("temprature = 1.0\nrate = 1.0", ["temprature", "temperature"]),
    ],
)
def test_a_file_says_which_key_is_wrong(line, parts, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(f"schema = 1\nwidth = 8\nheight = 6\n[thermostat]\n{line}\n")
    with pytest.raises(InputError) as caught:
        Scene.load(path)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.usefixtures("compiled_when_run")
def test_files_and_checkpoints_hold_it(tmp_path):
    scene = Scene(**GOOD, thermostat=BATH)
    scene.save(tmp_path / "a.toml")
    assert Scene.load(tmp_path / "a.toml").digest() == scene.digest()
    with simulate(scene, method="naive", dt=0.1) as sim:
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.scene.thermostat == BATH


def test_show_describes_it(tmp_path):
    Scene(**GOOD, thermostat=BATH).save(tmp_path / "a.toml")
    assert "temperature 2, rate 0.5, seed 7" in CliRunner().invoke(main, ["show", str(tmp_path / "a.toml")]).output
    assert "thermostat" in repr(Scene(**GOOD, thermostat=BATH))


def test_other_starts_have_other_random_numbers():
    """Else the discs of all runs of an ensemble would get the same velocities, and their mean would not be one."""
    scene = gas(20, 0.1, thermostat=BATH)
    seeds = [scene.thermostat.seed, *(scene.redrawn(seed).thermostat.seed for seed in range(9))]
    assert len(set(seeds)) == 10
    assert scene.redrawn(3).digest() == scene.redrawn(3).digest()
    again = scene.starting_from(State(scene.position, scene.velocity))
    assert again.thermostat.seed not in seeds
    other = scene.starting_from(State(scene.position, -scene.velocity))
    assert len({again.thermostat.seed, other.thermostat.seed}) == 2
    assert again.thermostat == dataclasses.replace(BATH, seed=again.thermostat.seed)


def test_the_probability_of_a_frame_is_that_of_its_length():
    assert probability_of(BATH, 0.01) == pytest.approx(-math.expm1(-0.005), rel=1e-15)
    assert probability_of(BATH, 1e9) == 1.0
    assert 0 < probability_of(BATH, 1e-300) < 1e-299
    assert (1 - probability_of(BATH, 0.5)) ** 2 == pytest.approx(1 - probability_of(BATH, 1.0), rel=1e-14)


@pytest.mark.slow
def test_a_heated_gas_does_not_conserve_its_energy():
    scene = gas(20, 0.1, thermostat=BATH)
    assert driving.is_heated(scene)
    assert not driving.conserves_energy(scene)
    assert driving.conserves_energy(gas(20, 0.1)), "the control"
    with simulate(scene, method="naive", dt=0.01) as sim:
        for name in ("energy_drift", "momentum_drift", "pressure_virial"):
            with pytest.raises(InputError) as caught:
                sim.run(frames=1, measures=[name])
            assert_says(caught, [name, "thermostat"])


def test_speeds_at_the_temperature_of_the_bath_are_warned_of_at_the_start():
    hot = mpsim.Settings(dt=0.1, method="naive")
    cold = Scene(**GOOD | {"velocity": np.zeros((2, 2))})
    text = StepLimits(Scene(**GOOD, thermostat=Thermostat(400.0, 0.5)), hot, True).forecast()
    assert "at the temperature of the heat bath" in text
    assert StepLimits(Scene(**GOOD, thermostat=Thermostat(0.01, 0.5)), hot, True).forecast() is None
    assert StepLimits(cold, hot, True).forecast() is None
