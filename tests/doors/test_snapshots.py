"""Snapshots in memory: the same bits after going back, whatever was done since; branches; what is refused."""

import pickle
import weakref

import numpy as np
import pytest
from support.goldens import SCENES as PINNED
from support.scenes import exact_zoo, gas, simulate

import mpsim
from mpsim import InputError

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::UserWarning")]

METHODS = ["naive", "grid", "event"]


SCENES = {name: PINNED[name].scene for name in ("bare", "rough exact", "rotation", "stream exact")}


def change_everything(sim):
    """Each kind of change, a run after each."""
    sim.kick([1, 2], impulse=(1.5, 0.5))
    sim.run(frames=3)
    sim.remove(3)
    sim.change(restitution=0.7, gravity=(0.5, -0.5))
    sim.run(frames=3)
    if sim.scene.emitters:
        sim.change(interval=0.05)
    sim.set(4, velocity=(0, 0))
    sim.change(dt=0.5 * sim.settings.dt)
    sim.run(frames=3)


def kept(sim):
    there = sim.digest(), sim.frame, sim.time, sim.count, sim.substeps, sim.origin
    return *there, sim.scene.digest(), sim.settings, [change.what for change in sim.journal]


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("method", METHODS)
def test_after_restore_all_is_as_if_nothing_had_been_done_since(name, method):
    with simulate(SCENES[name](), method=method) as sim:
        sim.run(frames=7)
        sim.kick(0, impulse=(0.3, 0.1))
        snap, at_once = sim.snapshot(), kept(sim)
        assert kept(sim) == at_once, "taking one changes nothing"
        sim.run(frames=10)
        later = kept(sim)
        for _ in range(2):
            change_everything(sim)
            sim.run(frames=10)
            assert kept(sim)[0] != later[0], "the control: what was done matters"
            sim.restore(snap)
            assert kept(sim) == at_once
            sim.run(frames=4)
            sim.run(frames=6)
            assert kept(sim) == later
    with mpsim.Simulation.from_snapshot(snap) as branch:
        branch.run(frames=10)
        assert kept(branch) == later, "a branch has the bits of what it was taken from, which is closed"
        with mpsim.Simulation.replay(branch.journal, workers=1) as again:
            assert again.digest() == later[0]


def test_added_discs_and_walls_are_gone_after_restore_and_their_numbers_are_given_again():
    with simulate(gas(30, 0.1), method="grid") as sim:
        snap, at_once = sim.snapshot(), kept(sim)
        for _ in range(2):
            for place in [(x, y) for x in np.arange(0.6, 14, 1.1) for y in np.arange(0.6, 14, 1.1)]:
                sim.add(place, (0, 0))
            sim.run(frames=2)
            sim.remove(31)
            sim.restore(snap)
            assert kept(sim) == at_once
        free = sim.state.position.copy()
        wall = next([(x, 0.0), (x, 0.4)] for x in np.arange(0.5, 14, 0.1)
                    if np.hypot(*(free - (x, 0.2)).T).min() > 0.9)  # fmt: skip
        sim.add_wall(wall)
        assert len(sim.scene.obstacles) == 1
        sim.restore(snap)
        assert sim.scene.obstacles == ()
        assert kept(sim) == at_once


def test_auto_goes_back_to_the_method_of_fewer_discs():
    with simulate(gas(100, 0.05), method="auto", workers=1) as sim:
        snap, at_once = sim.snapshot(), kept(sim)
        run = sim.run(frames=5)
        later = kept(sim)
        sim.restore(snap)
        side = sim.scene.width
        for x in np.arange(0.6, side - 0.6, 1.2):
            for y in np.arange(0.6, side - 0.6, 1.2):
                sim.add((x, y), (0, 0))
        assert (run.method, sim.run(frames=1).method) == ("naive", "grid")
        sim.restore(snap)
        assert kept(sim) == at_once
        assert sim.run(frames=5).method == "naive"
        assert kept(sim) == later


FAST = {"method": "grid", "dt": 0.02}


@pytest.mark.parametrize(
    ("make", "how", "first", "then"),
    [
        *((lambda: gas(20, 0.2, gravity=(0, -30)), FAST | {"on_fast": each}, 10, 40) for each in ("warn", "substep")),
        (exact_zoo, {"method": "event"}, 20, 300),
    ],
    ids=["fast", "sub-steps", "exact"],
)
def test_sub_steps_discs_that_have_left_a_piston_and_obstacles_are_those_of_the_moment(make, how, first, then):
    with simulate(make(), **how) as sim:
        sim.run(frames=first)
        snap, at_once = sim.snapshot(), (kept(sim), sim.state.box)
        sim.run(frames=then)
        later = kept(sim), sim.state.box
        if make is exact_zoo:
            assert later[1] != at_once[1]
            assert not sim.state.present.all()
        sim.restore(snap)
        assert (kept(sim), sim.state.box) == at_once
        sim.run(frames=then)
        assert (kept(sim), sim.state.box) == later


