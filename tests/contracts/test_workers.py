"""The same bits on any number of workers, with any start method, on every run; and the race that is the control."""

import itertools
import time

import numpy as np
import pytest
from support.compare import assert_inside_and_finite, assert_same_bits
from support.internals import block_name
from support.scenes import ZOO, crowd, digest_after, gas, simulate, state_after, zoo
from support.selection import FORKS, slow_but

import mpsim
from mpsim.core.machine import usable_cores

pytestmark = pytest.mark.compiled

MANY = 20_000
SETTINGS = {"dt": 0.02}


def dense(count):
    return gas(count, 0.7, seed=1)


def test_two_simulations_at_the_same_time_do_not_disturb_each_other():
    first, second = gas(2000, 0.5, seed=2), gas(1500, 0.6, seed=3)
    alone = [digest_after(scene, 30, method="grid") for scene in (first, second)]
    with simulate(first, method="parallel", workers=2) as one, simulate(second, method="parallel", workers=3) as two:
        for _ in range(6):
            one.run(frames=5)
            two.run(frames=5)
        assert [one.digest(), two.digest()] == alone


def rows(count):
    """Places in twenty points on the edges of cells, at which groups are shared by two workers as they spread."""
    return np.tile(np.stack(np.divmod(np.arange(20), 5), axis=1) * 6.0 + 3.0, (count, 1))


AT_ONE_POINT = mpsim.Scene(width=30, height=30, position=rows(9), velocity=np.zeros((180, 2)), radius=0.5)


@FORKS
@pytest.mark.parametrize(
    ("scene", "settings"),
    [
        (lambda: gas(600, 0.05, seed=1), {"law": "reflect", "dt": 0.02}),
        (lambda: gas(2000, 0.6, seed=5), {"contact": "impact", "passes": 2}),
        (lambda: dense(4000), {**SETTINGS, "start_method": "fork"}),
        (lambda: AT_ONE_POINT, {"contact": "push"}),
    ],
    ids=["thin, reflect", "two passes", "dense, by fork", "at one point"],
)
def test_parallel_is_grid(scene, settings):
    scene, settings = scene(), {"dt": 0.03, **settings}
    expected = state_after(scene, 30, method="grid", **settings)
    least = 2000 if scene.count == 4000 else 0
    with simulate(scene, method="parallel", workers=3, **settings) as sim:
        assert sim.run(frames=30).collisions > least, "too few contacts, which tests nothing"
        assert_same_bits(sim.state, expected, f"{scene!r}, {settings}")


@pytest.mark.parametrize(("count", "size"), [(60, (1.0, 200.0)), (60, (200.0, 1.5)), (2, (8.0, 8.0)), (0, (8.0, 8.0))])
def test_parallel_is_grid_with_more_workers_than_columns_or_discs(count, size):
    rng = np.random.default_rng(3)
    position, velocity = 0.5 + rng.random((count, 2)) * (np.array(size) - 1), rng.normal(size=(count, 2))
    scene = mpsim.Scene(width=size[0], height=size[1], position=position, velocity=velocity, radius=0.5)
    grid = state_after(scene, 40, method="grid", dt=0.05)
    assert_same_bits(state_after(scene, 40, method="parallel", workers=3, dt=0.05), grid, f"{count} discs on 3 workers")


