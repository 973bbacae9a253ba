"""Motions of obstacles: places at times, what is refused, and what survives files, changes and another start."""

import math
import re

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim import FixedDisc, Oscillation, Path, Polyline, Rotation, Translation

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
    with simulate(scene_of(None, **near), **how) as rest:
        rest.run(frames=64)
        assert rest.digest() != end.digest(), "nothing has met the obstacle"


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
    (lambda: Path([0], [(0, 0)]), "times of a Path must be at least two, each later than the one before; got [0]"),
    (lambda: Path([0, 0], [(0, 0), (1, 1)]), "times of a Path must be at least two, each later"),
    (lambda: Path([0, 1], [(0, 0)]), "displacements of a Path must have shape (2, 2); got shape (1, 2)"),
    (lambda: Polyline(LINE, motion=3), "motion of a Polyline must be one of mpsim.Translation, mpsim.Oscillation"),
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
