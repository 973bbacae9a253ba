"""Settings: how a scene is simulated; and what a scene recommends."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, get_args

from mpsim.core import checks
from mpsim.core.late import view
from mpsim.errors import InputError
from mpsim.kernels import records

# --- Settings: how a scene is simulated

MethodName = Literal["naive", "grid", "parallel", "event", "mpi", "auto"]
Law = Literal["elastic", "reflect"]
Contact = Literal["impact", "push"]
Precision = Literal["float32", "float64"]
OnFast = Literal["warn", "substep", "error"]

METHODS: tuple[MethodName, ...] = get_args(MethodName)
LAWS = tuple(records.LAWS)
CONTACTS = tuple(records.CONTACTS)
PRECISIONS: tuple[Precision, ...] = get_args(Precision)
ON_FAST: tuple[OnFast, ...] = get_args(OnFast)

MOST_WORKERS = 1024
"""More worker processes than this is taken for a mistake: no machine that mpsim runs on has so many cores."""


@dataclass(frozen=True)
class Settings:
    """How a scene is simulated: speed against accuracy. Checked when made; immutable.

    Args:
        dt: time of one frame [time], > 0. A disc should move less than its radius in one step.
        method: "naive" tests all pairs; "grid" uses cells and one process; "parallel" uses cells and several processes;
            "auto" takes the fastest of these for the scene and this machine. "event" is the exact, event-driven solver,
            which ignores contact, passes and substeps. "mpi" is "grid" on the ranks of MPI, with the same bits.
        workers: number of processes that compute, the coordinator included, 1 to 1024; None: one per core that this
            process may use (affinity and container quota); "event" uses several from 50,000 discs on. Never changes the
            result.
        law: "elastic" is the physical law: only approaching discs collide; momentum is conserved, and energy unless a
            restitution is below 1. "reflect", the law of the term-project report, reverses the component of each
            velocity along the line through the centres.
        contact: "impact" moves overlapping discs back to the time at which they touched, applies the law there, and
            moves them on for the rest of the step: second order in dt. "push", as in the report, moves each disc by
            half the overlap, and applies the law at the end of the frame: first order, and 10 % cheaper.
        passes: number of searches for contacts in one step, >= 1. A second search finds collisions that the first ones
            cause.
        substeps: steps of dt / substeps in each frame, >= 1.
        precision: "float32" (the report's) or "float64".
        on_fast: what to do when a disc moves farther in a step than its own radius, so that discs may pass through each
            other, or collides more than once in a step on average: "warn" (FastWarning, once), "error" (TooFastError),
            or "substep": divide frames into so many steps that every disc moves less than half its radius in each. The
            number is chosen every 16 frames, and after any frame in which a disc was fast, from the state alone. The
            frame in which a disc becomes fast is finished first. Discs pressed into each other by lack of room are
            reported in the same way; sub-steps do not help there. See docs/stability.md.
        contact_time: prevents inelastic collapse in "event" [time], > 0: an impact within this time after the previous
            impact of a disc loses no energy, so a disc at rest makes bounces of this duration. None: a millionth of the
            time in which a typical disc moves by the smallest radius. If discs come to rest, a longer contact time is
            faster, and less exact; in gravity g at most sqrt(8 radius / g), with which a bounce is as high as the
            radius of the smallest disc. The other methods need none.

    Raises:
        InputError: naming the setting, its rule and the value received.

    >>> Settings(dt=0.02, law="reflect").substeps
    1
    >>> Settings(method="gird")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    mpsim.InputError: method must be one of 'naive', 'grid', ... got 'gird'. Did you mean 'grid'?
    """

    dt: float = 0.01
    method: MethodName = "auto"
    workers: int | None = None
    law: Law = "elastic"
    contact: Contact = "impact"
    passes: int = 1
    substeps: int = 1
    precision: Precision = "float64"
    on_fast: OnFast = "warn"
    contact_time: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "dt", checks.positive("dt", self.dt, "[time]"))
        checks.choice("method", self.method, METHODS)
        checks.choice("law", self.law, LAWS)
        checks.choice("contact", self.contact, CONTACTS)
        checks.choice("precision", self.precision, PRECISIONS)
        checks.whole("substeps", self.substeps, 1, 1_000_000, "Use dt for the frame and substeps to divide it.")
        checks.whole("passes", self.passes, 1, 1000, "1 or 2 will do for most scenes.")
        if self.workers is not None:
            remedy = "Leave it out to use every core that this process may use."
            checks.whole("workers", self.workers, 1, MOST_WORKERS, remedy)
        checks.choice("on_fast", self.on_fast, ON_FAST)
        if self.contact_time is not None:
            object.__setattr__(self, "contact_time", checks.positive("contact_time", self.contact_time, "[time]"))


# --- What a scene recommends for runs of it: length, settings, pictures and what to measure

NAMES = ("duration", "settings", "picture_interval", "measures")
"""Arguments of Scene that are recommendations: they are no part of its digest."""


def check_recommended(
    duration: Any, settings: Any, picture_interval: Any, measures: Iterable[str] | str
) -> dict[str, Any]:
    """The recommendations that were given, checked."""
    found: dict[str, Any] = {"duration": None if duration is None else checks.positive("duration", duration, "[time]")}
    if settings is not None:
        found["settings"] = check_settings(settings)
    if picture_interval is not None:
        found["picture_interval"] = checks.positive("picture_interval", picture_interval, "[time]")
    if not isinstance(measures, Iterable):
        raise InputError(f"measures must be names of measures; got {checks.brief(measures)}.")
    if names := (measures,) if isinstance(measures, str) else tuple(measures):
        known = view("measure_names")
        found["measures"] = tuple(checks.choice("measures", name, known) for name in names)
    return found


def check_settings(settings: object) -> Settings:
    """The settings, refused if they are none."""
    if not isinstance(settings, Settings):
        raise InputError(f"settings must be mpsim.Settings; got {type(settings).__name__}. Use Settings(dt=...).")
    return settings
