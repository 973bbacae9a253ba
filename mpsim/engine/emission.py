"""Emitters: discs that enter a running simulation, and their flight in the first frame."""

import copy
import heapq
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.checks import Floats
from mpsim.core.columns import IMAGE
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.engine.access import Notices, Once
from mpsim.engine.changes import checked, hindrance
from mpsim.engine.solvers.base import NewDiscs, Solver
from mpsim.errors import EmitterWarning, InputError
from mpsim.features.emitters import Emitter
from mpsim.features.properties import has_masses, has_radii
from mpsim.scene.scene import LARGEST_COUNT, Scene
from mpsim.scene.settings import Settings

# --- The flight of an emitted disc in its first frame, up to the end of the frame or the first obstacle

LOOKS_PER_RADIUS = 4  # places along a flight that are tested for walls and capsules, per radius of its length

MOST_LOOKS = 10_000

HALVINGS = 5  # steps of a bisection that are looked at together
MOST_PERIODS = 2.0**53  # periods of one flight that are counted at most, as in the kernels


class FlightEnd(NamedTuple):
    """Where a flight ends: position, velocity, and image flags, all of shape (2,)."""

    position: Floats
    velocity: Floats
    image: NDArray[np.int64]


def end_of_flight(scene: Scene, emitter: Emitter, radius: float, elapsed: float, time: float) -> FlightEnd:
    """Where a disc of a radius is at a time that left an emitter `elapsed` >= 0 before [length], [time].

    It has flown freely: position + v s + g s^2/2 and v + g s. A flight that meets a wall or a capsule ends there with
    the velocity it then has, and the next frame begins with that contact; other discs are left out of account.
    """
    start, velocity = np.array(emitter.position), np.array(emitter.velocity)
    image = np.zeros(2, np.int64)
    if elapsed == 0:
        return FlightEnd(start, velocity, image)
    gravity = np.zeros(2) if scene.gravity is None else scene.gravity

    def places(times: Floats) -> Floats:
        return start + times[:, None] * (velocity + 0.5 * times[:, None] * gravity)

    def clear(times: Floats) -> NDArray[np.bool_]:
        return _clear(scene, radius, places(times), time)

    length = elapsed * (math.hypot(*velocity) + math.hypot(*gravity) * elapsed)
    looks = int(np.clip(LOOKS_PER_RADIUS * length / radius, 1, MOST_LOOKS))
    times = np.linspace(0, elapsed, looks + 1)[1:]
    free, flown = clear(times), elapsed
    if not free.all():
        blocked = float(times[np.argmin(free)])
        rounding = elapsed * float(np.finfo(float).eps)  # below it a flight that ends at its start would halve on to 0
        flown = _last_clear(clear, blocked - float(times[0]), blocked, rounding)
    place = places(np.array([flown]))[0]
    for axis, length in enumerate((scene.width, scene.height)):
        if scene.periodic[axis]:
            end = place[axis]
            place[axis] %= length
            periods = np.rint((end - place[axis]) / length)
            image[axis] = periods if abs(periods) < MOST_PERIODS else 0
    return FlightEnd(place, velocity + flown * gravity, image)


def _last_clear(clear: Callable[[Floats], NDArray[np.bool_]], flown: float, beyond: float, rounding: float) -> float:
    """The end of the clear part of a flight, by bisection: clear at `flown`, not at `beyond` [time].

    Asking about one time costs as much as about thirty, so each look is at all that the next HALVINGS can lead to.
    """
    while True:
        times = np.array([flown, beyond])
        for _ in range(HALVINGS):
            middles = 0.5 * (times[:-1] + times[1:])
            times = np.append(np.stack([times[:-1], middles], axis=1).ravel(), times[-1])
        free, low, high = clear(times), 0, len(times) - 1
        while high - low > 1:
            middle = (low + high) // 2
            flown, beyond = float(times[low]), float(times[high])
            if beyond - flown <= rounding or not flown < times[middle] < beyond:
                return flown
            low, high = (middle, high) if free[middle] else (low, middle)
        flown, beyond = float(times[low]), float(times[high])


def _clear(scene: Scene, radius: float, places: Floats, time: float) -> NDArray[np.bool_]:
    """Which centres are inside the walls and outside capsules, shape (K,); through periodic borders too."""
    size, periodic = np.array([scene.width, scene.height]), np.array(scene.periodic)
    low, high = scene.limits(radius, time)
    low, high = np.where(periodic, -np.inf, low), np.where(periodic, np.inf, high)
    clear: NDArray[np.bool_] = np.all((places >= low) & (places <= high), axis=1)
    if len(scene._capsules_at(0.0)):
        wrapped = np.where(periodic, places % size, places)
        clear &= scene._capsule_index_at(time).depths(wrapped, np.full(len(places), radius)) == 0
    return clear


