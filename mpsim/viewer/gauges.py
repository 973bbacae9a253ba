"""The gauges beside the picture: measures of the present state, and rates of the run.

A number that is not known yet, or has no meaning for the scene, is NaN or None; the page shows a dash.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim import measure
from mpsim.core.state import State
from mpsim.engine.report import Report
from mpsim.errors import InputError
from mpsim.kernels.layout import PHASES
from mpsim.measure.driving import adds_discs, has_losses, is_heated, removes_discs
from mpsim.measure.observables import has_periodic_field
from mpsim.scene.scene import Scene

BINS = 8, 40
"""Fewest and most bins of the histogram of speeds."""

FEWEST = 20
"""Least number of discs for which the speeds are compared with Maxwell's distribution."""


class Meter:
    """Counts frames, their computing time and collisions since the last reading.

    >>> Meter(0.0).read(count=10, now=1.0)
    Rates(frames_per_second=nan, collisions_per_second=nan, nanoseconds=nan)
    """

    def __init__(self, now: float):
        self.start(now)

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

    def workers(self) -> dict[str, Any]:
        """The fraction of its time that each worker spent in each phase since the last reading; None: nothing ran.

        The last phase is waiting.

        >>> Meter(0.0).workers()
        {'phases': ('move', 'sort', 'even columns', 'odd columns', 'wait'), 'workers': None, 'waiting': nan}
        """
        total = float(self._phases.sum())
        if not total > 0:
            return {"phases": PHASES, "workers": None, "waiting": math.nan}
        of_each = self._phases / np.maximum(self._phases.sum(axis=0), 1e-12)
        return {"phases": PHASES, "workers": of_each.T.copy(), "waiting": float(self._phases[-1].sum()) / total}

    def read(self, count: int, now: float) -> "Rates":
        """The rates since the last reading; NaN if nothing has run."""
        passed, frames, seconds, collisions = now - self._since, self._frames, self._seconds, self._collisions
        self.start(now)
        if not frames or passed <= 0:
            return Rates(math.nan, math.nan, math.nan)
        return Rates(frames / passed, collisions / passed, seconds * 1e9 / (frames * count) if count else math.nan)


@dataclass(frozen=True)
class Rates:
    """Rates of a run.

    Attributes:
        frames_per_second, collisions_per_second: rates in real time, which includes waiting for the next frame [1/s].
        nanoseconds: computing time of a frame divided by the number of discs, without waiting [ns].
    """

    frames_per_second: float
    collisions_per_second: float
    nanoseconds: float


class Gauges:
    """Measures of the states of one run.

    Args:
        scene: the scene that runs.
        start: state to which the energy drift is relative.
        law: the law of collisions, as in `Settings`.
    """

    def __init__(self, scene: Scene, start: State, law: str = "elastic"):
        self._scene = scene
        self._before = _energies(start, scene)
        self._no_maxwell = _why_not_maxwell(scene, law)
        self.energy_note: str | None = _why_energy_changes(scene)

    def of(self, state: State) -> dict[str, Any]:
        """The measures of a state by name, for `wire.text_of`."""
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
    """The state without absent discs."""
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
        "a wall moves": scene.moving_wall is not None,
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
