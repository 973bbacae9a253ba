"""Whether steps are short enough for the speeds, and numbers fine enough for the scene.

Two discs that touch at the start of a step and move towards each other are 2 R - 2 v dt apart at its end. While each
moves less than its own radius, centres cannot pass one another, nor the middle of an obstacle: whatever overlaps is
found on the side on which it came. Beyond, a pair may be met from behind, or pass unseen. Between two walls a disc must
not move farther than its free way, or the second bounce of one step is lost. And where discs meet more than one other
in a step on average, collisions that follow from others are missed.

Looks at the speeds happen at fixed frames, counted from the start of the simulation, and see the state alone. So what
follows from them is the same with any number of workers, and however a run is cut into calls, saved or healed.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim import checks
from mpsim.errors import FastWarning, InputError, OverlapWarning, ResolutionWarning, TooFastError
from mpsim.scene import Scene
from mpsim.settings import Settings

BOUND = 1.0
"""Way of a disc in one step, as a part of its radius (of its free way between walls), from which on it is too fast."""

MEETINGS = 1.0
"""Collisions of a disc in one step, on average, from which on too many are missed: those that follow from others."""

DENSE, HEXAGONAL = 0.7, 0.9069
"""Packing from which on discs are taken for a crystal, and the densest there is."""

AIM = 0.5
"""Part of both bounds kept by on_fast="substep" where it looks: a disc may double its speed until the next look."""

ADAPT_EVERY = 16
"""Frames between two looks of on_fast="substep"."""

MOST_SUBSTEPS = 10_000
"""Sub-steps of a frame that on_fast="substep" chooses at most: more are a mistake in dt or in a speed."""

WATCH_EVERY, WATCH_LARGE_EVERY, LARGE = 4096, 1024, 8192
"""Frames between two looks that only warn or refuse: fewer from LARGE discs on, where a look costs far less than a
frame. Either way a look takes less than a hundredth of the time."""

COARSE = 1e-3
"""Spacing of coordinates, as a part of the smallest radius, from which on the user is told: directions of contacts are
then wrong by about as much [radians]."""

TOO_COARSE = 0.125
"""The same, from which on contacts mean nothing and the scene is refused."""

TINY = 1e-6
"""Radius, as a part of the distance between neighbours, below which squares of both do not fit one float64."""

VANISHING = 1e7
"""Square of radius times speed, in smallest normal numbers, below which the user is told."""

STEP_SPACINGS = 16
"""A step of typical length should be so many spacings of coordinates long: rounding then changes it by 3 % at most."""


@dataclass(frozen=True)
class Pace:
    """How fast the discs of a state are, for what they may be.

    Attributes:
        disc: index of the one whose way in a step is the largest part of what it may be; -1 where there is none.
        speed: of it, or its component between two walls [length/time].
        limit: way that it may make in a step: its radius, or its free way between walls [length].
        between: "" or the axis between whose walls that is.
        meetings: collisions of a disc with others, estimated [1/time].
        mean_speed: root mean square [length/time].
        when: "" now; or, in words, when discs will be so fast.
    """

    disc: int = -1
    speed: float = 0.0
    limit: float = 1.0
    between: str = ""
    meetings: float = 0.0
    mean_speed: float = 0.0
    when: str = ""

    def part(self, dt: float) -> float:
        """Way of the fastest disc in a step of length dt, as a part of what it may be."""
        return self.speed * dt / self.limit


def pace_of(velocity: NDArray[Any], radius: NDArray[np.float64], scene: Scene) -> Pace:
    """How fast discs are.

    Args:
        velocity: shape (N, 2), in the order of the scene's discs, so that no sum depends on another one [length/time].
        radius: shape (N,) [length].
        scene: whose box it is.
    """
    if not len(velocity):
        return Pace()
    vx, vy = velocity.astype(np.float64).T
    squares = vx * vx + vy * vy
    speed = np.sqrt(squares)
    mean_speed = math.sqrt(float(squares.mean()))
    worst = int((speed / radius).argmax())
    found = Pace(worst, float(speed[worst]), float(radius[worst]))
    for axis, (v, length) in enumerate(((vx, scene.width), (vy, scene.height))):
        free = length - 2 * radius
        if scene.periodic[axis] or (free >= radius).all():
            continue
        # Where there is no room at all, or rounding's worth of it, a disc stands between the walls as it should.
        free = np.where(free > 1e-6 * length, free, np.inf)
        worst = int((np.abs(v) / free).argmax())
        between = Pace(worst, float(abs(v[worst])), float(free[worst]), "xy"[axis])
        found = max(found, between, key=lambda pace: pace.part(1.0))
    return replace(found, meetings=_meetings(radius, mean_speed, scene), mean_speed=mean_speed)


def _meetings(radius: NDArray[np.float64], speed: float, scene: Scene) -> float:
    """Collisions of a disc with others per time, as in a gas without structure: 2 sqrt(pi) n sigma g sqrt(kT/m).

    g, the density of neighbours in touch: of a fluid (Henderson 1975), or above packing 0.7 of a crystal by its free
    volume, (Z - 1) / (2 packing) with Z = 2 / (1 - packing / 0.9069).
    """
    area = scene.width * scene.height
    packing = math.pi * float((radius * radius).sum()) / area
    if speed == 0 or len(radius) < 2:
        return 0.0
    if packing >= HEXAGONAL:
        return math.inf
    if packing <= DENSE:
        crowding = (1 - 7 * packing / 16) / (1 - packing) ** 2
    else:
        crowding = (2 / (1 - packing / HEXAGONAL) - 1) / (2 * packing)
    density = (len(radius) - 1) / area
    return 2 * math.sqrt(math.pi) * density * 2 * float(radius.mean()) * crowding * speed / math.sqrt(2)


def pace_after_fall(pace: Pace, scene: Scene, pull: float) -> Pace:
    """How fast the fastest disc is where acceleration has taken it through the box."""
    fall = math.sqrt(2 * pull * max(scene.width, scene.height))
    return replace(pace, speed=math.hypot(pace.speed, fall), when="after a fall through the box" if fall else "")


def pace_in_equilibrium(pace: Pace, scene: Scene) -> Pace:
    """How fast discs become whose masses differ: collisions give each the same energy, so light ones become fast.

    With E = <m v^2> the mean square of a disc's speed is E / m, and the fastest of N is sqrt(ln N) times faster:
    speeds in two dimensions exceed s with probability exp(-s^2 m / E).
    """
    if scene.mass is None or scene.count < 2:
        return pace
    squares = (scene.velocity**2).sum(axis=1)
    energy = float((scene.mass * squares).mean())
    speed = np.sqrt(energy / scene.mass * max(math.log(scene.count), 1.0))
    worst = int((speed / scene.radii).argmax())
    mean_speed = math.sqrt(energy * float((1 / scene.mass).mean()))
    return Pace(
        worst,
        float(speed[worst]),
        float(scene.radii[worst]),
        meetings=_meetings(scene.radii, mean_speed, scene),
        mean_speed=mean_speed,
        when="once collisions have shared the energy out",
    )


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
        self._pull = sum(pulls)
        self._gain = self._pull * settings.dt  # of speed in a frame

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
        pace = pace_of(scene.velocity, scene.radii, scene)
        if self.adapts:
            self.substeps_for(pace, 0)
            return
        # What falls, or is light among heavy discs, becomes fast between two looks.
        ahead = [pace, pace_after_fall(pace, scene, self._pull)]
        if settings.law == "elastic":
            ahead.append(pace_in_equilibrium(pace, scene))
        fast = next(filter(None, (self.complaint(each, 0) for each in ahead)), None)
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

    def substeps_for(self, pace: Pace, frame: int) -> int:
        """Sub-steps that keep speeds and meetings at AIM of their bounds, and below the bounds until the next look.

        Raises:
            TooFastError: if they are more than MOST_SUBSTEPS.
        """
        dt = self._settings.dt
        pace = replace(pace, speed=pace.speed + self._gain * ADAPT_EVERY)
        part = max(pace.part(dt) / BOUND, pace.meetings * dt / MEETINGS) / AIM
        if math.isinf(part):
            raise TooFastError(f"{self._words(pace, frame)} No number of sub-steps is enough. Use a larger box.")
        if not part <= MOST_SUBSTEPS:
            raise TooFastError(
                f"{self._words(pace, frame)} on_fast='substep' takes at most {MOST_SUBSTEPS} sub-steps, and would need "
                f"{part:.3g}. Use a smaller dt."
            )
        return max(self._settings.substeps, math.ceil(part))

    def complaint(self, pace: Pace, frame: int) -> str | None:
        """What to tell of the fastest disc, or None where it is slow enough.

        Raises:
            TooFastError: in place of telling, for on_fast="error".
        """
        settings = self._settings
        dt = settings.dt / settings.substeps
        part, meetings = pace.part(dt) / BOUND, pace.meetings * dt / MEETINGS
        if part <= 1 and meetings <= 1:
            return None
        needed = settings.substeps * max(part, meetings) / AIM
        remedy = "Use a larger box"
        if math.isfinite(needed):
            remedy = f"Use dt={settings.dt * settings.substeps / needed:.2g}"
            remedy += f", substeps={math.ceil(needed)}" if needed <= MOST_SUBSTEPS else ""
            remedy += " or on_fast='substep'"
        text = f"{self._words(pace, frame)} {remedy}"
        if settings.on_fast == "error":
            raise TooFastError(f"{text}; on_fast='warn' runs it all the same.")
        return f"{text}; method='event' has no such bound."

    def _words(self, pace: Pace, frame: int) -> str:
        dt = self._settings.dt / self._settings.substeps
        part, meetings = pace.part(dt), pace.meetings * dt
        when = pace.when or f"in frame {frame}"
        if math.isinf(meetings):
            return f"{when} discs fill the box more densely than they can be packed, so that they overlap."
        if not part > BOUND and meetings > MEETINGS:
            return (
                f"{when} a disc collides some {meetings:.3g} times in one step (mean speed "
                f"{pace.mean_speed:.3g}, step {dt:.3g}); above {MEETINGS:g} many collisions that follow from others "
                "are missed."
            )
        way = f"its radius {pace.limit:.3g}"
        if pace.between:
            way = f"its free way {pace.limit:.3g} between the walls along {pace.between}"
        lost = "bounces are lost" if pace.between else "discs may pass through each other unseen"
        return (
            f"{when} disc {pace.disc} moves {part:.3g} times {way} in one step (speed {pace.speed:.3g}, step "
            f"{dt:.3g}); above {BOUND:g} {lost}."
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
    checks.fitting("dt", np.array([settings.dt]), precision)
    for name in ("velocity", "gravity", "acceleration"):
        if getattr(scene, name) is not None:
            checks.fitting(name, getattr(scene, name), precision)
    product = 8 * scene.largest_radius * float(np.abs(scene.velocity).max(initial=0.0))
    most = math.sqrt(float(np.finfo(precision).max))
    if product > most and squares_products(settings):
        raise InputError(
            f"radius times velocity must be at most {most / 8:.3g} in {precision}, so that its square fits; got "
            f"{product / 8:.3g}. Use other units{_or_double(precision)}."
        )
    if scene.mass is not None:
        checks.fitting("mass", scene.mass, precision)
        lightest = float(scene.mass.min(initial=1.0))
        checks.not_vanishing("mass", lightest, tiny / float(np.finfo(precision).eps), precision)
    spacing = spacing_of(scene, precision)
    if smallest > 0 and spacing > TOO_COARSE * smallest:
        raise InputError(
            f"radius must be at least {spacing / TOO_COARSE:.3g} in a box of {scene.width:g} x {scene.height:g} in "
            f"{precision}, whose coordinates are {spacing:.3g} apart: smaller discs cannot be told from each other; "
            f"got {smallest:.3g}. Use {_finer(precision)}."
        )


def squares_products(settings: Settings) -> bool:
    """Whether contacts are computed with the square of radius times speed: `push` does without."""
    return settings.contact == "impact" or settings.method == "event"


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
    apart = math.sqrt(scene.width * scene.height / max(scene.count, 1))
    if settings.method == "event" and scene.count > 1 and scene.smallest_radius < TINY * apart:
        words.append(
            f"discs of radius {scene.smallest_radius:.3g} are some {apart:.3g} apart: the square of the radius is lost "
            "beside that of the distance, so that the time of a contact is wrong by up to the time in which a disc "
            "moves its radius. Use larger discs or a smaller box"
        )
    speed = math.sqrt(float((scene.velocity**2).sum(axis=1).mean())) if scene.count else 0.0
    square = (speed * scene.smallest_radius) ** 2
    if squares_products(settings) and 0 < square < VANISHING * float(np.finfo(precision).tiny):
        words.append(
            f"the square of mean speed {speed:.3g} times radius {scene.smallest_radius:.3g} is lost, so that times of "
            f"contacts cannot be told. Use other units{_or_double(precision)}"
        )
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
            f"{speed:.3g}. Use larger steps{_or_double(precision)}"
        )
    return ". ".join(words) + "." if words else None


_DOUBLE = "precision='float64'"


def _or_double(precision: str) -> str:
    return "" if precision == "float64" else f" or {_DOUBLE}"


def _finer(precision: str) -> str:
    return "a smaller box or larger discs" if precision == "float64" else f"{_DOUBLE} or a smaller box"
