"""Files to download from a view: a film, the session, a program."""

import dataclasses
import importlib
import inspect
import io
import math
import tempfile
import zipfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError
from mpsim.features.feature import chosen, plain
from mpsim.output.animation import DPI, PIXELS, image_of, write_gif
from mpsim.output.drawing import PAGE, ColourScale, MovingDiscs
from mpsim.scene import scenefile, settings
from mpsim.scene.scene import Scene
from mpsim.viewer.protocol import FASTEST, HEADER, SentPicture, unpack


class Download(NamedTuple):
    """A file to download: its content and its media type."""

    content: bytes
    kind: str


# --- A film of the latest pictures of a view, as GIF
#
# Two stages are drawn side by side. Each picture shows the walls as they were at its time.

SECONDS, PICTURES_A_SECOND = 6, 20  # longest duration of a film [s], and its pictures per second
MOST_BYTES = 2**26  # largest size of the discs of the kept pictures, in bytes

MOST_DISCS = 150_000
"""Largest number of discs in all pictures of a film together: some seconds of drawing. With more discs, some pictures
are left out."""

GAP = 8  # pixels between two stages


class Film:
    """Keeps the `pictures` of the last seconds, the oldest first; afresh when a second stage begins or ends."""

    def __init__(self) -> None:
        self.pictures: deque[SentPicture] = deque(maxlen=SECONDS * PICTURES_A_SECOND)
        self._kind: tuple[Any, ...] = ()  # extent of the scene, and number of stages
        self._next = 0.0

    def add(self, picture: SentPicture, now: float) -> None:
        """Keep a picture, if it is time for one; now: time of a clock [s]."""
        if now < self._next:
            return
        extent = np.frombuffer(picture.stages[0].packed, HEADER, 1)["extent"][0]
        kind = (*extent.tolist(), len(picture.stages))
        if kind != self._kind:
            self.pictures.clear()
            self._kind = kind
        self._next = max(self._next + 1 / PICTURES_A_SECOND, now + 0.5 / PICTURES_A_SECOND)
        self.pictures.append(picture)
        # Pictures mostly share radii and walls with the picture before.
        while len(self.pictures) > 1 and sum(len(s.packed) for each in self.pictures for s in each.stages) > MOST_BYTES:
            self.pictures.popleft()


FILM = "film.gif"  # the name that a browser requests


