"""Refuses import in a subinterpreter, before NumPy and Numba are imported: they keep state per process.

NumPy only warns, or fails with a text of its own; the first compiled kernel would then end the process.
"""

import importlib
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
