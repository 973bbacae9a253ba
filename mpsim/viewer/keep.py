"""Makes the files to download from a view: the session, the present scene, a program.

They are made in memory, or in a temporary folder that is removed before the answer is sent. No name from a page ever
becomes a path.
"""

import dataclasses
import inspect
import io
import math
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mpsim.engine.changes import Change
from mpsim.engine.journal import Journal
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError, MpsimError
from mpsim.features import FEATURES
from mpsim.features.piston import PISTON
from mpsim.scene import recommended, scenefile
from mpsim.scene.scene import Scene

MOST_WRITTEN_OUT = 2000
"""Largest number of discs whose numbers are written into a program; with more it would be too long to read."""


class Kept(NamedTuple):
    """A file to download: its content and its media type."""

    content: bytes
    kind: str


def session(sim: Simulation, name: str) -> Kept:
    """A zip archive of the journal, session.toml, and its scene file. `Simulation.replay` runs it again."""
    journal = sim.journal
    return _zipped(lambda folder: journal.save(folder / "session.toml"))


def scene_now(sim: Simulation, name: str) -> Kept:
    """A zip archive of a scene file that starts from the present state, with the present settings."""
    found, settings = _continuing(sim), dataclasses.replace(sim.settings, workers=None)
    title = f"{name or 'A simulation'} at time {sim.time:g}"
    return _zipped(lambda folder: scenefile.save(found, folder / "scene.toml", settings, title))


def program(sim: Simulation, name: str) -> Kept:
    """The same run as a Python program, which compares digests at its end.

    Raises:
        InputError: if the scene does not come with mpsim and has more than MOST_WRITTEN_OUT discs.
    """
    return Kept(_program(sim.journal, name).encode(), "text/x-python; charset=utf-8")


KEEPING: Mapping[str, Callable[[Simulation, str], Kept]] = {
    "session.zip": session,
    "scene.zip": scene_now,
    "program.py": program,
}
"""What can be downloaded, by the name that a browser requests."""


def answer(sim: Simulation | None, name: str, what: str, answer: "Future[Kept]") -> None:
    """Make a file and set it, or an error of mpsim, as the result of `answer`; sim: None if it has ended."""
    if not answer.set_running_or_notify_cancel():
        return
    try:
        if sim is None:
            raise InputError("a file to keep needs a simulation; this one has ended. Reset it.")
        answer.set_result(KEEPING[what](sim, name))
    except (MpsimError, OSError) as error:
        answer.set_exception(error)


def _zipped(write: Callable[[Path], object]) -> Kept:
    """The files that a function writes into a folder, as a zip archive."""
    archive = io.BytesIO()
    with tempfile.TemporaryDirectory(prefix="mpsim-view-") as folder:
        write(Path(folder))
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
            for path in sorted(Path(folder).iterdir()):
                file.write(path, path.name)
    return Kept(archive.getvalue(), "application/zip")


# --- the scene of this moment


def _continuing(sim: Simulation) -> Scene:
    """A scene that starts from the present state: with the discs that were added, without absent ones."""
    scene, state = sim.scene, sim.state
    if sim.count == scene.count:
        return scene.starting_from(state)
    if scene.acceleration is not None:
        raise InputError(
            "a scene file of this moment needs the acceleration of each disc, which is unknown for discs that were "
            "added. Download the session, which has everything."
        )
    here = state.present
    values = _arguments(scene) | {
        "position": state.position[here].astype(np.float64),
        "velocity": state.velocity[here].astype(np.float64),
        "radius": sim.radii[here] if np.ndim(scene.radius) else scene.radius,
        "mass": None if scene.mass is None else sim.masses[here],
        "spin": None if state.spin is None else state.spin[here].astype(np.float64),
    }
    if scene.piston is not None and state.box is not None:
        values["piston"] = PISTON.continued(scene, state.box)
    return Scene(**values)


def _arguments(scene: Scene) -> dict[str, Any]:
    """The arguments that make an equal scene."""
    return {name: getattr(scene, name) for name in inspect.signature(Scene).parameters if name not in recommended.NAMES}


# --- as Python


def _program(journal: Journal, name: str) -> str:
    scene = _named_or_written_out(journal.scene, name)
    lines = [
        '"""A session of mpsim\'s live view, again."""',
        "",
        "import mpsim",
        "",
        f"scene = {scene}",
        f"settings = {_call(journal.settings, leave_defaults=True)}",
        "with mpsim.Simulation(scene, settings) as sim:",
    ]
    frame = 0
    for change in journal.changes:
        lines += _run(change.frame - frame)
        lines.append(f"    sim.{change.what}({_values(change)})")
        frame = change.frame
    lines += _run(journal.frame - frame)
    lines += [
        f'    assert sim.digest() == "{journal.digest}", "another version of mpsim, or another kind of processor"',
        "    print(sim)",
    ]
    return "\n".join(lines) + "\n"


def _run(frames: int) -> list[str]:
    return [f"    sim.run(frames={frames})"] if frames else []


def _values(change: Change) -> str:
    return ", ".join(f"{name}={_text(value)}" for name, value in change.values.items())


def _named_or_written_out(scene: Scene, name: str) -> str:
    if is_named(scene, name):
        return f"mpsim.Scene.load({name!r})"
    if scene.count > MOST_WRITTEN_OUT:
        raise InputError(
            f"a program can contain the numbers of at most {MOST_WRITTEN_OUT} discs; this scene has {scene.count:,} "
            "and does not come with mpsim. Download the session, and use mpsim.Simulation.replay('session.toml')."
        )
    defaults = {each.name: each.default for each in inspect.signature(Scene).parameters.values()}
    given = {argument: value for argument, value in _arguments(scene).items() if not _same(value, defaults[argument])}
    return f"mpsim.Scene({', '.join(f'{argument}={_text(value)}' for argument, value in given.items())})"


def _text(value: Any) -> str:
    """A value as a Python expression that evaluates to the same bits."""
    if isinstance(value, tuple(kind for feature in FEATURES for kind in feature.kinds)):
        return _call(value)
    if isinstance(value, np.ndarray | np.generic):
        return repr(value.tolist())
    if isinstance(value, list | tuple):
        inside = ", ".join(map(_text, value))
        return f"[{inside}]"
    if isinstance(value, float) and not math.isfinite(value):
        return f'float("{value}")'
    return repr(value)


def _call(part: Any, leave_defaults: bool = False) -> str:
    """A dataclass of mpsim as a call that makes it."""
    values = {each.name: getattr(part, each.name) for each in dataclasses.fields(part) if each.init}
    if leave_defaults:
        values = {name: value for name, value in values.items() if value != getattr(type(part)(), name)}
    return f"mpsim.{type(part).__name__}({', '.join(f'{name}={_text(value)}' for name, value in values.items())})"


# --- named scenes


def is_named(scene: Scene, name: str) -> bool:
    """Whether a scene is the one that comes with mpsim under this name."""
    if name not in scenefile.names():
        return False
    other = _arguments(Scene.load(name))
    return all(_same(value, other[argument]) for argument, value in _arguments(scene).items())


def _same(one: Any, other: Any) -> bool:
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return one is not None and other is not None and bool(np.array_equal(one, other))
    return type(one) is type(other) and one == other
