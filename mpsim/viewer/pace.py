"""Decides how many frames to run before the next picture, for a given speed and quick responses."""

import math

UNIT = 60.0
"""Frames a second at speed 1: one for each picture of a usual screen."""

LOOK = 1 / 60
"""Shortest time between two observations of a run [s]. Each interrupts the run, which costs 0.3 ms."""

TURN = 3 * LOOK
"""Longest time for which frames are run at once [s]; an action waits at most so long. To start and end a run takes
0.3 ms."""

MOST_BEHIND = 0.1
"""Largest delay that a simulation catches up [s]. After a longer stop, the missed frames are dropped."""

MOST_FRAMES = 10_000
"""Largest number of frames to run at once, however short they are."""

SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
"""Speeds that the page offers, as in its link.js."""

PICTURES = 25
"""Recommended pictures of a scene that are shown per second."""


def first_speed(every: int | None) -> float:
    """The speed at which a scene is first shown: one that the page offers, in units of UNIT frames a second.

    Args:
        every: frames between two recommended pictures of the scene; None: it recommends none.

    >>> first_speed(None), first_speed(10)
    (1.0, 2.0)
    """
    wanted = 1.0 if every is None else every * PICTURES / UNIT
    return float(max((speed for speed in SPEEDS if speed <= wanted), default=SPEEDS[0]))


class Pace:
    """Decides which frames are due. All times are from one clock [s].

    Attributes:
        speed: in units of UNIT frames a second; None: as fast as possible.
        look: time between two observations of a run, from LOOK to TURN [s].

    >>> pace = Pace(speed=1.0)
    >>> pace.start(now=10.0)
    >>> pace.due(now=10.0), pace.due(now=10.001), round(pace.wait(now=10.001), 4)
    (1, 0, 0.0157)
    """

    def __init__(self, speed: float | None = 1.0):
        self.speed: float | None = speed
        self.look: float = LOOK
        self._next = 0.0
        self._seconds_per_frame: float | None = None

    def start(self, now: float) -> None:
        """Start at this moment; the first frame is due at once."""
        self._next = now

    def due(self, now: float) -> int:
        """Number of frames to run now, at most as many as fit into TURN. They then no longer count as due."""
        if self.speed is None:
            looks = self.frames_between_looks
            return max(self._fitting(TURN) // looks, 1) * looks
        rate = self.speed * UNIT
        self._next = max(self._next, now - MOST_BEHIND)
        if now < self._next:
            return 0
        frames = min(int((now - self._next) * rate) + 1, self._fitting(TURN))
        self._next += frames / rate
        return frames

    def wait(self, now: float) -> float:
        """Time until the next frame is due [s]."""
        return 0.0 if self.speed is None else max(self._next - now, 0.0)

    @property
    def frames_between_looks(self) -> int:
        """Number of frames that fit into `look`, at least one.

        It is a power of two, so that it stays the same although the time of a frame varies a little.
        """
        return 1 << (self._fitting(self.look).bit_length() - 1)

    def note(self, frames: int, seconds: float) -> None:
        """Note how long some frames took [s]."""
        self._seconds_per_frame = max(seconds / frames, 1e-9)

    def _fitting(self, seconds: float) -> int:
        """Number of frames that take so long; one if the time of a frame is not known yet."""
        if self._seconds_per_frame is None:
            return 1
        return min(max(int(seconds / self._seconds_per_frame), 1), MOST_FRAMES)


class Allowance:
    """Limits the fraction of a core that repeated work takes, by a pause after each use. Times are from one clock [s].

    Args:
        at_least: shortest time between two uses [s].

    >>> allowance = Allowance(at_least=0.01)
    >>> allowance.use(now=10.0, cost=0.001)
    >>> allowance.charge(0.002)
    >>> [round(allowance.wait(10.0, share, at_most=0.5), 3) for share in (0.001, 0.02, 0.5)]
    [0.5, 0.15, 0.01]
    """

    def __init__(self, at_least: float):
        self._at_least = at_least
        self._last = -math.inf
        self._cost = 0.0

    def use(self, now: float, cost: float) -> None:
        """Note a use at this moment; cost: processor time that it took [s]."""
        self._last, self._cost = now, cost

    def charge(self, cost: float) -> None:
        """Add processor time to the cost of the last use [s]."""
        self._cost += cost

    def wait(self, now: float, share: float, at_most: float) -> float:
        """Time until the next use [s], so that the uses take at most this fraction of a core; 0: now.

        at_most: longest time between two uses [s], whatever they cost.
        """
        pause = min(max(self._cost / share, self._at_least), at_most)
        return max(self._last + pause - now, 0.0)
