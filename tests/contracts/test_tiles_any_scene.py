"""The exact solver on tiles: random scenes with features, physics that must not notice them, and few discs."""

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.internals import solver_of
from support.scenes import simulate
from support.tiles import assert_played_on_tiles, everything, on_tiles, windows_of

import mpsim

TILINGS = [(2, 1), (1, 2), (2, 2), (3, 1), (3, 2)]


def any_scene(seed, open_box):
    """Hundreds of discs with all that discs can have, and obstacles; in an open box, an edge that lets discs out.

    A closed one has the kernels of `support.tiles.everything`.
    """
    rng = np.random.default_rng(seed)
    count = int(rng.integers(300, 700))
    radius = rng.choice([0.5, 0.45, 0.3], count)
    ends = rng.uniform(7.5, 42.5, (3, 2, 2)).tolist()
    walls = [mpsim.Polyline(points, thickness=0.3) for points in ends]
    closed = {"obstacles": mpsim.FixedDisc((25.0, 25.0), 1.0), "boundary": ("periodic", "walls")}
    opening = {"obstacles": walls, "absorbing": ("right",)} if open_box else closed
    return mpsim.Scene.random(
        count=count, width=50.0, height=50.0, radius=radius, mass=rng.uniform(0.5, 2.0, count), seed=int(seed),
        temperature=float(rng.uniform(0.5, 4.0)), gravity=tuple(rng.normal(size=2).tolist()),
        restitution=float(rng.uniform(0.8, 0.99)), wall_restitution=float(rng.uniform(0.7, 0.99)),
        friction=float(rng.uniform(0.1, 0.5)), wall_friction=float(rng.uniform(0.1, 0.5)), **opening,
    )  # fmt: skip


def check_any_scene(seeds, open_box=False):
    """Play each scene as a whole and in some tiling, and compare states, counts, and who has left."""
    divided = left = 0
    for seed in seeds:
        rng = np.random.default_rng([seed, 1])
        tiling, dt = TILINGS[rng.integers(len(TILINGS))], float(rng.choice([0.05, 0.3, 1.0]))
        scene = any_scene(seed, open_box)
        with on_tiles(scene, (1, 1), dt=dt) as whole, on_tiles(scene, tiling, dt=dt) as sim:
            frames = int(3.0 / dt)
            assert whole.run(frames=frames).collisions == sim.run(frames=frames).collisions
            assert_same_bits(sim.state, whole.state, f"seed {seed} in {tiling}, dt {dt}")
            found = windows_of(sim)
            divided += found["windows"] - found["as_one"]
            left += int((~sim.state.present).sum())
    return divided, left


@pytest.mark.long
def test_random_scenes_are_the_same_on_tiles(figures):
    divided, _ = check_any_scene(range(3))
    assert divided > 5
    figures.note("R1", "event in tiles", "3 random scenes with features", "state of one tile", "the same")


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")  # of grains that come to rest
def test_two_hundred_random_scenes_are_the_same_on_tiles(figures):
    check_any_scene(range(3, 100))
    divided, left = check_any_scene(range(100, 200), open_box=True)
    assert divided > 500
    assert left > 500
    figures.note("R1", "event in tiles", "200 random scenes with features", "state of one tile", "the same")


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_on_tiles_comes_home_when_it_is_turned_round(workers, figures):
    """Errors of rounding grow e-fold in each of some collisions a disc, so the way is short."""
    start = mpsim.Scene.random(count=2000, packing=0.3, radius=0.5, seed=3)
    with on_tiles(start, (2, 2), workers, dt=0.25) as there:
        collisions = there.run(frames=12).collisions
        turned = there.state
        assert_played_on_tiles(there)
    back = mpsim.Scene(
        width=start.width, height=start.height, radius=0.5, position=turned.position, velocity=-turned.velocity
    )
    with on_tiles(back, (2, 2), workers, dt=0.25) as home:
        found = home.run(frames=12).collisions
        error = np.abs(home.state.position - start.position).max()
        assert_played_on_tiles(home)
    with on_tiles(start, (2, 2), dt=0.25) as onward:
        onward.run(frames=24)
        missed = np.abs(onward.state.position - start.position).max()
    assert found == collisions > 2000
    assert error < 1e-6
    assert missed > 1.0, "a run that is not turned round must not come home"
    figures.note("H3", f"event in tiles, {workers} workers", "comes home within", "< 1e-6", f"{error:.1e}")


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
def test_two_discs_meet_when_they_must_on_any_number_of_workers(workers):
    """A box too small to be divided is one worker's, however many there are."""
    scene = mpsim.Scene(
        width=20, height=10, radius=0.5, position=[[4.0, 5.0], [16.0, 5.0]], velocity=[[1.0, 0.0], [-2.0, 0.0]]
    )
    with simulate(scene, method="event", workers=workers, dt=0.5) as sim:
        sim.run(frames=10)
        assert sim.state.position == pytest.approx(np.array([[5.0, 5.0], [10.0, 5.0]]), abs=1e-12)
        assert sim.state.velocity.tolist() == [[-2.0, 0.0], [1.0, 0.0]]


def renumbered(sim):
    """Let equal times go by another number of each disc, as if they went by who plays it."""
    store = solver_of(sim)._system.store
    number, order = store.event["number"].copy(), store.order.copy()
    store.event["number"], store.order[:] = len(number) - 1 - number, order[::-1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")  # of the second collision of an instant
@pytest.mark.parametrize("other", [False, True])
def test_ties_that_were_broken_in_another_way_would_be_noticed(other):
    """The control: two discs hit a third one at the same instant, and who is first changes what becomes of them."""
    scene = mpsim.Scene(
        width=20, height=10, position=[[8.0, 5.0], [10.0, 5.0], [12.0, 5.0]],
        velocity=[[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]],
        **everything(3) | {"mass": [1.0, 2.0, 1.0], "radius": [0.5] * 3},
    )  # fmt: skip
    with simulate(scene, method="event", dt=0.5) as usual, simulate(scene, method="event", dt=0.5) as sim:
        if other:
            renumbered(sim)
        for each in (usual, sim):
            each.run(frames=4)
        assert np.array_equal(sim.state.velocity, usual.state.velocity) != other
