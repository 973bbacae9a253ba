"""Motions of obstacles: their places and velocities as functions of time. Checked when made; immutable."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.errors import InputError
from mpsim.kernels.features import bodies
from mpsim.kernels.geometry import ENDS, RADIUS, ROW

TURN = 2 * math.pi


@dataclass(frozen=True, kw_only=True)
class Movement:
    """A motion of an obstacle, which is where it was given until the time `start`. Use one of the classes below.

    Args:
        start: time of the run at which the motion begins [time].
    """

    start: float = 0.0

    def __post_init__(self) -> None:
        checks.keep_fields(self, start=checks.finite)

    def seen_from(self, time: float) -> Movement:
        """The same motion, where the clock is set to 0 at a time of the run."""
        return replace(self, start=self.start - time)

    def capsules_at(self, capsules: Floats, time: float) -> Floats:
        """Where capsules are at a time of the run."""
        body, knots = self.body()
        pose = bodies.pose_at(body, knots, time)
        ends = [bodies.out_of_frame(body, pose, *capsules[:, first : first + 2].T) for first in (0, 2)]
        moved = capsules.copy()
        moved[:, ENDS] = np.column_stack([*ends[0], *ends[1]])
        return moved

    def body(self) -> tuple[Any, Floats]:
        """A record of the kernels with the motion, of dtype BODY, and the rows of its path, shape (P, 3)."""
        record = np.zeros(1, bodies.BODY)[0]
        record.start, record.stop, record.fastest = self.start, math.inf, self.fastest(np.zeros((0, ROW)))
        knots = self._fill(record)
        return record, np.zeros((0, 3)) if knots is None else knots

    def _fill(self, record: Any) -> Floats | None:
        """Write the motion into a record; the rows of a path are returned."""
        raise NotImplementedError

    def fastest(self, capsules: Floats) -> float:
        """The highest speed of a point of capsules [length/time]."""
        raise NotImplementedError

    def swept(self, points: Floats) -> tuple[Floats, Floats]:
        """Lower left and upper right corner (x, y) of where points, shape (K, 2), are at any time [length]."""
        ways = self._displacements()
        return points.min(axis=0) + ways.min(axis=0), points.max(axis=0) + ways.max(axis=0)

    def _displacements(self) -> Floats:
        """Displacements (x, y) between which all others lie, shape (P, 2) [length]."""
        raise NotImplementedError


def _moving(name: str, value: object, check: Callable[[str, Any], Any] = checks.point, rest: object = (0, 0)) -> Any:
    """A number or pair of a motion, which `rest` would not be."""
    if (found := check(name, value)) == rest:
        raise InputError(f"{name} must not be {rest}. Leave the motion out of what is at rest.")
    return found


@dataclass(frozen=True)
class Translation(Movement):
    """A motion along a straight line at constant speed, such as that of a lid that closes.

    Args:
        velocity: (x, y) [length/time], not (0, 0).
        stop: distance after which it comes to rest [length], > 0; None: never.
        start: time of the run at which it begins [time].

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Translation((0, -0.5), stop=3)
    Translation(start=0.0, velocity=(0.0, -0.5), stop=3.0)
    """

    velocity: ArrayLike
    stop: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.keep_fields(self, velocity=_moving, stop="[length]")

    def _fill(self, record: Any) -> None:
        record.kind, record.vector[:] = bodies.TRANSLATION, self.velocity
        record.stop = math.inf if self.stop is None else self.stop / record.fastest

    def fastest(self, capsules: Floats) -> float:
        return float(np.hypot(*np.asarray(self.velocity)))

    def _displacements(self) -> Floats:
        velocity = np.asarray(self.velocity)
        with np.errstate(invalid="ignore"):
            way = velocity * (math.inf if self.stop is None else self.stop / np.hypot(*velocity))
        way[velocity == 0] = 0
        return np.array([np.zeros(2), way])


@dataclass(frozen=True)
class Oscillation(Movement):
    """A harmonic oscillation about where the obstacle was given: displacement amplitude sin(2 pi t / period + phase).

    Args:
        amplitude: (x, y) [length], not (0, 0).
        period: [time], > 0.
        phase: [radians]; until `start`, the obstacle is displaced by amplitude sin(phase).
        start: time of the run at which it begins, from which t counts [time].

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Oscillation((0, 0.2), period=0.5).period
    0.5
    """

    amplitude: ArrayLike
    period: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.keep_fields(self, amplitude=_moving, period="[time]", phase=checks.finite)

    def _fill(self, record: Any) -> None:
        record.kind, record.vector[:] = bodies.OSCILLATION, self.amplitude
        record.rate, record.phase = 1 / self.period, self.phase / TURN
        record.bend = record.fastest * TURN / self.period

    def fastest(self, capsules: Floats) -> float:
        return float(np.hypot(*np.asarray(self.amplitude))) * TURN / self.period

    def _displacements(self) -> Floats:
        return np.multiply.outer((-1.0, 1.0), np.asarray(self.amplitude))


@dataclass(frozen=True)
class Rotation(Movement):
    """A rotation at constant rate, such as that of a drum, a rotor or a flipper.

    Args:
        centre: (x, y) about which it turns [length].
        rate: angular velocity, counter-clockwise [radians/time], not 0.
        stop: angle after which it comes to rest [radians], > 0; None: never.
        start: time of the run at which it begins [time].

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Rotation((10, 10), rate=0.4).centre
    (10.0, 10.0)
    """

    centre: ArrayLike
    rate: float
    stop: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        turning = partial(_moving, check=checks.finite, rest=0)
        checks.keep_fields(self, centre=checks.point, rate=turning, stop="[radians]")

    def _fill(self, record: Any) -> None:
        record.kind, record.vector[:], record.rate = bodies.ROTATION, self.centre, self.rate / TURN
        record.stop = math.inf if self.stop is None else self.stop / abs(self.rate)

    def fastest(self, capsules: Floats) -> float:
        ends = capsules[:, ENDS].reshape(-1, 2, 2) - np.asarray(self.centre)
        far = np.hypot(*np.moveaxis(ends, 2, 0)) + np.abs(capsules[:, RADIUS, None])
        return abs(self.rate) * float(far.max(initial=0.0))

    def swept(self, points: Floats) -> tuple[Floats, Floats]:
        centre = np.asarray(self.centre)
        arm = points - centre
        reach, begin = np.hypot(*arm.T), np.arctan2(arm[:, 1], arm[:, 0])
        angle = TURN if self.stop is None else min(self.stop, TURN)
        # Ends of the arcs, and where they cross an axis: there x or y is extreme.
        first = begin if self.rate > 0 else begin - angle
        quarters = math.pi / 2 * (np.ceil(first / (math.pi / 2))[:, None] + np.arange(5))
        angles = np.column_stack([first, first + angle, np.minimum(quarters, first[:, None] + angle)])
        places = reach[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=2) + centre
        return places.min(axis=(0, 1)), places.max(axis=(0, 1))


@dataclass(frozen=True)
class Path(Movement):
    """A motion by a table of times and displacements, straight and at constant speed between them.

    Args:
        times: since `start`, ascending, shape (K,), K >= 2 [time]. Before the first, and after the last, it is at rest.
        displacements: (x, y) from where the obstacle was given, shape (K, 2) [length].
        start: time of the run from which `times` count [time].

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Path(times=[0, 1, 2], displacements=[(0, 0), (1, 0), (0, 0)]).times
    (0.0, 1.0, 2.0)
    """

    times: ArrayLike
    displacements: ArrayLike

    def __post_init__(self) -> None:
        super().__post_init__()
        times = checks.finite_array("times of a Path", self.times, (None,), "(K,)")
        if len(times) < 2 or (np.diff(times) <= 0).any():
            got = checks.brief(self.times)
            raise InputError(f"times of a Path must be at least two, each later than the last; got {got}. Sort them.")
        shape = (len(times), 2)
        places = checks.finite_array("displacements of a Path", self.displacements, shape, f"{shape}")
        object.__setattr__(self, "times", tuple(times.tolist()))
        object.__setattr__(self, "displacements", tuple((x, y) for x, y in places.tolist()))

    def _fill(self, record: Any) -> Floats:
        table = np.column_stack([np.asarray(self.times), np.asarray(self.displacements)])
        record.kind, record.knots[:], record.stop = bodies.PATH, (0, len(table)), table[-1, 0]
        return table

    def fastest(self, capsules: Floats) -> float:
        ways = np.hypot(*np.diff(np.asarray(self.displacements), axis=0).T)
        return float((ways / np.diff(np.asarray(self.times))).max())

    def _displacements(self) -> Floats:
        return np.asarray(self.displacements)


MOTIONS: tuple[type[Movement], ...] = (Translation, Oscillation, Rotation, Path)


def check_kind(name: str, motion: Any, kinds: tuple[type[Movement], ...] = MOTIONS) -> Movement:
    """A motion exactly of one of the kinds: the kernels move a subclass as they move its base."""
    if type(motion) not in kinds:
        names = ", ".join(f"mpsim.{kind.__name__}" for kind in kinds)
        remedy = "Use that class itself, not a subclass." if isinstance(motion, kinds) else "Use one of them."
        raise InputError(f"{name} must be one of {names}; got {type(motion).__name__}. {remedy}")
    return motion
