"""Obstacles: discs, polylines and circles, at rest or moving, all made of capsules. Checked when made; immutable."""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

from __future__ import annotations

import dataclasses
import math
import weakref
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.errors import InputError
from mpsim.features import capsules
from mpsim.features.capsules import Deepest
from mpsim.features.edges import EDGES
from mpsim.features.feature import AddedDiscs, Continuation, Feature, Invalidation, tuple_of
from mpsim.features.motions import MOTIONS, Movement, Rotation, check_kind
from mpsim.kernels.features.bodies import BODY
from mpsim.kernels.geometry import ENDS, OWNER, POLYGON, RADIUS, ROW, SURFACE

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """What every obstacle can do; see FixedDisc, Polyline and Circle.

    Args:
        motion: a Translation, Oscillation, Rotation or Path; None: it is at rest.
        surface_velocity: at which its surface runs along itself, as a belt does [length/time].
    """

    motion: Movement | None = None
    surface_velocity: float = 0.0

    def __post_init__(self) -> None:
        checks.keep_fields(self, motion=check_kind, surface_velocity=checks.finite)

    def __repr__(self) -> str:
        fields = [each for each in dataclasses.fields(self) if getattr(self, each.name) != _UNSAID.get(each.name, self)]
        arguments = sorted(fields, key=lambda each: each.name in _UNSAID)
        return f"{type(self).__name__}({', '.join(f'{each.name}={getattr(self, each.name)!r}' for each in arguments)})"

    def capsules(self) -> list[tuple[float, float, float, float, float]]:
        """Capsules where the obstacle was given: (ax, ay, bx, by, radius) [length]."""
        raise NotImplementedError

    @property
    def moves(self) -> bool:
        """Whether its capsules do."""
        return self.motion is not None

    @property
    def along(self) -> float:
        """Speed of its surface as the kernels take it: see `surface_speed` there [length/time]."""
        return self.surface_velocity

    def at_place(self, capsules: Floats) -> dict[str, Any]:
        """The arguments that would put it where its capsules have come to."""
        raise NotImplementedError

    def turned_over_to(self, motion: Movement | None, time: float) -> Obstacle:
        """The same obstacle with another motion, from where it is at a time on; times of the motion count from then."""
        here = {} if self.motion is None else self.at_place(capsules_of((self,), time))
        return dataclasses.replace(self, **here, motion=motion).seen_from(-time)

    def seen_from(self, time: float) -> Obstacle:
        """The same obstacle, where the clock of its motion is set to 0 at a time of the run."""
        return self if self.motion is None else dataclasses.replace(self, motion=self.motion.seen_from(time))


_UNSAID = {"filled": False, "inside": False, "motion": None, "surface_velocity": 0.0}
"""Values that go without saying."""


@dataclass(frozen=True, repr=False)
class FixedDisc(Obstacle):
    """A disc that no other disc moves, such as a peg.

    Args:
        position: centre (x, y) [length], in the box.
        radius: [length], > 0.
        motion: a Translation, Oscillation, Rotation or Path; None: it never moves.
        surface_velocity: at which its surface runs counter-clockwise, acting through wall_friction [length/time].

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> FixedDisc((2, 3), 0.5).capsules()
    [(2.0, 3.0, 2.0, 3.0, 0.5)]
    """

    position: ArrayLike
    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.keep_fields(self, position=checks.point, radius="[length]")

    def capsules(self) -> list[tuple[float, float, float, float, float]]:
        place: Any = self.position
        x, y = place
        return [(x, y, x, y, self.radius)]

    def at_place(self, capsules: Floats) -> dict[str, Any]:
        return {"position": capsules[0, :2]}


