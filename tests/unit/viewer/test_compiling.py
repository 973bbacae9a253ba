"""What pages are told while kernels are compiled, whoever compiles them, and however many views there are."""

import time
from contextlib import ExitStack

import pytest
from support.scenes import gas
from support.watching import Watcher

import mpsim
from mpsim.kernels import compile_notice
from mpsim.viewer.compiling import Listeners
from mpsim.viewer.session import Session

MOVE = "compiling a small kernel (move), once"


class Before:
    """The announcer that was there before."""

    def __init__(self):
        self.told = []

    def begin(self, text):
        self.told.append(text)

    def end(self):
        self.told.append(None)


@pytest.fixture
def before():
    announcer = Before()
    with compile_notice.announced_by(announcer):
        yield announcer


def compile_as_if(until, monkeypatch):
    """As if the compiler worked on a kernel until something holds."""
    monkeypatch.setattr(compile_notice, "QUIET_FOR", 0.01)
    with compile_notice.asked_for("move", (), True):
        compile_notice.not_cached()
        until()


def test_blocks_end_in_any_order_and_the_announcer_before_hears_all(before):
    listeners, first, second = Listeners(), [], []
    one, other = ExitStack(), ExitStack()
    one.enter_context(listeners.notifying(first.append))
    other.enter_context(listeners.notifying(second.append))
    listeners.begin("a")
    one.close()
    listeners.begin("b")
    listeners.end()
    assert second == ["a", "b"], "another one is still being compiled"
    listeners.end()
    assert (first, second) == (["a"], ["a", "b", None])
    assert before.told == ["a", "b", None, None]
    assert compile_notice._announcer is listeners
    other.close()
    assert compile_notice._announcer is before


def test_pages_are_told_while_a_session_is_open(before, monkeypatch):
    watcher = Watcher()
    session = Session(gas(10, 0.2), mpsim.Settings(method="grid"), playing=False, audience=watcher)
    session.start()
    try:
        watcher.wait(lambda w: w.phase == "paused")
        compile_as_if(lambda: watcher.wait(lambda w: w.told.get("compiling", {}).get("text") == MOVE), monkeypatch)
        watcher.wait(lambda w: w.told["compiling"]["text"] is None)
    finally:
        session.close()
    heard = before.told.count(MOVE)
    assert heard
    assert compile_notice._announcer is before, "a view that has ended is told nothing"
    watcher.told.clear()
    compile_as_if(lambda: time.sleep(0.2), monkeypatch)
    assert (before.told.count(MOVE), watcher.told) == (heard + 1, {})
