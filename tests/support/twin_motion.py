"""The twins' motion of one disc over one step: forces, walls, borders, a piston, edges that absorb, obstacles."""

import itertools
import math
from typing import Any

import numpy as np

import mpsim

EDGES = ("left", "right", "bottom", "top")


def differs(own: Any, of_emitters: list[Any], usual: Any) -> bool:
    """Whether discs differ in radius or mass, those of emitters included: one for all is a number, or nothing."""
    return (own is not None and np.ndim(own) > 0) or any(each not in (None, usual) for each in of_emitters)


def segments_of(scene: mpsim.Scene) -> np.ndarray:
    """Obstacles as segments with a radius, (ax, ay, bx, by, radius) [length], shape (K, 5)."""
    found = []
    for obstacle in scene.obstacles:
        if isinstance(obstacle, mpsim.FixedDisc):
            found.append([*obstacle.position, *obstacle.position, obstacle.radius])
        elif isinstance(obstacle, mpsim.Circle):
            found.append([*obstacle.centre, *obstacle.centre, obstacle.radius * (-1 if obstacle.inside else 1)])
        else:
            assert isinstance(obstacle, mpsim.Polyline), f"the twin does not know a {type(obstacle).__name__}"
            ends = zip(obstacle.points[:-1], obstacle.points[1:], strict=True)
            found += [[*start, *end, obstacle.thickness / 2] for start, end in ends]
    return np.array(found).reshape(-1, 5)


def capsules_of(scene: mpsim.Scene) -> np.ndarray:
    """The obstacles, and images of all so far, that a disc in the box can touch."""
    found = list(segments_of(scene))
    for axis, (length, word) in enumerate(zip((scene.width, scene.height), scene.boundary, strict=True)):
        if word == "periodic":
            steps = [sign * length * np.array([1 - axis, axis, 1 - axis, axis, 0]) for sign in (0, 1, -1)]
            images = [np.array(capsule) + step for step in steps for capsule in found]
            found = [
                capsule
                for capsule in images
                if max(capsule[axis], capsule[axis + 2]) > -(scene.largest_radius + capsule[4])
                and min(capsule[axis], capsule[axis + 2]) < length + (scene.largest_radius + capsule[4])
            ]
    return np.array(found).reshape(-1, 5)


CELLS_PER_OBSTACLE = 16
"""Cells of the obstacles' own grid are as many, or fewer where discs are larger than such a cell."""


def cells_of(capsules: np.ndarray, scene: mpsim.Scene) -> np.ndarray:
    """For each cell of a grid, columns and rows, the capsules that a disc with its centre there can touch, in order.

    They are found from the middle of the cell: a disc in it is no further than half a diagonal, and a rounding, away.
    """
    size, reach = (scene.width, scene.height), scene.largest_radius
    side = max(2 * reach, math.sqrt(size[0] * size[1] / (CELLS_PER_OBSTACLE * (len(capsules) + 1))))
    found = np.empty([max(int(length / side), 1) for length in size], object)
    cell = [length / number for length, number in zip(size, found.shape, strict=True)]
    for place in np.ndindex(found.shape):
        middle = np.array([(index + 0.5) * length for index, length in zip(place, cell, strict=True)])
        away = [np.hypot(*Motion.from_segment(middle, each[:2], each[2:4])[0]) for each in capsules]
        apart = [(own if each[4] >= 0 else -own) - each[4] for own, each in zip(away, capsules, strict=True)]
        within = reach + math.hypot(*cell) / 2 * 1.001
        found[place] = [index for index, distance in enumerate(apart) if distance <= within]
    return found


