"""The exact solver: stopping, saving, ties, overlaps, and what cannot be computed."""

import math

import numpy as np
import pytest
from support.exact import SCRIPT, Run, bits, everything, gas, in_a_new_process, kinetic, same_arrays
from support.script_server import TESTS

from mpsim.kernels.events import records
from mpsim.kernels.events.cells import worst_overlap


@pytest.mark.slow
def test_stopping_changes_no_bit():
    whole, cut, sliced = everything(), everything(), everything()
    assert whole.advance(7.0) == (records.REACHED, -1)
    for time in [0.0, 1e-9, 0.1, 0.1, math.pi / 7, 1.0, 1.0 + 1e-15, 2.718281828, 5.000000001, 6.9999, 7.0]:
        assert cut.advance(time) == (records.REACHED, -1)
        cut.state()
    calls = 0
    while sliced.advance(7.0, 13)[0] == records.PAUSED:
        calls += 1
    assert calls > 50
    assert bits(whole) == bits(cut) == bits(sliced)
    assert same_arrays(whole, sliced)
    # Negative control: the bits do tell one rounding.
    other = everything()
    velocity = other.store.disc[0].velocity
    velocity[0] = np.nextafter(velocity[0], 9.0)
    other.advance(7.0)
    assert bits(other) != bits(whole)


@pytest.mark.slow
def test_saved_and_restored_arrays_go_on_with_the_same_bits():
    whole, saved, other = everything(), everything(), everything(seed=10)
    whole.advance(6.0)
    saved.advance(2.345, 700)
    for target, source in zip(other.store, saved.store, strict=True):
        np.asarray(target)[...] = np.array(source)
    for name in ("radius", "mass", "image"):
        getattr(other.features, name)[:] = getattr(saved.features, name)
    other.box = saved.box
    assert other.advance(6.0) == (records.REACHED, -1)
    assert same_arrays(whole, other)
    assert bits(whole) == bits(other)


def test_ties_break_the_same_way_every_time():
    # Rows of discs in step: a whole lattice of impacts at the same instants.
    grid = 2.0 * np.arange(8) + 1.5
    position = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    velocity = np.where((np.indices((8, 8)).sum(0) % 2).reshape(-1, 1) == 0, [1.0, 0.0], [-1.0, 0.0])
    runs = [Run(position, velocity, 17.0, 17.0) for _ in range(2)]
    for run in runs:
        run.advance(200.0)
    assert same_arrays(*runs)
    assert runs[0].count("pairs") > 1000
    # Where the calendar keeps an event cannot matter, here on an exact grid of times.
    runs = [Run(position, velocity, 17.0, 17.0, steps=steps) for steps in (64, 1 << 12)]
    for run in runs:
        run.advance(3.0)
    assert bits(runs[0]) == bits(runs[1])
    assert runs[0].store.clock.lap != runs[1].store.clock.lap


def test_worst_overlap_is_the_brute_force_one():
    rng = np.random.default_rng(15)
    for periodic in ((False, False), (True, True)):
        x, radii = rng.uniform(1.0, 19.0, (200, 2)), rng.uniform(0.2, 0.6, 200)
        run = Run(x, np.zeros((200, 2)), 20.0, 20.0, radii, periodic=periodic)
        i, j, depth = worst_overlap(*run.system)
        r = x[:, None] - x[None]
        if periodic[0]:
            r -= 20.0 * np.round(r / 20.0)
        depths = radii[:, None] + radii[None] - np.hypot(r[..., 0], r[..., 1]) - 9.0 * np.eye(200)
        assert (i, j) == np.unravel_index(depths.argmax(), depths.shape)
        assert abs(depth - depths.max()) < 1e-14
    position, velocity, radius, length = gas(64, 0.3, seed=8)
    run = Run(position, velocity, length, length, radius)
    assert worst_overlap(*run.system) == (-1, -1, 0.0)


