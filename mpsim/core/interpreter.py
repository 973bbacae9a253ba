"""What comes before NumPy and Numba are imported, which takes a second.

Ctrl-C ends the command `mpsim` at once, without a traceback of imports, until `ready_for_interrupts`.
"""

import signal
import sys
import threading
from pathlib import Path


def _is_command() -> bool:
    """Whether this process is the command `mpsim`, in which nothing but the import goes on yet."""
    handled = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    alone = threading.current_thread() is threading.main_thread()
    return handled and alone and Path(*sys.argv[:1]).name == "mpsim"


def ready_for_interrupts() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again, once the command is imported and catches it."""
    if _ends_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)


_ends_at_once = _is_command()
if _ends_at_once:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
