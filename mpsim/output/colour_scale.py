"""Colour scales from the numbers in a picture, with arrows for values outside."""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.engine.simulation import Simulation
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

PERCENTILES = (2.0, 98.0)
"""Percentiles of the values at the two ends of the scale."""

SAMPLE = 5_000
"""Discs of one picture that enter the scale of a run at most."""

SPEED = "speed [length/time]"
"""Words of a colour bar."""

SCALES = ("linear", "log")

ScaleName = Literal["linear", "log"]


class ColourScale(NamedTuple):
    """Ends of a colour bar; outside: where values lie beyond them, as in matplotlib; log: whether it is logarithmic."""

    low: float
    high: float
    outside: Literal["neither", "both", "min", "max"] = "neither"
    log: bool = False


def percentile_scale(values: ArrayLike, kind: ScaleName = "linear") -> ColourScale:
    """The scale from the 2nd to the 98th percentile of values, of any shape; NaN is left out.

    Its ends are two of the values; for 50 values or fewer, the least and the greatest.

    If these percentiles are equal, it spans all values; if all values are equal, it begins or ends at 0. The ends of a
    logarithmic scale come from the values > 0; if these are fewer than two different ones, the scale is linear.

    >>> percentile_scale([*range(101)])
    ColourScale(low=2.0, high=98.0, outside='both', log=False)
    >>> percentile_scale([3.0, 3.0])
    ColourScale(low=0.0, high=3.0, outside='neither', log=False)
    >>> percentile_scale([0.0, 0.1, 10.0], "log")
    ColourScale(low=0.1, high=10.0, outside='min', log=True)
    """
    found = np.asarray(values, np.float64).ravel()
    found = found[np.isfinite(found)]
    if kind == "log" and len(np.unique(found[found > 0])) > 1:
        scale = percentile_scale(found[found > 0])
        below = scale.outside in ("both", "min") or float(found.min()) <= 0
        above = scale.outside in ("both", "max")
        return ColourScale(scale.low, scale.high, _outside(below, above), log=True)
    if not len(found):
        return ColourScale(0.0, 1.0)
    least, most = float(found.min()), float(found.max())
    low, high = (
        float(np.percentile(found, each, method=method))
        for each, method in zip(PERCENTILES, ("lower", "higher"), strict=True)
    )
    if low == high:
        low, high = least, most
    if low == high:
        low, high = min(low, 0.0), max(high, 0.0)
    high = high if high > low else 1.0
    return ColourScale(low, high, _outside(least < low, most > high))


def _outside(below: bool, above: bool) -> Literal["neither", "both", "min", "max"]:
    return "both" if below and above else "min" if below else "max" if above else "neither"


def speeds_of(velocity: NDArray[np.floating]) -> NDArray[np.float64]:
    """Speeds from velocities of shape (N, 2), in float64, shape (N,) [length/time]."""
    return np.hypot(*velocity.astype(np.float64).T)


def sampled(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """At most SAMPLE of the values of one picture, evenly spread, for the scale of many pictures."""
    return values[:: max(-(-len(values) // SAMPLE), 1)]


def scale_of_run(
    scene: Scene, settings: Settings, pictures: int, every: int, kind: ScaleName = "linear"
) -> ColourScale:
    """The scale of the speeds of all pictures of an animation: the run is simulated once for it.

    Args:
        scene, settings: what is simulated and how.
        pictures: number of pictures, >= 1; the first shows the start.
        every: frames from one picture to the next, >= 1.
        kind: "linear" or "log".
    """
    found: list[NDArray[np.floating]] = []
    with Simulation(scene, settings) as sim:
        for number in range(pictures):
            if number:
                sim.run(frames=every)
            state = sim.state
            found.append(sampled(speeds_of(state.velocity[state.present])))
    return percentile_scale(np.concatenate(found), kind)
