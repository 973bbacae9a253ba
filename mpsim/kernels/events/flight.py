"""Free flight: where a disc is at a time, and when it reaches a place."""

import math

from mpsim.kernels.compiling import inlined

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

    The root of distance + speed t + acceleration t^2/2 = 0 in the form that does not cancel. A rounding-level negative
    distance counts as zero: a disc on the limit that moves towards it reaches it now.
    """
    ahead = max(distance, 0.0)
    discriminant = speed * speed - 2.0 * acceleration * ahead
    if speed < 0.0:
        return 2.0 * ahead / (math.sqrt(discriminant) - speed) if discriminant >= 0.0 else INFINITY
    return (speed + math.sqrt(discriminant)) / -acceleration if acceleration < 0.0 else INFINITY


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
