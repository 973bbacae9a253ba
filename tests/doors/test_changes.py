"""Discs, walls and parameters changed between two frames: what is refused, what follows, and what the journal holds."""

import math
import os
from decimal import Decimal
from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from support.refusals import assert_refused
from support.scenes import At, digest_after, gas, lattice, scene_of, simulate

import mpsim
from mpsim import InputError, ThermalWalls, Thermostat
from mpsim.measure import kinetic_energy

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]

METHODS = ["naive", "grid", "event"]


def one_disc(place=(9, 9), velocity=(0, 0), size=(12, 12), **features):
    return mpsim.Scene(width=size[0], height=size[1], position=[place], velocity=[velocity], radius=0.5, **features)


def kept(sim):
    """Everything that a refused change must leave as it was."""
    return sim.digest(), sim.scene.digest(), sim.settings, sim.count, sim.frame, sim.time, len(sim.journal)


# --- what is refused

OF_GAS = {
    "set": [
        ({"ids": [1, 2, 1], "velocity": (0, 0)}, ["ids must hold each disc once", "disc 1 is in it 2 times"]),
        ({"ids": [[1], [2, 3]], "velocity": (0, 0)}, ["ids must be whole numbers", "[[1], [2, 3]]"]),
        ({"ids": 9, "velocity": (0, 0)}, ["ids must be discs that are there", "disc 9 has been removed"]),
        ({"ids": 1}, ["set needs something to set", "position, velocity, acceleration, spin"]),
        ({"ids": [1, 2], "velocity": [(1, 0), (1,)]}, ["velocity must be numbers of shape (2,) or (2, 2)"]),
        ({"ids": 1, "velocity": (1e200, 0)}, ["velocity must be at most", "1e+200"]),
        ({"ids": 1, "spin": 1.0}, ["spin can be set only in a scene of rough discs", "1.0"]),
    ],
    "kick": [
        ({"ids": 1, "impulse": 3.0}, ["impulse must have shape (2,) or (1, 2)", "got shape ()"]),
        ({"ids": 1, "impulse": (1e300, 0)}, ["impulse must be at most", "1e+300"]),
    ],
    "remove": [({"ids": [3, 9]}, ["disc 9 has been removed"])],
    "add": [
        ({"position": [1, math.nan], "velocity": [0, 0]}, ["position must be finite", "nan"]),
        ({"position": [[1, 1], [1, 99]], "velocity": [[0, 0], [0, 0]]}, ["position[1] must lie in", "99"]),
        ({"position": [1, 1], "velocity": [0, 0], "spin": 2}, ["only in a scene of rough discs", "got 2. Give"]),
        ({"position": [1, 1], "velocity": [0, 0], "radius": 0.5}, ["radius can be given for added discs only in a"]),
    ],
    "change": [
        ({"gravty": (0, 1)}, ["'gravty' is not a parameter of a simulation", "Did you mean 'gravity'?"]),
        ({"gravity": 9.8}, ["gravity must be two numbers, along x and y; got 9.8. Downwards it is (0, -9.8)"]),
        ({"piston_speed": -1.0}, ["piston_speed can be changed only in a scene with a piston", "-1.0"]),
        ({"wall_temperature": [1]}, ["wall_temperature can be changed only in a scene with thermal walls"]),
        ({"restitution": 0.5, "dt": -1}, ["dt must be a finite number > 0", "-1"]),
    ],
    "add_wall": [
        ({"wall": [(1, 1), (1, 1)]}, ["points of a Polyline", "[1.0, 1.0]"]),
        ({"wall": [(0, 0), (8, 8)]}, ["a wall must be clear of all discs; got disc ", "inside obstacles[0]"]),
    ],
    "run": [
        ({"until": 0.01}, ["until must not lie in the past", "the time is 0.02", "got 0.01"]),
        ({"until": 1e13}, ["until must be at most 1,000,000,000,000 frames of 0.01; got 1e+13"]),
        ({"frames": 9, "measures": ["temperature"], "start": 1e308}, ["start must be at most 1,000,000,000,000"]),
    ],
}  # fmt: skip
OF_STEPS = {"contact", "passes", "substeps"}
NO_STEPS = ["can be changed only where frames are made of steps", "method='event', which has none"]


