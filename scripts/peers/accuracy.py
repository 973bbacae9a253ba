"""The longest step at which an engine's pressure has at most a given error, and its cost.

The pressure is the impulse on the walls over time and perimeter, of runs of TIME from several starts; its error is
relative to that of mpsim's exact solver from the same starts. Nothing is divided by the energy that an engine has left:
what it loses is in its error. The scatter between starts gives the standard error.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from peers.client import Client, FailedError
from peers.engine import Start

LIMITS = (0.01, 0.1)
"""Errors of the pressure that are asked for, relative."""

STEPS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
"""Steps that are tried, v dt [diameters]."""

TIME = 20.0
"""Length of a run [diameters / v]."""

SETTLE = 1.0
"""Time before it: soft discs must first share their energy with their springs [diameters / v]."""

EXACT_LONGER = 5
"""So many times longer are the runs of the exact solver, whose error must be the smaller."""

LEAST_STARTS = 3
"""Fewer finished runs give no error bar, and no answer."""


@dataclass(frozen=True)
class Point:
    """One engine at one step.

    Attributes:
        dt: step [diameters / v].
        knob: the engine's setting of effort.
        pressure: mean over the starts [mass / time^2].
        scatter: its standard error.
        drift: relative change of the kinetic energy per unit of time, mean over the starts.
        starts: how many were run in the time there was.
    """

    dt: float
    knob: int
    pressure: float
    scatter: float
    drift: float
    starts: int

    def error(self, exact: "Point") -> float:
        """Relative error of the pressure."""
        return self.pressure / exact.pressure - 1

    def uncertainty(self, exact: "Point") -> float:
        """Standard error of `error`."""
        return math.hypot(self.scatter, exact.scatter) / exact.pressure


def drift_per_time(first: float, last: float, duration: float) -> float:
    """Relative change of an energy per unit of time, were it always the same: exp(rate) - 1."""
    return math.expm1(math.log(max(last, 1e-300) / first) / duration)


def one_run(client: Client, path: Path, dt: float, knob: int, longer: float, budget: float) -> tuple[float, float]:
    """Pressure and drift of a run from one start."""
    start = Start.load(path)
    client.prepare(path, dt, budget + 60, counting=True, knob=knob)
    client.run(max(1, round(SETTLE / dt)), 3 * budget + 60)
    before, frames = client.ask("measure", budget + 60), round(TIME * longer / dt)
    client.run(frames, 3 * budget + 60)
    after, duration = client.ask("measure", budget + 60), frames * dt
    pressure = (after["impulse"] - before["impulse"]) / duration / (2 * (start.width + start.height))
    return pressure, drift_per_time(before["energy"], after["energy"], duration)


def point(client: Client, paths: Sequence[Path], dt: float, knob: int, budget: float, longer: float = 1) -> Point:
    """Pressure and drift of an engine at one step, of as many starts as `budget` seconds allow.

    Raises:
        FailedError: if the engine fails, or has finished fewer than LEAST_STARTS in that time.
    """
    client.prepare(paths[0], dt, budget + 60, counting=True, knob=knob)
    client.run(1, budget + 60)  # what is to be compiled is not of the budget
    found, begun = [], time.monotonic()
    for path in paths:
        found.append(one_run(client, path, dt, knob, longer, budget))
        if (time.monotonic() - begun) * (1 + 1 / len(found)) > budget:
            break
    if len(found) < LEAST_STARTS:
        raise FailedError(f"{budget:.0f} s were enough for {len(found)} of {LEAST_STARTS} runs at v·dt = {dt:g}")
    pressure, drift = np.array(found).T
    scatter = float(pressure.std(ddof=1)) / math.sqrt(len(found))
    return Point(dt, knob, float(pressure.mean()), scatter, float(drift.mean()), len(found))


def series(ask: Callable[[float], Point], steps: Sequence[float], exact: Point) -> tuple[list[Point], str]:
    """Points at ever shorter steps, until two in turn are within the least limit; and why it ended early, or ""."""
    found: list[Point] = []
    for dt in steps:
        try:
            found.append(ask(dt))
        except FailedError as failed:
            return found, str(failed)
        if all(abs(each.error(exact)) <= min(LIMITS) for each in found[-2:]) and len(found) > 1:
            break
    return found, ""


def longest(points: Sequence[Point], exact: Point, limit: float) -> Point | None:
    """The point of the longest step that is within the limit with all shorter ones that were tried."""
    answer = None
    for each in sorted(points, key=lambda each: each.dt):
        if abs(each.error(exact)) > limit:
            break
        answer = each
    return answer


def cost_per_time(seconds_per_frame: float, discs: int, dt: float) -> float:
    """Nanoseconds per disc and unit of time, diameters / v."""
    return seconds_per_frame * 1e9 / discs / dt
