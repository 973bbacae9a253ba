"""Animations: discs at true radius, drawn frame by frame and written as GIF or MP4."""

from __future__ import annotations

import base64
import contextlib
import itertools
import math
import os
import pickle
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path, PosixPath
from typing import IO, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from mpsim.core import checks, files
from mpsim.core.late import imported
from mpsim.core.progress import checked_progress, of_frames
from mpsim.core.state import Box
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import frames_until
from mpsim.errors import InputError, OutputError
from mpsim.output import drawing
from mpsim.output.drawing import ColourScale, MovingDiscs, ScaleName, Theme, ThemeName
from mpsim.scene.scene import Scene, frames_between_pictures, settings_for
from mpsim.scene.settings import Settings

# --- A picture of a simulation that is updated for each frame of an animation

PIXELS = 480  # length of the longer side of the box in a picture

DPI = 100

IN_MEMORY = 2**27  # bytes of moments that are kept in memory; what is more lies in a file


class Shot(NamedTuple):
    """What a picture shows of a simulation of N discs."""

    time: float
    walls: Box
    position: NDArray[np.float32]  # shape (N, 2); NaN of absorbed discs
    radius: NDArray[np.float32]  # shape (N,)
    values: NDArray[np.float32]  # numbers to colour by, shape (N,), or (0,) if there are none

    @property
    def present(self) -> NDArray[np.bool_]:
        """Which discs have not been absorbed, shape (N,)."""
        return np.isfinite(self.position[:, 0])


def moment_of(sim: Simulation, coloured: bool) -> Shot:
    """The present moment; coloured: whether by speed."""
    state = sim.state
    assert state.box is not None  # the walls of a simulation are known
    position = state.position.astype(np.float32)
    position[~state.present] = np.nan
    values = drawing.speeds_of(state.velocity) if coloured else np.zeros(0)
    return Shot(sim.time, state.box, position, sim.radii.astype(np.float32), values.astype(np.float32))


class Picture:
    """The figure of a scene, in which each moment of an animation is shown; absorbed discs are hidden.

    scale: of the speeds; None: one colour.
    """

    def __init__(self, scene: Scene, pixels: int, scale: ColourScale | None, theme: Theme = drawing.LIGHT):
        self._scene = scene
        inches = pixels / DPI / max(scene.width, scene.height)
        size = scene.width * inches, scene.height * inches
        with matplotlib.rc_context(theme.style, fname=drawing.STYLE):
            self.figure: Figure = drawing.figure_around(scene, size, beside=(1.2, 0.5), below=(0.4, 1.4), theme=theme)
            self.axes: Axes = self.figure.add_subplot()
            self._moving = MovingDiscs(self.axes, scene, scene.position, scene.radii, scale, theme=theme)
            if scale is not None:
                drawing.colour_bar(self.axes, self._moving.discs, scene, drawing.SPEED, scale.outside)
            self._title = self.axes.set_title("time 0.00")
        self.figure.draw_without_rendering()
        # The layout is found once; solving it again for each picture would take most of the time.
        self.figure.set_layout_engine("none")

    def show(self, moment: Shot) -> None:
        """Show a moment."""
        capsules = self._scene._capsules_at(moment.time)
        self._moving.show(moment.position, moment.radius, moment.values, moment.walls, capsules)
        number = int(np.count_nonzero(moment.present))
        self._title.set_text(f"time {moment.time:.2f}, {number} disc{'s' * (number != 1)}")


# --- Writes films: GIFs with one palette for all frames, without bands or flicker; MP4 by ffmpeg

SAMPLE = 8  # pictures from which the palette is made


def image_of(figure: Figure) -> Image.Image:
    """A figure as it is now, in pixels, whatever a program has set for its own figures."""
    canvas = figure.canvas if isinstance(figure.canvas, FigureCanvasAgg) else FigureCanvasAgg(figure)
    figure.dpi = DPI
    canvas.draw()
    size = canvas.get_width_height()
    return Image.frombuffer("RGBA", size, bytes(canvas.buffer_rgba()), "raw", "RGBA", 0, 1).convert("RGB")


def write_gif(file: str | os.PathLike[str] | IO[bytes], images: Iterable[Image.Image], rate: float) -> None:
    """Write images, at least one, as a GIF at a rate [1/s], with the 256 colours that suit a selection of them best."""
    every = list(images)
    chosen = [every[index] for index in np.unique(np.linspace(0, len(every) - 1, SAMPLE).round().astype(int))]
    palette = Image.fromarray(np.concatenate([np.asarray(image) for image in chosen])).quantize(256)
    first, *rest = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in every)
    first.save(file, format="GIF", save_all=True, append_images=rest, duration=int(1000 / rate), loop=0)