class Motion:
    """A scene's discs, and how each moves when it meets no other. Limits of axis 0 (x) and 1 (y) are pairs."""

    def __init__(self, scene: mpsim.Scene, settings: mpsim.Settings):
        self.scene, self.settings = scene, settings
        real = self.real = np.float32 if settings.precision == "float32" else np.float64
        self.impact = settings.contact == "impact"
        self.p, self.v = scene.position.astype(real), scene.velocity.astype(real)
        self.has_radii = differs(scene.radius, [each.radius for each in scene.emitters], scene.radius)
        self.has_masses = scene.mass is not None or differs(None, [each.mass for each in scene.emitters], 1)
        self.radii, self.mass = np.array(scene.radii, float), np.array(scene.masses).astype(real)
        self.gone = np.zeros(scene.count, bool)
        self.image = np.zeros((scene.count, 2), np.int64)
        self.diameter = real(2 * scene.largest_radius)
        self.dt = real(settings.dt / settings.substeps)
        self.wall_restitution = real(scene.wall_restitution)
        self.spin = np.zeros(scene.count, real) if scene.spin is None else scene.spin.astype(real)
        self.friction = friction_of(scene.friction, (1 + scene.tangential_restitution) / 6, real)
        self.wall_friction = friction_of(scene.wall_friction, (1 + scene.tangential_restitution) / 3, real)
        size = (scene.width, scene.height)
        periodic = [word == "periodic" for word in scene.boundary]
        self.wrap = [real(length) if wrap else None for length, wrap in zip(size, periodic, strict=True)]
        self.inset = 0.0 if self.has_radii else scene.largest_radius
        self.limits = [[real(self.inset), real(length - self.inset)] for length in size]
        self.wall_speeds = [[real(0), real(0)], [real(0), real(0)]]
        self.limits_at_contacts, self.steps = self.limits, 0
        self.gravity = None if scene.gravity is None else scene.gravity.astype(real)
        own = np.zeros((scene.count, 2)) if scene.acceleration is None else scene.acceleration
        self.acceleration = own.astype(real)
        exact = capsules_of(scene)
        self.capsules, self.near = exact.astype(real), cells_of(exact, scene)
        self.arms = [[arms_of(exact, 2 * k + side, real) for side in (0, 1)] for k in range(len(exact))]
        self.obstacle_cells = np.array([cells / length for cells, length in zip(self.near.shape, size, strict=True)])
        self.obstacle_cells = self.obstacle_cells.astype(real)
        self.place_piston()

    @property
    def pulled(self) -> bool:
        return self.gravity is not None or self.scene.acceleration is not None

    @property
    def plain(self) -> bool:
        """Whether nothing but four smooth walls at rest and discs of one size are there."""
        special = self.scene.piston or self.wall_friction or any(wrap is not None for wrap in self.wrap)
        return not (self.has_radii or special)

    def radius(self, i: int) -> Any:
        return self.real(self.radii[i])

    def pull(self, i: int, axis: int) -> Any:
        pull = self.real(0)
        if self.gravity is not None:
            pull += self.gravity[axis]
        if self.scene.acceleration is not None:
            pull += self.acceleration[i, axis]
        return pull

    def inside(self, i: int, axis: int) -> tuple[Any, Any]:
        """Least and largest place of a disc's centre between walls."""
        margin = self.radius(i) if self.has_radii else self.real(0)
        return self.limits[axis][0] + margin, self.limits[axis][1] - margin

    def confined(self, i: int, axis: int, place: Any) -> Any:
        if self.wrap[axis] is not None:
            return place
        low, high = self.inside(i, axis)
        return min(max(place, low), high)

    def wrapped(self, place: Any, axis: int) -> Any:
        """The same place inside a periodic box, [0, length)."""
        length = self.wrap[axis]
        if length is None:
            return place
        place = place - length * np.floor(place / length)
        return self.real(0) if place < 0 or place >= length else place

    def wrap_disc(self, i: int, axis: int, place: Any) -> Any:
        """`wrapped`, counted: by whole periods down to the place, or one fewer where rounding has put it at 0 or up."""
        length = self.wrap[axis]
        if length is None:
            return place
        periods = int(np.floor(place / length))
        rest = place - length * np.floor(place / length)
        self.image[i, axis] += periods + (1 if rest >= length else 0)
        return self.wrapped(place, axis)

    def move(self, i: int) -> None:
        """One step: swallowed by an edge, or moved between walls and off obstacles."""
        if self.scene.absorbing and not self.gone[i] and self.leaves(i):
            self.gone[i] = True
        if self.gone[i]:
            self.v[i] = 0
            return
        advance = self.fall if self.pulled and self.impact else self.drift
        self.rub_walls(i, [advance(i, axis) for axis in range(2)])
        self.meet_obstacles(i)

    def leaves(self, i: int) -> bool:
        """Whether this step would bring a disc to an absorbing edge, along the way that it will take."""
        late = self.dt / self.real(2) if self.impact else self.real(0)
        for edge in self.scene.absorbing:
            axis, side = divmod(EDGES.index(edge), 2)
            speed = self.v[i, axis] + self.pull(i, axis) * (self.dt - late)
            place, limit = self.p[i, axis] + speed * self.dt, self.inside(i, axis)[side]
            if place > limit if side else place < limit:
                return True
        return False

    def drift(self, i: int, axis: int) -> tuple[Any, Any, Any]:
        """v += a dt, p += v dt, and the wall rule.

        Returns where inwards is from the wall, 1 or -1, by what the wall has changed the velocity, and how long ago.
        """
        if self.gravity is not None:
            self.v[i, axis] += self.gravity[axis] * self.dt
        if self.scene.acceleration is not None:
            self.v[i, axis] += self.acceleration[i, axis] * self.dt
        p = self.wrap_disc(i, axis, self.p[i, axis]) + self.v[i, axis] * self.dt
        if self.wrap[axis] is not None:
            self.p[i, axis] = self.wrap_disc(i, axis, p)
            return 1, self.real(0), self.real(0)
        limits, v = self.inside(i, axis), self.v[i, axis]
        beyond = p < limits[0]
        p, self.v[i, axis], time = self.reflected(axis, p, v, limits, self.plain)
        if self.plain and beyond and p > limits[1]:  # faster than a box per step: it bounces once more
            p, _, _ = self.reflected(axis, p, self.real(0), limits, self.plain)
        self.p[i, axis] = min(max(p, limits[0]), limits[1])
        return (1 if beyond else -1), self.v[i, axis] - v, time

    def reflected(
        self, axis: int, p: Any, v: Any, limits: tuple[Any, Any], plain: bool = False
    ) -> tuple[Any, Any, Any]:
        """Place and velocity beyond a wall, mirrored there: as far inside as it would be outside, or under push on it.

        And the time since it has touched the wall. plain: the walls are known to be at rest.
        """
        back, time = self.wall_restitution if self.impact else self.real(0), self.real(0)
        for side, sign in ((0, -1), (1, 1)):
            limit, wall = limits[side], self.wall_speeds[axis][side]
            if sign * p > sign * limit:
                if sign * v > sign * wall:
                    time = (p - limit) / (v - wall)
                    v = -v * self.wall_restitution if plain else wall - (v - wall) * self.wall_restitution
                return limit + back * (limit - p), v, time
        return p, v, time

    def fall(self, i: int, axis: int) -> tuple[Any, Any, Any]:
        """Along the parabola; beyond a wall, bounced off where the parabola crossed it. Returns as `drift`."""
        pull = self.pull(i, axis)
        v = self.v[i, axis] + pull * self.dt
        p = self.wrap_disc(i, axis, self.p[i, axis]) + (v - pull * self.dt / self.real(2)) * self.dt
        before, inward, time = v, 1, self.real(0)
        if self.wrap[axis] is None:
            inward = 1 if p < self.inside(i, axis)[0] else -1
            p, v, time = self.off_walls(axis, p, v, pull, self.inside(i, axis))
        self.p[i, axis], self.v[i, axis] = self.wrap_disc(i, axis, p), v
        return inward, v - before, time

    def off_walls(self, axis: int, p: Any, v: Any, pull: Any, limits: tuple[Any, Any]) -> tuple[Any, Any, Any]:
        """Place and velocity of an accelerated disc, bounced off the wall that it is beyond, if any, and since when."""
        for side, sign in ((0, -1), (1, 1)):
            limit, wall = limits[side], self.wall_speeds[axis][side]
            if sign * p > sign * limit:
                way, inward, time = self.bounced(abs(p - limit), sign * (v - wall), sign * pull)
                return min(max(limit - sign * way, limits[0]), limits[1]), wall - sign * inward, time
        return p, v, self.real(0)

    def bounced(self, depth: Any, speed: Any, pull: Any) -> tuple[Any, Any, Any]:
        """Way and speed inward of a disc so far beyond a wall, so fast and so pulled outward. Energy tells the rest.

        And the time since it has touched the wall; of one that rests there, over which the wall has pressed it.
        """
        at_wall = np.sqrt(max(speed * speed - self.real(2) * pull * depth, self.real(0)))
        if speed + at_wall <= 0:  # it moves inward already
            return self.real(0), at_wall, self.real(0)
        time = min(self.real(2) * depth / (speed + at_wall), type(depth)(self.dt))
        start = self.wall_restitution * at_wall
        way, inward = (start - pull * time / self.real(2)) * time, start - pull * time
        return (self.real(0), max(inward, self.real(0)), depth / speed) if way < 0 else (way, inward, time)

    # --- friction

    def rub_walls(self, i: int, met: list[tuple[Any, Any, Any]], wraps: bool = True) -> None:
        """Friction on walls that have changed the velocity along each axis by so much, so long ago.

        A wall that has only taken speed from a disc which moves inwards has not pressed it.
        """
        if self.wall_friction is None or not any(change for _, change, _ in met):
            return
        for axis, (inward, change, time) in enumerate(met):
            n = np.zeros(2, self.real)
            n[axis] = inward
            self.rub(i, n, inward * change, time if self.impact else self.real(0))
        for axis in range(2):
            self.p[i, axis] = self.confined(i, axis, self.p[i, axis])
            if wraps:
                self.p[i, axis] = self.wrap_disc(i, axis, self.p[i, axis])

    def rub(self, i: int, n: Any, pressed: Any, time: Any) -> None:
        """Friction on what is fixed, in the direction -n, whose contact has changed the velocity along n by `pressed`.

        The tangential velocity at that time is changed, and the place by as much as that leads to since.
        """
        if self.wall_friction is None or not pressed > 0:
            return
        time = min(time, n.dtype.type(self.dt))
        then = [self.v[i, axis] - self.pull(i, axis) * time for axis in range(2)]
        radius = self.surface(i)
        slip = then[1] * n[0] - then[0] * n[1] - radius * self.spin[i]
        change = limited(self.wall_friction, slip, pressed)
        self.v[i, 0] += change * n[1]
        self.v[i, 1] -= change * n[0]
        self.p[i, 0] += change * n[1] * time
        self.p[i, 1] -= change * n[0] * time
        self.spin[i] += self.real(2) * change / radius

    def surface(self, i: int) -> Any:
        """Distance from the centre of a disc to its surface."""
        return self.radius(i) if self.has_radii else self.diameter / self.real(2)

    # --- the piston

    def place_piston(self) -> None:
        """The wall where contacts and the next step will meet it, and its speed in the middle of that step."""
        piston = self.scene.piston
        if piston is None:
            return
        axis, side = divmod(EDGES.index(piston.wall), 2)
        start = piston.start if piston.start is not None else (self.scene.width, self.scene.height)[axis] * side
        inwards, duration = (-self.inset if side else self.inset), (piston.stop - start) / piston.speed
        now, later = ((self.steps + more) / self.settings.substeps * self.settings.dt for more in (0, 1))
        self.limits_at_contacts = [list(pair) for pair in self.limits]
        for limits, time in ((self.limits_at_contacts, now), (self.limits, later)):
            place = start + piston.speed * time
            arrived = time >= duration or (place < piston.stop if side else place > piston.stop)
            limits[axis][side] = self.real((piston.stop if arrived else place) + inwards)
        self.wall_speeds[axis][side] = self.real(piston.speed if (now + later) / 2 < duration else 0)

    def advance_piston(self) -> None:
        self.steps += 1
        self.place_piston()

    # --- obstacles

    def meet_obstacles(self, i: int) -> None:
        """Off every obstacle near the cell in which the disc is now, one after the other."""
        cell = (
            min(max(int(self.p[i, axis] * self.obstacle_cells[axis]), 0), self.near.shape[axis] - 1) for axis in (0, 1)
        )
        met = [self.meet_capsule(i, self.capsules[k], self.arms[k]) for k in self.near[tuple(cell)]]
        if any(met):
            for axis in range(2):
                self.p[i, axis] = self.wrap_disc(i, axis, self.confined(i, axis, self.p[i, axis]))

    def meet_capsule(self, i: int, capsule: Any, arms: list[Any]) -> bool:
        """Bounce off a segment with a radius, or out of it; not off an end where another segment is nearer.

        arms: at each end, vectors along the segments that end there, its own the first.
        """
        a, b = capsule[:2], capsule[2:4]
        r, end = self.from_segment(self.p[i], a, b)
        reach = self.surface(i) + capsule[4]
        if capsule[4] < 0:
            return self.meet_wall_around(i, a, -reach)
        if not _dot(r, r) < reach * reach:
            return False
        if end is not None and any(_dot(r, arm) > 0 for arm in arms[end][1:]):
            return False
        r, v = r.astype(np.float64), self.v[i].astype(np.float64)  # whatever the precision of the run
        distance = np.sqrt(_dot(r, r))
        if self.impact and _dot(r, v) < 0:
            n = r / distance if end is None else self.normal_at_touch(r, v, reach, arms[end])
            pull = [self.pull(i, axis) for axis in range(2)]
            depth, speed = reach - _dot(r, n), max(-_dot(v, n), self.real(0))
            way, inward, time = self.bounced(depth, speed, -_dot(pull, n))
            way, change = way + depth, max(inward + speed, self.real(0))
        else:
            n = self.away_from(r, distance, (b - a).astype(np.float64))
            along = _dot(v, n)
            way = reach - distance
            change = -(1.0 + np.float64(self.wall_restitution)) * along if along < 0 else self.real(0)
            time = 0.0
        self.v[i] += change * n
        self.p[i] += way * n
        self.rub(i, n, change, time)
        return True

    def meet_wall_around(self, i: int, centre: Any, room: Any) -> bool:
        """Back inside a circle, from where it was crossed as long as that was in this step: at most seven times."""
        for bounce in range(8):
            r, v = (self.p[i] - centre).astype(np.float64), self.v[i].astype(np.float64)
            outside, outward = _dot(r, r) - room * room, _dot(r, v)
            if not outside > 0:
                return bounce > 0
            n = -r / np.sqrt(_dot(r, r))
            if self.impact and outward > 0 and bounce < 7:
                crossing = outward * outward - _dot(v, v) * outside
                since = outside / (outward + np.sqrt(max(crossing, 0.0)))
                if crossing > 0 and since <= self.dt:
                    n = v * since - r
                    n = n / np.sqrt(_dot(n, n))
                pull = [self.pull(i, axis) for axis in range(2)]
                depth = max(-room - _dot(r, n), 0.0)
                way, inward, time = self.bounced(depth, max(-_dot(v, n), self.real(0)), -_dot(pull, n))
                way, change = way + depth, max(inward - _dot(v, n), self.real(0))
            else:
                along, time = _dot(v, n), 0.0
                way = -room + np.sqrt(_dot(r, r))
                change = -(1.0 + np.float64(self.wall_restitution)) * along if along < 0 else self.real(0)
            self.v[i] += change * n
            self.p[i] += way * n
            self.rub(i, n, change, time)
        return True

    @staticmethod
    def from_segment(p: Any, a: Any, b: Any) -> tuple[Any, int | None]:
        """Offset from the nearest point of a segment, and which end that is: 0 is a, 1 is b; None is between them."""
        along = b - a
        part, squared = _dot(p - a, along), _dot(along, along)
        if part <= 0 or squared == 0:
            return p - a, 0
        if part >= squared:
            return p - b, 1
        return (p - a) - part / squared * along, None

    def away_from(self, r: Any, distance: Any, along: Any) -> Any:
        """Direction out of a segment; for a disc with its centre on it, across it."""
        if distance > 0:
            return r / distance
        length = np.sqrt(_dot(along, along))
        return np.array([-along[1] / length, along[0] / length]) if length > 0 else np.array([0.0, 1.0])

    def normal_at_touch(self, r: Any, v: Any, reach: Any, arms: Any) -> Any:
        """Direction from an end to where the disc, flying straight, touched it; if before this step, to where it is.

        If it was over one of the segments that end there, it touched that first: the direction is across it.
        """
        b, c = _dot(r, v), _dot(r, r) - reach * reach
        time = -c / (np.sqrt(b * b - _dot(v, v) * c) - b)
        n = r - v * (time if time <= self.dt else self.real(0))
        n = n / np.sqrt(_dot(n, n))
        for arm in arms:
            if _dot(n, arm) > 0:
                along = arm.astype(np.float64)
                left = np.array([-along[1], along[0]]) / np.sqrt(_dot(along, along))
                n = left if _dot(n, left) >= 0 else -left
        return n


