"""The preliminary run of a trade-off study, and its independent starts."""

import dataclasses
import math
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mpsim.core import checks
from mpsim.core.machine import usable_cores
from mpsim.core.state import State
from mpsim.engine import access
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.event_block import contact_time_at_rest
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import (
    EmitterWarning,
    FastWarning,
    GuardWarning,
    InputError,
    MpsimError,
    OverlapWarning,
    ResolutionWarning,
)
from mpsim.features import FEATURES
from mpsim.features.emitters import Emitter
from mpsim.features.feature import (
    acceleration_bound,
    adds_discs,
    conserves_energy,
    gravity_strength,
    has_body_force,
    has_losses,
    strongest_field,
    thermal_speed,
)
from mpsim.kernels.compiling import running_seconds
from mpsim.measure.observables import trajectory_error
from mpsim.measure.statistics import block_average
from mpsim.scene import starts
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.runner import Stopped

# --- Independent starts of a scene, over which a trade-off study averages

VARIATION = 1e-3
"""Displacement of a disc, in diameters of the smallest, and relative change of its velocity, between two variations of
one start: too small to matter, large enough for collisions to decorrelate them soon."""

KINDS = ("kind", "same")

StartsGiven = str | Callable[[int], Scene] | None  # the argument `starts`: see `Starts`


class Starts:
    """Numbered starts of one scene. The same number always gives the same start.

    For "kind" and "same", number 0 is the scene itself.

    Args:
        scene: the scene.
        given: "kind": other starts of the same kind (`Scene.redrawn`); "same": this start with small variations
            (VARIATION); a function from a number to a Scene; None: "kind" if the scene knows how it was made, else
            "same".

    Attributes:
        name: the starts in words.
        key: a text that identifies the starts; functions are distinguished by the first two starts that they make.
        same: whether they are variations of one start, so that their runs are initially correlated.
    """

    def __init__(self, scene: Scene, given: StartsGiven = None):
        if given is None:
            given = "kind" if scene._redraw is not None else "same"
        self.same: bool = given == "same"
        self._made: dict[int, Scene] = {0: scene} if isinstance(given, str) else {}
        if given == "kind":
            self.name: str = "other starts of the same kind"
            self._make: Callable[[int], Any] = scene.redrawn
            self._made[1] = scene.redrawn(1)  # which raises if there is no other
        elif given == "same":
            self.name = f"this start, each disc displaced by up to {VARIATION:g} of a diameter"
            self._make = lambda number: varied(scene, number)
        elif callable(given):
            self.name, self._make = "starts that were given by a function", given
        else:
            raise checks.refusal("starts", "be 'kind', 'same' or a function of a number", checks.brief(given))
        known = [self[0], self[1]] if callable(given) else []
        self.key: str = " ".join([self.name, *(each.digest() for each in known)])

    def __getitem__(self, number: int) -> Scene:
        """The start of a number, >= 0."""
        if number not in self._made:
            made = self._make(number)
            if not isinstance(made, Scene):
                raise InputError(f"starts must give Scenes; for {number} it gave {type(made).__name__}.")
            self._made[number] = made
        return self._made[number]


def varied(scene: Scene, seed: int) -> Scene:
    """The scene with positions and velocities varied by VARIATION, at the same kinetic energy.

    Displacements that would lead to an overlap, or beyond a wall, are rejected. Emitters are varied likewise.
    """
    rng = np.random.default_rng(seed)
    moves = rng.uniform(-1, 1, (scene.count, 2)) * (VARIATION * 2 * scene.smallest_radius)
    low, high = scene.limits(scene.radii)  # a moving wall may start inside of the box
    moves *= (scene.position + moves >= low) & (scene.position + moves <= high) | scene.periodic
    room = starts.Room((scene.width, scene.height), scene.periodic, scene._capsules_at(0.0))
    position = starts.displaced(scene.position, scene.radii, room, moves)
    velocity = scene.velocity * (1 + VARIATION * rng.normal(size=scene.velocity.shape))
    masses = 1.0 if scene.mass is None else scene.mass[:, None]
    if (squares := float((masses * velocity**2).sum())) > 0:
        velocity *= np.sqrt(float((masses * scene.velocity**2).sum()) / squares)
    emitters = tuple(_varied_emitter(scene, emitter, scene.largest_radius, rng) for emitter in scene.emitters)
    return scene.starting_from(State(position, velocity))._replace(emitters=emitters)


