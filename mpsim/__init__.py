"""Simulations of moving discs in two dimensions, by worker processes that share memory.

>>> import mpsim
>>> scene = mpsim.Scene.random(count=100, packing=0.4, radius=0.5, temperature=1.0, seed=7)
>>> with mpsim.Simulation(scene, mpsim.Settings(dt=0.01)) as sim:
...     report = sim.run(frames=50)
>>> report.frames
50
"""

import importlib
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import mpsim.core.interpreter  # noqa: F401  # pyright: ignore[reportUnusedImport]  # isort: skip
from mpsim import errors, measure
from mpsim.core import calls, checks, state
from mpsim.core.state import State
from mpsim.core.units import Units
from mpsim.core.version import __version__ as __version__
from mpsim.engine.observers import Collisions, Sensor
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.snapshot import Snapshot
from mpsim.errors import (
    CheckpointError,
    DivergedError,
    FastWarning,
    InputError,
    MpsimError,
    OverlapWarning,
    TooFastError,
    WorkerDiedError,
)
from mpsim.features import (
    Circle,
    Emitter,
    FixedDisc,
    Oscillation,
    Path,
    Piston,
    Polyline,
    Rotation,
    ThermalWalls,
    Thermostat,
    Translation,
)
from mpsim.measure.correlations import Correlations
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.findings import Findings, findings
from mpsim.studies.sweep import Sweep, sweep
from mpsim.studies.tradeoff import Tradeoff, tradeoff
from mpsim.studies.tune import Tuned, tune

if TYPE_CHECKING:
    from mpsim.output.animation import animate
    from mpsim.output.drawing import draw
    from mpsim.output.trajectory import Trajectory
    from mpsim.viewer.live import View, view
    from mpsim.viewer.notebook import live


_LATE = {
    "animate": "mpsim.output.animation",
    "draw": "mpsim.output.drawing",
    "live": "mpsim.viewer.notebook",
    "Trajectory": "mpsim.output.trajectory",
    "View": "mpsim.viewer.live",
    "view": "mpsim.viewer.live",
}
"""Names that are imported on first use, so that `import mpsim` stays quick."""

_VIEWS = {
    "scene_from_file": ("mpsim.scene.scenefile", "load"),
    "scene_of_groups": ("mpsim.scene.scenefile", "of_groups"),
    "scene_to_file": ("mpsim.scene.scenefile", "save"),
    "compressed": ("mpsim.scene.compression", "compressed"),
    "scene_png": ("mpsim.output.drawing", "scene_png"),
    "report_html": ("mpsim.output.tables", "report_html"),
    "report_times": ("mpsim.output.figures", "times"),
    "trade_text": ("mpsim.output.tables", "terminal_table"),
    "trade_html": ("mpsim.output.tables", "html_table"),
    "tuned_html": ("mpsim.output.tables", "tuned_html"),
    "measure_names": ("mpsim.measure.registry", "names"),
}
"""What upper modules do for objects of lower ones; each is imported when it is asked for."""


def _imported_when_called(module: str, name: str) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        return getattr(importlib.import_module(module), name)(*arguments)

    return call


for _view, _where in _VIEWS.items():
    state.register(_view, _imported_when_called(*_where))


def __getattr__(name: str) -> Any:
    """Import on first use what writes files and pictures."""
    if name in _LATE:
        module = importlib.import_module(_LATE[name])
        calls.explain_wrong_calls(module, [name])
        return getattr(module, name)
    raise AttributeError(f"module 'mpsim' has no attribute {name!r}")


def __dir__() -> list[str]:
    """What is public."""
    return sorted([*__all__, "__doc__", "__file__", "__name__", "__path__", "__version__"])


__all__ = [
    "CheckpointError",
    "Circle",
    "Collisions",
    "Correlations",
    "DivergedError",
    "Emitter",
    "FastWarning",
    "Findings",
    "FixedDisc",
    "InputError",
    "MpsimError",
    "Oscillation",
    "OverlapWarning",
    "Path",
    "Piston",
    "Polyline",
    "Report",
    "Rotation",
    "Scene",
    "Sensor",
    "Settings",
    "Simulation",
    "Snapshot",
    "State",
    "Sweep",
    "ThermalWalls",
    "Thermostat",
    "TooFastError",
    "Tradeoff",
    "Trajectory",
    "Translation",
    "Tuned",
    "Units",
    "View",
    "WorkerDiedError",
    "animate",
    "draw",
    "errors",
    "findings",
    "live",
    "measure",
    "sweep",
    "tradeoff",
    "tune",
    "view",
]

calls.explain_wrong_calls(
    sys.modules[__name__],
    [name for name in __all__ if name not in _LATE],
    instead={
        "Settings": {
            name: f"Simulation(scene, settings, {name}=...)"
            for name in checks.names_of(Simulation)
            if name not in ("scene", "settings")
        },
        "Simulation": {name: f"Settings({name}=...)" for name in checks.names_of(Settings)},
    },
)
calls.explain_wrong_calls(measure, measure.__all__)
