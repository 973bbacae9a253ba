"""A program may end while daemon threads use simulations: nothing is left, nothing is said, and it ends at once."""

import pytest
from support.processes import assert_clean, run_script
from support.selection import long_but

ROUNDS = """
import os, random, sys, tempfile, threading, time
import mpsim
from support.scenes import lattice, simulate

class Looking:
    every = 1

    def look(self, sim, collisions):
        sim.state, sim.radii, sim.pids

def run_new():
    with simulate(lattice(12, 12), method="{method}", workers=2) as new:
        new.run(frames=1)

def end(wait):
    '''Leave a thread behind that uses a simulation, and end soon.'''
    place, sim, begun = tempfile.mkdtemp() + "/run", simulate(lattice(12, 12), method="{method}", workers=2), []
    act = dict(
        run=lambda: sim.run(frames=1),
        save=lambda: sim.save(place),
        look=lambda: sim.run(frames=2, measures=["temperature"], observe=Looking(), progress=lambda *_: sim.digest()),
        new=run_new,
        drop=lambda: simulate(lattice(12, 12), method="{method}", workers=2),
    )["{act}"]
    threading.Thread(target=lambda: [begun.append(act()) for _ in iter(int, 1)], daemon=True).start()
    while not begun:
        time.sleep(0.001)
    sys.setswitchinterval(1e-5)
    time.sleep(wait)

with simulate(lattice(12, 12), method="{method}", workers=1) as warm:
    warm.run(frames=2, measures=["temperature"])
for number in range({rounds}):
    if not (child := os.fork()):
        end(random.Random(number).uniform(0.001, 0.03))
        sys.exit()
    assert os.waitpid(child, 0)[1] == 0, "it was ended by a signal, or failed"
    assert not [name for name in os.listdir("/dev/shm") if name.startswith(f"mpsim-{{child}}-")], "a block is left"
"""


@pytest.mark.timeout(600)
@pytest.mark.parametrize("act", long_but(["run", "save", "look", "new", "drop"], "save"))
@pytest.mark.parametrize("method", long_but(["grid", "event", "parallel"], "grid"))
def test_nothing_is_said_whatever_a_daemon_thread_is_doing(method, act, request):
    """A `ClosedError` was printed now and then, and a thread that ran without a break kept the program from ending."""
    rounds = 60 if request.config.getoption("--long") else 3
    outcome = run_script(ROUNDS.format(method=method, act=act, rounds=rounds), bound=60 + 6 * rounds, warm=True)
    assert_clean(outcome)
    assert outcome.err == ""


def test_the_end_of_a_program_does_not_wait_until_a_thread_that_always_runs_lets_it_through():
    """It took the lock again and again, and the program ended after half a minute."""
    outcome = run_script(
        """
        import atexit, sys, threading, time

        began = []
        atexit.register(lambda: print(time.perf_counter() - began[0] < 5))  # runs after that of mpsim
        from support.scenes import lattice, simulate

        sim, begun = simulate(lattice(12, 12), method="grid"), threading.Event()
        threading.Thread(target=lambda: [sim.run(frames=1) and begun.set() for _ in iter(int, 1)], daemon=True).start()
        begun.wait()
        time.sleep(0.2)
        began.append(time.perf_counter())
        """
    )
    assert_clean(outcome)
    assert outcome.out == "True\n"


LEFT_OPEN = """
import multiprocessing, sys
from support.scenes import lattice, simulate

def leave_open():
    sim = simulate(lattice(12, 12), method="{method}", workers=2)
    sim.run(frames=2)
    sys.left = sim  # which nobody closes

if __name__ == "__main__":
    process = multiprocessing.get_context("{start}").Process(target=leave_open)
    process.start()
    process.join(60)
    print(process.exitcode)
    process.kill()
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", long_but(["grid", "parallel"], "parallel"))
@pytest.mark.parametrize("start", long_but(["fork", "spawn", "forkserver"], "fork"))
def test_a_process_of_multiprocessing_closes_what_it_leaves_open(start, method):
    """It calls nothing that is registered with atexit: it left the block, or waited for its workers for ever."""
    outcome = run_script(LEFT_OPEN.format(start=start, method=method))
    assert_clean(outcome)
    assert outcome.out.split() == ["0"]


def test_the_end_of_a_program_waits_for_no_thread_that_it_has_stopped():
    """The end of a pool joined the thread of its callbacks, which had stopped inside a run for good."""
    script = """
        import multiprocessing, threading
        from support.scenes import lattice, simulate
        sim, begun = simulate(lattice(12, 12), method="grid"), threading.Event()
        callback = lambda _: sim.run(frames=2000, progress=lambda *_: begun.set())
        pool = multiprocessing.get_context("fork").Pool(1)
        pool.apply_async(int, callback=callback)
        begun.wait()
    """
    outcome = run_script(script, flags=())  # else the pool complains that nobody has closed it
    assert_clean(outcome)