def test_rounding_overlaps_are_legal():
    # A touching triangular packing, scaled by one part in 1e12 below contact.
    rows = 8
    x = np.array([[1.0 + i + 0.5 * (j % 2), 1.0 + j * math.sqrt(0.75)] for j in range(rows) for i in range(rows)])
    rng = np.random.default_rng(16)
    x = x * (1.0 - 1e-12)
    velocity = rng.normal(size=(64, 2))
    run = Run(x, velocity, 12.0, 12.0)
    depth = worst_overlap(*run.system)[2]
    assert 0.0 < depth < 2e-12
    assert run.advance(20.0) == (records.REACHED, -1)
    x, v = run.state()
    assert abs(kinetic(v) / kinetic(velocity) - 1.0) < 1e-12
    r = x[:, None] - x[None]
    assert (np.hypot(r[..., 0], r[..., 1]) + 9.0 * np.eye(64)).min() > 1.0 - 1e-11
    assert run.count("pairs") > 1000


def test_a_jammed_corner_of_touching_discs_is_no_endless_loop():
    x = np.array([[0.5 + i, 0.5 + j] for j in range(4) for i in range(4)])
    velocity = np.random.default_rng(17).normal(size=(16, 2))
    run = Run(x, velocity, 4.0 + 1e-9, 4.0 + 1e-9)
    assert run.advance(1e-6)[0] == records.REACHED
    assert abs(kinetic(run.state()[1]) / kinetic(velocity) - 1.0) < 1e-11
    assert run.count("pairs") > 1000


def test_what_cannot_be_computed_is_a_status():
    position, velocity, radius, length = gas(16, 0.3, seed=18)
    bad = velocity.copy()
    bad[5, 1] = math.nan
    assert Run(position, bad, length, length, radius).placed == (records.NOT_FINITE, 5)
    bad[5, 1] = math.inf
    assert Run(position, bad, length, length, radius).placed == (records.NOT_FINITE, 5)
    off = position.copy()
    off[7, 0] = -1.0
    assert Run(off, velocity, length, length, radius).placed == (records.OUTSIDE, 7)
    run = Run(position, velocity, length, length, radius)
    run.advance(1.0)
    assert run.advance(0.5) == (records.BACKWARDS, -1)
    assert run.advance(math.nan) == (records.BACKWARDS, -1)
    for field in ("position", "velocity", "last_update"):
        run = Run(position, velocity, length, length, radius)
        run.advance(0.5)
        run.store.disc[field][3] = math.nan
        assert run.advance(50.0, 10**6)[0] == records.NOT_FINITE


def test_idle_and_cooling_scenes_take_few_laps():
    run = Run([[2.0, 2.0], [5.0, 5.0]], np.zeros((2, 2)), 10.0, 10.0)
    assert run.advance(1e9, 10_000) == (records.REACHED, -1)
    run = Run([[2.0, 2.0], [5.0, 5.0]], [[1e-7, 0.0], [0.0, 0.0]], 10.0, 10.0)
    assert run.advance(1e9, 10_000) == (records.REACHED, -1)
    assert run.count("walls") > 5


def test_time_keeps_its_resolution():
    # The same gas started at time zero and at time 2^40 moves alike: only the stopping time is rounded.
    position, velocity, radius, length = gas(36, 0.3, seed=19)
    early, late = (Run(position, velocity, length, length, radius) for _ in range(2))
    late.store.clock.origin = 2.0**40
    early.advance(3.0)
    late.advance(2.0**40 + 3.0)
    assert bits(early) == bits(late)


@pytest.mark.slow
def test_the_interpreter_gives_the_same_bits():
    code = SCRIPT.format(tests=str(TESTS))
    outputs = [in_a_new_process(code, NUMBA_DISABLE_JIT=flag) for flag in "01"]
    assert outputs[0] == outputs[1]
    assert "(0, -1)" in outputs[0]


def test_importing_compiles_nothing():
    code = "from mpsim.kernels.events.solver import advance, schedule; print(advance.signatures, schedule.signatures)"
    assert in_a_new_process(code).strip() == "[] []"
