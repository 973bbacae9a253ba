"""Limits of the time step: checks speeds and collision rates, and warns, refuses or uses sub-steps.

Two discs that touch at the start of a step and move towards each other are 2 R - 2 v dt apart at its end. While each
moves less than its own radius, centres cannot pass one another, nor the middle of a capsule: whatever overlaps is
found on the side on which it came. Beyond, a pair may be met from behind, or pass unseen. Between two walls a disc must
not move farther than its free distance, or the second bounce of one step is lost. And where discs meet more than one
other in a step on average, collisions that follow from others are missed.

The kernels see a disc that is too fast for the step to come, whatever made it fast, while they move it: the frame is
then the last of its command, and the exact look follows. What no single speed tells, collisions in a step and the room
between walls, is looked at in frames that follow from what can change it: at the start, where discs are added, as often
as a wall has taken a little of the box, and now and then. All of it depends on the state alone. So what follows is
the same with any number of workers, and however a run is cut into calls, saved or healed.
"""

import math
from collections.abc import Iterator

from mpsim.engine.compression import SELDOM, is_crowded, may_be_pressed, pressed
from mpsim.engine.notices import Notices, Once
from mpsim.engine.precision_check import coarseness
from mpsim.engine.solvers.base import NewDiscs, Origin, Solver
from mpsim.engine.solvers.speed_limit import SpeedLimit
from mpsim.engine.solvers.speeds import Speeds, sides_at, speeds_at_start
from mpsim.engine.speed_estimates import (
    speeds_after_fall,
    speeds_in_bath,
    speeds_in_equilibrium,
    speeds_of_emitters,
    speeds_of_pushed,
)
from mpsim.errors import FastWarning, OverlapWarning, ResolutionWarning, TooFastError
from mpsim.kernels.layout import LAWS
from mpsim.measure.driving import acceleration_bound, is_inelastic
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

BOUND = 1.0
"""Displacement of a disc in one step, as a fraction of its radius (of its free distance between walls), from which on
it is too fast."""

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


START = Origin()


