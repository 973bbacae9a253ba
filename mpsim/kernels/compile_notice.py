"""The message while kernels are compiled, and the time that this takes.

Numba compiles a kernel silently, inside its first call with new types. A call of the compiler that the cache does not
answer is timed here, and announced once it has taken `QUIET_FOR`. A separate thread announces it, because a listener (a
log handler, for example) may wait for a lock that the compiling thread holds.
"""

# pyright: reportAttributeAccessIssue=false
# Types of Numba have attributes that it declares nowhere.

import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple, Protocol

from numba import types

logger = logging.getLogger("mpsim")

QUIET_FOR = 0.5
"""Seconds of compiling of which nothing is said: small kernels take less."""

PATIENCE = 1.0
"""Seconds to wait for an announcement that has begun: none that is well takes as long."""


class Cost(NamedTuple):
    """Seconds that compiling a kernel takes: of a bare scene, and more for each field of `Features` that it has."""

    what: str
    bare: float
    field: float = 0.0


LOOPS = "the loops for this scene"

COSTS = {
    "run_grid": Cost(LOOPS, 10.0, 1.3),
    "run_naive": Cost(LOOPS, 3.5, 0.7),
    "run_events": Cost(LOOPS, 3.0, 0.1),
}
"""By the kernel that Python calls: processor seconds with an empty cache, as measured on bare scenes and, for a field,
on named scenes (of the exact solver on one with friction), Intel Xeon, Python 3.11, numba 0.68."""


class Announcer(Protocol):
    """Tells people that something is being compiled."""

    def begin(self, text: str) -> None:
        """Say what is being compiled, and about how long it will take. Called by another thread."""
        ...

    def end(self) -> None:
        """Compilation has ended. Called only after `begin`."""
        ...


class LogLine:
    """One line in the log "mpsim": INFO, or WARNING if a person waits at a prompt or a terminal.

    So it is seen there without configuration, and a job without a terminal stays quiet.
    """

    def begin(self, text: str) -> None:
        """Log the text."""
        waited_for = hasattr(sys, "ps1") or (sys.stderr is not None and sys.stderr.isatty())
        logger.log(logging.WARNING if waited_for else logging.INFO, "mpsim: %s", text)

    def end(self) -> None:
        """Nothing more: reports tell how long it took."""


_announcer: Announcer | None = LogLine()

_lock = threading.Lock()
_spent = 0.0


def announce_by(announcer: Announcer | None) -> None:
    """Replace the announcer of this process; None: announce nothing."""
    global _announcer  # noqa: PLW0603 - one for the process, as is the compiler
    _announcer = announcer


@contextmanager
def announced_by(announcer: Announcer) -> Iterator[Announcer | None]:
    """`announce_by` for a block, which is given the announcer before."""
    before = _announcer
    announce_by(announcer)
    try:
        yield before
    finally:
        announce_by(before)


def compile_seconds() -> float:
    """Time that this process has spent on compiling kernels so far [s]."""
    return _spent


def announcement(kernel: str, signature: Any, kept: bool) -> str:
    """The text announced for the compilation of a kernel for such arguments; kept: whether its machine code is cached.

    >>> announcement("run_naive", (), True)
    'compiling the loops for this scene, once; about 4 s'
    """
    once = ", once" if kept else ""
    if kernel not in COSTS:
        return f"compiling a small kernel ({kernel}){once}"
    cost = COSTS[kernel]
    return f"compiling {cost.what}{once}; about {cost.bare + cost.field * _features_in(signature):.0f} s"


def _features_in(signature: Any) -> int:
    """How many fields of `Features` are present (not None) among the types of arguments."""
    records = (each for each in signature if isinstance(each, types.BaseNamedTuple))
    of_features = (each for each in records if each.instance_class.__name__.endswith("Features"))
    return sum(not isinstance(field, types.NoneType) for each in of_features for field in each.types)


class _Compilation(threading.local):
    """What this thread compiles: nesting depth of calls of the compiler, and the request of the outermost."""

    def __init__(self) -> None:
        self.depth = 0
        self.asked: tuple[str, Any, bool] = ("", (), False)
        self.started: float | None = None
        self.announcement: _Announcement | None = None


_mine = _Compilation()


class _Announcement:
    """An announcement that comes when compiling has taken QUIET_FOR."""

    def __init__(self, announcer: Announcer, text: str):
        self._announcer = announcer
        self._text = text
        self._begun = False
        self._timer = threading.Timer(QUIET_FOR, self._begin)
        self._timer.daemon = True
        self._timer.start()

    def _begin(self) -> None:
        self._begun = True
        self._announcer.begin(self._text)

    def end(self) -> None:
        """Compilation has ended."""
        self._timer.cancel()
        self._timer.join(PATIENCE)  # a process that forks next should not have this thread
        if self._begun:
            self._announcer.end()


@contextmanager
def asked_for(kernel: str, signature: Any, kept: bool) -> Iterator[None]:
    """Wraps each call of the compiler, for a kernel and the types of its arguments; such calls are nested."""
    global _spent  # noqa: PLW0603 - see compile_seconds
    if _mine.depth == 0:
        _mine.asked = kernel, signature, kept
    _mine.depth += 1
    try:
        yield
    finally:
        _mine.depth -= 1
        if _mine.depth == 0 and _mine.started is not None:
            with _lock:
                _spent += time.perf_counter() - _mine.started
            _mine.started = None
            if _mine.announcement is not None:
                _mine.announcement.end()
                _mine.announcement = None


def not_cached() -> None:
    """Called when a requested kernel is in no cache: from here on this thread compiles."""
    if _mine.started is None and _mine.depth:
        _mine.started = time.perf_counter()
        if _announcer is not None:
            with suppress(RuntimeError):  # the system allows no more threads
                _mine.announcement = _Announcement(_announcer, announcement(*_mine.asked))