@pytest.mark.parametrize("method", ["grid", "event"])
@pytest.mark.parametrize("act", OF_GAS)
def test_what_is_wrong_is_refused_by_name_and_changes_nothing(act, method):
    with simulate(gas(20, 0.2), dt=0.01, method=method) as sim:
        sim.run(frames=2)
        sim.remove(9)
        before = kept(sim)
        for arguments, words in OF_GAS[act]:
            of_steps = method == "event" and act == "change" and arguments.keys() & OF_STEPS
            parts = NO_STEPS if of_steps else words
            assert_refused(parts, getattr(sim, act), **arguments)
            assert kept(sim) == before, arguments
        assert sim.run(frames=1).frames == 1


PISTON = {"piston": mpsim.Piston("right", -0.5, 9)}
IN_TIME, BY_FRAMES = mpsim.Emitter((1, 1), (1, 0), interval=5), mpsim.Emitter((1, 1), (1, 0), every=5)
ROUGH = {"friction": 0.5, "wall_friction": 0.5}
WARM = {"thermal_walls": ThermalWalls(left=1.0, right=1.0)}


OF_SCENES = [
    (PISTON, {"piston_speed": 0.5}, "speed of a Piston must point into the box"),
    ({"emitters": BY_FRAMES}, {"interval": 0.5}, "emitters that have it"),
    ({"emitters": IN_TIME}, {"interval": [1, 2]}, "one for each of 1 emitters"),
    (ROUGH, {"friction": 0.0}, "friction must be > 0 in a change; got 0.0. A small one has almost no effect."),
    (WARM, {"wall_temperature": [1, 2, 3]}, "one for each of the thermal walls left, right; got [1, 2, 3]"),
]


def test_a_parameter_that_does_not_fit_its_scene_is_refused():
    for features, arguments, text in OF_SCENES:
        with simulate(one_disc(**features), method="naive") as sim:
            before = kept(sim)
            assert_refused([text], sim.change, **arguments)
            assert kept(sim) == before


MIXED = {"position": [[2, 2], [5, 5]], "velocity": np.zeros((2, 2)), "radius": [0.5, 0.25], "mass": [1, 2]}


@pytest.mark.parametrize("method", METHODS)
def test_added_discs_have_one_value_or_one_each_and_right_ones(method):
    with simulate(mpsim.Scene(width=10, height=10, friction=0.5, **MIXED), method=method) as sim:
        for arguments, text in (
            ({"mass": 1}, "radius must be given for added discs, as the discs of this scene have one each; got None"),
            ({"radius": 0.5}, "mass must be given for added discs, as the discs of this scene have one each"),
            ({"radius": 0.6, "mass": 1}, "largest disc, 0.5; got [0.6]"),
            ({"radius": [0.1, 0.2], "mass": -1}, "radius must have shape () or (1,)"),
        ):
            assert_refused([text], sim.add, [7, 7], [0, 0], **arguments)
        assert sim.count == 2, "nothing was added"
        sim.add([[7, 7], [8, 2]], np.zeros((2, 2)), radius=[0.1, 0.2], mass=1)
        sim.add([3, 8], [0, 0], radius=0.5, mass=2, spin=2.5)
        sim.add(np.empty((0, 2)), np.empty((0, 2)), radius=[], mass=[])
        assert sim.radii.tolist() == [0.5, 0.25, 0.1, 0.2, 0.5]
        assert sim.masses.tolist() == [1, 2, 1, 1, 2]
        assert sim.state.spin.tolist() == [0, 0, 0, 0, 2.5]


def test_accelerations_are_set_and_added_for_each_disc():
    with simulate(one_disc((2, 2), acceleration=[(0.0, 0.0)]), method="grid", dt=0.5) as sim:
        sim.set(0, acceleration=(1.0, 0.0))
        sim.add((8, 8), (0, 0), (0.0, -1.0))
        sim.run(frames=1)
        assert sim.state.velocity.tolist() == [[0.5, 0], [0, -0.5]]


