"""A worker that dies is named within a second, or replaced so that nothing shows it; a slow one is waited for."""

import functools
import itertools
import logging
import os
import random
import signal
import threading
import time
from contextlib import contextmanager, suppress

import psutil
import pytest
from support.compare import assert_same_bits, values
from support.internals import peek
from support.processes import Script, assert_nothing_left_of, blocks_of, in_another_thread, is_gone, wait_until
from support.scenes import gas, lattice, split
from support.selection import FORKS, long_but
from support.tiles import always_tiled, first_free_place, on_tiles

import mpsim

pytestmark = [pytest.mark.compiled, FORKS]

NOTICED_WITHIN = 1.0  # seconds between a death and the exception that reports it

ROOMY = lattice(9, 9, pitch=4.0)
MORE = lattice(8, 8, pitch=4.0).position + 2.0  # places between them


def begin(scene=None, workers=3, start_method="fork", **settings):
    """A simulation on workers, by fork, which starts them in the shortest time."""
    settings = {"method": "parallel", "workers": workers, "start_method": start_method, **settings}
    return mpsim.Simulation(scene or gas(2000, 0.5, seed=1), **split(settings))


def alone(scene, frames, act=lambda sim: None, **settings):
    """Digest of the same on one process."""
    with mpsim.Simulation(scene, **split({"method": "grid", **settings})) as sim:
        act(sim)
        sim.run(frames=frames - sim.frame)
        return sim.digest()


def kill(*pids):
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@contextmanager
def later(act, seconds=0.1):
    """Call something in another thread, so many seconds from now; the list gets the time when it was done."""
    moments = []

    def acting():
        act()
        moments.append(time.monotonic())

    timer = threading.Timer(seconds, acting)
    timer.start()
    try:
        yield moments
    finally:
        timer.join()


def assert_over(sim, pids):
    """Require that the simulation is closed, its workers gone, and its block removed."""
    assert all(map(is_gone, pids))
    assert wait_until(lambda: not blocks_of(os.getpid()), 2)
    with pytest.raises(mpsim.errors.ClosedError, match="closed after frame"):
        sim.run(frames=1)
    sim.close()


# --- a death that ends the run

DEATHS = {
    "all at once": (lambda pids: kill(*pids), {1, 2}, -9, "signal 9 (SIGKILL)"),
    "by another signal": (lambda pids: os.kill(pids[0], signal.SIGUSR1), {1}, -10, "signal 10 (SIGUSR1)"),
}


@pytest.mark.parametrize("death", DEATHS)
def test_a_death_in_a_run_is_named_within_a_second_and_nothing_is_left(death):
    act, workers, code, words = DEATHS[death]
    sim = begin(lattice(100, 100))
    pids = sim.pids
    with later(lambda: act(pids)) as moments, pytest.raises(mpsim.WorkerDiedError) as caught:
        sim.run(frames=10**6)
    assert time.monotonic() - moments[0] < NOTICED_WITHIN
    error = caught.value
    assert error.worker in workers
    assert (error.exitcode, error.pid) == (code, pids[error.worker - 1])
    for word in (f"worker {error.worker}", str(error.pid), words, f"frame {error.frame}", f"'{error.phase}'"):
        assert word in str(error)
    assert_over(sim, pids)


@pytest.mark.parametrize("then", ["run", "grow"])
def test_a_death_between_runs_is_noticed_by_the_next_call_and_the_state_stays_readable(then):
    sim = begin(ROOMY)
    sim.run(frames=5)
    pids, before = sim.pids, sim.digest()
    kill(pids[1])
    assert wait_until(lambda: is_gone(pids[1]), 5)
    assert sim.digest() == before
    deed = {"run": lambda: sim.run(frames=10**6), "grow": lambda: sim.add(MORE, 0 * MORE)}[then]
    with pytest.raises(mpsim.WorkerDiedError, match="worker 2") as caught:
        deed()
    assert (caught.value.worker, caught.value.frame) == (2, 5)
    assert_over(sim, pids)


def kill_in_phase(sim, worker, phase):
    """Stop the worker again and again until it is found in this phase; kill it there. Returns the frame."""
    pid = sim.pids[worker - 1]
    for attempt in range(3000):
        os.kill(pid, signal.SIGSTOP)
        assert wait_until(lambda: psutil.Process(pid).status() == "stopped", 2)  # a little after the signal
        found, frame = peek(sim, worker)  # nobody else can tell the phase of a worker that has been stopped
        if found == phase:
            kill(pid)
            return frame
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.0005 + attempt % 7 * 0.0003)
    kill(pid)  # or the run would not end
    raise AssertionError(f"worker {worker} was never found in phase {phase!r}")


