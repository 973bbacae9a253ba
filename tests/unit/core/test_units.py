"""Numbers of a scene in SI, and back."""

import dataclasses
import math
from typing import get_args

import numpy as np
import pytest
from support.refusals import assert_says

import mpsim
from mpsim.core.units import BOLTZMANN, Quantity

CHOSEN = {"length": 0.03, "mass": 0.2, "time": 0.7}
QUANTITIES = get_args(Quantity)


def of_each(units):
    """One unit of each quantity [SI]."""
    return {quantity: units.to_si(1.0, quantity) for quantity in QUANTITIES}


def test_units_multiply_as_the_quantities_do():
    """Laws between quantities hold for their units: each from another two, none from the table of powers."""
    one = of_each(mpsim.Units(**CHOSEN))
    laws = {
        "area": one["length"] ** 2,
        "rate": 1 / one["time"],
        "velocity": one["length"] / one["time"],
        "acceleration": one["velocity"] ** 2 / one["length"],
        "momentum": one["mass"] * one["velocity"],
        "force": one["mass"] * one["acceleration"],
        "energy": one["force"] * one["length"],
        "temperature": one["energy"] / BOLTZMANN,
        "pressure": one["energy"] / one["area"],
        "diffusion": one["length"] * one["velocity"],
        "viscosity": one["pressure"] / one["rate"],
        "wave_number": 1 / one["length"],
        "number_density": 1 / one["area"],
    }
    assert {*laws, *CHOSEN} == {*QUANTITIES}
    assert one == pytest.approx(laws | CHOSEN, rel=1e-14)


@pytest.mark.parametrize("name", ["time", "velocity", "acceleration", "energy", "temperature"])
def test_any_of_five_units_gives_that_of_time(name):
    other = mpsim.Units(length=0.03, mass=0.2, **{name: 5.0})
    assert other.to_si(1.0, name) == pytest.approx(5.0, rel=1e-14)
    again = mpsim.Units(**CHOSEN)
    assert mpsim.Units(length=0.03, mass=0.2, **{name: again.to_si(1.0, name)}).time == pytest.approx(0.7, rel=1e-14)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_there_and_back(quantity):
    units, values = mpsim.Units(**CHOSEN), np.random.default_rng(1).normal(size=(5, 2))
    there = units.to_si(values, quantity)
    assert there.shape == values.shape
    assert units.from_si(there, quantity) == pytest.approx(values, rel=1e-15)
    assert isinstance(units.from_si(2, quantity), float)


def test_a_gas_drawn_in_units_of_the_scene_has_its_speed_in_si():
    """The rms speed of a gas in two dimensions is sqrt(2 kT/m), here in m/s, whatever the units of length and time."""
    argon = mpsim.Units(length=2e-10, mass=6.634e-26, time=3e-13)
    energy = argon.from_si(300.0, "temperature")
    scene = mpsim.Scene.random(count=50, packing=0.1, radius=0.85, temperature=energy, seed=1)
    speed = argon.to_si(math.sqrt((scene.velocity**2).sum(axis=1).mean()), "velocity")
    expected = math.sqrt(2 * BOLTZMANN * 300 / 6.634e-26)
    assert speed == pytest.approx(expected, rel=1e-12)
    as_energy = argon.to_si(argon.from_si(300.0, "energy"), "temperature")
    assert as_energy != pytest.approx(300.0), "negative control: a temperature in kelvin is no energy"


def test_kelvins_of_argon():
    """sqrt(kT/m) of argon at 300 K is 249.9 m/s."""
    argon = mpsim.Units(length=3.4e-10, mass=6.634e-26, temperature=300.0)
    assert argon.to_si(1.0, "velocity") == pytest.approx(249.9, abs=0.1)
    assert math.sqrt(3 * argon.from_si(300.0, "temperature")) == pytest.approx(math.sqrt(3))


def test_they_are_immutable_and_compare():
    units = mpsim.Units(**CHOSEN)
    assert units == mpsim.Units(**CHOSEN)
    assert units != mpsim.Units(**CHOSEN | {"time": 1})
    with pytest.raises(dataclasses.FrozenInstanceError):
        vars(mpsim.Units)["__setattr__"](units, "length", 2)


BAD = {
    "no time": ({"time": None}, ["must follow from one of time, velocity", "got none of them"]),
    "two of them": ({"energy": 1.0}, ["must follow from one of", "got time and energy"]),
    "length below 0": ({"length": -1}, ["length must be a finite number > 0 [m]", "got -1"]),
    "mass nan": ({"mass": math.nan}, ["mass must be a finite number > 0 [kg]", "got nan"]),
    "time as text": ({"time": "1 s"}, ["time must be a number > 0 in SI", "'1 s'"]),
    "temperature 0": ({"time": None, "temperature": 0}, ["temperature must be a finite number > 0", "got 0"]),
    "too small": ({"length": 1e-200}, ["fit float64", "one unit of area is 0 in SI", "length=1e-200"]),
    "too large": ({"length": 1e200}, ["fit float64", "one unit of area is inf in SI"]),
    "misspelt": ({"lenght": 1}, ["argument of Units", "'lenght'", "Did you mean 'length'?"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_units_are_refused(case):
    arguments, parts = BAD[case]
    with pytest.raises(mpsim.InputError) as caught:
        mpsim.Units(**CHOSEN | arguments)
    assert_says(caught, parts)


BAD_VALUES = {
    "quantity": ((1.0, "presure"), ["quantity must be one of 'length'", "got 'presure'", "Did you mean 'pressure'?"]),
    "a list of quantities": ((1.0, ["force"]), ["quantity must be one of", "['force']"]),
    "nan": ((math.nan, "force"), ["value must be finite; value is nan"]),
    "inf in an array": (([1.0, math.inf], "force"), ["value[1] is inf"]),
    "text": (("1 m", "length"), ["value must be numbers", "'1 m'"]),
    "rows that differ": (([[1], [1, 2]], "length"), ["value must be numbers", "[[1], [1, 2]]"]),
}


@pytest.mark.parametrize("case", BAD_VALUES)
def test_bad_values_are_refused_both_ways(case):
    arguments, parts = BAD_VALUES[case]
    for way in (mpsim.Units.to_si, mpsim.Units.from_si):
        with pytest.raises(mpsim.InputError) as caught:
            way(mpsim.Units(**CHOSEN), *arguments)
        assert_says(caught, parts)


def test_what_is_beyond_float64_is_refused():
    units = mpsim.Units(length=0.01, mass=1.0, time=1.0)
    with pytest.raises(mpsim.InputError, match=r"value in units of the scene must be finite"):
        units.from_si(1e308, "length")
    with pytest.raises(mpsim.InputError, match=r"value in SI must be finite; value in SI\[0\] is inf"):
        units.to_si([1e308], "wave_number")
