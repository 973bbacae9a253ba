"""Pauses garbage collection while very many objects are created."""

import contextlib
import gc
from collections.abc import Generator


@contextlib.contextmanager
def garbage_collection_paused() -> Generator[None]:
    """Pause garbage collection: for a million objects that all stay it would take four fifths of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
