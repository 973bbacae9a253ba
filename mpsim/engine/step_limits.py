"""What a scene and its time step must fulfil: precision, room, speeds, collision rates."""

import math
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.columns import GIVEN
from mpsim.engine.access import Notices, Once
from mpsim.engine.solvers.base import NewDiscs, Origin, Solver, Steps
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.engine.solvers.speeds import SpeedLimit, Speeds, sides_at, speeds_at_start
from mpsim.errors import FastWarning, InputError, OverlapWarning, ResolutionWarning, TooFastError
from mpsim.features import FEATURES, VECTORS
from mpsim.features.feature import acceleration_bound, is_inelastic
from mpsim.features.obstacles import OBSTACLES, surfaces_near
from mpsim.kernels.geometry import RADIUS
from mpsim.kernels.records import STEPS_OF_OVERLAP
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.scene.starts import Room, overlap_of_obstacles, overlaps

# --- Checks whether the floating-point precision is sufficient for a scene; refuses it or warns

COARSE = 1e-3
"""Spacing of coordinates, as a fraction of the smallest radius, from which on a warning is given: directions of
contacts are then wrong by about as much [radians]."""

TOO_COARSE = 0.125
"""The same, from which on contacts mean nothing and the scene is refused."""

TINY = 1e-6
"""Radius, as a fraction of the distance between neighbours, below which squares of both do not fit one float64."""

VANISHING = 1e7
"""Square of radius times speed, in smallest normal numbers, below which a warning is given."""

STEP_SPACINGS = 16
"""A step of typical length should be so many spacings of coordinates long: rounding then changes it by 3 % at most."""


def check_precision(scene: Scene, settings: Settings) -> None:
    """Refuse a scene whose numbers do not fit the precision of the run."""
    precision = settings.precision
    checks.fitting("the box", np.array([scene.width, scene.height]), precision)
    # Squares of lengths must not underflow either, nor the time of a step.
    tiny = float(np.finfo(precision).tiny)
    smallest = float(scene.radii.min(initial=scene.largest_radius))
    if smallest > 0:  # with radii of their own, no discs have none
        checks.not_vanishing("radius", smallest, 1e4 * math.sqrt(tiny), precision)
    checks.not_vanishing("dt / substeps", settings.dt / settings.substeps, tiny, precision)
    checks.fitting("dt", np.array([settings.dt]), precision)
    checks.fitting("speed of a surface", np.array([scene._driving_speed]), precision)
    fastest = 0.0
    for first, velocity in scene._velocities_in_pieces():
        fastest = max(fastest, checks.fitting("velocity", velocity, precision, first))
    for name in (*VECTORS, *(column.name for column in GIVEN)):
        if (values := getattr(scene, name, None)) is not None:
            checks.fitting(name, values, precision)
    product = 8 * scene.largest_radius * fastest
    most = math.sqrt(float(np.finfo(precision).max))
    if product > most and computes_contact_times(settings):
        raise InputError(
            f"radius times velocity must be at most {most / 8:.3g} in {precision}, so that its square fits; got "
            f"{product / 8:.3g}. Use other units{_or_double(precision)}."
        )
    if scene.mass is not None:
        lightest = float(scene.mass.min(initial=1.0))
        checks.not_vanishing("mass", lightest, tiny / float(np.finfo(precision).eps), precision)
    spacing = spacing_of(scene, precision)
    if smallest > 0 and spacing > TOO_COARSE * smallest:
        raise InputError(
            f"radius must be at least {spacing / TOO_COARSE:.3g} in a box of {scene.width:g} x {scene.height:g} in "
            f"{precision}, whose coordinates are {spacing:.3g} apart: smaller discs cannot be distinguished; "
            f"got {smallest:.3g}. Use {_finer(precision)}."
        )


def computes_contact_times(settings: Settings) -> bool:
    """Whether times of contacts are computed, with the square of radius times speed: `push` needs none."""
    return settings.contact == "impact" or not capabilities_of(settings).has_steps


def spacing_of(scene: Scene, precision: str) -> float:
    """Distance between two neighbouring coordinates at the far end of the box [length]."""
    return float(np.finfo(precision).eps) * max(scene.width, scene.height)


