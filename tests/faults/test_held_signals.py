"""Signals that were held back are handled afterwards, all of them, and by what handled them before."""

import signal

import pytest
from support.processes import assert_clean, run_script

from mpsim.core.deferred_signals import interrupts_held_back


def test_ctrl_c_that_was_held_back_is_not_lost_when_what_held_it_fails():
    def fail():
        with interrupts_held_back():
            signal.raise_signal(signal.SIGINT)
            raise ZeroDivisionError

    with pytest.raises(KeyboardInterrupt) as caught:
        fail()
    assert isinstance(caught.value.__context__, ZeroDivisionError)


def test_signals_that_were_held_back_are_all_handled_though_one_raises():
    def fail(number, frame):
        caught.append((number, frame is not None))
        raise ZeroDivisionError

    def hold():
        with interrupts_held_back():
            signal.raise_signal(signal.SIGUSR1)
            signal.raise_signal(signal.SIGUSR2)
            assert caught == []

    caught, numbers = [], (signal.SIGUSR1, signal.SIGUSR2)
    before = {number: signal.signal(number, fail) for number in numbers}
    try:
        with pytest.raises(ZeroDivisionError):
            hold()
        assert [signal.getsignal(number) for number in numbers] == [fail, fail]
    finally:
        for number in numbers:
            signal.signal(number, before[number])
    assert sorted(caught) == [(number, True) for number in numbers]


@pytest.mark.slow
def test_a_worker_that_is_started_while_signals_wait_has_them():
    """A fork server that started with SIGCHLD blocked, as a user handles it, would not tell of the end of a worker."""
    outcome = run_script(
        """
        import os, signal
        import mpsim, psutil
        from support.scenes import lattice, simulate

        signal.signal(signal.SIGCHLD, lambda *_: None)
        with simulate(lattice(20, 20), method="parallel", workers=2, on_worker_death="raise") as sim:
            print(psutil.Process(sim.pids[0]).ppid() != os.getpid())
            os.kill(sim.pids[0], signal.SIGKILL)
            try:
                sim.run(frames=10**6)
            except mpsim.WorkerDiedError as death:
                print(death.exitcode)
        """
    )
    assert_clean(outcome)
    assert outcome.out == "True\n-9\n"


def test_what_python_does_not_know_of_a_signal_comes_back_after_it_was_held_back(tmp_path):
    """The dump of faulthandler was lost at the first run, and calls were no longer restarted after the signal."""
    outcome = run_script(
        f"""
        import ctypes, faulthandler, signal
        from mpsim.core.deferred_signals import interrupts_held_back
        def action(number):
            found = ctypes.create_string_buffer(512)
            ctypes.CDLL(None).sigaction(number, None, found)
            return found.raw[:8], found.raw[136:140]  # the function and the flags; of the mask C sets a piece
        signal.signal(signal.SIGUSR1, lambda *_: print("handled"))
        signal.signal(signal.SIGUSR2, lambda *_: None)
        signal.siginterrupt(signal.SIGUSR2, False)
        file = open({str(tmp_path / "dump")!r}, "wb", buffering=0)
        faulthandler.register(signal.SIGUSR1, file=file, chain=True)
        before = action(signal.SIGUSR1), action(signal.SIGUSR2)
        with interrupts_held_back():
            assert (action(signal.SIGUSR1), action(signal.SIGUSR2)) != before
        assert (action(signal.SIGUSR1), action(signal.SIGUSR2)) == before
        signal.raise_signal(signal.SIGUSR1)
        file.close()
    """,
        warm=True,
    )
    assert_clean(outcome)
    assert outcome.out.split() == ["handled"]
    assert (tmp_path / "dump").stat().st_size
