"""What a disc of the slow twin meets alone besides walls at rest: textbook roots of polynomials, all of them."""

import math

import numpy as np

NOW = 1e-11
"""Roots this close to zero are those of an event that has just been."""


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
