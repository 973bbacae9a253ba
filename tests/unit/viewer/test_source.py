"""The thread that pages watch: actions in their order, rest while nobody watches, and errors."""

import signal
import threading
import time

import pytest

from mpsim.errors import InputError
from mpsim.scene.scene import Scene
from mpsim.viewer import wire
from mpsim.viewer.source import MOST_WAITING, Source

SCENE = Scene.random(count=5, packing=0.2, radius=0.5, seed=1)


class Recorder(Source):
    """Notes what its thread is asked to do."""

    def __init__(self):
        super().__init__(SCENE, audience=None)  # pyright: ignore[reportArgumentType] - nothing is sent
        self.done, self.advanced, self.refused, self.ended_by = [], threading.Event(), [], None
        self.free = threading.Event()
        self.free.set()

    def _open(self):
        self.done.append("open")

    def _do(self, action):
        self.free.wait(10)
        if action.name == "undo":
            raise InputError("undo needs something to take back; got nothing. Do something first.")
        if action.name == "add":
            raise ZeroDivisionError
        self.done.append(action.name)

    def _advance(self):
        self.advanced.set()

    def _seconds_to_next(self):
        return None

    def _refused(self, error):
        self.refused.append(str(error))

    def _stopped_by(self, error):
        self.ended_by = error

    def _release(self):
        self.done.append("release")


@pytest.fixture
def source():
    found = Recorder()
    found.start()
    yield found
    found.free.set()
    found.close()
    assert not found._thread.is_alive()


def until(holds):
    end = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_actions_are_done_in_their_order_between_opening_and_release(source):
    for name in ("play", "reset", "pause"):
        source.submit(wire.Action(name, {}))
    until(lambda: len(source.done) == 4)
    source.close()
    assert source.done == ["open", "play", "reset", "pause", "release"]


def test_of_waiting_holds_the_last_one_of_each_disc_counts(source):
    source.free.clear()
    source.submit(wire.Action("play", {}))
    until(lambda: not source._actions)
    source.submit(wire.Action("hold", {"id": 4, "x": 0.0}))
    source.submit(wire.Action("undo", {}))
    for x in (1.0, 2.0, 3.0):
        for disc in (4, 5):
            source.submit(wire.Action("hold", {"id": disc, "x": x}))
    assert [each.values for _, each in source._actions] == [
        {"id": 4, "x": 0.0}, {}, {"id": 4, "x": 3.0}, {"id": 5, "x": 3.0},
    ]  # fmt: skip
    source.free.set()


def test_who_has_too_many_actions_waiting_is_refused_and_nobody_else(source):
    source.free.clear()
    source.submit(wire.Action("play", {}))
    until(lambda: not source._actions)
    greedy, other = object(), object()
    for _ in range(MOST_WAITING):
        source.submit(wire.Action("undo", {}), greedy)
    with pytest.raises(InputError, match=f"at most {MOST_WAITING} actions may wait; got one more, undo"):
        source.submit(wire.Action("undo", {}), greedy)
    source.submit(wire.Action("reset", {}), other)
    source.forget(greedy)
    assert [(sender, action.name) for sender, action in source._actions] == [(other, "reset")]
    source.free.set()


def test_it_advances_only_while_somebody_watches(source):
    source.ask()
    assert not source.advanced.wait(0.1)
    source.watched_by(1)
    assert source.advanced.wait(10)


def test_an_error_of_mpsim_is_noted_and_any_other_ends_it(source):
    source.submit(wire.Action("undo", {}))
    until(lambda: source.refused)
    assert source.error is None
    source.submit(wire.Action("add", {}))
    assert source.wait(10)
    assert isinstance(source.error, ZeroDivisionError)
    assert source.ended_by is source.error
    assert source.done == ["open", "release"]


def test_a_signal_that_another_thread_received_ends_the_wait_of_the_main_thread(source):
    """Python only notes such a signal for the main thread, which slept on, for ever."""

    class CameError(Exception):
        pass

    def come(number, frame):
        raise CameError

    other = threading.Thread(target=source.wait, args=(5,), daemon=True)
    other.start()
    before = signal.signal(signal.SIGUSR1, come)
    timer = threading.Timer(0.3, signal.pthread_kill, (other.ident, signal.SIGUSR1))
    try:
        timer.start()
        with pytest.raises(CameError):
            source.wait()
    finally:
        timer.join()
        signal.signal(signal.SIGUSR1, before)
        source.close()
        other.join()


def test_of_speeds_in_a_row_the_last_counts_and_the_inbox_has_a_bound(source):
    source.free.clear()
    source.submit(wire.Action("play", {}))
    until(lambda: not source._actions)  # the thread has it, and waits
    for _ in range(3):
        source.submit(wire.Action("speed", {}))
    assert len(source._actions) == 1
    for _ in range(MOST_WAITING - 1):
        source.submit(wire.Action("step", {}))
    with pytest.raises(InputError, match=f"at most {MOST_WAITING} actions may wait; got one more, step"):
        source.submit(wire.Action("step", {}))
