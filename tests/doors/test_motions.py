"""Obstacles that move, and walls put up, moved and taken away in a run: places, what is kept, what is refused."""

import math
import re

import numpy as np
import pytest
from support.scenes import digest_after, simulate

import mpsim
from mpsim import Circle, FixedDisc, Oscillation, Path, Polyline, Rotation, Translation

pytestmark = pytest.mark.plain

BOX = {"width": 12, "height": 10, "position": [[2, 2], [9, 8]], "velocity": [[1, 0.5], [0, -1]], "radius": 0.5}
LINE = [(5, 4), (7, 4)]
MOTIONS = [
    Translation((0.25, 0.5), stop=2, start=0.125),
    Oscillation((0.5, 0.25), period=0.75, phase=0.3),
    Rotation((6, 4), rate=-1.25, start=0.25, stop=9),
    Path([0.25, 0.5, 1.5], [(0, 0), (1, 0.5), (0, 1)]),
]


def scene_of(motion, **more):
    return mpsim.Scene(**BOX | more, obstacles=[Polyline(LINE, 0.125, motion=motion), FixedDisc((1, 9), 0.25)])


@pytest.mark.parametrize("turns", [0, 0.1, 0.125, 0.3, 0.5, 0.62, 0.875, 0.99, 1234.567, -5.25])
def test_places_are_those_of_the_mathematical_library(turns):
    points = np.array([[7.0, 4.0, 8.0, 5.0, 0.5]])
    found = Rotation((6, 4), rate=2 * math.pi, start=-2000).capsules_at(points, turns - 2000)
    c, s = math.cos(2 * math.pi * max(turns, 0)), math.sin(2 * math.pi * max(turns, 0))
    assert found[0] == pytest.approx([6 + c, 4 + s, 6 + 2 * c - s, 4 + 2 * s + c, 0.5], abs=1e-11)
    wave = Oscillation((0, 2), period=1, start=-2000).capsules_at(points, turns - 2000)
    assert wave[0, 1] == pytest.approx(4 + 2 * s, abs=1e-11)


def test_translations_and_rotations_come_to_rest_and_all_motions_wait_for_their_start():
    row = np.array([[5.0, 4, 7, 4, 0.1]])
    for motion in MOTIONS[::2]:
        assert (motion.capsules_at(row, motion.start) == row).all()
        ends = [motion.capsules_at(row, time) for time in (50, 1e6)]
        assert (ends[0] == ends[1]).all()
        assert (ends[0] != row).any()
    assert MOTIONS[0].capsules_at(row, 50)[0, :2] == pytest.approx([5 + 2 / math.sqrt(5), 4 + 4 / math.sqrt(5)])


@pytest.mark.parametrize("method", ["grid", "event"])
@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: type(motion).__name__)
def test_a_motion_goes_through_checkpoints_and_another_start(tmp_path, motion, method):
    near = {"position": [[6, 5], [6.5, 2.5]], "velocity": [[0.5, -1], [0, 2]]}
    scene, how = scene_of(motion, **near), {"method": method, "dt": 1 / 64, "contact": "impact"}
    with simulate(scene, **how) as sim:
        sim.run(frames=40)
        state, time = sim.state, sim.time
        sim.save(tmp_path / "run.mpsim")
        sim.run(frames=24)
        end = sim.state
        with mpsim.Simulation.resume(tmp_path / "run.mpsim") as resumed:
            assert resumed.scene.obstacles == scene.obstacles
            resumed.run(frames=24)
            assert resumed.digest() == sim.digest()
    with simulate(scene.starting_from(state, time), **how) as again:
        assert again.scene.capsules_at(0.0) == pytest.approx(scene.capsules_at(time), abs=1e-12)
        again.run(frames=24)
        assert np.abs(again.state.position - end.position).max() < 1e-9
    assert eval(repr(scene.obstacles[0]), vars(mpsim)) == scene.obstacles[0]
    assert "motion" not in repr(scene.obstacles[1]), "what goes without saying"
    rest = digest_after(scene_of(None, **near), 64, **how)
    assert rest != end.digest(), "nothing has met the obstacle"


class Swerve(Translation):
    """A motion of a user's own, which the kernels do not know."""


