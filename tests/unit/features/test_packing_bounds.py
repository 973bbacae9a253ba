"""Discs for which there is no room: behind a piston, in an obstacle, more than a box can hold where a piston stops."""

import math
import warnings

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim.features import packing_bounds as room
from mpsim.features.capsules import distance
from mpsim.features.obstacles import capsules_of

BOX = {"width": 20, "height": 10, "radius": 0.5}
NOBODY = {"position": np.zeros((0, 2)), "velocity": np.zeros((0, 2))}
PEG = mpsim.FixedDisc((5, 5), 1)


def lattice_of(count):
    """So many discs in rows of 10, which touch."""
    places = np.array([[0.5 + i // 10, 0.5 + i % 10] for i in range(count)])
    return {"position": places, "velocity": np.zeros((count, 2))}


# --- where a piston stops


def test_a_piston_that_would_leave_too_little_room_is_refused_with_the_room_needed():
    """Today's row: 50 discs in 20 x 10 with stop=3 ended at packing 1.31, 107 pairs overlapping, E = 137,003."""
    text = (
        r"stop of the piston must leave room for all 50 discs, a box at least 4\.511 long and 10 across: no "
        r"arrangement of them is denser; got 3, which leaves 3 \(packing 1\.31\)\. Let the piston stop earlier"
    )
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.Scene.random(count=50, **BOX, seed=1, piston=mpsim.Piston("right", -1, 3))
    with pytest.raises(mpsim.InputError, match="got 17, which leaves 3"):
        mpsim.Scene(**BOX, **lattice_of(50), piston=mpsim.Piston("left", 1, 17))
    mpsim.Scene(**BOX, **lattice_of(50), piston=mpsim.Piston("right", -1, 6))


@pytest.mark.parametrize("count", [10, 50, 100])
def test_what_can_be_packed_is_never_refused(count):
    """Rows of ten that fill the box between its walls, all in touch."""
    mpsim.Scene(**BOX, **lattice_of(count), piston=mpsim.Piston("right", -1, count / 10))


def test_hexagonal_rows_are_not_refused_and_half_a_disc_less_room_is():
    """40 columns of 20 and 19 in turn: the densest that walls allow is within a disc a column of what Oler allows."""
    count, length = sum(20 - i % 2 for i in range(40)), 1 + 39 * math.sqrt(3) / 2
    shortest = room.shortest_box(np.array([0.5]), np.array([float(count)]), 20.0, walls=True)
    assert length * 0.97 < shortest < length


def test_the_bound_of_two_sizes_lies_between_equal_discs_and_one():
    assert room.densest_packing(1, 1) == pytest.approx(math.pi / math.sqrt(12))
    bounds = [room.densest_packing(small, 1) for small in (1, 0.7, 0.414, 0.1, 1e-3)]
    assert bounds == sorted(bounds)
    assert bounds[-1] < 1
    # 0.9106832: the densest of radii in the ratio sqrt(2) - 1, discs in the holes of a square lattice, is 0.9202.
    assert bounds[2] > math.pi * (2 - math.sqrt(2)) / 2 > bounds[0]


def test_discs_of_emitters_count_where_there_is_an_end_to_them():
    emitter = mpsim.Emitter((1, 5), (1, 0), every=5, limit=20)
    piston = mpsim.Piston("right", -1, 6)
    with pytest.raises(mpsim.InputError, match=r"room for all 70 discs, a box at least 6\."):
        mpsim.Scene(**BOX, **lattice_of(50), emitters=emitter, piston=piston)
    endless = mpsim.Emitter((1, 5), (1, 0), every=5)
    mpsim.Scene(**BOX, **lattice_of(50), emitters=endless, piston=piston)
    mpsim.Scene(**BOX, **lattice_of(50), emitters=emitter, piston=piston, absorbing="left")  # where they may leave


def test_discs_that_are_added_count_too():
    scene = mpsim.Scene(**BOX, **lattice_of(50), piston=mpsim.Piston("right", -1, 6))
    with simulate(scene, method="naive") as sim:
        sim.add([(8, 1), (8, 3)], [(0, 0), (0, 0)])
        more = np.array([[9 + i // 8, 1 + i % 8] for i in range(20)])
        with pytest.raises(mpsim.InputError, match=r"position must leave room for all 72 discs, a box at least 6\.\d+"):
            sim.add(more, 0 * more)
        assert sim.count == 52


# --- among obstacles, where a piston stops


def test_a_piston_that_would_leave_too_little_room_among_obstacles_is_refused():
    """Of the area left over they would take 0.956; they ended 0.39 of a diameter deep in each other."""
    peg, box = mpsim.FixedDisc((2, 3), 1.9), {"count": 30, "width": 20, "height": 6, "radius": 0.5, "seed": 2}
    text = (
        r"stop of the piston must leave room for all 30 discs of radius 0\.5 among the obstacles, where no arrangement "
        r"has more than 25; got 6, which leaves a box of 6 x 6\. Let the piston stop earlier"
    )
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.Scene.random(**box, obstacles=peg, piston=mpsim.Piston("right", -0.5, 6))
    mpsim.Scene.random(**box, piston=mpsim.Piston("right", -0.5, 6))  # the control
    mpsim.Scene.random(**box, obstacles=peg, piston=mpsim.Piston("right", -0.5, 7))


def hexagonal(rng, low, high):
    """Places of discs of radius 0.5 that touch in a hexagonal lattice, turned and shifted at random, in a box."""
    index = np.stack(np.meshgrid(*[np.arange(-40, 41)] * 2), axis=-1).reshape(-1, 2)
    turn = rng.uniform(0, np.pi)
    axes = np.array([[np.cos(turn + k * np.pi / 3), np.sin(turn + k * np.pi / 3)] for k in (0, 1)]) * (1 + 1e-12)
    places = index @ axes + rng.uniform(0, 9, 2)
    return places[((places >= low + 0.5) & (places <= high - 0.5)).all(axis=1)]


def test_no_packing_that_exists_is_above_the_bound_among_obstacles():
    """Lattices from which the discs in obstacles are taken; in most of them the bound is no more than half above."""
    rng, ratios = np.random.default_rng(5), []
    for _ in range(150):
        high = rng.uniform(2, 15, 2)
        pegs = [mpsim.FixedDisc(rng.random(2) * high, rng.uniform(0.01, 2)) for _ in range(rng.integers(0, 5))]
        walls = [mpsim.Polyline(rng.random((3, 2)) * high, rng.choice([0, 0.3])) for _ in range(rng.integers(0, 3))]
        obstacles = (*pegs, *walls)
        places = hexagonal(rng, 0, high)
        capsules = capsules_of(obstacles)
        deep = distance(places[:, None], capsules).min(axis=1, initial=np.inf) < 0.5
        most = room.largest_number(0.5, (0, 0), tuple(high.tolist()), capsules)
        assert (~deep).sum() <= most
        ratios.append((~deep).sum() / max(most, 1))
    assert np.median(ratios) > 0.5


@pytest.mark.parametrize(("gap", "above"), [(1.0, 37), (1.0 + 1e-9, 37), (1.3, 42)])
def test_channels_as_wide_as_a_disc_count_as_room(gap, above):
    """Between two thick walls, and between a wall of the box and one of them, ten discs each stand in a row."""
    low, thick = gap + 1.0, 2.0
    walls = tuple(mpsim.Polyline([(0, y), (10, y)], thick) for y in (low, low + thick + gap))
    top = low + thick + gap + 1.0 + gap
    assert 30 <= room.largest_number(0.5, (0, 0), (10, top), capsules_of(walls)) < above


def test_the_bound_among_many_obstacles_of_many_sizes_of_discs_is_found_without_looking_at_each_pair(monkeypatch):
    """Of 100 pegs there are 4,950 pairs for each of 16 radii, and 100 outlines, of which few meet the box."""
    places = np.stack(np.divmod(np.arange(100), 10), axis=1) + 0.5
    radius, looks, separated = 0.02 + 0.001 * np.arange(16), [], room.are_separated
    monkeypatch.setattr(room, "are_separated", lambda *polygons: looks.append(polygons) or separated(*polygons))
    pegs = [mpsim.FixedDisc(place, 0.2) for place in places]
    capsules = capsules_of(tuple(pegs))
    arguments = {"position": places[:16] + 0.5, "velocity": 0 * places[:16], "radius": radius, "obstacles": pegs}
    mpsim.Scene(width=10, height=10.5, **arguments, piston=mpsim.Piston("right", -1, 9.9))
    assert len(looks) < 16 * 200
    for each in radius[[0, 15]]:
        alone = [room.largest_number(each, (0, 0), (9.9, 10.5), one[None]) for one in capsules]
        free = room.largest_number(each, (0, 0), (9.9, 10.5), capsules[:0])
        assert room.largest_number(each, (0, 0), (9.9, 10.5), capsules) == pytest.approx(free + sum(alone - free))


def test_of_two_sizes_the_larger_ones_have_no_more_room_than_alone():
    peg, box = mpsim.FixedDisc((3, 3), 1.5), {"width": 20, "height": 6}
    places = np.array([[9 + i // 5, 0.5 + i % 5] for i in range(45)])
    piston, rest = mpsim.Piston("right", -0.5, 6), {"position": places, "velocity": 0 * places}
    mixed = np.where(np.arange(45) < 31, 0.5, 0.05)
    with pytest.raises(mpsim.InputError, match=r"all 31 discs of radius 0\.5 or more among the obstacles, .* than 30;"):
        mpsim.Scene(**box, **rest, radius=mixed, obstacles=peg, piston=piston)
    mpsim.Scene(**box, **rest, radius=np.where(np.arange(45) < 30, 0.5, 0.05), obstacles=peg, piston=piston)


# --- behind a piston


def test_a_disc_behind_the_piston_is_refused_with_the_present_walls():
    scene = mpsim.Scene(**BOX, **lattice_of(10), piston=mpsim.Piston("right", -10, 6))
    with simulate(scene, method="naive", dt=0.1) as sim:
        sim.add((19, 5), (0, 0))
        sim.run(frames=5)
        text = (
            r"must lie in \[0.5, 14.5\] x \[0.5, 9.5\] \(one radius from the walls, the piston's place at time 0.5 incl"
        )
        with pytest.raises(mpsim.InputError, match=text):
            sim.add((14.6, 5), (0, 0))
        assert sim.count == 11
        sim.add((14.5, 3), (0, 0))
        sim.run(frames=20)
        with pytest.raises(mpsim.InputError, match=r"\[0.5, 5.5\] x"):
            sim.add((5.6, 5), (0, 0))


@pytest.mark.parametrize(("wall", "speed", "stop"), [("left", 4, 9), ("bottom", 2, 3), ("top", -2, 6)])
def test_any_wall_may_be_the_piston(wall, speed, stop):
    scene = mpsim.Scene(**BOX, **NOBODY, piston=mpsim.Piston(wall, speed, stop))
    low, high = scene.walls_at(1.0)
    with simulate(scene, method="naive", dt=0.1) as sim:
        sim.run(frames=10)
        for axis, side in ((0, low), (1, low), (0, high), (1, high)):
            inward = 0.5 if side is low else -0.5
            place = np.array([10.0, 5.0])
            place[axis] = side[axis] + 0.9 * inward
            with pytest.raises(mpsim.InputError, match="must lie in"):
                sim.add(place, (0, 0))
            place[axis] = side[axis] + inward
            sim.add(place, (0, 0))


def test_an_emitter_that_the_piston_has_passed_waits_for_good_and_says_so():
    scene = mpsim.Scene(
        **BOX, **NOBODY, piston=mpsim.Piston("right", -10, 6), emitters=mpsim.Emitter((15, 5), (0, 9), every=3)
    )
    text = r"emitters\[0\] found no room before frame 6, and its disc waits: .* must lie in \[0.5, 13.5\] x"
    with simulate(scene, method="naive", dt=0.1) as sim:
        sim.run(frames=5)
        with pytest.warns(mpsim.errors.EmitterWarning, match=text):
            sim.run(frames=5)
        assert sim.count == 1


def test_an_emitter_waits_when_the_box_would_be_too_full_in_the_end():
    scene = mpsim.Scene(
        width=20, height=1, radius=0.5, **NOBODY, piston=mpsim.Piston("right", -0.1, 2.5),
        emitters=mpsim.Emitter((1, 0.5), (10, 0), every=3),
    )  # fmt: skip
    with simulate(scene, method="naive", dt=0.1) as sim:
        with pytest.warns(mpsim.errors.EmitterWarning, match="must leave room for all 3 discs"):
            sim.run(frames=40)
        assert sim.count == 2


# --- in obstacles


def test_an_emitter_in_an_obstacle_is_refused():
    text = r"the position of emitters\[0\] must be one radius from every obstacle; got \(6.0, 5.0\), 0.5 inside obst"
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.Scene(**BOX, **NOBODY, obstacles=PEG, emitters=mpsim.Emitter((6, 5), (0, 0), every=1))
    mpsim.Scene(**BOX, **NOBODY, obstacles=PEG, emitters=mpsim.Emitter((6.5, 5), (0, 0), every=1))  # which touches it


@pytest.mark.usefixtures("compiled_when_run")
def test_a_disc_that_is_added_into_an_obstacle_is_refused():
    scene = mpsim.Scene(**BOX, **NOBODY, obstacles=[mpsim.FixedDisc((15, 5), 1), PEG], boundary=("periodic", "walls"))
    with simulate(scene, method="naive") as sim, warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(
            mpsim.InputError, match=r"position\[1\] must be one radius .* obstacles\[1\] with radius 0.5"
        ):
            sim.add([(1, 1), (5, 6.4)], np.zeros((2, 2)))
        assert sim.count == 0
        sim.add([(1, 1), (5, 6.5)], np.zeros((2, 2)))


@pytest.mark.parametrize("time", [-1.0, float("nan"), "soon", None])
def test_walls_are_those_of_a_time(time):
    with pytest.raises(mpsim.InputError, match="time must be a number >= 0"):
        mpsim.Scene.load("piston").walls_at(time)
