"""Parameters changed while a simulation runs: each takes effect, in every method, and is saved, healed and replayed."""

import math
import os
import signal
from functools import cache

import numpy as np
import pytest
from support.scenes import gas, simulate
from support.selection import long_but
from support.sessions import METHODS, stage

import mpsim
from mpsim.engine.parameters import NAMES, OF_FRICTION, OF_STEPS
from mpsim.features.thermal_walls import ThermalWalls
from mpsim.features.thermostat import Thermostat

pytestmark = [
    pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning"),
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),  # 3.12: fork with threads
]

DT = 0.025
BATH = Thermostat(temperature=1.0, rate=4.0, seed=5)
WALLS = ThermalWalls(left=1.0, right=1.0, bottom=1.0, top=1.0, seed=5)


@cache
def scene_of(name):
    """A scene in which the parameter can be changed, and acts within some frames."""
    if name in OF_FRICTION:
        return gas(60, 0.4, seed=2, friction=0.05, wall_friction=0.05)
    if name == "temperature":
        return gas(60, 0.4, seed=2, boundary="periodic", thermostat=BATH)
    if name == "wall_temperature":
        return gas(60, 0.4, seed=2, thermal_walls=WALLS)
    scene = stage()
    each = mpsim.Emitter((6.0, scene.height - 0.75), (4.0, 0.0), every=8, mass=1.0, limit=4)
    return scene.changed(emitters=(*scene.emitters, each))


VALUES = {
    "gravity": ((0.25, 0.0), (0.0, 1.0), (0.5, -0.25)),
    "restitution": (0.9, 0.5, 0.8),
    "wall_restitution": (0.9, 0.5, 0.8),
    "friction": (0.02, math.inf, 0.01),
    "wall_friction": (0.02, math.inf, 0.01),
    "piston_speed": (-0.5, -2.0, -1.0),
    "interval": (0.2, 1.0, 0.1),
    "every": (6, 100, 3),
    "temperature": (4.0, 9.0, 0.25),
    "wall_temperature": (4.0, 9.0, [0.25, 1.0, 2.0, 0.5]),
    "dt": (0.02, 1.0, 0.0125),
    "contact": ("impact", "push", "impact"),
    "passes": (2, 3, 4),
    "substeps": (2, 7, 4),
    "workers": (2, 1, 3),
}
"""Of each parameter: a value before the first frame, then two in the same frame, of which the last one holds."""

ALL = [(words, name) for words in METHODS for name in NAMES if not ("event" in words and name in OF_STEPS)]


def test_all_parameters_are_tried():
    assert VALUES.keys() == set(NAMES)


def begun(words, name, **more):
    return simulate(scene_of(name), dt=DT, **(METHODS[words] | more))


def changed(sim, name, before=lambda sim: None, after=lambda sim: None):
    """Change a parameter three times, in the frames 0 and 12; before, after: called in frame 12."""
    first, second, last = VALUES[name]
    sim.change(**{name: first})
    sim.run(frames=12)
    before(sim)
    sim.change(**{name: second})
    sim.change(**{name: last})
    after(sim)


@cache
def unchanged(words, name):
    with begun(words, name) as sim:
        sim.run(frames=32)
        return sim.digest()


@pytest.mark.slow
@pytest.mark.parametrize(("words", "name"), long_but(ALL, *(each for each in ALL if each[0] == "grid")))
def test_a_change_acts_and_is_the_same_after_a_resume_and_in_a_replay(words, name, tmp_path):
    with begun(words, name) as sim:
        changed(sim, name)
        path = sim.save(tmp_path / "run")
        sim.run(frames=20)
        digest, time, journal = sim.digest(), sim.time, sim.journal
    assert (digest == unchanged(words, name)) == (name == "workers"), "the control"
    several = {} if words in ("naive", "grid") else {"workers": 2}
    with mpsim.Simulation.resume(path, **several) as again:
        again.run(frames=20)
        assert (again.digest(), again.time, len(again.journal)) == (digest, time, 3)
    saved = journal.save(tmp_path / "session.toml")
    for source, more in ((journal, {"workers": 1}), (saved, several)):
        with mpsim.Simulation.replay(source, **more) as again:
            assert (again.digest(), again.time) == (digest, time)