def coarseness(scene: Scene, settings: Settings, speed: float) -> str | None:
    """What the precision of the run loses of a scene of this rms speed: text with remedy; None if it is little."""
    precision, spacing, smallest = settings.precision, spacing_of(scene, settings.precision), scene.smallest_radius
    words = []
    if scene.count and spacing > COARSE * smallest:
        words.append(
            f"coordinates are {spacing:.3g} apart at the far end of the box, {spacing / smallest:.2g} of the smallest "
            f"radius: directions of contacts are wrong by as much. Use {_finer(precision)}"
        )
    apart = math.sqrt(scene.width * scene.height / max(scene.count, 1))
    has_steps = capabilities_of(settings).has_steps
    if not has_steps and scene.count > 1 and smallest < TINY * apart:
        words.append(
            f"discs of radius {smallest:.3g} are some {apart:.3g} apart: the square of the radius is lost beside that "
            "of the distance, so that the time of a contact is wrong by up to the time in which a disc moves its "
            "radius. Use larger discs or a smaller box"
        )
    square = (speed * smallest) ** 2
    if computes_contact_times(settings) and 0 < square < VANISHING * float(np.finfo(precision).tiny):
        words.append(
            f"the square of rms speed {speed:.3g} times radius {smallest:.3g} is lost, so that times of contacts "
            f"cannot be computed. Use other units{_or_double(precision)}"
        )
    dt = settings.dt / settings.substeps
    displacement = speed * dt
    if has_steps and 0 < displacement < STEP_SPACINGS * spacing:
        effect = "most discs do not move at all" if displacement < spacing / 2 else "rounding changes each step"
        words.append(
            f"a disc of rms speed {speed:.3g} moves {displacement:.3g} in a step, {displacement / spacing:.2g} of the "
            f"distance {spacing:.3g} between coordinates: {effect}. Use larger steps, or {_finer(precision)}"
        )
    pull = 0.0 if scene.gravity is None else float(np.abs(scene.gravity).max())
    if has_steps and 0 < pull * dt < float(np.finfo(precision).eps) * speed:
        words.append(
            f"gravity changes a velocity by {pull * dt:.3g} in a step, which is lost to rounding beside an rms speed "
            f"of {speed:.3g}. Use larger steps{_or_double(precision)}"
        )
    return ". ".join(words) + "." if words else None


_DOUBLE = "precision='float64'"


def _or_double(precision: str) -> str:
    return "" if precision == "float64" else f" or {_DOUBLE}"


def _finer(precision: str) -> str:
    return "a smaller box or larger discs" if precision == "float64" else f"{_DOUBLE} or a smaller box"


# --- Detects discs that are pressed into each other or into obstacles, which smaller steps cannot cure
#
# Because of steps discs overlap, by as much as they move in a few of them; discs that overlap more are pressed. Moving
# walls, emitters and added discs can cause it. So scenes with these are checked, in the frames in which speeds are
# checked too, and after the frame, as added discs may overlap others until then.


DEEP = 0.2
"""Overlap from which on discs are pressed, as a fraction of the smaller one's radius, beyond what steps explain."""


def pressed(solver: Solver, scene: Scene, settings: Settings) -> str | None:
    """Which discs are pressed into each other or into a capsule now, and what to do, in words; None if none are."""
    state = solver.state()
    here = np.flatnonzero(state.present)
    if not len(here):
        return None
    position, radius = state.position[here].astype(np.float64), solver.radii[here]
    steps = solver.substeps if isinstance(solver, Steps) else 1
    moved = np.hypot(*state.velocity[here].T.astype(np.float64)) * settings.dt / steps
    mean = float(np.sqrt((moved**2).mean()))
    pairs, found = overlaps(position, radius, Room((scene.width, scene.height), scene.periodic)), []
    if pairs.worst:
        i, j = pairs.worst
        found.append(([i, j], pairs.largest, f"discs {here[i]} and {here[j]} overlap by {pairs.largest:.3g}"))
    if (deepest := scene._deepest(position, radius, solver.time)) is not None:
        disc = deepest.disc
        others = surfaces_near(scene, position[disc], float(radius[disc]), solver.time)
        beside = next((f", and beside {name}" for name in others if name != deepest.where), "")
        found.append(
            ([disc], deepest.depth, f"disc {here[disc]} is {deepest.depth:.3g} deep in {deepest.where}{beside}")
        )
    for discs, depth, words in found:
        smaller = float(radius[discs].min())
        if depth > DEEP * smaller + STEPS_OF_OVERLAP * max(mean, float(moved[discs].max())):
            relief = ", ".join(sorted(feature.relief for feature in FEATURES if feature.relief))
            return (
                f"discs are pressed into each other: at time {solver.time:g} {words}, {depth / smaller:.2g} of a "
                f"radius, and discs move {mean:.3g} in a step on average. They were placed that way, or there is no "
                "room for them: smaller steps and on_fast='substep' do not help. "
                f"{relief[0].upper()}{relief[1:]}, or use smaller ones or a larger box."
            )
    return None


