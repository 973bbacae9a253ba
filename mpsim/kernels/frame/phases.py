"""The phases of a frame: which one a worker is in, how long each has taken, and the barrier between two."""

from mpsim.kernels.compiling import linked
from mpsim.kernels.layout import WAIT
from mpsim.kernels.machine import now
from mpsim.kernels.waiting import barrier


@linked
def add_time(times, mine, phase, since):
    """Add the time since `since` to a phase of the current frame. Returns the time now."""
    moment = now(mine.clock)
    times[mine.frame, phase] += moment - since
    return moment


@linked
def set_phase(mine, phase):
    """Record which phase this worker is in, for the message if it dies."""
    mine.phase = phase


@linked
def wait_for_all(control, mine, times, since):
    """Barrier that records its waiting time. Returns the time now, and the abort word."""
    if control.workers > 1:
        set_phase(mine, WAIT)
        barrier(control, mine)
        return add_time(times, mine, WAIT, since)
    return since
