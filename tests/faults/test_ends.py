"""However a simulation or its program ends, nothing is left and nothing is said; `mpsim clean` removes the rest."""

import fcntl
import gc
import os
import signal
import stat
import subprocess
import time

import psutil
import pytest
from support.commands import mpsim_command
from support.processes import (
    SHARED_MEMORY,
    Script,
    assert_clean,
    assert_nothing_left_of,
    blocks_of,
    is_gone,
    run_script,
    wait_until,
)
from support.scenes import lattice, simulate
from support.selection import FORKS, long_but

import mpsim

pytestmark = [pytest.mark.compiled, FORKS]


def begin(method="parallel", workers=3, scene=None, start_method="fork"):
    return simulate(scene or lattice(20, 20), method=method, workers=workers, start_method=start_method)


# --- a simulation


@pytest.mark.parametrize(("method", "workers"), [("grid", 1), ("parallel", 3)])
def test_a_simulation_that_is_closed_left_or_dropped_leaves_no_worker_and_no_block(method, workers):
    def fail(*_):
        raise ZeroDivisionError

    def leave(sim):
        with sim:
            sim.run(frames=100, progress=fail)

    def close_inside(sim):
        sim.run(frames=10**6, progress=lambda *_: sim.close())

    for deed, error in (
        (lambda sim: [sim.close() for _ in range(3)], None),
        (leave, ZeroDivisionError),
        (close_inside, mpsim.errors.ClosedError),
    ):
        sim = begin(method, workers)
        sim.run(frames=2)
        pids, (block,) = sim.pids, blocks_of(os.getpid())
        path = SHARED_MEMORY / block
        status = path.stat()
        assert (stat.S_IMODE(status.st_mode), status.st_uid) == (0o600, os.getuid()), "it is its user's alone"
        with path.open("rb") as file, pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        assert len(pids) == workers - 1
        if error is None:
            deed(sim)
        else:
            with pytest.raises(error):
                deed(sim)
        assert all(map(is_gone, pids))
        assert not path.exists()
        with pytest.raises(mpsim.errors.ClosedError, match="closed after frame"):
            sim.state  # noqa: B018
    sim = begin(method, workers)
    pids = sim.pids
    circle = [sim]  # only the collector finds it
    circle.append(circle)
    del sim, circle
    gc.collect()
    assert wait_until(lambda: all(map(is_gone, pids)) and not blocks_of(os.getpid()), 2)


@pytest.mark.parametrize("on_worker_death", ["restart", "raise"])
def test_a_worker_that_dies_after_the_last_frame_does_not_lose_the_report(on_worker_death):
    def kill(done, of):
        os.kill(sim.pids[0], signal.SIGKILL)
        assert wait_until(lambda: is_gone(sim.pids[0]), 20)

    with simulate(lattice(9, 9), method="parallel", workers=2, on_worker_death=on_worker_death) as sim:
        report = sim.run(frames=1, progress=kill)
        assert report.frames == 1
        assert report.memory_bytes[0] > 0 == report.memory_bytes[1]


# --- a program

ENDINGS = {
    "by sys.exit": ("fork", "import sys; state, report = sim.state, sim.run(frames=1); sys.exit(3)", 3),
    "by an error": ("fork", "1 / 0", 1),
    "without closing": ("forkserver", "", 0),
}


@pytest.mark.slow
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_program_may_end_without_closing_and_without_a_main_guard(ending):
    start, text, code = ENDINGS[ending]
    outcome = run_script(f"""
print("once")
import mpsim
from support.scenes import lattice, simulate
sim = simulate(lattice(20, 20), method="parallel", workers=3, start_method="{start}")
other = simulate(lattice(20, 20), method="grid")
sim.run(frames=2)
{text}
""")
    assert (outcome.code, outcome.out) == (code, "once\n"), outcome.err
    if code == 1:
        assert outcome.err.count("Traceback") == 1
        assert outcome.err.rstrip().endswith("ZeroDivisionError: division by zero"), outcome.err
    else:
        assert outcome.err == ""