def squeezed(solver: Solver, scene: Scene, settings: Settings, speeds: Speeds) -> str | None:
    """What to say of discs that kernels report to be pinched or pressed; None if there is nothing to be said."""
    if (disc := speeds.pinched) < 0:
        return pressed(solver, scene, settings)
    state, radius = solver.state(disc, disc + 1), float(solver.radii[disc])
    surfaces = surfaces_near(scene, state.position[0].astype(np.float64), radius, solver.time)
    between = " and ".join(surfaces[:2]) if len(surfaces) > 1 else "surfaces less than its diameter apart"
    return (
        f"disc {disc} is pinched between {between} in frame {solver.frame - 1}: one more step presses it through one "
        f"of them. Let what moves keep a diameter, {2 * radius:g}, from what is at rest, or stop earlier; smaller "
        "steps do not help."
    )


# --- Limits of the time step: checks speeds and collision rates, and warns, refuses or uses sub-steps
#
# Two discs that touch at the start of a step and move towards each other are 2 R - 2 v dt apart at its end. While each
# moves less than its own radius, centres cannot pass one another, nor the middle of a capsule: whatever overlaps is
# found on the side on which it came. Beyond, a pair may be met from behind, or pass unseen. Between two walls a disc
# must not move farther than its free distance, or the second bounce of one step is lost. And where discs meet more
# than one other in a step on average, collisions that follow from others are missed.
#
# The kernels see a disc that is too fast for the step to come, whatever made it fast, while they move it: the frame is
# then the last of its command, and the exact look follows. What no single speed tells, collisions in a step and the
# room between walls, is looked at in frames that follow from what can change it: at the start, where discs are added,
# as often as a wall has taken a little of the box, and now and then. All of it depends on the state alone. So what
# follows is the same with any number of workers, however a run is cut into calls, saved or healed; see control.deep.

BOUND, BOUND_BESIDE_SURFACES = 1.0, 0.5
"""Displacement of a disc in one step, as a fraction of its radius (of its free distance between walls), from which on
it is too fast; and, with half the thickness of the thinnest obstacle more, where something moves that may press discs
through it."""

COLLISIONS = 1.0
"""Collisions of a disc in one step, on average, from which on too many are missed: those that follow from others."""

LOST = 0.001
"""Fraction of its energy that `push` takes from a disc at a bounce under gravity, from which on it is said."""

AIM = 0.5
"""Fraction of both bounds kept by on_fast="substep" where it looks."""

SUBSTEP_LIMIT = 0.7
"""Fraction of the bound from which on on_fast="substep" looks at once: where two equal discs meet, neither leaves
faster than sqrt(2) times the faster one came, so that the frame that is seen too late stays below the bound."""

ADAPT_EVERY = 16
"""Frames between two looks of on_fast="substep", and in boxes so narrow that a bound of theirs is below the radius."""

LOOK_EVERY, LOOK_LARGE_EVERY, LARGE = 4096, 1024, 8192
"""Frames between two looks where nothing but collisions changes speeds: fewer from LARGE discs on, where a look costs
far less than a frame. Either way a look takes less than a hundredth of the time."""

SQUEEZE = 0.02
"""Fraction of the room that it will leave in the end by which a wall moves between two looks."""

GAIN = 0.25
"""Fraction of the bound of speed that acceleration adds to a disc between two looks."""

MOST_SUBSTEPS = 10_000
"""Sub-steps of a frame that on_fast="substep" chooses at most: more are a mistake in dt or in a speed."""

JUST_ABOVE = 1 + 1e-5
"""Where kernels see a disc, in parts of the bound: rounding of float32 must not let them see what is not above it."""


