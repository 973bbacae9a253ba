"""What a scene may have besides discs in a box: obstacles, emitters, a piston. Checked when made; immutable."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

import contextlib
import gc
from collections.abc import Generator
from dataclasses import KW_ONLY, dataclass, fields
from itertools import chain, pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim import checks
from mpsim.errors import InputError

LARGEST_OBSTACLES = 1_000_000
"""More obstacles than this are taken for a mistake."""

LARGEST_EMITTERS = 1_000_000
"""More emitters than this likewise."""

EDGES = ("left", "right", "bottom", "top")
"""The walls of the box: x = 0, x = width, y = 0, y = height."""


def _point(name: str, value: ArrayLike) -> tuple[float, float]:
    x, y = checks.finite_array(name, value, (2,), "(2,)").tolist()
    return x, y


@dataclass(frozen=True)
class FixedDisc:
    """A disc that never moves: a peg.

    Args:
        position: centre (x, y) [length], in the box.
        radius: [length], > 0.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> FixedDisc((2, 3), 0.5).capsules()
    [(2.0, 3.0, 2.0, 3.0, 0.5)]
    """

    position: ArrayLike
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _point("position of a FixedDisc", self.position))
        object.__setattr__(self, "radius", checks.positive("radius of a FixedDisc", self.radius, "[length]"))

    def capsules(self) -> list[tuple[float, float, float, float, float]]:
        """Segments with a radius, as the kernels take all obstacles: (ax, ay, bx, by, radius); here one of length 0."""
        place: Any = self.position
        x, y = place
        return [(x, y, x, y, self.radius)]


@dataclass(frozen=True)
class Polyline:
    """A chain of straight walls, solid from both sides: a funnel, a channel, a bin.

    Args:
        points: corners, shape (K, 2), K >= 2 [length], in the box; neighbours differ.
        thickness: of the walls [length], >= 0.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Polyline([(0, 0), (1, 0), (1, 2)]).capsules()
    [(0.0, 0.0, 1.0, 0.0, 0.0), (1.0, 0.0, 1.0, 2.0, 0.0)]
    """

    points: ArrayLike
    thickness: float = 0.0

    def __post_init__(self) -> None:
        points = checks.finite_array("points of a Polyline", self.points, (None, 2), "(K, 2)")
        check_lines(points, np.array([points.shape[0]]))
        thickness = checks.non_negative("thickness of a Polyline", self.thickness, "[length]")
        object.__setattr__(self, "points", tuple((float(x), float(y)) for x, y in points))
        object.__setattr__(self, "thickness", thickness)

    def capsules(self) -> list[tuple[float, float, float, float, float]]:
        """Segments with a radius, as the kernels take all obstacles: (ax, ay, bx, by, radius)."""
        points: Any = self.points
        return [(ax, ay, bx, by, self.thickness / 2) for (ax, ay), (bx, by) in pairwise(points)]


Obstacle = FixedDisc | Polyline


@dataclass(frozen=True)
class Emitter:
    """A place where discs enter, one after the other.

    With `interval`, disc k enters at the time k * interval, whatever the time step and the method. The exact solver
    stops there; of the others a disc enters at the end of the frame that reaches its time, having flown for the rest
    of that frame: at position + v s + g s^2/2 with velocity v + g s, where s is the time since it was due and g the
    scene's gravity. A flight that meets a wall, the piston or an obstacle ends there.

    With `every`, a disc enters before each so manieth frame: another scene for each dt.

    Where a disc finds its place occupied it waits, an EmitterWarning says so once, and those after it are put off as
    long: it tries again every interval / 8 (of `every`: before each frame).

    Args:
        position: centre of the new disc (x, y) [length], a radius from walls and obstacles. Where a piston has passed
            it, no more discs enter, and a warning says so.
        velocity: of the new disc v (vx, vy) [length/time].
        interval: time between two discs [time], > 0.
        every: frames between two discs, >= 1, instead of interval.
        limit: discs in all, >= 1; None: no end.
        radius, mass: of the new discs [length], [mass]; None: those of the scene, if its discs have one.

    Raises:
        InputError: naming the argument, its rule and the value received; both or neither of interval and every.

    >>> Emitter(position=(1, 2), velocity=(3, 0), interval=0.25, limit=5)
    Emitter(position=(1.0, 2.0), velocity=(3.0, 0.0), interval=0.25, limit=5, radius=None, mass=None)
    """

    position: ArrayLike
    velocity: ArrayLike
    _: KW_ONLY
    interval: float | None = None
    every: int | None = None
    limit: int | None = None
    radius: float | None = None
    mass: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _point("position of an Emitter", self.position))
        object.__setattr__(self, "velocity", _point("velocity of an Emitter", self.velocity))
        if (self.interval is None) == (self.every is None):
            raise InputError(
                "an Emitter must have either interval, the time between two discs, or every, the frames between two; "
                f"got interval={checks.brief(self.interval)}, every={checks.brief(self.every)}."
            )
        if self.interval is not None:
            object.__setattr__(self, "interval", checks.positive("interval of an Emitter", self.interval, "[time]"))
        if self.every is not None:
            every = checks.whole("every of an Emitter", self.every, 1, 10**12, "One disc every `every` frames.")
            object.__setattr__(self, "every", every)
        if self.limit is not None:
            limit = checks.whole("limit of an Emitter", self.limit, 1, 10**8, "Leave it out for no end.")
            object.__setattr__(self, "limit", limit)
        for name in ("radius", "mass"):
            if getattr(self, name) is not None:
                unit = "[length]" if name == "radius" else "[mass]"
                object.__setattr__(self, name, checks.positive(f"{name} of an Emitter", getattr(self, name), unit))

    def __repr__(self) -> str:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        del values["every" if self.every is None else "interval"]  # so a scene's digest depends on what it has only
        return f"Emitter({', '.join(f'{name}={value!r}' for name, value in values.items())})"


@dataclass(frozen=True)
class Piston:
    """A wall of the box that moves at constant speed.

    Args:
        wall: "left", "right", "bottom" or "top".
        speed: along x or y [length/time]; a right wall with a negative speed compresses.
        stop: coordinate at which it comes to rest [length], in the box, on the way. There must be room for all discs
            then.
        start: coordinate at which it begins [length], between its wall and stop, which may be both: a piston that has
            arrived. None: at its wall.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Piston("right", speed=-0.5, stop=3).stop
    3.0
    """

    wall: str
    speed: float
    stop: float
    start: float | None = None

    def __post_init__(self) -> None:
        checks.choice("wall of a Piston", self.wall, EDGES)
        speed = float(checks.finite_array("speed of a Piston", self.speed, (), "()"))
        if speed == 0 or (speed < 0) != (self.wall in ("right", "top")):
            raise InputError(
                f"speed of a Piston must point into the box, {'< 0' if self.wall in ('right', 'top') else '> 0'} for "
                f"the {self.wall} wall; got {speed:g}. Turn its sign, or leave the piston out."
            )
        object.__setattr__(self, "speed", speed)
        object.__setattr__(self, "stop", checks.positive("stop of a Piston", self.stop, "[length]"))
        if self.start is not None:
            start = checks.non_negative("start of a Piston", self.start, "[length]")
            if (self.stop - start) * speed < 0:
                side = "at or above" if speed < 0 else "at or below"
                raise InputError(
                    f"start of a Piston must lie {side} its stop, {self.stop:g}, to which it moves; got {start:g}. "
                    "Leave it out for a piston that starts at its wall."
                )
            object.__setattr__(self, "start", start)

    def __repr__(self) -> str:
        start = "" if self.start is None else f", start={self.start!r}"
        return f"Piston(wall={self.wall!r}, speed={self.speed!r}, stop={self.stop!r}{start})"


def fixed_discs(position: NDArray[np.float64], radius: float | NDArray[np.float64]) -> list[FixedDisc]:
    """Many FixedDiscs of numbers that are checked already, at once.

    Args:
        position: finite, shape (K, 2) [length].
        radius: > 0, of all or of each, shape (K,) [length].
    """
    made: list[FixedDisc] = []
    radii = np.broadcast_to(radius, len(position)).tolist()
    with _garbage_collection_paused():
        for (x, y), each in zip(position.tolist(), radii, strict=True):
            disc = object.__new__(FixedDisc)
            vars(disc).update(position=(x, y), radius=each)
            made.append(disc)
    return made


def check_lines(points: NDArray[np.float64], lengths: NDArray[Any]) -> None:
    """Refuse points that are no Polylines, one after the other.

    Args:
        points: of all, finite, shape (K, 2) [length].
        lengths: how many of them each has, shape (L,): whole numbers >= 2 that add up to K.

    Raises:
        InputError: naming points or lengths, the rule and the values received.
    """
    wrong = (lengths > len(points)) | (lengths != np.floor(lengths)) | ((lengths < 2) & (len(lengths) > 1))
    if wrong.any() or lengths.sum() != len(points):
        raise InputError(
            f"lengths must be whole numbers >= 2 that add up to {len(points)}, the rows of points; got "
            f"{checks.brief(lengths[:20].tolist())}. Correct them, or leave them out for one line."
        )
    ends = np.cumsum(lengths.astype(np.int64))
    same = (points[1:] == points[:-1]).all(axis=1)
    same[ends[:-1] - 1] = False  # where the next one begins
    if same.any() or (lengths < 2).any():
        line = min(int(np.searchsorted(ends, int(same.argmax()) if same.any() else 0, "right")), len(ends) - 1)
        some = points[np.append(0, ends)[line] : ends[line]][:20].tolist()
        raise InputError(
            "points of a Polyline must be at least two, neighbours at different places; got "
            f"{checks.brief(some)}. Use a FixedDisc for a point."
        )


def polylines(
    points: NDArray[np.float64], lengths: NDArray[Any], thickness: float | NDArray[np.float64]
) -> list[Polyline]:
    """Many Polylines of numbers that are checked already, at once.

    Args:
        points, lengths: as of `check_lines`.
        thickness: >= 0, of all or of each, shape (L,) [length].
    """
    made: list[Polyline] = []
    ends = np.cumsum(lengths.astype(np.int64)).tolist()
    thick = np.broadcast_to(thickness, len(lengths)).tolist()
    with _garbage_collection_paused():
        corners: list[tuple[float, float]] = [(x, y) for x, y in points.tolist()]
        for first, last, each in zip([0, *ends], ends, thick, strict=False):  # one beginning more than ends
            line = object.__new__(Polyline)
            vars(line).update(points=tuple(corners[first:last]), thickness=each)
            made.append(line)
    return made


@contextlib.contextmanager
def _garbage_collection_paused() -> Generator[None]:
    """No search for garbage meanwhile: of a million objects that all stay it takes four fifths of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def capsules_of(obstacles: tuple[Obstacle, ...]) -> NDArray[np.float64]:
    """All obstacles as segments with a radius, shape (K, 5): ax, ay, bx, by, radius [length]."""
    numbers = chain.from_iterable(chain.from_iterable(obstacle.capsules() for obstacle in obstacles))
    return np.fromiter(numbers, np.float64).reshape(-1, 5)


