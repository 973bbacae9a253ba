"""The preliminary run of a trade-off study, and its independent starts."""

import dataclasses
import functools
import inspect
import math
import re
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mpsim.core.machine import usable_cores
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.event_block import contact_time_at_rest, longest_contact_time
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError, MpsimError
from mpsim.features import FEATURES, energy
from mpsim.features.emitters import Emitter
from mpsim.scene import placement
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.comparison import divergence, typical_speed
from mpsim.studies.replicas import quietly

# --- Independent starts of a scene, over which a trade-off study averages

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.


VARIATION = 1e-3
"""Displacement of a disc, in diameters of the smallest, and relative change of its velocity, between two variations of
one start: too small to matter, large enough for collisions to decorrelate them soon."""

KINDS = ("kind", "same")

StartsGiven = str | Callable[[int], Scene] | Sequence[Scene] | None
"""The argument `starts`: see `Starts`."""


class Starts:
    """Numbered starts of one scene. The same number always gives the same start.

    For "kind" and "same", number 0 is the scene itself.

    Args:
        scene: the scene.
        given: "kind": other starts of the same kind (`Scene.redrawn`); "same": this start with small variations
            (VARIATION); a function from a number to a Scene, or a list of Scenes; None: "kind" if the scene knows how
            it was made, else "same".

    Attributes:
        name: the starts in words.
        key: a text that identifies the starts; functions are distinguished by the first two starts that they make.
        same: whether they are variations of one start, so that their runs are initially correlated.
        number: of starts; None if there is no limit.

    Raises:
        InputError: if the scene has no other starts, or `given` is not one of these.
    """

    def __init__(self, scene: Scene, given: StartsGiven = None):
        kind = ("kind" if scene._can_redraw else "same") if given is None else given
        if isinstance(kind, str) and kind not in KINDS:
            raise InputError(f"starts must be 'kind', 'same', a function or a list of Scenes; got {given!r}.")
        self.same: bool = isinstance(kind, str) and kind == "same"
        self.number: int | None = None
        self._made: dict[int, Scene] = {}
        if callable(kind):
            self._make: Callable[[int], Scene] = _of_one_number(kind)
            self.name: str = "starts that were given by a function"
        elif isinstance(kind, str) and kind == "kind":
            self._made = {0: scene, 1: scene.redrawn(1)}  # which raises if there is no other
            self._make = scene.redrawn
            self.name = "other starts of the same kind"
        elif isinstance(kind, str):
            self._made, self._make = {0: scene}, functools.partial(varied, scene)
            self.name = f"this start, each disc displaced by up to {VARIATION:g} of a diameter"
        else:
            chosen = _listed(kind)
            self._made = dict(enumerate(chosen))
            self._make = lambda number: _too_few(len(chosen), number)
            self.number = len(chosen)
            self.name = f"the {len(chosen)} starts that were given"
        known = [] if isinstance(kind, str) else [self[number] for number in range(self.number or 2)]
        self.key: str = " ".join([self.name, *(each.digest() for each in known)])

    def __getitem__(self, number: int) -> Scene:
        """The start of a number, >= 0.

        Raises:
            InputError: if what was given for it is not a Scene, or there are too few starts.
        """
        if number not in self._made:
            made: Any = self._make(number)
            if not isinstance(made, Scene):
                raise InputError(f"starts must give Scenes; for {number} it gave {type(made).__name__}.")
            self._made[number] = made
        return self._made[number]


def varied(scene: Scene, seed: int) -> Scene:
    """The scene with positions and velocities varied by VARIATION, at the same kinetic energy.

    Displacements that would lead to an overlap, or out of the box, are rejected. Emitters are varied likewise.
    """
    rng = np.random.default_rng(seed)
    moves = rng.uniform(-1, 1, (scene.count, 2)) * (VARIATION * 2 * scene.smallest_radius)
    solid = np.vstack([scene.capsules_at(0.0), *_wall_as_capsule(scene)])
    position = placement.displaced(
        scene.position, scene.radii, (scene.width, scene.height), scene.periodic, solid, moves
    )
    velocity = scene.velocity * (1 + VARIATION * rng.normal(size=scene.velocity.shape))
    masses = 1.0 if scene.mass is None else scene.mass[:, None]
    energy = float((masses * velocity**2).sum())
    if energy > 0:
        velocity *= np.sqrt(float((masses * scene.velocity**2).sum()) / energy)
    common = scene.largest_radius
    emitters = tuple(_varied_emitter(scene, emitter, common, rng) for emitter in scene.emitters)
    return scene.starting_from(State(position, velocity))._replace(emitters=emitters)