@pytest.mark.parametrize("commands", [(20,) * 4, (1,) * 48], ids=["many frames a call", "one frame a call"])
@pytest.mark.filterwarnings("ignore::mpsim.errors.OverlapWarning")
def test_columns_are_dealt_by_the_time_that_they_take(commands):
    index = np.arange(2000)
    alone, pressed = np.stack(np.divmod(index, 40), axis=1) * 4.0, np.stack(np.divmod(index, 100), axis=1) * 0.7
    position = np.concatenate([alone, pressed + np.array([210, 0])]) + 1
    scene = mpsim.Scene(width=300, height=170, position=position, velocity=np.zeros((4000, 2)), radius=0.5)
    with simulate(scene, method="parallel", workers=2, dt=1e-4, passes=4) as sim:
        reports = [sim.run(frames=frames) for frames in commands]
    busy = [report.times[:, :, :-1].sum(axis=2).min(axis=1) for report in reports]  # without waiting
    uneven = [each.max() / each.min() for each in busy]
    assert uneven[0] > 4, f"it was even before, or dealt by one frame: {uneven}"
    assert min(uneven[len(uneven) // 2 :]) < 2, f"the worker of pressed discs takes longer to the end: {uneven}"


# --- what must fail
# That two racing runs differ would be a matter of luck. On one worker the order of columns without odd and even passes
# is simply another one (0, 1, 2, ...), which is enough to change the bits of a dense scene.


@pytest.mark.parametrize("precision", slow_but(["float32", "float64"], "float64"))
def test_unguarded_columns_are_resolved_in_another_order(precision):
    digests = [
        [digest_after(scene, frames, method="grid", precision=precision, unguarded=flag) for flag in (False, True)]
        for scene, frames in ((crowd(500, 0.85, seed=1), 5), (gas(200, 0.01, seed=2), 20))
    ]
    assert digests[0][0] != digests[0][1], "odd and even passes make no difference: the tests above would pass without"
    assert digests[1][0] == digests[1][1], "where no columns touch, nothing else is changed"


def test_unguarded_workers_lose_no_disc_and_end_cleanly():
    scene = gas(3000, 0.7, seed=3)
    state = state_after(scene, 50, method="parallel", workers=3, unguarded=True)
    assert_inside_and_finite(state, scene, "unguarded on 3 workers")


# --- more discs and frames


@pytest.mark.long
@pytest.mark.timeout(600)
@FORKS
def test_every_worker_count_and_start_method_agrees_after_300_frames_and_on_more_workers_than_cores():
    grid = digest_after(dense(MANY), 300, method="grid", **SETTINGS)
    for workers, start in itertools.product((1, 2, 3, 4, 8), ("fork", "spawn", "forkserver")):
        how = {"method": "parallel", "workers": workers, "start_method": start, **SETTINGS}
        assert digest_after(dense(MANY), 300, **how) == grid, f"{workers} workers by {start}"
    grid = digest_after(dense(5000), 50, method="grid")
    for run in range(30):
        assert digest_after(dense(5000), 50, method="parallel", workers=6) == grid, f"run {run}"


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of the tail of the speeds
@pytest.mark.parametrize("name", ZOO)
def test_every_feature_has_the_bits_of_grid_on_all_cores_of_the_machine(name):
    scene = zoo(ZOO[name], MANY, seed=7, side=163.0)
    settings = {"contact": "impact", "dt": 0.03}
    with simulate(scene, method="grid", **settings) as sim:
        assert sim.run(frames=60).collisions > MANY
        grid = sim.digest()
    for workers in {3, 5, 8, max(usable_cores() - 1, 1), usable_cores()}:
        assert digest_after(scene, 60, method="parallel", workers=workers, **settings) == grid, f"{workers} workers"


# --- in pieces, watched, or grown on the way: the bits of the run in one piece

CROWD, OF_CROWD = 400, 24


def overwrite(values):
    """Write zeros where an array that cannot be written has its values."""
    owner = values if values.base is None else values.base
    owner.flags.writeable = True
    owner[:] = 0


@pytest.mark.parametrize(("method", "workers"), [("naive", 1), ("grid", 1), ("parallel", 3)])
def test_a_run_in_pieces_that_is_looked_at_has_the_bits_of_one_run(method, workers):
    settings = {"method": method, "workers": workers, "dt": 0.02, "substeps": 2}
    expected = state_after(crowd(CROWD, 0.8, seed=1), OF_CROWD, **settings)
    with simulate(crowd(CROWD, 0.8, seed=1), **settings) as sim:
        for frames in (1, 1, 1, 7, 0, 1, 13):
            sim.run(frames=frames, progress=lambda done, of: time.sleep(0.0005))
            assert len(sim.digest()) == 32
            overwrite(sim.state.position)  # a copy
        assert sim.frame == OF_CROWD
        assert_same_bits(sim.state, expected, "in pieces")


def grow(method, workers, pieces, scene):
    """State after a growth experiment, and the number of blocks: `pieces` of discs are added, each after two frames."""
    rng = np.random.default_rng(4)
    places = 0.5 + rng.random((sum(pieces), 2)) * (scene.width - 1)
    speeds = rng.normal(size=(sum(pieces), 2))
    blocks, added = set(), 0
    with simulate(scene, method=method, workers=workers, dt=0.02) as sim:
        for size in pieces:
            sim.run(frames=2)
            sim.add(places[added : added + size], speeds[added : added + size])
            added += size
            blocks.add(block_name(sim))
        sim.run(frames=10)
        assert sim.count == scene.count + added
        return sim.state, len(blocks)


@pytest.mark.parametrize(
    ("method", "pieces", "packing", "on_workers"),
    [("grid", [1] * 20 + [5] * 10 + [40], 0.1, ("parallel", 3)), ("auto", [80] * 10, 0.01, ("auto", 2))],
)
def test_growth_has_the_same_bits_on_workers_in_larger_blocks_and_where_auto_changes_its_method(
    method, pieces, packing, on_workers
):
    scene = gas(30, packing, seed=3)
    expected, _ = grow(method, 1, pieces, scene)
    state, blocks = grow(*on_workers, pieces, scene)
    assert blocks > 2, "the block never grew, which tests half of it"
    assert_same_bits(state, expected, f"growth by {on_workers}")


def test_discs_added_one_by_one_or_together_give_the_same_bits():
    scene = gas(50, 0.2, seed=6)
    with simulate(scene, method="grid") as one, simulate(scene, method="grid") as other:
        places, speeds = scene.position[:6] * 0.99 + 0.01 * scene.width / 2, scene.velocity[:6]
        for place, speed in zip(places, speeds, strict=True):
            one.add(place, speed)
        other.add(places, speeds)
        one.run(frames=30)
        other.run(frames=30)
        assert_same_bits(one.state, other.state, "added one by one")
