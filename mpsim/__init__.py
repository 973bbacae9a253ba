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

from mpsim import measure
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.errors import (
    BudgetError,
    CheckpointError,
    CheckpointWarning,
    ClosedError,
    DivergedError,
    EmitterWarning,
    FastWarning,
    GuardWarning,
    InputError,
    MpsimError,
    NotRecordedError,
    OutputError,
    OverlapWarning,
    ResolutionWarning,
    SceneFileError,
    SharedMemoryError,
    StalledError,
    TooFastError,
    WorkerDied,
    WorkerStalled,
)
from mpsim.features import Emitter, FixedDisc, Piston, Polyline
from mpsim.measure.tradeoff import Tradeoff, tradeoff
from mpsim.measure.tune import Tuned, tune
from mpsim.scene import Scene
from mpsim.settings import Settings
from mpsim.state import State

__version__ = "0.1.0"

if TYPE_CHECKING:
    from mpsim.output.animation import animate


def __getattr__(name: str) -> Any:
    """Import on first use what needs matplotlib, so that `import mpsim` stays quick."""
    if name == "animate":
        return importlib.import_module("mpsim.output.animation").animate
    raise AttributeError(f"module 'mpsim' has no attribute {name!r}")


__all__ = [
    "BudgetError",
    "CheckpointError",
    "CheckpointWarning",
    "ClosedError",
    "DivergedError",
    "Emitter",
    "EmitterWarning",
    "FastWarning",
    "FixedDisc",
    "GuardWarning",
    "InputError",
    "MpsimError",
    "NotRecordedError",
    "OutputError",
    "OverlapWarning",
    "Piston",
    "Polyline",
    "Report",
    "ResolutionWarning",
    "Scene",
    "SceneFileError",
    "Settings",
    "SharedMemoryError",
    "Simulation",
    "StalledError",
    "State",
    "TooFastError",
    "Tradeoff",
    "Tuned",
    "WorkerDied",
    "WorkerStalled",
    "animate",
    "measure",
    "tradeoff",
    "tune",
]