def kill_at_barrier(sim, worker, other):
    """Hold another worker up, so that this one waits at a barrier for certain; kill it there."""
    victim, held_up = sim.pids[worker - 1], sim.pids[other - 1]
    os.kill(held_up, signal.SIGSTOP)
    before, now = None, peek(sim, worker)
    while now != before:  # on a busy machine it may be long on its way to the barrier
        time.sleep(0.1)
        before, now = now, peek(sim, worker)
    kill(victim)
    assert wait_until(lambda: is_gone(victim), 5)
    with suppress(ProcessLookupError):  # its death was noticed, and all were stopped
        os.kill(held_up, signal.SIGCONT)
    return now[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("phase", "worker"),
    long_but(
        [("move", 1), ("sort", 2), ("even columns", 1), ("odd columns", 2), ("wait", 2)], ("sort", 2), ("wait", 2)
    ),
)
def test_a_death_in_any_phase_is_named_in_full_and_healed(phase, worker):
    scene, deed = lattice(200, 200), kill_in_phase if phase != "wait" else kill_at_barrier
    for heals in ("raise", "restart"):
        sim, found = begin(scene, on_worker_death=heals), []
        pids, other = sim.pids, 3 - worker
        act = lambda: found.append(deed(sim, worker, phase if phase != "wait" else other))  # noqa: B023, E731
        if heals == "raise":
            with later(act), pytest.raises(mpsim.WorkerDiedError) as caught:
                sim.run(frames=10**6)
            error = caught.value
            assert (error.worker, error.exitcode, error.phase) == (worker, -signal.SIGKILL, phase)
            assert error.frame == found[0]
            assert_over(sim, pids)
        else:
            with sim, later(act):
                while not found:
                    sim.run(frames=10)
                sim.run(frames=10)
                assert sim.digest() == alone(scene, sim.frame)


START_UP = """
import multiprocessing, os, signal, threading, time
import mpsim
from support.scenes import lattice

def kill_the_first_worker():
    while not multiprocessing.active_children():
        time.sleep(0.0005)
    os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)

threading.Thread(target=kill_the_first_worker).start()
try:
    mpsim.Simulation(lattice(20, 20), mpsim.Settings(method="parallel", workers=2), start_method="{start}")
except mpsim.WorkerDiedError as error:
    print(error.worker, error.exitcode, error.phase)
"""


@pytest.mark.parametrize("start", long_but(["spawn", "forkserver"], "forkserver"))
def test_a_death_during_start_up_is_named(start):
    with Script(START_UP.format(start=start), warm=start != "spawn") as script:
        outcome = script.finish(30)
        assert (outcome.code, outcome.out, outcome.err) == (0, "1 -9 start-up\n", "")
        assert_nothing_left_of(script.pid)


def test_a_worker_that_raises_hands_over_its_traceback(monkeypatch):
    def broken(*_):
        raise ValueError("the kernels are broken")

    monkeypatch.setattr("mpsim.engine.workers.worker.load_kernels", broken)  # which a damaged installation would do
    with pytest.raises(mpsim.WorkerDiedError, match=r"(?s)ValueError: the kernels are broken") as caught:
        begin(lattice(20, 20))
    assert (caught.value.worker, caught.value.exitcode, caught.value.phase) == (1, 1, "start-up")


# --- a death that is healed

STEPS = {
    "add one": lambda sim: sim.add(MORE[0], (0.5, 0.0)),
    "add many, which moves the workers": lambda sim: sim.add(MORE[1:], 0 * MORE[1:]),
    "kick": lambda sim: sim.kick(range(0, 80, 5), (0.5, 0.25)),
    "change": lambda sim: sim.change(passes=2, dt=0.005),
    "set": lambda sim: sim.set(7, velocity=(1.0, 1.0)),
}


def stepwise(sim, before=lambda sim: None):
    for act in STEPS.values():
        sim.run(frames=5)
        before(sim)
        act(sim)
        before(sim)
    sim.run(frames=5)
    return sim.digest(), sim.count, [change.what for change in sim.journal]