REFUSED = [
    (lambda: Translation((0, 0)), "velocity of a Translation must not be (0, 0)"),
    (lambda: Translation((1, math.nan)), "velocity of a Translation must be"),
    (lambda: Translation((1, 0), stop=0), "stop of a Translation must be a finite number > 0 [length]; got 0"),
    (lambda: Oscillation((0, 0), 1), "amplitude of an Oscillation must not be (0, 0)"),
    (lambda: Oscillation((1, 0), math.nan), "period of an Oscillation must be a finite number > 0 [time]"),
    (lambda: Oscillation((1, 0), -1), "period of an Oscillation must be a finite number > 0 [time]; got -1"),
    (lambda: Rotation((1, 1), 0), "rate of a Rotation must not be 0"),
    (lambda: Rotation((1, 1), 1, stop=-1), "stop of a Rotation must be a finite number > 0 [radians]; got -1"),
    (lambda: Rotation((1, 1), 1, start=math.inf), "start of a Rotation must be"),
    (lambda: Path([0], [(0, 0)]), "times of a Path must be at least two, each later than the last; got [0]"),
    (lambda: Path([0, 0], [(0, 0), (1, 1)]), "times of a Path must be at least two, each later"),
    (lambda: Path([0, 1], [(0, 0)]), "displacements of a Path must have shape (2, 2); got shape (1, 2)"),
    (lambda: Polyline(LINE, motion=3), "motion of a Polyline must be one of mpsim.Translation, mpsim.Oscillation"),
    (lambda: Polyline(LINE, motion=Swerve((1, 0))), "mpsim.Path; got Swerve. Use that class itself, not a subclass."),
    (lambda: mpsim.Piston("left", motion=Swerve((1, 0), 3)), "motion of a Piston must be one of mpsim.Translation"),
    (lambda: FixedDisc((1, 1), 1, surface_velocity=math.nan), "surface_velocity of a FixedDisc must be"),
    (lambda: scene_of(Translation((1, 0))), "the motion of obstacles[0] must keep it in the box, in [0, 12] along x"),
    (lambda: scene_of(Rotation((2, 4), 1)), "got [-3, 7]"),
    (
        lambda: scene_of(Oscillation((0, 5), 1)),
        "the motion of obstacles[0] must keep it in the box, in [0, 10] along y",
    ),
    (
        lambda: mpsim.Scene(
            **BOX, boundary="periodic", obstacles=Polyline([(1, 5), (11, 5)], motion=Rotation((6, 5), 1))
        ),
        "must be shorter than the periodic box",
    ),
    (
        lambda: mpsim.Scene(**BOX, obstacles=FixedDisc((5, 5), 1, surface_velocity=1)),
        "acts through friction, and wall_",
    ),
]


@pytest.mark.parametrize(("make", "words"), REFUSED, ids=[words[:40] for _, words in REFUSED])
def test_what_makes_no_motion_is_refused_by_name(make, words):
    with pytest.raises(mpsim.InputError, match=re.escape(words)):
        make()


def test_a_quarter_turn_that_stays_in_the_box_is_no_whole_one():
    flipper = Polyline([(1, 4), (4, 4)], motion=Rotation((1, 4), rate=2, stop=math.pi / 2))
    assert mpsim.Scene(**BOX, obstacles=flipper).obstacles == (flipper,)
    with pytest.raises(mpsim.InputError, match="must keep it in the box"):
        mpsim.Scene(**BOX, obstacles=Polyline([(1, 4), (4, 4)], motion=Rotation((1, 4), rate=2, stop=math.pi)))


def test_a_fast_surface_is_named_as_fast_discs_are():
    scene = scene_of(Rotation((6, 4), rate=40))
    with pytest.raises(mpsim.TooFastError, match="towards an obstacle of speed 4"):
        mpsim.Simulation(scene, mpsim.Settings(method="grid", dt=0.02, on_fast="error"))
    with mpsim.Simulation(scene, mpsim.Settings(method="grid", dt=0.02, on_fast="substep")) as sim:
        sim.run(frames=5)
    with mpsim.Simulation(scene, mpsim.Settings(method="grid", dt=0.001, on_fast="error")) as sim:
        sim.run(frames=5)


def test_added_discs_need_room_where_obstacles_are_now():
    scene = scene_of(Translation((0, 1), stop=4))
    with simulate(scene, method="grid", dt=1 / 64) as sim:
        sim.add((6, 8), (0, 0))
        sim.run(frames=256)
        with pytest.raises(mpsim.InputError, match=re.escape("inside obstacles[0]")):
            sim.add((6, 8.2), (0, 0))
        sim.add((6, 4), (0, 0))


