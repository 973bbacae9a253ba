"""Whether steps are short enough for the speeds, and numbers fine enough for the scene.

Two discs that touch at the start of a step and move towards each other are 2 R - 2 v dt apart at its end. While each
moves less than its own radius, centres cannot pass one another, nor the middle of an obstacle: whatever overlaps is
found on the side on which it came. Beyond, a pair may be met from behind, or pass unseen. Between two walls a disc must
not move farther than its free way, or the second bounce of one step is lost.

Looks at the speeds happen at fixed frames, counted from the start of the simulation, and see the state alone. So what
follows from them is the same with any number of workers, and however a run is cut into calls, saved or healed.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim import checks
from mpsim.errors import FastWarning, InputError, OverlapWarning, ResolutionWarning, TooFastError
from mpsim.scene import Scene
from mpsim.settings import Settings

BOUND = 1.0
"""Way of a disc in one step, as a part of its radius (of its free way between walls), from which on it is too fast."""

AIM = 0.5
"""The same, kept by on_fast="substep" where it looks: a disc may double its speed until the next look."""

ADAPT_EVERY = 16
"""Frames between two looks of on_fast="substep"."""

MOST_SUBSTEPS = 10_000
"""Sub-steps of a frame that on_fast="substep" chooses at most: more are a mistake in dt or in a speed."""

WATCH_EVERY, WATCH_LARGE_EVERY, LARGE = 1024, 64, 8192
"""Frames between two looks that only warn or refuse: fewer from LARGE discs on, where a look costs far less than a
frame. Either way a look takes less than a hundredth of the time."""

COARSE = 1e-3
"""Spacing of coordinates, as a part of the smallest radius, from which on the user is told: directions of contacts are
then wrong by about as much [radians]."""

TOO_COARSE = 0.125
"""The same, from which on contacts mean nothing and the scene is refused."""

STEP_SPACINGS = 16
"""A step of typical length should be so many spacings of coordinates long: rounding then changes it by 3 % at most."""


@dataclass(frozen=True)
class Fastest:
    """The disc whose way in a step is the largest part of what it may be.

    Attributes:
        disc: its index, or -1 where nothing moves.
        speed: of it, or its component between two walls [length/time].
        limit: way that it may make in a step: its radius, or its free way between walls [length].
        between: "" or the axis between whose walls it is.
    """

    disc: int = -1
    speed: float = 0.0
    limit: float = 1.0
    between: str = ""

    def part(self, dt: float) -> float:
        """Way in a step of length dt, as a part of what it may be."""
        return self.speed * dt / self.limit


def fastest(vx: NDArray, vy: NDArray, radius: Any, scene: Scene) -> Fastest:
    """The disc that comes nearest to the bound.

    Args:
        vx, vy: velocities, shape (N,) [length/time].
        radius: of all discs, or one each, shape (N,) [length].
        scene: whose box it is.
    """
    if not len(vx):
        return Fastest()
    # Not np.hypot, which takes ten times as long.
    vx, vy = vx.astype(np.float64, copy=False), vy.astype(np.float64, copy=False)
    speed = np.sqrt(vx * vx + vy * vy)
    worst = int((speed / radius).argmax())
    found = Fastest(worst, float(speed[worst]), float(np.broadcast_to(radius, len(speed))[worst]))
    for axis, (v, length) in enumerate(((vx, scene.width), (vy, scene.height))):
        free = length - 2 * np.asarray(radius, np.float64)
        if scene.periodic[axis] or (free >= radius).all():
            continue
        pace = np.abs(v)
        # Where there is no room at all, or rounding's worth of it, a disc stands between the walls as it should.
        free = np.where(free > 1e-6 * length, free, np.inf)
        worst = int((pace / free).argmax())
        limit = float(np.broadcast_to(free, len(pace))[worst])
        if pace[worst] / limit > found.part(1.0):
            found = Fastest(worst, float(pace[worst]), limit, "xy"[axis])
    return found


class Watch:
    """Looks at the fastest disc at fixed frames and acts as Settings.on_fast says.

    Args:
        scene, settings: of the simulation.
        exact: the solver has no steps, so there is nothing to look for.
    """

    def __init__(self, scene: Scene, settings: Settings, exact: bool):
        self._scene = scene
        self._settings = settings
        self._done = exact  # or the warning was given
        pulls = [0.0] if scene.gravity is None else [float(np.hypot(*scene.gravity))]
        if scene.acceleration is not None and scene.count:
            pulls.append(float(np.hypot(*scene.acceleration.T).max()))
        self._gain = sum(pulls) * settings.dt  # of speed in a frame

    def at_start(self) -> Iterator[tuple[str, type[Warning]]]:
        """What to warn of before anything is run: overlaps, lost digits, speeds.

        Raises:
            TooFastError: if the settings do not allow such speeds, or they would need too many sub-steps.
        """
        scene, settings = self._scene, self._settings
        exact = self._done
        overlaps = "" if exact else scene.overlaps_at_start()  # which the exact solver refuses
        if overlaps:
            text = "The first frames push them apart. Give places that leave room for the discs to avoid it."
            yield f"{overlaps}. {text}", OverlapWarning
        coarse = coarseness(scene, settings)
        if coarse:
            yield f"in {settings.precision} {coarse}", ResolutionWarning
        if exact:
            return
        found = fastest(scene.velocity[:, 0], scene.velocity[:, 1], scene.radius, scene)
        if self.adapts:
            self.substeps_for(found, 0)
            return
        fast = self.complaint(found, 0)
        if fast:
            self.told()
            yield fast, FastWarning

    @property
    def adapts(self) -> bool:
        """Whether sub-steps are chosen."""
        return self._settings.on_fast == "substep" and not self._done

    def frames_ahead(self, frame: int, count: int) -> int:
        """Frames until the next look; a very large number if there is none."""
        if self._done:
            return 2**62
        every = self._every(count)
        return every - frame % every

    def is_due(self, frame: int, count: int) -> bool:
        """Whether this is a frame before which to look."""
        return not self._done and frame % self._every(count) == 0

    def told(self) -> None:
        """The warning was given: once is enough."""
        self._done = True

    def substeps_for(self, found: Fastest, frame: int) -> int:
        """Sub-steps that keep the fastest disc at AIM or below until the next look.

        Raises:
            TooFastError: if they are more than MOST_SUBSTEPS.
        """
        speed = found.speed + self._gain * ADAPT_EVERY
        part = speed * self._settings.dt / found.limit / AIM
        if not part <= MOST_SUBSTEPS:
            raise TooFastError(
                f"{self._words(found, frame)} on_fast='substep' takes at most {MOST_SUBSTEPS} sub-steps, which is not "
                f"enough. Use dt={self._settings.dt * AIM * MOST_SUBSTEPS / (2 * part):.2g} or less."
            )
        return max(self._settings.substeps, math.ceil(part))

    def complaint(self, found: Fastest, frame: int) -> str | None:
        """What to tell of the fastest disc, or None where it is slow enough.

        Raises:
            TooFastError: in place of telling, for on_fast="error".
        """
        settings = self._settings
        part = found.part(settings.dt / settings.substeps)
        if part <= BOUND:
            return None
        needed = part * settings.substeps / (BOUND / 2)
        remedy = f"Use dt={settings.dt * settings.substeps / needed:.2g}"
        remedy += f", substeps={math.ceil(needed)}" if needed < MOST_SUBSTEPS else ""
        text = f"{self._words(found, frame)} {remedy}"
        if settings.on_fast == "error":
            raise TooFastError(f"{text} or on_fast='substep'; on_fast='warn' runs it all the same.")
        return f"{text} or on_fast='substep'; method='event' has no such bound."

    def _words(self, found: Fastest, frame: int) -> str:
        dt = self._settings.dt / self._settings.substeps
        room = f"its free way {found.limit:.3g} between the walls along {found.between}"
        return (
            f"in frame {frame} disc {found.disc} moves {found.part(dt):.3g} times "
            f"{room if found.between else f'its radius {found.limit:.3g}'} in one step (speed {found.speed:.3g}, step "
            f"{dt:.3g}); above {BOUND:g} "
            f"{'bounces are lost' if found.between else 'discs may pass through each other unseen'}."
        )

    def _every(self, count: int) -> int:
        if self._settings.on_fast == "substep":
            return ADAPT_EVERY
        return WATCH_LARGE_EVERY if count >= LARGE else WATCH_EVERY


def check_precision(scene: Scene, settings: Settings) -> None:
    """Refuse a scene whose numbers do not fit the precision of the run.

    Raises:
        InputError: naming the number, the rule and a remedy.
    """
    precision = settings.precision
    checks.fitting("the box", np.array([scene.width, scene.height]), precision)
    # Squares of lengths must not underflow either, nor the time of a step.
    tiny = float(np.finfo(precision).tiny)
    smallest = float(scene.radii.min(initial=scene.largest_radius))
    if smallest > 0:  # with radii of their own, no discs have none
        checks.not_vanishing("radius", smallest, 1e4 * math.sqrt(tiny), precision)
    checks.not_vanishing("dt / substeps", settings.dt / settings.substeps, tiny, precision)
    for name in ("velocity", "gravity", "acceleration"):
        if getattr(scene, name) is not None:
            checks.fitting(name, getattr(scene, name), precision)
    if scene.mass is not None:
        checks.fitting("mass", scene.mass, precision)
        checks.not_vanishing("mass", float(scene.mass.min(initial=1.0)), tiny / float(np.finfo(precision).eps), precision)
    spacing = spacing_of(scene, precision)
    if smallest > 0 and spacing > TOO_COARSE * smallest:
        raise InputError(
            f"radius must be at least {spacing / TOO_COARSE:.3g} in a box of {scene.width:g} x {scene.height:g} in "
            f"{precision}, whose coordinates are {spacing:.3g} apart: smaller discs cannot be told from each other; "
            f"got {smallest:.3g}. Use {_finer(precision)}."
        )


def spacing_of(scene: Scene, precision: str) -> float:
    """Distance between two neighbouring coordinates at the far end of the box [length]."""
    return float(np.finfo(precision).eps) * max(scene.width, scene.height)


def coarseness(scene: Scene, settings: Settings) -> str | None:
    """What the precision of the run loses of a scene, in words with numbers and remedy; None if it is little."""
    precision, spacing = settings.precision, spacing_of(scene, settings.precision)
    words = []
    if scene.count and spacing > COARSE * scene.smallest_radius:
        words.append(
            f"coordinates are {spacing:.3g} apart at the far end of the box, {spacing / scene.smallest_radius:.2g} of "
            f"the smallest radius: directions of contacts are wrong by as much. Use {_finer(precision)}"
        )
    speed = math.sqrt(float((scene.velocity**2).sum(axis=1).mean())) if scene.count else 0.0
    dt = settings.dt / settings.substeps
    way = speed * dt
    if settings.method == "event":  # which moves discs from collision to collision, not by steps
        way = 0.0
    if 0 < way < STEP_SPACINGS * spacing:
        effect = "most discs do not move at all" if way < spacing / 2 else "rounding changes each step"
        words.append(
            f"a disc of mean speed {speed:.3g} moves {way:.3g} in a step, {way / spacing:.2g} of the distance "
            f"{spacing:.3g} between coordinates: {effect}. Use larger steps, or {_finer(precision)}"
        )
    pull = 0.0 if scene.gravity is None else float(np.abs(scene.gravity).max())
    if settings.method != "event" and 0 < pull * dt < float(np.finfo(precision).eps) * speed:
        words.append(
            f"gravity changes a velocity by {pull * dt:.3g} in a step, which rounding loses beside a mean speed of "
            f"{speed:.3g}. Use larger steps{'' if precision == 'float64' else f', or {_DOUBLE}'}"
        )
    return ". ".join(words) + "." if words else None


_DOUBLE = "precision='float64'"


def _finer(precision: str) -> str:
    return "a smaller box or larger discs" if precision == "float64" else f"{_DOUBLE} or a smaller box"
