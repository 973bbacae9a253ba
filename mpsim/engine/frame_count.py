"""Number of frames until a given time, and in a run."""

import math

from mpsim.core import checks
from mpsim.errors import InputError

MOST_FRAMES_OF_A_RUN = 10**12


def frames_until(until: float, dt: float, name: str = "until") -> int:
    """Frames from the start to the first that reaches a time; one that ends within rounding of it does.

    >>> frames_until(2.1, 0.3), frames_until(2.2, 0.3)  # 2.1 / 0.3 is 7.000000000000001
    (7, 8)

    Raises:
        InputError: for more than MOST_FRAMES_OF_A_RUN.
    """
    frames = until / dt * (1 - 1e-12)
    if frames > MOST_FRAMES_OF_A_RUN:
        raise InputError(
            f"{name} must be at most {MOST_FRAMES_OF_A_RUN:,} frames of {dt:g}; got {until:g}. Give an earlier time."
        )
    return math.ceil(frames)


def frames_skipped(
    start: float | None, measures: object, frames: int, dt: float, frame: int, origin: tuple[int, float] = (0, 0.0)
) -> int:
    """How many frames at the beginning of a run of so many are not measured.

    Args:
        start, measures: as `Simulation.run` was given them.
        frames: of the run.
        dt, frame, origin: as of `frames_wanted`.

    Raises:
        InputError: without measures, for a start out of range, and for one that leaves no frame to measure.
    """
    if start is None:
        return 0
    start = checks.non_negative("start", start, "[time]")
    if not measures:
        raise InputError(
            f"start needs measures, which are taken from then on; got start={start:g} and none. Name them."
        )
    skipped = max(origin[0] + frames_until(start - origin[1], dt, "start") - frame, 0)
    if skipped and skipped >= frames:
        end = origin[1] + (frame + frames - origin[0]) * dt
        raise InputError(f"start must lie before the end of the run, at time {end:g}; got {start:g}. Run longer.")
    return skipped


def frames_wanted(
    frames: int | None,
    until: float | None,
    dt: float,
    frame: int,
    time: float,
    origin: tuple[int, float] = (0, 0.0),
) -> int:
    """How many frames a run is to have.

    Args:
        frames, until: as `Simulation.run` was given them.
        dt: of a frame [time].
        frame, time: where the simulation stands.
        origin: the frame and the time since which dt is that of a frame.

    Raises:
        InputError: both or neither, or one out of range.
    """
    if (frames is None) == (until is None):
        raise InputError(f"run needs either frames or until; got frames={frames!r}, until={until!r}.")
    if frames is not None:
        return checks.whole("frames", frames, 0, MOST_FRAMES_OF_A_RUN, "Ask for 0 or more frames.")
    until = checks.non_negative("until", until, "[time]")
    if until < time:
        raise InputError(f"until must not lie in the past: the time is {time:g}; got {until!r}.")
    return max(origin[0] + frames_until(until - origin[1], dt) - frame, 0)
