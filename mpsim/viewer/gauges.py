"""The gauges beside the picture: measures of the present state, rates, pressure, overlap, collisions."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim import measure
from mpsim.core.state import State
from mpsim.engine.observers import Collisions
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError
from mpsim.features.feature import adds_discs, has_losses, removes_discs
from mpsim.measure.observables import has_periodic_field, is_heated
from mpsim.measure.registry import refusal
from mpsim.measure.statistics import Measure, ratio_average
from mpsim.scene.scene import Scene

# --- Pressure

FEWEST_FRAMES = 16
"""Least number of frames in a part of the run. The pressures of the parts are the samples of the mean."""

MOST_PARTS = 512  # largest number of parts; then each two of them are merged into one


class MeanPressure:
    """The mean pressure along many short runs, and its standard error."""

    def __init__(self) -> None:
        self._parts: list[tuple[float, int]] = []  # sum of the pressure over the frames of each part, and their number
        self._fewest = FEWEST_FRAMES
        self.frames: int = 0

    def note(self, report: Report) -> None:
        """Add the report of a run, if it has a pressure: its frames join the last part, or begin a new one."""
        measure, frames, parts = report.measures.get("pressure"), report.frames, self._parts
        if measure is None or not math.isfinite(measure.value):
            return
        self.frames += frames
        total = measure.value * frames
        if parts and parts[-1][1] < self._fewest:
            total, frames = total + parts[-1][0], frames + parts[-1][1]
            parts.pop()
        parts.append((total, frames))
        if len(parts) >= MOST_PARTS:
            self._parts = [(a + c, b + d) for (a, b), (c, d) in zip(parts[::2], parts[1::2], strict=True)]
            self._fewest *= 2

    def read(self) -> Measure:
        """The mean so far [mass/time^2]; NaN until one collision contributes: zero would be no measurement."""
        totals, frames = np.array(self._parts, float).reshape(-1, 2).T
        return ratio_average(totals, frames) if totals.any() else Measure(math.nan, math.nan, 0, settled=False)


# --- The gauges beside the picture: measures of the present state, and rates of the run
#
# A number that is not known yet, or has no meaning for the scene, is NaN or None; the page shows a dash.

MOST_LOGGED = 3
"""Largest number of discs for which collisions with walls and obstacles are counted, too. They have to be logged, which
makes frames of many discs slower."""

BINS = 8, 40  # fewest and most bins of the histogram of speeds
FEWEST = 20  # least number of discs for which the speeds are compared with Maxwell's distribution


class Meter:
    """Counts the runs of a simulation: frames a second, collisions since the start, pressure and overlap.

    The last two need another kernel and make frames slower, so they are counted only on request.

    Attributes:
        counting: whether pressure and overlap are counted.
        collisions: since the start of the simulation; NaN: unknown.
        log: observes the runs, and counts collisions with walls and obstacles, too; None: there are too many discs.
    """

    def __init__(self) -> None:
        self.counting: bool = False
        self.collisions: float = math.nan
        self.log: Collisions | None = None
        self.start(0.0)
        self.forget()

    def begin(self, sim: Simulation, from_start: bool) -> None:
        """Begin to count for a simulation; from_start: whether all its frames are run here, so collisions are known."""
        self.collisions = 0 if from_start else math.nan
        self.log = Collisions(callback=self._logged) if from_start and sim.count <= MOST_LOGGED else None
        self.forget()

    def back(self, collisions: float) -> None:
        """Go back to an earlier number of collisions, with the simulation."""
        self.collisions = collisions
        if self.log is not None:
            self.log = Collisions(callback=self._logged)

    def _logged(self, sim: Simulation, table: NDArray[Any]) -> None:
        self.collisions += len(table)

    def start(self, now: float) -> None:
        """Start the clock of the frame rate afresh: the time before now does not count, because nothing ran."""
        self._since, self._frames = now, 0

    def forget(self) -> None:
        """Count pressure and overlap afresh."""
        self._pressure = MeanPressure()
        self._overlap = math.nan
        self._note: str | None = None

    def measures(self, sim: Simulation) -> tuple[str, ...]:
        """Names of the measures for the next run."""
        if not self.counting:
            return ()
        self._note = refusal("pressure", sim.scene, sim.count) or None
        names = ("pressure", "largest_overlap")
        return tuple(name for name in names if not refusal(name, sim.scene, sim.count))

    def note(self, report: Report) -> None:
        """Add the report of a run."""
        self._frames += report.frames
        if self.log is None:
            self.collisions += report.collisions
        self._pressure.note(report)
        if "largest_overlap" in report.measures:
            self._overlap = float(np.fmax(self._overlap, report.measures["largest_overlap"].value))

    def read(self, now: float) -> dict[str, Any]:
        """The numbers by name, for `protocol.text_of`.

        frames_per_second: in real time, which includes waiting for the next frame [1/s].
        pressure: NaN for few frames [mass/time^2]. largest_overlap: in diameters.
        """
        passed, frames = now - self._since, self._frames
        self.start(now)
        pressure, enough = self._pressure.read(), self._pressure.frames >= FEWEST_FRAMES
        return {
            "frames_per_second": frames / passed if frames and passed > 0 else math.nan,
            "collisions": self.collisions,
            "with_walls": self.log is not None,
            "counting": self.counting,
            "pressure": pressure.value if enough else math.nan,
            "pressure_error": pressure.error if enough and pressure.settled else math.nan,
            "largest_overlap": self._overlap,
            "pressure_note": self._note,
        }


class Gauges:
    """Measures of the states of one run; the energy drift is relative to the state `start`."""

    def __init__(self, scene: Scene, start: State, law: str = "elastic"):
        self._scene = scene
        self._before = _energies(start, scene)
        self._no_maxwell = _why_not_maxwell(scene, law)
        self.energy_note: str | None = _why_energy_changes(scene)

    def of(self, state: State) -> dict[str, Any]:
        """The measures of a state by name, for `protocol.text_of`."""
        kinetic, potential = _energies(state, self._scene)
        largest = max(kinetic, self._before[0])  # as in the measure energy_drift; NaN if either is
        change = kinetic - self._before[0] + potential - self._before[1]
        return {
            "discs": int(state.present.sum()),
            "temperature": _or_nan(measure.temperature, state, self._scene),
            "energy": kinetic + potential,
            "energy_drift": change / largest if largest > 0 else math.nan,
            "energy_note": self.energy_note,
            "speeds": self._speeds(state),
        }

    def _speeds(self, state: State) -> dict[str, Any] | None:
        """Histogram of the speeds, with Maxwell's distribution or a note why it is left out; None: no disc moves."""
        here = state.present
        count = int(here.sum())
        try:
            bins = int(np.clip(2 * math.sqrt(count), *BINS))  # with more bins, most are empty for few discs
            present = state if here.all() else State(state.position[here], state.velocity[here])
            found = measure.speed_distribution(present, bins)
        except InputError:  # nothing moves
            return None
        reason = self._no_maxwell or (f"fewer than {FEWEST} discs" if count < FEWEST else None)
        note = None if reason is None else f"no Maxwell curve: {reason}"
        maxwell = found.maxwell if note is None else None
        return {"edges": found.edges, "density": found.value, "maxwell": maxwell, "note": note}


