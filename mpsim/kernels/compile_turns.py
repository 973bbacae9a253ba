"""If several processes need the same kernel, one compiles it; the others wait and load the result.

Otherwise ranks and runs that start together would each compile it, on cores that the others need. The system's lock
(`flock`) ends with its process. A fork may keep it longer, so no process waits longer than LONGEST.
"""

import fcntl
import hashlib
import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

LONGEST = 60.0
"""Seconds to wait for another process; then a kernel is compiled twice, which does no harm."""

STEP = 0.02
"""Seconds between two looks at the lock."""


class Turns:
    """Turns of compiling one function, for each signature of its own.

    Args:
        folder: of the cache; the lock files lie in it.
        name: of the function, unique.
    """

    def __init__(self, folder: Path, name: str):
        self._stem = folder / f"{hashlib.sha256(name.encode()).hexdigest()[:16]}"
        self._held: dict[str, int] = {}

    def load_or_take(self, signature: Any, load: Callable[[], Any]) -> Any:
        """What `load` finds in the cache, perhaps from another process; None: compile it, then `give_back`."""
        key = hashlib.sha256(str(signature).encode()).hexdigest()[:16]
        path = self._stem.with_name(f"{self._stem.name}-{key}.lock")
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError:  # a read-only cache
            return None
        if not _locked(descriptor):
            os.close(descriptor)
            return None
        found = load()
        if found is None:
            self._held[key] = descriptor
        else:
            os.close(descriptor)
        return found

    def give_back(self) -> None:
        """Release the lock: the function is compiled, or could not be."""
        while self._held:
            _, descriptor = self._held.popitem()
            with suppress(OSError):
                os.close(descriptor)


def _locked(descriptor: int) -> bool:
    """Wait for the lock, at most LONGEST; False: it could not be taken."""
    end = time.monotonic() + LONGEST
    while time.monotonic() < end:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(STEP)
        except OSError:  # a file system without locks
            return False
        else:
            return True
    return False
