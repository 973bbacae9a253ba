"""Settings are checked and immutable."""

import dataclasses
from typing import get_args

import pytest
from support.refusals import assert_says
from support.scenes import gas

import mpsim
from mpsim.engine.solvers.methods import METHODS as SOLVERS
from mpsim.scene import settings

NAN, INF = float("nan"), float("inf")

SETTINGS = {
    "dt 0": ({"dt": 0}, ["dt must be a finite number > 0", "got 0"]),
    "dt below 0": ({"dt": -0.01}, ["dt must be a finite number > 0", "got -0.01"]),
    "dt nan": ({"dt": NAN}, ["dt must be a finite number > 0", "got nan"]),
    "dt inf": ({"dt": INF}, ["dt must be a finite number > 0", "got inf"]),
    "dt as text": ({"dt": "fast"}, ["dt must be a number > 0", "'fast'"]),
    "dt too large for a number": ({"dt": 10**400}, ["dt must be a number > 0", "finite", "of 401 digits"]),
    "method": ({"method": "gird"}, ["method must be one of", "'naive', 'grid'", "got 'gird'", "Did you mean 'grid'?"]),
    "method None": ({"method": None}, ["method must be one of", "got None"]),
    "method far off": ({"method": "xyz"}, ["method must be one of", "got 'xyz'."]),
    "law": ({"law": "elastisch"}, ["law must be one of 'reflect', 'elastic'", "Did you mean 'elastic'?"]),
    "contact": ({"contact": "pull"}, ["contact must be one of", "'push'", "got 'pull'"]),
    "precision": ({"precision": "float16"}, ["precision must be one of 'float32', 'float64'", "got 'float16'"]),
    "workers 0": ({"workers": 0}, ["workers must be a whole number from 1 to", "got 0", "Leave it out"]),
    "workers below 0": ({"workers": -2}, ["workers must be a whole number", "got -2"]),
    "workers absurd": ({"workers": 10**6}, ["workers must be a whole number from 1 to 1024", "got 1000000"]),
    "workers in halves": ({"workers": 1.5}, ["workers must be a whole number", "got 1.5"]),
    "workers as truth": ({"workers": True}, ["workers must be a whole number", "got True"]),
    "substeps 0": ({"substeps": 0}, ["substeps must be a whole number from 1", "got 0", "dt"]),
}


@pytest.mark.parametrize("case", SETTINGS)
def test_bad_settings_are_refused(case):
    change, parts = SETTINGS[case]
    with pytest.raises(mpsim.InputError) as caught:
        mpsim.Settings(**change)
    assert_says(caught, parts)


def test_types_name_the_words_that_settings_accept():
    words = {name: set(get_args(getattr(settings, name))) for name in ("MethodName", "Law", "Contact")}
    assert words == {"MethodName": {*SOLVERS, "auto"}, "Law": set(settings.LAWS), "Contact": set(settings.CONTACTS)}


