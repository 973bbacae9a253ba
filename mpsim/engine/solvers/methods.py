"""The registry of methods, and the method that `auto` chooses."""

import logging
from dataclasses import replace
from typing import NamedTuple, cast

from mpsim.core.checks import refusal
from mpsim.core.late import named
from mpsim.core.machine import may_start_processes, usable_cores
from mpsim.engine.access import Notices
from mpsim.engine.solvers.base import Choice, Processes, Solver
from mpsim.errors import InputError
from mpsim.kernels.compiling import JIT_DISABLED
from mpsim.scene.settings import MethodName, Settings


class Method(NamedTuple):
    """What can be known of a method before there is a solver.

    Attributes:
        solver: class that runs the method, by name: a simulation loads no other solver than its own.
        has_steps: frames are made of steps, so that a disc can be too fast for one: its solver has `Steps`. Without
            steps `dt` only says when frames end, and `contact`, `passes` and `substeps` change nothing.
        is_exact: its only error is rounding, so that other methods are compared with it.
        on_ranks: several processes make the same calls, each with a simulation of its own.
        workers: it runs on as many processes as Settings.workers says; otherwise on one.
        phases: what it does in a phase, where that is not what the phase is called after.
        by_columns: it resolves the columns of the grid in an even and an odd pass: all that do have the same bits.
    """

    solver: str
    has_steps: bool = True
    is_exact: bool = False
    on_ranks: bool = False
    workers: bool = False
    phases: dict[str, str] = {}  # noqa: RUF012 - never changed
    by_columns: bool = False


GRID, EVENTS = "mpsim.engine.solvers.grid:GridSolver", "mpsim.engine.solvers.events:EventSolver"

METHODS: dict[str, Method] = {
    "naive": Method(GRID, phases={"even columns": "pairs"}),
    "grid": Method(GRID, by_columns=True),
    "parallel": Method(GRID, workers=True, by_columns=True),
    "event": Method(EVENTS, has_steps=False, is_exact=True, workers=True, phases={"move": "events"}),
    "mpi": Method("mpsim.engine.solvers.ranks.solver:MpiSolver", on_ranks=True, by_columns=True),
}
"""Every method by its name in Settings; `auto` is one of AUTO."""

RANKS = "mpsim.engine.solvers.ranks.messages"  # the module that imports mpi4py, where ranks are asked for
AUTO = ("naive", "grid", "parallel")  # methods among which `auto` chooses

NAIVE_UP_TO = 160
"""Discs up to which `auto` tests all pairs. A constant, not a measurement: naive and grid resolve contacts in different
orders, so the choice between them must depend on the scene alone for the bits to be the same on every machine."""

PARALLEL_FROM = 200
"""Discs from which `auto` starts workers, where there are cores for them. Then it measures whether they pay: it may,
because one worker or many give the same bits."""


EVENT_FROM = 50_000
"""Discs from which the exact solver has a worker for each core unless something else is said."""


def solver_of(method: str) -> type[Solver]:
    """The class that runs a method."""
    return named(METHODS[method].solver)


def capabilities_of(settings: Settings) -> Method:
    """What the method of these settings can do; those of AUTO can do the same."""
    return METHODS[AUTO[0] if settings.method == "auto" else settings.method]


def on_ranks(method: str | None) -> bool:
    """Whether a method of this name runs on ranks."""
    return isinstance(method, str) and method in METHODS and METHODS[method].on_ranks


def in_one_process(settings: Settings, what: str) -> Settings:
    """The settings, refused if they need ranks; what: is to run with them, in words."""
    if capabilities_of(settings).on_ranks:
        rule = f"be one that runs in one process, as {what} does"
        raise refusal("method", rule, repr(settings.method), "Use 'grid', which has the same bits.")
    return settings


def check_processes(settings: Settings, processes: Processes) -> None:
    """Refuse a communicator that is none, and arguments that the method has no use for."""
    method, can = settings.method, capabilities_of(settings)
    if can.on_ranks:
        named(f"{RANKS}:ranks_of")(processes.comm)
        if settings.workers not in (None, 1):
            raise InputError(
                f"workers must be 1 with method={method!r}, where each rank is one process; got {settings.workers}. "
                "Leave it out, and start more ranks: mpiexec -n ..."
            )
        if processes.on_worker_death != "raise":
            raise InputError(
                f"on_worker_death must be 'raise' with method={method!r}; got {processes.on_worker_death!r}. Leave it "
                "out, or use method='parallel' on one machine."
            )
    elif processes.comm is not None:
        raise InputError(f"comm may be given only with method='mpi'; the method is {method!r}. Leave it out.")
    if processes.unguarded and (can.on_ranks or can.is_exact):
        raise InputError(f"method={method!r} cannot do unguarded=True. Leave it out, or use method='grid'.")


def choose(count: int, settings: Settings, processes: Processes = Processes()) -> Choice:  # noqa: B008 - immutable
    """What runs `count` discs under these settings."""
    method = settings.method
    if method == "auto":
        method = "naive" if count <= NAIVE_UP_TO else "parallel" if count >= PARALLEL_FROM else "grid"
    if on_ranks(method):
        return Choice(method, (named(f"{RANKS}:ranks_of")(processes.comm),), processes=processes)
    if not METHODS[method].workers:
        return Choice(method, (1,), processes=processes)
    workers = settings.workers or (1 if method == "event" and count < EVENT_FROM else usable_cores())
    remark = ""
    if workers > 1 and not may_start_processes():
        remark = "mpsim: this process is daemonic and may not start others; running on one worker."
    elif workers > 1 and JIT_DISABLED:
        remark = "mpsim: without compilation there are no atomics to wait with; running on one worker."
    if remark:
        workers = 1
    if settings.method != "auto":
        return Choice(method, (workers,), remark, processes)
    if workers > 1:
        return Choice(method, (workers, 1), processes=processes)
    return Choice("grid", (1,), remark, processes)


def settings_to_go_on(settings: Settings, method: str | None, workers: int | None) -> Settings:
    """Those of a checkpoint, a snapshot or a journal on other workers, and by a method that has the same bits."""
    saved, alike = settings.method, tuple(name for name, each in METHODS.items() if each.by_columns)
    if method is None:
        return replace(settings, workers=workers)
    if method != saved and (method not in alike or saved not in alike):
        auto = "'auto' may choose 'naive', which has other bits. " if "auto" in (saved, method) else ""
        raise InputError(
            f"method must be that of the checkpoint, {saved!r}, or both must be among {', '.join(map(repr, alike))}, "
            f"which have the same bits; got {method!r}. {auto}Leave it out."
        )
    return replace(settings, method=cast(MethodName, method), workers=workers)


def note_remark(choice: Choice, before: Choice | None, notices: Notices) -> None:
    """Log the remark of a choice, unless the one before had the same."""
    if choice.remark and (before is None or choice.remark != before.remark):
        notices.log(choice.remark, level=logging.INFO)
