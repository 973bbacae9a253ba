"""What comes before NumPy and Numba are imported, which takes a second.

Refuses import in a subinterpreter: both keep state per process. NumPy only warns, or fails with a text of its own; the
first compiled kernel would then end the process. And Ctrl-C ends the command `mpsim` at once, without a traceback of
imports, until `ready_for_interrupts`.
"""

import importlib
import signal
import sys
import threading
from pathlib import Path
from typing import Any


def _in_main() -> bool:
    """Whether this is the main interpreter of the process; True if Python cannot tell."""
    for name in ("_interpreters", "_xxsubinterpreters"):  # from Python 3.13 on, and before
        try:
            interpreters: Any = importlib.import_module(name)
        except ImportError:
            continue
        return bool(interpreters.get_current() == interpreters.get_main())
    return True


if not _in_main():
    raise ImportError(
        "mpsim cannot be imported in a subinterpreter: NumPy and Numba, which it uses, belong to the main "
        "interpreter of a process. Use threads, each with a simulation of its own, or processes."
    )


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
