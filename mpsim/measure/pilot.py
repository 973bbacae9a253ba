"""A first look at a scene: what runs it exactly, how fast discs are, how often they collide, how soon chaos wins."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError, MpsimError
from mpsim.measure.comparison import parting, typical_speed
from mpsim.measure.replicas import quietly
from mpsim.scene import Scene
from mpsim.settings import Settings
from mpsim.state import State

STARTS = 8
"""States along the run from which short runs start."""

COLLISIONS = 20_000
"""Collisions between two of these states, about: they then have little to do with each other."""

PATIENCE = 20.0
"""Seconds after which the exact solver is too slow for a scene."""

FINEST = 0.002
"""Step of the run that stands in for the exact solver, in units of diameter / speed."""

LYAPUNOV_TIMES = 2.0
"""Length of a short run in Lyapunov times: long enough to see an error, short against the time that erases all."""


@dataclass(frozen=True)
class Pilot:
    """What the first look has found.

    Attributes:
        reference: settings of the reference, `event` where it can do the scene.
        reference_name: the same in words, with the reason where it cannot.
        speed: root mean square of one velocity component [length/time].
        collisions: of pairs, per time [1/time].
        growth: Lyapunov exponent, at least 1/100 of a crossing time's inverse [1/time].
        short: length of a short run [time].
        starts: states along the run.
        gap: time between the last two of them [time].
        look: settings of the run.
    """

    reference: Settings
    reference_name: str
    speed: float
    collisions: float
    growth: float
    short: float
    starts: tuple[State, ...]
    gap: float
    look: Settings

    def further_starts(self, scene: Scene) -> tuple[State, ...]:
        """As many other states: those half-way from each start to the next."""
        settings = replace(self.look, dt=min(self.look.dt, self.gap / 2))
        states = []
        for start in self.starts:
            with quietly(), Simulation(scene.starting_from(start), settings) as sim:
                sim.run(until=self.gap / 2)
                states.append(_among_all(sim.state, start.present))
        return tuple(states)


def _among_all(state: State, present: NDArray[np.bool_]) -> State:
    """The state of those discs that were present, as a state of all, shape (N,): in it the others are absent."""
    if present.all():
        return state
    position, velocity, here = np.zeros((len(present), 2)), np.zeros((len(present), 2)), present.copy()
    position[present], velocity[present], here[present] = state.position, state.velocity, state.present
    return State(position, velocity, present=here, box=state.box)


EXACT = "the exact solver"
"""First words of Pilot.reference_name where that is the reference."""


@dataclass(frozen=True)
class Look:
    """What one run has shown: as in `Pilot`, and in how many of its collisions the exact solver's guard acted."""

    speed: float
    collisions: float
    starts: tuple[State, ...]
    gap: float
    guarded: float


def pilot(scene: Scene, earlier: str | None = None) -> Pilot:
    """Take a first look.

    Args:
        scene: at what.
        earlier: reference_name of an earlier look, which this one repeats, however fast the machine is now.

    Raises:
        InputError: if nothing moves in the scene, or it is too large for a look.
    """
    speed = typical_speed(scene)
    if speed == 0 or scene.count == 0:
        raise InputError(
            f"a trade needs a scene in which something moves; got {scene!r}, all at rest. "
            "Give it discs with velocities, or gravity."
        )
    crossing = 2 * scene.smallest_radius / speed
    exact = earlier is None or earlier.startswith(EXACT)
    settings, reason = Settings(method="event", dt=crossing / 4), ""
    try:
        if not exact:
            raise _TooSlow
        patience = PATIENCE if earlier is None else math.inf
        look = _look(scene, settings, crossing, patience)
        growth = _growth(scene, crossing, patience)
    except (MpsimError, _TooSlow) as error:
        exact, reason, growth = False, str(error), 1 / crossing
        settings = Settings(dt=crossing / 20, passes=2)
        look = _stepped_look(scene, settings, crossing)
    reference = settings if exact else replace(settings, dt=FINEST * crossing)
    name = EXACT if exact else f"two passes at dt={reference.dt:.3g}, the finest affordable run, as {EXACT} "
    if look.guarded:
        name += f" (whose guard kept the energy in {look.guarded:.1%} of the collisions)"
    name = earlier or (name if exact else f"{name}cannot: {reason}")
    short = min(LYAPUNOV_TIMES / growth, 5 * crossing)
    return Pilot(reference, name, look.speed, look.collisions, growth, short, look.starts, look.gap, settings)


def _growth(scene: Scene, crossing: float, patience: float) -> float:
    """Lyapunov exponent; a small one where the runs do not part."""
    least = 0.01 / crossing
    try:
        with quietly():
            return max(parting(scene, progress=_impatient(patience)).rate.value, least)
    except InputError:
        return least


def _impatient(patience: float) -> Callable[[int, int], None]:
    """What ends a run that takes longer than so many seconds."""
    end = time.monotonic() + patience

    def look(done: int, frames: int) -> None:
        if time.monotonic() > end:
            raise _TooSlow(f"do its first look in {patience:g} s")

    return look


class _TooSlow(Exception):  # noqa: N818 - not an error
    """A look takes too long."""


def _stepped_look(scene: Scene, settings: Settings, crossing: float) -> Look:
    try:
        return _look(scene, settings, crossing, PATIENCE)
    except _TooSlow:
        raise InputError(
            f"a trade needs a scene whose first look takes less than {PATIENCE:g} s; that of {scene!r} takes longer. "
            "Take a smaller scene of the same kind: errors hardly depend on the number of discs."
        ) from None


def _look(scene: Scene, settings: Settings, crossing: float, patience: float) -> Look:
    """A run of the scene, STARTS blocks long."""
    collisions, guarded = 0, 0
    with quietly(), Simulation(scene, settings) as sim:
        states = [sim.state]
        look = _impatient(patience)  # from here on, as what came before may have compiled
        block = done = 1
        for _ in range(STARTS):
            report = sim.run(frames=block, progress=look)
            collisions, guarded, done = collisions + report.collisions, guarded + report.guarded, block
            block = int(np.clip(COLLISIONS / max(collisions / sim.frame, 1), 1, 5 * crossing / settings.dt))
            states.append(sim.state)
        squares = [(state.velocity[state.present] ** 2).mean() for state in states if state.present.any()]
        speed = float(np.sqrt(np.mean(squares)))
        share = guarded / max(collisions, 1)
        return Look(speed, collisions / sim.time, tuple(states[:-1]), done * settings.dt, share)