@pytest.mark.parametrize("method", ["grid", "event"])
def test_collisions_with_obstacles_that_move_have_their_index(method):
    table = mpsim.Collisions(between="obstacles")
    with simulate(scene_of(Oscillation((1, 0), period=1)), method=method, dt=1 / 64) as sim:
        sim.set([0, 1], position=[(6, 5), (1, 8)], velocity=[(0, -1), (0, 1)])
        sim.run(frames=80, observe=table)
    assert {*table.table["j"].tolist()} == {0, 1}


# --- walls that are put up, moved, stopped and taken away in a run

FLAT = {"width": 12, "height": 6, "position": [[2, 3], [10, 3]], "velocity": [[1, 0], [-0.5, 0.25]], "radius": 0.5}
HOW = {"dt": 1 / 64, "contact": "impact"}


def a_busy_run(sim):
    """Walls of all kinds of change; returns their numbers."""
    sim.run(frames=10)
    one = sim.add_wall(Polyline([(5, 0), (5, 6)], 0.25))
    other = sim.add_wall(Polyline([(7, 3), (8, 3)], motion=Rotation((7, 3), rate=1.0, start=0.25)))
    sim.run(frames=40)
    sim.move_wall(one, Translation((-0.5, 0), stop=1.0))
    sim.run(frames=40)
    sim.move_wall(other, Oscillation((0.25, 0.5), period=1.5))
    sim.move_wall(one)
    sim.run(frames=40)
    sim.remove_wall(one)
    last = sim.add_wall([(6, 5), (6, 6)])
    peg, _, rotor, wall = sim.scene.obstacles
    drum = Circle((6, 3), 6.25, inside=True, motion=Oscillation((0.125, 0), period=0.5, start=0.125))
    sim.change(obstacles=(each for each in [wall, drum, peg, wall, rotor]), gravity=(0, -0.125))
    sim.run(frames=40)
    sim.change(obstacles=sim.scene.obstacles)
    sim.remove_wall(sim.add_wall(FixedDisc((6, 1), 0.25)))
    return one, other, last


@pytest.mark.parametrize("method", ["grid", "event", "naive"])
def test_every_change_is_kept_in_checkpoints_sessions_and_snapshots(tmp_path, method):
    scene = mpsim.Scene(**FLAT, obstacles=FixedDisc((3, 5), 0.25))
    with simulate(scene, method=method, **HOW) as sim:
        assert a_busy_run(sim) == (1, 2, 3), "the numbers go on, and none is used twice"
        kinds = ["FixedDisc", "Removed", "Polyline", "Polyline", "Polyline", "Circle", "Removed"]
        assert [type(each).__name__ for each in sim.scene.obstacles] == kinds
        assert sim.scene.obstacles[3] == sim.scene.obstacles[4], "what is given twice is there twice"
        assert sim.scene.obstacles[5].motion.start == 130 / 64 + 0.125
        assert [each.what for each in sim.journal][-4:] == ["change", "change", "add_wall", "remove_wall"]
        sim.set(1, position=(7.5, 4.75), velocity=(0, -1.5))
        sim.save(tmp_path / "run.mpsim")
        sim.journal.save(tmp_path / "run.toml")
        snapshot, middle = sim.snapshot(), sim.digest()
        sim.change(obstacles=[each for each in sim.scene.obstacles if not isinstance(each, Polyline)])
        sim.run(frames=80)
        other = sim.digest()
        sim.restore(snapshot)
        assert (sim.digest(), len(sim.scene.capsules_at(0.0))) == (middle, 5)
        sim.run(frames=80)
        end = sim.digest()
    assert end != other, "the wall that was removed is met"
    elsewhere = {"method": "parallel", "workers": 2} if method == "grid" else {}  # in plain Python on one worker
    with mpsim.Simulation.resume(tmp_path / "run.mpsim", **elsewhere) as resumed:
        assert resumed.digest() == middle
        resumed.run(frames=80)
        assert resumed.digest() == end
        with pytest.raises(mpsim.InputError, match=re.escape("there are [0, 2, 3, 4, 5]")):
            resumed.remove_wall(1)
    with mpsim.Simulation.replay(tmp_path / "run.toml") as again:
        assert again.digest() == middle
        assert again.scene.obstacles == sim.scene.obstacles
        again.scene.starting_from(again.state, again.time).save(tmp_path / "now.toml")
    assert len(mpsim.Scene.load(tmp_path / "now.toml").obstacles) == 5
    text = (tmp_path / "run.toml").read_text()
    (tmp_path / "run.toml").write_text(text.replace('wall = ["FixedDisc"', 'wall = ["Sieve"'))
    with pytest.raises(mpsim.InputError, match="it has a 'Sieve', and this version of mpsim knows FixedDisc, Polyline"):
        mpsim.Simulation.replay(tmp_path / "run.toml")


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_partition_that_is_removed_lets_discs_through(method):
    scene = mpsim.Scene(**FLAT, obstacles=Polyline([(6, 0), (6, 6)]))
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
    with simulate(mpsim.Scene(**FLAT), method=method, **HOW) as sim:
        wall = sim.add_wall(Polyline([(6, 0), (6, 6)], motion=Translation((1, 0), stop=5, start=0.5)))
        sim.run(frames=96)
        sim.move_wall(wall)
        assert sim.scene.obstacles[wall].points == pytest.approx(np.array([[7, 0], [7, 6]]))
        sim.run(frames=64)
        assert sim.scene.capsules_at(sim.time)[0, 0] == pytest.approx(7)
        sim.move_wall(wall, Translation((-2, 0), stop=1))
        sim.run(frames=64)
        assert sim.scene.capsules_at(sim.time)[0, 0] == pytest.approx(6)


