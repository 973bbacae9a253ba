"""Compares frame times of three scenes with an earlier version; fails if one is much slower three times in a row.

python scripts/check_speed.py                       against the commit before
python scripts/check_speed.py --before REVISION

Both versions are timed in turns, each time in a process of its own, so that other load falls on both. Ratios are always
printed. Only scenes that were slower by a factor of LOSS are timed again, so a slow turn alone is no loss. Where the
revision is not there, as in a clone of one commit, or cannot run these scenes, it says so and passes.
"""

import io
import json
import os
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from harness import TOP, parser_of

from mpsim.errors import InputError

SCENES: dict[str, dict[str, Any]] = {
    "bare, grid": {"method": "grid", "precision": "float32"},
    "bare, 2 workers": {"method": "parallel", "workers": 2, "precision": "float32"},
    "friction and gravity": {
        "method": "grid",
        "precision": "float64",
        "features": {"gravity": (0.0, -1.0), "restitution": 0.6, "friction": 0.5, "wall_friction": 0.5},
    },
}
"""10,000 discs, packing 0.4. Each has kernels that the default tests have compiled: of the bare scene, and those of the
named scene rough-sediment."""

LOSS = 1.3
"""Time of a frame over that of the earlier version from which on it counts as a loss."""

TURNS = 3
"""Turns in each of which a scene must have lost, for the check to fail."""

TIMER = """
import json, sys, warnings
import numpy as np
import mpsim
warnings.simplefilter("ignore")
places = (np.arange(100) + 0.5) * 1.4
position = np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)
velocity = np.random.default_rng(1).normal(size=position.shape)
found = {}
for name, settings in json.loads(sys.argv[1]).items():
    features = settings.pop("features", {})
    scene = mpsim.Scene(width=140, height=140, position=position, velocity=velocity, radius=0.5, **features)
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.01, **settings)) as sim:
        sim.run(frames=100)
        medians = [float(np.median(sim.run(frames=150).frame_seconds)) for _ in range(5)]
        found[name] = min(medians) / scene.count * 1e9
print(json.dumps(found))
"""
"""Prints nanoseconds per disc and frame of scenes: the least of several medians, as other load only adds to it."""


class OtherVersionError(Exception):
    """The other version cannot run a scene; the text is what it wrote to standard error."""


@contextmanager
def checkout_of(revision: str) -> Iterator[Path]:
    """A temporary folder with the package at a git revision.

    Raises:
        InputError: if there is no such revision in this checkout, or no git.
    """
    try:
        done = subprocess.run(["git", "archive", revision, "mpsim"], cwd=TOP, capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        why = error.stderr.decode().strip() if isinstance(error, subprocess.CalledProcessError) else str(error)
        raise InputError(f"--before must be a git revision of this checkout; got {revision!r}: {why}") from None
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(folder, filter="data")
        yield Path(folder)


def timed(scenes: dict[str, dict[str, Any]], there: Path, turn: int) -> dict[str, tuple[float, float]]:
    """Costs of scenes here and in another checkout, which comes first in every other turn.

    Raises:
        OtherVersionError: if it fails there.
        RuntimeError: if it fails here.
    """
    printed = {}
    for top in (TOP, there) if turn % 2 else (there, TOP):
        command = [sys.executable, "-c", TIMER, json.dumps(scenes)]
        environment = {**os.environ, "PYTHONPATH": str(top)}
        run = subprocess.run(command, cwd=top, env=environment, capture_output=True, text=True, check=False)
        if run.returncode:
            raise (OtherVersionError if top == there else RuntimeError)(run.stderr.strip())
        printed[top] = json.loads(run.stdout)
    return {name: (printed[TOP][name], printed[there][name]) for name in scenes}


def losses(there: Path) -> list[str]:
    """Names of the scenes that have lost in each of TURNS turns; every ratio is printed."""
    suspects = SCENES
    for turn in range(TURNS):
        costs = timed(suspects, there, turn)
        for name, (here, before) in costs.items():
            print(f"turn {turn + 1}: {name}: {here:.2f} ns per disc and frame, {here / before:.2f} of {before:.2f}")
        suspects = {name: SCENES[name] for name, (here, before) in costs.items() if here / before >= LOSS}
        if not suspects:
            break
    return list(suspects)


def main() -> int:
    """Exit code: 1 where a scene has lost for certain."""
    parser = parser_of(__doc__)
    parser.add_argument("--before", default="HEAD~1", metavar="REVISION", help="default: HEAD~1, the commit before")
    revision = parser.parse_args().before
    try:
        with checkout_of(revision) as there:
            lost = losses(there)
    except (InputError, OtherVersionError) as error:
        print(f"nothing to compare with: {revision}: {str(error).splitlines()[-1]}")
        return 0
    for name in lost:
        print(f"{name}: slower by {LOSS} or more than {revision} in {TURNS} turns out of {TURNS}.")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
