"""A browser for all tests of a file, and sessions of the live view."""

import pytest
from support.browser import browser
from support.scenes import gas
from support.watching import Watcher

import mpsim
from mpsim.viewer.session import Session

SCENE = gas(300, 0.4)
GRID = mpsim.Settings(method="grid", contact="push", dt=0.01)


@pytest.fixture(scope="module")
def opened():
    with browser() as found:
        yield found


@pytest.fixture
def begin():
    """Starts paused sessions, each with a watcher that has been told all, and ends them after the test."""
    open_ones = []

    def started(source=SCENE, settings=GRID, **options):
        watcher = Watcher()
        session = Session(source, settings, audience=watcher, playing=False, **options)
        open_ones.append(session)
        session.watched_by(1)
        session.start()
        watcher.wait(lambda w: w.phase == "paused" and {"pair", "gauges"} <= w.told.keys())
        return session, watcher

    yield started
    for session in open_ones:
        session.close()
