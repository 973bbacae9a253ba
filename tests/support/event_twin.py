"""A slow, obvious twin of the exact solver: plain Python, no cells, no calendar, no lazy positions.

Before every event it solves all pairs, all images and all walls anew, then moves every disc. It shares no line with
the solver. Roots are the textbook ones, all of them.
"""

import itertools
import math

import numpy as np

import mpsim

NOW = 1e-11  # roots this close to zero are those of an event that has just been


def real_roots(*coefficients):
    """Real roots of a polynomial, highest power first, each polished until it no longer changes."""
    if len(coefficients) == 3:
        return quadratic_roots(*coefficients)
    found = []
    for root in np.roots(coefficients):
        if abs(root.imag) < 1e-6 * (1.0 + abs(root.real)):
            t = float(root.real)
            for _ in range(50):
                slope = np.polyval(np.polyder(coefficients), t)
                following = t - np.polyval(coefficients, t) / slope if slope else t
                if following == t:
                    break
                t = following
            found.append(t)
    return found


def quadratic_roots(a, b, c):
    """Real roots of a t^2 + b t + c."""
    if a == 0.0:
        return [-c / b] if b else []
    if b * b < 4 * a * c:
        return []
    sum_of_both = -(b + math.copysign(math.sqrt(b * b - 4 * a * c), b)) / 2
    return [sum_of_both / a, c / sum_of_both] if sum_of_both else [0.0]


def place_at(x, v, g, t):
    return [x[k] + v[k] * t + 0.5 * g[k] * t * t for k in (0, 1)]


def nearest(point, capsule):
    """The point of a segment (ax, ay, bx, by, radius) that is nearest to a point."""
    a, along = capsule[:2], [capsule[2] - capsule[0], capsule[3] - capsule[1]]
    squared = along[0] ** 2 + along[1] ** 2
    part = sum((point[k] - a[k]) * along[k] for k in (0, 1)) / squared if squared else 0.0
    part = min(max(part, 0.0), 1.0)
    return [a[k] + part * along[k] for k in (0, 1)]


def gap(point, capsule, radius):
    """Distance from the surface of a disc to that of a capsule."""
    return math.dist(point, nearest(point, capsule)) - radius - capsule[4]


def capsule_time(x, v, g, radius, capsule):
    """Time until a disc touches a capsule: of all roots of its sides and ends the first at which it comes nearer."""
    reach = radius + capsule[4]
    along = [capsule[2] - capsule[0], capsule[3] - capsule[1]]
    length = math.hypot(*along)
    times = []
    if length:
        normal = [-along[1] / length, along[0] / length]
        h, w, p = (sum(each[k] * normal[k] for k in (0, 1)) for each in ([x[0] - capsule[0], x[1] - capsule[1]], v, g))
        for side in (reach, -reach):
            times += real_roots(0.5 * p, w, h - side)
    for end in (capsule[:2], capsule[2:4]):
        r = [x[k] - end[k] for k in (0, 1)]
        dot = lambda a, b: a[0] * b[0] + a[1] * b[1]  # noqa: E731
        bend = [0.25 * dot(g, g), dot(v, g)] if any(g) else []
        times += real_roots(*bend, dot(v, v) + dot(r, g), 2 * dot(r, v), dot(r, r) - reach * reach)
    good = []
    for t in times:
        if t > NOW:
            point = place_at(x, v, g, t)
            there = nearest(point, capsule)
            n, u = [point[k] - there[k] for k in (0, 1)], [v[k] + g[k] * t for k in (0, 1)]
            touches = abs(gap(point, capsule, radius)) < 1e-7 * reach
            if touches and n[0] * u[0] + n[1] * u[1] < 0.0:
                good.append(t)
    return min(good, default=math.inf)


def wall_at(wall, time):
    """Coordinate and velocity of a wall (edge, start, stop, speed) that moves until it stops."""
    _, start, stop, speed = wall
    arrival = (stop - start) / speed
    return (start + speed * time, speed) if time < arrival else (stop, 0.0)


def moving_wall_time(x, v, g, radius, wall, now):
    """Time until a disc meets the moving wall: the first root at which it comes nearer, of two parts of the motion."""
    edge, start, stop, speed = wall
    axis, sign = edge // 2, (-1.0 if edge % 2 else 1.0)
    arrival = (stop - start) / speed - now
    good = []
    for place, moving, begins, ends in (
        (start + speed * now, speed, NOW, arrival),
        (stop, 0.0, max(arrival, NOW), math.inf),
    ):
        for t in real_roots(0.5 * sign * g[axis], sign * (v[axis] - moving), sign * (x[axis] - place) - radius):
            if begins < t <= ends and sign * (v[axis] + g[axis] * t - moving) < 0.0:
                good.append(t)
    return min(good, default=math.inf)