@dataclass(frozen=True, repr=False)
class Polyline(Obstacle):
    """A chain of straight walls that discs cannot cross from either side, such as a funnel, a channel or a bin.

    Args:
        points: corners, shape (K, 2), K >= 2 [length], in the box; neighbours differ.
        thickness: of the walls [length], >= 0.
        filled: whether no disc may start or be added inside the polygon, whose last corner then is the first.
        motion: a Translation, Oscillation, Rotation or Path; None: it never moves.
        surface_velocity: at which its surface runs from the first point to the last, acting through wall_friction
            [length/time].

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Polyline([(0, 0), (1, 0), (1, 2)]).capsules()
    [(0.0, 0.0, 1.0, 0.0, 0.0), (1.0, 0.0, 1.0, 2.0, 0.0)]
    """

    points: ArrayLike
    thickness: float = 0.0
    filled: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        points = checks.finite_array("points of a Polyline", self.points, (None, 2), "(K, 2)")
        if len(points) < 2 or (points[1:] == points[:-1]).all(axis=1).any():
            raise InputError(
                "points of a Polyline must be at least two, neighbours at different places; got "
                f"{checks.brief(points[:20].tolist())}. Use a FixedDisc for a point."
            )
        object.__setattr__(self, "points", tuple((float(x), float(y)) for x, y in points))
        checks.keep_fields(self, thickness=partial(checks.non_negative, unit="[length]"), filled=checks.truth)
        if self.filled and not self.is_closed:
            raise InputError(
                "points of a Polyline that is filled must end with the first one, after three or more; got "
                f"{checks.brief(points[:20].tolist())}. Add it."
            )

    @property
    def is_closed(self) -> bool:
        """Whether it is a polygon."""
        points: Any = self.points
        return len(points) > 3 and points[0] == points[-1]

    def capsules(self) -> list[tuple[float, float, float, float, float]]:
        points: Any = self.points
        return [(ax, ay, bx, by, self.thickness / 2) for (ax, ay), (bx, by) in pairwise(points)]

    def at_place(self, capsules: Floats) -> dict[str, Any]:
        return {"points": np.concatenate([capsules[:1, :2], capsules[:, 2:4]])}


@dataclass(frozen=True, repr=False)
class Circle(Obstacle):
    """A circle that discs cannot cross: from inside the wall of a round container, such as a drum; else a fixed disc.

    Args:
        centre: (x, y) [length], in the box.
        radius: [length], > 0.
        inside: True: all discs are inside, and it is solid outside; False: the other way round.
        motion: a Translation, Oscillation, Rotation or Path; None: it never moves. A Rotation about its own centre that
            does not stop is the same as a surface velocity.
        surface_velocity: at which its surface runs counter-clockwise, acting through wall_friction [length/time].

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Circle((5, 5), 4, inside=True)
    Circle(centre=(5.0, 5.0), radius=4.0, inside=True)
    """

    centre: ArrayLike
    radius: float
    inside: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.keep_fields(self, centre=checks.point, radius="[length]", inside=checks.truth)

    def capsules(self) -> list[tuple[float, float, float, float, float]]:
        place: Any = self.centre
        x, y = place
        return [(x, y, x, y, -self.radius if self.inside else self.radius)]

    @property
    def moves(self) -> bool:
        return self.motion is not None and self._spin == 0

    @property
    def along(self) -> float:
        speed = self.surface_velocity + self._spin * self.radius
        return -speed if self.inside else speed

    @property
    def _spin(self) -> float:
        """Angular velocity of a rotation about its own centre that never stops."""
        motion: Any = self.motion
        endless = isinstance(motion, Rotation) and motion.stop is None and motion.start <= 0
        return motion.rate if endless and motion.centre == self.centre else 0.0

    def at_place(self, capsules: Floats) -> dict[str, Any]:
        return {"centre": capsules[0, :2]}


@dataclass(frozen=True, repr=False)
class Removed(Obstacle):
    """What is left of an obstacle that was removed while a simulation ran: its number, which no other gets."""

    def capsules(self) -> list[tuple[float, float, float, float, float]]:
        return []