REFUSED_IN_A_RUN = [
    (lambda sim: sim.remove_wall(5), "wall must be the number of an obstacle that is there"),
    (lambda sim: sim.remove_wall(True), "wall must be the number of an obstacle that is there"),
    (lambda sim: sim.move_wall(None), "wall must be the number of an obstacle that is there"),
    (lambda sim: sim.move_wall(0, Translation((1, 0))), "the motion of obstacles[0] must keep it in the box"),
    (lambda sim: sim.move_wall(0, Oscillation((1, 0), 1, phase=1.5)), "motion must begin where the wall is"),
    (lambda sim: sim.move_wall(0, 7), "motion of a Polyline must be one of mpsim.Translation"),
    (lambda sim: sim.add_wall("abc"), "points of a Polyline must be numbers"),
    (lambda sim: sim.add_wall(Translation((1, 0))), "points of a Polyline must be numbers"),
    (lambda sim: sim.add_wall(sim.scene.obstacles), "points of a Polyline must be numbers"),
    (lambda sim: sim.change(obstacles=None), "obstacles[0] must be an mpsim.FixedDisc or"),
    (lambda sim: sim.change(obstacles=[*sim.scene.obstacles, (7, 1)]), "obstacles[1] must be an mpsim.FixedDisc or"),
    (lambda sim: sim.change(obstacles=[], dt=-1), "dt must be a finite number > 0"),
    (lambda sim: sim.change(obstacles=[], gravity=3), "gravity must be two numbers"),
]
REFUSED_OBSTACLES = [
    (Polyline([(2, 0), (2, 6)], motion=Translation((1, 0), stop=1)), "a wall must be clear of all discs; got disc 0"),
    (Polyline([(9, 2), (11, 2), (10, 5), (9, 2)], filled=True), "got disc 1"),
    (Circle((6, 3), 4, inside=True), "inside obstacles[1]. Put it elsewhere"),
    (Circle((6, 3), 0.5, inside=True), "radius of obstacles[1], a Circle with discs inside, must be above"),
    (FixedDisc((12.5, 3), 0.1), "obstacles[1] must lie in the box, [0, 12] x [0, 6]"),
    (FixedDisc((7, 1), 0.1, motion=Rotation((0, 0), 1)), "the motion of obstacles[1] must keep it"),
    (Polyline([(7, 1), (7, 2)], surface_velocity=1), "acts through friction, and wall_friction is 0"),
]
for _wall, _words in REFUSED_OBSTACLES:
    REFUSED_IN_A_RUN += [
        (lambda sim, wall=_wall: sim.add_wall(wall), _words),
        (lambda sim, wall=_wall: sim.change(obstacles=[wall, *sim.scene.obstacles]), _words),
    ]


@pytest.mark.parametrize(("act", "words"), REFUSED_IN_A_RUN, ids=range(len(REFUSED_IN_A_RUN)))
def test_what_is_refused_leaves_everything_as_it_was(act, words):
    with simulate(mpsim.Scene(**FLAT, obstacles=Polyline([(6, 0), (6, 6)])), method="grid", **HOW) as sim:
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