DAEMONS = """
import os, random, sys, tempfile, threading, time
import mpsim
from support.scenes import lattice, simulate

class Looking:
    every = 1

    def observe(self, sim, collisions):
        sim.state, sim.radii, sim.pids

def run_new():
    with simulate(lattice(12, 12), method="{method}", workers=2) as new:
        new.run(frames=1)

def end(wait, act):
    '''Leave a thread behind that uses a simulation, and end soon.'''
    place, sim, begun = tempfile.mkdtemp() + "/run", simulate(lattice(12, 12), method="{method}", workers=2), []
    act = dict(
        run=lambda: sim.run(frames=1),
        save=lambda: sim.save(place),
        look=lambda: sim.run(frames=2, observe=Looking(), progress=lambda *_: sim.digest()),
        new=run_new,
        drop=lambda: simulate(lattice(12, 12), method="{method}", workers=2),
    )[act]
    threading.Thread(target=lambda: [begun.append(act()) for _ in iter(int, 1)], daemon=True).start()
    while not begun:
        time.sleep(0.001)
    sys.setswitchinterval(1e-5)
    time.sleep(wait)

with simulate(lattice(12, 12), method="{method}", workers=1) as warm:
    warm.run(frames=2)
for act in {acts}:
    for number in range({rounds}):
        if not (child := os.fork()):
            end(random.Random(number).uniform(0.001, 0.03), act)
            sys.exit()
        assert os.waitpid(child, 0)[1] == 0, "it was ended by a signal, or failed"
        assert not [name for name in os.listdir("/dev/shm") if name.startswith(f"mpsim-{{child}}-")], "a block is left"
"""


@pytest.mark.timeout(900)
@pytest.mark.parametrize("method", long_but(["grid", "event", "parallel"], "grid"))
def test_nothing_is_said_whatever_a_daemon_thread_is_doing_at_the_end(method, request):
    """A `ClosedError` was printed now and then, and a thread that ran without a break kept the program from ending."""
    acts, rounds = ["run", "save", "look", "new", "drop"], 20 if request.config.getoption("--long") else 2
    text = DAEMONS.format(method=method, acts=acts, rounds=rounds)
    assert_clean(run_script(text, bound=60 + 30 * rounds, warm=True))


LEFT_OPEN = """
import multiprocessing, sys
from support.scenes import lattice, simulate

def leave_open():
    sim = simulate(lattice(12, 12), method="parallel", workers=2)
    sim.run(frames=2)
    sys.left = sim  # which nobody closes

if __name__ == "__main__":
    for start in ("fork", "forkserver"):
        process = multiprocessing.get_context(start).Process(target=leave_open)
        process.start()
        process.join(60)
        print(process.exitcode)
        process.kill()
"""


@pytest.mark.slow
def test_a_process_of_multiprocessing_closes_what_it_leaves_open():
    """It calls nothing that is registered with atexit: it left the block, or waited for its workers for ever."""
    outcome = run_script(LEFT_OPEN, flags=("-W", "error", "-W", "ignore::DeprecationWarning"))
    assert_clean(outcome)
    assert outcome.out.split() == ["0"] * 2


# --- a kill

HEAD = """
import _posixshmem, json, os, signal, sys, time
import mpsim
from support.scenes import lattice, simulate

def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)

make = _posixshmem.shm_open

def make_and_die(*given, **named):
    make(*given, **named)
    print(len([name for name in os.listdir("/dev/shm") if name.startswith(f"mpsim-{os.getpid()}-")]))
    die()

class Look:
    every = 1
    observe = die

begin = lambda: simulate(lattice(20, 20), method="parallel", workers=3, start_method=START)
"""
PHASES = {
    "as the block is born": "_posixshmem.shm_open = make_and_die; begin()",
    "while workers start": "import multiprocessing.process as p; p.BaseProcess.start = die; begin()",
    "idle": "sim = begin(); print(*sim.pids); die()",
    "in a run": "sim = begin(); print(*sim.pids); sim.run(frames=10**9)",
    "in an observer": "sim = begin(); print(*sim.pids); sim.run(frames=9, observe=Look())",
    "while a checkpoint is written": "sim = begin(); print(*sim.pids); os.fsync = die; sim.save('run')",
    "as discs are added": "sim = begin(); print(*sim.pids); _posixshmem.shm_open = make_and_die;"
    " more = lattice(20, 20); sim.add(more.position, more.velocity)",
    "as it is closed": "sim = begin(); print(*sim.pids); _posixshmem.shm_unlink = die; sim.close()",
    "at the exit": "import atexit; sim = begin(); print(*sim.pids); atexit.register(die)",
}
"""What is done, by which the coordinator is killed, or in the midst of which."""