def _wall_as_capsule(scene: Scene) -> list[list[float]]:
    """A capsule along the start of a moving wall, which discs must not overlap."""
    wall = scene._moving_wall
    if wall is None:
        return []
    (left, bottom), (right, top) = scene.walls_at(0.0)
    ends = (
        (left, bottom, left, top),
        (right, bottom, right, top),
        (left, bottom, right, bottom),
        (left, top, right, top),
    )
    return [[*ends[wall.edge], 0.0]]


def _varied_emitter(scene: Scene, emitter: Emitter, common: float, rng: np.random.Generator) -> Emitter:
    """The emitter with varied position and velocity; it stays where it is if the new disc would overlap a capsule."""
    radius = common if emitter.radius is None else emitter.radius
    before, speed = np.array(emitter.position), np.array(emitter.velocity)
    place = np.clip(before + rng.uniform(-1, 1, 2) * VARIATION * 2 * radius, *scene.limits(radius))
    if scene._deepest(place[None], np.array([radius])) is not None:
        place = before
    return dataclasses.replace(emitter, position=place, velocity=speed * (1 + VARIATION * rng.normal(size=2)))


def _listed(given: Any) -> list[Scene]:
    try:
        chosen = list(given)
    except TypeError:
        chosen = []
    if len(chosen) < 2 or not all(isinstance(each, Scene) for each in chosen):
        raise InputError(f"starts must be 'kind', 'same', a function or a list of two Scenes or more; got {given!r}.")
    return chosen


def _of_one_number(given: Callable[[int], Scene]) -> Callable[[int], Scene]:
    try:
        inspect.signature(given).bind(0)
    except TypeError as error:
        raise InputError(
            f"starts must be a function of one number, from 0 on, that returns a Scene; got {given!r} ({error})."
        ) from None
    except ValueError:  # one without a signature, as some of C have
        pass
    return given


def _too_few(there: int, number: int) -> Scene:
    raise InputError(
        f"starts must hold a Scene for every run; {there} were given, and number {number} is needed. Give a function "
        "that makes them, or fewer replicas."
    )


# --- The preliminary run of a trade-off study: the reference, the speed of the discs, and their collision rate

STARTS = 8
"""Number of states along the run from which short runs start."""

COLLISIONS = 20_000
"""Approximate number of collisions between two of these states, if there is no duration: enough to decorrelate them."""

EXACT_SECONDS = 10.0
"""Seconds of a preliminary run after which the exact solver is too slow for a scene."""

BOUNCES = 500_000
"""Bounces of discs at rest that the exact solver follows in a second at least, collisions among them included."""

STEPPED_SECONDS = 20.0
"""Seconds after which a stepped preliminary run is too slow, too."""

FINEST = 0.002
"""Step of a stepped reference, in units of diameter / speed, if there is time for it."""

COARSEST = 0.02
"""Its longest step: a coarser reference would not resolve the errors of the steps that are used in practice."""

PRELIMINARY_STEP = 0.05
"""Step of a stepped preliminary run, in the same units."""

RUNS = 20
"""Approximate number of runs of the reference in a trade-off study, among which its time is divided."""

FRAMES = 100
"""Frames that are timed to measure the time of a step."""

MOST_CROSSINGS = 1e11
"""Length of the runs at most, in times in which a disc flies its diameter."""

LYAPUNOV_TIMES = 2.0
"""Length of a short run in Lyapunov times: long enough to show an error, far below the predictability horizon."""

GOLDEN = (math.sqrt(5) - 1) / 2
"""The fractional parts of its multiples are far from each other and from 0 (Weyl sequence)."""


