"""Options, the end of a session that hangs, and the guard against what a test leaves behind."""

import faulthandler
import gc
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from multiprocessing import forkserver, resource_tracker
from pathlib import Path

import hypothesis
import pytest
from hypothesis.configuration import set_hypothesis_home_dir

sys.path.insert(0, str(Path(__file__).parent))  # for `support`, from every folder of tests

from support import sorts

os.environ.update(sorts.variables())

from support.browser import DRIVERS
from support.processes import SHARED_MEMORY, blocks_of, descendants_of, is_gone, wait_until
from support.script_server import Server, end_with_parent

LONGEST_SESSION = {"default": 900, "slow": 1500, "long": 7200}
"""Seconds after which a whole session counts as hung: pytest-timeout bounds each single test before, but cannot see a
hang between tests."""

LEFT = {"slow": "takes seconds; run with --slow", "long": "takes minutes; run with --long"}
"""Why tests with these marks are left out."""

SLOW_EXAMPLES = {
    "mpsim.studies.tune.tune",
    "mpsim.scene.scene.Scene.compressed",
    "mpsim.measure.correlations.Correlations",
    "mpsim.measure.observables.to_freud",
    "mpsim.studies.sweep.sweep",
    "mpsim.studies.tradeoff.tradeoff",
}
"""Examples of docstrings that compile several kernels, run for seconds, or import a large package."""

LONGEST_EXIT = 60  # seconds that the interpreter may take to end after the last test

set_hypothesis_home_dir(Path(tempfile.gettempdir()) / "mpsim-hypothesis")
for name, examples in (("default", 40), ("long", 500)):
    hypothesis.settings.register_profile(
        name, max_examples=examples, deadline=None, database=None, derandomize=name == "default", print_blob=True
    )


def pytest_addoption(parser):
    parser.addoption("--slow", action="store_true", help="run the tests marked slow instead: some fifteen minutes")
    parser.addoption("--within", type=float, help="begin no test after so many seconds, and say how many were left out")
    parser.addoption("--long", action="store_true", help="run all tests, those marked slow and long too")
    parser.addoption(
        "--renew", action="store_true", help="write pinned digests and texts anew instead of comparing them"
    )


def keep_bytecode():
    """For this process and all that it starts, whatever the environment says.

    Half of the time of collection goes into the assertions of tests, which pytest rewrites, and hundreds of processes
    import mpsim.
    """
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def kind_of(config) -> str:
    """Kind of the session: default, slow or long."""
    return next((kind for kind in ("long", "slow") if config.getoption(f"--{kind}")), "default")


def pytest_configure(config):
    keep_bytecode()
    kind = kind_of(config)
    hypothesis.settings.load_profile("long" if kind == "long" else "default")
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as a shell does for what it starts in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(config, "workerinput"):
        end_with_parent()
    config.stash[_end], config.stash[_errors] = time.monotonic() + LONGEST_SESSION[kind], os.dup(2)
    end_later(config)
    shared = kind == "default" and pytest_xdist_auto_num_workers(config)
    if shared:
        sorts.announce()
        config.option.maxworkerrestart = "0"  # it would have another name, and no share
    if shared or (hasattr(config, "workerinput") and sorts.mine()):
        config.pluginmanager.register(sorts)


def pytest_unconfigure(config):
    if hasattr(config, "workerinput"):  # which waits for the others, and ends with its parent
        faulthandler.cancel_dump_traceback_later()
    else:
        config.stash[_end] = time.monotonic() + LONGEST_EXIT
        end_later(config)


def end_later(config):
    """End a session that hangs, in whatever code, with the stacks of all threads."""
    faulthandler.dump_traceback_later(
        max(config.stash[_end] - time.monotonic(), 1), exit=True, file=config.stash[_errors]
    )


@pytest.hookimpl(trylast=True)
def pytest_exception_interact(node):
    """Pytest takes that timer back after each failure, for a debugger."""
    end_later(node.config)


_end = pytest.StashKey[float]()
_errors = pytest.StashKey[int]()


def pytest_terminal_summary(terminalreporter, config):
    """What was left out, and why, but for the slow and long tests: each reason once."""
    reasons = (str(each.longrepr[2]).removeprefix("Skipped: ") for each in terminalreporter.stats.get("skipped", ()))
    for reason, count in Counter(reasons).items():
        if reason not in LEFT.values():
            terminalreporter.write_line(f"Left out, {count} tests: {reason}")
    if config.getoption("--long"):
        terminalreporter.write_line(
            "Other versions of Python and of what mpsim depends on are left: python scripts/run_versions.py --long"
        )


def pytest_xdist_auto_num_workers(config):
    """A process for each share of all default tests, three for all others, which wait often; else this one."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS and not config.getoption("--renew")
    return (len(sorts.SHARES) if kind_of(config) == "default" else 3) if whole else 0


def pytest_collection_modifyitems(config, items):
    """Which tests run, whatever their files: those of the session's kind, and all of them with --long."""
    kind = kind_of(config)
    for item in items:
        if item.name in SLOW_EXAMPLES:
            item.add_marker(pytest.mark.slow)
    if kind == "long":  # three at a time on two cores, and each compiles what it needs
        for item in items:
            seconds = next((mark.args[0] for mark in item.iter_markers("timeout")), float(config.getini("timeout")))
            item.add_marker(pytest.mark.timeout(4 * seconds), append=False)
        return
    if kind == "slow":
        others = [item for item in items if not item.get_closest_marker("slow")]
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if item.get_closest_marker("slow")]
    for item in items:
        for mark, why in LEFT.items():
            if mark != kind and item.get_closest_marker(mark):
                item.add_marker(pytest.mark.skip(reason=why))


BEGAN = time.monotonic()  # when this process began


def pytest_runtest_setup(item):
    """Where the time is limited, as in the check of a slow machine, begin no test after its end."""
    within = item.config.getoption("--within")
    if within is not None and time.monotonic() - BEGAN > within:
        pytest.skip(f"no test was begun after {within:g} s")


LONG = 1.0  # seconds after which a test has probably compiled something


@pytest.fixture(autouse=True)
def garbage_is_found_soon():
    """Leave what compilations keep out of later collections of garbage: of millions of objects each takes a second."""
    began = time.perf_counter()
    yield
    if time.perf_counter() - began > LONG:
        gc.collect()
        gc.freeze()


@pytest.fixture(autouse=True)
def nothing_left_behind():
    """After each test: no new shared block of this process, and no new child process but multiprocessing's helpers."""
    blocks, children = blocks_of(os.getpid()), _children()
    yield
    if blocks_of(os.getpid()) - blocks or _children() - children:
        gc.collect()
    left = lambda: (blocks_of(os.getpid()) - blocks, _children() - children)  # noqa: E731
    try:
        assert wait_until(lambda: left() == (set(), set()), 2), f"left behind (blocks, processes): {left()}"
    finally:  # else tests that count all blocks of this process would fail, too
        for name in blocks_of(os.getpid()) - blocks:
            (SHARED_MEMORY / name).unlink(missing_ok=True)


def _children() -> set[int]:
    """Living children and theirs but for the fork server, the resource tracker, the server of scripts and browsers."""
    helpers = {forkserver._forkserver._forkserver_pid, resource_tracker._resource_tracker._pid, *Server.pids()}
    helpers |= DRIVERS.union(*(descendants_of(driver) for driver in DRIVERS))
    return {pid for pid in descendants_of(os.getpid()) if pid not in helpers and not is_gone(pid)}
