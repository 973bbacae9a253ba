"""Setting up a scene takes time that grows with what is in it: 100,000 obstacles or emitters within seconds.

Growth is counted, not timed: of comparisons of a disc or a cell with an obstacle, and of looks at emitters. Obstacles
that all lie on each other take no more than those that do not.
"""

import itertools
import warnings
from typing import Any

import numpy as np
import pytest
from support.seconds import quickest
from support.selection import long_but

import mpsim
from mpsim.engine import emission, entry_flight, insertion
from mpsim.features import capsules
from mpsim.features.obstacles import capsules_of, fixed_discs

LONGEST = 2e-5
"""Seconds of processor time per obstacle or emitter, from the scene to the end of the first frame."""

CHECKPOINT = 8e-5
"""Seconds of processor time per emitter, to write it into a checkpoint and to read it."""


def lattice(count, spacing=3.0):
    """Places on a square lattice, and the side of the box that it fills."""
    side = int(np.ceil(np.sqrt(count)))
    return spacing * (np.stack(np.divmod(np.arange(count), side), axis=1) + 0.5), spacing * side


def pegs(count):
    """As many pegs as discs, none of which touch."""
    places, side = lattice(count)
    made = tuple(mpsim.FixedDisc(place, 0.5) for place in places)
    return {"width": side, "height": side, "position": places + 1, "obstacles": made, "radius": 0.4}


def chain(count):
    """One wall of many short pieces, and as many discs beside it."""
    places, side = lattice(count)
    corners = np.stack([np.linspace(0, side, count + 1), np.full(count + 1, side)], axis=1)
    return {"width": side, "height": side, "position": places, "obstacles": mpsim.Polyline(corners), "radius": 0.4}


def emitters(count):
    places, side = lattice(count)
    made = tuple(mpsim.Emitter(place, (1, 0), interval=10) for place in places)  # of the common radius
    return {"width": side, "height": side, "position": places + 1, "emitters": made, "radius": 0.4}


def simulated(arguments):
    scene = mpsim.Scene(**arguments, velocity=np.zeros_like(arguments["position"]))
    return mpsim.Simulation(scene, mpsim.Settings(method="grid"))


@pytest.mark.parametrize("make", [pegs, chain])
def test_comparisons_with_obstacles_grow_with_their_number(make, monkeypatch):
    def compared(count):
        arguments, numbers, hypot = make(count), [], np.hypot

        def counting(*values, **options):
            numbers.append(np.size(values[0]))
            return hypot(*values, **options)

        with monkeypatch.context() as patch:
            patch.setattr(np, "hypot", counting)
            simulated(arguments).close()
        return sum(numbers)

    simulated(make(4)).close()  # its kernels are loaded, which needs the hypot of NumPy
    few, many = compared(400), compared(1600)
    assert 0 < few < many < 6 * few, "linear would be 4, quadratic 16"


def test_looks_at_emitters_grow_with_their_number(monkeypatch):
    def looks(count):
        arguments, reads = emitters(count), [0]

        def counting(self, name):
            reads[0] += 1
            return object.__getattribute__(self, name)

        with monkeypatch.context() as patch:
            patch.setattr(mpsim.Emitter, "__getattribute__", counting)
            simulated(arguments).close()
        return reads[0]

    few, many = looks(100), looks(400)
    assert 0 < few < many < 6 * few, "linear would be 4, quadratic 16"


SCENES = [(make, count) for make in (pegs, chain, emitters) for count in (10_000, 100_000, 1_000_000)]


@pytest.mark.timeout(900)
@pytest.mark.parametrize(("make", "count"), long_but(SCENES, *(scene for scene in SCENES if scene[1] < 1_000_000)))
def test_scene_and_first_frame_of_very_many_take_seconds(make, count, figures):
    with simulated(make(4)) as sim:
        sim.run(frames=1)  # its kernels are loaded
    arguments = make(count)

    def first_frame():
        with simulated(arguments) as sim:
            sim.run(frames=1)
            assert (sim.count, sim.frame) == (count, 1)

    seconds = quickest(first_frame, LONGEST * count)
    assert seconds < LONGEST * count
    what = f"{count:,} {make.__name__}, as many discs: from Scene(...) to the end of frame 1"
    figures.note("R22", "grid", what, f"{LONGEST * count:g} s at most", f"{seconds:.2f} s")


