"""The registry of methods: what runs each, and which one `auto` stands for."""

import logging
from typing import NamedTuple

from mpsim.core.cores import may_start_processes, usable_cores
from mpsim.engine.notices import Notices
from mpsim.engine.solvers.base import Capabilities, Choice, Solver
from mpsim.engine.solvers.events import EventSolver
from mpsim.engine.solvers.grid import GridSolver
from mpsim.engine.solvers.naive import NaiveSolver
from mpsim.kernels.compiling import JIT_DISABLED
from mpsim.scene.settings import Settings


class Method(NamedTuple):
    """One line of the registry.

    Attributes:
        solver: class that runs the method.
        workers: whether it runs on as many processes as Settings.workers says; otherwise on one.
        phases: what it does in a phase, where that is not what the phase is called after.
    """

    solver: type[Solver]
    workers: bool = False
    phases: dict[str, str] = {}  # noqa: RUF012 - never changed


METHODS: dict[str, Method] = {
    "naive": Method(NaiveSolver, phases={"even columns": "pairs"}),
    "grid": Method(GridSolver),
    "parallel": Method(GridSolver, workers=True),
    "event": Method(EventSolver, phases={"move": "events"}),
}
"""Every method by its name in Settings; `auto` is one of AUTO."""

AUTO = ("naive", "grid", "parallel")
"""Methods among which `auto` chooses."""

NAIVE_UP_TO = 160
"""Discs up to which `auto` tests all pairs. A constant, not a measurement: naive and grid resolve contacts in different
orders, so the choice between them must depend on the scene alone for the bits to be the same on every machine."""

PARALLEL_FROM = 400
"""Discs from which `auto` starts workers, where there are cores for them. Then it measures whether they pay: it may,
because one worker or many give the same bits."""


def capabilities_of(settings: Settings) -> Capabilities:
    """What the method of these settings can do: of `auto`, what all of AUTO can."""
    names = AUTO if settings.method == "auto" else (settings.method,)
    each = [METHODS[name].solver.capabilities for name in names]
    return Capabilities(
        has_steps=all([one.has_steps for one in each]),
        is_exact=all([one.is_exact for one in each]),
    )


def choose(count: int, settings: Settings) -> Choice:
    """What runs `count` discs under these settings."""
    method = settings.method
    if method == "auto":
        method = "naive" if count <= NAIVE_UP_TO else "parallel" if count >= PARALLEL_FROM else "grid"
    if not METHODS[method].workers:
        return Choice(method, (1,))
    workers, remark = settings.workers or usable_cores(), ""
    if workers > 1 and not may_start_processes():
        remark = "mpsim: this process is daemonic and may not start others; running on one worker."
    elif workers > 1 and JIT_DISABLED:
        remark = "mpsim: without compilation there are no atomics to wait with; running on one worker."
    if remark:
        workers = 1
    if settings.method != "auto":
        return Choice(method, (workers,), remark)
    return Choice(method, (workers, 1)) if workers > 1 else Choice("grid", (1,), remark)


def same_solver(one: Choice, other: Choice) -> bool:
    """Whether one class of solvers runs both."""
    return METHODS[one.method].solver is METHODS[other.method].solver


def note_remark(choice: Choice, before: Choice | None, notices: Notices) -> None:
    """Log the remark of a choice, unless the one before had the same."""
    if choice.remark and (before is None or choice.remark != before.remark):
        notices.log(choice.remark, level=logging.INFO)


def what_ran(choice: Choice, best: int, settings: Settings) -> tuple[str, int]:
    """Method and workers for a report.

    Args:
        choice: what runs.
        best: of its numbers of workers, the fastest so far; `auto` may have found one to be faster than many.
        settings: as they were given.
    """
    alone = settings.method == "auto" and choice.method == "parallel" and best == 1
    return "grid" if alone else choice.method, best