def kill(sim):
    os.kill(sim.pids[0], signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("name", long_but(NAMES, "substeps", "friction", "temperature", "wall_temperature"))
def test_a_worker_that_dies_in_the_frame_of_a_change_changes_no_bit(name, when):
    digests = []
    for words, more in (("grid", {}), ("parallel on 2", {when: kill})):
        with begun(words, name, start_method="fork", on_worker_death="restart") as sim:
            changed(sim, name, **more)
            sim.run(frames=20)
            digests.append(sim.digest())
            assert sim.substeps == (4 if name == "substeps" else 1)
    assert digests[0] == digests[1] != unchanged("grid", name) or name == "workers"


# --- sub-steps


def heirs(words, **settings):
    """A simulation that is changed to four sub-steps, and one that begins with them where it is: both after 12 frames.

    settings: of both.
    """
    scene = gas(60, 0.4, seed=3)
    with simulate(scene, dt=0.05, **METHODS[words], **settings) as sim:
        sim.run(frames=7)
        sim.change(substeps=4)
        assert (sim.substeps, sim.settings.substeps, sim.journal.changes[-1].values) == (4, 4, {"substeps": 4})
        with simulate(scene.starting_from(sim.state), dt=0.05, substeps=4, **METHODS[words], **settings) as other:
            for each in (sim, other):
                each.run(frames=12)
            return sim.state, other.state


@pytest.mark.parametrize("words", [words for words in METHODS if "event" not in words])
@pytest.mark.parametrize("on_fast", ["warn", "substep"])
def test_substeps_are_those_of_a_simulation_that_begins_with_them(words, on_fast):
    changed, begun = heirs(words, on_fast=on_fast)
    assert np.array_equal(changed.position, begun.position)
    assert np.array_equal(changed.velocity, begun.velocity)
    with simulate(gas(60, 0.4, seed=3), dt=0.05, **METHODS[words]) as control:
        control.run(frames=19)
        assert control.digest() != changed.digest()


@pytest.mark.parametrize(
    "change", [{"substeps": 4}, {"passes": 2}, {"contact": "impact"}, {"gravity": (0, 1), "substeps": 2}]
)
def test_parameters_of_steps_are_refused_where_there_are_none(change):
    with simulate(gas(60, 0.4, seed=3), dt=0.05, method="event") as sim:
        before = sim.settings, sim.scene
        with pytest.raises(mpsim.InputError, match=r"only where frames are made of steps, and got .* method='event'"):
            sim.change(**change)
        assert (sim.settings, sim.scene, len(sim.journal)) == (*before, 0)


# --- friction


@pytest.mark.slow
@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "friction must be > 0 in a change; got 0.0. A small one has almost no effect."),
        (-1.0, "friction must be a number >= 0"),
        (math.nan, "friction must be a number >= 0"),
        ("rough", "friction must be a number >= 0"),
        ([0.1, 0.2], "friction must be a number >= 0"),
        (None, "friction must be a number >= 0"),
    ],
)
def test_friction_that_is_none_is_refused(value, text):
    with begun("grid", "friction") as sim:
        before = sim.scene
        with pytest.raises(mpsim.InputError) as caught:
            sim.change(friction=value)
        assert text in str(caught.value)
        assert (sim.scene, len(sim.journal)) == (before, 0)


@pytest.mark.slow
def test_a_sliding_disc_is_slowed_by_the_friction_that_is_in_force():
    """By mu g, until it rolls: the closed form of the page on rough discs, with another mu halfway."""
    scene = mpsim.Scene(
        width=20, height=4, position=[[1.0, 0.5]], velocity=[[1.0, 0.0]], radius=0.5, gravity=(0, -2),
        wall_restitution=0.0, wall_friction=0.25,
    )  # fmt: skip
    with simulate(scene, dt=1 / 64, method="naive") as sim:
        sim.run(until=0.25)
        assert sim.state.velocity[0, 0] == pytest.approx(1 - 0.25 * 2 * 0.25)
        sim.change(wall_friction=0.125)
        sim.run(until=0.5)
        assert sim.state.velocity[0, 0] == pytest.approx(1 - 0.25 * 2 * 0.25 - 0.125 * 2 * 0.25)


# --- temperatures


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("temperature", 0.0, "temperature must be a finite number > 0"),
        ("temperature", [1.0, 2.0], "temperature must be a number"),
        ("wall_temperature", -1.0, "wall_temperature must be a finite number > 0"),
        ("wall_temperature", [1.0, 2.0], "one for each of the thermal walls left, right, bottom, top; got [1.0, 2.0]"),
        ("wall_temperature", [1.0, 2.0, 3.0, 0.0], "wall_temperature must be a finite number > 0"),
        ("wall_temperature", "hot", "wall_temperature must be a number"),
        ("wall_temperature", None, "wall_temperature must be a number"),
        ("wall_temperature", [1.0, None, 2.0, 3.0], "wall_temperature must be a number"),
    ],
)
def test_a_temperature_that_is_none_is_refused(name, value, text):
    with begun("grid", name) as sim:
        before = sim.scene
        with pytest.raises(mpsim.InputError) as caught:
            sim.change(**{name: value})
        assert text in str(caught.value)
        assert (sim.scene, len(sim.journal)) == (before, 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["temperature", "wall_temperature"])
def test_a_gas_comes_to_a_temperature_that_was_changed(name):
    found = []
    for change in ({}, {name: 9.0}):
        with begun("grid", name) as sim:
            if change:
                sim.change(**change)
            sim.run(frames=400)
            found.append(sim.run(frames=400, measures=["temperature"]).measures["temperature"].value)
    assert 0.7 < found[0] < 1.4, "the control"
    assert 6.5 < found[1] < 11.5


def test_walls_that_are_not_thermal_stay_so():
    scene = gas(60, 0.4, seed=2, thermal_walls=ThermalWalls(right=1.0, bottom=2.0))
    assert scene.thermal_walls.temperatures == {"right": 1.0, "bottom": 2.0}
    with simulate(scene, method="grid") as sim:
        sim.change(wall_temperature=[3.0, 4.0])
        assert sim.scene.thermal_walls == ThermalWalls(right=3.0, bottom=4.0)
        sim.change(wall_temperature=5.0)
        assert sim.scene.thermal_walls == ThermalWalls(right=5.0, bottom=5.0)
        assert sim.journal.scene.thermal_walls == scene.thermal_walls
