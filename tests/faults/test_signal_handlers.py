"""A handler of a signal runs in the middle of whatever its thread is doing: it reads what is whole, or is refused."""

import contextlib
import itertools
import os
import signal
import sys

import pytest
from support.processes import assert_clean, run_script
from support.scenes import digest_after, lattice, simulate

import mpsim


def test_a_signal_handler_may_read_while_its_thread_is_reading():
    """The run waited for the reader, and the reader, in its handler, for the run."""
    outcome = run_script(
        """
        import signal, threading, time
        from support.scenes import lattice, simulate

        def handler(*_):
            if not stop:
                seen.append(sim.frame)
                signal.setitimer(signal.ITIMER_REAL, 0.001)

        def run_until_seen():
            while len(seen) < 30:
                sim.run(frames=500)

        seen, stop = [], []
        with simulate(lattice(30, 30), method="grid") as sim:
            thread = threading.Thread(target=run_until_seen)
            thread.start()
            signal.signal(signal.SIGALRM, handler)
            signal.setitimer(signal.ITIMER_REAL, 0.001)
            while thread.is_alive():
                sim.state
            stop.append(True)
            signal.setitimer(signal.ITIMER_REAL, 0)
            print(sim.frame % 500, seen == sorted(seen))
        """,
        warm=True,
    )
    assert_clean(outcome)
    assert outcome.out == "0 True\n"


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of a disc that is added where others are
def test_a_signal_handler_may_not_look_into_a_move_to_another_block(monkeypatch):
    """A handler runs in the middle of whatever its thread is doing; between frames it may do anything."""
    found = []

    def look_and_add(solver, new, choice):
        with pytest.raises(
            mpsim.errors.BusyError, match=r"^add\(\) of thread 'MainThread' is in progress; reading state of"
        ):
            sim.state  # noqa: B018
        with pytest.raises(mpsim.errors.BusyError, match=r"close\(\) of the same thread was refused"):
            sim.close()
        found.append("refused")
        return add(solver, new, choice)

    with simulate(lattice(9, 9), method="grid") as sim:
        solver = type(sim._solver)
        add = solver.add
        monkeypatch.setattr(solver, "add", look_and_add)
        sim.add((1.0, 1.0), (0.0, 0.0))
        assert (found, sim.count) == (["refused"], 82)


class AtMoment:
    """Acts once as a signal handler would: at the `number`-th call or return of a function in the `with` block.

    Attributes:
        count: of such moments so far.
        found: what the action has returned, or the BusyError by which it was refused.
        free: whether at that moment no call was in progress, or callbacks were, so that anything may be done.
    """

    def __init__(self, number, sim, act):
        self.count, self.found, self.free = 0, None, False
        self._number, self._sim, self._act = number, sim, act

    def __enter__(self):
        sys.setprofile(self._look)
        return self

    def __exit__(self, *exception):
        sys.setprofile(None)

    def _look(self, frame, event, argument):
        self.count += 1
        if self.count == self._number:
            use = self._sim._access.use
            self.free = use is None or getattr(use, "in_callback", False)
            try:
                self.found = self._act(self._sim)
            except mpsim.errors.BusyError as error:
                self.found = error


HANDLERS = {
    "add": lambda sim: sim.add((15.0, 5.0), (0.0, 0.0)),
    "save": lambda sim: sim.save("run.mpsim"),
    "close": lambda sim: sim.close(),
    "read": lambda sim: (sim.frame, sim.count, sim.digest()),
}


def emitting(method):
    """Discs enter before frames 5 and 10."""
    emitter = mpsim.Emitter((2.0, 2.0), (50.0, 0.0), every=5)
    scene = mpsim.Scene(
        width=20, height=10, position=[(18.0, 8.0)], velocity=[(0.0, 0.0)], radius=0.1, emitters=[emitter]
    )
    return simulate(scene, method=method, dt=0.001)


def four_frames_and_then_six(method, number, act):
    """What a handler did in the six, and the simulation after them; its owner must close it."""
    sim = emitting(method)
    sim.run(frames=4)
    with contextlib.suppress(mpsim.errors.ClosedError), AtMoment(number, sim, act) as handler:
        sim.run(frames=6)
    return handler, sim


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_signal_handler_changes_nothing_inside_a_run_and_reads_what_is_whole(method, request, tmp_path, monkeypatch):
    """It added discs to a store that the kernel had left, and saved discs of which the emitter did not know yet."""
    monkeypatch.chdir(tmp_path)
    read, refused = HANDLERS["read"], 0
    with emitting(method) as sim:
        whole = [read(sim), *(sim.run(frames=1) and read(sim) for _ in range(10))]
    entered = [(frame, count) for (frame, _, _), (_, count, _) in itertools.pairwise(whole)]  # before the next frame
    counter, sim = four_frames_and_then_six(method, 0, read)
    sim.close()
    step = 1 if request.config.getoption("--long") else counter.count // 40
    for number, name in zip(range(1, counter.count + 1, step), itertools.cycle(HANDLERS), strict=False):
        handler, sim = four_frames_and_then_six(method, number, HANDLERS[name])
        with sim:
            moment = f"{name}, moment {number} of {counter.count}"
            if handler.count < number:
                continue  # this run had fewer
            if isinstance(handler.found, mpsim.errors.BusyError):
                refused += 1
                assert read(sim) == whole[10], moment
            elif name == "read":
                assert handler.found in whole or handler.found[:2] in entered, moment
            else:
                assert handler.free, moment
    assert refused > 20


MIDDLE = {"grid": "_deal", "event": "_run_kernel"}


@pytest.mark.parametrize("method", MIDDLE)
def test_a_signal_handler_that_is_refused_ends_the_run_and_not_the_simulation(method):
    def save(frame, event, argument):
        if event == "call" and frame.f_code.co_name == MIDDLE[method]:
            sys.setprofile(None)
            sim.save("/dev/null/never")

    with simulate(lattice(9, 9), method=method) as sim:
        sys.setprofile(save)
        with pytest.raises(
            mpsim.errors.BusyError, match=r"^run\(\) of thread 'MainThread' is in progress; save\(\) of the same"
        ):
            sim.run(frames=10)
        sim.run(frames=10 - sim.frame)
        assert sim.digest() == digest_after(lattice(9, 9), 10, method=method)


def test_a_signal_handler_does_not_read_discs_that_a_dead_worker_has_left_inside_a_frame():
    def look(frame, event, argument):
        if event == "call" and frame.f_code.co_name == "_deal":
            os.kill(sim.pids[0], signal.SIGKILL)
        if event == "call" and frame.f_code.co_name == "_failure":
            sys.setprofile(None)
            with pytest.raises(mpsim.errors.BusyError, match="reading state"):
                sim.state  # noqa: B018
            found.append("refused")

    found = []
    with simulate(lattice(20, 20), method="parallel", workers=2, on_worker_death="restart") as sim:
        sys.setprofile(look)
        try:
            sim.run(frames=20)
        finally:
            sys.setprofile(None)
        assert found == ["refused"], "the control: the worker has died in the run"
        assert sim.digest() == digest_after(lattice(20, 20), 20, method="grid")
