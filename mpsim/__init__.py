"""Simulations of moving discs in two dimensions, by worker processes that share memory.

>>> import mpsim
>>> scene = mpsim.Scene.random(count=100, packing=0.4, radius=0.5, temperature=1.0, seed=7)
>>> with mpsim.Simulation(scene, mpsim.Settings(dt=0.01)) as sim:
...     report = sim.run(frames=50)
>>> report.frames
50
"""

import importlib
from typing import TYPE_CHECKING, Any

from mpsim import errors
from mpsim.core import late
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

__version__ = "0.1.0"  # as in pyproject.toml

if TYPE_CHECKING:
    from mpsim import measure
    from mpsim.core.state import State
    from mpsim.core.units import Units
    from mpsim.engine.checkpoint import Snapshot
    from mpsim.engine.observers import Collisions, Sensor
    from mpsim.engine.report import Report
    from mpsim.engine.simulation import Simulation
    from mpsim.features.baths import ThermalWalls, Thermostat
    from mpsim.features.emitters import Emitter
    from mpsim.features.motions import Oscillation, Path, Rotation, Translation
    from mpsim.features.obstacles import Circle, FixedDisc, Polyline
    from mpsim.features.piston import Piston
    from mpsim.measure.correlations import Correlations
    from mpsim.output.animation import animate
    from mpsim.output.drawing import draw
    from mpsim.output.trajectory import Trajectory
    from mpsim.scene.scene import Scene
    from mpsim.scene.settings import Settings
    from mpsim.studies.findings import Findings, findings
    from mpsim.studies.sweep import Sweep, sweep
    from mpsim.studies.tradeoff import Tradeoff, tradeoff
    from mpsim.studies.tune import Tuned, tune
    from mpsim.viewer.live import View, view
    from mpsim.viewer.notebook import live

_NAMES_OF = {
    "mpsim.core.state": "State",
    "mpsim.core.units": "Units",
    "mpsim.engine.checkpoint": "Snapshot",
    "mpsim.engine.observers": "Collisions Sensor",
    "mpsim.engine.report": "Report",
    "mpsim.engine.simulation": "Simulation",
    "mpsim.features.baths": "ThermalWalls Thermostat",
    "mpsim.features.emitters": "Emitter",
    "mpsim.features.motions": "Oscillation Path Rotation Translation",
    "mpsim.features.obstacles": "Circle FixedDisc Polyline",
    "mpsim.features.piston": "Piston",
    "mpsim.measure.correlations": "Correlations",
    "mpsim.output.animation": "animate",
    "mpsim.output.drawing": "draw",
    "mpsim.output.trajectory": "Trajectory",
    "mpsim.scene.scene": "Scene",
    "mpsim.scene.settings": "Settings",
    "mpsim.studies.findings": "Findings findings",
    "mpsim.studies.sweep": "Sweep sweep",
    "mpsim.studies.tradeoff": "Tradeoff tradeoff",
    "mpsim.studies.tune": "Tuned tune",
    "mpsim.viewer.live": "View view",
    "mpsim.viewer.notebook": "live",
}
"""Public names by their modules, which are imported on first use: NumPy and Numba alone take half a second."""

_MODULE_OF = {name: module for module, names in _NAMES_OF.items() for name in names.split()}

_OF_SIMULATION = ("comm", "start_method", "on_worker_death", "unguarded")
"""Arguments of Simulation that may be looked for among the settings."""

late.VIEWS.update(
    scene_from_file="mpsim.scene.scenefile:load",
    scene_of_groups="mpsim.scene.scenefile:of_groups",
    scene_to_file="mpsim.scene.scenefile:save",
    compressed="mpsim.scene.compression:compressed",
    scene_png="mpsim.output.drawing:scene_png",
    report_html="mpsim.output.tables:report_html",
    report_times="mpsim.output.history:times",
    trade_text="mpsim.output.tables:terminal_table",
    measure_names="mpsim.measure.registry:names",
)


def __getattr__(name: str) -> Any:
    """Import a public name on first use, and have wrong calls of it explained."""
    if name == "measure":
        return importlib.import_module("mpsim.measure")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'mpsim' has no attribute {name!r}")
    module = importlib.import_module(_MODULE_OF[name])
    late.named("mpsim.core.calls:explain_wrong_calls")(module, [name], _instead(name))
    globals()[name] = getattr(module, name)
    return globals()[name]


def _instead(name: str) -> dict[str, dict[str, str]]:
    """What to write in place of arguments that belong to another class."""
    if name == "Simulation":
        own = late.named("mpsim.core.checks:names_of")(__getattr__("Settings"))
        return {name: {each: f"Settings({each}=...)" for each in own}}
    return {"Settings": {each: f"Simulation(scene, settings, {each}=...)" for each in _OF_SIMULATION}}


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

for _name in __all__:
    if _name.endswith(("Error", "Warning")):
        getattr(errors, _name).__module__ = "mpsim"  # by which people catch it, and which tracebacks show