# --- what follows


@pytest.mark.parametrize("method", METHODS)
def test_set_and_kick_do_what_they_say(method):
    base = gas(20, 0.2)
    box = {"width": base.width + 4, "height": base.height, "radius": 0.5}
    features = {"mass": np.linspace(1, 4, 20), "wall_friction": 0.5}
    scene = mpsim.Scene(position=base.position, velocity=base.velocity, **box, **features)
    with simulate(scene, dt=0.01, method=method) as sim:
        sim.run(frames=3)
        before, place = sim.state, (scene.width - 1, 2.0)
        sim.set([2, 4], velocity=(0.5, -0.25))
        sim.set([6, 4], velocity=[(0.5, 0.5), (1.0, -0.25)])
        sim.set(4, position=place)
        sim.kick([7, 6], [(1.0, 0.0), (0.0, 2.0)])
        sim.kick(np.array([8]), (0.25, 0.25))
        expected = before.velocity.copy()
        expected[[2, 4, 6]] = (0.5, -0.25), (1.0, -0.25), (0.5, 0.5)
        expected[[7, 6, 8]] += [(1.0, 0.0), (0.0, 2.0), (0.25, 0.25)] / scene.masses[[7, 6, 8], None]
        now, others = sim.state, np.arange(20) != 4
        assert np.array_equal(now.velocity, expected)
        assert np.array_equal(now.position[others], before.position[others])
        assert now.position[4].tolist() == pytest.approx(place, abs=1e-15)
        assert (sim.frame, len(sim.journal)) == (3, 5)


