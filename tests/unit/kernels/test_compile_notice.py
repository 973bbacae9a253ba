"""What is said while kernels are compiled: in good time, once, by whoever listens, and nothing where none are."""

import logging
import sys
import threading
import time

import pytest
from support.processes import assert_clean, run_script

from mpsim.kernels import compile_notice
from mpsim.kernels.events import solver
from mpsim.kernels.features.hooks import BARE
from mpsim.kernels.frame import stepping

QUIET_FOR = 0.05
LONG = 10.0
"""Seconds after which an announcement has gone missing."""


class Heard:
    """What an announcer was told, and by which thread."""

    def __init__(self):
        self.told, self.threads, self.begun = [], set(), threading.Event()

    def begin(self, text):
        self.told.append(text)
        self.threads.add(threading.current_thread())
        self.begun.set()

    def end(self):
        self.told.append("end")


@pytest.fixture
def heard(monkeypatch):
    monkeypatch.setattr(compile_notice, "QUIET_FOR", QUIET_FOR)
    listener = Heard()
    with compile_notice.announced_by(listener):
        yield listener


def compiling(kernel="run_naive", signature=(), kept=True, until=lambda: None, cached=False):
    """As if the compiler worked on a kernel, which calls another one, until something has happened."""
    with compile_notice.asked_for(kernel, signature, kept), compile_notice.asked_for("move", (), kept):
        if not cached:
            compile_notice.not_cached()
            compile_notice.not_cached()
        until()


def test_it_is_said_while_it_lasts_once_and_by_another_thread(heard):
    before = compile_notice.compile_seconds()
    compiling(until=lambda: heard.begun.wait(LONG))
    assert heard.told == ["compiling the loops for this scene, once; about 4 s", "end"]
    assert threading.current_thread() not in heard.threads
    assert not any(thread.is_alive() for thread in heard.threads)
    assert QUIET_FOR <= compile_notice.compile_seconds() - before < LONG


def test_within_a_second():
    assert compile_notice.QUIET_FOR < 0.8


def test_nothing_is_said_or_counted_where_the_kernel_comes_from_the_cache(heard):
    before = compile_notice.compile_seconds()
    compiling(until=lambda: time.sleep(4 * QUIET_FOR), cached=True)
    assert heard.told == []
    assert compile_notice.compile_seconds() == before


def test_nothing_is_said_of_a_short_compilation_but_it_is_counted(heard):
    before = compile_notice.compile_seconds()
    compiling()
    time.sleep(4 * QUIET_FOR)
    assert heard.told == []
    assert compile_notice.compile_seconds() > before


def test_one_that_fails_ends_too(heard):
    def fail():
        assert heard.begun.wait(LONG)
        raise ValueError("no such type")

    with pytest.raises(ValueError, match="no such type"):
        compiling(until=fail)
    assert heard.told[1:] == ["end"]
    heard.begun.clear()
    compiling(until=lambda: heard.begun.wait(LONG))
    assert len(heard.told) == 4


def test_a_listener_may_wait_for_what_the_compiling_thread_holds(monkeypatch):
    """As a handler of the log may, for a thread that reads the simulation: the compiler does not wait for it."""
    monkeypatch.setattr(compile_notice, "QUIET_FOR", QUIET_FOR)
    monkeypatch.setattr(compile_notice, "PATIENCE", QUIET_FOR)
    lock, waiting, done = threading.Lock(), threading.Event(), threading.Event()

    class Waiting(Heard):
        def begin(self, text):
            waiting.set()
            with lock:
                done.set()

    with compile_notice.announced_by(Waiting()):
        with lock:
            compiling(until=lambda: waiting.wait(LONG))
            assert not done.is_set()
        assert done.wait(LONG)


def test_nobody_is_told_where_nobody_is_to_tell(monkeypatch):
    monkeypatch.setattr(compile_notice, "QUIET_FOR", 0.0)
    threads = threading.active_count()
    with compile_notice.announced_by(Heard()):
        compile_notice.announce_by(None)
        compiling(until=lambda: time.sleep(QUIET_FOR))
    assert threading.active_count() == threads


@pytest.mark.parametrize(
    ("prompt", "terminal", "level"),
    [(False, False, logging.INFO), (True, False, logging.WARNING), (False, True, logging.WARNING)],
)
def test_the_log_line_is_a_warning_only_where_somebody_waits(prompt, terminal, level, caplog, monkeypatch):
    caplog.set_level(logging.INFO, "mpsim")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    if prompt:
        monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
    compile_notice.LogLine().begin("compiling something")
    assert caplog.record_tuples == [("mpsim", level, "mpsim: compiling something")]


def test_what_is_said_tells_how_long_and_whether_the_code_is_kept():
    from numba import typeof  # noqa: PLC0415

    kinds = [typeof(BARE), typeof(BARE._replace(gravity=1.0)), typeof(BARE._replace(gravity=1.0, mass=1.0))]
    bare, one, two = ([compile_notice.announcement("run_grid", (kind,), True)] for kind in kinds)
    cost = compile_notice.COSTS["run_grid"]
    said = [f"compiling the loops for this scene, once; about {cost.bare + n * cost.field:.0f} s" for n in range(3)]
    assert [*bare, *one, *two] == said
    assert compile_notice.announcement("run_naive", (), False) == "compiling the loops for this scene; about 4 s"
    assert compile_notice.announcement("is_free", (), True) == "compiling a small kernel (is_free), once"


def test_there_is_a_kernel_of_each_name_whose_cost_is_known():
    assert set(compile_notice.COSTS) <= set(vars(stepping)) | set(vars(solver))


RUN = """
import logging, sys
logging.basicConfig(level=logging.INFO, stream=sys.stdout, format="%(levelname)s %(message)s")
import mpsim
from mpsim.kernels import compile_notice
compile_notice.QUIET_FOR = 0.01
mpsim.Scene.random(count=30, packing=0.5, radius=0.5, seed=1)
print(compile_notice.compile_seconds())
"""


@pytest.mark.slow
def test_a_first_run_says_so_and_a_second_one_nothing(tmp_path):
    env = {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (run_script(RUN, env=env, bound=90) for _ in range(2))
    for outcome in (first, second):
        assert_clean(outcome)
    *lines, seconds = first.out.splitlines()
    assert "INFO mpsim: compiling a small kernel (sweep), once" in lines
    assert float(seconds) > 0
    assert second.out == "0.0\n"