def _varied_emitter(scene: Scene, emitter: Emitter, common: float, rng: np.random.Generator) -> Emitter:
    """The emitter with varied position and velocity; it stays where it is if the new disc would overlap a capsule."""
    radius = common if emitter.radius is None else emitter.radius
    before, speed = np.array(emitter.position), np.array(emitter.velocity)
    place = np.clip(before + rng.uniform(-1, 1, 2) * VARIATION * 2 * radius, *scene.limits(radius))
    if scene._deepest(place[None], np.array([radius])) is not None:
        place = before
    return dataclasses.replace(emitter, position=place, velocity=speed * (1 + VARIATION * rng.normal(size=2)))


# --- Limits of runs, and warnings that hundreds of them would repeat


class RunTooLong(Exception):  # noqa: N818 - an outcome, not an error
    """A run takes far more time than forecast."""


def time_limit(seconds: float, text: str, stop: threading.Event | None = None) -> Callable[[int, int], None]:
    """A progress function that ends a run after seconds of this thread, compiling left out, or soon after `stop`.

    It raises RunTooLong, with a text that says why, or Stopped.
    """
    end = running_seconds() + seconds

    def progress(done: int, frames: int) -> None:
        if stop is not None and stop.is_set():
            raise Stopped
        if running_seconds() > end:
            raise RunTooLong(text)

    return progress


@contextmanager
def quietly() -> Iterator[None]:
    """Suppress warnings about the scene in this thread, which hundreds of runs would repeat."""
    with access.caught(EmitterWarning, OverlapWarning, GuardWarning, FastWarning, ResolutionWarning):
        yield


# --- How fast two runs of one scene diverge that differ a little
#
# Hard discs are chaotic: a difference between two runs, even a single rounding, grows on average as exp(lambda t), with
# the largest Lyapunov exponent lambda. Beyond a horizon the distance between two trajectories is meaningless.

AGREEMENT = 20.0
"""Two correct float64 solvers agree for about this many Lyapunov times 1/lambda [1]: at packing 0.3, where lambda =
2.9, for 7 time units. More would need digits that rounding has destroyed."""

PERTURBATION = 1e-10
"""Initial difference of the velocities of two runs, as a fraction of a typical speed: far above rounding."""

HIGHEST = 1e-3  # distance, in diameters of the smallest disc, up to which two runs count as close together

STRAIGHT = 10.0
"""Growth of a difference, over that in straight flight, below which it shows no exponent: there was one collision at
most."""

SAMPLES = 400  # largest number of times at which two runs are compared


def typical_speed(scene: Scene) -> float:
    """Root mean square speed, including that of a fall through the largest diameter [length/time]."""
    kinetic = float((scene.velocity**2).sum(axis=1).mean()) if scene.count else 0.0
    return math.sqrt(kinetic + 2 * acceleration_bound(scene) * 2 * scene.largest_radius)


