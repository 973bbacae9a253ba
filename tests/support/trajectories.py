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
        warnings.simplefilter("ignore", mpsim.FastWarning)
        sim.run(frames=frames, observe=out)
        return sim.digest()


def killed_and_resumed(path: Path, scene: mpsim.Scene, every: int = 3, **settings) -> None:
    """A run of 40 frames, saved at frame 20 and killed at frame 25, of which the file holds more than is saved."""
    saved = path.with_suffix(".mpsim")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.EmitterWarning)
        warnings.simplefilter("ignore", mpsim.FastWarning)
        with simulate(scene, **{**SETTINGS, **settings}) as sim, mpsim.Trajectory.write(path, every) as out:
            sim.run(frames=20, observe=out)
            sim.save(saved)
            sim.run(frames=5, observe=out)
        with mpsim.Simulation.resume(saved) as sim, mpsim.Trajectory.write(path, every, mode="a") as out:
            sim.run(frames=20, observe=out)


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
