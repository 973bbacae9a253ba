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
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mpsim import checks
from mpsim.engine.simulation import Simulation
from mpsim.errors import OutputError
from mpsim.output.drawing import STYLE, behind_piston, draw_discs, new_figure, with_images
from mpsim.scene import Scene
from mpsim.settings import Settings

PIXELS = 480
"""Length of the longer side of the box in a picture."""

DPI = 100

FLAT = 2.5
"""Ratio of width to height from which the colour bar lies below the box."""


def animate(
    scene: Scene,
    settings: Settings | None,
    path: str | os.PathLike[str],
    frames: int = 200,
    *,
    every: int = 1,
    pictures_per_second: int = 25,
    pixels: int = PIXELS,
    progress: bool = True,
) -> Path:
    """Simulate a scene and write it as an animation.

    Args:
        scene, settings: what is simulated and how (None: the defaults).
        path: ends in .gif (always possible) or .mp4 (needs ffmpeg on the PATH). An existing file is replaced.
        frames: number of pictures, >= 1; the first shows the start.
        every: frames of the simulation from one picture to the next, >= 1.
        pictures_per_second: of the animation, 1 to 50 [1/s].
        pixels: length of the longer side of the box in a picture, 100 to 4000.
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
    pixels = checks.whole("pixels", pixels, 100, 4000, "480 suits a page.")
    target = Path(path)
    writer = _writer_for(target, rate)
    with Simulation(scene, settings) as sim, matplotlib.rc_context(fname=STYLE), _bar(frames, progress) as advance:
        picture = Picture(sim, pixels)
        with writer.saving(picture.figure, str(target), DPI):
            for number in range(frames):
                if number:
                    sim.run(frames=every)
                picture.update()
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


class Picture:
    """The figure of a simulation, brought up to date before each frame of the animation.

    Colours span the speeds of nearly all discs of the start. Discs that have left through an absorbing edge are hidden.
    """

    def __init__(self, sim: Simulation, pixels: int = PIXELS):
        scene = self._scene = sim.scene
        self._sim = sim
        inches = pixels / DPI / max(scene.width, scene.height)
        flat = scene.width > FLAT * scene.height
        size = (0.4, 1.4) if flat else (1.2, 0.5)  # what title and colour bar need
        self.figure: Figure = new_figure(scene.width * inches + size[0], scene.height * inches + size[1])
        self._axes = self.figure.add_subplot()
        speeds = np.hypot(*scene.velocity.T)
        moving = [float(np.hypot(*np.asarray(emitter.velocity))) for emitter in scene.emitters]
        typical = float(np.quantile(speeds, 0.9)) if len(speeds) else 0.0
        self._fastest = max(1.5 * typical, *moving, 1e-300) if moving else max(1.5 * typical or 1.0, 1e-300)
        self._discs = self._draw(scene.position, sim.radii)
        where = {"location": "bottom", "shrink": 0.6, "aspect": 40} if flat else {"location": "right", "shrink": 0.8}
        self.figure.colorbar(self._discs, ax=self._axes, label="speed [length/time]", **where)
        self._title = self._axes.set_title("time 0.00")
        self._closed = behind_piston(scene, 0.0)
        if self._closed is not None:
            self._axes.add_patch(self._closed)
        self.figure.canvas.draw()
        # The layout is found once; solving it again for each picture would take most of the time.
        self.figure.set_layout_engine("none")

    def _draw(self, position: NDArray[np.floating], radii: NDArray[np.float64]) -> EllipseCollection:
        """New discs: the sizes of a collection cannot change."""
        discs = draw_discs(self._axes, position, self._scene, radii=radii)
        discs.set_array(np.zeros(len(radii)))
        discs.set_cmap("viridis")
        discs.set_clim(0, self._fastest)
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
        self._discs.set_array(np.hypot(*state.velocity.T))
        closed = behind_piston(self._scene, sim.time)
        if self._closed is not None and closed is not None:
            self._closed.set_bounds(*closed.get_bbox().bounds)
        self._title.set_text(f"time {sim.time:.2f}, {sim.count - int(gone.sum())} discs")


@contextlib.contextmanager
def _bar(total: int, wanted: bool) -> Iterator[Callable[[], None]]:
    """A progress bar on standard error, if that is a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("animation"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not (wanted and console.is_terminal)) as bar:
        task = bar.add_task("animation", total=total)
        yield lambda: bar.advance(task)
