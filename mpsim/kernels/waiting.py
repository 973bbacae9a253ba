"""Waiting for other processes, on words of the shared block: spin, then yield, then sleep. Every wait ends."""

from mpsim.kernels.compiling import compiled, linked
from mpsim.kernels.machine import atomic_add, atomic_load, atomic_store, now, pause, sleep_briefly, yield_core
from mpsim.kernels.records import ABORT, ARRIVED, COMMAND, IDLE, MAIL, MAILED, PATIENCE, RUNNING, STALLED

SPINS = 200
"""Polls before a waiting process gives its core away: about 4 microseconds, which covers the waits of an undisturbed
small frame. More would slow a frame where two workers share a core: the one that spins holds up the other."""

YIELDS = 3000
"""Calls of sched_yield between spinning and sleeping, about 1 ms. It must be far longer than a nap: otherwise one
worker's nap makes the other one wait long enough to nap too, and the two take turns for ever."""

NAP = 100_000
"""Nanoseconds of one sleep. Longer ones cost latency at a barrier, shorter ones CPU while somebody is suspended."""


@linked
def barrier(control, mine):
    """Wait until every worker has arrived equally often. Returns the abort word: 0 is success.

    One shared counter only increases: the k-th barrier is complete at k times the number of workers, so it needs no
    reset and no second phase. `mine` is this worker's row of `team`.
    """
    mine.arrivals += 1
    target = mine.arrivals * control.workers
    atomic_add(control.signals, ARRIVED, 1)
    polls = 0
    started = 0
    while atomic_load(control.signals, ARRIVED) < target:
        abort = atomic_load(control.signals, ABORT)
        if abort != RUNNING:
            return abort
        polls += 1
        if polls < SPINS:
            pause()
        elif polls < SPINS + YIELDS:
            yield_core()
        else:
            clock = mine.clock
            if started == 0:
                started = now(clock)
            elif now(clock) - started > PATIENCE:
                atomic_store(control.signals, ABORT, STALLED)
            sleep_briefly(clock, NAP)
    return atomic_load(control.signals, ABORT)


@linked
def next_command(control, mine, worker, linger):
    """Give the command, as worker 0, or wait for it, as any other. Returns RUNNING, or IDLE or MAILED: no command.

    linger: how long to wait [ns].
    """
    if worker == 0:
        if control.workers > 1:
            atomic_add(control.signals, COMMAND, 1)
        return RUNNING
    started, polls = now(mine.clock), 0
    while atomic_load(control.signals, COMMAND) == mine.commands and atomic_load(control.signals, MAIL) == mine.mails:
        polls += 1
        if polls < SPINS:
            pause()
        else:
            if now(mine.clock) - started > linger:
                return IDLE
            yield_core()
    if atomic_load(control.signals, COMMAND) == mine.commands:
        return MAILED
    mine.commands += 1
    return RUNNING


@compiled
def store_word(words, index, value):
    """`atomic_store` for callers in Python."""
    atomic_store(words, index, value)


@compiled
def load_word(words, index):
    """`atomic_load` for callers in Python."""
    return atomic_load(words, index)


@compiled
def add_to_word(words, index, value):
    """`atomic_add` for callers in Python."""
    return atomic_add(words, index, value)