def test_averages_and_reports_begin_anew():
    with simulate(gas(30, 0.3), method="grid") as sim:
        snap = sim.snapshot()
        first = sim.run(frames=50, measures=["pressure", "collision_rate"])
        sim.restore(snap)
        again = sim.run(frames=50, measures=["pressure", "collision_rate"])
        assert (again.measures, again.collisions, again.frames) == (first.measures, first.collisions, 50)


# --- observers: each sees one line of frames


def test_an_observer_that_has_looked_refuses_to_go_on_after_restore_and_a_new_one_sees_the_new_frames(tmp_path):
    def observers(number):
        trajectory = mpsim.Trajectory.write(tmp_path / f"{number}.xyz", every=2)
        series = mpsim.measure.Series(mpsim.measure.temperature)
        return mpsim.Collisions(), mpsim.Sensor(wall="left"), trajectory, series

    with simulate(gas(30, 0.4), method="grid") as sim:
        before, idle, after = observers(1), observers(2), observers(3)
        sim.run(frames=4)
        snap = sim.snapshot()
        sim.run(frames=10, observe=before)
        sim.run(frames=2, observe=before)
        assert sim.restores == 0
        sim.restore(snap)
        assert sim.restores == 1
        for each in before:
            with pytest.raises((InputError, mpsim.errors.OutputError), match=r"may be undone, as sim.restore"):
                sim.run(frames=2, observe=each)
        sim.restore(snap)
        sim.run(frames=12, observe=[*idle, *after])
        assert (idle[0].table == before[0].table).all()
        assert len(idle[0].table) > 0
        for each in (before, idle, after):
            each[2].close()
        texts = [(tmp_path / f"{number}.xyz").read_text() for number in (1, 3)]
        assert texts[0] == texts[1]
        assert texts[0].count("Lattice") == 7


def test_an_observer_may_take_a_snapshot_but_not_go_back():
    taken = []

    class Looks:
        every = 5

        def observe(self, sim, collisions):
            taken.append(sim.snapshot())
            with pytest.raises(InputError, match="restore must be called between two runs"):
                sim.restore(taken[0])

    with simulate(gas(20, 0.3), method="grid") as sim:
        sim.run(frames=20, observe=Looks())
        end = sim.digest()
        assert [each.frame for each in taken] == [0, 5, 10, 15, 20]
        sim.restore(taken[2])
        sim.run(frames=10)
        assert sim.digest() == end


# --- what is refused, and what a snapshot is


def test_a_snapshot_of_another_scene_is_refused_and_says_what_to_do():
    scene = gas(20, 0.3)
    with simulate(scene, method="grid") as sim, simulate(gas(21, 0.3), method="grid") as other:
        snap = other.snapshot()
        with pytest.raises(InputError, match=r"same scene and settings; got <Snapshot: 21 discs.*from_snapshot"):
            sim.restore(snap)
        with simulate(scene, method="naive") as same, pytest.raises(InputError, match="from_snapshot"):
            sim.restore(same.snapshot())
        with pytest.raises(InputError, match=r"restore needs a Snapshot, from sim.snapshot\(\); got 7"):
            sim.restore(7)  # pyright: ignore[reportArgumentType]
        with pytest.raises(InputError, match="from_snapshot needs a Snapshot"):
            mpsim.Simulation.from_snapshot("run.mpsim")  # pyright: ignore[reportArgumentType]
        with pytest.raises(InputError, match="method must be that of the checkpoint"):
            mpsim.Simulation.from_snapshot(snap, method="event")
        with pytest.raises(InputError, match=r"method='mpi' cannot start from a snapshot in memory. Use sim.save"):
            mpsim.Simulation.from_snapshot(snap, method="mpi")
        assert sim.restores == 0
    with pytest.raises(mpsim.errors.ClosedError):
        sim.restore(snap)
    with pytest.raises(mpsim.errors.ClosedError):
        sim.snapshot()


def test_a_snapshot_holds_copies_that_nobody_can_write():
    with simulate(gas(400, 0.3), method="grid") as sim:
        sim.run(frames=3)
        snap = sim.snapshot()
        assert (snap.frame, snap.time, snap.count) == (3, sim.time, 400)
        assert 32 * 400 <= snap.nbytes <= 80 * 400
        assert repr(snap) == f"<Snapshot: 400 discs, frame 3, time {sim.time:g}>"
        assert all(not array.flags.writeable for array in snap.arrays.values() if isinstance(array, np.ndarray))


@pytest.mark.parametrize("method", METHODS)
def test_a_snapshot_is_freed_at_once_and_a_pickle_of_it_is_one_of_an_equal_scene(method):
    with simulate(gas(20, 0.3), method=method) as sim, simulate(gas.__wrapped__(20, 0.3), method=method) as other:
        sim.run(frames=5)
        sim.remove(3)
        snap = sim.snapshot()
        freed = [weakref.ref(each) for name, each in snap.arrays.items() if name not in ("radii", "masses")]
        sent = pickle.dumps(snap)
        del snap
        assert [each() for each in freed] == [None] * len(freed)
        other.restore(received := pickle.loads(sent))
        assert all(not array.flags.writeable for array in received.arrays.values() if isinstance(array, np.ndarray))
        for each in (sim, other):
            each.run(frames=20)
        assert kept(other) == kept(sim)
