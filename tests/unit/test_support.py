"""Negative controls of the tests' own tools: each of them must be able to fail."""

import os
import re
import signal
import subprocess
import sys
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import numpy as np
import pytest
from support.compare import assert_inside_and_finite, assert_same_bits, overlapping_pairs
from support.processes import (
    Script,
    assert_clean,
    assert_nothing_left_of,
    blocks_of,
    descendants_of,
    is_gone,
    run_script,
    wait_until,
)
from support.scenes import gas, lattice
from support.script_server import Server, environment

import mpsim

WARM = pytest.mark.parametrize("warm", [False, True], ids=["new", "warm"])


@WARM
def test_a_script_that_hangs_is_a_failure_with_its_stacks(warm):
    script = Script("import time\ndef wait_for_ever():\n    time.sleep(1000)\nwait_for_ever()", warm=warm)
    with script, pytest.raises(AssertionError, match=r"still running after 1 s(.|\n)*in wait_for_ever"):
        script.finish(1)
    assert is_gone(script.pid)


@WARM
def test_a_script_that_says_nothing_is_a_failure(warm):
    script = Script("import time; time.sleep(1000)", warm=warm)
    with script, pytest.raises(AssertionError, match="no line within"):
        script.line(0.2)


def test_a_process_that_a_script_leaves_behind_is_noticed():
    leave = "import subprocess; subprocess.Popen(['sleep', '1000'], stdout=-3, stderr=-3)"
    with Script(leave, flags=()) as script:
        script.finish(20)
        with pytest.raises(AssertionError, match="processes left behind"):
            assert_nothing_left_of(script.pid, within=0.1)


def test_a_process_that_a_warm_script_leaves_behind_is_noticed():
    leave = "import os, time\nif not os.fork():\n    os.closerange(1, 3)\n    time.sleep(1000)"
    with Script(leave, warm=True) as script:
        assert script.finish(20).code == 0
        with pytest.raises(AssertionError, match="processes left behind"):
            assert_nothing_left_of(script.pid, within=0.1)


def test_children_and_their_children_are_found():
    """The guard after each test looks for them."""
    command = "import subprocess; subprocess.Popen(['sleep', '1000']); print('up', flush=True); input()"
    before = descendants_of(os.getpid())
    child = subprocess.Popen([sys.executable, "-c", command], stdout=subprocess.PIPE, stdin=subprocess.PIPE)
    with child:
        child.stdout.readline()
        (sleeping,) = descendants_of(child.pid)
        assert descendants_of(os.getpid()) - before == {child.pid, sleeping}
        os.kill(sleeping, signal.SIGKILL)
    assert descendants_of(os.getpid()) == before


def test_a_block_that_is_left_behind_is_noticed():
    memory = SharedMemory(f"mpsim-{os.getpid()}-test", create=True, size=10)
    try:
        assert blocks_of(os.getpid()) == {memory.name}
        with pytest.raises(AssertionError, match="blocks left behind"):
            assert_nothing_left_of(os.getpid(), within=0.1)
    finally:
        memory.close()
        memory.unlink()


@WARM
def test_noise_and_exit_codes_of_a_script_are_noticed(warm):
    for text in (
        "import sys; print('noise', file=sys.stderr)",
        "raise SystemExit(3)",
        "import warnings; warnings.warn('x')",
    ):
        with pytest.raises(AssertionError, match="exit code"):
            assert_clean(run_script(text, bound=20, warm=warm))


@WARM
def test_a_script_ended_by_a_signal_has_it_as_exit_code(warm):
    with Script("import time; print('up'); time.sleep(1000)", warm=warm) as script:
        assert script.line(20) == "up"
        script.send_to_group(signal.SIGTERM)
        assert script.finish(20).code == -signal.SIGTERM


