"""Discs and parameters changed between two frames: what is refused, by name, and what comes of the rest."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from support.refusals import assert_says
from support.scenes import gas, lattice, simulate, zoo
from support.selection import long_but
from support.sessions import METHODS, room
from support.tiles import first_free_place

import mpsim
from mpsim.measure import kinetic_energy

NAN, INF = float("nan"), float("inf")
WORDS = list(METHODS)

SET = [
    ({"ids": 20, "velocity": (0, 0)}, ["ids must be numbers of discs, from 0 to 19", "got 20"]),
    ({"ids": -1, "velocity": (0, 0)}, ["ids must be numbers of discs", "got -1"]),
    ({"ids": [1, 2, 1], "velocity": (0, 0)}, ["ids must hold each disc once", "disc 1 is in it 2 times"]),
    ({"ids": 1.5, "velocity": (0, 0)}, ["ids must be whole numbers", "got 1.5"]),
    ({"ids": [[1]], "velocity": (0, 0)}, ["ids must be whole numbers", "[[1]]"]),
    ({"ids": "all", "velocity": (0, 0)}, ["ids must be whole numbers", "'all'"]),
    ({"ids": [[1], [2, 3]], "velocity": (0, 0)}, ["ids must be whole numbers", "[[1], [2, 3]]"]),
    ({"ids": None, "velocity": (0, 0)}, ["ids must be whole numbers", "None"]),
    ({"ids": [True] * 20, "velocity": (0, 0)}, ["ids must be whole numbers", "numpy.flatnonzero"]),
    ({"ids": 9, "velocity": (0, 0)}, ["ids must be discs that are there", "disc 9 has been removed"]),
    ({"ids": 1}, ["set needs something to set", "position, velocity, acceleration, spin"]),
    ({"ids": 1, "position": (NAN, 1)}, ["position must be finite", "nan"]),
    ({"ids": 1, "position": (1, 99)}, ["position[0] must lie in", "99"]),
    ({"ids": 1, "position": (0.25, 1)}, ["position[0] must lie in", "0.25"]),
    ({"ids": [1, 2], "position": (1, 1)}, ["position must have shape (2, 2)", "got shape (1, 2)"]),
    ({"ids": 1, "velocity": (INF, 0)}, ["velocity must be finite", "inf"]),
    ({"ids": [1, 2], "velocity": [(1, 0)] * 3}, ["velocity must have shape (2,) or (2, 2)", "(3, 2)"]),
    ({"ids": [1, 2], "velocity": [(1, 0), (1,)]}, ["velocity must be numbers of shape (2,) or (2, 2)"]),
    ({"ids": 1, "velocity": np.array([1j, 1])}, ["velocity must be numbers of shape (2,)", "complex128"]),
    ({"ids": 1, "velocity": (1e200, 0)}, ["velocity must be at most", "1e+200"]),
    ({"ids": 1, "spin": 1.0}, ["spin can be set only in a scene of rough discs", "1.0"]),
    ({"ids": 1, "acceleration": (0, 1)}, ["acceleration can be set only in a scene", "(0, 1)"]),
]
KICK = [
    ({"ids": 20, "impulse": (0, 0)}, ["ids must be numbers of discs", "got 20"]),
    ({"ids": 9, "impulse": (0, 0)}, ["disc 9 has been removed"]),
    ({"ids": 1, "impulse": (NAN, 0)}, ["impulse must be finite", "nan"]),
    ({"ids": 1, "impulse": 3.0}, ["impulse must have shape (2,) or (1, 2)", "got shape ()"]),
    ({"ids": 1, "impulse": (1e300, 0)}, ["impulse must be at most", "1e+300"]),
]
REMOVE = [
    ({"ids": 20}, ["ids must be numbers of discs", "got 20"]),
    ({"ids": [3, 3]}, ["ids must hold each disc once"]),
    ({"ids": [3, 9]}, ["disc 9 has been removed"]),
]
CHANGE = [
    ({}, ["change needs something to change", "gravity, restitution"]),
    ({"gravty": (0, 1)}, ["'gravty' is not a parameter of a simulation", "Did you mean 'gravity'?"]),
    ({"method": "grid"}, ["'method' is fixed from the start", "What can be changed: gravity"]),
    ({"width": 3.0}, ["'width' is fixed from the start"]),
    ({"gravity": (0, NAN)}, ["gravity must be finite", "nan"]),
    ({"gravity": 9.8}, ["gravity must be two numbers, along x and y; got 9.8. Downwards it is (0, -9.8)"]),
    ({"gravity": None}, ["gravity must be two numbers", "got None", "Give (0, 0)"]),
    ({"gravity": [[1], [2, 3]]}, ["gravity must be numbers of shape (2,)", "[[1], [2, 3]]"]),
    ({"contact": [[1], [2, 3]]}, ["contact must be one of", "[[1], [2, 3]]"]),
    ({"restitution": 1.5}, ["restitution must be a number from 0 to 1", "1.5"]),
    ({"wall_restitution": "low"}, ["wall_restitution must be a number from 0 to 1", "'low'"]),
    ({"dt": 0}, ["dt must be a finite number > 0", "got 0"]),
    ({"dt": "quick"}, ["dt must be a number > 0", "'quick'"]),
    ({"contact": "pus"}, ["contact must be one of", "Did you mean 'push'?"]),
    ({"passes": 0}, ["passes must be a whole number from 1", "got 0"]),
    ({"substeps": 0}, ["substeps must be a whole number from 1", "got 0"]),
    ({"workers": 0}, ["workers must be a whole number from 1", "got 0"]),
    ({"piston_speed": -1.0}, ["piston_speed can be changed only in a scene with a piston", "-1.0"]),
    ({"interval": 0.5}, ["interval can be changed only in a scene with emitters that have it", "0.5"]),
    ({"every": 5}, ["every can be changed only in a scene with emitters that have it", "5"]),
    ({"friction": 0.5}, ["friction can be changed only in a scene that has it, and got 0.5"]),
    ({"wall_friction": -1}, ["wall_friction can be changed only in a scene that has it, and got -1"]),
    ({"temperature": 2.0}, ["temperature can be changed only in a scene with a thermostat, and got 2.0"]),
    ({"wall_temperature": [1]}, ["wall_temperature can be changed only in a scene with thermal walls, and got [1]"]),
    ({"restitution": 0.5, "dt": -1}, ["dt must be a finite number > 0", "-1"]),
]
WALL = [
    ({"points": [(1, 1)]}, ["points of a Polyline must be at least two", "[[1.0, 1.0]]"]),
    ({"points": [(1, 1), (1, 1)]}, ["points of a Polyline must be at least two"]),
    ({"points": [(1, 1), (1, NAN)]}, ["points of a Polyline must be finite", "nan"]),
    ({"points": "wall"}, ["points of a Polyline must be numbers of shape (K, 2)", "'wall'"]),
    ({"points": [(1, 1), (99, 1)]}, ["points of a wall must be in the box", "(99.0, 1.0)"]),
    ({"points": [(1, 1), (2, 1)], "thickness": -1}, ["thickness of a Polyline", "-1"]),
    ({"points": [(0, 0), (8, 8)], "thickness": 3}, ["a wall must be clear of all discs; got disc ", "inside it"]),
]
NO_STEPS = ["can be changed only where frames are made of steps", "with method='event', which has none"]
TABLE = [
    (name, *line)
    for name, lines in (("set", SET), ("kick", KICK), ("remove", REMOVE), ("change", CHANGE), ("add_wall", WALL))
    for line in lines
]


@pytest.mark.parametrize("words", long_but(["grid", "event as a whole"], "grid"))
def test_what_is_wrong_is_refused_by_name_and_changes_nothing(words):
    with simulate(gas(20, 0.2), dt=0.01, **METHODS[words]) as sim:
        sim.run(frames=2)
        sim.remove(9)
        before = sim.digest(), sim.scene.digest(), sim.settings, len(sim.journal)
        for name, arguments, parts in TABLE:
            of_steps = "event" in words and name == "change" and arguments.keys() & {"contact", "passes", "substeps"}
            with pytest.raises(mpsim.InputError) as caught:
                getattr(sim, name)(**arguments)
            assert_says(caught, NO_STEPS if of_steps else parts)
            assert (sim.digest(), sim.scene.digest(), sim.settings, len(sim.journal)) == before, (name, arguments)
        assert sim.run(frames=1).frames == 1


def test_an_unknown_column_is_refused_with_those_that_there_are():
    with (
        simulate(gas(20, 0.2)) as sim,
        pytest.raises(mpsim.InputError, match=r"an argument of Simulation.set must be one of 'ids', .*; got 'colour'"),
    ):
        sim.set(1, colour=3)


@pytest.mark.usefixtures("compiled_when_run")
@pytest.mark.parametrize(
    ("features", "arguments", "parts"),
    [
        (
            {"piston": mpsim.Piston("right", -0.5, 9)},
            {"piston_speed": 0.5},
            ["speed of a Piston must point into the box"],
        ),
        ({"piston": mpsim.Piston("right", -0.5, 9)}, {"piston_speed": -1e200}, ["speed of a wall must be at most"]),
        ({"emitters": mpsim.Emitter((1, 1), (1, 0), every=5)}, {"interval": 0.5}, ["emitters that have it"]),
        ({"emitters": mpsim.Emitter((1, 1), (1, 0), interval=5)}, {"interval": -1}, ["interval of an Emitter", "-1"]),
        ({"emitters": mpsim.Emitter((1, 1), (1, 0), interval=5)}, {"interval": [1, 2]}, ["one for each of 1 emitters"]),
        ({"obstacles": mpsim.FixedDisc((5, 5), 1)}, None, ["position[0]", "obstacle"]),
    ],
)
def test_what_does_not_fit_the_scene_is_refused(features, arguments, parts):
    scene = mpsim.Scene(width=12, height=12, position=[[9, 9]], velocity=[[0, 0]], radius=0.5, **features)
    with simulate(scene) as sim:
        before = sim.digest(), sim.scene.digest()
        with pytest.raises(mpsim.InputError) as caught:
            sim.set(0, position=(5, 6.25)) if arguments is None else sim.change(**arguments)
        for part in parts:
            assert part in str(caught.value)
        assert (sim.digest(), sim.scene.digest()) == before


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_the_exact_solver_refuses_discs_that_overlap(workers):
    with simulate(lattice(4, 4), method="event", workers=workers) as sim:
        sim.run(frames=3)
        before, there = sim.digest(), sim.state.position[5]
        with pytest.raises(mpsim.InputError, match="discs 3 and 5 overlap"):
            sim.set(3, position=there)
        assert (sim.digest(), len(sim.journal)) == (before, 0)
        sim.remove(5)
        sim.set(3, position=there)
        assert sim.run(frames=3).frames == 3


def test_the_exact_solver_refuses_speeds_that_no_run_would_follow():
    """As it does at the start: a frame of them would take years."""
    with simulate(gas(20, 0.2), method="event", dt=1.0) as sim:
        sim.run(frames=3)
        before = sim.digest(), len(sim.journal)
        for change in (
            lambda: sim.set(0, velocity=(1e12, 0)),
            lambda: sim.kick(0, (0, -1e12)),
            lambda: sim.add(first_free_place(sim.state), (1e12, 0)),
            lambda: sim.change(dt=1e40),
        ):
            with pytest.raises(mpsim.InputError, match="dt must be short enough"):
                change()
            assert (sim.digest(), len(sim.journal)) == before
        sim.set(0, velocity=(1e2, 0))  # the control
        assert sim.run(frames=1).frames == 1
    wall = mpsim.Scene(
        width=9, height=9, position=[[2, 2]], velocity=[[1, 0]], radius=0.5, piston=mpsim.Piston("right", -1e30, 6)
    )
    with pytest.raises(mpsim.InputError, match="dt must be short enough"):
        simulate(wall, method="event", dt=0.01)


def pressure_of_a_gas_times(factor, method):
    """Over the square of a factor, a power of two, by which all velocities are multiplied after two frames."""
    scene = gas(20, 0.2)
    with simulate(scene, method=method, contact="impact", dt=0.01) as sim:
        sim.run(frames=2)
        sim.change(dt=0.01 / factor)
        sim.set(np.arange(20), velocity=sim.state.velocity * factor)
        found = sim.run(frames=400, measures=["pressure"]).measures["pressure"].value
    return found / factor**2


@pytest.mark.parametrize(("method", "fits", "does_not"), [("event", 2.0**34, 2.0**40), ("grid", 2.0**22, 2.0**28)])
def test_speeds_whose_impulses_cannot_be_added_up_are_refused(method, fits, does_not):
    usual = pressure_of_a_gas_times(1.0, method)
    assert pressure_of_a_gas_times(fits, method) == pytest.approx(usual, rel=1e-6)
    with pytest.raises(mpsim.InputError, match=r"velocity must give speeds of at most .* of impulses"):
        pressure_of_a_gas_times(does_not, method)


def test_each_door_refuses_speeds_whose_impulses_cannot_be_added_up():
    with simulate(gas(20, 0.2), method="event", dt=1e-9) as sim:
        before = sim.digest(), len(sim.journal)
        for change, name in (
            (lambda: sim.set(0, velocity=(1e14, 0)), "velocity must"),
            (lambda: sim.kick(0, (0, -1e14)), "the velocity after the kick must"),
            (lambda: sim.add(first_free_place(sim.state), (1e14, 0)), "velocity must"),
        ):
            with pytest.raises(mpsim.InputError, match=f"{name} give speeds of at most .*; got 1e"):
                change()
            assert (sim.digest(), len(sim.journal)) == before
        sim.set(0, velocity=(1e11, 0))  # the control
        assert sim.run(frames=1).frames == 1


def test_a_stepped_method_parts_discs_that_are_set_on_each_other():
    with simulate(lattice(4, 4), method="grid", contact="push") as sim:
        sim.set(3, position=sim.state.position[5] + 0.25)
        sim.run(frames=100)
        assert np.hypot(*(sim.state.position[3] - sim.state.position[5])) > 0.9


@pytest.mark.parametrize("words", WORDS)
@pytest.mark.parametrize("name", long_but(["", "masses rough"], ""))
def test_set_and_kick_do_what_they_say(words, name):
    scene = zoo(name, count=20, side=30.0) if "event" not in words else room(20)
    mass = scene.masses
    with simulate(scene, dt=0.01, **METHODS[words]) as sim:
        sim.run(frames=3)
        before, place = sim.state, first_free_place(sim.state)
        sim.set([2, 4], velocity=(0.5, -0.25))
        sim.set(4, position=place)
        sim.kick([7, 6], [(1.0, 0.0), (0.0, 2.0)])
        sim.kick(np.array([8]), (0.25, 0.25))
        now = sim.state
        expected = before.velocity.copy()
        expected[[2, 4]] = 0.5, -0.25
        for disc, impulse in ((7, (1.0, 0.0)), (6, (0.0, 2.0)), (8, (0.25, 0.25))):
            expected[disc] += np.array(impulse) / mass[disc]
        assert np.array_equal(now.velocity, expected)
        others = np.arange(20) != 4
        assert np.array_equal(now.position[others], before.position[others])
        assert now.position[4].tolist() == pytest.approx(place, abs=1e-15)
        assert (sim.frame, len(sim.journal)) == (3, 4)


@pytest.mark.slow
@pytest.mark.parametrize("precision", long_but(["float32", "float64"], "float64"))
def test_a_kick_is_computed_in_float64_and_kept_in_the_precision_of_the_run(precision):
    with simulate(zoo("masses", count=20), method="grid", precision=precision) as sim:
        before = sim.state.velocity.astype(float)
        sim.kick(5, (0.1, 0.3))
        expected = (before[5] + np.array([0.1, 0.3]) / sim.masses[5]).astype(precision)
        assert np.array_equal(sim.state.velocity[5], expected)


@pytest.mark.slow
@pytest.mark.parametrize("words", WORDS)
def test_a_removed_disc_is_absent_and_the_others_keep_their_numbers(words):
    """One that flies at a removed one passes through where it was."""
    scene = mpsim.Scene(width=12, height=3, position=[[2, 1.5], [6, 1.5]], velocity=[[2, 0], [0, 0]], radius=0.5)
    with simulate(scene, dt=0.01, **METHODS[words]) as sim:
        sim.remove(1)
        sim.run(frames=200, measures=["kinetic_energy"])
        state = sim.state
        assert (sim.count, state.present.tolist(), sim.absorbed.tolist()) == (2, [True, False], [False, True])
        assert state.position.tolist() == [[pytest.approx(6.0), 1.5], [6.0, 1.5]]
        assert kinetic_energy(state, scene) == 2.0
        sim.add((9.0, 1.5), (0.0, 0.0))
        assert (sim.count, sim.state.present.tolist()) == (3, [True, False, True])
        sim.remove([0, 2])
        sim.run(frames=5)
        assert not sim.state.present.any()


def test_with_the_disc_there_it_would_be_met():
    """The control of the one before."""
    scene = mpsim.Scene(width=12, height=3, position=[[2, 1.5], [6, 1.5]], velocity=[[2, 0], [0, 0]], radius=0.5)
    with simulate(scene, dt=0.01, method="grid") as sim:
        sim.run(frames=200)
        assert sim.state.position[0, 0] < 5.1


@pytest.mark.slow
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
            with pytest.raises(mpsim.InputError, match="removed discs"):
                sim.run(frames=1, measures=[name])
    frames = list(mpsim.Trajectory(tmp_path / "t.xyz"))
    assert [len(frame.position) for frame in frames] == [20, 20]
    assert not set(range(10, 20)) & set(frames[0].ids.tolist())


def test_energy_that_was_put_in_is_no_drift():
    """Between two runs it is counted by neither; in a run nobody knows what it was, and the drift is NaN."""

    class Kick:
        every = 10

        def look(self, sim, collisions):
            if sim.frame == 20:
                sim.kick(0, (5.0, 0.0))

    with simulate(gas(30, 0.3, seed=2), method="grid") as sim:
        sim.kick(0, (5.0, 0.0))
        assert abs(sim.run(frames=10, measures=["energy_drift"]).measures["energy_drift"].value) < 1e-10
        report = sim.run(frames=20, measures=["energy_drift", "momentum_drift", "temperature"], observe=Kick())
        assert np.isnan(report.measures["energy_drift"].value)
        assert np.isnan(report.measures["momentum_drift"].value)
        assert report.measures["temperature"].value > 0
        assert abs(sim.run(frames=10, measures=["energy_drift"]).measures["energy_drift"].value) < 1e-10


@pytest.mark.parametrize("words", WORDS)
def test_a_disc_falls_as_gravity_is_changed(words):
    scene = mpsim.Scene(width=30, height=30, position=[[15, 15]], velocity=[[0, 0]], radius=0.5)
    with simulate(scene, dt=0.125, contact="impact", **METHODS[words]) as sim:
        sim.change(gravity=(0, -1))
        sim.run(frames=8)
        sim.change(gravity=(2, 0), dt=0.0625)
        sim.run(frames=16)
        assert sim.state.velocity[0].tolist() == pytest.approx([2, -1])
        assert sim.state.position[0].tolist() == pytest.approx([16, 13.5])
        assert (sim.time, sim.frame, sim.origin, sim.settings.dt) == (2.0, 24, (8, 1.0), 0.0625)
        assert sim.run(until=3.0).frames == 16


@pytest.mark.slow
@pytest.mark.parametrize("words", long_but(WORDS, "grid"))
def test_a_piston_goes_on_from_where_it_is(words):
    scene = mpsim.Scene(
        width=16, height=4, position=[[2, 2]], velocity=[[0, 0]], radius=0.5, piston=mpsim.Piston("right", -1.0, 6.0)
    )
    with simulate(scene, dt=0.125, **METHODS[words]) as sim:
        sim.run(frames=16)
        assert sim.state.box[1] == 14.0
        sim.change(piston_speed=-0.5)
        sim.run(frames=16)
        assert sim.state.box[1] == 13.0
        sim.change(dt=0.25)
        sim.remove([])
        sim.run(frames=8)
        assert (sim.state.box[1], sim.time) == (12.0, 6.0)
        with pytest.raises(mpsim.InputError, match=r"position\[0\] must lie in"):
            sim.set(0, position=(12.0, 2.0))
        sim.run(frames=100)
        assert sim.state.box[1] == 6.0


@pytest.mark.parametrize("words", WORDS)
def test_the_rate_of_an_emitter_is_changed_within_its_interval(words):
    """A quarter of the first interval is left: a quarter of the new one remains."""
    emitter = mpsim.Emitter((1.0, 2.0), (4.0, 0.0), interval=1.0)
    scene = mpsim.Scene(width=40, height=4, position=[[30, 2]], velocity=[[0, 0]], radius=0.5, emitters=emitter)
    with simulate(scene, dt=0.125, **METHODS[words]) as sim:
        entered = []
        for frame in range(16):
            if frame == 6:
                sim.change(interval=0.5)
            sim.run(frames=1)
            entered.append(sim.count - 1)
    assert np.searchsorted(entered, [1, 2, 3], side="left").tolist() == [6, 10, 14]


def test_dt_is_not_changed_in_a_callback():
    found = []

    class Slower:
        every = 1

        def look(self, sim, collisions):
            try:
                sim.change(dt=0.5)
            except mpsim.InputError as error:
                found.append(str(error))

    with simulate(gas(20, 0.2)) as sim:
        sim.run(frames=1, observe=Slower())
        assert "between two runs, not in a callback of a run" in found[0]
        sim.change(dt=0.005)


def test_a_speed_that_is_refused_is_not_given():
    with simulate(lattice(4, 4), method="grid", dt=0.01, on_fast="error") as sim:
        sim.run(frames=2)
        before = sim.digest()
        for change in (
            lambda: sim.kick(1, (500, 0)),
            lambda: sim.set(1, velocity=(500, 0)),
            lambda: sim.change(dt=10.0),
        ):
            with pytest.raises(mpsim.TooFastError):
                change()
            assert (sim.digest(), len(sim.journal), sim.settings.dt) == (before, 0, 0.01)
        sim.run(frames=2)
        digest = sim.digest()
    with simulate(lattice(4, 4), method="grid", dt=0.01) as sim:
        sim.run(frames=4)
        assert sim.digest() == digest


def test_a_fast_disc_divides_the_frames_that_follow():
    with simulate(lattice(4, 4), method="grid", dt=0.01, on_fast="substep") as sim:
        before = sim.substeps
        sim.set(1, velocity=(500, 0))
        assert sim.substeps > 10 * before
        sim.change(passes=2)
        assert sim.substeps > 10 * before


OF_DISCS = some.lists(
    some.tuples(
        some.sampled_from(["set", "kick", "remove", "place"]),
        some.integers(0, 29),
        some.floats(-2, 2, allow_subnormal=False),
        some.floats(-2, 2, allow_subnormal=False),
    ),
    min_size=1,
    max_size=6,
)


def changed(sim, changes):
    """Make changes, each after two frames; those of discs that have been removed are none."""
    for what, disc, x, y in changes:
        sim.run(frames=2)
        if not sim.state.present[disc]:
            continue
        if what == "set":
            sim.set(disc, velocity=(x, y))
        elif what == "kick":
            sim.kick(disc, (x, y))
        elif what == "remove":
            sim.remove(disc)
        else:
            sim.set(disc, position=first_free_place(sim.state))


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(changes=OF_DISCS)
@pytest.mark.parametrize("words", long_but(["naive", "grid", "parallel on 2"], "grid"))
def test_what_follows_is_what_a_new_simulation_of_the_changed_state_does(words, changes):
    """Bit for bit; for the exact solver, whose clock then has other digits, see the next one."""
    scene = room(30, gravity=(0.0, -0.25))
    with simulate(scene, dt=0.01, **METHODS[words]) as sim:
        changed(sim, changes)
        state = sim.state
        sim.run(frames=5)
        with simulate(scene.starting_from(state), dt=0.01, **METHODS[words]) as fresh:
            fresh.run(frames=5)
            now, here = sim.state, sim.state.present
            assert np.array_equal(fresh.state.position, now.position[here])
            assert np.array_equal(fresh.state.velocity, now.velocity[here])
        with simulate(scene, dt=0.01, **METHODS[words]) as unchanged:  # the control
            unchanged.run(frames=sim.frame)
            moved = any(x or y for what, _, x, y in changes if what == "kick") or any(
                what == "remove" for what, *_ in changes
            )
            assert not moved or unchanged.digest() != sim.digest()


@pytest.mark.long
@settings(max_examples=25, deadline=None)
@given(changes=OF_DISCS)
def test_the_exact_solver_goes_on_as_a_new_one_from_the_changed_state_but_for_rounding(changes):
    scene = room(30, gravity=(0.0, -0.25))
    with simulate(scene, dt=0.01, method="event") as sim:
        changed(sim, changes)
        state = sim.state
        sim.run(frames=5)
        with simulate(scene.starting_from(state), dt=0.01, method="event") as fresh:
            fresh.run(frames=5)
            here = sim.state.present
            assert np.abs(fresh.state.position - sim.state.position[here]).max(initial=0) < 1e-9


def test_settings_in_force_are_those_of_the_scene_and_settings():
    with simulate(gas(20, 0.2), dt=0.01) as sim:
        given_then = sim.scene, sim.settings
        sim.change(restitution=0.5, passes=2)
        assert (sim.scene.restitution, sim.settings) == (0.5, dataclasses.replace(given_then[1], passes=2))
        assert (given_then[0].restitution, sim.journal.scene) == (1.0, given_then[0])
