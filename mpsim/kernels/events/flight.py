"""Free flight in the exact solver: where a disc is at a time, and when it reaches a place."""

import math

from mpsim.kernels.compiling import inlined, linked

# --- Free flight: where a disc is at a time, and when it reaches a place

INFINITY = math.inf


@inlined
def state_at(disc, now, gravity):
    """Position [length] and velocity [length/time] of a disc, from its stored state, at time `now`: (x, y, vx, vy)."""
    flight = now - disc.last_update
    vx = disc.velocity[0]
    vy = disc.velocity[1]
    if gravity is None:
        return disc.position[0] + vx * flight, disc.position[1] + vy * flight, vx, vy
    gain_x = gravity[0] * flight
    gain_y = gravity[1] * flight
    x = disc.position[0] + flight * (vx + 0.5 * gain_x)
    y = disc.position[1] + flight * (vy + 0.5 * gain_y)
    return x, y, vx + gain_x, vy + gain_y


@inlined
def advance_to(disc, now, gravity):
    """Bring the stored state of a disc to time `now`."""
    x, y, vx, vy = state_at(disc, now, gravity)
    disc.position[0] = x
    disc.position[1] = y
    disc.velocity[0] = vx
    disc.velocity[1] = vy
    disc.last_update = now


@inlined
def is_finite(disc):
    """Whether the stored state of a disc holds neither a NaN nor an infinity."""
    total = disc.position[0] + disc.position[1] + disc.velocity[0] + disc.velocity[1] + disc.last_update
    return total - total == 0.0


@inlined
def time_to_limit(distance, speed, acceleration):
    """Time until a limit `distance` ahead is reached [time]; `speed` and `acceleration` positive away from it.

    A rounding-level negative distance counts as zero: a disc on the limit that moves towards it reaches it now.
    """
    return time_to_come_down(max(distance, 0.0), speed, acceleration)


@inlined
def time_to_leave(low, high, place, speed, gravity, axis):
    """Time until a centre between two limits along an axis reaches one: (time, 0 low or 1 high)."""
    if gravity is None:
        # Only one of the two limits lies ahead.
        ahead = high - place if speed > 0.0 else place - low
        return (max(ahead, 0.0) / abs(speed) if speed != 0.0 else INFINITY), (1 if speed > 0.0 else 0)
    down = time_to_limit(place - low, speed, gravity[axis])
    up = time_to_limit(high - place, -speed, -gravity[axis])
    return (up, 1) if up < down else (down, 0)


@inlined
def approach_of(rx, ry, ux, uy, contact):
    """The relative motion of two discs: (b, gap, D), as `will_touch` and `time_of` need it.

    r, u: relative position and velocity; contact: sum of the radii. b = r.u, gap = r^2 - contact^2, and
    D = b^2 - u^2 gap, from |r + u t| = contact.
    """
    b = rx * ux + ry * uy
    gap = rx * rx + ry * ry - contact * contact
    return b, gap, b * b - (ux * ux + uy * uy) * gap


@inlined
def will_touch(b, discriminant):
    """Whether two discs meet: only an approaching pair does."""
    return (b < 0.0) & (discriminant >= 0.0)


@inlined
def time_of(b, gap, discriminant):
    """Time until two discs that will touch do so [time]: gap/(-b + sqrt D); a pair that already overlaps touches now.

    The other form of the root cancels for slow and grazing approaches.
    """
    return max(gap, 0.0) / (math.sqrt(discriminant) - b)


@inlined
def time_to_impact(rx, ry, ux, uy, contact):
    """Time until two discs touch [time], infinity if they never do: as `approach_of`."""
    b, gap, discriminant = approach_of(rx, ry, ux, uy, contact)
    return time_of(b, gap, discriminant) if will_touch(b, discriminant) else INFINITY


# --- When a point on a parabola reaches a line or a circle: for a disc under gravity and a wall that is not level
#
# A line leads to a quadratic equation, a circle to a quartic. Closed forms of a quartic lose their digits where roots
# lie close together, that is, at a grazing contact. So time is divided at the extrema of the distance, the roots of a
# cubic, which is divided at the extrema of its own; each interval has one root at most, and bisection cannot miss it.

MOST_HALVINGS = 200
"""Steps of a search at most: Newton's are some five, bisection's alone some 60, and more for a root next to zero."""


@inlined
def time_to_come_down(height, speed, acceleration):
    """Time until a height above a line falls to 0 [time]; speed and acceleration upward. From below, it rises first.

    The root of height + speed t + acceleration t^2/2 = 0 at which it falls, of which there is one at most after now, in
    the form that does not cancel.
    """
    discriminant = speed * speed - 2.0 * acceleration * height
    if discriminant < 0.0:
        return INFINITY
    if speed < 0.0:
        return 2.0 * height / (math.sqrt(discriminant) - speed) if height >= 0.0 else INFINITY
    return (speed + math.sqrt(discriminant)) / -acceleration if acceleration < 0.0 else INFINITY


