"""Collisions are the same rows on any number of workers and tiles, however a run is cut, and change no bit of it."""

import functools

import numpy as np
import pytest
from support.internals import solver_of
from support.scenes import simulate

import mpsim
from mpsim.engine.solvers import base

pytestmark = pytest.mark.plain

COUNT, FRAMES = 25, 24
GRID, EVENT = {"method": "grid", "dt": 0.05, "substeps": 2}, {"method": "event", "dt": 0.125}
STOP_AT = {"grid": GRID, "event": EVENT}


@functools.cache
def scene(count=COUNT):
    return mpsim.Scene.random(count=count, packing=0.4, seed=2, radius=0.5)


def logged(cuts=(FRAMES,), count=COUNT, **settings):
    """The table and the digest."""
    seen = mpsim.Collisions()
    with simulate(scene(count), **settings) as sim:
        for frames in cuts:
            sim.run(frames=frames, observe=seen)
        return seen.table, sim.digest()


@functools.cache
def whole(method, count=COUNT):
    return logged(count=count, **STOP_AT[method])


def assert_same(found, method, count=COUNT):
    assert found[1] == whole(method, count)[1]
    assert found[0].tobytes() == whole(method, count)[0].tobytes()


@pytest.mark.parametrize(
    ("workers", "cuts"), [(1, (1,) * 6 + (18,)), pytest.param(3, (5, 1, 18), marks=pytest.mark.long)]
)
def test_stepped_collisions_are_the_same_on_any_workers(workers, cuts):
    assert_same(logged(cuts, **GRID | {"method": "parallel", "workers": workers}), "grid")
    assert len(whole("grid")[0]) > COUNT


@pytest.mark.parametrize("method", STOP_AT)
def test_looking_changes_no_bit_and_leaves_no_log(method):
    with simulate(scene(), **STOP_AT[method]) as sim:
        bare = sim.array_names
        sim.run(frames=FRAMES)
        assert sim.digest() == whole(method)[1]
        sim.run(frames=1, observe=mpsim.Collisions())
        assert {"collisions", "collision_counts"} <= set(sim.array_names) - set(bare)
        sim.run(frames=1)
        assert sim.array_names == bare


@pytest.fixture
def room_for(monkeypatch):
    """Logs with room for so many rows of all workers together: else it takes a frame of very many collisions."""

    def set_room(rows):
        monkeypatch.setattr(base, "ROOM", rows)
        monkeypatch.setattr(base, "ROOM_OF_A_DISC", 0)

    return set_room


def test_a_log_that_is_too_small_loses_nothing(room_for):
    whole("grid")
    whole("event")
    room_for(2)
    for settings in (GRID, EVENT):
        assert_same(logged(**settings), settings["method"])


@pytest.mark.parametrize("method", STOP_AT)
def test_a_run_that_was_interrupted_loses_nothing(method):
    seen, stopped = mpsim.Collisions(), []
    with simulate(scene(), **STOP_AT[method]) as sim:
        advance = solver_of(sim).advance

        def interrupted(*arguments):  # between two commands, whenever a signal comes
            part = advance(*arguments)
            if sim.frame == FRAMES // 2 and not stopped:
                stopped.append(sim.frame)
                raise KeyboardInterrupt
            return part

        solver_of(sim).advance = interrupted
        with pytest.raises(KeyboardInterrupt):
            sim.run(frames=FRAMES, observe=seen)
        sim.run(frames=FRAMES - sim.frame, observe=seen)
        assert stopped == [FRAMES // 2]
        assert_same((seen.table, sim.digest()), method)


def test_times_go_on_after_a_change_of_dt():
    seen = mpsim.Collisions()
    with simulate(scene(), method="grid", dt=0.05) as sim:
        sim.run(frames=12, observe=seen)
        sim.change(dt=0.025)
        sim.run(frames=12, observe=seen)
    frame, time = seen.table["frame"], seen.table["time"]
    assert (frame > 12).sum() > 3
    early = np.where(frame > 12, (frame + 12) - time / 0.025, frame - time / 0.05)
    assert early.min() > -1e-9
    assert early.max() < 1 + 1e-9


@pytest.mark.parametrize("seed", [2, 18, 38])
def test_a_wall_on_which_another_ends_is_named_by_its_number(seed):
    """The exact solver meets its halves, which begin at that end, too."""
    rng = np.random.default_rng(seed)
    start, end = rng.uniform(1, 9, 2), rng.uniform(1, 9, 2)
    joint = start + (end - start) * rng.random()
    velocity = rng.normal(size=2) * 3
    walls = [mpsim.Polyline([start, end]), mpsim.Polyline([joint, rng.uniform(1, 9, 2)])]
    one = mpsim.Scene(width=10, height=10, radius=0.3, position=[(5, 5)], velocity=[velocity], obstacles=walls)
    seen = mpsim.Collisions()
    with simulate(one, method="event", dt=5) as sim:
        sim.run(frames=1, observe=seen)
    met = seen.table["j"][seen.table["kind"] == 2]
    assert len(met) > 0
    assert set(met) <= {0, 1}