def _energies(state: State, scene: Scene) -> tuple[float, float]:
    """Kinetic and potential energy; NaN where they are undefined."""
    return _or_nan(measure.kinetic_energy, state, scene), _or_nan(measure.potential_energy, state, scene)


def _or_nan(function: Any, state: State, scene: Scene) -> float:
    """A measure of a state; NaN where it is undefined, as without discs."""
    try:
        return function(state, scene)
    except InputError:
        return math.nan


def _why_energy_changes(scene: Scene) -> str | None:
    """Why kinetic and potential energy together are not constant; None if they are."""
    reasons = {
        "a wall moves": bool(scene._moving_walls),
        "a thermostat heats or cools": is_heated(scene),
        "contacts take energy": has_losses(scene),
        "discs enter": adds_discs(scene),
        "discs leave": removes_discs(scene),
        "discs fall through a periodic edge": has_periodic_field(scene),
    }
    return next((reason for reason, holds in reasons.items() if holds), None)


def _why_not_maxwell(scene: Scene, law: str) -> str | None:
    """Why the speeds do not come to Maxwell's distribution; None if they do."""
    walls = scene.thermal_walls
    reasons = {
        "the discs differ in mass": scene.mass is not None and np.ptp(scene.mass) > 0,
        "contacts take energy": has_losses(scene),
        "law reflect keeps the speed of each disc": law == "reflect",
        "the walls differ in temperature": walls is not None and len(set(walls.temperatures.values())) > 1,
        "discs fall through a periodic edge": has_periodic_field(scene),
    }
    return next((reason for reason, holds in reasons.items() if holds), None)
