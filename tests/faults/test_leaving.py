"""However a simulation or its program ends, nothing is left and nothing is said."""

import gc
import os
import signal

import psutil
import pytest
from support.internals import block_name
from support.processes import SHARED_MEMORY, assert_clean, blocks_of, is_gone, run_script, wait_until
from support.scenes import lattice, simulate
from support.selection import long_but

import mpsim

METHODS = [("grid", 1), ("parallel", 3)]


@pytest.mark.parametrize(("method", "workers"), METHODS)
def test_close_stops_the_workers_and_removes_the_block(method, workers):
    sim = simulate(lattice(20, 20), method=method, workers=workers)
    sim.run(frames=2)
    pids, block = sim.pids, SHARED_MEMORY / block_name(sim)
    assert block.exists()
    assert len(pids) == workers - 1
    assert block.name.startswith(f"mpsim-{os.getpid()}-")
    for _ in range(3):
        sim.close()
    assert all(is_gone(pid) for pid in pids)
    assert not block.exists()


def fail_inside(seen, method, workers):
    with simulate(lattice(9, 9), method=method, workers=workers) as sim:
        seen.append((sim, sim.pids, block_name(sim)))
        sim.run(frames=2)
        raise ZeroDivisionError


@pytest.mark.slow
@pytest.mark.parametrize(("method", "workers"), METHODS)
def test_an_exception_inside_the_block_closes_and_passes_through(method, workers):
    seen = []
    for _ in range(3):
        with pytest.raises(ZeroDivisionError):
            fail_inside(seen, method, workers)
    for sim, pids, block in seen:
        assert all(is_gone(pid) for pid in pids)
        assert not (SHARED_MEMORY / block).exists()
        with pytest.raises(mpsim.errors.ClosedError):
            sim.state  # noqa: B018


def test_an_exception_of_the_progress_callback_passes_through_and_nothing_is_left():
    def broken(done, of):
        raise ZeroDivisionError

    with simulate(lattice(9, 9), method="parallel", workers=2) as sim, pytest.raises(ZeroDivisionError):
        sim.run(frames=100, progress=broken)


@pytest.mark.parametrize(("method", "workers"), METHODS)
def test_closing_in_the_progress_callback_ends_the_run_with_an_error_that_says_so(method, workers):
    sim = simulate(lattice(9, 9), method=method, workers=workers)
    with pytest.raises(mpsim.errors.ClosedError, match="closed after frame"):
        sim.run(frames=10**6, progress=lambda done, of: sim.close())


@pytest.mark.slow
@pytest.mark.parametrize("on_worker_death", ["restart", "raise"])
def test_a_worker_that_dies_after_the_last_frame_does_not_lose_the_report(on_worker_death):
    def kill(done, of):
        os.kill(sim.pids[0], signal.SIGKILL)
        assert wait_until(lambda: is_gone(pid), 20)

    with simulate(lattice(9, 9), method="parallel", workers=2, on_worker_death=on_worker_death) as sim:
        pid = sim.pids[0]
        report = sim.run(frames=1, progress=kill)
        assert report.frames == 1
        assert report.memory_bytes[0] > 0 == report.memory_bytes[1]


def test_a_dropped_simulation_cleans_up():
    sim = simulate(lattice(20, 20), method="parallel", workers=3)
    sim.run(frames=2)
    pids, block = sim.pids, SHARED_MEMORY / block_name(sim)
    del sim
    gc.collect()
    assert wait_until(lambda: all(is_gone(pid) for pid in pids), 2)
    assert not block.exists()


ENDINGS = {
    "without close": "pass",
    "with close": "sim.close(); other.close()",
    "by sys.exit": "import sys; state, report = sim.state, sim.run(frames=1); sys.exit(0)",
}


@pytest.mark.slow
@pytest.mark.parametrize("ending", long_but(ENDINGS, "without close", "by sys.exit"))
def test_a_program_may_end_without_closing(ending):
    start = "forkserver" if ending == "without close" else "fork"
    outcome = run_script(f"""
from support.scenes import lattice, simulate
sim = simulate(lattice(20, 20), method="parallel", workers=3, start_method="{start}")
other = simulate(lattice(20, 20), method="grid")
sim.run(frames=2)
{ENDINGS[ending]}
""")
    assert_clean(outcome)
    assert outcome.out == ""


@pytest.mark.slow
def test_a_program_that_fails_shows_only_its_own_traceback():
    outcome = run_script("""
    from support.scenes import lattice, simulate
    sim = simulate(lattice(20, 20), method="parallel", workers=3)
    sim.run(frames=2)
    1 / 0
    """)
    assert outcome.code == 1
    assert outcome.err.count("Traceback") == 1
    assert outcome.err.rstrip().endswith("ZeroDivisionError: division by zero"), outcome.err


@pytest.mark.slow
@pytest.mark.parametrize("start", long_but(["fork", "spawn", "forkserver"], "spawn"))
def test_a_script_without_main_guard_runs_once(start):
    outcome = run_script(f"""
    print("once")
    import mpsim
    scene = mpsim.Scene.random(count=500, packing=0.5, radius=0.5, seed=1)
    with mpsim.Simulation(scene, mpsim.Settings(method="parallel", workers=3), start_method="{start}") as sim:
        print(sim.run(frames=5).workers)
    """)
    assert_clean(outcome)
    assert outcome.out == "once\n3\n"


FROM_STANDARD_INPUT = """
import subprocess, sys
code = '''
import mpsim
scene = mpsim.Scene.random(count=500, packing=0.5, radius=0.5, seed=1)
for start in ("spawn", "forkserver"):
    with mpsim.Simulation(scene, mpsim.Settings(method="parallel", workers=2), start_method=start) as sim:
        print(sim.run(frames=5).workers)
'''
done = subprocess.run([sys.executable, "-W", "error"], input=code, capture_output=True, text=True)
print(done.stdout + done.stderr, end="")
"""


@pytest.mark.slow
def test_a_program_read_from_standard_input_works():
    """As a notebook's cells do: there is no file that a new process could import as the main module."""
    outcome = run_script(FROM_STANDARD_INPUT)
    assert_clean(outcome)
    assert outcome.out == "2\n2\n"


def resources():
    """File descriptors, shared blocks and child processes of this process."""
    process = psutil.Process()
    return process.num_fds(), len(blocks_of(os.getpid())), len(process.children(recursive=True))


def cycles(number, workers, start):
    """Create, run and close so many times; returns the resources before and after."""
    for _ in range(2):
        digest = cycle(workers, start)
    before = resources()
    for _ in range(number):
        assert cycle(workers, start) == digest
    return before, resources()


def cycle(workers, start):
    with simulate(lattice(9, 9), method="parallel", workers=workers, start_method=start) as sim:
        sim.run(frames=3)
        return sim.digest()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # 3.12: fork in a process with threads
@pytest.mark.parametrize(
    ("number", "workers", "start"), long_but([(20, 3, "fork"), (4, 2, "forkserver")], (20, 3, "fork"))
)
def test_many_simulations_leak_no_descriptor_no_block_and_no_process(number, workers, start):
    before, after = cycles(number, workers, start)
    assert after == before, f"(descriptors, blocks, processes) were {before}, and are {after} after {number} cycles"


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_a_thousand_simulations_leak_nothing(figures):
    before, after = cycles(1000, 2, "forkserver")
    assert after == before, f"(descriptors, blocks, processes) were {before}, and are {after}"
    counts = "descriptors, blocks, processes after 1000 simulations"
    figures.note("R15", "parallel on 2", counts, "as before", f"{after}, as before")
