"""Animations: discs at true radius, coloured, written frame by frame to a GIF or an MP4."""

import contextlib
import dataclasses
import itertools
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mpsim.core import atomic, checks
from mpsim.core.errors import InputError, OutputError
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.output import ffmpeg
from mpsim.output.colour_scale import ColourScale, scale_of, scale_of_run, speeds_of
from mpsim.output.drawing import STYLE, closed_off, draw_discs, new_figure, with_images
from mpsim.scene.recommended import frames_between_pictures, settings_for
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

PIXELS = 480
"""Length of the longer side of the box in a picture."""

PICTURES, MOST_PICTURES = 200, 300
"""Default number of pictures of a scene without a duration, and the largest of one with a duration."""

DPI = 100

FLAT = 2.5
"""Ratio of width to height from which the colour bar lies below the box."""


def animate(
    scene: Scene,
    settings: Settings | None,
    path: str | os.PathLike[str],
    frames: int | None = None,
    *,
    every: int | None = None,
    pictures_per_second: int = 25,
    pixels: int = PIXELS,
    colour: str | None = "speed",
    progress: bool | Callable[[int, int], None] = True,
    until: float | None = None,
) -> Path:
    """Simulate a scene and write it as an animation.

    By speed, the ends of the colour bar are the 2nd and the 98th percentile of all its pictures, and arrows show that
    speeds lie outside. The scene is simulated twice for this: before the first picture, and as the pictures are drawn.

    Args:
        scene, settings: what is simulated and how; settings None: those that the scene recommends, or the defaults.
        path: ends in .gif, or .mp4 (needs ffmpeg, or the extra `film`). An existing file is replaced.
        frames: number of pictures, >= 1; the first shows the start. None: as many as the scene's duration takes, up to
            MOST_PICTURES; 200 without a duration.
        every: frames of the simulation from one picture to the next, >= 1; None: the scene's picture_interval, or 1.
        pictures_per_second: of the animation, 1 to 50 [1/s].
        pixels: length of the longer side of the box in a picture, 100 to 4000.
        colour: "speed"; "worker", by the worker that owns the column of a disc, or "parity", by whether that column is
            even or odd, so that one sees the passes (both need a method with columns, `grid` or `parallel`;
            `auto` then stands for the latter); None: one colour for all.
        progress: show a progress bar, if standard error is a terminal; or a function, called as progress(done, of).
        until: time of the last picture [time], > 0, in place of `frames`; without `every` too, MOST_PICTURES at most
            are spread evenly over it.

    Returns:
        The path that was written.

    Raises:
        OutputError: without ffmpeg for .mp4, or if the path cannot be written; before any work.
        InputError: for another ending, for numbers out of range, and for columns of a method that has none.

    >>> import tempfile
    >>> scene = Scene.random(count=20, packing=0.3, radius=0.5, seed=2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     animate(scene, Settings(dt=0.02), f"{folder}/gas.gif", frames=3, every=5).stat().st_size > 1000
    True
    """
    settings = settings_for(scene, settings)
    frames, every = pictures_of(scene, settings, frames, every, until)
    rate = checks.whole("pictures_per_second", pictures_per_second, 1, 50, "25 looks smooth.")
    pixels = checks.whole("pixels", pixels, 100, 4000, "480 suits a page.")
    target = checked_target(path)
    if colour in ("worker", "parity") and settings.method == "auto":  # which may choose one without columns
        settings = dataclasses.replace(settings, method="parallel")
    with Simulation(scene, settings) as sim, matplotlib.rc_context(fname=STYLE), _bar(frames, progress) as advance:
        writer = _writer_for(target, rate)
        scale = scale_of_run(scene, settings, frames, every) if colour == "speed" else None
        picture = Picture(sim, pixels, colour, scale)
        with atomic.atomic_write(target) as file, writer.saving(picture.figure, file.name, DPI):
            for number in range(frames):
                if number:
                    sim.run(frames=every)
                picture.update()
                writer.grab_frame()
                advance()
    return target