def film(pictures: Sequence[SentPicture], scene: Scene) -> Download:
    """A film of every n-th picture, so that drawing takes a few seconds at most.

    Raises:
        InputError: if there are no pictures.
    """
    if not pictures:
        raise InputError("a film needs pictures; got none yet. Show the simulation in the page first.")
    each = max(sum(len(stage.packed) for stage in pictures[-1].stages) // 5, 1)
    step = -(-len(pictures) * each // MOST_DISCS)
    content = io.BytesIO()
    write_gif(content, _drawn(pictures[::step], scene), PICTURES_A_SECOND / step)
    return Download(content.getvalue(), "image/gif")


def _drawn(pictures: Sequence[SentPicture], scene: Scene) -> Iterator[Image.Image]:
    stages = pictures[0].stages
    scale = PIXELS / max(scene.width, scene.height)
    width, height = (max(round(side * scale), 1) for side in (scene.width, scene.height))
    whole = len(stages) * (width + GAP) - GAP
    figure = Figure((whole / DPI, height / DPI), DPI, facecolor=PAGE.behind)
    figure.set_layout_engine("none")  # whatever a program has set for its own figures
    moving: list[MovingDiscs] = []
    for number, stage in enumerate(stages):
        axes = figure.add_axes((number * (width + GAP) / whole, 0, width / whole, 1), facecolor=PAGE.ground)
        moving.append(MovingDiscs(axes, scene, *unpack(stage)[:2], ColourScale(0, FASTEST), theme=PAGE))
        for spine in axes.spines.values():
            spine.set_visible(False)
    for picture in pictures:
        for stage, discs in zip(picture.stages, moving, strict=True):
            discs.show(*unpack(stage), picture.capsules)
        yield image_of(figure)


# --- The session, a program
#
# They are made in memory, or in a temporary folder that is removed before the answer is sent. No name from a page ever
# becomes a path.


MOST_WRITTEN_OUT = 2000
"""Largest number of discs whose numbers are written into a program; with more it would be too long to read."""


def session(sim: Simulation, name: str) -> Download:
    """A zip archive of the journal, session.toml, and its scene file. `Simulation.replay` runs it again."""
    archive = io.BytesIO()
    with tempfile.TemporaryDirectory(prefix="mpsim-view-") as folder:
        sim.journal.save(Path(folder, "session.toml"))
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
            for path in sorted(Path(folder).iterdir()):
                file.write(path, path.name)
    return Download(archive.getvalue(), "application/zip")


def program(sim: Simulation, name: str) -> Download:
    """The same run as a Python program, which compares digests at its end.

    Raises:
        InputError: if the scene does not come with mpsim and has more than MOST_WRITTEN_OUT discs.
    """
    journal = sim.journal
    scene = _named_or_written_out(journal.scene, name)
    lines = [
        '"""A session of mpsim\'s live view, again."""',
        "",
        "import mpsim",
        "",
        f"scene = {scene}",
        f"settings = {_call(journal.settings)}",
        "with mpsim.Simulation(scene, settings) as sim:",
    ]
    frame = 0
    for change in [*journal.changes, None]:
        end = journal.frame if change is None else change.frame
        lines += [f"    sim.run(frames={end - frame})"] if end > frame else []
        frame = end
        if change is not None:
            lines.append(f"    sim.{change.what}({_arguments_as_text(change.values)})")
    lines += [
        f'    assert sim.digest() == "{journal.digest}", "another version of mpsim, or another kind of processor"',
        "    print(sim)",
    ]
    return Download(("\n".join(lines) + "\n").encode(), "text/x-python; charset=utf-8")


FILES: Mapping[str, Callable[[Simulation, str], Download]] = {"session.zip": session, "program.py": program}
"""What can be downloaded besides the film, by the name that a browser requests."""


def _arguments_as_text(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={_text(value)}" for name, value in values.items())


def _named_or_written_out(scene: Scene, name: str) -> str:
    if is_named(scene, name):
        return f"mpsim.Scene.load({name!r})"
    if scene.count > MOST_WRITTEN_OUT:
        raise InputError(
            f"a program can contain the numbers of at most {MOST_WRITTEN_OUT} discs; this scene has {scene.count:,} "
            "and does not come with mpsim. Download the session, and use mpsim.Simulation.replay('session.toml')."
        )
    arguments = {each.name: each.default for each in inspect.signature(Scene).parameters.values()}
    values = {name: getattr(scene, name) for name in arguments if name not in settings.NAMES}
    given = {name: value for name, value in values.items() if plain(value) != plain(arguments[name])}
    return f"mpsim.Scene({_arguments_as_text(given)})"


def _text(value: Any) -> str:
    """A value as a Python expression that evaluates to the same bits."""
    if dataclasses.is_dataclass(value):
        return _call(value)
    if isinstance(value, np.ndarray | np.generic):
        return repr(value.tolist())
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return f'float("{value}")'
    return repr(value)


def _call(part: Any) -> str:
    """A dataclass of mpsim as a call that makes it.

    Raises:
        InputError: if it is not public, so that a program cannot call it.
    """
    kind = type(part)
    if getattr(importlib.import_module("mpsim"), kind.__name__, None) is not kind:
        raise InputError(
            f"a program can contain only what mpsim offers by name; got a {kind.__name__}. Download the session."
        )
    return f"mpsim.{kind.__name__}({_arguments_as_text(chosen(part))})"


def is_named(scene: Scene, name: str) -> bool:
    """Whether a scene is the one that comes with mpsim under this name."""
    return name in scenefile.names() and Scene.load(name).digest() == scene.digest()
