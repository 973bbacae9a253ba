"""Workers that die at random moments of a run, and runs that are repeated until some have."""

import functools
import os
import random
import signal
import threading

import pytest

import mpsim
from support.processes import is_gone


class Killer(threading.Thread):
    """Thread that kills one of the present workers every now and then, until told to stop; counts the deaths."""

    def __init__(self, sim, pause, most=10**9):
        super().__init__(daemon=True)
        self.deaths = 0
        self._sim, self._pause, self._most = sim, pause, most
        self._end = threading.Event()

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *exception):
        self._end.set()
        self.join()

    def run(self):
        while self.deaths < self._most and not self._end.wait(self._pause()):
            try:
                pids = [pid for pid in self._sim.pids if not is_gone(pid)]
                if pids:
                    os.kill(random.choice(pids), signal.SIGKILL)
                    self.deaths += 1
            except (ProcessLookupError, TypeError, ValueError, LookupError, mpsim.errors.ClosedError):
                continue  # it is being replaced at this moment


def often():
    return random.uniform(0.02, 0.25)


def repeat_until_killed(experiment, pause, least=1, **killer):
    """Call `experiment(killing)`, where `killing(sim)` is a Killer to enter, until so many died in it; their number.

    A quick machine may be done before the first pause is over: each attempt waits half as long as the one before.
    """
    for attempt in range(6):
        killers = []
        experiment(functools.partial(begin_killer, killers, pause, 0.5**attempt, killer))
        deaths = sum(killer.deaths for killer in killers)
        if deaths >= least:
            return deaths
    return pytest.fail("nobody has died, which tests nothing")


def begin_killer(killers, pause, part, settings, sim):
    killers.append(Killer(sim, lambda: part * pause(), **settings))
    return killers[-1]