EDGES = ("left", "right", "bottom", "top")


def rows_of(obstacle):
    """Capsules of an obstacle: (ax, ay, bx, by, radius)."""
    if isinstance(obstacle, mpsim.FixedDisc):
        return [(*obstacle.position, *obstacle.position, obstacle.radius)]
    points = [tuple(point) for point in obstacle.points]
    return [(*a, *b, obstacle.thickness / 2) for a, b in itertools.pairwise(points)]


class Twin:
    """Hard discs as lists of floats. Fields as in a scene; `contact_time` is the guard.

    friction, wall_friction: (coefficient, tangential restitution). capsules: rows (ax, ay, bx, by, radius).
    moving_wall: (edge, start, stop, speed). absorbing: numbers of edges: left, right, bottom, top.
    images: between two events a pair may fly past this many boxes.
    """

    def __init__(self, scene, contact_time, images=2):
        count = scene.count
        self.x, self.v = scene.position.tolist(), scene.velocity.tolist()
        self.radius, self.mass = scene.radii.tolist(), scene.masses.tolist()
        self.size, self.periodic, self.images = (scene.width, scene.height), scene.periodic, images
        self.gravity = (0.0, 0.0) if scene.gravity is None else tuple(scene.gravity)
        self.restitution, self.wall_restitution = scene.restitution, scene.wall_restitution
        self.friction = scene.friction, scene.tangential_restitution
        self.wall_friction = scene.wall_friction, scene.tangential_restitution
        self.spin = [0.0] * count if scene.spin is None else scene.spin.tolist()
        self.capsules = [[float(a) for a in row] for each in scene.obstacles for row in rows_of(each)]
        self.absorbing, self.gone = [EDGES.index(edge) for edge in scene.absorbing], set()
        self.moving_wall, piston = None, scene.piston
        if piston is not None:
            edge = EDGES.index(piston.wall)
            start = scene.box[edge] if piston.start is None else piston.start
            self.moving_wall = edge, start, piston.stop, piston.speed
        self.contact_time, self.time, self.guards = contact_time, 0.0, 0
        self.last = [-math.inf] * count

    def pair_time(self, i, j, shift):
        """Time until i and the image of j displaced by `shift` touch."""
        r = [self.x[j][k] + shift[k] - self.x[i][k] for k in (0, 1)]
        u = [self.v[j][k] - self.v[i][k] for k in (0, 1)]
        a = u[0] ** 2 + u[1] ** 2
        b = r[0] * u[0] + r[1] * u[1]
        c = r[0] ** 2 + r[1] ** 2 - (self.radius[i] + self.radius[j]) ** 2
        if b >= 0.0:
            return math.inf
        if c <= 0.0:
            return 0.0
        return (-b - math.sqrt(b * b - a * c)) / a if b * b > a * c else math.inf

    def wall_time(self, i, axis, high):
        """Time until disc i touches one wall: the first positive root at which it moves towards the wall."""
        sign = 1.0 if high else -1.0
        limit = self.size[axis] - self.radius[i] if high else self.radius[i]
        gap = max(sign * (limit - self.x[i][axis]), 0.0)
        speed, pull = sign * self.v[i][axis], sign * self.gravity[axis]
        if pull == 0.0:
            return gap / speed if speed > 0.0 else math.inf
        if speed * speed + 2.0 * pull * gap < 0.0:
            return math.inf
        root = math.sqrt(speed * speed + 2.0 * pull * gap)
        times = [(-speed + root) / pull, (-speed - root) / pull]
        good = [t for t in times if t > 1e-12 and speed + pull * t > 0.0]
        if gap < 1e-13 and speed > 0.0:
            good.append(0.0)
        return min(good, default=math.inf)

    def next_event(self):
        """(time from now, kind, i, j or (axis, high), shift) of the earliest event."""
        here = [i for i in range(len(self.x)) if i not in self.gone]
        near = range(-self.images, self.images + 1)
        along = [[image * self.size[k] for image in (near if self.periodic[k] else (0,))] for k in (0, 1)]
        shifts = list(itertools.product(*along))
        moving = self.moving_wall[0] if self.moving_wall else None
        events = [
            (self.pair_time(i, j, shift), "pair", i, j, shift)
            for i, j in itertools.combinations(here, 2)
            for shift in shifts
        ]
        events += [
            (self.wall_time(i, axis, high), "wall", i, (axis, high), None)
            for i, axis, high in itertools.product(here, (0, 1), (0, 1))
            if not self.periodic[axis] and 2 * axis + high != moving
        ]
        events += [
            (capsule_time(self.x[i], self.v[i], self.gravity, self.radius[i], moved), "capsule", i, moved, None)
            for i, (ax, ay, bx, by, radius), (a, b) in itertools.product(here, self.capsules, shifts)
            for moved in [[ax + a, ay + b, bx + a, by + b, radius]]
        ]
        if self.moving_wall:
            flights = [(i, self.x[i], self.v[i], self.gravity, self.radius[i]) for i in here]
            wall = self.moving_wall, self.time
            events += [(moving_wall_time(*flight, *wall), "moving wall", i, None, None) for i, *flight in flights]
        return min(events, key=lambda event: event[0], default=(math.inf, "nothing", -1, None, None))

    def fly(self, t):
        """Move every disc by the time t."""
        for i, (x, v) in enumerate(zip(self.x, self.v, strict=True)):
            for k in (0, 1) if i not in self.gone else ():
                x[k] += v[k] * t + 0.5 * self.gravity[k] * t * t
                v[k] += self.gravity[k] * t
                if self.periodic[k]:
                    x[k] %= self.size[k]
        self.time += t

    def kept(self, restitution, discs):
        """Restitution after the guard."""
        if restitution < 1.0 and any(self.time - self.last[i] < self.contact_time for i in discs):
            self.guards += 1
            return 1.0
        return restitution

    def step(self, event=None):
        """One event: the next one, if it is not given."""
        t, kind, i, j, shift = event or self.next_event()
        if kind == "pair":
            self.collide(t, i, j, shift)
            return
        n, moving = [0.0, 0.0], 0.0
        if kind == "capsule":  # it lies where the disc is when they meet, a period further perhaps
            point = place_at(self.x[i], self.v[i], self.gravity, t)
            there = nearest(point, j)
            n = [(there[k] - point[k]) / math.dist(there, point) for k in (0, 1)]
        self.fly(t)
        if kind == "moving wall":
            axis, high = divmod(self.moving_wall[0], 2)
            n[axis] = 1.0 if high else -1.0
            moving = n[axis] * wall_at(self.moving_wall, self.time)[1]
        elif kind == "wall":
            axis, high = j
            if 2 * axis + high in self.absorbing:
                self.gone.add(i)
                self.v[i] = [0.0, 0.0]
                return
            n[axis] = 1.0 if high else -1.0
        self.bounce(i, n, moving)

    def collide(self, t, i, j, shift):
        """Disc i meets the image of disc j that was predicted. The fall is the same for both."""
        r = [self.x[j][k] + shift[k] - self.x[i][k] + (self.v[j][k] - self.v[i][k]) * t for k in (0, 1)]
        self.fly(t)
        distance = math.hypot(*r)
        n = [r[0] / distance, r[1] / distance]
        closing = sum((self.v[i][k] - self.v[j][k]) * n[k] for k in (0, 1))
        reduced = self.mass[i] * self.mass[j] / (self.mass[i] + self.mass[j])
        impulse = (1.0 + self.kept(self.restitution, [i, j])) * reduced * closing
        for k in (0, 1):
            self.v[i][k] -= impulse * n[k] / self.mass[i]
            self.v[j][k] += impulse * n[k] / self.mass[j]
        self.rub(self.friction, i, j, n, impulse)
        self.last[i] = self.last[j] = self.time

    def bounce(self, i, n, moving):
        """Disc i meets, in the direction n, what is as heavy as the world and moves so fast along it."""
        change = (1.0 + self.kept(self.wall_restitution, [i])) * (self.v[i][0] * n[0] + self.v[i][1] * n[1] - moving)
        for k in (0, 1):
            self.v[i][k] -= change * n[k]
        self.rub(self.wall_friction, i, None, n, change * self.mass[i])
        self.last[i] = self.time

    def rub(self, law, i, j, n, pressed):
        """Tangential impulse of disc i on disc j, or on a wall (None), in the direction n, at the points that touch.

        The surfaces slip at the velocity of the centres and the spins' there: v + spin x arm.
        """
        t = [-n[1], n[0]]
        slip = self.v[i][0] * t[0] + self.v[i][1] * t[1] + self.radius[i] * self.spin[i]
        inverse = 1.0 / self.mass[i]
        if j is not None:
            slip -= self.v[j][0] * t[0] + self.v[j][1] * t[1] - self.radius[j] * self.spin[j]
            inverse += 1.0 / self.mass[j]
        coefficient, restitution = law
        # An impulse along t changes the slip by 1 / m_eff through the centres, and by 2 / m_eff through the spins.
        turning = -(1.0 + restitution) * slip / (3.0 * inverse)
        impulse = max(-coefficient * pressed, min(coefficient * pressed, turning))
        for disc, sign in ((i, 1.0), (j, -1.0)):
            if disc is not None:
                for k in (0, 1):
                    self.v[disc][k] += sign * impulse * t[k] / self.mass[disc]
                inertia = 0.5 * self.mass[disc] * self.radius[disc] ** 2
                self.spin[disc] += self.radius[disc] * impulse / inertia
