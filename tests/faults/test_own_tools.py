"""The tests' own tools must be able to fail: scripts that hang or leave something, sessions that hang, other bits."""

import os
import re
import signal
import subprocess
import sys
from multiprocessing.shared_memory import SharedMemory

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
def test_a_script_that_hangs_says_nothing_or_makes_noise_is_a_failure(warm):
    hangs = "import time\ndef wait_for_ever():\n    time.sleep(1000)\nwait_for_ever()"
    with Script(hangs, warm=warm) as script:
        with pytest.raises(AssertionError, match="no line within"):
            script.line(0.2)
        with pytest.raises(AssertionError, match=r"still running after 1 s(.|\n)*in wait_for_ever"):
            script.finish(1)
    assert is_gone(script.pid)
    for text in ("import sys; print('noise', file=sys.stderr)", "raise SystemExit(3)"):
        with pytest.raises(AssertionError, match="exit code"):
            assert_clean(run_script(text, bound=20, warm=warm))
    with Script("import time; print('up'); time.sleep(1000)", warm=warm) as script:
        assert script.line(20) == "up"
        script.send_to_group(signal.SIGTERM)
        assert script.finish(20).code == -signal.SIGTERM


@pytest.mark.parametrize(
    ("leave", "how"),
    [
        ("import subprocess; subprocess.Popen(['sleep', '1000'], stdout=-3, stderr=-3)", {"flags": ()}),
        ("import os, time\nif not os.fork():\n    os.closerange(1, 3)\n    time.sleep(1000)", {"warm": True}),
    ],
    ids=["new", "warm"],
)
def test_a_process_that_a_script_leaves_behind_is_noticed(leave, how):
    with Script(leave, **how) as script:
        script.finish(20)
        with pytest.raises(AssertionError, match="processes left behind"):
            assert_nothing_left_of(script.pid, within=0.1)


def test_children_theirs_and_blocks_are_found():
    """The guard after each test looks for them."""
    command = "import subprocess; subprocess.Popen(['sleep', '1000']); print('up', flush=True); input()"
    before = descendants_of(os.getpid())
    child = subprocess.Popen([sys.executable, "-c", command], stdout=subprocess.PIPE, stdin=subprocess.PIPE)
    with child:
        child.stdout.readline()
        (sleeping,) = descendants_of(child.pid)
        assert descendants_of(os.getpid()) - before == {child.pid, sleeping}
        child.send_signal(signal.SIGSTOP)
        assert not is_gone(child.pid), "a stopped process"
        child.send_signal(signal.SIGCONT)
        os.kill(sleeping, signal.SIGKILL)
    assert descendants_of(os.getpid()) == before
    memory = SharedMemory(f"mpsim-{os.getpid()}-test", create=True, size=10)
    try:
        assert blocks_of(os.getpid()) == {memory.name}
        with pytest.raises(AssertionError, match="blocks left behind"):
            assert_nothing_left_of(os.getpid(), within=0.1)
    finally:
        memory.close()
        memory.unlink()


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
print(multiprocessing.active_children(), hasattr(support, "mark"))
support.mark = "what a script changes the next one does not see"
if not (child := os.fork()):
    os._exit(len(os.listdir("/proc/self/fd")))
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
threading.Timer(0.1, print, ["a thread that is waited for"]).start()
"""
ENDS = ["sys.exit(3)", "os.kill(os.getpid(), 2); import time; time.sleep(10)"]


@pytest.mark.parametrize("end", ENDS)
def test_a_warm_script_is_a_program_like_one_in_a_new_interpreter(end):
    new, warm = (run_script(PROGRAM + end, warm=warm) for warm in (False, True))
    assert warm.out == new.out
    assert warm.out.splitlines()[-2:] == ["a thread that is waited for", "last"]
    assert warm.code == new.code
    assert (warm.err.count("Traceback"), warm.err.splitlines()[-1:]) == (
        new.err.count("Traceback"),
        new.err.splitlines()[-1:],
    )


def test_a_server_of_scripts_that_has_ended_takes_its_scripts_along_and_the_next_one_starts_another():
    with Script("import time; print('up', flush=True); time.sleep(1000)", warm=True) as script:
        script.line()
        (server,) = Server.pids()
        os.kill(server, signal.SIGKILL)
        assert wait_until(lambda: is_gone(script.pid), 5)
        with pytest.raises(AssertionError, match="server of scripts has ended"):
            script.finish()
        script._process.returncode = -signal.SIGKILL
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
    config.watchdog = watchdog.Watchdog(config, 20)
    config.pluginmanager.register(config.watchdog)

def pytest_unconfigure(config):
    config.watchdog.stop(1)
"""


@pytest.mark.slow
def test_a_session_that_hangs_ends_with_its_workers_and_names_its_tests(tmp_path):
    for name, text in (("test_it.py", HANGING), ("conftest.py", WATCHED), ("pytest.ini", "[pytest]")):
        (tmp_path / name).write_text(text)
    command = [sys.executable, "-m", "pytest", "-n", "1", "-p", "no:cacheprovider", str(tmp_path)]
    ended = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=150, check=False)
    assert ended.returncode == 1
    assert wait_until(lambda: is_gone(int((tmp_path / "pid").read_text())), 5)
    assert re.search(r"failed: test_it.py::test_fails\nrunning for \d+ s: test_it.py::test_hangs\n", ended.stderr)
    assert re.search(r"test_it.py\W+line \d+ in test_hangs", ended.stderr)
    assert "test_passes" not in ended.stderr


def test_a_difference_of_one_bit_and_a_disc_outside_are_named():
    scene = gas(50, 0.2)
    pairs = [(scene.position.copy(), scene.velocity.copy()) for _ in range(2)]
    state, other = (mpsim.State(*pair) for pair in pairs)
    assert_same_bits(state, other, "equal")
    assert_inside_and_finite(state, scene, "as given")
    pairs[1][1][31, 1] = np.nextafter(other.velocity[31, 1], 9)
    with pytest.raises(AssertionError, match="note: 1 of 50 discs differ in velocity; the first is disc 31"):
        assert_same_bits(state, other, "note")
    pairs[1][1][31, 1], pairs[1][0][0, 0] = state.velocity[31, 1], -0.0
    pairs[0][0][0, 0] = 0.0
    with pytest.raises(AssertionError, match="differ in position; the first is disc 0"):
        assert_same_bits(state, other, "zeros of two signs")
    for index, value, text in ((0, 0.4, "disc 7 is outside"), (1, np.nan, "not finite")):
        flight = scene.position.copy(), scene.velocity.copy()
        flight[index][7] = value
        with pytest.raises(AssertionError, match=text):
            assert_inside_and_finite(mpsim.State(*flight), scene, "note")


def test_overlapping_pairs_are_those_of_all_pairs():
    position = np.random.default_rng(1).random((80, 2)) * 8
    i, j, distance = overlapping_pairs(position, 1.0)
    apart = np.hypot(*(position[:, None] - position[None]).transpose(2, 0, 1))
    assert set(zip(i.tolist(), j.tolist(), strict=True)) == {(a, b) for a, b in np.argwhere(apart < 1) if a < b}
    assert np.allclose(distance, apart[i, j])
    assert not len(overlapping_pairs(lattice(7, 5).position, 1.0)[0])