@dataclass(frozen=True)
class PreliminaryRun:
    """Results of the preliminary run.

    Attributes:
        reference: settings of the reference, `event` if it can run the scene.
        reference_name: the same in words, with the reason if it cannot.
        guard: contact time of the reference [time]; 0 if it has none, because nothing needs one or it is stepped.
        thermal_velocity: root mean square of one velocity component [length/time].
        collisions: of pairs, per time [1/time].
        growth: Lyapunov exponent, at least 1/100 of a crossing time's inverse [1/time].
        short: length of a short run [time].
        starts: states along the run.
        gap: time between the last two of them [time].
        settings: of the run.
        seconds: wall time that the reference takes for a unit of time on one core [s/time].
        step_seconds: wall time of one step with one pass on one core [s].
        by_frames: whether a thermostat acts once a frame, so that results depend on dt of the exact solver too.
    """

    reference: Settings
    reference_name: str
    thermal_velocity: float
    collisions: float
    growth: float
    short: float
    starts: tuple[State, ...]
    gap: float
    settings: Settings
    seconds: float = 0.0
    step_seconds: float = 0.0
    guard: float = 0.0
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

    def further_starts(self, scene: Scene, first: int) -> tuple[State, ...]:
        """As many other states, between each start and the next, different for each number `first`."""
        elapsed = self.gap * (first * GOLDEN % 1)
        settings = replace(self.settings, dt=min(self.settings.dt, elapsed / 2))
        states = []
        for start in self.starts:
            with quietly(), Simulation(scene.starting_from(start), settings) as sim:
                sim.run(until=elapsed)
                states.append(sim.state)
        return tuple(states)


EXACT, MODEL = "the exact solver", "the contact-time model"
"""First words of PreliminaryRun.reference_name if that is the reference."""


@dataclass(frozen=True)
class Observation:
    """Results of one run, as in `PreliminaryRun`.

    Attributes:
        pairs: collisions of pairs.
        guarded: losses of energy that the guard suppressed.
        guard: its contact time [time].
    """

    thermal_velocity: float
    collisions: float
    starts: tuple[State, ...]
    gap: float
    pairs: int
    guarded: int
    guard: float
    seconds: float


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
        drives = f"{', '.join(others)} or {last}"
        raise InputError(
            f"a trade-off study needs a scene in which something moves; got {scene!r}, all at rest. "
            f"Give it discs with velocities, {drives}."
        )
    crossing = 2 * scene.smallest_radius / speed
    if until is not None:
        _demand_reachable(until, crossing)
    exact = earlier is None or earlier.startswith((EXACT, MODEL))
    limit_seconds = _limit_seconds(seconds, contact_time) if earlier is None else math.inf
    by_frames = scene.thermostat is not None  # so the reference needs frames short enough for a bath in time
    dt = float(f"{PRELIMINARY_STEP * crossing:.2g}") if by_frames else crossing / 4
    settings, reason = Settings(method="event", dt=dt, contact_time=contact_time), ""
    try:
        if not exact:
            raise _NotUsable
        found = _observe(scene, settings, crossing, until, limit_seconds)
    except (MpsimError, _NotUsable) as error:
        if contact_time is not None:
            raise InputError(_refusal(contact_time, error, _longer_contact_time(scene, until, seconds))) from error
        exact, reason = False, str(error)
        if isinstance(error, _NotUsable) and reason and _may_come_to_rest(scene):
            reason += _remedy(_longer_contact_time(scene, until, seconds))
        settings = Settings(dt=PRELIMINARY_STEP * crossing, passes=2, on_fast="substep", workers=1)
        found = _observe_stepped(scene, settings, crossing, until)
    speed = max(found.thermal_velocity, _speed_of_fall(scene)) or speed  # at which there is motion to resolve
    own = 2 * scene.smallest_radius / speed
    reference, cost, growth = settings, found.seconds, 1 / own
    if exact:
        growth = _growth(scene, crossing, limit_seconds, contact_time)
        step_seconds = _step_seconds(scene, PRELIMINARY_STEP * crossing, until, limit_seconds)
    else:
        step_seconds = found.seconds * settings.dt / settings.passes
        dt = _finest(settings, found.seconds, own, until or 0.0, seconds) if earlier is None else _dt_of(earlier)
        reference, cost = replace(settings, dt=dt), found.seconds * settings.dt / dt
    stepped = f"two passes at dt={reference.dt:.3g}, the finest affordable run, because {EXACT} is not usable: {reason}"
    exactly = _name_of_exact(found, contact_time)
    exactly += f", dt={reference.dt:.3g} (a thermostat acts once a frame)" if by_frames else ""
    name = earlier or (exactly if exact else stepped)
    short = min(LYAPUNOV_TIMES / growth, 5 * own)
    return PreliminaryRun(
        reference=reference,
        reference_name=name,
        thermal_velocity=speed,
        collisions=found.collisions,
        growth=growth,
        short=short,
        starts=found.starts,
        gap=found.gap,
        settings=settings,
        seconds=cost,
        step_seconds=step_seconds,
        guard=found.guard,
        by_frames=by_frames,
    )


