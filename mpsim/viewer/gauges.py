"""The gauges beside the picture: measures of the present state, rates, pressure, overlap, collisions."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim import measure
from mpsim.core.state import State
from mpsim.engine.observers import Collisions
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError
from mpsim.features.energy import (
    adds_discs,
    has_body_force,
    has_losses,
    is_heated,
    removes_discs,
)
from mpsim.kernels.records import PHASES
from mpsim.measure import reference, temperature
from mpsim.measure.observables import has_periodic_field
from mpsim.measure.registry import refusal
from mpsim.measure.statistics import Measure, ratio_average
from mpsim.scene.scene import Scene

# --- Counts pressure and largest overlap for the gauges
#
# Counting needs another kernel and makes frames slower, so it runs only on request.

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


class Counting:
    """Pressure and largest overlap since counting began, from the reports of many short runs."""

    def __init__(self) -> None:
        self.wanted: bool = False  # whether they are to be counted
        self.forget()

    def forget(self) -> None:
        """Start afresh, for another run."""
        self._pressure = MeanPressure()
        self._overlap = math.nan
        self._note: str | None = None

    def measures(self, sim: Simulation) -> tuple[str, ...]:
        """Names of the measures for the next run."""
        if not self.wanted:
            return ()
        self._note = refusal("pressure", sim.scene, sim.count) or None
        names = ("pressure", "largest_overlap")
        return tuple(name for name in names if not refusal(name, sim.scene, sim.count))

    def note(self, report: Report) -> None:
        """Add the report of a run."""
        self._pressure.note(report)
        if "largest_overlap" in report.measures:
            self._overlap = float(np.fmax(self._overlap, report.measures["largest_overlap"].value))

    def numbers(self) -> dict[str, Any]:
        """The numbers so far: pressure, NaN for few frames, its standard error [mass/time^2], overlap [diameters]."""
        found, enough = self._pressure.read(), self._pressure.frames >= FEWEST_FRAMES
        return {
            "counting": self.wanted,
            "pressure": found.value if enough else math.nan,
            "pressure_error": found.error if enough and found.settled else math.nan,
            "largest_overlap": self._overlap,
            "pressure_note": self._note,
        }


def bulk_pressure(state: State, scene: Scene) -> float:
    """The pressure from the equation of state, at the packing and temperature of a state [mass/time^2].

    NaN where the equation does not hold: under gravity, for several sizes of discs, and above the packing of the fluid.
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


# --- The number of collisions since the start of a simulation, for the gauges

MOST_LOGGED = 3
"""Largest number of discs for which collisions with walls and obstacles are counted, too. They have to be logged, which
makes frames of many discs slower."""


class CollisionCount:
    """Counts the collisions of a simulation since its start; it goes back to an earlier moment with the simulation."""

    def __init__(self) -> None:
        self.total: float = math.nan  # unknown
        self._log: Collisions | None = None

    def begin(self, sim: Simulation, from_start: bool) -> None:
        """Begin to count for a simulation; from_start: whether all its frames are run here, so the total is known."""
        self.total, self._log = 0 if from_start else math.nan, None
        if from_start and sim.count <= MOST_LOGGED:
            self._log = Collisions(callback=self._logged)

    @property
    def with_walls(self) -> bool:
        """Whether collisions with walls and obstacles are counted, too."""
        return self._log is not None

    def observers(self, every: int) -> list[Collisions]:
        """Observers for the next run; every: frames between two observations."""
        if self._log is None:
            return []
        self._log.every = every
        return [self._log]

    def _logged(self, sim: Simulation, table: NDArray[Any]) -> None:
        self.total += len(table)

    def end_run(self, sim: Simulation, reports: Iterable[Report]) -> None:
        """Add the collisions of a run that has ended, from its reports or from the log."""
        if self._log is None:
            self.total += sum(report.collisions for report in reports)
        else:
            self._log.observe(sim, 0)

    def lose(self) -> None:
        """Note that a run ended without a report: the number is unknown until the simulation goes back."""
        self.total = math.nan

    def back(self, total: float) -> None:
        """Go back to an earlier number, with the simulation."""
        self.total = total
        if self._log is not None:
            self._log = Collisions(callback=self._logged)


# --- The gauges beside the picture: measures of the present state, and rates of the run
#
# A number that is not known yet, or has no meaning for the scene, is NaN or None; the page shows a dash.

BINS = 8, 40  # fewest and most bins of the histogram of speeds
FEWEST = 20  # least number of discs for which the speeds are compared with Maxwell's distribution


class Meter:
    """Counts frames, their computing time and collisions since the last reading."""

    def __init__(self) -> None:
        self.start(0.0)

    def start(self, now: float) -> None:
        """Start afresh: the time before now does not count, because nothing ran."""
        self._since, self._frames, self._seconds, self._collisions = now, 0, 0.0, 0
        self._phases: NDArray[np.float64] = np.zeros((len(PHASES), 0))

    def note(self, report: Report) -> None:
        """Add the report of a run."""
        self._frames += report.frames
        self._seconds += float(report.frame_seconds.sum())
        self._collisions += report.collisions
        phases = np.stack([report.phase_seconds[name].sum(axis=0) for name in PHASES])
        self._phases = self._phases + phases if self._phases.shape == phases.shape else phases

    def read(self, count: int, now: float) -> dict[str, Any]:
        """The rates since the last reading, and the fraction of its time that each worker spent in each phase.

        frames_per_second, collisions_per_second: in real time, which includes waiting for the next frame [1/s].
        nanoseconds: computing time of a frame divided by the number of discs, without waiting [ns].
        workers: None if nothing ran; the last phase is waiting.
        """
        passed, frames, seconds, collisions = now - self._since, self._frames, self._seconds, self._collisions
        phases, total = self._phases, float(self._phases.sum())
        self.start(now)
        ran, spent = frames > 0 and passed > 0, total > 0
        return {
            "frames_per_second": frames / passed if ran else math.nan,
            "collisions_per_second": collisions / passed if ran else math.nan,
            "nanoseconds": seconds * 1e9 / (frames * count) if ran and count else math.nan,
            "phases": PHASES,
            "workers": (phases / np.maximum(phases.sum(axis=0), 1e-12)).T.copy() if spent else None,
            "waiting": float(phases[-1].sum()) / total if spent else math.nan,
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
        count = int(state.present.sum())
        try:
            bins = int(np.clip(2 * math.sqrt(count), *BINS))  # with more bins, most are empty for few discs
            found = measure.speed_distribution(_present(state), bins)
        except InputError:  # nothing moves
            return None
        reason = self._no_maxwell or (f"fewer than {FEWEST} discs" if count < FEWEST else None)
        note = None if reason is None else f"no Maxwell curve: {reason}"
        maxwell = found.maxwell if note is None else None
        return {"edges": found.edges, "density": found.value, "maxwell": maxwell, "note": note}


def _present(state: State) -> State:
    here = state.present
    return state if here.all() else State(state.position[here], state.velocity[here])


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
        "a wall moves": scene._moving_wall is not None,
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