def test_workers_that_die_before_and_after_each_change_are_replaced_and_change_nothing(caplog):
    """One, all at once, or one that was stopped for a while: a line of the log each time."""
    turns = itertools.cycle([lambda pids: kill(pids[0]), lambda pids: kill(*pids), stop_and_kill])

    def hit(sim):
        if sim.pids:
            next(turns)(sim.pids)

    with mpsim.Simulation(ROOMY, mpsim.Settings(method="grid")) as sim:
        expected = stepwise(sim)
    with caplog.at_level(logging.WARNING, "mpsim"), begin(ROOMY, on_worker_death="restart") as sim:
        assert stepwise(sim, hit) == expected
        assert len(sim.pids) == 2
    assert len(caplog.records) >= len(STEPS)
    assert all("on new workers" in record.getMessage() for record in caplog.records)


def stop_and_kill(pids):
    """A stopped worker holds everybody up; it is no death until somebody kills it."""
    os.kill(pids[0], signal.SIGSTOP)
    threading.Timer(0.3, kill, (pids[0],)).start()


NAMES = ("pressure", "collision_rate", "kinetic_energy")


class Hit:
    """An observer that kills a worker at some frames, once at each."""

    every = 20

    def __init__(self, frames):
        self.left = set(frames)

    def observe(self, sim, collisions):
        if sim.frame in self.left:
            self.left.remove(sim.frame)
            kill(sim.pids[0])


def test_a_run_that_heals_goes_back_with_all_that_it_writes_in_any_thread(tmp_path):
    """Trajectory, checkpoints, progress, measures and report are those of a run in which nobody dies."""
    scene, steps = gas(60, 0.4), []
    with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as sim, mpsim.Trajectory.write(tmp_path / "a.xyz") as o:
        measures = values(sim.run(frames=60, observe=o, measures=NAMES, start=0.1))
        expected = sim.digest()

    def work():
        with begin(scene, on_worker_death="restart") as sim, mpsim.Trajectory.write(tmp_path / "b.xyz") as out:
            kept = {"checkpoint": tmp_path / "run", "checkpoint_every": 30}
            progress = lambda done, of: steps.append(done)  # noqa: E731
            kept |= {"measures": NAMES, "start": 0.1, "progress": progress}
            report = sim.run(frames=60, observe=[out, Hit([20, 40])], **kept)
            return [sim.digest(), sim.frame, values(report), bool((report.frame_seconds > 0).all())]

    assert in_another_thread(work) == [expected, 60, measures, True]
    assert (tmp_path / "b.xyz").read_bytes() == (tmp_path / "a.xyz").read_bytes()
    assert steps[-1] == 60
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert (sim.frame, sim.digest()) == (60, expected)
    with pytest.raises(mpsim.WorkerDiedError), begin(scene) as sim:  # the control: raise is the default
        sim.run(frames=60, observe=Hit([20]))


def test_deaths_without_end_end_the_run():
    """No progress, so no use in trying again."""
    sim, over = begin(lattice(100, 100), workers=2, on_worker_death="restart"), threading.Event()

    def kill_all_that_come():
        while not over.is_set():
            with suppress(ProcessLookupError, mpsim.errors.ClosedError):
                kill(*[child.pid for child in psutil.Process().children() if child.pid in sim.pids])

    thread = threading.Thread(target=kill_all_that_come)
    thread.start()
    try:
        with pytest.raises(mpsim.WorkerDiedError):
            sim.run(frames=10**6)
    finally:
        over.set()
        thread.join()
    assert_over(sim, [])


@pytest.mark.parametrize("deaths", ["raise", "restart"])
def test_ctrl_c_beside_a_death_leaves_a_state_that_is_one_or_none(deaths):
    """The frame may be given up half-way. What lies in the block then must not pass for a result, nor a snapshot."""

    def hit(sim):
        kill(sim.pids[0])
        os.kill(os.getpid(), signal.SIGINT)

    for attempt in range(2):
        with begin(lattice(60, 60), workers=2, on_worker_death=deaths) as sim:
            with (
                later(lambda: hit(sim), 0.03 + 0.0274 * attempt),
                pytest.raises((KeyboardInterrupt, mpsim.WorkerDiedError)),
            ):
                run_until_interrupted(sim)
            with suppress(mpsim.errors.ClosedError):
                assert sim.digest() == alone(lattice(60, 60), sim.frame)


def run_until_interrupted(sim):
    """Ctrl-C may come a little after the error of the death."""
    try:
        sim.run(frames=10**6)
    except mpsim.WorkerDiedError:
        time.sleep(5)