def divergence(
    scene: Scene, seed: int = 0, contact_time: float | None = None, progress: Callable[[int, int], None] | None = None
) -> float:
    """Largest Lyapunov exponent [1/time] of the scene, from two exact runs whose velocities differ by 1e-10 at first.

    It is the mean growth of the logarithm of their distance until that is 1/1000 diameter, from this start; for that of
    a gas, average over several starts.

    Args:
        scene: that `method="event"` can run, with moving discs.
        seed: of the small difference.
        contact_time: as in `Settings` [time].
        progress: as for `Simulation.run`.

    Raises:
        InputError: if the scene cannot be run exactly, or the runs do not diverge, as in a scene without collisions.

    Source: Benettin, Galgani & Strelcyn, Phys. Rev. A 14, 2338 (1976), eq. 6; hard discs: Dellago, Posch & Hoover,
    Phys. Rev. E 53, 1485 (1996).

    >>> 1.5 < divergence(Scene.random(count=64, packing=0.3, radius=0.5, seed=1)) < 4.5
    True
    """
    speed, diameter = typical_speed(scene), 2 * scene.smallest_radius
    perturbation = np.random.default_rng(seed).normal(size=(scene.count, 2)) * PERTURBATION * speed
    other = scene.starting_from(State(scene.position, scene.velocity + perturbation))
    other = other._replace(thermostat=scene.thermostat) if scene.thermostat else other  # the same kicks, by its seed
    # A sample for each twentieth of a diameter of flight: a Lyapunov time is about as long as a free path.
    settings = Settings(method="event", dt=0.05 * diameter / speed if speed else 1.0, contact_time=contact_time)
    times, distances = [], []
    with Simulation(scene, settings) as one, Simulation(other, settings) as two:
        for _ in range(SAMPLES):
            one.run(frames=1, progress=progress)
            two.run(frames=1, progress=progress)
            times.append(one.time)
            distances.append(trajectory_error(one.state, two.state, scene).rms)
            if distances[-1] > HIGHEST * diameter:
                break
    near = np.array([each for each in distances if each <= HIGHEST * diameter])
    near = near[np.flatnonzero(np.append(0.0, near) == 0)[-1] :]  # where the runs met again, from there on
    straight = PERTURBATION * speed * times[-1]
    rate = 0.0
    if len(near) > 2 and distances[-1] > STRAIGHT * straight:
        rate = block_average(np.diff(np.log(near)) / ((times[-1] - times[0]) / (len(times) - 1))).value
    if rate <= 0:
        raise InputError(
            f"the runs of a scene must diverge for a growth rate; a distance of {distances[-1]:.3g} in a time of "
            f"{times[-1]:.3g} is that of straight flight, {straight:.3g}. Take a scene in which discs collide."
        )
    return rate


# --- The preliminary run of a trade-off study: the reference, the speed of the discs, and their collision rate

STARTS = 8  # number of states along the run from which short runs start

COLLISIONS = 20_000
"""Approximate number of collisions between two of these states, if there is no duration: enough to decorrelate them."""

EXACT_SECONDS = 10.0  # seconds of a preliminary run after which the exact solver is too slow for a scene
STEPPED_SECONDS = 20.0  # seconds after which a stepped preliminary run is too slow, too
FINEST = 0.002  # step of a stepped reference, in units of diameter / speed, if there is time for it

COARSEST = 0.02
"""Its longest step: a coarser reference would not resolve the errors of the steps that are used in practice."""

PRELIMINARY_STEP = 0.05  # step of a stepped preliminary run, in the same units
RUNS = 20  # approximate number of runs of the reference in a trade-off study, among which its time is divided
FRAMES = 100  # frames that are timed to measure the time of a step
MOST_CROSSINGS = 1e11  # length of the runs at most, in times in which a disc flies its diameter

LYAPUNOV_TIMES = 2.0
"""Length of a short run in Lyapunov times: long enough to show an error, far below the predictability horizon."""

GOLDEN = (math.sqrt(5) - 1) / 2
"""The fractional parts of its multiples are far from each other and from 0 (Weyl sequence)."""

EXACT, MODEL = "the exact solver", "the contact-time model"
"""First words of PreliminaryRun.reference_name if that is the reference."""