@pytest.mark.parametrize("removed", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_a_removed_disc_is_in_nobodys_way_and_the_others_keep_their_numbers(method, removed):
    """One flies to where another was removed: it passes. The control: where it was not, it turns back."""
    scene = mpsim.Scene(width=12, height=3, position=[[2, 1.5], [6, 1.5]], velocity=[[2, 0], [0, 0]], radius=0.5)
    with simulate(scene, dt=0.05, method=method) as sim:
        sim.remove([1] if removed else [])
        sim.run(frames=40, measures=["kinetic_energy"])
        state = sim.state
        assert kinetic_energy(state, scene) == pytest.approx(2.0)
        if not removed:
            assert state.position[0, 0] < 5.1
            return
        assert (sim.count, state.present.tolist(), sim.absorbed.tolist()) == (2, [True, False], [False, True])
        assert state.position.tolist() == [[pytest.approx(6.0), 1.5], [6.0, 1.5]]
        sim.add((9.0, 1.5), (0.0, 0.0))
        assert (sim.count, sim.state.present.tolist()) == (3, [True, False, True])


def test_a_removed_disc_takes_no_part_in_measures_and_files(tmp_path):
    with simulate(gas(30, 0.3, seed=2), method="grid") as sim:
        sim.remove(range(10, 20))
        with mpsim.Trajectory.write(tmp_path / "t.xyz", every=5) as writer:
            report = sim.run(frames=5, measures=["kinetic_energy", "energy_drift"], observe=writer)
        state = sim.state
        energy = 0.5 * (state.velocity[state.present] ** 2).sum()
        assert report.measures["kinetic_energy"].value == pytest.approx(energy, rel=1e-12)
        assert abs(report.measures["energy_drift"].value) < 1e-10
        for name in ("collision_rate", "contact_rate", "pressure_virial"):
            with pytest.raises(InputError, match="removed discs"):
                sim.run(frames=1, measures=[name])
    frames = list(mpsim.Trajectory(tmp_path / "t.xyz"))
    assert [sorted(frame.ids.tolist()) for frame in frames] == [[*range(10), *range(20, 30)]] * 2


def test_energy_that_was_put_in_is_no_drift():
    """Between two runs it is counted by neither; in a run nobody knows what it was, nor what a wall takes up."""
    with simulate(gas(20, 0.3, seed=2), method="grid") as sim:
        sim.kick(0, (5.0, 0.0))
        assert abs(sim.run(frames=10, measures=["energy_drift"]).measures["energy_drift"].value) < 1e-10
        names = ["energy_drift", "momentum_drift"]
        for act in (lambda sim: sim.kick(0, (5.0, 0.0)), lambda sim: sim.add_wall([(0, 0), (0, 1)])):
            found = sim.run(frames=10, measures=names, observe=At(sim.frame, act)).measures
            assert np.isnan(found["momentum_drift"].value)


@pytest.mark.parametrize("method", METHODS)
def test_a_disc_falls_as_gravity_is_changed(method):
    with simulate(one_disc((15, 15), size=(30, 30)), dt=0.125, contact="impact", method=method) as sim:
        sim.change(gravity=(0, -1))
        sim.run(frames=8)
        sim.change(gravity=(2, 0), dt=0.0625)
        sim.run(frames=16)
        assert sim.state.velocity[0].tolist() == pytest.approx([2, -1])
        assert sim.state.position[0].tolist() == pytest.approx([16, 13.5])
        assert (sim.time, sim.frame, sim.origin, sim.settings.dt) == (2.0, 24, (8, 1.0), 0.0625)
        assert sim.run(until=3.0).frames == 16


@pytest.mark.parametrize("method", METHODS)
def test_rounding_of_a_time_neither_refuses_it_nor_costs_a_frame(method):
    """3 * 0.1 is more than 0.3. And 1000.1 - 1000 more than 2 * 0.05, which an emitter must not take for a frame."""
    with simulate(one_disc(), method=method, dt=0.1) as sim:
        assert [sim.run(until=time).frames for time in (0.3, 0.3, 0.7)] == [3, 0, 4]
    jet = mpsim.Emitter((2, 2), (1, 0), interval=1000.1, limit=1)
    with simulate(one_disc(emitters=jet), method=method, dt=1000) as sim:
        sim.run(frames=1)
        sim.change(dt=0.05)
        assert (sim.run(until=1000.1).frames, sim.count) == (2, 2)
        assert [sim.run(until=time).frames for time in (1000.15, 1001.3, 1001.3)] == [1, 23, 0]


@pytest.mark.parametrize("method", METHODS)
def test_the_rate_of_an_emitter_is_changed_within_its_interval(method):
    """A quarter of the first interval is left: a quarter of the new one remains."""
    emitter = mpsim.Emitter((1.0, 2.0), (4.0, 0.0), interval=1.0)
    with simulate(one_disc((30, 2), size=(40, 4), emitters=emitter), dt=0.125, method=method) as sim:
        entered = []
        for frame in range(16):
            if frame == 6:
                sim.change(interval=0.5)
            sim.run(frames=1)
            entered.append(sim.count - 1)
    assert np.searchsorted(entered, [1, 2, 3], side="left").tolist() == [6, 10, 14]


@pytest.mark.parametrize("method", METHODS)
def test_a_wall_is_met_from_both_sides_once_it_stands(method):
    """Both discs would meet in the middle; a removed one is not in the way of the wall."""
    places = [[2, 2], [10, 2], [6, 2]]
    scene = mpsim.Scene(width=12, height=4, position=places, velocity=[[2, 0], [-2, 0], [0, 0]], radius=0.5)
    with simulate(scene, dt=0.0625, contact="impact", method=method) as sim:
        wall = mpsim.Polyline([(6, 0), (6, 4)], 0.5)
        with pytest.raises(InputError, match=r"a wall must be clear of all discs; got disc 2 at \(6.0, 2.0\)"):
            sim.add_wall(wall)
        sim.remove(2)
        sim.run(frames=8)
        sim.add_wall(wall)
        sim.run(frames=24)
        assert sim.state.velocity.tolist() == [[-2, 0], [2, 0], [0, 0]]
        assert sim.state.position[:2, 0] == pytest.approx([4.5, 7.5], abs=1e-9), "having turned at 5.25 and 6.75"
        assert sim.scene.obstacles == (wall,)
        assert scene.obstacles == (), "the scene that was given is as it was"
        sim.run(frames=64)
        assert sim.state.position[0, 0] < 5.3, "and for good"


def test_a_wall_leaves_the_other_parts_of_a_scene_their_room():
    parts = {"emitters": mpsim.Emitter((4, 4), (1, 0), every=5), "obstacles": mpsim.FixedDisc((5, 6), 1)}
    with simulate(one_disc(**parts), method="naive") as sim:
        with pytest.raises(InputError, match=r"the position of emitters\[0\] must be one radius from"):
            sim.add_wall([(3, 4), (6, 4)])
        sim.add_wall([(3, 2), (6, 2)])
        assert len(sim.scene.obstacles) == 2
        with pytest.raises(InputError, match=r"position\[0\] must be one radius .* obstacle"):
            sim.set(0, position=(5, 2.25))


@pytest.mark.parametrize("method", METHODS)
def test_obstacles_change_beside_a_piston_discs_of_two_sizes_and_an_emitter_that_ends(method):
    jet, piston = mpsim.Emitter((2, 9), (1, 0), every=5, limit=2, radius=0.25), mpsim.Piston("right", -0.25, 9)
    scene = scene_of([[2, 2], [6, 6]], np.ones((2, 2)), 12, 12, radius=[0.5, 0.25], emitters=jet, piston=piston)
    with simulate(scene, method=method) as sim:
        wall = sim.add_wall([(4, 2), (4, 8)])
        sim.move_wall(wall, mpsim.Translation((0.25, 0), stop=1))
        sim.change(obstacles=[*sim.scene.obstacles, mpsim.FixedDisc((8, 8), 0.5)])
        sim.remove_wall(wall)
        assert (sim.run(frames=3).frames, len(sim.scene.obstacles)) == (3, 2)


def test_a_speed_that_is_refused_is_not_given():
    with simulate(lattice(4, 4), method="grid", dt=0.01, on_fast="error") as sim:
        sim.run(frames=2)
        before = kept(sim)
        for change in (
            lambda: sim.kick(1, (500, 0)),
            lambda: sim.set(1, velocity=(500, 0)),
            lambda: sim.add((2.25, 2.25), (500, 0)),
            lambda: sim.change(dt=10.0),
        ):
            with pytest.raises(mpsim.TooFastError):
                change()
            assert kept(sim) == before
        sim.run(frames=2)
        assert sim.digest() == digest_after(lattice(4, 4), 4, method="grid", dt=0.01)


def test_what_follows_is_what_a_new_simulation_of_the_changed_state_does():
    scene = gas(30, 0.3, seed=3, gravity=(0.0, -0.25))
    with simulate(scene, dt=0.01, method="grid") as sim:
        for act in (
            lambda: sim.kick(3, (1.5, -2.0)),
            lambda: sim.remove([4, 11]),
            lambda: sim.set(7, velocity=(-0.5, 2.0)),
            lambda: sim.set(5, position=scene.position[4]),
            lambda: sim.change(substeps=3),
        ):
            sim.run(frames=2)
            act()
        state = sim.state
        sim.run(frames=5)
        with simulate(scene.starting_from(state), dt=0.01, method="grid", substeps=3) as fresh:
            fresh.run(frames=5)
            assert np.array_equal(fresh.state.position, sim.state.position[state.present])
            assert np.array_equal(fresh.state.velocity, sim.state.velocity[state.present])


def test_each_door_refuses_speeds_that_no_exact_run_can_follow():
    with simulate(gas(20, 0.2), method="event", dt=1e-9) as sim:
        before = kept(sim)
        for change in (lambda: sim.set(0, velocity=(1e14, 0)), lambda: sim.kick(0, (0, -1e14))):
            with pytest.raises(InputError, match=r"velocity(| after the kick) must give speeds of at most .*; got 1e"):
                change()
            assert kept(sim) == before
        sim.set(0, velocity=(1e11, 0))  # the control
    with simulate(gas(20, 0.2), method="event", dt=1.0) as sim:
        with pytest.raises(InputError, match="dt must be short enough"):
            sim.set(0, velocity=(1e12, 0))
        with pytest.raises(InputError, match="dt must be "):
            sim.change(dt=1e40)


# --- the journal


def test_a_journal_holds_plain_numbers_and_is_replayed_from_its_file(tmp_path):
    words = "between two runs, not in a callback of a run"
    with simulate(gas(20, 0.2)) as sim, pytest.raises(InputError, match=words):
        sim.run(frames=1, observe=At(0, lambda sim: sim.change(dt=0.5)))
    with simulate(gas(20, 0.2)) as sim:
        sim.change(dt=Fraction(1, 40), gravity=(Decimal("0.5"), np.float32(0)), passes=np.int8(2))
        sim.run(frames=5)
        sim.change(gravity=np.zeros(2))
        sim.run(frames=5)
        journal = sim.journal
        checkpoint = sim.save(tmp_path / "run")
    assert journal.changes[0].values == {"dt": 0.025, "gravity": [0.5, 0.0], "passes": 2}
    with mpsim.Simulation.replay(journal.save(tmp_path / "session.toml")) as again:
        assert again.digest() == journal.digest
    with mpsim.Simulation.resume(checkpoint) as again:
        assert again.journal.changes == journal.changes


def everything(name):
    """A scene in which a parameter can be changed, and acts within some frames."""
    base = gas(20, 0.35, seed=3)
    top = base.height + 3.25
    emitters = [mpsim.Emitter((1.0, top), (4.0, 0.0), interval=0.3, limit=4)]
    emitters.append(mpsim.Emitter((4.0, top), (4.0, 0.0), every=8, limit=4))
    warm = {"thermal_walls": ThermalWalls(left=1.0, bottom=1.0, seed=5)}
    return mpsim.Scene(
        width=base.width, height=base.height + 4, position=base.position, velocity=base.velocity, radius=0.5,
        piston=mpsim.Piston("right", -0.25, 0.8 * base.width), emitters=emitters, friction=0.05,
        thermostat=Thermostat(1.0, 4.0, seed=5), **({"wall_friction": 0.05} if name == "wall_friction" else warm),
    )  # fmt: skip


PEG, OTHER = (mpsim.FixedDisc(place, 0.125) for place in [(3, 0.5), (0.25, 3)])
VALUES = {
    "gravity": ((0.25, 0.0), (0.0, 1.0), (0.5, -0.25)),
    "restitution": (0.9, 0.5, 0.8),
    "wall_restitution": (0.9, 0.5, 0.8),
    "friction": (0.02, math.inf, 0.01),
    "wall_friction": (0.02, math.inf, 0.01),
    "piston_speed": (-4.0, -2.0, -6.0),
    "interval": (0.2, 1.0, 0.1),
    "every": (6, 100, 3),
    "temperature": (4.0, 9.0, 0.25),
    "wall_temperature": (4.0, 9.0, [0.25, 1.0]),
    "obstacles": (PEG, [], [OTHER, PEG]),
    "dt": (0.02, 1.0, 0.0125),
    "contact": ("impact", "push", "impact"),
    "passes": (2, 3, 4),
    "substeps": (2, 7, 4),
    "workers": (2, 1, 3),
}
"""Of each parameter: a value before the first frame, then two in the same frame, of which the last one holds."""


HOW = {"dt": 0.025, "method": "grid"}


@cache
def unchanged(scene_name):
    return digest_after(everything(scene_name), 14, **HOW)


@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
@pytest.mark.parametrize("name", VALUES)
def test_each_parameter_acts_and_is_the_same_after_a_resume_and_in_a_replay(name, tmp_path):
    with simulate(everything(name), **HOW) as sim:
        first, second, last = VALUES[name]
        sim.change(**{name: first})
        sim.run(frames=6)
        sim.change(**{name: second})
        sim.change(**{name: last})
        path = sim.save(tmp_path / "run")
        sim.run(frames=8)
        digest, time, session = sim.digest(), sim.time, sim.journal.save(tmp_path / "session.toml")
        if name == "wall_temperature":
            assert sim.scene.thermal_walls == ThermalWalls(left=last[0], bottom=last[1], seed=5)
            assert sim.journal.scene.thermal_walls == everything(name).thermal_walls
        assert (digest == unchanged("wall_friction" if name == "wall_friction" else "")) == (name == "workers")
    with mpsim.Simulation.resume(path) as again:
        again.run(frames=8)
        assert (again.digest(), again.time, len(again.journal)) == (digest, time, 3)
    with mpsim.Simulation.replay(session) as again:
        assert (again.digest(), again.time) == (digest, time)


def test_all_parameters_are_tried():
    with simulate(gas(5, 0.1)) as sim, pytest.raises(InputError) as caught:
        sim.change(width=3.0)
    assert str(caught.value).split("What can be changed: ")[1].rstrip(".").split(", ") == list(VALUES)


DONE = {
    "remove": lambda sim: sim.remove([1, 2]),
    "piston_speed": lambda sim: sim.change(piston_speed=-2.0),
    "remove_wall": lambda sim: sim.remove_wall(0),
    "move_wall": lambda sim: sim.move_wall(0, mpsim.Oscillation((0, 0.25), period=1.0)),
    "change": lambda sim: sim.change(obstacles=[mpsim.FixedDisc((4, 2), 0.25)], gravity=(0, -1), dt=0.05),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", DONE)
def test_the_scene_of_a_changed_simulation_begins_others_like_any_scene(name, method, tmp_path):
    """Of it all discs are there, and the piston is where it was at first, beyond discs that it would have passed."""
    lid = mpsim.Piston("right", -8.0, 5), mpsim.Polyline([(5, 1), (5, 2)], motion=mpsim.Translation((0, 1), stop=2))
    places = [[2, 2], [2, 8], [4.5, 5], [11, 5]]
    scene = scene_of(places, -np.ones((4, 2)), 12, 12, piston=lid[0], obstacles=lid[1])
    with simulate(scene, method=method, dt=0.0625) as sim:
        sim.run(frames=12)
        DONE[name](sim)
        changed = sim.scene
    with simulate(changed, method=method) as sim, simulate(changed, method=method) as other:
        sim.run(frames=10)
        path, snap = sim.save(tmp_path / "run"), sim.snapshot()
        sim.run(frames=90)
        session = sim.journal.save(tmp_path / "session.toml")
        other.restore(snap)
        with mpsim.Simulation.resume(path) as again, mpsim.Simulation.replay(session) as third:
            for each in (other, again, third):
                each.run(frames=100 - each.frame)
                assert each.digest() == sim.digest()


def test_a_changed_scene_that_has_no_room_for_its_start_is_refused_at_once():
    with simulate(one_disc((2, 2))) as sim:
        sim.set(0, position=(8, 8))
        sim.add_wall(mpsim.Circle((8, 8), 3, inside=True))
        with pytest.raises(InputError, match=r"position\[0\] must lie inside obstacles\[0\], a Circle"):
            mpsim.Simulation(sim.scene)


def test_a_journal_is_replayed_up_to_a_frame():
    with simulate(gas(20, 0.2)) as sim:
        digests = []
        for _ in range(3):
            sim.kick(1, (0.5, 0))
            digests.append(sim.digest())
            sim.run(frames=4)
        journal = sim.journal
    with mpsim.Simulation.replay(journal, frame=4) as again:
        assert (again.frame, again.digest(), len(again.journal)) == (4, digests[1], 2)
    with pytest.raises(InputError, match="frame must be a whole number from 0 to 12"):
        mpsim.Simulation.replay(journal, frame=13)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A session file with changes in the frames 0 and 4, at its end."""
    with simulate(gas(20, 0.2)) as sim:
        sim.kick(1, (0.5, 0))
        sim.run(frames=4)
        sim.kick(2, (0.5, 0))
        return sim.journal.save(tmp_path_factory.mktemp("session") / "session.toml")


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("format = 1", "format = 9", "its format is 9"),
        ("frame = 0", "frame = 0.0", "frames must be whole numbers"),
        ("frame = 0", "frame = 5", "frames must be whole numbers"),
        ('what = "kick"', 'what = "close"', "must have a time and be one of"),
        ('scene = "session', 'scene = "../session', "its scene must be a file beside it"),
        ("ids = [1]", "ids = [77]", "change 0 of a journal.*ids must be numbers of discs"),
        ("time = 0.0", "time = 0.125", "an interrupt had left that run inside a frame"),
        ("[settings]", "more = 1\n[settings]", "it has the key 'more'"),
        ("format", "= =", "must be a file that Journal.save has written"),
    ],
)
def test_a_session_file_that_is_none_is_refused_by_name(old, new, text, session, tmp_path):
    for path in session.parent.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    text_of, path = session.read_text(), tmp_path / session.name
    assert old in text_of
    path.write_text(text_of.replace(old, new, 1))
    with pytest.raises(InputError, match=text):
        mpsim.Simulation.replay(path)


def test_a_session_file_that_is_too_large_is_refused_unread(session):
    path = session.with_name("large.toml")
    path.touch()
    os.truncate(path, 2**28 + 1)
    with pytest.raises(InputError, match="it has 268,435,457 bytes, and at most 268,435,456 are read"):
        mpsim.Simulation.replay(path)


# --- ids of discs: those that were added, the nearest, those in a shape


def test_added_discs_have_ids_and_may_be_refused_where_others_are():
    scene = scene_of([[2, 2], [9, 6]], width=12, height=8, boundary=("periodic", "walls"))
    with mpsim.Simulation(scene, mpsim.Settings(method="naive")) as sim:
        assert sim.add((5, 5), (0, 0)).tolist() == [2]
        assert sim.add([(5, 2), (11.8, 4)], [(0, 0), (0, 0)], overlap="refuse").tolist() == [3, 4]
        sim.remove(2)
        assert sim.add((5, 5.2), (0, 0), overlap="refuse").tolist() == [5], "ids are never used twice"
        for places, first in (([(5.4, 5.8)], 0), ([(7, 2), (0.4, 4.3)], 1), ([(7, 2), (7.5, 2.5)], 0)):
            with pytest.raises(mpsim.InputError, match=rf"position\[{first}\] must be free for overlap='refuse'"):
                sim.add(places, np.zeros((len(places), 2)), overlap="refuse")
        assert sim.count == 6
        assert sim.add((9, 5.8), (0, 0), overlap="push").tolist() == [6]
        assert sim.add(np.zeros((0, 2)), np.zeros((0, 2)), overlap="push").tolist() == []
        moved = sim.state.position
        assert np.hypot(*(moved[6] - moved[1])) >= 1, "disc 1 has been pushed aside"
        assert moved[[0, 3, 4, 5, 6]].tolist() == [[2, 2], [5, 2], [11.8, 4], [5, 5.2], [9, 5.8]]
        assert sim.add((5, 5.8), (0, 0)).tolist() == [7], "allowed unless it is refused"
        with pytest.raises(mpsim.InputError, match="overlap must be one of 'refuse', 'push', 'allow'"):
            sim.add((7, 2), (0, 0), overlap="refused")


def test_the_nearest_disc_and_those_in_a_shape():
    scene = scene_of([[2, 2], [6, 2], [11.5, 4], [6, 6]], width=12, height=8, boundary=("periodic", "walls"))
    with mpsim.Simulation(scene, mpsim.Settings(method="naive")) as sim:
        assert [sim.nearest(*point) for point in ((5, 2.5), (0.2, 4), (6, 7))] == [1, 2, 3]
        assert sim.within((1, 1, 6, 3)).tolist() == [0, 1]
        assert sim.within(mpsim.Circle((6, 4), 2)).tolist() == [1, 3]
        assert sim.within(mpsim.Polyline([(5, 0), (12, 0), (12, 5), (5, 0)])).tolist() == [2]
        sim.remove(3)
        assert sim.nearest(6, 7) == 1
        assert sim.within(mpsim.Circle((6, 4), 2)).tolist() == [1]
        with pytest.raises(mpsim.InputError, match="shape must be numbers of shape"):
            sim.within(mpsim.FixedDisc((1, 1), 1))
