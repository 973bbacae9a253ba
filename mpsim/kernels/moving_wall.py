"""Place and velocity of a wall that moves, as functions of the time since it began: for both solvers and for Python.

A wall has the fields start, stop [length], speed [length/time] and arrival, the time at which it comes to rest [time],
all in float64.
"""

from mpsim.kernels.compiling import inlined


@inlined
def place(wall, time):
    """Coordinate of a wall [length]."""
    if time >= wall.arrival:
        return wall.stop
    moved = wall.start + wall.speed * time
    return max(moved, wall.stop) if wall.speed < 0.0 else min(moved, wall.stop)


@inlined
def velocity(wall, time):
    """Velocity of a wall along its axis [length/time]."""
    return wall.speed if time < wall.arrival else 0.0