@pytest.mark.parametrize("count", [20_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_a_checkpoint_of_many_emitters_is_written_and_read_in_seconds(count, tmp_path, figures):
    def written_and_read():
        path = sim.save(tmp_path / "run")
        with mpsim.Simulation.resume(path) as again:
            assert again.scene.emitters == sim.scene.emitters

    with simulated({**emitters(count), "position": np.ones((1, 2))}) as sim:
        seconds = quickest(written_and_read, CHECKPOINT * count)
    assert seconds < CHECKPOINT * count
    what = f"a checkpoint of {count:,} emitters, written and read"
    figures.note("R22", "grid", what, f"{CHECKPOINT * count:g} s at most", f"{seconds:.2f} s")


@pytest.mark.parametrize("boundary", ["walls", "periodic", ("walls", "periodic")])
@pytest.mark.parametrize("count", [5, 300])
def test_depths_are_those_of_all_comparisons(count, boundary):
    """The twin: every disc with every image of every capsule. Few discs and many take different ways."""
    rng = np.random.default_rng(count)
    size, periodic = (30.0, 20.0), tuple(word == "periodic" for word in np.broadcast_to(boundary, 2))
    ends = rng.uniform(0, 1, (40, 4)) * np.tile(size, 2)
    ends[::3, 2:] = ends[::3, :2]  # discs
    ends[1::3, 2] = ends[1::3, 0]  # upright walls
    walls = np.column_stack([ends, 10 ** rng.uniform(-3, 0.5, 40)])
    position, radius = rng.uniform(0, 1, (count, 2)) * size, 10 ** rng.uniform(-3, 0.5, count)
    shifts = itertools.product(
        *((-length, 0, length) if wraps else (0,) for length, wraps in zip(size, periodic, strict=True))
    )
    gaps = np.min([capsules.distance((position + shift)[:, None], walls) for shift in shifts], axis=0)
    found = capsules.depths(position, radius, walls, size, periodic)
    assert np.array_equal(found, np.maximum(radius - gaps.min(axis=1), 0))
    assert 0 < (found > 0).sum() < count, "some discs overlap, some do not"
    for disc in range(min(count, 20)):
        assert capsules.nearest(position[disc], walls, size, periodic) == gaps[disc].argmin()


@pytest.mark.parametrize("slope", [0.0, 1e-13, 0.3, 1.0, -1.0, 1e13])
def test_a_long_wall_is_listed_in_the_cells_along_it_alone(slope):
    size, reach = (50.0, 50.0), 0.25
    run = np.array([1.0, slope]) / np.hypot(1.0, slope) * 30
    wall = np.array([[25 - run[0] / 2, 25 - run[1] / 2, 25 + run[0] / 2, 25 + run[1] / 2, 0.1]])
    many = np.repeat(wall, 60, axis=0)
    lists = capsules.cell_lists(many, size, reach)
    columns, rows = lists.grid
    middle = (np.stack(np.divmod(np.arange(columns * rows), rows), axis=1) + 0.5) / lists.per_length
    margin = reach + np.hypot(*(0.5 / lists.per_length)) * 1.001
    expected = np.where(capsules.distance(middle, wall[0]) <= margin, 60, 0)
    assert np.array_equal(np.diff(lists.near), expected)
    assert lists.listed[:60].tolist() == list(range(60)), "each cell's in ascending order"


def thick(count):
    """Pegs each of which covers the box of 10 x 10."""
    return fixed_discs(np.random.default_rng(2).uniform(0, 10, (count, 2)), 20.0)


def zigzag(count):
    """A wall whose pieces each cross the box of 10 x 10."""
    corners = np.stack([np.linspace(0, 10, count + 1), 10.0 * (np.arange(count + 1) % 2)], axis=1)
    return mpsim.Polyline(corners)


@pytest.mark.parametrize(("make", "each"), [(thick, 40_000), (zigzag, 200)])
def test_cells_list_no_more_where_obstacles_lie_on_each_other(make, each, monkeypatch):
    """In the grid of those that do not each would stand in more than `each` lists, and in more the more there are."""
    count, room = 3000, {"width": 10, "height": 10, "position": [], "velocity": [], "radius": 0.001}
    scene = mpsim.Scene(**room, obstacles=make(count))
    monkeypatch.setattr(capsules, "MOST_LISTED", 2**62)
    finest = capsules._grid(scene.capsules, (10, 10), 0.001)
    monkeypatch.setattr(capsules, "MOST_LISTED", 2**18)
    most = capsules.MOST_LISTED + capsules.LISTED_EACH * count
    per_length, grid = finest[2], np.array(finest[:2])
    assert capsules._cells_in_reach(scene.capsules, finest[3], per_length, grid) > each * count
    lists = capsules.cell_lists(scene.capsules, (10, 10), 0.001)
    assert most / 8 < len(lists.listed) < 1.2 * most
    with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as sim:
        assert sim.count == 0


@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_coarser_cells_give_the_same_bits(boundary, monkeypatch):
    """A cell lists all that a disc in it can touch, in one order, so what else it lists is never met."""
    places, side = lattice(400)
    pegs = fixed_discs(places[::3], 0.5)
    walls = [mpsim.Polyline([(1, 1), (side - 1, side / 2), (side / 2, side - 1)], 0.1)]
    box = {"width": side, "height": side, "radius": 0.4, "boundary": boundary, "obstacles": [*pegs, *walls]}
    inside = capsules.depths(places + 1, np.full(400, 0.4), capsules_of((*pegs, *walls)), (side, side), (True, True))
    position = places[inside == 0] + 1
    velocity = np.random.default_rng(3).normal(size=position.shape)

    def run():
        scene = mpsim.Scene(**box, position=position, velocity=velocity)
        with mpsim.Simulation(scene, mpsim.Settings(method="grid", dt=0.01)) as sim:
            sim.run(frames=200)
            return capsules.cell_lists(scene.capsules, (side, side), 0.4).grid.tolist(), sim.digest()

    grid, digest = run()
    monkeypatch.setattr(capsules, "MOST_LISTED", 0)
    monkeypatch.setattr(capsules, "LISTED_EACH", 4)
    coarse, same = run()
    assert np.prod(coarse) < np.prod(grid) / 3
    assert same == digest


@pytest.mark.parametrize("slope", [0.0, 0.3, 1.0])
def test_the_number_of_entries_is_known_beforehand(slope):
    """By which a grid is chosen: about so many, of pegs and walls within the box, at its border and beyond."""
    rng = np.random.default_rng(4)
    ends = np.tile(rng.uniform(-3, 23, (200, 2)), 2)
    ends[:100, 2:] += 5 * np.array([1, slope])
    many = np.column_stack([ends, 10 ** rng.uniform(-2, 1.5, 200)])
    lists = capsules.cell_lists(many, (20.0, 20.0), 0.1)
    columns, rows, per_length, margin = capsules._grid(many, (20.0, 20.0), 0.1)
    assert [columns, rows] == lists.grid.tolist()
    expected = capsules._cells_in_reach(many, margin, per_length, lists.grid)
    assert len(lists.listed) < expected < 1.3 * len(lists.listed)


def test_more_comparisons_than_can_be_made_are_refused_with_their_number(monkeypatch):
    monkeypatch.setattr(capsules, "MOST_COMPARED", 10_000)
    arguments = {"width": 10, "height": 10, "obstacles": thick(200), "radius": 0.001}
    position = np.random.default_rng(5).uniform(1, 9, (100, 2))
    with pytest.raises(mpsim.InputError, match=r"more than 10,000 pairs .* got 20,000 of 100 discs. Use fewer"):
        simulated({**arguments, "position": position})


@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_discs_that_enter_together_are_those_of_all_comparisons(boundary, monkeypatch):
    """Which of 300 emitters find their places free: by comparison with all discs, and with some."""
    rng = np.random.default_rng(8)
    spouts = [mpsim.Emitter(place, (0, 0), every=1, limit=3) for place in rng.uniform(1, 59, (300, 2))]
    arguments = {"position": rng.uniform(1, 59, (40, 2)), "width": 60, "height": 60, "radius": 1, "boundary": boundary}

    def entered(few):
        monkeypatch.setattr(emission, "FEW_LOOKS", few)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with simulated({**arguments, "emitters": spouts}) as sim:
                sim.run(frames=3)
                return sim.count, sim.digest()

    every = entered(10**9)
    assert 100 < every[0] < 340
    assert entered(32) == entered(1) == every


def test_looks_at_discs_grow_with_the_number_that_enter_together(monkeypatch):
    def compared(count):
        numbers, absolute = [], np.abs
        arguments = {**emitters(count), "position": np.zeros((0, 2))}
        spouts = tuple(mpsim.Emitter(each.position, (0, 0), every=1, limit=1) for each in arguments["emitters"])
        with simulated({**arguments, "emitters": spouts}) as sim, monkeypatch.context() as patch:
            patch.setattr(emission.np, "abs", lambda values: numbers.append(len(values)) or absolute(values))
            sim.run(frames=2)
            assert sim.count == count
        return sum(numbers)

    few, many = compared(400), compared(1600)
    assert 0 < few < many < 10 * few, "quadratic would be 16, in strips it is 8"


def pegs_and_emitters(obstacles, emitters, velocity=(10.0, 0.0)):
    """Discs that enter in the first frame, each in the middle between four pegs, or in flight to one of them."""
    places, side = lattice(obstacles, 1.0)
    middles = (places[(places < side - 1).all(axis=1)] + 0.5)[:emitters]
    spouts = tuple(mpsim.Emitter(place, velocity, interval=0.006, limit=1) for place in middles)
    box = {"width": side, "height": side, "position": np.zeros((0, 2)), "radius": 0.1}
    return {**box, "obstacles": fixed_discs(places, 0.05), "emitters": spouts}


def test_looks_at_obstacles_grow_with_the_number_of_discs_that_enter(monkeypatch):
    def compared(obstacles, emitters):
        numbers, hypot = [], np.hypot
        with simulated(pegs_and_emitters(obstacles, emitters)) as sim, monkeypatch.context() as patch:
            patch.setattr(np, "hypot", lambda *values: numbers.append(np.size(values[0])) or hypot(*values))
            sim.run(frames=1)
            assert sim.count == emitters
        return sum(numbers)

    few, many = compared(900, 200), compared(3600, 800)
    assert 0 < few < many < 6 * few, "linear would be 4, of all with all 16"


@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_few_discs_are_as_deep_in_obstacles_that_are_asked_again_and_again(boundary):
    rng = np.random.default_rng(9)
    walls = np.column_stack([rng.uniform(0, 30, (300, 4)), 10 ** rng.uniform(-3, 0, 300)])
    walls[::2, 2:4] = walls[::2, :2]
    box = walls, (30.0, 30.0), (boundary == "periodic",) * 2
    among, found = capsules.Among(*box), []
    for power in rng.integers(-6, 2, 100):
        position, radius = rng.uniform(0, 30, (3, 2)), 2.0**power * rng.uniform(0.5, 1, 3)
        found.append(among.depths(position, radius))
        assert np.array_equal(found[-1], capsules.depths(position, radius, *box))
    assert 0 < np.count_nonzero(found) < 300


def test_obstacles_that_are_replaced_are_those_that_are_asked():
    scene = mpsim.Scene(**{**pegs_and_emitters(9, 1), "velocity": []})
    place, radius = np.array([[0.5, 0.5]]), np.array([0.1])
    assert scene.among.depths(place, radius) > 0
    scene.obstacles = scene.obstacles[1:]
    assert scene.among.depths(place, radius) == 0


CROWDS = {"free": ((10.0, 0.0), 4e-4), "into obstacles": ((150.0, 150.0), 2.5e-3)}
"""Velocity of discs that enter, and seconds of processor time that each may take."""


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # a flight inside a frame is exact at any speed
@pytest.mark.timeout(300)
@pytest.mark.parametrize("how", long_but(CROWDS, "free"))
@pytest.mark.parametrize("emitters", [1000, pytest.param(10_000, marks=pytest.mark.long)])
def test_many_discs_enter_among_very_many_obstacles_in_seconds(how, emitters, figures):
    velocity, each = CROWDS[how]
    longest = 2 + each * emitters  # two seconds for the scene, and the grid in which they look
    with simulated(pegs_and_emitters(100, 1, velocity)) as sim:
        sim.run(frames=1)  # its kernels are loaded
    arguments = pegs_and_emitters(100_000, emitters, velocity)

    def first_frame():
        with simulated(arguments) as sim:
            sim.run(frames=1)
            assert sim.count == emitters

    seconds = quickest(first_frame, longest)
    assert seconds < longest
    what = f"100,000 pegs, {emitters:,} emitters: to the end of frame 1, in which all discs enter and fly {how}"
    figures.note("R22", "grid", what, f"{longest:g} s at most", f"{seconds:.2f} s")


def test_a_flight_ends_where_one_look_after_the_other_ends_it():
    """The twin bisects one step at a time."""
    rng = np.random.default_rng(10)
    for _ in range(200):
        flown, beyond = np.sort(10 ** rng.uniform(-6, 2, 2)).tolist()
        end, rounding = rng.uniform(flown, beyond), rng.choice([0.0, 1e-16, 1e-3]) * beyond
        found = entry_flight._last_clear(lambda times, end=end: times < end, flown, beyond, rounding)
        while beyond - flown > rounding and flown < (middle := 0.5 * (flown + beyond)) < beyond:
            flown, beyond = (middle, beyond) if middle < end else (flown, middle)
        assert found == flown


class NotLookedAt:
    def __array__(self, *_, **__):
        raise AssertionError("all discs are looked at")


def test_discs_that_are_there_are_not_looked_at_where_nothing_presses_them_together():
    """An array over all discs for each one that enters takes the square of their number."""
    box = {"width": 9, "height": 9, "position": [], "velocity": [], "radius": 1}
    place = {"time": 0.0, "name": "position", "position": np.array([4.0, 4.0]), "radius": 1.0}
    present: Any = NotLookedAt()
    assert insertion.hindrance(mpsim.Scene(**box), present=present, **place) is None
    pressed = mpsim.Scene(**box, piston=mpsim.Piston("right", -1, 5.0))
    assert "room for all 26 discs" in str(insertion.hindrance(pressed, present=np.ones(25), **place))
