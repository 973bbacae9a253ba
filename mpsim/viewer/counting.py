"""Counts pressure and largest overlap for the gauges.

Counting needs another kernel and makes frames slower, so it runs only on request.
"""

import math
from typing import Any

import numpy as np

from mpsim.core.state import State
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError
from mpsim.measure import reference, temperature
from mpsim.measure.driving import has_body_force
from mpsim.measure.run_averages import checked
from mpsim.measure.statistics import ratio_average
from mpsim.scene.scene import Scene

FEWEST_FRAMES = 16
"""Least number of frames in a part of the run. The pressures of the parts are the samples of the mean."""

MOST_PARTS = 512
"""Largest number of parts; then each two of them are merged into one."""


class Counting:
    """Pressure and largest overlap since counting began, from the reports of many short runs.

    Attributes:
        wanted: whether they are to be counted.

    >>> counting = Counting()
    >>> counting.numbers()
    {'counting': False, 'pressure': nan, 'pressure_error': nan, 'largest_overlap': nan, 'pressure_note': None}
    """

    def __init__(self) -> None:
        self.wanted: bool = False
        self.forget()

    def forget(self) -> None:
        """Start afresh, for another run."""
        self._parts: list[tuple[float, int]] = []
        self._fewest = FEWEST_FRAMES
        self._overlap = math.nan
        self._note: str | None = None

    def measures(self, sim: Simulation) -> tuple[str, ...]:
        """Names of the measures for the next run."""
        names: list[str] = []
        for name in ("pressure", "largest_overlap") if self.wanted else ():
            try:
                names += checked(name, sim.scene, sim.count)
            except InputError as error:
                self._note = str(error) if name == "pressure" else self._note
        return tuple(names)

    def note(self, report: Report) -> None:
        """Add the report of a run."""
        found, frames = report.measures, report.frames
        if "pressure" in found and math.isfinite(found["pressure"].value):
            self._add(found["pressure"].value * frames, frames)
        if "largest_overlap" in found:
            self._overlap = float(np.fmax(self._overlap, found["largest_overlap"].value))

    def _add(self, total: float, frames: int) -> None:
        """Add frames to the last part, or begin a new one. total: sum of the pressure over these frames."""
        parts = self._parts
        if parts and parts[-1][1] < self._fewest:
            total, frames = total + parts[-1][0], frames + parts[-1][1]
            parts.pop()
        parts.append((total, frames))
        if len(parts) >= MOST_PARTS:
            self._parts = [(a + c, b + d) for (a, b), (c, d) in zip(parts[::2], parts[1::2], strict=True)]
            self._fewest *= 2

    def numbers(self) -> dict[str, Any]:
        """The numbers so far, by name: pressure [mass/time^2] and its standard error, overlap [diameters].

        The pressure is NaN until FEWEST_FRAMES frames and one collision are counted: zero would be no measurement.
        """
        value = error = math.nan
        totals, frames = np.array(self._parts, float).reshape(-1, 2).T
        if frames.sum() >= FEWEST_FRAMES and totals.any():
            found = ratio_average(totals, frames)
            value, error = found.value, found.error if found.settled else math.nan
        return {
            "counting": self.wanted,
            "pressure": value,
            "pressure_error": error,
            "largest_overlap": self._overlap,
            "pressure_note": self._note,
        }


def bulk_pressure(state: State, scene: Scene) -> float:
    """The pressure from the equation of state, at the packing and temperature of a state [mass/time^2].

    NaN where the equation does not hold: under gravity, for several sizes of discs, and above the packing of the fluid.

    >>> scene = Scene.random(count=100, packing=0.3, radius=0.5, seed=1)
    >>> ideal = 100 * temperature(State(scene.position, scene.velocity), scene) / (scene.width * scene.height)
    >>> round(bulk_pressure(State(scene.position, scene.velocity), scene) / ideal, 3)
    2.063
    """
    x_low, x_high, y_low, y_high = scene.box if state.box is None else state.box
    area, count = (x_high - x_low) * (y_high - y_low), int(state.present.sum())
    if has_body_force(scene) or scene.smallest_radius < scene.largest_radius:
        return math.nan
    try:
        packing = count * math.pi * scene.largest_radius**2 / area
        return count * temperature(state, scene) / area * reference.compressibility(packing)
    except InputError:
        return math.nan