# --- Emitters: discs that enter a running simulation

Insert = Callable[[NewDiscs], None]  # what adds discs to a simulation

TRIES = 8
"""Times in an interval at which the place of a waiting disc is looked at. A power of two: k TRIES / TRIES is k."""

FEW_LOOKS = 32  # discs of one frame that are compared with all others, which is quicker than sorting those

Progress = dict[str, list[Any]]


class Emission:
    """What the emitters of a scene have done so far.

    Each emitter has a count, `due`, at which its next disc is to enter: of frames if it has `every`, of fractions of
    its interval, interval / TRIES, if it has that. A disc that enters raises the count by `every` or by TRIES; one
    whose place is occupied, by 1. So what enters when depends on the state and on these counts alone, not on how a run
    is cut into slices; and times are products, in which rounding does not add up.

    Attribute emits: whether there are emitters.
    """

    def __init__(self, scene: Scene, settings: Settings, notices: Notices):
        dt = settings.dt
        for index, emitter in enumerate(scene.emitters):
            if emitter.interval is not None and emitter.interval * LARGEST_COUNT < dt:
                raise InputError(
                    f"interval of emitters[{index}] must be at least dt / {LARGEST_COUNT:g}, {dt / LARGEST_COUNT:g} "
                    f"here; got {emitter.interval:g}. Use a smaller dt, or a longer interval."
                )
        self._scene = scene
        self._notices = notices
        self._emitters = scene.emitters
        self.emits: bool = bool(scene.emitters)
        self._emitted = [0] * len(scene.emitters)
        self._due = [emitter.every or TRIES for emitter in scene.emitters]
        self._since = [0.0] * len(scene.emitters)
        self._waiting = Once()

    @property
    def progress(self) -> Progress:
        """Discs that each emitter has added, the count at which it is due again, and since when it counts [time]."""
        found: Progress = {"emitted": list(self._emitted), "due": list(self._due)}
        return found | ({"since": list(self._since)} if any(self._since) else {})

    @progress.setter
    def progress(self, found: Progress) -> None:
        self._emitted, self._due = list(found["emitted"]), list(found["due"])
        self._since = list(found.get("since", [0.0] * len(self._due)))

    def under(self, scene: Scene, settings: Settings, frame: int, time: float) -> "Emission":
        """The same emitters from now on under another scene: what is left of an interval changes as the interval."""
        other = Emission(scene, settings, self._notices)
        other._waiting, other.progress = self._waiting, self.progress
        for index, (before, after) in enumerate(zip(self._emitters, scene.emitters, strict=True)):
            if before.interval is not None and after.interval is not None and before.interval != after.interval:
                left = max(self._time(index) - time, 0.0) / before.interval
                other._since[index], other._due[index] = time + (left - 1) * after.interval, TRIES
            if before.every is not None and after.every is not None and before.every != after.every:
                left = (self._due[index] - frame) / before.every
                other._due[index] = frame + max(round(left * after.every), 0)
        return other

    def frames_ahead(self, frame: int) -> int:
        """Frames until an emitter that counts frames is due again; a very large number without one."""
        ahead = [max(self._due[index] - frame, 1) for index in self._open() if self._emitters[index].every]
        return min(ahead, default=2**62)

    @property
    def next_time(self) -> float:
        """When an emitter that has an interval is due again [time]; infinity without one."""
        return min((self._time(index) for index in self._open() if not self._emitters[index].every), default=math.inf)

    def enter(self, solver: Solver, insert: Insert, count_frames: bool) -> None:
        """Add all discs that are due, oldest first, where their places are free.

        count_frames: before a frame, also those that enter before it; else those whose times the last frame has
        reached, having flown for the time since then.
        """
        due = [found for index in self._open() if (found := self._is_due(index, solver, count_frames))]
        if not due:
            return
        heapq.heapify(due)
        plan, occupied, now = copy.copy(self), _Occupied(self._scene, solver), solver.time
        plan.progress = self.progress
        entering: list[tuple[Emitter, FlightEnd]] = []
        while due:
            time, index = heapq.heappop(due)
            emitter = self._emitters[index]
            radius, _ = self._kind(emitter)
            end = end_of_flight(self._scene, emitter, radius, max(now - time, 0.0), now)
            name = f"the position of emitters[{index}]"
            hindered = hindrance(self._scene, now, occupied.radius, name, end.position, radius)
            free = not hindered and occupied.admits(end.position, radius)
            if free:
                entering.append((emitter, end))
            else:
                self._warn(index, emitter, solver.frame if emitter.every else time, hindered)
            plan._note(index, solver.frame, free)
            if again := plan._is_due(index, solver, count_frames):
                heapq.heappush(due, again)
        with interrupts_held_back():  # else a disc could be in the simulation, but not in the books
            if entering:
                insert(self._discs(solver, entering))
            self.progress = plan.progress

    def _is_due(self, index: int, solver: Solver, count_frames: bool) -> tuple[float, int] | None:
        """The time at which an emitter is due, and its index, by which several are ordered; None if it is not due."""
        if not self._has_left(index):
            return None
        if self._emitters[index].every:
            return (solver.time, index) if count_frames and self._due[index] <= solver.frame else None
        return (self._time(index), index) if solver.reached(self._time(index)) else None

    def _note(self, index: int, frame: int, entered: bool) -> None:
        """Raise an emitter's count."""
        every = self._emitters[index].every
        if every:
            self._due[index] = frame
        self._due[index] += (every or TRIES) if entered else 1
        self._emitted[index] += entered

    def _discs(self, solver: Solver, entering: list[tuple[Emitter, FlightEnd]]) -> NewDiscs:
        """The discs that enter, checked as any that are added."""
        scene = self._scene
        positions, velocities, images = map(np.array, zip(*(end for _, end in entering), strict=True))
        radii, masses = np.array([self._kind(emitter) for emitter, _ in entering]).T
        sizes = radii if has_radii(scene) else None, masses if has_masses(scene) else None
        new = checked(solver, positions, velocities, *sizes, {})
        return new._replace(columns={**new.columns, IMAGE.name: images})

    def _kind(self, emitter: Emitter) -> tuple[float, float]:
        """Radius and mass of an emitter's discs."""
        radius = emitter.radius if emitter.radius is not None else self._scene.largest_radius
        return radius, emitter.mass if emitter.mass is not None else 1.0

    def _open(self) -> list[int]:
        """Emitters that have discs left."""
        return [index for index in range(len(self._emitters)) if self._has_left(index)]

    def _has_left(self, index: int) -> bool:
        limit = self._emitters[index].limit
        return limit is None or self._emitted[index] < limit

    def _time(self, index: int) -> float:
        """When an emitter that has an interval is due [time]."""
        interval = self._emitters[index].interval
        assert interval is not None
        return self._since[index] + self._due[index] * (interval / TRIES)

    def _warn(self, index: int, emitter: Emitter, when: float, hindered: str | None) -> None:
        """Warn, once, that a disc waits."""
        name, moment = ("every", f"before frame {when}") if emitter.every else ("interval", f"at time {when:g}")
        text = (
            f"emitters[{index}] found its place {emitter.position} occupied {moment}: its disc waits "
            f"until the place is free. Give a larger `{name}`, or a velocity that leads away."
        )
        if hindered:
            text = f"emitters[{index}] found no room {moment}, and its disc waits: {hindered}"
        self._notices.warn(text, EmitterWarning, self._waiting)


