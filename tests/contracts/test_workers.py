"""The same bits on any number of workers, with any start method, on every run."""

import itertools

import pytest
from support.compare import assert_same_bits
from support.processes import assert_clean, run_script
from support.scenes import ZOO, digest_after, gas, simulate, state_after, zoo

from mpsim.core.cores import usable_cores

COUNT, PACKING, FRAMES = 20_000, 0.7, 60
SETTINGS = {"dt": 0.02}


@pytest.fixture(scope="module")
def expected():
    """State of the dense scene by `grid`."""
    return state_after(gas(COUNT, PACKING, seed=1), FRAMES, method="grid", **SETTINGS)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2, 3, 4])
def test_a_dense_scene_has_the_bits_of_grid_on_any_number_of_workers(workers, expected):
    with simulate(gas(COUNT, PACKING, seed=1), method="parallel", workers=workers, **SETTINGS) as sim:
        report = sim.run(frames=FRAMES)
        assert_same_bits(sim.state, expected, f"{workers} workers")
    assert report.collisions > 10_000, f"{report.collisions} contacts keep no worker busy"


def test_repeated_runs_have_the_same_bits(expected):
    for run in range(3):
        again = state_after(gas(COUNT, PACKING, seed=1), FRAMES, method="parallel", workers=2, **SETTINGS)
        assert_same_bits(again, expected, f"run {run}")


def test_float32_has_the_same_bits_on_any_number_of_workers():
    scene, settings = gas(COUNT, PACKING, seed=1), {"precision": "float32", **SETTINGS}
    grid = state_after(scene, FRAMES, method="grid", **settings)
    assert_same_bits(state_after(scene, FRAMES, method="parallel", workers=3, **settings), grid, "float32")


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # 3.12: fork in a process with threads
@pytest.mark.parametrize("start_method", ["fork", "spawn", "forkserver"])
def test_the_start_method_does_not_change_the_bits(start_method, expected):
    scene = gas(COUNT, PACKING, seed=1)
    state = state_after(scene, FRAMES, method="parallel", workers=2, start_method=start_method, **SETTINGS)
    assert_same_bits(state, expected, start_method)


def test_two_simulations_at_the_same_time_do_not_disturb_each_other():
    first, second = gas(2000, 0.5, seed=2), gas(1500, 0.6, seed=3)
    alone = [digest_after(scene, 30, method="grid") for scene in (first, second)]
    with simulate(first, method="parallel", workers=2) as one, simulate(second, method="parallel", workers=3) as two:
        for _ in range(6):
            one.run(frames=5)
            two.run(frames=5)
        assert [one.digest(), two.digest()] == alone


RUN_ALONE = """
from support.scenes import digest_after, gas
scene = gas({count}, {packing}, seed=1)
print(digest_after(scene, {frames}, method="{method}", workers={workers}, start_method="{start}", dt=0.02))
"""


def digest_alone(method, workers, start, count=COUNT, frames=FRAMES):
    """Digest found by an interpreter of its own."""
    text = RUN_ALONE.format(count=count, packing=PACKING, frames=frames, method=method, workers=workers, start=start)
    outcome = run_script(text, bound=120)
    assert_clean(outcome)
    return outcome.out.strip()


@pytest.mark.slow
def test_another_process_finds_the_same_bits(expected):
    assert digest_alone("parallel", 2, "forkserver") == expected.digest()


@pytest.mark.long
@pytest.mark.timeout(600)
def test_every_worker_count_and_start_method_agrees_after_300_frames():
    scene = gas(COUNT, PACKING, seed=1)
    grid = digest_after(scene, 300, method="grid", **SETTINGS)
    for workers, start in itertools.product((1, 2, 3, 4, 8), ("fork", "spawn", "forkserver")):
        assert digest_alone("parallel", workers, start, frames=300) == grid, f"{workers} workers by {start}"


@pytest.mark.long
def test_many_runs_on_more_workers_than_cores_agree():
    scene = gas(5000, PACKING, seed=1)
    grid = digest_after(scene, 50, method="grid")
    for run in range(30):
        assert digest_after(scene, 50, method="parallel", workers=6) == grid, f"run {run}"


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of the tail of the speeds
@pytest.mark.parametrize("name", ZOO)
def test_every_feature_has_the_bits_of_grid_on_all_cores_of_the_machine(name):
    scene = zoo(ZOO[name], COUNT, seed=7, side=163.0)
    settings = {"contact": "impact", "dt": 0.03}
    with simulate(scene, method="grid", **settings) as sim:
        assert sim.run(frames=FRAMES).collisions > COUNT
        grid = sim.digest()
    for workers in {3, 5, 8, max(usable_cores() - 1, 1), usable_cores()}:
        assert digest_after(scene, FRAMES, method="parallel", workers=workers, **settings) == grid, f"{workers} workers"