def _demand_reachable(until: float, crossing: float) -> None:
    longest = MOST_CROSSINGS * crossing
    if until > longest:
        raise InputError(
            f"until must be at most {longest:.3g}, in which a disc flies {MOST_CROSSINGS:g} diameters; got {until:g}. "
            "Take shorter runs."
        )


def _name_of_exact(found: Observation, contact_time: float | None) -> str:
    """The exact solver in words, and what its guard did."""
    acted = f"the guard acted {found.guarded:,} times in a run with {found.pairs:,} collisions"
    if contact_time is not None and found.guard:
        return (
            f"{MODEL} with contact_time={contact_time:g}, which is not exact: {EXACT}, but for impacts of a disc so "
            f"soon after its last one, which lose no energy ({acted})"
        )
    return f"{EXACT} ({acted}, for impacts within {found.guard:.2g})" if found.guarded else EXACT


def _may_come_to_rest(scene: Scene) -> bool:
    """Whether discs with losses may settle in a field, where they collide without end."""
    return energy.has_body_force(scene) and energy.has_losses(scene)


def _longer_contact_time(scene: Scene, until: float | None, seconds: float) -> float:
    """A contact time with which a run is likely to be affordable, though its discs come to rest, for people [time]."""
    number = scene.count + sum(each.limit or 0 for each in scene.emitters)
    bounces = number * (until or 0.0) / (BOUNCES * _affordable(seconds))
    return float(f"{min(max(contact_time_at_rest(scene), bounces), longest_contact_time(scene) / 4):.1g}")


def _remedy(longer: float) -> str:
    """What a contact time would make of the exact solver."""
    return (
        f", as discs with losses come to rest, and collide without end. Give contact_time={longer:g} for a reference "
        "that is a model of the scene, but ends"
    )


def _refusal(given: float, error: Exception, longer: float) -> str:
    """Why there is no reference with the contact time given, and what would help."""
    if not isinstance(error, _NotUsable):
        return f"contact_time is of {EXACT}, which is not usable: {error} Or leave contact_time out."
    return (
        f"contact_time must be so long that {EXACT} reaches the end of a run; with {given:g} {error}. Give a longer "
        f"one, such as {max(longer, float(f'{4 * given:.1g}')):g}, more time (seconds=...), a shorter run "
        "(until=...), or none, for a stepped reference."
    )


def _limit_seconds(seconds: float, contact_time: float | None) -> float:
    """Seconds that the preliminary run of the exact solver may take; with a contact time, all that can be afforded."""
    return _affordable(seconds) if contact_time is not None else min(EXACT_SECONDS, _affordable(seconds))


def _speed_of_fall(scene: Scene) -> float:
    """Speed of a fall through a radius [length/time]: a scale of motion when all discs have come to rest."""
    return math.sqrt(2 * energy.strongest_field(scene) * scene.smallest_radius)


def _speed_to_come(scene: Scene) -> float:
    """Typical speed, including discs of emitters, a moving wall and a heat bath [length/time]."""
    speeds = [typical_speed(scene), *(float(np.hypot(*np.array(each.velocity))) for each in scene.emitters)]
    if energy.adds_discs(scene):
        speeds.append(math.sqrt(2 * energy.gravity_strength(scene) * 2 * scene.largest_radius))
    if (wall := scene._moving_wall) is not None and scene.count:
        speeds.append(abs(wall.speed))
    if scene.count:
        speeds.append(math.sqrt(2) * energy.thermal_speed(scene))
    return max(speeds)


def _finest(settings: Settings, seconds: float, crossing: float, until: float, limit: float) -> float:
    """Step of the stepped reference: FINEST, or as fine as time allows.

    Raises:
        InputError: if there is no time even for COARSEST.
    """
    dt = max(FINEST * crossing, seconds * settings.dt * until / _affordable(limit))
    if dt > COARSEST * crossing:
        needed = seconds * settings.dt / (COARSEST * crossing) * until * RUNS / usable_cores()
        raise InputError(
            f"a trade-off study of this scene needs about {needed:.0f} s, because one run of its reference to "
            f"{until:g} takes so long; it may take {limit:g} s. Give it more time (seconds=...), a shorter run "
            "(until=...), or a smaller scene of the same kind."
        )
    return float(f"{dt:.3g}")


