"""Observers of collisions: what they choose, count and refuse."""

import contextlib

import numpy as np
import pytest
from support.refusals import assert_says
from support.scenes import gas, simulate
from support.selection import long_but

import mpsim
from mpsim.engine.solvers.base import Choice, Solver
from mpsim.engine.solvers.mpi import MpiSolver

pytestmark = pytest.mark.slow


@contextlib.contextmanager
def refused(*parts):
    with pytest.raises(mpsim.InputError) as caught:
        yield
    assert_says(caught, parts)


def run(observers, frames=20, method="event", scene=None):
    with simulate(scene or obstructed(), method=method, dt=0.1) as sim:
        sim.run(frames=frames, observe=observers)
    return sim


def obstructed():
    discs = [mpsim.FixedDisc((2.0, 2.0), 0.3), mpsim.FixedDisc((6.0, 6.0), 0.3)]
    return mpsim.Scene.random(count=40, packing=0.3, radius=0.5, seed=3, obstacles=discs)


def test_pi_has_314_collisions():
    with mpsim.Simulation(mpsim.Scene.load("pi"), mpsim.Settings(method="event", dt=0.5)) as sim:
        seen, at_wall = mpsim.Collisions(), mpsim.Sensor(wall="left")
        anywhere = mpsim.Sensor(region=(0.0, 40.0, 0.0, 1.0))
        sim.run(until=42, observe=[seen, at_wall, anywhere])
    kinds = seen.table["kind"]
    assert (anywhere.counts.sum(), at_wall.counts.sum()) == (314, 157)
    assert (len(kinds), (kinds == 0).sum(), (kinds == 1).sum()) == (314, 157, 157)
    assert set(seen.table["j"][kinds == 1]) == {0}
    assert (np.diff(seen.table["time"]) > 0).all()
    assert (np.diff(kinds) != 0).all(), "the light disc goes from one to the other"


def test_a_lighter_disc_has_31():
    scene = mpsim.Scene.load("pi")
    ten = mpsim.Scene(
        width=scene.width, height=scene.height, position=scene.position, velocity=scene.velocity, radius=0.5,
        mass=[1.0, 100.0],
    )  # fmt: skip
    seen = mpsim.Collisions()
    with simulate(ten, method="event", dt=0.5) as sim:
        sim.run(until=36, observe=seen)
    assert len(seen.table) == 31


def test_what_is_chosen_is_a_part_of_all():
    every, discs, fixed, two = (
        mpsim.Collisions(), mpsim.Collisions(between="discs"), mpsim.Collisions(between=("walls", "obstacles")),
        mpsim.Collisions(ids=[3, 7]),
    )  # fmt: skip
    run([every, discs, fixed, two])
    table = every.table
    assert {0, 1, 2} == set(table["kind"])
    assert discs.table.tobytes() == table[table["kind"] == 0].tobytes()
    assert fixed.table.tobytes() == table[table["kind"] != 0].tobytes()
    with_two = np.isin(table["i"], [3, 7]) | ((table["kind"] == 0) & np.isin(table["j"], [3, 7]))
    assert two.table.tobytes() == table[with_two].tobytes()
    assert 0 < len(two.table) < len(table)


@pytest.mark.parametrize("method", long_but(["event", "grid"], "event"))
def test_sensors_count_what_the_table_says(method):
    seen = mpsim.Collisions()
    sensors = {
        "obstacle": mpsim.Sensor(obstacle=1, every=5),
        "wall": mpsim.Sensor(wall="top", every=5),
        "region": mpsim.Sensor(region=(0.0, 4.0, 0.0, 3.0), every=5),
    }
    run([seen, *sensors.values()], method=method, frames=60)
    table, (x, y) = seen.table, seen.table["place"].T
    chosen = {
        "obstacle": (table["kind"] == 2) & (table["j"] == 1),
        "wall": (table["kind"] == 1) & (table["j"] == 3),
        "region": (x < 4.0) & (y < 3.0),
    }
    for name, sensor in sensors.items():
        assert sensor.frames.tolist() == list(range(5, 61, 5))
        look = (table["frame"][chosen[name]] - 1) // 5
        size = np.hypot(*table["impulse"][chosen[name]].T)
        assert sensor.counts.tolist() == np.bincount(look, minlength=12).tolist()
        assert sensor.impulse == pytest.approx(np.bincount(look, size, minlength=12))
        assert sensor.counts.sum() > 0, name