def owner_of(capsule: int, obstacles: tuple[Obstacle, ...]) -> int:
    """Index of the obstacle that a row of `capsules_of` belongs to.

    >>> owner_of(2, (FixedDisc((1, 1), 1), Polyline([(0, 0), (1, 0), (1, 2)])))
    1
    """
    return int(np.searchsorted(np.cumsum([len(each.capsules()) for each in obstacles]), capsule, side="right"))


def check_obstacles(obstacles: object, width: float, height: float) -> tuple[Obstacle, ...]:
    """The obstacles as a tuple, if each is one and lies in the box."""
    each_of: Any = obstacles
    chosen = (each_of,) if isinstance(each_of, Obstacle) else tuple(each_of)
    if len(chosen) > LARGEST_OBSTACLES:
        raise InputError(
            f"obstacles must be at most {LARGEST_OBSTACLES:,}; got {len(chosen):,}. Use fewer: a Polyline is one."
        )
    for index, obstacle in enumerate(chosen):
        if not isinstance(obstacle, Obstacle):
            raise InputError(
                f"obstacles[{index}] must be an mpsim.FixedDisc or mpsim.Polyline; got {type(obstacle).__name__}."
            )
    ends = capsules_of(chosen)[:, :4].reshape(-1, 2)
    outside = (ends < 0).any(axis=1) | (ends[:, 0] > width) | (ends[:, 1] > height)
    if outside.any():
        first = int(outside.argmax())
        raise InputError(
            f"obstacles[{owner_of(first // 2, chosen)}] must lie in the box, [0, {width:g}] x [0, {height:g}]; got a "
            f"point {tuple(ends[first].tolist())}. Move it, or enlarge the box."
        )
    return chosen


