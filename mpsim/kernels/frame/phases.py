"""The phases of a frame: which one a worker is in, how long each has taken, and the barrier between two."""

from mpsim.kernels.compiling import linked
from mpsim.kernels.layout import WAIT
from mpsim.kernels.machine import now
from mpsim.kernels.waiting import barrier


@linked
def add_time(times, mine, phase, since):
    """Add the time since `since` to a phase of the current frame; returns the time now."""
    moment = now(mine.clock)
    times[mine.frame, phase] += moment - since
    return moment


@linked
def set_phase(mine, phase):
    """Note which phase this worker is in, for the report of a death."""
    mine.phase = phase


@linked
def wait_for_all(control, mine, times, since):
    """Barrier, its waiting time recorded. Returns the time now; the abort word says whether to continue."""
    if control.workers > 1:
        set_phase(mine, WAIT)
        barrier(control, mine)
        return add_time(times, mine, WAIT, since)
    return since