STARTS = [(phase, "fork") for phase in PHASES] + [("in a run", "forkserver")]
FEW = [(phase, "fork") for phase in ("as the block is born", "in a run", "as it is closed", "as discs are added")]


@pytest.mark.timeout(60)
@pytest.mark.parametrize(("phase", "start"), long_but(STARTS, *FEW))
def test_a_killed_coordinator_leaves_no_worker_and_no_block_whatever_it_was_doing(phase, start):
    """Workers end at once; the block goes with the last process that holds the tracker's pipe."""
    text = "import warnings\nwarnings.simplefilter('ignore')\n" + HEAD.replace("START", repr(start)) + PHASES[phase]
    with Script(text, warm=start == "fork") as script:
        pids = []
        if "in a run" in phase:
            pids = list(map(int, script.line().split()))
            time.sleep(0.2)
            assert len(blocks_of(script.pid)) == 1, "the control: there is one"
            assert not any(map(is_gone, pids))
            script.send(signal.SIGKILL)
        assert script.finish(30).code == -signal.SIGKILL
        if phase != "in a run" and phase != "while workers start":
            pids = list(map(int, script.line().split()))
            assert pids, "the control: there were workers, or one block"
        pids = [] if "born" in phase else pids
        assert wait_until(lambda: all(map(is_gone, pids)), 2), "workers outlive the coordinator"
        assert wait_until(lambda: not blocks_of(script.pid), 10), "the block outlives everybody"
        assert_nothing_left_of(script.pid)


# --- what nobody has removed


def leave(pid, token="0123abcd", age=0.0, size=5000):
    """A file that looks like a block, made so many seconds ago."""
    path = SHARED_MEMORY / f"mpsim-{pid}-{token}"
    path.write_bytes(bytes(size))
    moment = time.time() - age
    os.utime(path, (moment, moment))
    return path


@pytest.fixture
def dead_pid():
    """Number of a process that has ended."""
    process = subprocess.Popen(["true"])
    process.wait()
    return process.pid


def test_mpsim_clean_removes_blocks_of_dead_owners_alone(dead_pid):
    """Not those of the living, of other programs, or that somebody has locked, as another container does."""
    born = time.time() - psutil.Process().create_time()
    zombie = os.fork()
    if zombie == 0:
        os._exit(0)
    stale = [
        leave(dead_pid),
        leave(dead_pid, "00000001"),
        leave(os.getpid(), "00000002", age=born + 3600),  # older than the process that has its owner's number
        leave(zombie),
    ]
    kept = [
        leave(os.getpid()),
        leave(os.getpid(), "00000003", age=born + 1),  # within the precision of clocks, the doubt is for the block
        leave(dead_pid, "0123abcd.bak"),
        leave(dead_pid, "short"),
        leave(1),
    ]
    link = SHARED_MEMORY / f"mpsim-{dead_pid}-00000004"
    link.symlink_to(kept[0])
    try:
        with simulate(lattice(3, 3), method="grid") as sim, stale[1].open("rb+") as file:
            assert wait_until(lambda: psutil.Process(zombie).status() == psutil.STATUS_ZOMBIE, 5)
            fcntl.flock(file, fcntl.LOCK_EX)
            shown = mpsim_command("clean", "--dry-run").output
            assert f"{stale[0].name}  5,000 bytes, of process {dead_pid}\n" in shown
            assert "would be removed" in shown
            assert all(path.exists() for path in stale)
            assert f"of process {dead_pid}" in mpsim_command("clean").output
            assert [path.exists() for path in stale] == [False, True, False, False]
            assert all(path.exists() for path in kept)
            assert link.is_symlink()
            assert sim.run(frames=2).frames == 2, "one that lives"
        assert " removed, " in mpsim_command("clean").output
        assert not stale[1].exists()
    finally:
        os.waitpid(zombie, 0)
        for path in (*stale, *kept, link):
            path.unlink(missing_ok=True)