def _dt_of(name: str) -> float:
    """The step in the name of a stepped reference."""
    found = re.search(r"dt=([^,]+),", name)
    assert found is not None  # such names are made here
    return float(found[1])


def _affordable(limit: float) -> float:
    """Seconds that one run of the reference may take."""
    return limit * usable_cores() / RUNS


def _step_seconds(scene: Scene, dt: float, until: float | None, limit_seconds: float) -> float:
    """Approximate time of one step with one pass on one core [s]; with emitters its mean over the run."""
    with quietly(), Simulation(scene, Settings(dt=dt, workers=1)) as sim:
        if until is None or not energy.adds_discs(scene):
            return float(np.median(sim.run(frames=FRAMES).frame_seconds))
        begun = time.thread_time()
        with suppress(_NotUsable):
            sim.run(until=until, progress=_time_limit(limit_seconds))
        return (time.thread_time() - begun) / sim.frame


def _growth(scene: Scene, crossing: float, limit_seconds: float, contact_time: float | None) -> float:
    """Lyapunov exponent; a small one if the runs do not diverge."""
    least = 0.01 / crossing
    try:
        with quietly():
            found = divergence(scene, contact_time=contact_time, progress=_time_limit(limit_seconds))
            return max(found.rate.value, least)
    except (MpsimError, _NotUsable):
        return least


def _time_limit(limit_seconds: float) -> Callable[[int, int], None]:
    """A progress function that ends a run after so many seconds of this thread's time."""
    end = time.thread_time() + limit_seconds

    def progress(done: int, frames: int) -> None:
        if time.thread_time() > end:
            raise _NotUsable(f"its preliminary run takes more than {limit_seconds:g} s")

    return progress


class _NotUsable(Exception):  # noqa: N818 - not an error
    """Why a solver cannot be used for this run, in words."""


def _observe_stepped(scene: Scene, settings: Settings, crossing: float, until: float | None) -> Observation:
    try:
        return _observe(scene, settings, crossing, until, STEPPED_SECONDS)
    except _NotUsable:
        raise InputError(
            f"a trade-off study needs a scene whose preliminary run takes less than {STEPPED_SECONDS:g} s; that of "
            f"{scene!r} takes longer. Take a smaller scene of the same kind: errors hardly depend on the number of "
            "discs."
        ) from None


def _observe(
    scene: Scene, settings: Settings, crossing: float, until: float | None, limit_seconds: float
) -> Observation:
    """A run of STARTS blocks: to `until`; without it, and at most where energy is conserved, of COLLISIONS each."""
    collisions, guarded, guard, seconds = 0, 0, 0.0, 0.0
    with quietly(), Simulation(scene, settings) as sim:
        states = [sim.state]
        progress = _time_limit(limit_seconds)  # from here on, as the constructor may have compiled
        block = done = likely = 1
        for number in range(1, STARTS + 1):
            if until is not None:
                block = max(int(until * number / STARTS / settings.dt) - sim.frame, 1)
                # Of a gas left to itself a short run is like a long one.
                block = min(block, likely) if energy.conserves_energy(scene) else block
            started = time.thread_time()
            report = sim.run(frames=block, progress=progress)
            seconds += time.thread_time() - started
            collisions, guarded, done = collisions + report.collisions, guarded + report.guarded, block
            guard = report.contact_time
            likely = int(np.clip(COLLISIONS / max(collisions / sim.frame, 1), 1, 5 * crossing / settings.dt))
            block = likely if until is None else block
            states.append(sim.state)
        moving = [(state.velocity[state.present] ** 2).mean() for state in states if state.present.any()]
        speed = float(np.sqrt(np.mean(moving))) if moving else 0.0
        return Observation(
            thermal_velocity=speed,
            collisions=collisions / sim.time,
            starts=tuple(states[:-1]),
            gap=done * settings.dt,
            pairs=collisions,
            guarded=guarded,
            guard=guard,
            seconds=seconds / sim.time,
        )
