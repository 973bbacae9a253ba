"""mpsim: many moving discs in two dimensions, simulated by worker processes over shared memory.

>>> import mpsim
>>> scene = mpsim.Scene.random(count=100, packing=0.4, radius=0.5, temperature=1.0, seed=7)
>>> with mpsim.Simulation(scene, mpsim.Settings(dt=0.01)) as sim:
...     report = sim.run(frames=50)
>>> report.frames
50
"""

import importlib
from typing import TYPE_CHECKING, Any

import mpsim.interpreter  # noqa: F401  # pyright: ignore[reportUnusedImport]  # isort: skip
from mpsim import measure
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.errors import (
    BudgetError,
    BusyError,
    CheckpointError,
    CheckpointWarning,
    ClosedError,
    DivergedError,
    EmitterWarning,
    FastWarning,
    ForkedError,
    GuardWarning,
    InputError,
    MpsimError,
    NotMeasurableError,
    NotRecordedError,
    OutputError,
    OverlapWarning,
    ResolutionWarning,
    ResourceError,
    SceneFileError,
    SharedMemoryError,
    StalledError,
    TooFastError,
    TrajectoryError,
    TrajectoryWarning,
    WorkerDied,
    WorkerStalled,
)
from mpsim.features import Emitter, FixedDisc, Piston, Polyline
from mpsim.measure.tradeoff import Tradeoff, tradeoff
from mpsim.measure.tune import tune
from mpsim.measure.tuned import Tuned
from mpsim.scene import Scene
from mpsim.settings import Settings
from mpsim.state import State

__version__ = "0.1.0"

if TYPE_CHECKING:
    from mpsim.output.animation import animate
    from mpsim.output.trajectory import Trajectory


_LATE = {"animate": "mpsim.output.animation", "Trajectory": "mpsim.output.trajectory"}


def __getattr__(name: str) -> Any:
    """Import on first use what writes files and pictures, so that `import mpsim` stays quick."""
    if name in _LATE:
        return getattr(importlib.import_module(_LATE[name]), name)
    raise AttributeError(f"module 'mpsim' has no attribute {name!r}")


__all__ = [
    "BudgetError",
    "BusyError",
    "CheckpointError",
    "CheckpointWarning",
    "ClosedError",
    "DivergedError",
    "Emitter",
    "EmitterWarning",
    "FastWarning",
    "FixedDisc",
    "ForkedError",
    "GuardWarning",
    "InputError",
    "MpsimError",
    "NotMeasurableError",
    "NotRecordedError",
    "OutputError",
    "OverlapWarning",
    "Piston",
    "Polyline",
    "Report",
    "ResolutionWarning",
    "ResourceError",
    "Scene",
    "SceneFileError",
    "Settings",
    "SharedMemoryError",
    "Simulation",
    "StalledError",
    "State",
    "TooFastError",
    "Tradeoff",
    "Trajectory",
    "TrajectoryError",
    "TrajectoryWarning",
    "Tuned",
    "WorkerDied",
    "WorkerStalled",
    "animate",
    "measure",
    "tradeoff",
    "tune",
]