@dataclass(frozen=True)
class PreliminaryRun:
    """Results of the preliminary run.

    Attributes:
        settings: of the run.
        reference: settings of the reference, `event` if it can run the scene.
        reference_name: the same in words, with the reason if it cannot.
        guard: contact time of the reference [time]; 0 if it has none, because nothing needs one or it is stepped.
        thermal_velocity: root mean square of one velocity component [length/time].
        collisions: of pairs, per time [1/time].
        starts: states along the run, and their times.
        gap: time between the last two of them [time].
        seconds: wall time that the reference takes for a unit of time on one core [s/time].
        growth: Lyapunov exponent, at least 1/100 of a crossing time's inverse [1/time].
        short: length of a short run [time].
        step_seconds: wall time of one step with one pass on one core [s].
        by_frames: whether a thermostat acts once a frame, so that results depend on dt of the exact solver too.
    """

    settings: Settings
    reference: Settings
    reference_name: str
    guard: float
    thermal_velocity: float
    collisions: float
    starts: tuple[tuple[State, float], ...]
    gap: float
    seconds: float
    growth: float = 0.0
    short: float = 0.0
    step_seconds: float = 0.0
    by_frames: bool = False

    @property
    def contact_time(self) -> float | None:
        """Contact time that was given for the reference, which makes it a model [time]; None if none was given."""
        return self.reference.contact_time if self.guard else None

    @property
    def exact(self) -> bool:
        """Whether the reference is the exact solver without a given contact time, and so has no error of its own."""
        return capabilities_of(self.reference).is_exact and self.contact_time is None

    def is_reference(self, settings: Settings) -> bool:
        """Whether settings are those of the reference, which has no steps: of the guard's own contact time.

        Where a thermostat acts once a frame, frames must be those of the reference too.
        """
        alike = self.contact_time == (settings.contact_time if self.guard else None)
        alike = alike and not (self.by_frames and settings.dt != self.reference.dt)
        return all(capabilities_of(each).is_exact for each in (settings, self.reference)) and alike

    def further_starts(self, scene: Scene, first: int) -> tuple[tuple[State, float], ...]:
        """As many other states, between each start and the next, different for each number `first`."""
        elapsed = self.gap * (first * GOLDEN % 1)
        settings = replace(self.settings, dt=min(self.settings.dt, elapsed / 2))
        starts = []
        for state, time in self.starts:
            with quietly(), Simulation(scene.starting_from(state, time), settings) as sim:
                sim.run(until=elapsed)
                starts.append((sim.state, time + sim.time))
        return tuple(starts)


def preliminary_run(
    scene: Scene,
    until: float | None = None,
    earlier: str | None = None,
    seconds: float = 150.0,
    contact_time: float | None = None,
) -> PreliminaryRun:
    """Make the preliminary run.

    Args:
        scene: the scene.
        until: length of the runs of the trade-off study, if it is known [time].
        earlier: reference_name of an earlier one, which is repeated, however fast the machine is now.
        seconds: approximate time that the whole trade-off study may take [s].
        contact_time: of the exact solver's guard [time]; if it is given, no other reference is used.

    Raises:
        InputError: if nothing can move in the scene, it is too large for a trade-off study, or the exact solver cannot
            run it with the contact time given.
    """
    speed = _speed_to_come(scene)
    if speed == 0:
        *others, last = (feature.drives for feature in FEATURES if feature.drives)
        raise InputError(
            f"a trade-off study needs a scene in which something moves; got {scene!r}, all at rest. "
            f"Give it discs with velocities, {', '.join(others)} or {last}."
        )
    crossing = 2 * scene.smallest_radius / speed
    if until is not None and until > MOST_CROSSINGS * crossing:
        rule = f"be at most {MOST_CROSSINGS * crossing:.3g}, in which a disc flies {MOST_CROSSINGS:g} diameters"
        raise checks.refusal("until", rule, f"{until:g}", "Take shorter runs.")
    if earlier is not None and not earlier.startswith((EXACT, MODEL)):
        return _stepped_reference(scene, until, crossing, seconds, "", earlier)
    try:
        return _exact_reference(scene, until, crossing, seconds, contact_time, earlier)
    except (MpsimError, RunTooLong) as error:
        if contact_time is not None:
            raise InputError(
                f"contact_time must let {EXACT} reach the end of a run; got {contact_time:g} ({error}). Give a longer "
                "one, more time (seconds=...), a shorter run (until=...), or none, for a stepped reference."
            ) from error
        reason = str(error)
        if isinstance(error, RunTooLong) and has_body_force(scene) and has_losses(scene):
            reason += (
                ", as discs with losses come to rest, and collide without end. Give "
                f"contact_time={contact_time_at_rest(scene):.1g} for a reference that is a model of the scene, but ends"
            )
    return _stepped_reference(scene, until, crossing, seconds, reason)