def test_frames_that_nobody_observed_are_not_in_it():
    seen = mpsim.Collisions()
    with simulate(obstructed(), method="event", dt=0.1) as sim:
        sim.run(frames=10, observe=seen)
        sim.run(frames=10)
        sim.run(frames=10, observe=seen)
    everything = mpsim.Collisions()
    run(everything, frames=30)
    frames = everything.table["frame"]
    assert seen.table.tobytes() == everything.table[(frames <= 10) | (frames > 20)].tobytes()


@pytest.mark.long
def test_discs_that_enter_are_seen_too():
    scene = mpsim.Scene(
        width=10.0, height=4.0, position=[[8.0, 2.0]], velocity=[[0.0, 0.0]], radius=0.5,
        emitters=mpsim.Emitter((1.0, 2.0), velocity=(1.0, 0.0), interval=1.0, limit=1),
    )  # fmt: skip
    for method in ("event", "grid"):
        seen = mpsim.Collisions(between="discs")
        run(seen, frames=90, method=method, scene=scene)
        assert (seen.table["i"][0], seen.table["j"][0]) == (0, 1)
        assert seen.table["impulse"][0] == pytest.approx([1.0, 0.0], abs=1e-9)


WRONG = {
    "every": {"every": 0},
    "between": {"between": "disks"},
    "between what": {"between": 3},
    "ids": {"ids": [1, -1]},
    "ids that are no numbers": {"ids": "all"},
    "each": {"each": 3},
}


@pytest.mark.parametrize("name", WRONG)
def test_arguments_out_of_range_are_refused(name):
    with refused(name.split()[0]):
        mpsim.Collisions(**WRONG[name])


WRONG_SENSORS = {
    "nothing": {},
    "two": {"obstacle": 1, "wall": "left"},
    "obstacle": {"obstacle": -1},
    "wall": {"wall": "lft"},
    "region": {"region": (1.0, 0.0, 0.0, 1.0)},
    "shape": {"region": (1.0, 0.0)},
}


@pytest.mark.parametrize("name", WRONG_SENSORS)
def test_sensors_of_nothing_are_refused(name):
    with refused("obstacle" if name in ("nothing", "two") else "region" if name == "shape" else name):
        mpsim.Sensor(**WRONG_SENSORS[name])


def test_an_obstacle_that_is_not_there_is_refused():
    with refused("obstacle of a Sensor"):
        run(mpsim.Sensor(obstacle=2))


def test_another_simulation_is_refused():
    seen = mpsim.Collisions()
    kept = run(seen, frames=1)
    with refused("belongs to one simulation"):
        run(seen, frames=1)
    assert kept.scene.count == 40


def test_another_kind_of_observer_needs_no_log():
    class Frames:
        every = 1
        seen = 0

        def look(self, sim, collisions):
            self.seen += 1

    frames = Frames()
    with simulate(gas(20, 0.2), method="grid") as sim:
        sim.run(frames=3, observe=frames)
        assert "collisions" not in sim.array_names
    assert frames.seen == 4


def test_ranks_do_not_log_them():
    class OnRanks:
        choice = Choice("mpi", (1,))

    assert MpiSolver.log_collisions is Solver.log_collisions
    with refused("method='mpi'", "does not log collisions", "'event'"):
        Solver.log_collisions(OnRanks(), True)
    Solver.log_collisions(OnRanks(), False)