UNKNOWN = {
    "Settings": (lambda: mpsim.Settings(metod="grid"), "an argument of Settings", "'metod'", "'method'"),
    "Scene.random": (lambda: mpsim.Scene.random(cout=9), "an argument of Scene.random", "'cout'", "'count'"),
    "of Scene": (
        lambda: mpsim.Scene.random(count=9, radius=0.5, packing=0.2, gravty=(0, -1)),
        "an argument of Scene.random",
        "'gravty'",
        "'gravity'",
    ),
    "Scene": (lambda: mpsim.Scene(postion=[[1, 1]]), "an argument of Scene", "'postion'", "'position'"),
    "Simulation": (lambda: mpsim.Simulation(seting=None), "an argument of Simulation", "'seting'", "'settings'"),
    "Emitter": (lambda: mpsim.Emitter(positon=(1, 1)), "an argument of Emitter", "'positon'", "'position'"),
    "FixedDisc": (lambda: mpsim.FixedDisc((1, 1), radus=1), "an argument of FixedDisc", "'radus'", "'radius'"),
    "Polyline": (lambda: mpsim.Polyline([], thicknes=1), "an argument of Polyline", "'thicknes'", "'thickness'"),
    "Piston": (lambda: mpsim.Piston(wal="left"), "an argument of Piston", "'wal'", "'wall'"),
    "Thermostat": (
        lambda: mpsim.Thermostat(temprature=1),
        "an argument of Thermostat",
        "'temprature'",
        "'temperature'",
    ),
    "ThermalWalls": (lambda: mpsim.ThermalWalls(letf=1), "an argument of ThermalWalls", "'letf'", "'left'"),
    "Sensor": (lambda: mpsim.Sensor(wal="left"), "an argument of Sensor", "'wal'", "'wall'"),
    "Collisions": (lambda: mpsim.Collisions(evry=3), "an argument of Collisions", "'evry'", "'every'"),
    "Correlations": (
        lambda: mpsim.Correlations(wave_number=[1]),
        "an argument of Correlations",
        "'wave_number'",
        "'wave_numbers'",
    ),
    "Series": (lambda: mpsim.measure.Series(len, evry=3), "an argument of Series", "'evry'", "'every'"),
    "view": (lambda: mpsim.view(None, prt=8000), "an argument of view", "'prt'", "'port'"),
    "live": (lambda: mpsim.live(None, heigt=300), "an argument of live", "'heigt'", "'height'"),
    "tune": (lambda: mpsim.tune(max_eror={}), "an argument of tune", "'max_eror'", "'max_error'"),
}


@pytest.mark.parametrize("case", UNKNOWN)
def test_an_unknown_keyword_is_refused_with_the_one_that_was_meant(case):
    call, what, got, meant = UNKNOWN[case]
    with pytest.raises(mpsim.errors.UnknownArgumentError) as caught:
        call()
    assert_says(caught, [f"{what} must be one of", f"got {got}. Did you mean {meant}?"])
    assert isinstance(caught.value, TypeError), "as Python raises it"


ALONE = {
    "Scene": (lambda: mpsim.Scene(10, 10), "an argument of Scene ", "width=...; got 10 alone"),
    "Scene.random": (lambda: mpsim.Scene.random(100), "an argument of Scene.random ", "count=...; got 100 alone"),
    "Scene.random, the first is named": (
        lambda: mpsim.Scene.random(0.5, count=9), "an argument of Scene.random ", "radius=...; got 0.5 alone"
    ),
    "draw": (lambda: mpsim.draw(None, None, "red"), "an argument of draw ", "colour=...; got 'red' alone"),
    "Units": (lambda: mpsim.Units(1), "an argument of Units ", "length=...; got 1 alone"),
}  # fmt: skip


@pytest.mark.parametrize("case", ALONE)
def test_a_value_without_its_name_is_refused(case):
    call, what, got = ALONE[case]
    with pytest.raises(mpsim.errors.UnknownArgumentError) as caught:
        call()
    assert_says(caught, [f"{what}must be given with its name, such as {got}."])
    assert isinstance(caught.value, TypeError), "as Python raises it"


def test_a_value_that_needs_no_name_is_taken_without():
    assert mpsim.Settings(0.01) == mpsim.Settings(dt=0.01)


def test_a_setting_where_a_simulation_begins_is_sent_to_settings():
    with pytest.raises(mpsim.errors.UnknownArgumentError, match=r"got 'dt'\. Use Settings\(dt=\.\.\.\)\."):
        mpsim.Simulation(gas(3, 0.1), dt=0.01)
    with pytest.raises(mpsim.errors.UnknownArgumentError) as caught:
        mpsim.Simulation(gas(3, 0.1), colour="red")
    assert "Settings" not in str(caught.value), "no setting either"


def test_settings_are_immutable_and_equal_by_value():
    settings = mpsim.Settings(dt=0.02)
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.dt = 1
    assert settings == mpsim.Settings(dt=0.02)
    assert hash(settings) == hash(mpsim.Settings(dt=0.02))


def test_the_defaults_are_the_documented_ones():
    settings = mpsim.Settings()
    assert (settings.method, settings.law, settings.contact, settings.precision) == (
        "auto",
        "elastic",
        "impact",
        "float64",
    )
    assert (settings.workers, settings.substeps) == (None, 1)