def check_emitters(emitters: object) -> tuple[Emitter, ...]:
    """The emitters as a tuple, if each is one and they are not too many; a single one counts as one."""
    each_of: Any = emitters
    chosen = (each_of,) if isinstance(each_of, Emitter) else tuple(each_of)
    if len(chosen) > LARGEST_EMITTERS:
        raise InputError(f"emitters must be at most {LARGEST_EMITTERS:,}; got {len(chosen):,}. Use fewer.")
    for index, emitter in enumerate(chosen):
        if not isinstance(emitter, Emitter):
            raise InputError(f"emitters[{index}] must be an mpsim.Emitter; got {type(emitter).__name__}.")
    return chosen


def check_boundary(boundary: object) -> tuple[str, str]:
    """Boundary of x and of y, "walls" or "periodic" each; one word stands for both."""
    each_of: Any = boundary
    pair = (each_of, each_of) if isinstance(each_of, str) else tuple(each_of)
    if len(pair) != 2:
        raise InputError(f"boundary must be one word or one for x and one for y; got {boundary!r}.")
    x, y = (checks.choice("boundary", word, ("walls", "periodic")) for word in pair)
    return x, y


def check_edges(absorbing: object, boundary: tuple[str, str]) -> tuple[str, ...]:
    """Names of edges that swallow discs; they must be walls."""
    each_of: Any = absorbing
    names = (each_of,) if isinstance(each_of, str) else tuple(each_of)
    for name in names:
        checks.choice("absorbing", name, EDGES)
        _demand_wall("absorbing", name, boundary)
    return tuple(dict.fromkeys(names))


