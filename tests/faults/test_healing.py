"""With on_worker_death="restart" a worker that dies is replaced, and nothing of the result shows it."""

import functools
import logging
import os
import random
import signal
import threading
import time

import pytest
from support.internals import block_name, peek
from support.killing import Killer, often, repeat_until_killed, slowed
from support.processes import SHARED_MEMORY, is_gone, wait_until
from support.scenes import crowd, digest_after, gas, lattice, simulate, struck, zoo
from support.selection import long_but

import mpsim
from mpsim.engine import recovery, run_record
from mpsim.engine.coordinator import Coordinator
from mpsim.engine.solvers.block import BlockSolver
from mpsim.engine.workers import pool

# 3.12: fork in a process with threads
pytestmark = [
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),  # of discs that are added where others are
]

MEASURES = ["pressure", "collision_rate", "largest_overlap", "kinetic_energy", "temperature"]
FRAMES = 2000


@functools.cache
def undisturbed(frames=FRAMES, measures=tuple(MEASURES)):
    """Digest, measures and collisions of the run in which nobody dies."""
    with simulate(gas(2000, 0.5, seed=1), method="grid") as sim:
        report = sim.run(frames=frames, measures=measures)
        return sim.digest(), values(report), report.collisions


def values(report):
    return {name: repr(each) for name, each in report.measures.items()}  # in which NaN equals NaN


def healing(scene=None, workers=3, start_method="fork", **settings):
    """A simulation whose workers are replaced; by fork, which starts them in the shortest time."""
    settings |= {"method": "parallel", "workers": workers, "start_method": start_method}
    return simulate(scene or gas(2000, 0.5, seed=1), on_worker_death="restart", **settings)


