"""The preliminary run of a trade: what can be the reference, how fast discs are and how often they collide."""

import math
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from mpsim.core.errors import InputError, MpsimError
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.engine.workers.cores import usable_cores
from mpsim.features import FEATURES
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.comparison import parting, typical_speed
from mpsim.studies.replicas import quietly

STARTS = 8
"""States along the run from which short runs start."""

COLLISIONS = 20_000
"""Collisions between two of these states, about, where no duration is known: they then have little in common."""

PATIENCE = 10.0
"""Seconds after which the exact solver is too slow for a scene."""

LONGEST_LOOK = 20.0
"""Seconds after which a stepped preliminary run is too slow, too."""

FINEST = 0.002
"""Step of the run that stands in for the exact solver, in units of diameter / speed, where there is time for it."""

COARSEST = 0.02
"""The longest such step: with a longer one little would be learnt about the steps that people use."""

LOOK = 0.05
"""Step of a stepped preliminary run, likewise."""

RUNS = 20
"""Runs of the reference that a trade takes, about: each may last so small a fraction of the time there is."""

FRAMES = 100
"""Frames that are timed to tell what a step takes."""

LYAPUNOV_TIMES = 2.0
"""Length of a short run in Lyapunov times: long enough to see an error, short against the time that erases all."""


GOLDEN = (math.sqrt(5) - 1) / 2
"""Fractions of its whole multiples lie far from each other and from 0 (Weyl's sequence)."""


@dataclass(frozen=True)
class Pilot:
    """What the preliminary run has found.

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
        seconds: that the reference takes for a unit of time on one core [s/time].
        step_seconds: that one step with one pass takes, likewise [s].
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
    seconds: float = 0.0
    step_seconds: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether the reference is the exact solver."""
        return self.reference.method == "event"

    def further_starts(self, scene: Scene, first: int) -> tuple[State, ...]:
        """As many other states: those on the way from each start to the next, elsewhere for each number `first`."""
        elapsed = self.gap * (first * GOLDEN % 1)
        settings = replace(self.look, dt=min(self.look.dt, elapsed / 2))
        states = []
        for start in self.starts:
            with quietly(), Simulation(scene.starting_from(start), settings) as sim:
                sim.run(until=elapsed)
                states.append(sim.state)
        return tuple(states)


EXACT = "the exact solver"
"""First words of Pilot.reference_name where that is the reference."""


@dataclass(frozen=True)
class Look:
    """What one run has shown: as in `Pilot`; in how many of its collisions the exact solver's guard acted; seconds."""

    speed: float
    collisions: float
    starts: tuple[State, ...]
    gap: float
    guarded: float
    seconds: float


def pilot(scene: Scene, until: float | None = None, earlier: str | None = None, seconds: float = 150.0) -> Pilot:
    """Make the preliminary run.

    Args:
        scene: of which.
        until: time to which runs will go, where it is known [time].
        earlier: reference_name of an earlier one, which this one repeats, however fast the machine is now.
        seconds: that the whole trade may take, about [s].

    Raises:
        InputError: if nothing can move in the scene, or it is too large for a trade.
    """
    speed = _speed_to_come(scene)
    if speed == 0:
        drives = " or ".join(feature.drives for feature in FEATURES if feature.drives)
        raise InputError(
            f"a trade needs a scene in which something moves; got {scene!r}, all at rest. "
            f"Give it discs with velocities, gravity, {drives}."
        )
    crossing = 2 * scene.smallest_radius / speed
    exact = earlier is None or earlier.startswith(EXACT)
    patience = min(PATIENCE, _affordable(seconds)) if earlier is None else math.inf
    settings, reason = Settings(method="event", dt=crossing / 4), ""
    try:
        if not exact:
            raise _TooSlow
        if _comes_to_rest(scene):
            raise _TooSlow("grains with losses come to rest on each other, and collide without end")
        look = _look(scene, settings, crossing, until, patience)
    except (MpsimError, _TooSlow) as error:
        exact, reason = False, str(error)
        settings = Settings(dt=LOOK * crossing, passes=2, on_fast="substep", workers=1)
        look = _stepped_look(scene, settings, crossing, until)
    speed = max(look.speed, _speed_of_fall(scene)) or speed  # at which there is motion to resolve
    own = 2 * scene.smallest_radius / speed
    reference, cost, growth = settings, look.seconds, 1 / own
    if exact:
        growth = _growth(scene, crossing, patience)
        step_seconds = _step_seconds(scene, LOOK * crossing, until, patience)
    else:
        step_seconds = look.seconds * settings.dt / settings.passes
        dt = _finest(settings, look.seconds, own, until or 0.0, seconds) if earlier is None else _dt_of(earlier)
        reference, cost = replace(settings, dt=dt), look.seconds * settings.dt / dt
    name = EXACT if exact else f"two passes at dt={reference.dt:.3g}, the finest affordable run, as {EXACT} "
    if look.guarded:
        name += f" (whose guard kept the energy in {look.guarded:.1%} of the collisions)"
    name = earlier or (name if exact else f"{name}cannot: {reason}")
    short = min(LYAPUNOV_TIMES / growth, 5 * own)
    return Pilot(
        reference, name, speed, look.collisions, growth, short, look.starts, look.gap, settings, cost, step_seconds
    )


def _comes_to_rest(scene: Scene) -> bool:
    """Whether a field presses discs together whose collisions lose energy: one start in a few never ends."""
    pressed = scene.gravity is not None or scene.acceleration is not None
    return pressed and min(scene.restitution, scene.wall_restitution) < 1