# --- at random moments


class Killer(threading.Thread):
    """Thread that kills one of the present workers every now and then, until told to stop; counts the deaths."""

    def __init__(self, sim, pause, most):
        super().__init__(daemon=True)
        self.deaths = 0
        self._sim, self._pause, self._most = sim, pause, most
        self._end = threading.Event()

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *exception):
        self._end.set()
        self.join()

    def run(self):
        while self.deaths < self._most and not self._end.wait(self._pause()):
            try:
                if pids := [pid for pid in self._sim.pids if not is_gone(pid)]:
                    os.kill(random.choice(pids), signal.SIGKILL)
                    self.deaths += 1
            except (ProcessLookupError, TypeError, ValueError, LookupError, mpsim.errors.ClosedError):
                continue  # it is being replaced at this moment


@pytest.mark.slow
def test_a_survivor_that_is_stopped_does_not_keep_the_others_from_going_on():
    with begin(on_worker_death="restart") as sim:
        stopped, victim = sim.pids
        os.kill(stopped, signal.SIGSTOP)
        kill(victim)
        sim.run(frames=100)
        assert sim.digest() == alone(gas(2000, 0.5, seed=1), 100)
        assert is_gone(stopped)


# --- slow ones


def cpu(pids):
    return sum(sum(psutil.Process(pid).cpu_times()[:2]) for pid in pids)


def test_a_slow_worker_is_waited_for_at_little_cost():
    """And comes at once when it is called, as it is kept off the caller's core. It has its cores back then."""
    scene, every = lattice(40, 40), os.sched_getaffinity(0)
    with begin(scene, workers=2) as sim:
        sim.run(frames=1)
        os.kill(sim.pids[0], signal.SIGSTOP)
        with later(lambda: os.kill(sim.pids[0], signal.SIGCONT), 1.2):
            spent, begun = time.process_time() + cpu(sim.pids), time.monotonic()
            report = sim.run(frames=99)
            spent = time.process_time() + cpu(sim.pids) - spent
        assert time.monotonic() - begun > 0.9, "the worker was not stopped, which tests nothing"
        assert spent < 0.9, f"{spent:.2f} s of processor time during 1.2 s of waiting"
        longest = report.frame_seconds.argmax()
        assert report.phase_seconds["wait"][longest, 0] > 0.9, "the time lost must show as waiting"
        for pause, cores in ((0, every), (0.001, every), (0.003, {min(every)}), (0.01, every), (0.1, every)):
            time.sleep(pause)
            os.sched_setaffinity(sim.pids[0], cores)
            sim.run(frames=2)
            assert wait_until(lambda cores=cores: os.sched_getaffinity(sim.pids[0]) == cores, 2)
        assert sim.digest() == alone(scene, 110)


@pytest.mark.slow
def test_an_idle_simulation_burns_no_processor():
    """Neither its workers nor its own process. The control: a run."""
    with begin(lattice(40, 40)) as sim:
        spent = []
        for act in (lambda: time.sleep(2), lambda: sim.run(frames=1000)):
            sim.run(frames=1)
            time.sleep(0.2)  # until workers have gone to sleep
            before = time.process_time() + cpu(sim.pids)
            act()
            spent.append(time.process_time() + cpu(sim.pids) - before)
        idle, busy = spent
        assert idle < 0.05 < busy, f"seconds of processor time: {idle:.2f} in two seconds, {busy:.2f} in a run"


def test_workers_that_share_one_core_are_slow_and_right():
    """A barrier among three on one core means three changes of process; it must not mean three time slices (4 ms)."""
    cores, found = os.sched_getaffinity(0), []
    os.sched_setaffinity(0, {min(cores)})
    try:
        for settings in ({"method": "grid"}, {"method": "parallel"}):
            with begin(lattice(40, 40), **settings) as sim:
                sim.run(frames=20)
                spent = time.process_time() + cpu(sim.pids)
                sim.run(frames=300)
                found += [time.process_time() + cpu(sim.pids) - spent, sim.digest()]
    finally:
        os.sched_setaffinity(0, cores)
    one, digest, shared, same = found
    assert digest == same
    assert shared / one < 60, f"frames cost {shared / one:.0f} times as much; time slices at barriers would be 200"


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_worker_stopped_for_good_ends_the_run_and_is_ended_too():
    sim = begin(lattice(20, 20))
    pids = sim.pids
    os.kill(pids[1], signal.SIGSTOP)
    with pytest.raises(
        mpsim.errors.WorkerStalledError, match=r"worker 2 has not reached a barrier within 120 s.*start"
    ):
        sim.run(frames=10)
    assert_over(sim, pids)