def capsules_of(obstacles: tuple[Obstacle, ...], time: float | None = None) -> Floats:
    """The capsules of all obstacles, shape (K, ROW); at a time, None: as they were given.

    >>> rows = capsules_of((FixedDisc((1, 1), 1), Polyline([(0, 0), (1, 0), (1, 2)], surface_velocity=3)))
    >>> rows[:, [SURFACE, OWNER]].tolist()
    [[0.0, 0.0], [3.0, 1.0], [3.0, 1.0]]
    """
    capsules = [each.capsules() for each in obstacles]
    owner = np.repeat(np.arange(len(obstacles)), np.array([len(each) for each in capsules], np.int64))
    rows = np.zeros((len(owner), ROW))
    numbers = chain.from_iterable(chain.from_iterable(capsules))
    rows[:, : RADIUS + 1] = np.fromiter(numbers, np.float64).reshape(-1, RADIUS + 1)
    rows[:, OWNER] = owner
    rows[:, SURFACE] = np.array([each.along for each in obstacles])[owner]
    filled = np.array([isinstance(each, Polyline) and each.filled for each in obstacles])
    rows[:, POLYGON] = np.where(filled[owner], owner + 1, 0)
    if time is not None:
        for number, each in enumerate(obstacles):
            if each.motion is not None:
                part = slice(*np.searchsorted(owner, [number, number + 1]))
                rows[part] = each.motion.capsules_at(rows[part], time)
    return rows


def exchanged(present: tuple[Obstacle, ...], wanted: Iterable[Obstacle], time: float) -> tuple[Obstacle, ...]:
    """Obstacles of a run after a change to those wanted: equal ones stay, others are Removed, or begin at this time."""
    left, kept = Counter(wanted), list[Obstacle]()
    for each in present:
        stays = left[each] > 0
        left[each] -= stays
        kept.append(each if stays else Removed())
    return (*kept, *(each.seen_from(-time) for each in left.elements()))


def listed(obstacles: object) -> tuple[Obstacle, ...]:
    """The obstacles as a tuple; a single one may come without a list."""
    return tuple_of("obstacles", obstacles, OBSTACLES.kinds, Removed)


def check_obstacles(obstacles: object, width: float, height: float) -> tuple[Obstacle, ...]:
    """The obstacles as `listed`, all in a box."""
    chosen = listed(obstacles)
    rows = capsules_of(chosen)
    ends = rows[:, ENDS].reshape(-1, 2)
    outside = (ends < 0).any(axis=1) | (ends[:, 0] > width) | (ends[:, 1] > height)
    if outside.any():
        first = int(outside.argmax())
        raise InputError(
            f"obstacles[{rows[first // 2, OWNER]:.0f}] must lie in the box, [0, {width:g}] x [0, {height:g}]; got a "
            f"point {tuple(ends[first].tolist())}. Move it, or enlarge the box."
        )
    return chosen


def _obstacles_near(scene: Scene, position: Floats, radius: float, time: float) -> dict[str, float]:
    """Gap between a disc at (x, y) and each obstacle, the nearest first, by name [length]."""
    rows = scene._capsules_at(time)
    images = capsules.with_images(rows, (scene.width, scene.height), scene.periodic, math.inf)
    gap = capsules.gaps(position - images.shift, radius, rows[images.source])
    found = np.full(len(scene.obstacles), np.inf)
    np.minimum.at(found, rows[images.source, OWNER].astype(int), gap)
    return {f"obstacles[{number}]": float(found[number]) for number in np.argsort(found, kind="stable")}


def surfaces_near(scene: Scene, position: Floats, radius: float, time: float) -> list[str]:
    """Names of the obstacles and walls within a radius of a disc at (x, y), the nearest first."""
    near = _obstacles_near(scene, position, radius, time)
    for side, ends in zip((-1, 1), scene.walls_at(time), strict=True):
        for axis in range(2):
            if not scene.periodic[axis]:
                near[f"the {EDGES[2 * axis + (side > 0)]} wall"] = side * (ends[axis] - position[axis]) - radius
    return [name for name in sorted(near, key=lambda each: near[each]) if near[name] < radius]


class _Made(NamedTuple):
    """Arrays of `Capsules` and of `Bodies`, by name."""

    at_rest: dict[str, NDArray[Any]]
    moving: dict[str, NDArray[Any]]


