"""Very many objects made at once."""

import contextlib
import gc
from collections.abc import Generator


@contextlib.contextmanager
def garbage_collection_paused() -> Generator[None]:
    """No search for garbage meanwhile: of a million objects that all stay it takes four fifths of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
