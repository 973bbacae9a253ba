"""The scale of colours of a picture: from the numbers it shows, with arrows for what lies outside."""

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


class ColourScale(NamedTuple):
    """Ends of a colour bar, and at which of them values lie outside, in matplotlib's words."""

    low: float
    high: float
    outside: Literal["neither", "both", "min", "max"] = "neither"


def scale_of(values: ArrayLike) -> ColourScale:
    """The scale from the 2nd to the 98th percentile of values, of any shape; NaN are left out.

    Where these percentiles are equal, it spans all values; where all values are equal, it begins at 0 or ends there.

    >>> scale_of([*range(101)])
    ColourScale(low=2.0, high=98.0, outside='both')
    >>> scale_of([3.0, 3.0])
    ColourScale(low=0.0, high=3.0, outside='neither')
    """
    found = np.asarray(values, np.float64).ravel()
    found = found[np.isfinite(found)]
    if not len(found):
        return ColourScale(0.0, 1.0)
    least, most = float(found.min()), float(found.max())
    low, high = (float(each) for each in np.percentile(found, PERCENTILES))
    if low == high:
        low, high = least, most
    if low == high:
        low, high = min(low, 0.0), max(high, 0.0)
    high = high if high > low else 1.0
    below, above = least < low, most > high
    outside = "both" if below and above else "min" if below else "max" if above else "neither"
    return ColourScale(low, high, outside)


def speeds_of(sim: Simulation) -> NDArray[np.float64]:
    """Speeds of the discs that have not been absorbed, shape (n,) [length/time]."""
    return np.hypot(*sim.state.velocity[~sim.absorbed].astype(np.float64).T)


def scale_of_run(scene: Scene, settings: Settings, pictures: int, every: int) -> ColourScale:
    """The scale of the speeds of all pictures of an animation: the run is simulated once for it.

    Args:
        scene, settings: what is simulated and how.
        pictures: number of pictures, >= 1; the first shows the start.
        every: frames from one picture to the next, >= 1.
    """
    kept: list[NDArray[np.float64]] = []
    with Simulation(scene, settings) as sim:
        for number in range(pictures):
            if number:
                sim.run(frames=every)
            speeds = speeds_of(sim)
            kept.append(speeds[:: max(-(-len(speeds) // SAMPLE), 1)])
    return scale_of(np.concatenate(kept))