PROGRAM = """
import atexit, multiprocessing, os, sys, threading, warnings
import support.scenes
from multiprocessing import forkserver, resource_tracker

@atexit.register
def last():
    print("last")

HIDDEN = "__annotations__ __cached__ __loader__ __doc__ __builtins__".split()
main = sys.modules["__main__"]
print(__name__, sorted(vars(main).keys() - HIDDEN))
print(os.path.samefile(os.getcwd(), os.path.dirname(__file__)), sys.argv == [__file__], sys.path[0] == os.getcwd())
print(os.getpgrp() == os.getpid() == os.getsid(0), threading.enumerate() == [threading.main_thread()])
print(resource_tracker._resource_tracker._pid, forkserver._forkserver._forkserver_pid)
print(warnings.filters[0], sys.warnoptions)
print(sorted(os.environ.keys() - {"PYTEST_CURRENT_TEST"}))
print(multiprocessing.active_children())
if not (child := os.fork()):
    os._exit(len(os.listdir("/proc/self/fd")))
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
threading.Timer(0.1, print, ["a thread that is waited for"]).start()
"""
ENDS = {
    "of itself": "",
    "by an exception": "1 / 0",
    "by sys.exit": "sys.exit(3)",
    "by Ctrl-C": "os.kill(os.getpid(), 2); import time; time.sleep(10)",
}


@pytest.mark.parametrize("end", ENDS)
def test_a_warm_script_is_a_program_like_one_in_a_new_interpreter(end):
    text = PROGRAM + ENDS[end]
    new, warm = (run_script(text, warm=warm) for warm in (False, True))
    assert warm.out == new.out
    assert warm.out.splitlines()[-2:] == ["a thread that is waited for", "last"]
    assert warm.code == new.code
    assert (warm.err.count("Traceback"), warm.err.splitlines()[-1:]) == (
        new.err.count("Traceback"),
        new.err.splitlines()[-1:],
    )


def test_a_warm_script_starts_workers_as_a_new_interpreter_does():
    """By each start method, and its own resource tracker, which would complain of what is left."""
    outcome = run_script(
        """
        from support.scenes import digest_after, lattice

        expected = digest_after(lattice(9, 9), 5, method="grid")
        for start in ("fork", "forkserver", "spawn"):
            print(digest_after(lattice(9, 9), 5, method="parallel", workers=2, start_method=start) == expected)
        """,
        warm=True,
        bound=150,  # it may be the first to compile these kernels
    )
    assert_clean(outcome)
    assert outcome.out == "True\nTrue\nTrue\n"


def test_what_a_warm_script_changes_the_next_one_does_not_see():
    for _ in range(2):
        outcome = run_script("import mpsim; print(hasattr(mpsim, 'mark')); mpsim.mark = 1", warm=True)
        assert (outcome.code, outcome.out) == (0, "False\n")


def test_a_server_of_scripts_that_has_ended_is_an_error_and_the_next_script_starts_another():
    run_script("pass", warm=True)
    (pid,) = Server.pids()
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(AssertionError, match=r"server of scripts has ended, with exit code -9"):
        run_script("pass", warm=True)
    assert run_script("print(1)", warm=True).out == "1\n"


HANGING = """
import os, re

def test_fails():
    assert False

def test_passes():
    pass

def test_hangs(request):
    (request.config.rootpath / "pid").write_text(str(os.getpid()))
    re.match(r"(a+)+$", 40 * "a" + "b")  # for years, in which it lets no thread of this process run
"""
WATCHED = """
from support import watchdog

watchdog.EARLIER = 0.5

def pytest_configure(config):
    config.watchdog = watchdog.Watchdog(config, 4)
    config.pluginmanager.register(config.watchdog)

def pytest_unconfigure(config):
    config.watchdog.stop(1)
"""


def test_a_session_that_hangs_ends_with_its_workers_and_names_its_tests(tmp_path):
    """In a failure pytest takes back the timer of faulthandler: it did so for good."""
    for name, text in (("test_it.py", HANGING), ("conftest.py", WATCHED), ("pytest.ini", "[pytest]")):
        (tmp_path / name).write_text(text)
    command = [sys.executable, "-m", "pytest", "-n", "1", "-p", "no:cacheprovider", str(tmp_path)]
    ended = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 1
    assert wait_until(lambda: is_gone(int((tmp_path / "pid").read_text())), 5)
    assert re.search(r"failed: test_it.py::test_fails\nrunning for \d+ s: test_it.py::test_hangs\n", ended.stderr)
    assert re.search(r"test_it.py\W+line \d+ in test_hangs", ended.stderr)
    assert "test_passes" not in ended.stderr