def pictures_of(
    scene: Scene, settings: Settings, frames: int | None, every: int | None, until: float | None = None
) -> tuple[int, int]:
    """Number of pictures of an animation, and frames between two, with what the scene recommends where None is given.

    Raises:
        InputError: if one is out of range, or if both frames and until are given.

    >>> pictures_of(Scene.load("pi"), Settings(dt=0.01), None, None)
    (211, 20)
    >>> pictures_of(Scene.load("pi"), Settings(dt=0.01), None, None, until=20.0)
    (101, 20)
    """
    if until is not None:
        if frames is not None:
            raise InputError(
                f"until must not come with frames; got until={until!r} and frames={frames!r}. Leave one out."
            )
        until = checks.positive("until", until, "[time]")
    if every is None:
        every = frames_between_pictures(scene, settings) or 1
        if until is not None:
            every = max(every, math.ceil(until / settings.dt / (MOST_PICTURES - 1) - 1e-9))
    every = checks.whole("every", every, 1, 10**9, "1 shows every frame.")
    if until is not None:
        frames = pictures_until(until, every, settings)
    if frames is None:
        lasting = None if scene.duration is None else pictures_until(scene.duration, every, settings)
        frames = PICTURES if lasting is None else min(lasting, MOST_PICTURES)
    return checks.whole("frames", frames, 1, 100_000, "Ask for at least one picture."), every


def checked_target(path: str | os.PathLike[str]) -> Path:
    """The path of an animation, after making sure that it can be written.

    Raises:
        InputError: for another ending.
        OutputError: without ffmpeg for .mp4, or if the path cannot be written.
    """
    target = Path(path)
    ending = target.suffix.lower()
    if ending not in (".gif", ".mp4"):
        raise InputError(f"an animation's path must end in .gif or .mp4; got {str(target)!r}. Use {target.stem}.gif.")
    if ending == ".mp4":
        ffmpeg.executable(f"write {str(target.with_suffix('.gif'))!r}")
    try:
        atomic.check_target(target)
    except OSError as error:
        raise OutputError(
            f"an animation must be a file in a folder that exists and can be written to; got {str(target)!r} "
            f"({error.strerror}). Make the folder, or choose another path."
        ) from None
    return target


def pictures_until(end: float, every: int, settings: Settings) -> int:
    """Pictures from time 0 to `end` [time], with so many frames between two.

    >>> pictures_until(1.0, every=20, settings=Settings(dt=0.01))
    6
    """
    return int(end / (every * settings.dt) + 1e-9) + 1


def _writer_for(target: Path, rate: int) -> AbstractMovieWriter:
    if target.suffix.lower() == ".gif":
        return PillowWriter(fps=rate)
    matplotlib.rcParams["animation.ffmpeg_path"] = ffmpeg.executable(f"write {str(target.with_suffix('.gif'))!r}")
    # One thread: on a shared machine it would otherwise take every core.
    return FFMpegWriter(fps=rate, extra_args=["-threads", "1"])