class StepLimits:
    """Looks at the fastest disc, and at collisions in a step, and acts as Settings.on_fast says.

    Args:
        scene, settings: of the simulation.
        has_steps: of the solver's capabilities; without steps there is nothing to look for.
        origin: when the length of frames began to act.
    """

    def __init__(self, scene: Scene, settings: Settings, has_steps: bool, origin: Origin = START):
        self._scene = scene
        self._settings = settings
        self._has_steps = has_steps
        self._origin = origin
        self._fast, self._pressed = Once(given=not has_steps), Once(given=not has_steps)  # so that nobody looks
        self._has_limit = False
        self._acceleration = acceleration_bound(scene)
        narrow = any(
            not wraps and length < 3 * scene.largest_radius
            for wraps, length in zip(scene.periodic, sides_at(scene, math.inf), strict=True)
        )
        self._often = settings.on_fast == "substep" or narrow
        self._squeezing, self._squeezed = self._frames_of_moving_wall()

    def under(self, scene: Scene, settings: Settings, origin: Origin) -> "StepLimits":
        """Those under another scene and settings; what has been warned of is not warned of again."""
        other = StepLimits(scene, settings, self._has_steps, origin)
        other._fast, other._pressed = self._fast, self._pressed
        return other

    def _frames_of_moving_wall(self) -> tuple[int, int]:
        """Frames in which a wall takes SQUEEZE of the room that is left in the end, and the last of such looks."""
        wall, dt = self._scene.moving_wall, self._settings.dt
        if wall is None:
            return 0, -1
        before, after = (sides_at(self._scene, time)[wall.axis] for time in (0.0, math.inf))
        displacement = abs(wall.speed) * dt
        # A wall that needs 1e18 frames for it has no effect that can be told from none.
        every = math.ceil(min(max(SQUEEZE * after / displacement, 1.0), 1e18))
        moved_before = abs(wall.speed) * (self._origin.time - wall.began)
        last = self._origin.frame + (before - after - moved_before) / displacement
        return every, every * math.ceil(last / every)

    def at_start(self) -> Iterator[tuple[str, type[Warning]]]:
        """What to warn of before anything is run: overlaps, lost digits, speeds.

        Raises:
            TooFastError: if the settings do not allow such speeds, or they would need too many sub-steps.
        """
        scene = self._scene
        overlaps = scene.overlaps_at_start() if self._has_steps else ""  # which are refused without steps
        if overlaps:
            text = "The first frames push them apart. To avoid this, give positions that leave room for the discs."
            yield f"{overlaps}. {text}", OverlapWarning
        yield from self.at_resume()
        if not self._has_steps:
            return
        lost = self._lost_at_a_bounce()
        if lost > LOST:
            text = (
                f"contact='push' takes {lost:.2g} of its energy or more from a disc at each bounce under gravity or "
                "acceleration, on average (g dt / speed), though the restitution is 1. Use contact='impact', which "
                "keeps the energy, or a smaller dt."
            )
            yield text, FastWarning
        if self.adapts:
            self.substeps_for(speeds_at_start(scene), 0)
            return
        fast = self.forecast()
        if fast:
            self._refuse_if_wanted(fast)
            yield fast, FastWarning
            self._fast.given = True

    def at_resume(self) -> Iterator[tuple[str, type[Warning]]]:
        """What to warn of before a run goes on from a checkpoint: lost digits."""
        coarse = coarseness(self._scene, self._settings)
        if coarse:
            yield f"in {self._settings.precision} {coarse}", ResolutionWarning

    def _lost_at_a_bounce(self) -> float:
        """Fraction of its energy that the fastest disc loses at a bounce by `push`, where no restitution takes any.

        A step conserves v^2/2 + g y - g dt v/2; a bounce at v, beyond the wall by v dt/2 on average, takes g dt v/2.
        """
        scene, settings = self._scene, self._settings
        if settings.contact != "push" or is_inelastic(scene) or not self._acceleration or all(scene.periodic):
            return 0.0
        fastest = speeds_after_fall(speeds_at_start(scene), scene).speed
        return self._acceleration * settings.dt / settings.substeps / fastest

    def forecast(self) -> str | None:
        """The complaint about speeds at the start, or about those that are certain to come; None: they are low."""
        scene = self._scene
        speeds = speeds_at_start(scene)
        ahead = [speeds, speeds_after_fall(speeds, scene), speeds_of_emitters(scene), speeds_of_pushed(speeds, scene)]
        if scene.count:
            ahead.append(speeds_in_bath(speeds, scene))
        if LAWS[self._settings.law].exchanges_energy:
            ahead.append(speeds_in_equilibrium(speeds, scene))
        return next(filter(None, (self._complaint(each, 0) for each in ahead)), None)

    @property
    def adapts(self) -> bool:
        """Whether sub-steps are chosen."""
        return self._settings.on_fast == "substep" and not self._fast.given

    def frames_ahead(self, frame: int, count: int) -> int:
        """Number of frames until the next check; very large if there is none."""
        if self._fast.given and not self._looks_for_pressed(count):
            return 2**62
        return min(every - frame % every for every in self._intervals(frame, count))

    def is_due(self, frame: int, count: int) -> bool:
        """Whether to check speeds before this frame, or to lift the limit, as the warning has been given.

        At the first frame they are: a snapshot in which no frame has been done does not tell the sub-steps.
        """
        return self._has_limit if self._fast.given else frame == self._origin.frame or self._is_look(frame, count, 1)

    def _is_look(self, frame: int, count: int, rarer: int) -> bool:
        """Whether this frame is one of every so many looks, for any reason to look."""
        return any(frame % (rarer * every) == 0 for every in self._intervals(frame, count))

    def _looks_for_pressed(self, count: int) -> bool:
        """Whether so many discs are to be looked at for what presses them into each other."""
        return not self._pressed.given and may_be_pressed(self._scene, count)

    def set_limit(self, solver: Solver) -> None:
        """Have the solver end its commands when a disc is too fast; never, once that has been warned of."""
        speed_limit = SpeedLimit()
        self._has_limit = not self._fast.given
        if self.adapts:
            speed_limit = SpeedLimit(SUBSTEP_LIMIT * BOUND, self._gain(solver.frame, 1))
        elif self._has_limit:
            speed_limit = SpeedLimit(JUST_ABOVE * BOUND)
        solver.set_speed_limit(speed_limit)

    def check(self, solver: Solver, notices: Notices, new: NewDiscs | None = None) -> int:
        """Check the speeds, and warn if that is wanted. Returns the number of sub-steps from now on.

        Args:
            solver: whose discs are looked at.
            notices: which take a warning.
            new: discs that are about to be added.

        Raises:
            TooFastError: if the settings do not allow such speeds, or they would need too many sub-steps.
        """
        usual = self._settings.substeps if self._has_steps else 1
        if self._fast.given:
            if self._has_limit:
                self.set_limit(solver)
            return usual
        frame = solver.frame
        speeds = solver.speeds(new).or_faster(solver.disc_too_fast())
        if self.adapts:
            self.set_limit(solver)
            return self.substeps_for(speeds, frame)
        text = self._complaint(speeds, frame)
        if text:
            self._refuse_if_wanted(text)
            notices.warn(text, FastWarning, self._fast)
        return usual

    def look_for_pressed(self, solver: Solver, notices: Notices) -> None:
        """Look for discs that are pressed into each other, after frames that are checked, and warn once.

        Raises:
            TooFastError: if the settings do not allow it.
        """
        frame, count = solver.frame, solver.count
        if not self._looks_for_pressed(count) or not self._is_look(frame, count, 1):
            return
        anyway = frame == self._squeezed or self._is_look(frame, count, SELDOM)
        if not anyway and not is_crowded(self._scene, solver.radii, solver.time):
            return
        text = solver.once(lambda: pressed(solver, self._scene, self._settings))
        if text and self._settings.on_fast == "error":
            raise TooFastError(f"{text} on_fast='warn' runs it anyway.")
        if text:
            notices.warn(text, FastWarning, self._pressed)

    def substeps_for(self, speeds: Speeds, frame: int) -> int:
        """Sub-steps that keep speeds and collisions at AIM of their bounds, and below the bounds until the next look.

        Raises:
            TooFastError: if they are more than MOST_SUBSTEPS.
        """
        dt = self._settings.dt
        gain = self._gain(frame, ADAPT_EVERY)
        gained = gain * dt / min(speeds.limit, speeds.smallest)
        fraction = max((speeds.fraction(dt) + gained) / BOUND, speeds.collision_rate * dt / COLLISIONS) / AIM
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
        last, wall = frame - frame % ADAPT_EVERY, self._scene.moving_wall
        push = 2 * abs(wall.speed) if wall is not None and last <= self._squeezed else 0.0
        return self._acceleration * self._settings.dt * frames + push

    def _complaint(self, speeds: Speeds, frame: int) -> str | None:
        """The warning about the fastest disc; None if it is slow enough."""
        settings = self._settings
        dt = settings.dt / settings.substeps
        fraction, collisions = speeds.fraction(dt) / BOUND, speeds.collision_rate * dt / COLLISIONS
        if fraction <= 1 and collisions <= 1:
            return None
        needed = settings.substeps * max(fraction, collisions) / AIM
        remedy = "Use a larger box"
        if math.isfinite(needed):
            remedy = f"Use dt={settings.dt * settings.substeps / needed:.2g}"
            remedy += f", substeps={math.ceil(needed)}" if needed <= MOST_SUBSTEPS else ""
            remedy += " or on_fast='substep'"
        text = f"{self._words(speeds, frame)} {remedy}"
        if settings.on_fast == "error":
            return f"{text}; on_fast='warn' runs it anyway."
        return f"{text}; method='event' has no such limit."

    def _refuse_if_wanted(self, text: str) -> None:
        if self._settings.on_fast == "error":
            raise TooFastError(text)

    def _words(self, speeds: Speeds, frame: int) -> str:
        dt = self._settings.dt / self._settings.substeps
        fraction, collisions = speeds.fraction(dt), speeds.collision_rate * dt
        when = speeds.when or f"in frame {frame}"
        if math.isinf(collisions):
            return f"{when} discs fill the box more densely than they can be packed, so that they overlap."
        if not fraction > BOUND and collisions > COLLISIONS:
            return (
                f"{when} a disc collides about {collisions:.3g} times in one step (rms speed "
                f"{speeds.mean_speed:.3g}, step {dt:.3g}); above {COLLISIONS:g} many collisions that follow from "
                "others are missed."
            )
        length = f"its radius {speeds.limit:.3g}"
        lost = "one radius, discs may pass through each other without a collision"
        if speeds.between:
            length = f"its free path {speeds.limit:.3g} between the walls along {speeds.between}"
            lost = "one free path, bounces are lost"
        return (
            f"{when} {'a disc' if speeds.disc < 0 else f'disc {speeds.disc}'} moves {fraction:.3g} times {length} in "
            f"one step (speed {speeds.speed:.3g}, step {dt:.3g}); beyond {lost}."
        )

    def _intervals(self, frame: int, count: int) -> list[int]:
        """Frames between two looks, for each reason that there is for them."""
        intervals = [LOOK_LARGE_EVERY if count >= LARGE else LOOK_EVERY]
        if self._often:
            intervals.append(ADAPT_EVERY)
        if self._acceleration > 0:
            bound = BOUND * self._scene.smallest_radius / self._settings.dt * self._settings.substeps
            frames = GAIN * bound / (self._acceleration * self._settings.dt)
            intervals.append(max(math.ceil(min(frames, LOOK_EVERY)), ADAPT_EVERY))
        if frame <= self._squeezed:
            intervals.append(self._squeezing)
        return intervals
