"""Capsules near a place are those of all comparisons, and looking for them grows with their number, not its square."""

import itertools

import numpy as np
import pytest
from support.many import chain, lattice, pegs, pegs_and_emitters, simulated
from support.selection import long_but

import mpsim
from mpsim.features import capsules
from mpsim.features.obstacles import capsules_of, fixed_discs


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


@pytest.mark.parametrize("boundary", long_but(["walls", "periodic"], "walls"))
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
def test_few_discs_are_as_deep_in_obstacles_that_are_asked_again_and_again(boundary):
    rng = np.random.default_rng(9)
    walls = np.column_stack([rng.uniform(0, 30, (300, 4)), 10 ** rng.uniform(-3, 0, 300)])
    walls[::2, 2:4] = walls[::2, :2]
    box = walls, (30.0, 30.0), (boundary == "periodic",) * 2
    among, found = capsules.CapsuleIndex(*box), []
    for power in rng.integers(-6, 2, 100):
        position, radius = rng.uniform(0, 30, (3, 2)), 2.0**power * rng.uniform(0.5, 1, 3)
        found.append(among.depths(position, radius))
        assert np.array_equal(found[-1], capsules.depths(position, radius, *box))
    assert 0 < np.count_nonzero(found) < 300


def test_obstacles_that_are_replaced_are_those_that_are_asked():
    scene = mpsim.Scene(**{**pegs_and_emitters(9, 1), "velocity": []})
    place, radius = np.array([[0.5, 0.5]]), np.array([0.1])
    assert scene.capsule_index.depths(place, radius) > 0
    scene = scene.changed(obstacles=scene.obstacles[1:])
    assert scene.capsule_index.depths(place, radius) == 0