class Obstacles(Feature):
    """The argument `obstacles`."""

    argument = "obstacles"
    kinds: ClassVar[tuple[type[Any], ...]] = (FixedDisc, Polyline, Circle)
    within: ClassVar[tuple[type[Any], ...]] = (Removed, *MOTIONS)
    examples: ClassVar[tuple[Any, ...]] = (FixedDisc((0, 0), 1), Polyline([(0, 0), (1, 0)]), Circle((0, 0), 1))
    excludes = True
    invalidates: ClassVar[tuple[Invalidation, ...]] = (
        Invalidation(
            ("virial", "momentum_drift"),
            "obstacles, whose impulses are not counted",
            "Use 'energy_drift' for the health of a run, 'pressure' for the load on the walls.",
        ),
    )

    def __init__(self) -> None:
        self._made: weakref.WeakKeyDictionary[Any, tuple[Any, _Made]] = weakref.WeakKeyDictionary()
        """Arrays of scenes in use, with what they were made from: each block needs them twice."""

    def check(self, scene: Scene) -> None:
        for index, each in enumerate(self.of(scene)):
            if each.surface_velocity and not scene.wall_friction:
                raise InputError(
                    f"surface_velocity of obstacles[{index}] acts through friction, and wall_friction is 0; got "
                    f"{each.surface_velocity:g}. Give the scene a wall_friction > 0, or leave it out."
                )
            if each.moves:
                _check_motion(f"obstacles[{index}]", each, scene)
            if scene._on_lattice is None:
                _check_contents(f"obstacles[{index}]", each, scene)

    def check_room(self, scene: Scene, new: AddedDiscs) -> None:
        found = scene._deepest(new.position, new.radius, new.time)
        capsules.check_clear(found, new.name, new.position, new.radius)

    def surface_speed(self, scene: Scene) -> float:
        moving = ((each, each.motion) for each in self.of(scene) if each.moves)
        return max((motion.fastest(capsules_of((each,))) for each, motion in moving if motion), default=0.0)

    def running_speed(self, scene: Scene) -> float:
        return max((abs(each.along) for each in self.of(scene)), default=0.0)

    def works(self, scene: Scene) -> tuple[int | str, ...]:
        return tuple(k for k, each in enumerate(self.of(scene)) if each.motion is not None or each.surface_velocity)

    def continued(self, scene: Scene, moment: Continuation) -> tuple[Obstacle, ...]:
        return tuple(each.seen_from(moment.time) for each in self.of(scene) if not isinstance(each, Removed))

    def deepest(self, scene: Scene, position: Floats, radius: Floats, time: float) -> Deepest | None:
        size = (scene.width, scene.height)
        depth = scene._capsule_index_at(time).depths(position, radius)
        number = int((depth > 8 * np.finfo(np.float64).eps * max(size)).sum())
        if not number:
            return None
        worst = int(depth.argmax())
        where = next(iter(_obstacles_near(scene, position[worst], radius[worst], time)))
        return Deepest(number, worst, where, float(depth[worst]))

    def arrays(self, scene: Scene, real: np.dtype) -> dict[str, NDArray[Any]]:
        at_rest = {
            f"capsules.{name}": each.astype(real, copy=False) if each.dtype.kind == "f" else each
            for name, each in self.at_rest(scene).items()
        }
        return at_rest | {f"bodies.{name}": each for name, each in self.bodies(scene).items()}

    def begin(self, scene: Scene, arrays: dict[str, Any], dt: float, origin: tuple[int, float]) -> None:
        if "bodies.body" in arrays:
            arrays["bodies.body"]["dt"], arrays["bodies.body"]["origin"] = dt, origin[1]

    def at_rest(self, scene: Scene) -> dict[str, NDArray[Any]]:
        """Capsules at rest, with images beyond periodic borders, and their grid (see `cell_lists`); {} without any.

        The grid depends neither on the method nor on the number of discs.
        """
        return self._arrays(scene).at_rest

    def bodies(self, scene: Scene, margin: float = 0.0) -> dict[str, NDArray[Any]]:
        """The arrays of `Bodies`: all obstacles that move; {} without any. margin: of their near lists [length]."""
        return self._arrays(scene).moving if margin == 0 else _made(self.of(scene), scene, margin).moving

    def _arrays(self, scene: Scene) -> _Made:
        made_of = (id(self.of(scene)), scene.width, scene.height, scene.periodic, scene.largest_radius)
        if scene not in self._made or self._made[scene][0] != made_of:
            self._made[scene] = made_of, _made(self.of(scene), scene)
        return self._made[scene][1]

    def description(self, scene: Scene) -> str:
        return f"{len(self.of(scene))}"


