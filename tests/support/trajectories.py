"""Runs that write trajectories."""

import warnings
from pathlib import Path

import numpy as np

import mpsim
from support.scenes import ZOO, simulate, zoo

SETTINGS = {"dt": 0.02, "method": "grid"}


def written(path: Path, scene: mpsim.Scene, frames: int = 10, every: int = 2, mode: str = "x", **settings) -> str:
    """Run a scene and write a trajectory of it; returns the digest of the last state."""
    with (
        warnings.catch_warnings(),
        simulate(scene, **{**SETTINGS, **settings}) as sim,
        mpsim.Trajectory.write(path, every, mode=mode) as out,
    ):
        warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)
        warnings.simplefilter("ignore", mpsim.FastWarning)
        sim.run(frames=frames, observe=out)
        return sim.digest()


def killed_and_resumed(path: Path, scene: mpsim.Scene, every: int = 3, **settings) -> None:
    """A run of 20 frames, saved at frame 10 and killed at frame 14, of which the file holds more than is saved."""
    saved = path.with_suffix(".mpsim")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)
        warnings.simplefilter("ignore", mpsim.FastWarning)
        with simulate(scene, **{**SETTINGS, **settings}) as sim, mpsim.Trajectory.write(path, every) as out:
            sim.run(frames=10, observe=out)
            sim.save(saved)
            sim.run(frames=4, observe=out)
        with mpsim.Simulation.resume(saved) as sim, mpsim.Trajectory.write(path, every, mode="a") as out:
            sim.run(frames=10, observe=out)


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


ENDINGS = ["xyz", "gsd"]
PLACES, SPEEDS = [[3, 3], [7, 7]], [[1, 0], [0, 1]]


def pair(width=10.0, position=PLACES, velocity=SPEEDS, radius=0.5, **features):
    """Two discs behind walls, or what differs from that."""
    return mpsim.Scene(width=width, height=10, position=position, velocity=velocity, radius=radius, **features)


DT = 0.02


def several(count, seed=0):
    """Radii and masses that are no default, and no power of two."""
    rng = np.random.default_rng(seed)
    return {"radius": rng.choice([0.2, 0.35, 0.5], count), "mass": rng.choice([0.3, 5.0, 7.7], count)}


def gas_of_several(boundary="walls", piston=None, count=12):
    rng = np.random.default_rng(3)
    place = np.stack(np.meshgrid(np.arange(4) * 1.4 + 4.1, np.arange(3) * 1.3 + 3.3), axis=-1).reshape(-1, 2)[:count]
    features = {"boundary": boundary, "piston": piston, **several(count)}
    return mpsim.Scene(width=13.0, height=9.5, position=place, velocity=3 * rng.normal(size=(count, 2)), **features)


def grown():
    """Discs of several sizes and masses enter, and leave: at first more, then fewer, at last none of the first ones."""
    emitter = mpsim.Emitter((1.0, 3.0), (9.0, 0.5), every=3, limit=25, radius=0.21, mass=0.7)
    return mpsim.Scene(
        width=9, height=6, position=[[4, 3], [7, 4.5]], velocity=[[4, 0.5], [3, -1]], radius=[0.5, 0.3],
        mass=[5.0, 3.3], absorbing=["right"], emitters=[emitter],
    )  # fmt: skip


SCENES = {
    "periodic": lambda: gas_of_several("periodic"),
    "right piston": lambda: gas_of_several(piston=mpsim.Piston("right", -4.0, 11.0)),
    "left piston": lambda: gas_of_several(piston=mpsim.Piston("left", 3.3, 2.2)),
    "grown": grown,
    "everything": lambda: zoo(ZOO["everything"], count=10),
}
