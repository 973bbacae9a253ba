"""Collisions are the same rows on any number of workers and tiles, however a run is cut, and change no bit of it."""

import contextlib
import functools
import os
import signal

import numpy as np
import pytest
from support.internals import solver_of
from support.scenes import simulate
from support.selection import long_but
from support.sessions import METHODS, stage
from support.tiles import always_tiled, everything, on_tiles, windows_of

import mpsim
from mpsim.engine.solvers import collisions, step_log
from mpsim.engine.solvers.base import Origin

pytestmark = pytest.mark.slow

COUNT, FRAMES, DT = 1500, 24, 0.125


SCENES = {"a gas": {"radius": 0.5}, "everything": everything(COUNT)}
"""By name: arguments of `Scene.random`."""


@functools.cache
def scene(name="a gas"):
    return mpsim.Scene.random(count=COUNT, packing=0.4, seed=2, **SCENES[name])


def on_whole_or_tiles(name="a gas", tiling=(1, 1), workers=1, cuts=(FRAMES,)):
    """The table, the digest, and what the windows came to."""
    seen = mpsim.Collisions()
    with always_tiled(*tiling), on_tiles(scene(name), tiling, workers=workers, dt=DT) as sim:
        for frames in cuts:
            sim.run(frames=frames, observe=seen)
        return seen.table, sim.digest(), None if tiling == (1, 1) else windows_of(sim)


def stepped(name="a gas", workers=1, cuts=(FRAMES,), **settings):
    """The table and the digest."""
    seen = mpsim.Collisions()
    method = "grid" if workers == 1 else "parallel"
    with simulate(scene(name), method=method, workers=workers, dt=0.05, substeps=2, **settings) as sim:
        for frames in cuts:
            sim.run(frames=frames, observe=seen)
        return seen.table, sim.digest()


@functools.cache
def whole(name="a gas"):
    return on_whole_or_tiles(name)


@functools.cache
def by_grid(name="a gas"):
    return stepped(name)


@pytest.mark.parametrize("name", long_but(SCENES, "a gas"))
@pytest.mark.parametrize(
    ("tiling", "workers", "cuts"),
    [((2, 1), 1, (FRAMES,)), ((2, 2), 2, (FRAMES,)), ((3, 2), 3, (5, 1, 18)), ((4, 1), 2, (1,) * FRAMES)],
)
def test_exact_collisions_are_the_same_on_any_tiles_and_workers(name, tiling, workers, cuts):
    table, digest, windows = on_whole_or_tiles(name, tiling, workers, cuts)
    assert windows["windows"] > windows["as_one"], windows
    assert digest == whole(name)[1]
    assert table.tobytes() == whole(name)[0].tobytes()
    assert len(table) > 5 * COUNT


@pytest.mark.parametrize("name", long_but(SCENES, "a gas"))
@pytest.mark.parametrize(("workers", "cuts"), [(1, (1,) * FRAMES), (2, (FRAMES,)), (3, (5, 1, 18))])
def test_stepped_collisions_are_the_same_on_any_workers(name, workers, cuts):
    table, digest = stepped(name, workers, cuts)
    assert digest == by_grid(name)[1]
    assert table.tobytes() == by_grid(name)[0].tobytes()
    assert len(table) > COUNT


def test_looking_changes_no_bit():
    with on_tiles(scene(), (1, 1), dt=DT) as sim:
        sim.run(frames=FRAMES)
        assert sim.digest() == whole()[1]
    with simulate(scene(), method="grid", dt=0.05, substeps=2) as sim:
        sim.run(frames=FRAMES)
        assert sim.digest() == by_grid()[1]


def tables_of(frames, every):
    """What is handed over along a run."""
    handed = []
    seen = mpsim.Collisions(each=lambda sim, table: handed.append((sim.frame, table)), every=every)
    with on_tiles(scene(), (1, 1), dt=DT) as sim:
        sim.run(frames=frames, observe=seen)
    return handed, seen.table


@pytest.mark.parametrize("every", [1, 5])
def test_what_is_handed_over_is_cut_at_frames(every):
    handed, left = tables_of(FRAMES, every)
    assert [frame for frame, _ in handed] == list(range(every, FRAMES + 1, every))
    for frame, table in handed:
        assert (table["frame"] > frame - every).all()
        assert (table["frame"] <= frame).all()
    assert (left["frame"] > FRAMES - FRAMES % every).all()
    assert np.concatenate([*(table for _, table in handed), left]).tobytes() == whole()[0].tobytes()


@pytest.fixture
def room_for(monkeypatch):
    """Logs with room for so many rows of all workers together."""

    def set_room(rows):
        monkeypatch.setattr(collisions, "ROOM", rows)
        monkeypatch.setattr(collisions, "ROOM_OF_A_DISC", 0)

    return set_room


@pytest.mark.parametrize("room", [4, 50, 1000])
def test_a_log_that_is_too_small_loses_nothing(room, room_for):
    expected, stepped_one = whole(), by_grid()
    room_for(room)
    for tiling, workers in (((1, 1), 1), ((2, 1), 1), ((2, 2), 2)):
        table, digest, _ = on_whole_or_tiles("a gas", tiling, workers)
        assert digest == expected[1]
        assert table.tobytes() == expected[0].tobytes(), (tiling, workers)
    for workers in (1, 2):
        table, digest = stepped("a gas", workers)
        assert digest == stepped_one[1]
        assert table.tobytes() == stepped_one[0].tobytes(), workers


