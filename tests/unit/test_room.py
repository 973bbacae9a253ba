"""Discs for which there is no room: behind a piston, in an obstacle, more than a box can hold where a piston stops."""

import math
import warnings

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim import room

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
        with pytest.warns(mpsim.EmitterWarning, match=text):
            sim.run(frames=5)
        assert sim.count == 1


def test_an_emitter_waits_when_the_box_would_be_too_full_in_the_end():
    scene = mpsim.Scene(
        width=20, height=1, radius=0.5, **NOBODY, piston=mpsim.Piston("right", -0.1, 2.5),
        emitters=mpsim.Emitter((1, 0.5), (10, 0), every=3),
    )  # fmt: skip
    with simulate(scene, method="naive", dt=0.1) as sim:
        with pytest.warns(mpsim.EmitterWarning, match="must leave room for all 3 discs"):
            sim.run(frames=40)
        assert sim.count == 2


# --- in obstacles


def test_an_emitter_in_an_obstacle_is_refused():
    text = (
        r"the position of emitters\[0\]\[0\] must be one radius from every obstacle; got \(6.0, 5.0\), 0.5 inside obst"
    )
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.Scene(**BOX, **NOBODY, obstacles=PEG, emitters=mpsim.Emitter((6, 5), (0, 0), every=1))
    mpsim.Scene(**BOX, **NOBODY, obstacles=PEG, emitters=mpsim.Emitter((6.5, 5), (0, 0), every=1))  # which touches it


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