def _is_gas(scene: Scene) -> bool:
    """Whether nothing drives the scene and nothing is lost, so that a short run tells what a long one will be like."""
    driven = scene.gravity is not None or scene.acceleration is not None or scene.moving_wall is not None
    lossless = scene.restitution == scene.wall_restitution == 1
    return lossless and not driven and not scene.emitters and not scene.absorbing


def _speed_of_fall(scene: Scene) -> float:
    """Speed after a fall through a radius [length/time]: what presses discs together when all have come to rest."""
    pull = 0.0 if scene.gravity is None else float(np.hypot(*scene.gravity))
    if scene.acceleration is not None and scene.count:
        pull = max(pull, float(np.hypot(*scene.acceleration.T).max()))
    return math.sqrt(2 * pull * scene.smallest_radius)


def _speed_to_come(scene: Scene) -> float:
    """Typical speed, that of the discs which emitters add and that of a moving wall included [length/time]."""
    speeds = [typical_speed(scene), *(float(np.hypot(*np.array(each.velocity))) for each in scene.emitters)]
    if scene.emitters and scene.gravity is not None:
        speeds.append(math.sqrt(2 * float(np.hypot(*scene.gravity)) * 2 * scene.largest_radius))
    if (wall := scene.moving_wall) is not None and scene.count:
        speeds.append(abs(wall.speed))
    return max(speeds)


def _finest(look: Settings, seconds: float, crossing: float, until: float, limit: float) -> float:
    """Step of the stepped reference: FINEST, or as fine as there is time for.

    Raises:
        InputError: if there is not even time for COARSEST.
    """
    dt = max(FINEST * crossing, seconds * look.dt * until / _affordable(limit))
    if dt > COARSEST * crossing:
        needed = seconds * look.dt / (COARSEST * crossing) * until * RUNS / usable_cores()
        raise InputError(
            f"a trade of this scene needs some {needed:.0f} s, as one run of its reference to {until:g} is so long; "
            f"it may take {limit:g} s. Give it more time (seconds=...), a shorter run (until=...), or a smaller scene "
            "of the same kind."
        )
    return float(f"{dt:.3g}")


def _dt_of(name: str) -> float:
    """The step that the name of a stepped reference tells."""
    found = re.search(r"dt=([^,]+),", name)
    assert found is not None  # as such a name is made here
    return float(found[1])


def _affordable(limit: float) -> float:
    """Seconds that one run of the reference may take."""
    return limit * usable_cores() / RUNS


def _step_seconds(scene: Scene, dt: float, until: float | None, patience: float) -> float:
    """Seconds of one step with one pass on one core, about; where emitters let a scene grow, a mean over the run."""
    with quietly(), Simulation(scene, Settings(dt=dt, workers=1)) as sim:
        if not scene.emitters or until is None:
            return float(np.median(sim.run(frames=FRAMES).frame_seconds))
        begun = time.thread_time()
        with suppress(_TooSlow):
            sim.run(until=until, progress=_impatient(patience))
        return (time.thread_time() - begun) / sim.frame


def _growth(scene: Scene, crossing: float, patience: float) -> float:
    """Lyapunov exponent; a small one where the runs do not part."""
    least = 0.01 / crossing
    try:
        with quietly():
            return max(parting(scene, progress=_impatient(patience)).rate.value, least)
    except (MpsimError, _TooSlow):
        return least


def _impatient(patience: float) -> Callable[[int, int], None]:
    """What ends a run that takes more than so many seconds of this thread, whatever else the machine does."""
    end = time.thread_time() + patience

    def look(done: int, frames: int) -> None:
        if time.thread_time() > end:
            raise _TooSlow(f"make its preliminary run in {patience:g} s")

    return look


class _TooSlow(Exception):  # noqa: N818 - not an error
    """A preliminary run takes too long."""


def _stepped_look(scene: Scene, settings: Settings, crossing: float, until: float | None) -> Look:
    try:
        return _look(scene, settings, crossing, until, LONGEST_LOOK)
    except _TooSlow:
        raise InputError(
            f"a trade needs a scene whose preliminary run takes less than {LONGEST_LOOK:g} s; that of {scene!r} takes "
            "longer. Take a smaller scene of the same kind: errors hardly depend on the number of discs."
        ) from None


def _look(scene: Scene, settings: Settings, crossing: float, until: float | None, patience: float) -> Look:
    """A run of the scene, STARTS blocks long: to `until`, or, of a gas or without one, of COLLISIONS each."""
    collisions, guarded, seconds = 0, 0, 0.0
    with quietly(), Simulation(scene, settings) as sim:
        states = [sim.state]
        look = _impatient(patience)  # from here on, as what came before may have compiled
        block = done = likely = 1
        for number in range(1, STARTS + 1):
            if until is not None:
                block = max(int(until * number / STARTS / settings.dt) - sim.frame, 1)
                block = min(block, likely) if _is_gas(scene) else block
            started = time.thread_time()
            report = sim.run(frames=block, progress=look)
            seconds += time.thread_time() - started
            collisions, guarded, done = collisions + report.collisions, guarded + report.guarded, block
            likely = int(np.clip(COLLISIONS / max(collisions / sim.frame, 1), 1, 5 * crossing / settings.dt))
            block = likely if until is None else block
            states.append(sim.state)
        moving = [(state.velocity[state.present] ** 2).mean() for state in states if state.present.any()]
        share = guarded / max(collisions, 1)
        speed = float(np.sqrt(np.mean(moving))) if moving else 0.0
        gap = done * settings.dt
        return Look(speed, collisions / sim.time, tuple(states[:-1]), gap, share, seconds / sim.time)