def test_rows_are_lost_where_nobody_looks_whether_they_fit(room_for, monkeypatch):
    """What the test above would find."""
    expected = by_grid()[0]
    room_for(50)
    monkeypatch.setattr(collisions, "longest", lambda arrays: 0)
    assert len(stepped()[0]) < len(expected)


@pytest.mark.parametrize("method", ["event", "parallel"])
def test_collisions_of_a_run_that_heals_come_once(method):
    expected = (whole() if method == "event" else by_grid())[0]
    seen, killed = mpsim.Collisions(), []

    def kill(done, _):
        if done >= FRAMES // 2 and not killed:
            killed.append(sim.pids[0])
            os.kill(sim.pids[0], signal.SIGKILL)

    settings = {"workers": 2, "on_worker_death": "restart"}
    if method == "event":
        with always_tiled(2, 2), on_tiles(scene(), (2, 2), dt=DT, **settings) as sim:
            sim.run(frames=FRAMES, observe=seen, progress=kill)
    else:
        with simulate(scene(), method=method, dt=0.05, substeps=2, **settings) as sim:
            sim.run(frames=FRAMES, observe=seen, progress=kill)
    assert killed
    assert seen.table.tobytes() == expected.tobytes()


@pytest.mark.parametrize("method", ["event", "grid"])
def test_a_run_that_was_interrupted_loses_nothing(method):
    expected = (whole() if method == "event" else by_grid())[0]
    settings = {"dt": DT} if method == "event" else {"dt": 0.05, "substeps": 2}
    seen, stopped = mpsim.Collisions(), []
    with simulate(scene(), method=method, **settings) as sim:
        advance = solver_of(sim).advance

        def interrupted(*arguments):
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
    assert seen.table.tobytes() == expected.tobytes()


class Doings:
    """What happens to the stage at some frames of a run, each once."""

    every = 10

    def __init__(self):
        self.to_come = {
            10: lambda sim: sim.kick([1, 7], (0.5, 0.25)),
            20: lambda sim: sim.remove([4, 11]),
            30: lambda sim: sim.change(gravity=(0.25, -0.25), piston_speed=-0.5),
            40: lambda sim: sim.set(5, velocity=(1.0, 0.0)),
        }

    def look(self, sim, collisions):
        self.to_come.pop(sim.frame, lambda sim: None)(sim)


def changed_as_it_ran(words, cuts, **more):
    """The table of a run in which discs, a piston's speed and the length of frames are changed, and the digest."""
    seen, doings = mpsim.Collisions(), Doings()
    tiled = always_tiled(2, 2, halo=3) if words == "event on tiles" else contextlib.nullcontext()
    with tiled, simulate(stage(), dt=0.025, **METHODS[words] | more) as sim:
        for frames in cuts:
            sim.run(frames=frames, observe=[seen, doings])
        sim.change(dt=0.0125)
        sim.run(frames=30, observe=seen)
        return seen.table, sim.digest()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
@pytest.mark.parametrize("words", METHODS)
def test_frames_and_times_go_on_after_changes(words):
    """Of each collision, and so does the place of those on the piston."""
    table, digest = changed_as_it_ran(words, (60,))
    short = np.maximum(table["frame"] - 60, 0)
    ends = np.minimum(table["frame"], 60) * 0.025 + short * 0.0125
    early = ends - table["time"]
    assert (early > -1e-9).all()
    assert (early < np.where(short, 0.0125, 0.025) + 1e-9).all()
    assert (short > 0).sum() > 5
    at_piston = table[(table["kind"] == 1) & (table["j"] == 1)]
    times, width = at_piston["time"], stage().width
    place = np.maximum(width - 0.25 * np.minimum(times, 0.75) - 0.5 * np.maximum(times - 0.75, 0.0), 0.8 * width)
    np.testing.assert_allclose(at_piston["place"][:, 0], place, rtol=0, atol=1e-12)
    assert (times > 0.75).sum() > 2
    if "workers" in METHODS[words]:
        for workers, cuts in ((1, (5,) * 12), (3, (60,))):
            again = changed_as_it_ran(words, cuts, workers=workers)
            assert again[1] == digest
            assert again[0].tobytes() == table.tobytes()


def times_after_a_change():
    """How far before the end of its frame each collision is, in frames, before and after dt is halved."""
    seen = mpsim.Collisions()
    with simulate(scene(), method="grid", dt=0.05) as sim:
        sim.run(frames=12, observe=seen)
        sim.change(dt=0.025)
        sim.run(frames=12, observe=seen)
    frame, time = seen.table["frame"], seen.table["time"]
    assert (frame > 12).sum() > 100
    return np.where(frame > 12, (frame + 12) - time / 0.025, frame - time / 0.05)


def test_times_go_on_after_a_change_of_dt():
    early = times_after_a_change()
    assert early.min() > -1e-9
    assert early.max() < 1 + 1e-9


def test_times_that_do_not_count_from_the_change_would_be_noticed(monkeypatch):
    """The control: without the origin, those after it begin at 0 again."""
    origin = property(lambda self: Origin(self.frame, 0.0))
    monkeypatch.setattr(step_log.Begun, "origin", origin)
    assert times_after_a_change().max() > 2


def test_a_run_that_nobody_observes_has_no_log():
    with simulate(scene(), method="grid", dt=0.05) as sim:
        bare = sim.array_names
        sim.run(frames=1, observe=mpsim.Collisions())
        assert set(sim.array_names) - set(bare) == {"collisions", "collision_counts"}
        sim.run(frames=1)
        assert sim.array_names == bare
