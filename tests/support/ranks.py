"""Scenes run on the ranks of MPI, and scripts started on several of them.

`python -m support.ranks WORKERS NAME ...`, on any number of ranks, prints what the first rank finds, as JSON.
"""

import json
import os
import subprocess
import sys
import tempfile
import textwrap
import time
import warnings
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mpsim
from mpsim.engine.solvers.ranks.messages import library
from mpsim.measure.registry import NAMES
from support.processes import Outcome
from support.scenes import gas, scene_of, zoo
from support.transforms import Units

MPIEXEC = Path(sys.executable).with_name("mpiexec")
TESTS = Path(__file__).parents[1]

ENVIRONMENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_mpi_yield_when_idle": "1",
}
"""Of Open MPI, where that is installed instead: more ranks than cores, which give their core away while they wait."""


class Case(NamedTuple):
    """A scene, settings, how many frames, and what is measured."""

    scene: mpsim.Scene
    settings: dict[str, Any]
    frames: int = 40
    measures: tuple[str, ...] = ()


def corner(count: int = 300) -> mpsim.Scene:
    """All discs in one corner of a large box, of which most columns are empty at first."""
    dense = gas(count, 0.5, seed=5)
    return scene_of(dense.position, dense.velocity, 4 * dense.width, dense.height)


def wandering(count: int = 600) -> mpsim.Scene:
    """A crowd that goes round a long box, past all columns."""
    crowd = gas(count, 0.5, seed=5)
    velocity = 0.2 * crowd.velocity + np.array([4.0, 0.0])
    return scene_of(crowd.position, velocity, 4 * crowd.width, crowd.height, boundary=("periodic", "walls"))


def fast() -> mpsim.Scene:
    """Some discs cross the columns of several ranks in one step."""
    start = gas(300, 0.2, seed=6)
    velocity = start.velocity * np.where(np.arange(300) % 31 == 0, 200.0, 1.0)[:, None]
    return mpsim.Scene(width=start.width, height=start.height, position=start.position, velocity=velocity, radius=0.5)


ALL_MEASURES = tuple(name for name in NAMES if name != "pressure_xy")  # those of a gas between walls

CASES = {
    "bare": lambda: Case(gas(700, 0.4, seed=3), {"dt": 0.05}, 60, ALL_MEASURES),
    "bare, in float32": lambda: Case(gas(700, 0.4, seed=3), {"dt": 0.05, "precision": "float32"}, 60, ALL_MEASURES),
    "everything": lambda: Case(
        zoo(
            "gravity acceleration radii masses lossy obstacles", 500, side=35.0, piston=mpsim.Piston("right", -0.5, 30)
        ),
        {"dt": 0.02, "passes": 2, "substeps": 2},
        40,
        ("contact_rate", "largest_overlap"),
    ),
    "rough torus": lambda: Case(zoo("periodic rough radii masses", 500, side=28.0), {"dt": 0.05}, 60),
    "heated": lambda: Case(
        gas(700, 0.4, seed=3, boundary="periodic", mass=(0.5, 2.0) * 350, thermostat=mpsim.Thermostat(1.5, 2.0)),
        {"dt": 0.05, "substeps": 2},
        60,
    ),
    "thermal walls": lambda: Case(
        gas(700, 0.4, seed=3, thermal_walls=mpsim.ThermalWalls(4.0, 4.0, 9.0, 9.0)), {"dt": 0.05}, 60, ("pressure",)
    ),
    "push": lambda: Case(gas(700, 0.6, seed=3), {"dt": 0.05, "contact": "push"}, 60),
    "corner": lambda: Case(corner(), {"dt": 0.05}, 400, ("pressure", "contact_rate")),
    "wandering": lambda: Case(wandering(), {"dt": 0.05}, 600),
    "doors": lambda: Case(zoo("rough gravity radii masses absorbing emitters", 300, side=24.0), {"dt": 0.02}, 120),
    "in a small unit": lambda: Case(Units(length=2.0**-9).scene(gas(700, 0.4, seed=3)), {"dt": 0.05}, 60),
    "fast": lambda: Case(fast(), {"dt": 0.05}, 60),
}
"""By name; made when they are asked for."""


def found(name: str, **settings: Any) -> dict[str, Any]:
    """Digest, contacts, measures and work of a case."""
    case = CASES[name]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with mpsim.Simulation(case.scene, mpsim.Settings(**case.settings, **settings)) as sim:
            report = sim.run(frames=case.frames, measures=case.measures)
            measures = {name: str(value) for name, value in report.measures.items()}
            found = {"digest": sim.digest(), "collisions": report.collisions, "measures": measures}
            return found | {"work": sim.work}


def on_ranks(
    number: int,
    *words: str,
    script: str | None = None,
    program: str = "support.ranks",
    bound: float = 280,
    prefix: Sequence[str] = (),
) -> Outcome:
    """`python -m PROGRAM WORDS`, or a script, on so many ranks; prefix: of the command, such as `unshare`."""
    with tempfile.TemporaryDirectory(prefix="mpsim-test-") as folder:
        arguments = ["-m", program, *words]
        if script is not None:
            path = Path(folder) / "script.py"
            path.write_text(textwrap.dedent(script))
            arguments = ["-m", "mpi4py", str(path), *words]
        paths = os.pathsep.join([str(TESTS), str(TESTS.parent)])
        variables = os.environ | ENVIRONMENT | {"PYTHONPATH": paths, "TMPDIR": folder}
        command = [*prefix, str(MPIEXEC), "-n", str(number), sys.executable, "-W", "error", *arguments]
        began = time.perf_counter()
        done = subprocess.run(
            command, env=variables, cwd=folder, capture_output=True, text=True, timeout=bound, check=False
        )
        return Outcome(done.returncode, done.stdout, done.stderr, time.perf_counter() - began)


def content_of(path: Path) -> tuple[dict[str, Any], list[tuple[str, bytes]]]:
    """The header of a checkpoint but for what says who has written it, and all else in the order of the file."""
    with zipfile.ZipFile(path) as file:
        assert file.testzip() is None
    found = np.load(path)
    members = [(name, (array := found[name]).dtype.str.encode() + array.tobytes()) for name in found.files]
    assert len(members) > 6
    header = json.loads(found["mpsim_checkpoint"].tobytes())
    for name in ("method", "workers"):
        del header["settings"][name]
    return header, [each for each in members if each[0] not in ("digest", "mpsim_checkpoint")]


def told_by(number, *words, script=None):
    """What so many ranks find of the cases that are named, or what a script prints last on them."""
    done = on_ranks(number, *words, script=script)
    assert done.code == 0, done.err
    return json.loads(done.out.splitlines()[-1])


def tell(*words: Any) -> None:
    """Print what each rank says, from the first one: `mpiexec` may mix what several print. All ranks call it."""
    for each in library().COMM_WORLD.gather(words) or []:
        print(*each)


def report(told: Any) -> None:
    """Print what the first rank has found, as JSON, for `told_by`. All ranks may call it."""
    if library().COMM_WORLD.rank == 0:
        print(json.dumps(told))


def main(*names: str) -> None:
    """Run cases on these ranks, and print what the first finds."""
    report({name: found(name, method="mpi") for name in names})


if __name__ == "__main__":
    main(*sys.argv[1:])