@pytest.mark.slow
def test_a_worker_without_further_tests_waits_for_the_last_one(tmp_path):
    """It was ended as if its session were over."""
    slow = "import time\ndef test_short(): pass\ndef test_long(): time.sleep(3)\n"
    for name, text in (("test_it.py", slow), ("conftest.py", WATCHED.replace("4", "60")), ("pytest.ini", "[pytest]")):
        (tmp_path / name).write_text(text)
    command = [sys.executable, "-m", "pytest", "-n", "2", "-p", "no:cacheprovider", str(tmp_path)]
    ended = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0
    assert "Timeout" not in ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "begun"), [("0", False), ("300", True)])
def test_where_the_time_is_limited_what_was_not_begun_is_counted(seconds, begun):
    command = [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider", "--within", seconds]
    command.append(str(Path(__file__).parent / "core" / "test_chunks.py"))
    ended = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0
    left_out = re.search(r"Left out, \d+ tests: no test was begun after 0 s", ended.stdout)
    assert (left_out is None) == begun, ended.stdout


def test_a_warm_script_ends_with_the_server():
    with Script("import time; print('up', flush=True); time.sleep(1000)", warm=True) as script:
        script.line()
        (server,) = Server.pids()
        os.kill(server, signal.SIGKILL)
        assert wait_until(lambda: is_gone(script.pid), 5)
        with pytest.raises(AssertionError, match="server of scripts has ended"):
            script.finish()
        script._process.returncode = -signal.SIGKILL


def test_a_stopped_process_is_not_gone_and_an_ended_one_is():
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
    assert not is_gone(process.pid)
    process.send_signal(signal.SIGSTOP)
    assert not is_gone(process.pid)
    process.kill()
    process.wait()
    assert is_gone(process.pid)


def test_a_difference_of_one_bit_is_named():
    scene = gas(50, 0.2)
    pairs = [(scene.position.copy(), scene.velocity.copy()) for _ in range(2)]
    state, other = (mpsim.State(*pair) for pair in pairs)
    assert_same_bits(state, other, "equal")
    pairs[1][1][31, 1] = np.nextafter(other.velocity[31, 1], 9)
    with pytest.raises(AssertionError, match="note: 1 of 50 discs differ in velocity; the first is disc 31"):
        assert_same_bits(state, other, "note")
    pairs[1][1][31, 1], pairs[1][0][0, 0] = state.velocity[31, 1], -0.0
    pairs[0][0][0, 0] = 0.0
    with pytest.raises(AssertionError, match="differ in position; the first is disc 0"):
        assert_same_bits(state, other, "zeros of two signs")


def test_a_disc_outside_or_not_finite_is_named():
    scene = gas(50, 0.2)
    position, velocity = scene.position.copy(), scene.velocity.copy()
    state = mpsim.State(position, velocity)
    assert_inside_and_finite(state, scene, "as given")
    position[7] = 0.4
    with pytest.raises(AssertionError, match="disc 7 is outside"):
        assert_inside_and_finite(state, scene, "note")
    velocity[7] = np.nan
    with pytest.raises(AssertionError, match="not finite"):
        assert_inside_and_finite(state, scene, "note")


def test_overlapping_pairs_are_those_of_all_pairs():
    position = np.random.default_rng(1).random((80, 2)) * 8
    i, j, distance = overlapping_pairs(position, 1.0)
    apart = np.hypot(*(position[:, None] - position[None]).transpose(2, 0, 1))
    expected = {(a, b) for a, b in np.argwhere(apart < 1) if a < b}
    assert set(zip(i.tolist(), j.tolist(), strict=True)) == expected
    assert np.allclose(distance, apart[i, j])


def test_the_lattice_is_legal_and_moves():
    scene = lattice(7, 5)
    assert not len(overlapping_pairs(scene.position, 1.0)[0])
    assert (np.abs(scene.velocity) <= 2).all()
    assert len(np.unique(scene.velocity)) == 70
