"""Runs that write trajectories."""

import warnings
from pathlib import Path

import mpsim
from support.scenes import simulate

SETTINGS = {"dt": 0.02, "method": "grid"}


def written(path: Path, scene: mpsim.Scene, frames: int = 10, every: int = 2, mode: str = "x", **settings) -> str:
    """Run a scene and write a trajectory of it; returns the digest of the last state."""
    with (
        warnings.catch_warnings(),
        simulate(scene, **{**SETTINGS, **settings}) as sim,
        mpsim.Trajectory.write(path, every, mode=mode) as out,
    ):
        warnings.simplefilter("ignore", mpsim.EmitterWarning)
        sim.run(frames=frames, observe=out)
        return sim.digest()


def content(path: Path) -> list:
    """All that a trajectory holds, to be compared."""
    with mpsim.Trajectory(path) as trajectory:
        return [
            (
                f.frame,
                f.time,
                f.box,
                f.origin,
                f.periodic,
                f.ids.tolist(),
                f.radius.tolist(),
                f.mass.tolist(),
                f.state.digest(),
            )
            for f in trajectory
        ]