# --- a circle round the origin ------------------------------------------------------------------------------------


@inlined
def excess(t, rx, ry, vx, vy, gx, gy, contact):
    """Half of |.|^2 - contact^2 of the point r + v t + g t^2/2, and its first and second derivative.

    With the other sign, as seen from inside the circle, for a contact < 0.
    """
    px, py = rx + t * (vx + 0.5 * t * gx), ry + t * (vy + 0.5 * t * gy)
    ux, uy = vx + t * gx, vy + t * gy
    distance, side = math.sqrt(px * px + py * py), math.copysign(1.0, contact)
    return (
        side * (0.5 * (distance - contact) * (distance + contact)),
        side * (px * ux + py * uy),
        side * (ux * ux + uy * uy + px * gx + py * gy),
    )


@linked
def sign_change(derivative, low, high, rx, ry, vx, vy, gx, gy, contact):
    """Where `excess` (derivative = 0), or its first derivative (1), changes sign between two times of opposite sign.

    Newton's steps; a bisection replaces each one that would leave the bracket or has not halved it.
    """
    start, approach, _ = excess(low, rx, ry, vx, vy, gx, gy, contact)
    falls = (start if derivative == 0 else approach) > 0.0
    t = 0.5 * (low + high)
    for _ in range(MOST_HALVINGS):
        width = high - low
        value, first, second = excess(t, rx, ry, vx, vy, gx, gy, contact)
        slope = first
        if derivative == 1:
            value, slope = first, second
        if value == 0.0:
            return t
        if (value > 0.0) == falls:
            low = t
        else:
            high = t
        step = value / slope if slope != 0.0 else INFINITY
        following = t - step
        if not (low < following < high) or high - low > 0.5 * width + abs(step):
            following = 0.5 * (low + high)
        if not (low < following < high) or following == t:
            break
        t = following
    return t


@inlined
def bends(rx, ry, vx, vy, gx, gy):
    """Times at which the first derivative of `excess` is extremal: (earlier, later); infinity if there are none."""
    gravity = gx * gx + gy * gy
    along = vx * gx + vy * gy
    discriminant = along * along - gravity * (vx * vx + vy * vy + rx * gx + ry * gy) * 2.0 / 3.0
    if gravity == 0.0 or discriminant < 0.0:
        return INFINITY, INFINITY
    root = math.sqrt(discriminant)
    return (-along - root) / gravity, (-along + root) / gravity


@linked
def time_to_circle(rx, ry, vx, vy, gx, gy, contact, ax, ay, within):
    """Time until a point on a parabola enters a circle round the origin, `within` at most, else infinity [time].

    r, v, g: place, velocity, acceleration. contact: radius of the circle [length]. a: only the part of the
    circle counts that does not lie ahead in this direction; (0, 0): all. A point that is inside by rounding enters when
    it begins to approach. For a contact < 0 it leaves the circle of that radius from inside.
    """
    slack = 1e-9 * contact * math.sqrt(ax * ax + ay * ay)
    first_bend, second_bend = bends(rx, ry, vx, vy, gx, gy)
    low = 0.0
    for _ in range(3):
        high = within
        if low < first_bend < within:
            high = first_bend
        elif low < second_bend < within:
            high = second_bend
        # Between two bends, the point changes at most once from receding to approaching, or back.
        _, before, _ = excess(low, rx, ry, vx, vy, gx, gy, contact)
        _, after, _ = excess(high, rx, ry, vx, vy, gx, gy, contact)
        start, end = low, low
        if before > 0.0 and after < 0.0:
            start, end = sign_change(1, low, high, rx, ry, vx, vy, gx, gy, contact), high
        elif before < 0.0 and after > 0.0:
            end = sign_change(1, low, high, rx, ry, vx, vy, gx, gy, contact)
        elif before + after < 0.0:
            end = high
        if end > start:
            at_start, _, _ = excess(start, rx, ry, vx, vy, gx, gy, contact)
            at_end, _, _ = excess(end, rx, ry, vx, vy, gx, gy, contact)
            if at_end < 0.0:
                t = start
                if at_start > 0.0:
                    t = sign_change(0, start, end, rx, ry, vx, vy, gx, gy, contact)
                px, py = rx + t * (vx + 0.5 * t * gx), ry + t * (vy + 0.5 * t * gy)
                if px * ax + py * ay <= slack:
                    return t
        if high == within:
            break
        low = high
    return INFINITY