def assert_as_undisturbed(sim, report, frames=FRAMES):
    digest, expected, collisions = undisturbed(frames)
    assert sim.digest() == digest
    assert values(report) == expected
    assert report.collisions == collisions
    assert (sim.frame, report.frames) == (frames, frames)
    assert (report.frame_seconds > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("start", long_but(["fork", "forkserver"], "fork"))
def test_workers_that_die_at_random_moments_change_nothing(start, figures):

    def experiment(killing):
        with healing(start_method=start) as sim, killing(sim):
            report = sim.run(frames=FRAMES, measures=MEASURES)
            assert_as_undisturbed(sim, report)

    # Never more than a run stands without a snapshot in between, of which a slow machine may take none.
    deaths = repeat_until_killed(experiment, often, least=2, most=recovery.MOST_DEATHS)
    figures.note(
        "R9",
        f"parallel on 3, {start}",
        "workers killed at random moments",
        "digest and measures of grid",
        f"the same after {deaths} deaths",
    )


@pytest.mark.slow
def test_measures_from_a_start_on_do_not_show_deaths_before_or_after_it():
    late = {"frames": FRAMES, "measures": MEASURES, "start": 0.4 * FRAMES * mpsim.Settings().dt}
    with simulate(gas(2000, 0.5, seed=1), method="grid") as sim:
        expected = values(sim.run(**late))
    assert expected != undisturbed()[1], "negative control"

    def experiment(killing):
        with healing() as sim, killing(sim):
            assert values(sim.run(**late)) == expected

    repeat_until_killed(experiment, often, least=2, most=recovery.MOST_DEATHS)


@pytest.mark.slow
def test_a_run_that_forgot_to_rewind_would_be_noticed(monkeypatch, figures):
    """The control: without the way back of the measures, or of the discs, the comparison fails."""
    digest, expected, _ = undisturbed()
    monkeypatch.setattr(run_record.RunRecord, "rewind", lambda self, mark: setattr(self, "done", mark.done))
    found = []

    def experiment(killing):
        with healing() as sim, killing(sim):
            report = sim.run(frames=FRAMES, measures=MEASURES)
            assert sim.digest() == digest
            found.append(values(report))

    repeat_until_killed(experiment, lambda: 0.15, most=2)
    assert found[-1] != expected
    figures.note(
        "R9",
        "parallel on 3",
        "control: measures that do not return to the snapshot",
        "different measures",
        "different measures",
    )


PHASES = ["move", "sort", "even columns", "odd columns", "wait"]


def kill_once_in(sim, phase):
    """Deed of a Killer: stop worker 1 until it is found in this phase, and kill it there."""

    def deed(pids):
        os.kill(pids[0], signal.SIGSTOP)
        time.sleep(0.002)
        if peek(sim, 1)[0] == phase:
            os.kill(pids[0], signal.SIGKILL)
            killer.deaths += 1
        else:
            os.kill(pids[0], signal.SIGCONT)

    killer = Killer(sim, lambda: random.uniform(0.001, 0.004), deed, most=1)
    return killer


@pytest.mark.slow
@pytest.mark.parametrize("phase", PHASES)
def test_a_death_in_any_phase_is_healed(phase, figures):
    with healing(lattice(100, 100), workers=2) as sim:
        with kill_once_in(sim, phase) as killer:
            sim.run(frames=300)
            while not killer.deaths:
                sim.run(frames=100)
            frames = sim.frame
        digest = sim.digest()
    with simulate(lattice(100, 100), method="grid") as sim:
        sim.run(frames=frames)
        assert sim.digest() == digest
    figures.note("R9", "parallel on 2", f"a worker killed in phase '{phase}'", "digest of grid", "the same")


@pytest.mark.slow
def test_a_worker_that_is_killed_while_it_replaces_another_is_replaced_too(monkeypatch, caplog):
    """The first worker dies in its run, and two of the three that replace it before they are ready."""
    starts = []
    begin = pool.WorkerPool._await_ready

    def kill_and_wait(self, worker):
        starts.append(worker)
        if 1 < len(starts) < 4:
            os.kill(self.pids[worker - 1], signal.SIGKILL)
        begin(self, worker)

    monkeypatch.setattr(pool.WorkerPool, "_await_ready", kill_and_wait)
    with caplog.at_level(logging.WARNING, "mpsim"), healing(workers=2) as sim:
        os.kill(sim.pids[0], signal.SIGKILL)
        report = sim.run(frames=FRAMES)
        assert sim.digest() == undisturbed()[0]
    assert report.frames == FRAMES
    assert [record.getMessage().split("'")[1] for record in caplog.records[1:]] == ["start-up", "start-up"]


@pytest.mark.slow
@pytest.mark.parametrize("grows", [1, 60])
def test_a_death_before_or_while_discs_are_added_is_healed(grows):
    """60 discs move the workers to a larger block, one does not."""
    more = lattice(8, 8)
    digests = []
    for workers in (1, 3):
        with healing(lattice(9, 9), workers=workers) as sim:
            for _ in range(3):
                sim.run(frames=5)
                if workers > 1:
                    os.kill(random.choice(sim.pids), signal.SIGKILL)
                sim.add(more.position[:grows], more.velocity[:grows])
            sim.run(frames=5, measures=["pressure"])  # which moves them again
            assert sim.count == 81 + 3 * grows
            digests.append(sim.digest())
    assert digests[0] == digests[1]


@pytest.mark.slow
def test_a_death_between_runs_is_healed_when_measures_move_the_workers():
    with healing(gas(500, 0.5, seed=2)) as sim:
        sim.run(frames=20)
        os.kill(sim.pids[1], signal.SIGKILL)
        sim.run(frames=20, measures=["pressure"])
        os.kill(sim.pids[0], signal.SIGKILL)
        sim.run(frames=20)
        digest = sim.digest()
    with simulate(gas(500, 0.5, seed=2), method="grid") as sim:
        sim.run(frames=60)
        assert sim.digest() == digest


@pytest.mark.slow
def test_frames_that_a_fast_disc_has_divided_go_back_too():
    def result(sim):
        sim.run(frames=200)
        return sim.substeps, sim.digest()

    def experiment(killing):
        with healing(struck(), workers=2, **settings) as sim, killing(sim):
            assert result(sim) == expected

    settings = {"dt": 0.05, "on_fast": "substep", "contact": "impact"}
    with healing(struck(), workers=1, **settings) as alone:
        expected = result(alone)

    repeat_until_killed(experiment, lambda: random.uniform(0.02, 0.1), most=4)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
def test_emitters_and_exits_go_back_too():
    scene = zoo("emitters absorbing piston gravity", count=30, side=40.0)

    def result(sim):
        sim.run(frames=2000)
        return sim.count, sim.absorbed.sum(), sim.digest()

    def experiment(killing):
        with healing(scene) as sim, killing(sim):
            assert result(sim) == expected

    with healing(scene, workers=1) as alone:
        expected = result(alone)

    repeat_until_killed(experiment, lambda: random.uniform(0.05, 0.2), most=4)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
def test_auto_that_becomes_parallel_on_the_way_heals_as_well():
    """The run begins on one process and has workers only when enough discs have been added."""
    scene = mpsim.Scene(
        width=200, height=200, position=crowd(190, 0.2).position, velocity=crowd(190, 0.2).velocity, radius=0.5,
        emitters=mpsim.Emitter((100, 100), (20, 5), every=10),
    )  # fmt: skip

    def experiment(killing):
        with simulate(scene, method="auto", workers=3, on_worker_death="restart") as sim:
            assert sim.pids == []
            with killing(sim):
                sim.run(frames=6000)
            assert sim.digest() == expected

    expected = digest_after(scene, 6000, method="auto", workers=1)

    repeat_until_killed(experiment, lambda: 0.05, most=3)


@pytest.mark.slow
def test_all_workers_at_once_may_die():
    dead = []

    def kill_all(pids):
        if len(dead) < 6:
            for pid in pids:
                os.kill(pid, signal.SIGKILL)
            dead.extend(pids)

    for attempt in range(6):
        pause = 0.15 * 0.5**attempt
        with healing() as sim, Killer(sim, lambda seconds=pause: seconds, kill_all):
            report = sim.run(frames=FRAMES, measures=MEASURES)
            assert_as_undisturbed(sim, report)
        if dead:
            return
    pytest.fail("nobody has died, which tests nothing")


@pytest.mark.slow
def test_a_death_during_a_snapshot_is_healed(monkeypatch):
    take, taken = Coordinator.snapshot, []

    def kill_and_take(self):
        taken.append(1)
        if len(taken) in (1, 3):
            os.kill(self.solver.pids[0], signal.SIGKILL)
        return take(self)

    monkeypatch.setattr(Coordinator, "snapshot", kill_and_take)
    monkeypatch.setattr(recovery, "SNAPSHOT_SECONDS", 0.005)  # so that there are many, however quick the machine is,
    monkeypatch.setattr(recovery, "SNAPSHOT_FRACTION", 1.0)  # and however slow the first snapshot was
    with healing() as sim:
        report = sim.run(frames=FRAMES, measures=MEASURES)
        assert_as_undisturbed(sim, report)
    assert len(taken) >= 3, "the second death was in the third"


def test_a_stopped_worker_that_is_then_killed_is_replaced():
    """A stopped worker holds everybody up; it is no death until somebody kills it."""
    with healing(workers=2) as sim:
        victim = sim.pids[0]
        os.kill(victim, signal.SIGSTOP)
        timer = threading.Timer(0.7, os.kill, (victim, signal.SIGKILL))
        timer.start()
        started = time.monotonic()
        report = sim.run(frames=FRAMES, measures=MEASURES)
        assert time.monotonic() - started > 0.6
        assert_as_undisturbed(sim, report)


@pytest.mark.slow
def test_a_survivor_that_is_stopped_does_not_keep_the_others_from_going_on(monkeypatch):
    monkeypatch.setattr(pool, "PATIENCE", 0.3)
    with healing() as sim:
        stopped, victim = sim.pids
        os.kill(stopped, signal.SIGSTOP)
        os.kill(victim, signal.SIGKILL)
        report = sim.run(frames=FRAMES, measures=MEASURES)
        assert_as_undisturbed(sim, report)
        assert is_gone(stopped)


@pytest.mark.slow
def test_deaths_without_end_end_the_run(monkeypatch, figures):
    """Each new worker dies in its first frame: no progress, so no snapshot, and no use in trying again."""
    advance = BlockSolver.advance

    def kill_and_advance(self, frames, workers, stop):
        if self.frame >= 10:
            os.kill(self.pids[0], signal.SIGKILL)
        return advance(self, min(frames, 10), workers, stop)

    monkeypatch.setattr(BlockSolver, "advance", kill_and_advance)
    sim = healing(workers=2)
    block = block_name(sim)
    with pytest.raises(mpsim.WorkerDiedError):
        sim.run(frames=FRAMES)
    with pytest.raises(mpsim.errors.ClosedError):
        sim.run(frames=1)
    assert wait_until(lambda: not (SHARED_MEMORY / block).exists(), 2)
    figures.note(
        "R10",
        "parallel on 2",
        "every new worker dies at once",
        "WorkerDiedError",
        f"after {recovery.MOST_DEATHS} attempts",
    )


def test_workers_that_never_get_ready_end_the_run(monkeypatch):
    begin = pool.WorkerPool._await_ready
    with healing(workers=2) as sim:

        def kill_and_wait(self, worker):
            os.kill(self.pids[worker - 1], signal.SIGKILL)
            begin(self, worker)

        monkeypatch.setattr(pool.WorkerPool, "_await_ready", kill_and_wait)
        os.kill(sim.pids[0], signal.SIGKILL)
        with pytest.raises(mpsim.WorkerDiedError, match="start-up"):
            sim.run(frames=FRAMES)
        with pytest.raises(mpsim.errors.ClosedError):
            sim.run(frames=1)


def test_raise_is_the_default_and_raises():
    with simulate(gas(2000, 0.5, seed=1), method="parallel", workers=2) as sim:
        os.kill(sim.pids[0], signal.SIGKILL)
        with pytest.raises(mpsim.WorkerDiedError):
            sim.run(frames=10, measures=["pressure"])
        with pytest.raises(mpsim.errors.ClosedError):
            sim.run(frames=1)


@pytest.mark.slow
def test_a_coordinator_in_a_thread_heals_too():
    found = []

    def work(killing):
        with healing() as sim, killing(sim):
            report = sim.run(frames=FRAMES, measures=MEASURES)
            found.append((sim.digest(), values(report)))

    def experiment(killing):
        thread = threading.Thread(target=work, args=(killing,))
        thread.start()
        thread.join()

    repeat_until_killed(experiment, often, most=3)
    assert set(map(repr, found)) == {repr(undisturbed()[:2])}


@pytest.mark.slow
def test_checkpoints_are_right_when_workers_die_between_them(tmp_path):
    with healing() as sim, Killer(sim, often, most=5):
        report = sim.run(frames=FRAMES, measures=MEASURES, checkpoint=tmp_path / "run", checkpoint_every=600)
        assert_as_undisturbed(sim, report)
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert (sim.frame, sim.digest()) == (FRAMES, undisturbed()[0])


@pytest.mark.slow
@pytest.mark.parametrize("deaths", ["raise", "restart"])
def test_ctrl_c_between_a_death_and_its_report_closes_a_state_that_is_no_state(deaths, monkeypatch):
    """The frame was given up half-way. What lies in the block must not pass for a result, nor for a snapshot.

    A worker may also die behind its last frame, as its command ends: that state is one, and the right one.
    """
    for _ in range(5):
        with simulate(lattice(200, 200), method="parallel", workers=2, on_worker_death=deaths) as sim:
            interrupt_after_death(sim, monkeypatch)
            try:
                frame, digest = sim.frame, sim.digest()
            except mpsim.errors.ClosedError:
                return
        with simulate(lattice(200, 200), method="grid") as undisturbed:
            undisturbed.run(frames=frame)
            assert digest == undisturbed.digest()
    pytest.fail("no worker has died inside a frame, which tests nothing")


def interrupt_after_death(sim, monkeypatch):
    """Run until a worker is killed; Ctrl-C comes before anybody has been told of it."""
    settle = pool.WorkerPool.settle

    def settle_and_interrupt(self):
        settle(self)
        if self._lost is not None:
            monkeypatch.undo()
            raise KeyboardInterrupt

    monkeypatch.setattr(pool.WorkerPool, "settle", settle_and_interrupt)
    with Killer(sim, lambda: 0.2, most=1), pytest.raises(KeyboardInterrupt):
        sim.run(frames=10**6)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_hundred_deaths_at_random_moments_change_nothing(figures):
    deaths, runs, given_up, phases = 0, 0, 0, set()
    while deaths < 100:
        started = time.perf_counter()
        with healing(workers=random.choice([2, 3])) as sim:
            pause = slowed(often, time.perf_counter() - started)
            with Killer(sim, pause) as killer:
                try:
                    report = sim.run(frames=FRAMES, measures=MEASURES)
                except mpsim.WorkerDiedError:  # as it must, where a busy machine has taken no snapshot between so many
                    assert killer.deaths > recovery.MOST_DEATHS
                    given_up += 1
                    continue
                assert_as_undisturbed(sim, report)
        deaths, runs, phases = deaths + killer.deaths, runs + 1, phases | killer.phases
    assert given_up <= runs, f"{given_up} runs were given up, and {runs} healed"
    figures.note(
        "R9",
        "parallel on 2 and 3",
        "workers killed at random moments, many in one run",
        "digest and measures of grid",
        f"the same in {runs} runs with {deaths} deaths, in phases {', '.join(sorted(phases))}",
    )
