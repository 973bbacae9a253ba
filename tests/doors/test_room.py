"""Room for discs: where a piston stops, behind it, in obstacles. What cannot be packed is refused, and nothing else."""

import itertools
import math
import time

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim import Emitter, FixedDisc, InputError, Piston, Polyline, Scene

pytestmark = pytest.mark.plain

BOX = {"width": 20, "height": 10, "radius": 0.5}
NOBODY = {"position": np.zeros((0, 2)), "velocity": np.zeros((0, 2))}
TO = {stop: Piston("right", -1, stop) for stop in (3, 5, 6)}


def rows_of_ten(count):
    """Discs that touch."""
    places = np.array([[0.5 + i // 10, 0.5 + i % 10] for i in range(count)])
    return {"position": places, "velocity": np.zeros((count, 2))}


# --- where a piston stops

LIMITED, ENDLESS = Emitter((1, 5), (1, 0), every=5, limit=20), Emitter((1, 5), (1, 0), every=5)


@pytest.mark.parametrize(
    ("features", "text"),
    [
        (
            {**rows_of_ten(50), "piston": TO[3]},
            r"stop of the piston must leave room for all 50 discs, a box at least 4\.33 long and 10 across: no "
            r"arrangement of them is denser; got 3, which leaves 3 \(packing 1\.31\)\. Let the piston stop earlier",
        ),
        ({**rows_of_ten(50), "piston": TO[5]}, None),  # full to the last place
        ({**rows_of_ten(50), "emitters": LIMITED, "piston": TO[6]}, r"room for all 70 discs, a box at least 6\."),
        ({**rows_of_ten(50), "emitters": ENDLESS, "piston": TO[6]}, None),
        ({**rows_of_ten(50), "emitters": LIMITED, "piston": TO[6], "absorbing": "left"}, None),  # where they may leave
        ({**NOBODY, "piston": Piston("left", 1, 19.5)}, r"of diameter 1.*got 19\.5, which leaves 0\.5"),
        ({**NOBODY, "piston": Piston("left", 1, 19)}, None),
    ],
)  # fmt: skip
def test_a_piston_that_would_leave_too_little_room_is_refused_and_no_other(features, text):
    if text is None:
        Scene(**BOX, **features)
        return
    with pytest.raises(InputError, match=text):
        Scene(**BOX, **features)


def test_discs_that_are_added_count_too():
    with simulate(Scene(**BOX, **rows_of_ten(50), piston=TO[6]), method="naive") as sim:
        sim.add([(8, 1), (8, 3)], [(0, 0), (0, 0)])
        more = np.array([[9 + i // 8, 1 + i % 8] for i in range(20)])
        with pytest.raises(InputError, match=r"position must leave room for all 72 discs, a box at least 6\.\d+"):
            sim.add(more, 0 * more)
        assert sim.count == 52


def depth(scene, position, radius):
    """Of the deepest of some discs in an obstacle; 0 if there is none."""
    found = scene._deepest(np.atleast_2d(position), np.atleast_1d(radius))
    return 0 if found is None else found.depth


# --- behind a piston


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # which moves by two radii in a frame
def test_a_disc_behind_the_piston_is_refused_with_the_present_walls():
    scene = Scene(**BOX, **rows_of_ten(10), piston=Piston("right", -10, 6))
    with simulate(scene, method="naive", dt=0.1) as sim:
        sim.add((19, 5), (0, 0))
        sim.run(frames=5)
        text = r"must lie in \[0.5, 14.5\] x \[0.5, 9.5\] \(one radius from the walls, the piston's place at time 0.5 i"
        with pytest.raises(InputError, match=text):
            sim.add((14.6, 5), (0, 0))
        assert sim.count == 11
        sim.add((14.5, 3), (0, 0))
        sim.run(frames=20)
        with pytest.raises(InputError, match=r"\[0.5, 5.5\] x"):
            sim.add((5.6, 5), (0, 0))


@pytest.mark.parametrize(("wall", "speed", "stop"), [("left", 4, 9), ("bottom", 2, 3), ("top", -2, 6)])
def test_any_wall_may_be_the_piston(wall, speed, stop):
    scene = Scene(**BOX, **NOBODY, piston=Piston(wall, speed, stop))
    low, high = scene.walls_at(1.0)
    with simulate(scene, method="naive", dt=0.1) as sim:
        sim.run(frames=10)
        for axis, side in ((0, low), (1, low), (0, high), (1, high)):
            inward = 0.5 if side is low else -0.5
            place = np.array([10.0, 5.0])
            place[axis] = side[axis] + 0.9 * inward
            with pytest.raises(InputError, match="must lie in"):
                sim.add(place, (0, 0))
            place[axis] = side[axis] + inward
            sim.add(place, (0, 0))


# --- in obstacles


def distance(place, a, b):
    """From a point to a segment."""
    along = (b - a) @ (b - a)
    part = min(max((place - a) @ (b - a) / along, 0.0), 1.0) if along > 0 else 0.0
    return math.dist(place, a + part * (b - a))


@pytest.mark.parametrize(("boundary", "count"), [("walls", 5), ("periodic", 60), (("walls", "periodic"), 60)])
def test_depths_in_obstacles_are_those_of_all_comparisons(count, boundary):
    """Every disc with every image of every obstacle. Few discs and many take different ways."""
    rng, size = np.random.default_rng(count), np.array([30.0, 20.0])
    ends = rng.uniform(0, 1, (24, 2, 2)) * size
    ends[::3, 1] = ends[::3, 0]
    ends[1::3, 1, 0] = ends[1::3, 0, 0]  # upright walls
    thick = 10 ** rng.uniform(-3, 0.5, 24)
    obstacles = [
        FixedDisc(a, r) if (a == b).all() else Polyline([a, b], 2 * r) for (a, b), r in zip(ends, thick, strict=True)
    ]
    scene = Scene(width=30, height=20, **NOBODY, radius=0.5, obstacles=obstacles, boundary=boundary)
    position, radius = rng.uniform(0, 1, (count, 2)) * size, 10 ** rng.uniform(-3, 0.5, count)
    steps = [(-1, 0, 1) if word == "periodic" else (0,) for word in np.broadcast_to(boundary, 2)]
    depths = [
        max(
            r + thick[k] - distance(place + np.array(step) * size, *ends[k])
            for k in range(24)
            for step in itertools.product(*steps)
        )
        for place, r in zip(position, radius, strict=True)
    ]
    assert 0 < sum(depth > 0 for depth in depths) < count
    for disc in range(count):
        assert depth(scene, position[disc], radius[disc]) == pytest.approx(max(depths[disc], 0), abs=1e-12)
    assert depth(scene, position, radius) == pytest.approx(max(depths), abs=1e-12)
    fewer = scene._replace(obstacles=obstacles[:1])
    assert depth(fewer, position, radius) < max(depths), "obstacles that are replaced are asked no more"


def test_memory_stays_small_where_obstacles_lie_on_each_other():
    """Lists of obstacles near each place would have hundreds of millions of entries in a grid as fine as the disc."""
    across = Polyline(np.stack([np.linspace(0, 10, 3001), 10.0 * (np.arange(3001) % 2)], axis=1))
    with simulate(Scene(width=10, height=10, **NOBODY, radius=0.001, obstacles=across), method="grid") as sim:
        assert sim.run(frames=0).block_bytes < 64e6


# --- very many


def many(name, count):
    """Arguments of a box with that many of these, and as many discs beside them, or in flight to some of them."""
    side, pitch = math.isqrt(count), 1.0 if name == "into pegs" else 3.0
    places, length = pitch * (np.stack(np.divmod(np.arange(count), side), axis=1) + 0.5), pitch * side
    box = {"width": length, "height": length, "position": places + 1, "velocity": 0 * places, "radius": 0.4}
    if name == "pegs":
        return box | {"obstacles": [FixedDisc(place, 0.5) for place in places]}
    if name == "chain":
        corners = np.stack([np.linspace(0, length, count + 1), np.full(count + 1, length)], axis=1)
        return box | {"position": places, "obstacles": Polyline(corners)}
    if name == "emitters":
        return box | {"emitters": [Emitter(place, (1, 0), interval=10) for place in places]}
    middles = (places[(places < length - 1).all(axis=1)] + 0.5)[: count // 10]
    flights = [Emitter(place, (150.0, 150.0), interval=0.006, limit=1) for place in middles]
    pegs = [FixedDisc(place, 0.05) for place in places]
    return box | NOBODY | {"radius": 0.1, "obstacles": pegs, "emitters": flights}


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
@pytest.mark.parametrize("name", ["pegs", "chain", "emitters", "into pegs"])
def test_scene_and_first_frame_take_time_as_their_number_and_not_as_its_square(name):
    def seconds(count):
        arguments, start = many(name, count), time.process_time()
        with mpsim.Simulation(Scene(**arguments), mpsim.Settings(method="grid")) as sim:
            sim.run(frames=1)
            assert sim.frame == 1
        return time.process_time() - start

    seconds(2_500)  # its kernels are loaded
    ratios = [1 / seconds(2_500) * seconds(10_000) for _ in range(3)]  # in turns: the machine may be busy for a while
    assert min(ratios) < 7, "4 if linear, 16 if each looks at all others"