def arms_of(capsules: np.ndarray, own: int, real: Any) -> list[Any]:
    """Vectors to the other ends of all segments that have the place and radius of an end, counting on from that one."""
    ends = [(*each[2 * side : 2 * side + 2], each[4]) for each in capsules for side in (0, 1)]
    others = [capsules[end // 2, 2 - 2 * (end % 2) :][:2] for end in range(len(ends))]
    here = capsules[own // 2, 2 * (own % 2) :][:2].astype(real)
    turned = [end % len(ends) for end in range(own, own + len(ends))]
    return [others[end].astype(real) - here for end in turned if ends[end] == ends[own]]


def friction_of(coefficient: float, sticking: float, real: Any) -> tuple[Any, Any] | None:
    """Coefficient and tangential change of a contact that sticks, per slip; None where contacts are smooth."""
    return (real(coefficient), real(sticking)) if coefficient > 0 else None


def limited(law: tuple[Any, Any], slip: Any, pressed: Any) -> Any:
    """Tangential change of velocity: that of a contact that sticks, but at most the coefficient times the normal's."""
    coefficient, sticking = law
    return min(max(sticking * slip, -(coefficient * pressed)), coefficient * pressed)


def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1]


# --- flights of discs that entered inside a frame, looked at step by step up to what they meet

LOOKS_PER_RADIUS, MOST_LOOKS = 4, 10_000  # places along a flight at which it is looked for what is in the way


def landing(
    scene: mpsim.Scene, emitter: mpsim.Emitter, capsules: Any, radius: float, elapsed: float, now: float
) -> tuple[Any, Any, Any]:
    """Place, velocity and periods of a disc that left an emitter some time ago, where its free flight has ended."""
    gravity = np.zeros(2) if scene.gravity is None else scene.gravity
    start, velocity = np.array(emitter.position), np.array(emitter.velocity)

    def place_at(time: float) -> Any:
        return start + time * (velocity + 0.5 * time * gravity)

    def meets(time: float) -> bool:
        return is_blocked(scene, capsules, radius, place_at(time), now)

    length = elapsed * (math.hypot(*velocity) + math.hypot(*gravity) * elapsed)
    looks = int(min(max(LOOKS_PER_RADIUS * length / radius, 1), MOST_LOOKS))
    times = np.linspace(0, elapsed, looks + 1)[1:]
    beyond = next((float(time) for time in times if meets(time)), None)
    flown = elapsed if beyond is None else last_free(meets, beyond - float(times[0]), beyond, elapsed)
    place, image = place_at(flown), np.zeros(2, np.int64)
    for axis, (size, word) in enumerate(zip((scene.width, scene.height), scene.boundary, strict=True)):
        if word == "periodic":
            end = place[axis]
            place[axis] %= size
            image[axis] = round((end - place[axis]) / size)
    return place, velocity + flown * gravity, image


def last_free(meets: Any, free: float, beyond: float, elapsed: float) -> float:
    """By halving: a time at which nothing is in the way, no more than a rounding before one at which something is."""
    while beyond - free > elapsed * np.finfo(float).eps:
        middle = 0.5 * (free + beyond)
        if not free < middle < beyond:
            break
        free, beyond = (free, middle) if meets(middle) else (middle, beyond)
    return free


def is_blocked(scene: mpsim.Scene, capsules: Any, radius: float, place: Any, now: float) -> bool:
    """Whether a disc would lie beyond a wall or the piston, or in an obstacle or an image of one."""
    size, steps, inside = (scene.width, scene.height), [], place.copy()
    for axis, length in enumerate(size):
        if scene.boundary[axis] == "periodic":
            inside[axis] %= length
            steps.append((0.0, length, -length))
            continue
        steps.append((0.0,))
        low, high = 0.0, length
        if scene.piston is not None and scene.piston.wall in (("left", "right"), ("bottom", "top"))[axis]:
            low, high = walls_by_piston(scene.piston, length, now)
        if not low + radius <= place[axis] <= high - radius:
            return True
    return any(
        radius > gap_to(inside - np.array(shift), capsule)
        for capsule, shift in itertools.product(capsules, itertools.product(*steps))
    )


def walls_by_piston(piston: mpsim.Piston, length: float, now: float) -> tuple[float, float]:
    """Lower and upper wall of the piston's axis."""
    upper = piston.wall in ("right", "top")
    start = piston.start if piston.start is not None else length if upper else 0.0
    place = start + piston.speed * now
    return (0.0, max(place, piston.stop)) if upper else (min(place, piston.stop), length)


def gap_to(place: Any, capsule: Any) -> float:
    """Distance from a place to the surface of a segment with a radius."""
    a, along = capsule[:2], capsule[2:4] - capsule[:2]
    r, squared = place - a, along[0] ** 2 + along[1] ** 2
    part = min(max((r[0] * along[0] + r[1] * along[1]) / squared, 0), 1) if squared > 0 else 0.0
    return float(np.hypot(*(r - part * along))) - capsule[4]