def check_piston(
    piston: Any, boundary: tuple[str, str], width: float, height: float, absorbing: tuple[str, ...]
) -> Piston | None:
    """The piston, if it is one, moves a wall, and stops in the box."""
    if piston is None:
        return None
    if not isinstance(piston, Piston):
        raise InputError(f"piston must be an mpsim.Piston; got {type(piston).__name__}.")
    _demand_wall("piston", piston.wall, boundary)
    if piston.wall in absorbing:
        raise InputError(f"piston must not be an absorbing edge; got {piston.wall!r} for both. Choose one.")
    length = width if piston.wall in ("left", "right") else height
    if not 0 < piston.stop < length:
        raise InputError(f"stop of the piston must lie in the box, in (0, {length:g}); got {piston.stop:g}.")
    if piston.start is not None and piston.start > length:
        raise InputError(f"start of the piston must lie in the box, in [0, {length:g}]; got {piston.start:g}.")
    return piston


def _demand_wall(name: str, edge: str, boundary: tuple[str, str]) -> None:
    axis = 0 if edge in ("left", "right") else 1
    if boundary[axis] == "periodic":
        raise InputError(
            f"{name} must name a wall; got {edge!r}, and boundary is periodic along {'xy'[axis]}. "
            "Make that axis 'walls', or choose another edge."
        )