# --- workers of the exact solver: no bit changes, and nothing is left

COUNT, FRAMES, DT = 3000, 400, 0.125


def tiled(workers=3, dt=DT, **settings):
    """A simulation on workers; by fork, which starts them in the shortest time."""
    return on_tiles(gas(COUNT, 0.4, seed=2), (2, 2), workers, dt=dt, start_method="fork", **settings)


@functools.cache
def undisturbed(frames=FRAMES, dt=DT):
    """State, measures and collisions of the run of one process in which nobody dies."""
    with on_tiles(gas(COUNT, 0.4, seed=2), (1, 1), dt=dt) as sim:
        report = sim.run(frames=frames, measures=NAMES)
        return sim.state, values(report), report.collisions


@pytest.mark.slow
@pytest.mark.timeout(300)  # it compiles for all of them
def test_a_worker_that_dies_in_a_window_or_between_runs_ends_the_run_by_default():
    with tiled() as sim, Killer(sim, lambda: 0.1, most=1) as killer:
        with pytest.raises(mpsim.WorkerDiedError, match="SIGKILL"):
            sim.run(frames=10**9)
        with pytest.raises(mpsim.errors.ClosedError):
            sim.run(frames=1)
    assert killer.deaths == 1
    with tiled() as sim:
        sim.run(frames=3)
        os.kill(sim.pids[1], signal.SIGKILL)
        with pytest.raises(mpsim.WorkerDiedError):
            sim.run(frames=FRAMES)


@pytest.mark.slow
def test_workers_that_die_at_random_moments_are_replaced_and_change_nothing():
    """A quick machine may be done before the first pause is over: each attempt waits half as long as the one before."""
    expected, measures, collisions = undisturbed()
    for attempt in range(6):
        pause = lambda longest=0.15 * 0.5**attempt: random.uniform(longest / 8, longest)  # noqa: E731
        with tiled(on_worker_death="restart") as sim, Killer(sim, pause, most=4) as killer, always_tiled(2, 2):
            report = sim.run(frames=FRAMES, measures=NAMES)
            assert_same_bits(sim.state, expected, "healed")
            assert len(sim.pids) == 2
            assert (values(report), report.collisions, sim.frame) == (measures, collisions, FRAMES)
        if killer.deaths >= 2:
            return
    pytest.fail("hardly anybody has died, which tests nothing")


@pytest.mark.slow
def test_workers_stay_the_same_when_discs_are_added_or_changed_and_a_death_before_it_is_healed():
    """Starting others takes a second or two, and an emitter adds discs in frame after frame."""
    states = []
    for workers in (1, 3):
        with tiled(workers, on_worker_death="restart") as sim, always_tiled(2, 2):
            sim.run(frames=2)
            pids = sim.pids
            sim.add([first_free_place(sim.state)], [[1.0, 2.0]])
            sim.run(frames=2)
            sim.kick(0, (1.0, 0.0))
            sim.run(frames=2)
            assert sim.pids == pids
            free = first_free_place(sim.state)
            for pid in sim.pids[:1]:
                os.kill(pid, signal.SIGKILL)
            sim.add([free], [[1.0, 2.0]])
            sim.run(frames=20)
            states.append(sim.state)
    assert_same_bits(states[1], states[0], "grown after a death")
    assert len(states[0].position) == COUNT + 2


@pytest.mark.slow
@pytest.mark.parametrize("dt", long_but([0.01, 20.0], 20.0))
def test_a_run_that_is_interrupted_between_short_frames_or_inside_long_ones_goes_on_with_the_same_bits(dt, tmp_path):
    with tiled(2, dt) as sim:
        pids = sim.pids
        for attempt in range(4):
            threading.Timer(0.03 + attempt * 0.0137, os.kill, (os.getpid(), signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                sim.run(frames=10**9)
            frames = sim.frame
            assert frames * dt <= sim.time <= (frames + 1) * dt
            assert sim.state.position.shape == (COUNT, 2)
            sim.save(tmp_path / "run")
        sim.run(frames=2)
        assert sim.pids == pids
        state = sim.state
    assert_same_bits(state, undisturbed(frames + 2, dt)[0], f"interrupted four times, last in frame {frames}")
