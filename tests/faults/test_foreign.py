"""Foreign processes that attach to the block, forks of the coordinator, and other simulations do no harm."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.internals import block_name
from support.processes import SHARED_MEMORY, assert_clean, run_script
from support.scenes import lattice, simulate, state_after
from support.selection import long_but

ATTACH = """
import os, sys
from multiprocessing.shared_memory import SharedMemory
memory = SharedMemory(sys.argv[1])
print(memory.size, flush=True)
{then}
"""

ENDINGS = {
    "closes and exits": "memory.close()",
    "crashes": "os.abort()",
    "is killed": "os.kill(os.getpid(), 9)",
}


@pytest.mark.parametrize("ending", long_but(ENDINGS, "closes and exits"))
def test_a_foreign_process_that_attached_to_the_block_and_ends_does_no_harm(ending):
    """Before Python 3.13 its resource tracker removes the block's name as it exits, thinking it a leak of its own.

    The mapping itself lives on in coordinator and workers, so the run must go on, and end without an error.
    """
    scene = lattice(30, 30)
    with simulate(scene, method="parallel", workers=3) as sim:
        sim.run(frames=10)
        script = ATTACH.format(then=ENDINGS[ending])
        command = [sys.executable, "-c", script, block_name(sim)]
        foreign = subprocess.run(command, capture_output=True, timeout=30, check=False)
        assert int(foreign.stdout) > 0, foreign.stderr
        time.sleep(0.3)
        sim.run(frames=10)
        assert_same_bits(sim.state, state_after(scene, 20, method="grid"), f"a foreign process {ending}")
        name = block_name(sim)
    assert not (SHARED_MEMORY / name).exists()


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of a box that is too full
def test_a_simulation_whose_name_a_foreign_process_removed_can_still_grow():
    scene, more = lattice(8, 8), lattice(16, 16)
    with simulate(scene, method="parallel", workers=2) as sim:
        sim.run(frames=2)
        (SHARED_MEMORY / block_name(sim)).unlink()
        sim.add(np.clip(more.position[:100], 0.5, 8.5), more.velocity[:100])
        sim.run(frames=2)
        assert sim.count == 164


@pytest.mark.slow
def test_a_removed_name_makes_no_noise_at_the_end():
    outcome = run_script("""
    import os
    from support.internals import block_name
    from support.scenes import lattice, simulate

    for method in ("grid", "parallel"):
        with simulate(lattice(20, 20), method=method, workers=2) as sim:
            sim.run(frames=2)
            os.unlink(f"/dev/shm/{block_name(sim)}")
            sim.run(frames=2)
    """)
    assert_clean(outcome)


FORKS = {
    "leaves": "leave()",
    "closes its copy and drops it": "sim.close(); del sim; gc.collect(); leave()",
}


@pytest.mark.parametrize("fork", long_but(FORKS, "closes its copy and drops it"))
def test_a_fork_of_the_coordinator_takes_nothing_away(fork):
    outcome = run_script(
        f"""
    import gc, os
    from support.scenes import lattice, simulate

    def leave():
        os._exit(0)

    with simulate(lattice(20, 20), method="parallel", workers=2) as sim:
        sim.run(frames=2)
        child = os.fork()
        if child == 0:
            {FORKS[fork]}
        assert os.waitpid(child, 0)[1] == 0
        sim.run(frames=2)
        print(sim.frame)
    """,
        warm=True,
    )
    assert_clean(outcome)
    assert outcome.out == "4\n"


def test_a_child_process_of_the_user_takes_nothing_away():
    outcome = run_script(
        """
    import multiprocessing
    from support.scenes import lattice, simulate

    with simulate(lattice(20, 20), method="parallel", workers=2) as sim:
        sim.run(frames=2)
        child = multiprocessing.get_context("fork").Process(target=print, args=("child",))
        child.start()
        child.join()
        sim.run(frames=2)
        print(sim.frame)
    """,
        warm=True,
    )
    assert_clean(outcome)
    assert outcome.out == "child\n4\n"


@pytest.mark.slow
def test_a_worker_pool_of_somebody_else_can_run_simulations():
    outcome = run_script("""
    import multiprocessing
    from support.scenes import digest_after, lattice

    def work(seed):
        return digest_after(lattice(12, 12), 20, method="parallel", workers=2)

    def work_of_a_child(connection):
        connection.send(work(0))

    if __name__ == "__main__":
        expected = digest_after(lattice(12, 12), 20, method="grid")
        with multiprocessing.get_context("fork").Pool(2) as pool:
            print([digest == expected for digest in pool.map(work, range(4))])
        ours, theirs = multiprocessing.Pipe()
        child = multiprocessing.get_context("spawn").Process(target=work_of_a_child, args=(theirs,))
        child.start()
        print(ours.recv() == expected)
        child.join()
    """)
    assert_clean(outcome)
    assert outcome.out == "[True, True, True, True]\nTrue\n"


def test_a_daemonic_process_runs_on_one_worker_and_logs_it():
    outcome = run_script(
        """
    import logging, multiprocessing
    from support.scenes import digest_after, lattice, simulate

    def work():
        logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s", force=True)
        with simulate(lattice(20, 20), method="parallel", workers=3) as sim:
            report = sim.run(frames=20)
            print(report.method, report.workers, sim.digest(), sim.pids)

    print(digest_after(lattice(20, 20), 20, method="grid"))
    child = multiprocessing.get_context("fork").Process(target=work, daemon=True)
    child.start()
    child.join()
    """,
        warm=True,
    )
    digest, line = outcome.out.splitlines()
    assert line == f"parallel 1 {digest} []"
    assert outcome.err.count("\n") == 1, outcome.err
    assert "daemonic" in outcome.err


@pytest.mark.slow
def test_a_simulation_runs_in_a_thread_that_is_not_the_main_one():
    outcome = run_script(
        """
    import threading
    from support.scenes import digest_after, lattice

    def work(results):
        results.append(digest_after(lattice(20, 20), 20, method="parallel", workers=2))

    results = []
    threads = [threading.Thread(target=work, args=(results,)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(results == [digest_after(lattice(20, 20), 20, method="grid")] * 3)
    """,
        warm=True,
    )
    assert_clean(outcome)
    assert outcome.out == "True\n"


def test_the_signal_mask_and_handlers_of_the_user_stay_as_they_were():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD)]
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with simulate(lattice(10, 10), method="parallel", workers=2) as sim:
        sim.run(frames=2)
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == mask
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD)] == before
    assert os.getpid() > 0
