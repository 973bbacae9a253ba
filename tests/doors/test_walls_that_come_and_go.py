"""Walls that are put up, moved, stopped and taken away in a run: what follows, what is kept, what is refused."""

import re

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim import FixedDisc, Oscillation, Polyline, Rotation, Translation

pytestmark = pytest.mark.plain

BOX = {"width": 12, "height": 6, "position": [[2, 3], [10, 3]], "velocity": [[1, 0], [-0.5, 0.25]], "radius": 0.5}
HOW = {"dt": 1 / 64, "contact": "impact"}


def a_busy_run(sim):
    """Walls of all kinds of change; returns their numbers."""
    sim.run(frames=10)
    one = sim.add_wall([(5, 0), (5, 6)], 0.25)
    other = sim.add_wall([(7, 3), (8, 3)], motion=Rotation((7, 3), rate=1.0, start=0.25), surface_velocity=0.0)
    sim.run(frames=40)
    sim.move_wall(one, Translation((-0.5, 0), stop=1.0))
    sim.run(frames=40)
    sim.move_wall(other, Oscillation((0.25, 0.5), period=1.5))
    sim.move_wall(one)
    sim.run(frames=40)
    sim.remove_wall(one)
    last = sim.add_wall([(6, 5), (6, 6)])
    sim.run(frames=40)
    return one, other, last


@pytest.mark.parametrize("method", ["grid", "event", "naive"])
def test_every_change_is_kept_in_checkpoints_sessions_and_snapshots(tmp_path, method):
    scene = mpsim.Scene(**BOX, obstacles=FixedDisc((3, 5), 0.25))
    with simulate(scene, method=method, **HOW) as sim:
        assert a_busy_run(sim) == (1, 2, 3), "the numbers go on, and none is used twice"
        assert [type(each).__name__ for each in sim.scene.obstacles] == ["FixedDisc", "Removed", "Polyline", "Polyline"]
        sim.set(1, position=(7.5, 4.75), velocity=(0, -1.5))
        sim.save(tmp_path / "run.mpsim")
        sim.journal.save(tmp_path / "run.toml")
        snapshot, middle = sim.snapshot(), sim.digest()
        sim.remove_wall(2)
        sim.run(frames=80)
        other = sim.digest()
        sim.restore(snapshot)
        assert (sim.digest(), len(sim.scene.capsules_at(0.0))) == (middle, 3)
        sim.run(frames=80)
        end = sim.digest()
    assert end != other, "the wall that was removed is met"
    elsewhere = {"method": "parallel", "workers": 2} if method == "grid" else {}  # in plain Python on one worker
    with mpsim.Simulation.resume(tmp_path / "run.mpsim", **elsewhere) as resumed:
        assert resumed.digest() == middle
        resumed.run(frames=80)
        assert resumed.digest() == end
        with pytest.raises(mpsim.InputError, match=re.escape("there are [0, 2, 3]")):
            resumed.remove_wall(1)
    with mpsim.Simulation.replay(tmp_path / "run.toml") as again:
        assert again.digest() == middle
        assert again.scene.obstacles == sim.scene.obstacles
        again.scene.starting_from(again.state, again.time).save(tmp_path / "now.toml")
    assert len(mpsim.Scene.load(tmp_path / "now.toml").obstacles) == 3


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_partition_that_is_removed_lets_discs_through(method):
    scene = mpsim.Scene(**BOX, obstacles=Polyline([(6, 0), (6, 6)]))
    with simulate(scene, method=method, **HOW) as sim:
        sim.run(frames=320)
        assert sim.state.velocity[0, 0] == -1, "it has bounced off the partition"
        assert sim.state.position[0, 0] == pytest.approx(5.5 - 1.5, abs=1e-9)
        sim.remove_wall(0)
        sim.run(frames=448)
        assert sim.state.position[0, 0] == pytest.approx(4, abs=1e-9), "back from the left wall"
        sim.run(frames=192)
        assert sim.state.position[0, 0] > 6
        assert not len(sim.scene.capsules_at(0.0))


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_wall_is_moved_from_where_it_is_and_stopped_there(method):
    with simulate(mpsim.Scene(**BOX), method=method, **HOW) as sim:
        wall = sim.add_wall([(6, 0), (6, 6)], motion=Translation((1, 0), stop=5, start=0.5))
        sim.run(frames=96)
        sim.move_wall(wall)
        assert sim.scene.obstacles[wall].points == pytest.approx(np.array([[7, 0], [7, 6]]))
        sim.run(frames=64)
        assert sim.scene.capsules_at(sim.time)[0, 0] == pytest.approx(7)
        sim.move_wall(wall, Translation((-2, 0), stop=1))
        sim.run(frames=64)
        assert sim.scene.capsules_at(sim.time)[0, 0] == pytest.approx(6)


REFUSED = [
    (lambda sim: sim.remove_wall(5), "wall must be the number of an obstacle that is there"),
    (lambda sim: sim.remove_wall(True), "wall must be the number of an obstacle that is there"),
    (lambda sim: sim.move_wall(None), "wall must be the number of an obstacle that is there"),
    (lambda sim: sim.move_wall(0, Translation((1, 0))), "the motion of obstacles[0] must keep it in the box"),
    (lambda sim: sim.move_wall(0, Oscillation((1, 0), 1, phase=1.5)), "motion must begin where the wall is"),
    (lambda sim: sim.move_wall(0, 7), "motion of a Polyline must be one of mpsim.Translation"),
    (
        lambda sim: sim.add_wall([(2, 0), (2, 6)], motion=Translation((1, 0), stop=1)),
        "a wall must be clear of all discs",
    ),
    (lambda sim: sim.add_wall([(7, 1), (7, 2)], motion=Rotation((0, 0), 1)), "the motion of obstacles[1] must keep it"),
    (lambda sim: sim.add_wall([(7, 1), (7, 2)], surface_velocity=1), "acts through friction, and wall_friction is 0"),
]


@pytest.mark.parametrize(("act", "words"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_refused_leaves_everything_as_it_was(act, words):
    with simulate(mpsim.Scene(**BOX, obstacles=Polyline([(6, 0), (6, 6)])), method="grid", **HOW) as sim:
        sim.run(frames=3)
        before = sim.digest(), sim.scene.obstacles, len(sim.journal)
        with pytest.raises(mpsim.InputError, match=re.escape(words)):
            act(sim)
        assert (sim.digest(), sim.scene.obstacles, len(sim.journal)) == before
        sim.run(frames=3)


def test_a_container_is_given_another_motion_where_its_discs_have_gone_with_it():
    """Also where no disc of the start would be in it now."""
    ring = mpsim.Circle((6, 6), 3, inside=True, motion=Translation((2, 0), stop=14))
    scene = mpsim.Scene.random(count=5, width=20, height=12, radius=0.3, obstacles=ring, seed=1)
    with simulate(scene, **HOW) as sim:
        sim.run(until=3)
        sim.move_wall(0, Translation((-1, 0), stop=4))
        sim.run(until=5)
        (x, y), (centre, *_) = sim.state.position.T, sim.scene.capsules_at(sim.time)[0]
        assert (np.hypot(x - centre, y - 6) < 3).all()