def _exact_reference(
    scene: Scene, until: float | None, crossing: float, seconds: float, contact_time: float | None, earlier: str | None
) -> PreliminaryRun:
    """The preliminary run of the exact solver; earlier: the reference of an earlier one.

    Raises:
        RunTooLong: if it is too slow.
    """
    limit = _affordable(seconds) if contact_time is not None else min(EXACT_SECONDS, _affordable(seconds))
    limit = math.inf if earlier is not None else limit
    by_frames = scene.thermostat is not None  # so the reference needs frames short enough for a bath in time
    dt = float(f"{PRELIMINARY_STEP * crossing:.2g}") if by_frames else crossing / 4
    found = _observed(scene, Settings(method="event", dt=dt, contact_time=contact_time), crossing, until, limit)
    growth = _growth(scene, crossing, limit, contact_time)
    return replace(
        found,
        reference_name=earlier or found.reference_name,
        growth=growth,
        short=min(LYAPUNOV_TIMES / growth, 10 * scene.smallest_radius / found.thermal_velocity),
        step_seconds=_step_seconds(scene, PRELIMINARY_STEP * crossing, until, limit),
    )


def _stepped_reference(
    scene: Scene, until: float | None, crossing: float, seconds: float, reason: str, earlier: str = ""
) -> PreliminaryRun:
    """The preliminary run in steps; reason: why the exact solver cannot be used."""
    settings = Settings(dt=PRELIMINARY_STEP * crossing, passes=2, on_fast="substep", workers=1)
    try:
        found = _observed(scene, settings, crossing, until, STEPPED_SECONDS)
    except RunTooLong:
        raise InputError(
            f"a trade-off study needs a scene whose preliminary run takes less than {STEPPED_SECONDS:g} s; that of "
            f"{scene!r} takes longer. Take a smaller scene of the same kind: errors hardly depend on its size."
        ) from None
    own = 2 * scene.smallest_radius / found.thermal_velocity
    of_one = found.seconds * settings.dt  # seconds of a step
    known = re.search(r"dt=([^,]+),", earlier)
    dt = float(known[1]) if known else _finest(of_one, own, until or 0.0, seconds)
    name = f"two passes at dt={dt:.3g}, the finest affordable run, because {EXACT} is not usable: {reason}"
    return replace(
        found,
        reference=replace(settings, dt=dt),
        reference_name=earlier or name,
        growth=1 / own,
        short=LYAPUNOV_TIMES * own,
        seconds=of_one / dt,
        step_seconds=of_one / settings.passes,
    )


def _speed_to_come(scene: Scene) -> float:
    """Typical speed, including discs of emitters, a moving wall and a heat bath [length/time]."""
    speeds = [typical_speed(scene), *(float(np.hypot(*np.array(each.velocity))) for each in scene.emitters)]
    if adds_discs(scene):
        speeds.append(math.sqrt(2 * gravity_strength(scene) * 2 * scene.largest_radius))
    if scene.count:
        speeds.append(math.sqrt(2) * thermal_speed(scene))
        speeds += [wall.speed for wall in scene._moving_walls]
    return max(speeds)


def _finest(seconds: float, crossing: float, until: float, limit: float) -> float:
    """Step of the stepped reference, of which each takes `seconds`: FINEST, or as fine as time allows."""
    dt = max(FINEST * crossing, seconds * until / _affordable(limit))
    if dt > COARSEST * crossing:
        needed = seconds / (COARSEST * crossing) * until * RUNS / usable_cores()
        raise InputError(
            f"a trade-off study of this scene needs about {needed:.0f} s, because one run of its reference to "
            f"{until:g} takes so long; it may take {limit:g} s. Give it more time (seconds=...), a shorter run "
            "(until=...), or a smaller scene of the same kind."
        )
    return float(f"{dt:.3g}")