def _write_mp4(path: str, images: Iterator[Image.Image], rate: float, instead: str) -> None:
    """Write images, at least one, as an MP4; an OutputError without ffmpeg says what to do `instead`."""
    first = next(images)
    width, height = (side - side % 2 for side in first.size)  # H.264 needs even sides
    taken = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-framerate", f"{rate:g}", "-i", "-"]
    # One thread: on a shared machine it would otherwise take every core.
    made = ["-threads", "1", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-loglevel", "error"]
    command = [executable(instead), *taken, *made, "-y", path]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None  # the pipe
        try:
            for image in itertools.chain([first], images):
                process.stdin.write(image.crop((0, 0, width, height)).tobytes())
        except BrokenPipeError:  # it has ended, and says why
            pass
        except BaseException:
            process.kill()
            raise
        _, words = process.communicate()
    if process.returncode:
        raise OutputError(
            f"an .mp4 needs an ffmpeg that encodes H.264; it ended with {process.returncode} "
            f"({words.decode(errors='replace')[-200:]!r}). {instead[:1].upper()}{instead[1:]}."
        )


def executable(instead: str) -> str:
    """The path of ffmpeg: the system's, or that of the package imageio-ffmpeg, which the extra `film` installs.

    Raises:
        OutputError: if neither is found; `instead` says what to do without it.
    """
    if (found := shutil.which("ffmpeg")) is not None:
        return found
    try:
        return imported("imageio_ffmpeg", "an .mp4", "film", f"install ffmpeg, or {instead}").get_ffmpeg_exe()
    except RuntimeError as error:  # a build of the package without one
        raise OutputError(f"an .mp4 needs ffmpeg, which was not found ({error}). Install it, or {instead}.") from None


# --- Animations: discs at true radius, written frame by frame as GIF or MP4

PICTURES, MOST_PICTURES = 200, 300
"""Default number of pictures of a scene without a duration, and the largest of one with a duration."""

LONGEST = 100_000  # pictures of an animation at most
MOST_SHOWN = 20_000_000  # bytes of an animation that a notebook shows: the output of the cell holds them


class Animation(PosixPath):
    """The path of an animation, which a notebook shows as the animation itself."""

    def _repr_html_(self) -> str | None:
        """The file inside an HTML tag; None, so that the path is shown, if it is too large or no longer there."""
        if not self.is_file() or self.stat().st_size > MOST_SHOWN:
            return None
        content = base64.b64encode(self.read_bytes()).decode()
        if self.suffix.lower() == ".mp4":
            return f'<video controls loop autoplay muted src="data:video/mp4;base64,{content}"></video>'
        return f'<img src="data:image/gif;base64,{content}">'


def animate(
    scene: Scene,
    settings: Settings | None = None,
    path: str | os.PathLike[str] = "",
    frames: int | None = None,
    *,
    every: int | None = None,
    pictures_per_second: int = 25,
    pixels: int = PIXELS,
    colour: str | None = "speed",
    progress: bool | Callable[[int, int], None] = True,
    until: float | None = None,
    scale: ScaleName = "linear",
    theme: ThemeName = "light",
) -> Animation:
    """Simulate a scene and write it as an animation.

    With colour="speed", the colour bar runs from the 2nd to the 98th percentile of the speeds in all pictures, and
    arrows show that speeds lie outside. To find these, the whole run is simulated before the first picture is drawn.

    Args:
        scene, settings: what is simulated and how; settings=None: those that the scene recommends, or the defaults.
        path: needed; ends in .gif, or .mp4 (needs ffmpeg, or the extra `film`). An existing file is replaced.
        frames: number of pictures, >= 1; the first shows the start. None: as many as `until`, or else the scene's
            duration, needs, up to MOST_PICTURES; 200 without a duration.
        every: frames of the simulation from one picture to the next, >= 1. None: the scene's picture_interval, or 1;
            with `until` so many that the pictures are spread evenly over that time.
        pictures_per_second: of the animation, 1 to 50 [1/s].
        pixels: length of the longer side of the box in a picture, 100 to 4000.
        colour: "speed"; None: one colour for all.
        progress: True: shown on standard error, if that is a terminal or a notebook; or a function, called as
            progress(done, of).
        until: time of the last picture [time], > 0. With `frames` there may be fewer of them, if the frames of the
            simulation do not divide evenly.
        scale: "linear" or "log": how speeds become colours. The latter distinguishes slow discs when a gas cools down.
        theme: "light" or "dark".

    Returns:
        The path that was written. A notebook shows the animation itself if it is smaller than 20 MB.

    Raises:
        OutputError: without ffmpeg for .mp4, or if the path cannot be written; before any work.
        InputError: for another ending, for numbers that are out of range or contradict each other, and for an unknown
            word.

    >>> import tempfile
    >>> scene = Scene.random(count=20, packing=0.3, radius=0.5, seed=2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     animate(scene, Settings(dt=0.02), f"{folder}/gas.gif", frames=3, every=5).stat().st_size > 1000
    True
    """
    _demand_path(settings, path)
    settings = settings_for(scene, settings)
    rate = checks.whole("pictures_per_second", pictures_per_second, 1, 50, "25 looks smooth.")
    frames, every = pictures_of(scene, settings, frames, every, until)
    pixels = checks.whole("pixels", pixels, 100, 4000, "480 suits a page.")
    look = drawing.THEMES[checks.choice("theme", theme, drawing.THEMES)]
    if colour is not None:
        checks.choice("colour", colour, ["speed"])
    if checks.choice("scale", scale, drawing.SCALES) == "log" and colour is None:
        raise checks.refusal("scale='log'", "come with colour='speed'", f"colour={colour!r}", "Leave one out.")
    target = checked_target(path)
    checked_progress(progress, "progress(done, of)")
    seen = of_frames(progress, "pictures")
    simulated = Simulation(scene, settings)
    with (
        files.writable("an animation", target, "be a file with room on its disk", "Make room, or choose another path."),
        simulated as sim,
        seen as show,
        moments_of(sim, frames, every, colour, scale) as (moments, found),
        files.atomic_write(target) as file,
    ):
        picture = Picture(scene, pixels, found, look)

        def images() -> Iterator[Image.Image]:
            for number, moment in enumerate(moments, start=1):
                picture.show(moment)
                yield image_of(picture.figure)
                if show is not None:
                    show(number, frames)

        if target.suffix.lower() == ".mp4":
            _write_mp4(file.name, images(), rate, _instead_of(target))
        else:
            write_gif(file.name, images(), rate)
    return Animation(target)


def _instead_of(target: Path) -> str:
    return f"write {str(target.with_suffix('.gif'))!r}"


@contextlib.contextmanager
def moments_of(
    sim: Simulation, frames: int, every: int, colour: str | None, scale: ScaleName
) -> Iterator[tuple[Iterator[Shot], ColourScale | None]]:
    """The moments of an animation, and the scale of their colours; by speed, all of them have been simulated.

    Then they are kept until they are drawn, large ones in a temporary file.
    """
    sample: list[NDArray[np.floating]] = []

    def taken() -> Iterator[Shot]:
        for number in range(frames):
            if number:
                sim.run(frames=every)
            moment = moment_of(sim, colour is not None)
            if colour is not None:
                sample.append(drawing.sampled(moment.values[moment.present]))
            yield moment

    if colour is None:
        yield taken(), None
        return
    with tempfile.SpooledTemporaryFile(IN_MEMORY) as file:
        for moment in taken():
            pickle.dump(moment, file, pickle.HIGHEST_PROTOCOL)
        file.seek(0)
        yield (pickle.load(file) for _ in range(frames)), drawing.percentile_scale(np.concatenate(sample), scale)


def pictures_of(
    scene: Scene, settings: Settings, frames: int | None, every: int | None, until: float | None = None
) -> tuple[int, int]:
    """Number of pictures of an animation, and frames between two; None stands for what the scene recommends.

    >>> pictures_of(Scene.load("pi"), Settings(dt=0.01), None, None)
    (211, 20)
    >>> pictures_of(Scene.load("pi"), Settings(dt=0.01), None, None, until=20.0)
    (101, 20)
    >>> pictures_of(Scene.load("pi"), Settings(dt=0.01), 100, None, until=20.0)
    (96, 21)
    """
    most = MOST_PICTURES
    if frames is not None:
        most = checks.whole("frames", frames, 1, LONGEST, "Ask for at least one picture.")
    if every is not None:
        every = checks.whole("every", every, 1, 10**9, "1 shows every frame.")
        if frames is not None and until is not None:
            raise checks.refusal("every", "not come with both frames and until", str(every), "Leave one out.")
    between = every or frames_between_pictures(scene, settings) or 1
    if frames is not None and until is None:
        return most, between
    end = scene.duration if until is None else checks.positive("until", until, "[time]")
    if end is None:
        return PICTURES, between
    steps = frames_until(end, settings.dt, "the scene's duration" if until is None else "until")
    if until is not None and every is None:
        between = max(between if frames is None else 1, math.ceil(steps / max(most - 1, 1)))
    lasting = int(end / (between * settings.dt) + 1e-9) + 1
    if until is None or every is None:
        return min(lasting, most), between
    if lasting > LONGEST:
        rule = f"be at most {(LONGEST - 1) * every * settings.dt:g} with every={every}, {LONGEST:,} pictures"
        raise checks.refusal("until", rule, f"{until:g}", "Use a larger every, or stop earlier.")
    return lasting, between


def _demand_path(settings: object, path: object) -> None:
    if isinstance(settings, str | os.PathLike):
        raise InputError(
            f"settings must be mpsim.Settings or None; got {os.fspath(settings)!r}. Write path={os.fspath(settings)!r}."
        )
    if not isinstance(path, str | os.PathLike) or not path:
        raise InputError(f"animate must be given a path; got {checks.brief(path)}. Write path='animation.gif'.")


def checked_target(path: str | os.PathLike[str]) -> Path:
    """The path of an animation, after a check that it can be written."""
    target = Path(path)
    ending = target.suffix.lower()
    if ending not in (".gif", ".mp4"):
        instead = f"Use {target.stem}.gif. One picture is made by mpsim.draw or `mpsim plot`."
        raise checks.refusal("an animation's path", "end in .gif or .mp4", repr(str(target)), instead)
    if ending == ".mp4":
        executable(_instead_of(target))
    rule = "be a file in a folder that exists and can be written to"
    with files.writable("an animation", target, rule, "Make the folder, or choose another path."):
        files.check_target(target)
    return target
