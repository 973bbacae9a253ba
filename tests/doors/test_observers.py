"""Observers of collisions: what they choose, count, hand over and refuse."""

import numpy as np
import pytest
from support.refusals import assert_refused
from support.scenes import simulate

from mpsim import Collisions, FixedDisc, InputError, Scene, Sensor
from mpsim.errors import ClosedError

pytestmark = pytest.mark.plain

DISCS, WALLS, OBSTACLES = 0, 1, 2


def obstructed():
    pegs = [FixedDisc((2.0, 2.0), 0.3), FixedDisc((6.0, 6.0), 0.3)]
    return Scene.random(count=30, packing=0.3, radius=0.5, seed=3, obstacles=pegs)


def run(observers, frames=20, method="event", scene=None):
    with simulate(scene or obstructed(), method=method, dt=0.1) as sim:
        sim.run(frames=frames, observe=observers)
    return sim


def test_what_is_chosen_is_a_part_of_all():
    every, discs, fixed, two = chosen = (
        Collisions(), Collisions(between="discs"), Collisions(between=("walls", "obstacles")), Collisions(ids=[3, 7]),
    )  # fmt: skip
    run(list(chosen))
    table = every.table
    assert {DISCS, WALLS, OBSTACLES} == set(table["kind"])
    assert discs.table.tobytes() == table[table["kind"] == DISCS].tobytes()
    assert fixed.table.tobytes() == table[table["kind"] != DISCS].tobytes()
    with_two = np.isin(table["i"], [3, 7]) | ((table["kind"] == DISCS) & np.isin(table["j"], [3, 7]))
    assert two.table.tobytes() == table[with_two].tobytes()
    assert 0 < len(two.table) < len(table)


@pytest.mark.parametrize("method", ["event", "grid"])
def test_sensors_count_what_the_table_says_and_rows_are_handed_over_at_each_look(method):
    handed = []
    seen = Collisions(every=3, callback=lambda sim, rows: handed.append((sim.frame, rows.copy())))
    sensors = {
        "obstacle": Sensor(obstacle=1, every=5),
        "wall": Sensor(wall="top", every=5),
        "region": Sensor(region=(0.0, 4.0, 0.0, 3.0), every=5),
        "discs of the region": Sensor(region=(0.0, 4.0, 0.0, 3.0), every=5, between="discs"),
    }
    run([seen, all_rows := Collisions(), *sensors.values()], method=method, frames=40)
    table = all_rows.table
    assert [frame for frame, _ in handed] == list(range(3, 40, 3))
    assert all(np.isin(rows["frame"], [frame - 2, frame - 1, frame]).all() for frame, rows in handed)
    rest = seen.table
    assert (rest["frame"] == 40).all()
    assert np.concatenate([*(rows for _, rows in handed), rest]).tobytes() == table.tobytes()
    x, y = table["place"].T
    if method == "grid":  # by `push`, which finds a contact where the frame ends
        assert table["time"] == pytest.approx(table["frame"] * 0.1)
    chosen = {
        "obstacle": (table["kind"] == OBSTACLES) & (table["j"] == 1),
        "wall": (table["kind"] == WALLS) & (table["j"] == 3),
        "region": (x < 4.0) & (y < 3.0),
        "discs of the region": (x < 4.0) & (y < 3.0) & (table["kind"] == DISCS),
    }
    for name, sensor in sensors.items():
        assert sensor.frames.tolist() == list(range(5, 41, 5))
        look = (table["frame"][chosen[name]] - 1) // 5
        size = np.hypot(*table["impulse"][chosen[name]].T)
        assert sensor.counts.tolist() == np.bincount(look, minlength=8).tolist()
        assert sensor.impulse == pytest.approx(np.bincount(look, size, minlength=8))
        assert sensor.counts.sum() > 0, name
        assert not sensor.tangential_impulse.any(), "smooth discs"


def test_frames_that_nobody_observed_are_not_in_it():
    seen, everything = Collisions(), Collisions()
    with simulate(obstructed(), method="event", dt=0.1) as sim:
        for observer in (seen, None, seen):
            sim.run(frames=10, observe=observer)
    run(everything, frames=30)
    frames = everything.table["frame"]
    assert seen.table.tobytes() == everything.table[(frames <= 10) | (frames > 20)].tobytes()


@pytest.mark.parametrize(
    ("kind", "arguments", "part"),
    [
        (Collisions, {"between": "disks"}, "got 'disks'. Did you mean 'discs'?"),
        (Collisions, {"ids": [1, -1]}, "ids must be numbers of discs"),
        (Collisions, {"callback": 3}, "callback must be a function of a simulation and a table"),
        (Sensor, {"obstacle": 1, "wall": "left"}, "one of obstacle, wall and region"),
        (Sensor, {"region": (1.0, 0.0, 0.0, 1.0)}, "region must be (x_low, x_high, y_low, y_high)"),
    ],
)
def test_arguments_out_of_range_are_refused(kind, arguments, part):
    assert_refused([part], kind, **arguments)


def test_an_obstacle_that_is_not_there_and_another_simulation_are_refused():
    with pytest.raises(InputError, match="obstacle of a Sensor"):
        run(Sensor(obstacle=2), frames=1)
    seen = Collisions()
    kept = run(seen, frames=1)
    with pytest.raises(InputError, match="belongs to one simulation"):
        run(seen, frames=1)
    assert kept.scene.count == 30


class Meddles:
    """Does something to the simulation, or to itself, at the end of frame 6."""

    every = 3

    def __init__(self, deed):
        self.deed = deed

    def observe(self, sim, collisions):
        if sim.frame == 6:
            self.deed(self, sim)


@pytest.mark.parametrize("frames", [0, 6, 60])
@pytest.mark.parametrize("method", ["event", "grid"])
def test_a_simulation_that_an_observer_closes_says_so_whatever_goes_on_beside_the_run(method, frames, tmp_path):
    beside = {"progress": lambda *_: None}, {"checkpoint": tmp_path / "run"}, {"checkpoint_every": 4}
    for each in ({}, *beside[:2], beside[1] | beside[2]):
        with simulate(obstructed(), method=method) as sim:
            sim.run(frames=0 if frames else 6)
            with pytest.raises(ClosedError, match="closed after frame 6"):
                sim.run(frames=frames, observe=Meddles(lambda _, sim: sim.close()), **each)


@pytest.mark.parametrize("every", [0, -3, 2.5, None])
def test_an_observer_may_change_how_often_it_looks_but_not_to_never(every):
    with simulate(obstructed(), method="grid") as sim:
        with pytest.raises(InputError, match=f"every of an observer must be a whole number from 1 .*got {every}"):
            sim.run(frames=9, observe=Meddles(lambda self, _: setattr(self, "every", every)))
        assert (sim.frame, sim.run(frames=3).frames) == (6, 3)