# --- What the kernels need: capsules at rest, and bodies that move


def _made(obstacles: tuple[Obstacle, ...], scene: Scene, margin: float = 0.0) -> _Made:
    rows = capsules_of(obstacles)
    motions = list(dict.fromkeys(each.motion for each in obstacles if each.motion is not None and each.moves))
    which = {motion: number for number, motion in enumerate(motions)}
    body = np.array([which[each.motion] if each.motion in which and each.moves else -1 for each in obstacles], np.int64)
    body = body[rows[:, OWNER].astype(np.int64)]
    made = [_body(motion, rows[body == number], scene, margin) for number, motion in enumerate(motions)]
    return _Made(_at_rest(rows[body < 0], scene), _joined(made) if made else {})


def _at_rest(rows: Floats, scene: Scene) -> dict[str, NDArray[Any]]:
    """Arrays of `Capsules`, {} without any."""
    size = (scene.width, scene.height)
    rows = capsules.with_images(rows, size, scene.periodic, scene.largest_radius).capsule
    if not len(rows):
        return {}
    around = rows[:, RADIUS] < 0
    rows = rows[np.argsort(around, kind="stable")]
    solid = rows[: np.count_nonzero(~around)]
    lists = capsules.cell_lists(solid, size, scene.largest_radius)
    every = np.concatenate([rows, capsules.cut_at_ends(solid, lists, size)])  # which these lists leave out
    made: dict[str, NDArray[Any]] = {"capsule": every, "next_end": capsules.next_ends(every)}
    made |= {"near": lists.near, "index": lists.listed, "grid": lists.grid, "per_length": lists.per_length}
    if around.any():
        made["around"] = np.arange(len(solid), len(around))
    return made


def _body(motion: Movement, rows: Floats, scene: Scene, margin: float) -> dict[str, NDArray[Any]]:
    """Arrays of `Bodies` for capsules of the same motion, with a grid over all of them."""
    (body, knots), reach = motion.body(), scene.largest_radius + margin
    for axis, length in enumerate((scene.width, scene.height)):
        body.nearest[axis] = scene.periodic[axis] and 2 * _half_size(motion, rows, scene.largest_radius)[axis] <= length
        if scene.periodic[axis] and not body.nearest[axis]:
            step = length * np.eye(2)[axis]
            rows = np.concatenate([rows, capsules.shifted(rows, -step), capsules.shifted(rows, step)])
    ends, border = rows[:, ENDS].reshape(-1, 2), 1.001 * (reach + float(np.abs(rows[:, RADIUS]).max()))
    low, high = ends.min(axis=0) - border, ends.max(axis=0) + border
    width, height = (high - low).tolist()
    placed = capsules.shifted(rows, -low)
    lists = capsules.cell_lists(placed, (width, height), reach)
    halves = capsules.cut_at_ends(placed, lists, (width, height))
    body.low[:], body.middle[:] = low, 0.5 * (low + high)
    body.cells[:], body.per_length[:], body.margin = lists.grid, lists.per_length, margin
    every = np.concatenate([rows, capsules.shifted(halves, low)])
    arrays = {"capsule": every, "next_end": capsules.next_ends(every), "near": lists.near, "index": lists.listed}
    return arrays | {"body": np.array([body], BODY), "knots": knots}