def _affordable(limit: float) -> float:
    """Seconds that one run of the reference may take."""
    return limit * usable_cores() / RUNS


def _step_seconds(scene: Scene, dt: float, until: float | None, limit: float) -> float:
    """Approximate time of one step with one pass on one core [s]; with emitters its mean over the run."""
    with quietly(), Simulation(scene, Settings(dt=dt, workers=1)) as sim:
        if until is None or not adds_discs(scene):
            return float(np.median(sim.run(frames=FRAMES).frame_seconds))
        begun = running_seconds()
        with suppress(RunTooLong):
            sim.run(until=until, progress=_limit(limit))
        return (running_seconds() - begun) / sim.frame


def _growth(scene: Scene, crossing: float, limit: float, contact_time: float | None) -> float:
    """Lyapunov exponent; a small one if the runs do not diverge."""
    least = 0.01 / crossing
    try:
        with quietly():
            return max(divergence(scene, contact_time=contact_time, progress=_limit(limit)), least)
    except (MpsimError, RunTooLong):
        return least


def _limit(seconds: float) -> Callable[[int, int], None]:
    return time_limit(seconds, f"its preliminary run takes more than {seconds:g} s")


def _observed(scene: Scene, settings: Settings, crossing: float, until: float | None, limit: float) -> PreliminaryRun:
    """A run of STARTS blocks: to `until`; without it, and at most where energy is conserved, of COLLISIONS each.

    Raises:
        RunTooLong: if it takes more than `limit` seconds.
    """
    collisions, guarded, guard, seconds = 0, 0, 0.0, 0.0
    with quietly(), Simulation(scene, settings) as sim:
        starts = [(sim.state, 0.0)]
        progress = _limit(limit)
        block = done = likely = 1
        for number in range(1, STARTS + 1):
            if until is not None:
                block = max(int(until * number / STARTS / settings.dt) - sim.frame, 1)
                # Of a gas left to itself a short run is like a long one.
                block = min(block, likely) if conserves_energy(scene) else block
            started = running_seconds()
            report = sim.run(frames=block, progress=progress)
            seconds += running_seconds() - started
            collisions, guarded, done = collisions + report.collisions, guarded + report.guarded, block
            guard = report.contact_time
            likely = int(np.clip(COLLISIONS / max(collisions / sim.frame, 1), 1, 5 * crossing / settings.dt))
            block = likely if until is None else block
            starts.append((sim.state, sim.time))
        moving = [(state.velocity[state.present] ** 2).mean() for state, _ in starts if state.present.any()]
        speed = float(np.sqrt(np.mean(moving))) if moving else 0.0
        fall = math.sqrt(2 * strongest_field(scene) * scene.smallest_radius)  # if all discs have come to rest
        by_frames = scene.thermostat is not None
        return PreliminaryRun(
            settings=settings,
            reference=settings,
            reference_name=_name_of_exact(settings, guard, guarded, collisions, by_frames),
            guard=guard,
            thermal_velocity=max(speed, fall) or 2 * scene.smallest_radius / crossing,
            collisions=collisions / sim.time,
            starts=tuple(starts[:-1]),
            gap=done * settings.dt,
            seconds=seconds / sim.time,
            by_frames=by_frames,
        )


def _name_of_exact(settings: Settings, guard: float, guarded: int, pairs: int, by_frames: bool) -> str:
    """The exact solver in words, and what its guard did."""
    acted = f"the guard acted {guarded:,} times in a run with {pairs:,} collisions"
    name = f"{EXACT} ({acted}, for impacts within {guard:.2g})" if guarded else EXACT
    if settings.contact_time is not None and guard:
        name = (
            f"{MODEL} with contact_time={settings.contact_time:g}, which is not exact: {EXACT}, but for impacts of a "
            f"disc so soon after its last one, which lose no energy ({acted})"
        )
    return name + (f", dt={settings.dt:.3g} (a thermostat acts once a frame)" if by_frames else "")