class _Occupied:
    """Places that are occupied: by the discs of a simulation, and by those that are about to enter.

    radius: of each disc, shape (N,) [length]. After a few looks those of the simulation are sorted along the longer
    side of the box.
    """

    def __init__(self, scene: Scene, solver: Solver):
        here = ~solver.absorbed
        self._scene = scene
        self._position, self.radius = solver.state().position[here], solver.radii[here]
        self._axis, self._side = int(scene.height > scene.width), max(scene.width, scene.height)
        self._looks = self._sorted = 0

    def admits(self, place: Floats, radius: float) -> bool:
        """Whether a disc overlaps none; if so, it is added to them."""
        near = self._near(float(place[self._axis]))
        offset = self._scene._to_nearest_image(self._position[near] - place)
        free = not ((offset**2).sum(axis=1) < (self.radius[near] + radius) ** 2).any()
        if free:
            self._position = np.append(self._position, place[None].astype(self._position.dtype), axis=0)
            self.radius = np.append(self.radius, radius)
        return free

    def _near(self, place: float) -> slice | NDArray[np.int64]:
        """Discs that may overlap one at a place along the longer side, some of them perhaps twice."""
        self._looks += 1
        if self._looks < FEW_LOOKS:
            return slice(None)
        if self._looks == FEW_LOOKS:
            order = np.argsort(self._position[:, self._axis])
            self._position, self.radius, self._sorted = self._position[order], self.radius[order], len(order)
        along, reach = self._position[: self._sorted, self._axis], 2 * self._scene.largest_radius * (1 + 1e-6)
        images = place + self._side * np.array((-1, 0, 1) if self._scene.periodic[self._axis] else (0,))
        strips = map(np.arange, np.searchsorted(along, images - reach), np.searchsorted(along, images + reach))
        return np.concatenate([*strips, np.arange(self._sorted, len(self.radius))])
