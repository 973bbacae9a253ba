"""Makes Python's fork server import what workers need, without effect on other processes.

The server is started while Ctrl-C is blocked, so that workers come up with it blocked: a start prints no traceback.
Processes of the program that the server starts later must not inherit that.
"""

import multiprocessing.util
import signal
from multiprocessing.process import current_process

from mpsim.engine.workers.worker import NAME


def _unblock(_: object) -> None:
    """In a process that the server has started: Ctrl-C comes through unless it is a worker."""
    if not current_process().name.startswith(NAME):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


multiprocessing.util.register_after_fork(_unblock, _unblock)
