"""Runs that write trajectories."""

from pathlib import Path

import mpsim
from support.scenes import ZOO, simulate, zoo

SETTINGS = {"dt": 0.02, "method": "grid"}


def written(path: Path, scene: mpsim.Scene, frames: int = 10, every: int = 2, mode: str = "x", **settings) -> str:
    """Run a scene and write a trajectory of it; returns the digest of the last state."""
    with simulate(scene, **{**SETTINGS, **settings}) as sim, mpsim.Trajectory.write(path, every, mode=mode) as out:
        sim.run(frames=frames, observe=out)
        return sim.digest()


def killed_and_resumed(path: Path, scene: mpsim.Scene, every: int = 3, **settings) -> None:
    """A run of 20 frames, saved at frame 10 and killed at frame 14, of which the file holds more than is saved."""
    saved = path.with_suffix(".mpsim")
    with simulate(scene, **{**SETTINGS, **settings}) as sim, mpsim.Trajectory.write(path, every) as out:
        sim.run(frames=10, observe=out)
        sim.save(saved)
        sim.run(frames=4, observe=out)
    with mpsim.Simulation.resume(saved) as sim, mpsim.Trajectory.write(path, every, mode="a") as out:
        sim.run(frames=10, observe=out)


def content(path: Path) -> list:
    """All that a trajectory holds, to be compared; the number of each frame comes first."""
    numbers, arrays = ("frame", "time", "box", "origin", "periodic"), ("ids", "radius", "mass")
    with mpsim.Trajectory(path) as trajectory:
        return [
            [*(getattr(f, name) for name in numbers), *(getattr(f, name).tolist() for name in arrays), f.state.digest()]
            for f in trajectory
        ]


ENDINGS = ["xyz", "gsd"]
PLACES, SPEEDS = [[3, 3], [7, 7]], [[1, 0], [0, 1]]


def pair(width=10.0, position=PLACES, velocity=SPEEDS, radius=0.5, **features):
    """Two discs behind walls, or what differs from that."""
    return mpsim.Scene(width=width, height=10, position=position, velocity=velocity, radius=radius, **features)


DT = 0.02


def grown():
    """Discs of several sizes and masses enter, and leave: at first more, then fewer, at last none of the first ones."""
    emitter = mpsim.Emitter((1.0, 3.0), (9.0, 0.5), every=3, limit=25, radius=0.21, mass=0.7)
    return mpsim.Scene(
        width=9, height=6, position=[[4, 3], [7, 4.5]], velocity=[[4, 0.5], [3, -1]], radius=[0.5, 0.3],
        mass=[5.0, 3.3], absorbing=["right"], emitters=[emitter],
    )  # fmt: skip


SCENES = {
    "periodic": lambda: zoo("periodic radii masses", 12),
    "right piston": lambda: zoo("radii masses", 12, piston=mpsim.Piston("right", -4.0, 6.0)),
    "left piston": lambda: zoo("radii masses", 12, piston=mpsim.Piston("left", 3.3, 2.2)),
    "grown": grown,
    "everything": lambda: zoo(ZOO["everything"], count=10),
}