class Picture:
    """The figure of a simulation, brought up to date before each frame of the animation.

    Discs that have left through an absorbing edge are hidden.

    Args:
        sim: what is shown.
        pixels: length of the longer side of the box.
        colour: as in `animate`.
        scale: of the speeds; None: that of the speeds now.
    """

    def __init__(
        self,
        sim: Simulation,
        pixels: int = PIXELS,
        colour: str | None = "speed",
        scale: ColourScale | None = None,
    ):
        if colour is not None:
            checks.choice("colour", colour, KINDS)
        scene = self._scene = sim.scene
        self._sim = sim
        inches = pixels / DPI / max(scene.width, scene.height)
        flat = scene.width > FLAT * scene.height
        size = (0.4, 1.4) if flat else (1.2, 0.5)  # what title and colour bar need
        self.figure: Figure = new_figure(scene.width * inches + size[0], scene.height * inches + size[1])
        self.axes: Axes = self.figure.add_subplot()
        self._kind = KINDS[colour](sim, self.axes, scale) if colour is not None else None
        self._discs = self._draw(scene.position, sim.radii)
        where = {"location": "bottom", "shrink": 0.6, "aspect": 40} if flat else {"location": "right", "shrink": 0.8}
        if self._kind is not None:
            bar = self.figure.colorbar(
                self._discs, ax=self.axes, label=self._kind.label, extend=self._kind.extend, **where
            )
            if self._kind.ticks is not None:
                bar.set_ticks(list(self._kind.ticks), labels=list(self._kind.ticks.values()))
        self._title = self.axes.set_title("time 0.00")
        self._closed = closed_off(scene, 0.0)
        if self._closed is not None:
            self.axes.add_patch(self._closed)
        self.figure.draw_without_rendering()
        # The layout is found once; solving it again for each picture would take most of the time.
        self.figure.set_layout_engine("none")

    def _draw(self, position: NDArray[np.floating], radii: NDArray[np.float64]) -> EllipseCollection:
        """New discs: the sizes of a collection cannot change."""
        discs = draw_discs(self.axes, position, self._scene, radii=radii)
        if self._kind is not None:
            discs.set_array(np.zeros(len(radii)))
            discs.set_cmap(self._kind.colours)
            discs.set_clim(*self._kind.limits)
        self._drawn = len(radii)
        return discs

    def update(self) -> None:
        """Show the simulation as it is now."""
        sim, state = self._sim, self._sim.state
        position, gone = state.position.astype(float), sim.absorbed
        position[gone] = np.nan
        if sim.count != self._drawn:
            self._discs.remove()
            self._discs = self._draw(position, sim.radii)
        self._discs.set_offsets(with_images(position, self._scene))
        if self._kind is not None:
            self._discs.set_array(self._kind.values(sim, state))
        closed = closed_off(self._scene, sim.time)
        if self._closed is not None and closed is not None:
            self._closed.set_bounds(*closed.get_bbox().bounds)
        self._title.set_text(f"time {sim.time:.2f}, {sim.count - int(gone.sum())} discs")


class _Speed:
    """Colour by speed."""

    label, ticks, colours = "speed [length/time]", None, "viridis"

    def __init__(self, sim: Simulation, axes: Axes, scale: ColourScale | None):
        low, high, self.extend = scale or scale_of(speeds_of(sim))
        self.limits = (low, high)

    def values(self, sim: Simulation, state: State) -> NDArray[np.floating]:
        return np.hypot(*state.velocity.T)


class _Worker:
    """Colour by the worker that owns a disc's column."""

    label, extend = "worker", "neither"

    def __init__(self, sim: Simulation, axes: Axes, scale: ColourScale | None):
        sim.columns()  # which refuses methods without columns
        workers = 1 + len(sim.pids)
        self.limits = (-0.5, workers - 0.5)
        self.ticks = {number: str(number) for number in range(workers)} if workers <= len(CATEGORIES) else None
        kinds = [CATEGORIES[number % len(CATEGORIES)] for number in range(workers)]
        self.colours = ListedColormap(kinds)

    def values(self, sim: Simulation, state: State) -> NDArray[np.floating]:
        return sim.columns().owner.astype(float)


class _Parity:
    """Colour by whether the column of a disc is even or odd, over the columns of the start."""

    label, limits, ticks, extend = "column of the disc", (-0.5, 1.5), {0: "even", 1: "odd"}, "neither"
    colours = ListedColormap(["#56B4E9", "#D55E00"])

    def __init__(self, sim: Simulation, axes: Axes, scale: ColourScale | None):
        number = sim.columns().number
        for column in range(number):
            edges = sim.scene.width / number * np.array([column, column + 1])
            axes.axvspan(*edges, color=self.colours(column % 2), alpha=0.15, linewidth=0, zorder=0)

    def values(self, sim: Simulation, state: State) -> NDArray[np.floating]:
        return (sim.columns().of_disc % 2).astype(float)


KINDS: dict[str, Any] = {"speed": _Speed, "worker": _Worker, "parity": _Parity}
"""What discs can be coloured by."""

CATEGORIES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")
"""Colours of Okabe & Ito, neighbours far apart."""


@contextlib.contextmanager
def _bar(total: int, wanted: bool | Callable[[int, int], None]) -> Iterator[Callable[[], None]]:
    """A progress bar on standard error, if that is a terminal; or calls of a function."""
    if callable(wanted):
        done = itertools.count(1)
        yield lambda: wanted(next(done), total)
        return
    console = Console(stderr=True)
    if not (wanted and console.is_terminal):  # a disabled Progress of rich before 14.3 prints a line nevertheless
        yield lambda: None
        return
    columns = (TextColumn("animation"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("animation", total=total)
        yield lambda: bar.advance(task)