class StepLimits:
    """Looks at the fastest disc, and at collisions in a step, and acts as Settings.on_fast says.

    origin: when the length of frames began to act.
    """

    def __init__(self, scene: Scene, settings: Settings, origin: Origin = Origin()):  # noqa: B008 - immutable
        self._scene = scene
        self._settings = settings
        self._has_steps = has_steps = capabilities_of(settings).has_steps
        self._origin = origin
        self._fast, self._pressed = Once(given=not has_steps), Once(given=not has_steps)  # so that nobody looks
        self._has_limit = False
        self._acceleration = acceleration_bound(scene)
        self._surface = OBSTACLES.surface_speed(scene) if scene.obstacles else 0.0  # towards which a disc may move
        self._bound = BOUND
        if scene.obstacles and scene._surface_speed > 0:
            half = scene.capsules_at(0.0)[:, RADIUS]  # of a container it is below 0, and nothing gets past it
            self._bound = min(BOUND_BESIDE_SURFACES + half[half >= 0].min(initial=np.inf) / scene.largest_radius, BOUND)
        narrow = any(
            not wraps and length < 3 * scene.largest_radius
            for wraps, length in zip(scene.periodic, scene._smallest_sides(), strict=True)
        )
        self._often = settings.on_fast == "substep" or narrow
        self._squeezing, self._squeezed = self._frames_of_moving_walls() if scene._moving_walls else (0, -1)
        lacks_room = scene._surface_speed > 0 or bool(scene.emitters)
        self._roomy_count = -1 if lacks_room else scene.count  # up to which discs cannot be pressed into each other
        self._last_look, self._next_look, self._discs = 0, 0, 0  # around the frames that were asked for

    def under(self, scene: Scene, settings: Settings, origin: Origin) -> "StepLimits":
        """Those under another scene and settings; what has been warned of is not warned of again."""
        other = StepLimits(scene, settings, origin)
        other._fast, other._pressed = self._fast, self._pressed
        return other

    @cached_property
    def _at_start(self) -> Speeds:
        return speeds_at_start(self._scene)

    def _frames_of_moving_walls(self) -> tuple[int, int]:
        """Frames in which a wall takes SQUEEZE of the least room that it leaves, and the last of such looks."""
        walls, dt, room = self._scene._moving_walls, self._settings.dt, self._scene._smallest_sides()
        # A wall that needs 1e18 frames for it has no effect that can be told from none.
        frames = min((SQUEEZE * room[wall.axis] / (wall.speed * dt) for wall in walls if wall.speed), default=1e18)
        every = math.ceil(min(max(frames, 1.0), 1e18))
        last = self._origin.frame + (max(wall.rests for wall in walls) - self._origin.time) / dt
        return every, every * math.ceil(min(last / every, 1e18))

    def at_start(self, notices: Notices) -> None:
        """Warn, before anything is run, of overlaps, lost digits, and speeds, unless these are refused."""
        scene = self._scene
        # Without steps, discs that overlap each other are refused when they are placed.
        if overlaps := scene.overlaps_at_start() if self._has_steps else overlap_of_obstacles(scene):
            then = "The first frames push them apart" if self._has_steps else "method='event' lets them leave"
            text = f"{overlaps}. {then}. To avoid this, give positions that leave room for the discs."
            notices.warn(text, OverlapWarning)
        self.at_resume(notices)
        if not self._has_steps:
            return
        lost = self._lost_at_a_bounce() if self._acceleration else 0.0
        if lost > LOST:
            text = (
                f"contact='push' takes {lost:.2g} of its energy or more from a disc at each bounce under gravity or "
                "acceleration, on average (g dt / speed), though the restitution is 1. Use contact='impact', which "
                "keeps the energy, or a smaller dt."
            )
            notices.warn(text, FastWarning)
        if self.adapts:
            self.substeps_for(self._at_start, 0)
        else:
            self._tell_of_fast(self._at_start, 0, notices)

    def at_resume(self, notices: Notices) -> None:
        """Warn, before a run goes on from a checkpoint, of lost digits."""
        if coarse := coarseness(self._scene, self._settings, self._at_start.mean_speed):
            notices.warn(f"in {self._settings.precision} {coarse}", ResolutionWarning)

    def _lost_at_a_bounce(self) -> float:
        """Fraction of its energy that the fastest disc loses at a bounce by `push`, where no restitution takes any.

        A step conserves v^2/2 + g y - g dt v/2; a bounce at v, beyond the wall by v dt/2 on average, takes g dt v/2.
        """
        scene, settings = self._scene, self._settings
        if settings.contact != "push" or is_inelastic(scene) or all(scene.periodic):
            return 0.0
        fall = math.sqrt(2 * self._acceleration * max(sides_at(scene, 0.0)))
        fastest = math.hypot(self._at_start.speed, fall)
        return self._acceleration * settings.dt / settings.substeps / fastest

    @property
    def adapts(self) -> bool:
        """Whether sub-steps are chosen."""
        return self._settings.on_fast == "substep" and not self._fast.given

    def frames_ahead(self, frame: int, count: int) -> int:
        """Number of frames until the next look; very large if there is none."""
        if self._fast.given and not self.may_be_pressed(count):
            return 2**62
        if not (self._last_look < frame < self._next_look and count == self._discs):
            past = [(frame % every, every) for every in self._intervals(frame, count)]
            self._last_look, self._discs = frame - min(each for each, _ in past), count
            self._next_look = frame + min(every - each for each, every in past)
        return self._next_look - frame

    def is_due(self, frame: int, count: int) -> bool:
        """Whether to look at speeds before this frame, or to lift the limit, as the warning has been given.

        At the first frame it is: a snapshot in which no frame has been done does not tell the sub-steps.
        """
        if self._fast.given:
            return self._has_limit
        return frame == self._origin.frame or self._is_look(frame, count)

    def _is_look(self, frame: int, count: int) -> bool:
        """Whether there is a look in this frame, for any reason."""
        if self._last_look < frame < self._next_look and count == self._discs:
            return False
        return any(frame % every == 0 for every in self._intervals(frame, count))

    def may_be_pressed(self, count: int) -> bool:
        """Whether n discs are checked for being pressed: by a moving surface, emitters, or added discs."""
        return count > self._roomy_count and not self._pressed.given

    def set_limit(self, solver: Solver) -> None:
        """Have the solver end its commands when a disc is too fast; never, once that has been warned of."""
        limit, gain, deep = math.inf, 0.0, not self._pressed.given
        self._has_limit = not self._fast.given
        if self.adapts:
            limit, gain = SUBSTEP_LIMIT * self._bound, self._gain(solver.frame, 1)
        elif self._has_limit:  # a surface that comes towards a disc is as a disc that is faster
            limit, gain = JUST_ABOVE * self._bound, self._surface
        if isinstance(solver, Steps):
            solver.set_speed_limit(SpeedLimit(limit, gain, deep))

    def check(
        self, solver: Solver, notices: Notices, new: NewDiscs | None = None, changed: NDArray[np.int64] | None = None
    ) -> int:
        """Check the speeds, new discs included; warn, refuse, or return the number of sub-steps from now on.

        changed: numbers of the discs that alone can have become faster; sub-steps depend on all.
        """
        usual = self._settings.substeps if self._has_steps else 1
        if not isinstance(solver, Steps) or (self._fast.given and not solver.too_fast):
            if self._has_limit:
                self.set_limit(solver)
            return usual
        speeds = solver.speeds(new, None if self.adapts else changed)
        words = partial(squeezed, solver, self._scene, self._settings, speeds)
        if (speeds.pressed or speeds.pinched >= 0) and (text := solver.ranks.on_root(words)):  # all ranks know
            self._tell(text, notices, self._pressed)
        self.set_limit(solver)
        if self._fast.given:
            return usual
        if self.adapts:
            return self.substeps_for(speeds, solver.frame)
        self._tell_of_fast(speeds, solver.frame, notices)
        return usual

    def look_for_pressed(self, solver: Solver, notices: Notices) -> None:
        """Look for discs that are pressed into each other, after frames that are checked; warn, or refuse."""
        if self._is_look(solver.frame, solver.count):
            text = solver.ranks.on_root(lambda: pressed(solver, self._scene, self._settings))
            if text:
                self._tell(text, notices, self._pressed)

    def _tell(self, text: str, notices: Notices, once: Once, otherwise: str = "") -> None:
        """Refuse to go on, or warn once; otherwise: what is said besides then."""
        if self._settings.on_fast == "error":
            raise TooFastError(f"{text} on_fast='warn' runs it anyway.")
        notices.warn(text + otherwise, FastWarning, once)

    def substeps_for(self, speeds: Speeds, frame: int) -> int:
        """Sub-steps that keep speeds and collisions at AIM of their bounds, and below these until the next look."""
        dt = self._settings.dt
        gain = self._gain(frame, ADAPT_EVERY)
        gained = gain * dt / min(speeds.limit, speeds.smallest)
        moved, collisions = self._fraction(speeds, dt) + gained, speeds.collision_rate * dt
        fraction = max(moved / self._bound, collisions / COLLISIONS) / AIM
        if math.isinf(fraction):
            raise TooFastError(f"{self._words(speeds, frame)} No number of sub-steps is enough. Use a larger box.")
        if not fraction <= MOST_SUBSTEPS:
            words = self._words(speeds, frame)
            if gained > max(speeds.fraction(dt), speeds.collision_rate * dt):
                words = (
                    f"acceleration or a moving wall can give a disc a speed of {gain:.3g} within {ADAPT_EVERY} frames "
                    f"of frame {frame}, with which it moves {gained:.3g} times its radius in one step of {dt:.3g}."
                )
            raise TooFastError(
                f"{words} on_fast='substep' takes at most {MOST_SUBSTEPS} sub-steps, and would "
                f"need {fraction:.3g}. Use a smaller dt."
            )
        return max(self._settings.substeps, math.ceil(fraction))

    def _gain(self, frame: int, frames: int) -> float:
        """Speed that a disc can gain in so many frames by other things than discs: acceleration, a moving wall.

        Of the last frame at which sub-steps are looked at anyway: what a simulation that is resumed there would find.
        """
        last, walls = frame - frame % ADAPT_EVERY, self._scene._moving_walls
        speed = max((wall.speed for wall in walls), default=0.0) if last <= self._squeezed else 0.0
        push = 2 * (speed or self._surface)
        return self._acceleration * self._settings.dt * frames + push

    def _tell_of_fast(self, speeds: Speeds, frame: int, notices: Notices) -> None:
        """Refuse the fastest disc, or warn of it once, unless it is slow enough."""
        settings = self._settings
        dt = settings.dt / settings.substeps
        fraction, collisions = self._fraction(speeds, dt) / self._bound, speeds.collision_rate * dt / COLLISIONS
        if fraction <= 1 and collisions <= 1:
            return
        needed = settings.substeps * max(fraction, collisions) / AIM
        remedy = "Use a larger box"
        if math.isfinite(needed):
            remedy = f"Use dt={settings.dt * settings.substeps / needed:.2g}"
            remedy += f", substeps={math.ceil(needed)}" if needed <= MOST_SUBSTEPS else ""
            remedy += " or on_fast='substep'"
        text = f"{self._words(speeds, frame)} {remedy};"
        self._tell(text, notices, self._fast, " method='event' has no such limit.")

    def _fraction(self, speeds: Speeds, dt: float) -> float:
        """Distance by which the fastest disc and an obstacle can near each other in dt, as a fraction of its limit."""
        return speeds.fraction(dt) + self._surface * dt / speeds.limit

    def _words(self, speeds: Speeds, frame: int) -> str:
        dt = self._settings.dt / self._settings.substeps
        fraction, collisions = self._fraction(speeds, dt), speeds.collision_rate * dt
        when = speeds.when or f"in frame {frame}"
        if math.isinf(collisions):
            return f"{when} discs fill the box more densely than they can be packed, so that they overlap."
        if not fraction > self._bound and collisions > COLLISIONS:
            return (
                f"{when} a disc collides about {collisions:.3g} times in one step (rms speed "
                f"{speeds.mean_speed:.3g}, step {dt:.3g}); above {COLLISIONS:g} many collisions that follow from "
                "others are missed."
            )
        towards = f", towards an obstacle of speed {self._surface:.3g}" if self._surface else ""
        length = f"its radius {speeds.limit:.3g}"
        lost = "one radius, discs may pass through each other without a collision"
        if self._bound < BOUND:
            lost = f"{self._bound:.3g} radii, what moves may press discs through an obstacle"
        if speeds.between:
            length = f"its free path {speeds.limit:.3g} between the walls along {speeds.between}"
            lost = "one free path, bounces are lost"
        return (
            f"{when} {'a disc' if speeds.disc < 0 else f'disc {speeds.disc}'} moves {fraction:.3g} times {length} in "
            f"one step (speed {speeds.speed:.3g}{towards}, step {dt:.3g}); beyond {lost}."
        )

    def _intervals(self, frame: int, count: int) -> list[int]:
        """Frames between two looks, for each reason that there is for them."""
        intervals = [LOOK_LARGE_EVERY if count >= LARGE else LOOK_EVERY]
        if self._often:
            intervals.append(ADAPT_EVERY)
        if self._acceleration > 0:
            bound = self._bound * self._scene.smallest_radius / self._settings.dt * self._settings.substeps
            frames = GAIN * bound / (self._acceleration * self._settings.dt)
            intervals.append(max(math.ceil(min(frames, LOOK_EVERY)), ADAPT_EVERY))
        if frame <= self._squeezed:
            intervals.append(self._squeezing)
        return intervals
