"""Files of every kind that mpsim writes and reads, of small scenes, kept so that later versions prove to read them.

python -m support.written FOLDER        write them anew; only where a format has changed on purpose
"""

import json
import shutil
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

import mpsim
from mpsim import Emitter, FixedDisc, Polyline, Scene, Settings
from mpsim.cli.app import main
from mpsim.core.state import digest_of
from mpsim.scene import scenefile
from support.goldens import FRAMES, SCENES

CHECKPOINTS = [
    ("bare", {"method": "naive", "contact": "push", "precision": "float32"}),
    ("bare", {"method": "parallel", "workers": 2}),
    ("sub-steps where fast", {"method": "grid"}),
    ("discs added", {"method": "grid"}),
    ("acceleration", {"method": "grid", "precision": "float32"}),
    ("giants", {"method": "grid"}),
    ("masses", {"method": "grid"}),
    ("periodic", {"method": "grid"}),
    ("fixed disc", {"method": "grid"}),
    ("polyline", {"method": "naive"}),
    ("emitter by time", {"method": "grid"}),
    ("emitter by frames", {"method": "grid"}),
    ("absorbing left", {"method": "grid"}),
    ("piston right", {"method": "grid"}),
    ("everything", {"method": "naive"}),
    ("everything", {"method": "grid", "contact": "push", "precision": "float32"}),
    ("everything", {"method": "parallel", "workers": 2}),
    ("bare", {"method": "event"}),
    ("periodic", {"method": "event"}),
    ("discs added", {"method": "event"}),
    ("everything exact", {"method": "event"}),
]
"""Scenes among the pinned ones, and how they are run: each is saved after half of its frames."""

EVERY = 6
TRAJECTORIES = ["everything.xyz", "everything.gsd", "bare.extxyz"]
TRADED = {"until": 2.0, "starts": "same", "replicas": 2}
CANDIDATE = Settings(dt=1 / 16, method="grid")


def words(name: str, how: dict[str, Any]) -> str:
    """The case of a checkpoint among the pinned digests, and its name."""
    contact, precision = how.get("contact", "impact"), how.get("precision", "float64")
    return "event" if how["method"] == "event" else f"{how['method']} {contact} {precision}"


def checkpoint_name(name: str, how: dict[str, Any]) -> str:
    return f"{name} {words(name, how)}.mpsim".replace(" ", "-").replace(",", "")


def large_scene() -> Scene:
    """So many discs, obstacles and emitters that each become arrays beside the scene file."""
    index = np.arange(70)
    position = np.stack([index % 10, index // 10], axis=1) + 1.0
    return Scene(
        width=12.0, height=12.0, position=position, velocity=(position - 5.0) / 8, radius=0.25 + index % 3 / 16,
        mass=1.0 + index % 4, gravity=(0.0, -1.0), duration=2.5,
        obstacles=[*(FixedDisc((x / 8 + 1.0, 9.0), 0.0625) for x in range(66)), Polyline([(1, 11.5), (2, 11)])],
        emitters=[Emitter((x / 8 + 1.0, 10.0), (0, 1), interval=1.0 + x, radius=0.25, mass=1.0) for x in range(66)],
    )  # fmt: skip


def scenes() -> dict[str, Scene]:
    """Scenes that are written as scene files, by the name of the file."""
    return {"everything": SCENES["everything"].scene(), "large": large_scene()}


def state() -> mpsim.State:
    """A state with every column."""
    return mpsim.State(
        np.array([[1.0, 2.0], [3.0, 1.5]], np.float32), np.array([[0.5, -1.0], [0.0, 0.25]], np.float32),
        image=np.array([[1, 0], [0, -2]]), present=np.array([True, False]), box=(0.0, 4.0, 0.0, 3.0),
    )  # fmt: skip


def write_scenes(folder: Path) -> None:
    for name, scene in scenes().items():
        scenefile.save(scene, folder / f"{name}.toml", Settings(dt=1 / 32, contact="push"), "A title", "Text.", "This.")


def write_checkpoints(folder: Path) -> None:
    for name, how in CHECKPOINTS:
        with SCENES[name].start(**how) as sim:
            sim.run(frames=FRAMES // 2)
            if SCENES[name].midway is not None:
                SCENES[name].midway(sim)
            sim.save(folder / checkpoint_name(name, how))


def write_trajectories(folder: Path, *names: str) -> None:
    """The first half of a run in each format; the checkpoints of `parallel` continue them."""
    for name in names or TRAJECTORIES:
        with SCENES[Path(name).stem].start(method="grid") as sim, mpsim.Trajectory.write(folder / name, EVERY) as out:
            sim.run(frames=FRAMES // 2, observe=out)


def write_run(folder: Path) -> None:
    """The folder of a run, as `mpsim run` leaves it, which was to go on; without pictures."""
    shutil.rmtree(folder / "run", ignore_errors=True)
    arguments = [folder / "everything.toml", "--out", folder / "run", "--frames", 12, "--every", 4]
    arguments += ["--method", "grid", "--measure", "overlap", "--quiet"]
    CliRunner().invoke(main, [str(each) for each in ("run", *arguments)], catch_exceptions=False)
    for unneeded in [*(folder / "run").glob("*.png"), *(folder / "run").glob("*.previous")]:
        unneeded.unlink()


def write_trade(folder: Path) -> None:
    """What a trade keeps, and the table that it came to."""
    (folder / "trade.json").unlink(missing_ok=True)
    table = mpsim.tradeoff(SCENES["bare"].scene(), [CANDIDATE], path=folder / "trade.json", **TRADED)
    (folder / "table.json").write_text(table.to_json())


def write(folder: Path) -> None:
    """All of them, into a folder that is emptied first."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for each in (write_scenes, write_checkpoints, write_trajectories, write_run, write_trade):
        each(folder)
    state().save(folder / "state.npz")
    expected = {
        "scenes": {name: scene.digest() for name, scene in scenes().items()},
        "trajectories": {name: frames_of(folder / name) for name in TRAJECTORIES},
    }
    (folder / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")


def frames_of(path: Path) -> list[list[Any]]:
    """Number, time and box of each frame of a trajectory, its discs, and digests of what it says of them."""
    found = []
    with mpsim.Trajectory(path) as trajectory:
        for frame in trajectory:
            sizes = digest_of({"radius": frame.radius, "mass": frame.mass})
            found.append([frame.frame, frame.time, *frame.box, len(frame.ids), int(frame.ids.sum()), sizes,
                          frame.state.digest()])  # fmt: skip
    return found


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    write(Path(sys.argv[1]))