def _joined(parts: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Arrays of several bodies as one."""
    first = {"near": 0, "index": 0, "capsule": 0, "knots": 0}
    for number, part in enumerate(parts):
        part["body_of"] = np.full(len(part["capsule"]), number)
        body = part["body"][0]
        body.first = first["near"]
        body.knots[:] += first["knots"]
        part["near"] = part["near"] + np.int32(first["index"])
        part["index"] = part["index"] + np.int32(first["capsule"])
        part["next_end"] = part["next_end"] + np.int32(2 * first["capsule"])
        for name in first:
            first[name] += len(part[name])
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _half_size(motion: Movement, rows: Floats, reach: float) -> Floats:
    """Half of the width and height of what discs of a radius can touch, however it has turned, shape (2,) [length]."""
    ends = rows[:, ENDS].reshape(-1, 2)
    half = 0.5 * (ends.max(axis=0) - ends.min(axis=0)) + float(rows[:, RADIUS].max()) + reach
    return np.full(2, math.hypot(*half)) if isinstance(motion, Rotation) else half


def _check_motion(name: str, obstacle: Obstacle, scene: Scene) -> None:
    """Refuse a motion that leaves the box, or of something so long that it would meet its own image."""
    motion: Any = obstacle.motion
    rows, size = capsules_of((obstacle,)), (scene.width, scene.height)
    low, high = motion.swept(rows[:, ENDS].reshape(-1, 2))
    beyond = np.maximum(-rows[0, RADIUS], 0.0) * np.array(scene.periodic)  # a container has no images
    low, high = low - beyond, high + beyond
    side = 2 * _half_size(motion, rows, scene.largest_radius)
    for axis, length in enumerate(size):
        slack = 1e-9 * length
        if (
            scene.periodic[axis]
            and side[axis] > length
            and (isinstance(motion, Rotation) or high[axis] - low[axis] > 2 * length)
        ):
            raise InputError(
                f"{name} must be shorter than the periodic box along {'xy'[axis]}, {length:g}, to move so far along it "
                f"or to turn; got {side[axis]:.4g}, with the largest disc on both sides. Use a larger box."
            )
        if (not scene.periodic[axis] or beyond[axis]) and (low[axis] < -slack or high[axis] > length + slack):
            raise InputError(
                f"the motion of {name} must keep it in the box, in [0, {length:g}] along {'xy'[axis]}; got "
                f"[{low[axis]:g}, {high[axis]:g}]. Give a Translation a stop, or move less far."
            )


def _check_contents(name: str, shape: Obstacle, scene: Scene) -> None:
    """Refuse discs with their centres outside a container, or too large for it, or in a filled polygon."""
    if isinstance(shape, Circle) and shape.inside:
        if scene.largest_radius >= shape.radius:
            raise InputError(
                f"radius of {name}, a Circle with discs inside, must be above that of the largest disc, "
                f"{scene.largest_radius:g}; got {shape.radius:g}. Use a larger circle, or smaller discs."
            )
        for axis, length in enumerate((scene.width, scene.height)):
            low, high = (shape.capsules()[0][axis] + sign * shape.radius for sign in (-1, 1))
            if scene.periodic[axis] and not 0 <= low < high <= length:
                raise InputError(
                    f"{name}, a Circle with discs inside, must lie in the periodic box along {'xy'[axis]}, in "
                    f"[0, {length:g}]; got [{low:g}, {high:g}]. Use a smaller circle, or walls."
                )
        where, wrong = "inside", capsules.distance(scene.position, capsules_of((shape,), 0.0)) < 0
    elif isinstance(shape, Polyline) and shape.filled:
        where, wrong = "outside", capsules.is_within(scene.position, capsules_of((shape,), 0.0))
    else:
        return
    if wrong.any():
        disc = int(wrong.argmax())
        raise InputError(
            f"position[{disc}] must lie {where} {name}, a {type(shape).__name__}; got "
            f"{tuple(scene.position[disc].tolist())} (such discs: {int(wrong.sum())}). Move it, or use Scene.random."
        )


OBSTACLES = Obstacles()
