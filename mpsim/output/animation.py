"""Animations: discs at true radius, coloured by speed, written frame by frame to a GIF or an MP4."""

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.text import Text
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mpsim import checks
from mpsim.engine.simulation import Simulation
from mpsim.errors import OutputError
from mpsim.output.figures import STYLE, draw_discs, new_figure
from mpsim.scene import Scene
from mpsim.settings import Settings

PIXELS = 480
"""Length of the longer side of the box in a picture."""

DPI = 100


def animate(
    scene: Scene,
    settings: Settings | None,
    path: str | os.PathLike[str],
    frames: int = 200,
    *,
    every: int = 1,
    pictures_per_second: int = 25,
    progress: bool = True,
) -> Path:
    """Simulate a scene and write it as an animation.

    Args:
        scene, settings: what is simulated and how (None: the defaults).
        path: ends in .gif (always possible) or .mp4 (needs ffmpeg on the PATH). An existing file is replaced.
        frames: pictures, >= 1; the first shows the start.
        every: frames of the simulation from one picture to the next, >= 1.
        pictures_per_second: of the animation, 1 to 50.
        progress: show a progress bar, if standard error is a terminal.

    Returns:
        The path that was written.

    Raises:
        OutputError: for another ending, without ffmpeg for .mp4, or if the path cannot be written; before any work.
        InputError: for numbers out of range.

    >>> import tempfile
    >>> scene = Scene.random(count=20, packing=0.3, radius=0.5, seed=2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     animate(scene, Settings(dt=0.02), f"{folder}/gas.gif", frames=3, every=5).stat().st_size > 1000
    True
    """
    frames = checks.whole("frames", frames, 1, 100_000, "Ask for at least one picture.")
    every = checks.whole("every", every, 1, 10**9, "1 shows every frame.")
    rate = checks.whole("pictures_per_second", pictures_per_second, 1, 50, "25 looks smooth.")
    target = Path(path)
    writer = _writer_for(target, rate)
    with Simulation(scene, settings) as sim, matplotlib.rc_context(fname=STYLE), _bar(frames, progress) as advance:
        figure, discs, title = _draw(sim)
        with writer.saving(figure, str(target), DPI):
            for picture in range(frames):
                if picture:
                    sim.run(frames=every)
                state = sim.state
                discs.set_offsets(state.position)
                discs.set_array(np.hypot(*state.velocity.T))
                title.set_text(f"time {sim.time:.2f}, {sim.count} discs")
                writer.grab_frame()
                advance()
    return target


def _writer_for(target: Path, rate: int) -> AbstractMovieWriter:
    """The writer for a path's ending, after making sure that it will be able to write."""
    ending = target.suffix.lower()
    if ending not in (".gif", ".mp4"):
        raise OutputError(f"an animation's path must end in .gif or .mp4; got {str(target)!r}. Use {target.stem}.gif.")
    if ending == ".mp4" and not FFMpegWriter.isAvailable():
        gif = target.with_suffix(".gif")
        raise OutputError(f"an .mp4 needs ffmpeg, which is not on the PATH. Write {str(gif)!r} or install ffmpeg.")
    folder = target.absolute().parent
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise OutputError(f"the folder of {str(target)!r} must exist and be writable. Make it, or choose another path.")
    # One thread of ffmpeg: on a shared machine it would otherwise take every core.
    return PillowWriter(fps=rate) if ending == ".gif" else FFMpegWriter(fps=rate, extra_args=["-threads", "1"])


def _draw(sim: Simulation) -> tuple[Figure, EllipseCollection, Text]:
    """Figure of the start, the discs in it, and its title; colours span the speeds of nearly all discs."""
    scene = sim.scene
    speeds = np.hypot(*scene.velocity.T)
    longest = max(scene.width, scene.height)
    inches = PIXELS / DPI / longest
    figure = new_figure(scene.width * inches + 1.2, scene.height * inches + 0.5)
    axes = figure.add_subplot()
    draw_discs(axes, scene.position, scene)
    discs = axes.collections[0]
    assert isinstance(discs, EllipseCollection)
    discs.set_array(speeds)
    discs.set_cmap("viridis")
    discs.set_clim(0, max(1.5 * float(np.quantile(speeds, 0.9)) if len(speeds) else 1.0, 1e-300))
    figure.colorbar(discs, ax=axes, label="speed [length/time]", shrink=0.8)
    title = axes.set_title("time 0.00")
    figure.canvas.draw()
    figure.set_layout_engine("none")  # found once; solving it again for every picture would take most of the time
    return figure, discs, title


@contextlib.contextmanager
def _bar(total: int, wanted: bool) -> Iterator[Callable[[], None]]:
    """A progress bar on standard error, if that is a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("animation"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not (wanted and console.is_terminal)) as bar:
        task = bar.add_task("animation", total=total)
        yield lambda: bar.advance(task)
