"""Who gets a warning or a line of the log may wait for a thread that reads the simulation, or make an error of it."""

import logging
import os
import signal
import threading
import warnings

import pytest
from support.scenes import digest_after, lattice, simulate

import mpsim
from mpsim.engine.solvers import methods

PATIENCE = 20
"""Seconds after which a reader counts as kept out."""


def blocked(method="grid"):
    """An emitter whose place is occupied before frame 5, and free later."""
    emitter = mpsim.Emitter((2.0, 2.0), (50.0, 0.0), every=5)
    scene = mpsim.Scene(
        width=20, height=10, position=[(2.0, 2.0)], velocity=[(0.0, 20.0)], radius=0.1, emitters=[emitter]
    )
    return simulate(scene, method=method, dt=0.0008)


class Waiting:
    """Waits, each time that it is called, for a thread that reads; `frames` is what it has read."""

    def __init__(self, sim):
        self.frames, self.calls, self._sim = [], 0, sim

    def __call__(self, *given, **named):
        self.calls += 1
        thread = threading.Thread(target=lambda: self.frames.append(self._sim.frame), daemon=True)
        thread.start()
        thread.join(PATIENCE)


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_hook_of_warnings_may_wait_for_a_reader(method, monkeypatch):
    """The warning was given while the run held the simulation: a deadlock."""
    with blocked(method) as sim, warnings.catch_warnings():
        warnings.simplefilter("always")
        hook = Waiting(sim)
        monkeypatch.setattr(warnings, "showwarning", hook)
        sim.run(frames=50)
        assert hook.calls == len(hook.frames) == 1


def test_a_hook_of_a_warning_for_what_is_added_may_wait_for_a_reader(monkeypatch):
    with simulate(lattice(9, 9), method="grid", dt=0.01) as sim, warnings.catch_warnings():
        warnings.simplefilter("always")
        hook = Waiting(sim)
        monkeypatch.setattr(warnings, "showwarning", hook)
        sim.add((1.2, 1.2), (1000.0, 0.0))
        assert hook.calls == len(hook.frames) == 1


def test_a_handler_of_the_log_may_wait_for_a_reader():
    with simulate(lattice(12, 12), method="parallel", workers=2, on_worker_death="restart") as sim:
        handler = logging.Handler()
        handler.emit = Waiting(sim)
        logging.getLogger("mpsim").addHandler(handler)
        try:
            sim.run(frames=5)
            os.kill(sim.pids[0], signal.SIGKILL)
            sim.run(frames=50)
        finally:
            logging.getLogger("mpsim").removeHandler(handler)
        assert handler.emit.calls == len(handler.emit.frames) >= 1
        assert sim.digest() == digest_after(lattice(12, 12), 55, method="grid")


def test_a_handler_of_the_log_may_wait_for_a_reader_when_emitters_bring_discs_enough_for_workers(monkeypatch, caplog):
    """The line that a daemonic process has none was written while the run held the simulation, at each disc."""
    for name, value in {"NAIVE_UP_TO": 0, "PARALLEL_FROM": 2}.items():
        monkeypatch.setattr(methods, name, value)
    monkeypatch.setattr(methods, "usable_cores", lambda: 2)
    monkeypatch.setattr(methods, "may_start_processes", lambda: False)
    logger = logging.getLogger("mpsim")
    caplog.set_level(logging.INFO, logger="mpsim")
    with blocked("auto") as sim, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        handler = logging.Handler()
        handler.emit = Waiting(sim)
        logger.addHandler(handler)
        try:
            sim.run(frames=60)
        finally:
            logger.removeHandler(handler)
        assert sim.count > 3
        assert handler.emit.calls == len(handler.emit.frames) == 1, "once, not at each disc"


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_warning_that_is_an_error_ends_the_run_at_the_end_of_a_frame_and_changes_no_bit(method):
    with blocked(method) as sim, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sim.run(frames=50)
        undisturbed = sim.count, sim.digest()
    assert undisturbed[0] > 1, "the control: discs have entered"
    with blocked(method) as sim:
        with pytest.raises(mpsim.errors.EmitterWarning, match="occupied before frame 5"):
            sim.run(frames=50)
        assert 5 <= sim.frame < 50
        with pytest.raises(mpsim.errors.EmitterWarning):  # it was not given: an error came in its place
            sim.run(frames=50 - sim.frame)
        assert sim.frame < 50
        with pytest.warns(mpsim.errors.EmitterWarning) as given:
            sim.run(frames=50 - sim.frame)
        assert (sim.count, sim.digest()) == undisturbed
        assert len(given) == 1


def test_nothing_is_added_as_often_as_the_warning_of_it_is_an_error():
    """The second time the disc was added without a word."""
    fast = (1.2, 1.2), (1000.0, 0.0)
    with simulate(lattice(9, 9), method="grid", dt=0.01) as sim:
        for _ in range(2):
            with pytest.raises(mpsim.FastWarning):
                sim.add(*fast)
            assert sim.count == 81
        with warnings.catch_warnings(record=True) as given:
            warnings.simplefilter("always")
            sim.add(*fast)
            sim.add((2.4, 1.2), (1000.0, 0.0))
            sim.run(frames=5)
        assert (sim.count, len(given)) == (83, 1), "once it has been given it is not given again"


@pytest.mark.long
def test_a_run_ends_as_often_as_the_warning_of_a_fast_disc_is_an_error_and_changes_no_bit():
    def fast():
        """A disc that falls through a periodic box: too fast from frame 500 on."""
        scene = mpsim.Scene(
            width=20, height=20, position=[(4.0, 10.0)], velocity=[(0.0, 0.0)], radius=0.1, gravity=(0.0, -2.0),
            boundary="periodic",
        )  # fmt: skip
        return simulate(scene, method="grid", dt=0.01)

    with fast() as sim, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sim.run(frames=600)
        undisturbed = sim.digest()
    with fast() as sim:
        for _ in range(3):
            before = sim.frame
            with pytest.raises(mpsim.FastWarning, match="in frame"):
                sim.run(frames=600)
            assert before < sim.frame < 510
        with pytest.warns(mpsim.FastWarning) as given:
            sim.run(frames=600 - sim.frame)
        assert (sim.digest(), len(given)) == (undisturbed, 1)


def test_a_warning_of_what_is_resumed_has_its_place_where_resume_is_called(tmp_path):
    """Its place was inside mpsim, where Python by default does not show it twice, whoever resumes."""
    scene = mpsim.Scene(width=8000, height=8000, position=[(9.0, 9.0)], velocity=[(1.0, 0.0)], radius=0.5)
    with simulate(scene, method="grid", dt=0.1, precision="float32") as sim:
        path = sim.save(tmp_path / "run.mpsim")
    with pytest.warns(mpsim.errors.ResolutionWarning) as given:
        mpsim.Simulation.resume(path).close()
    assert [each.filename for each in given] == [__file__]
