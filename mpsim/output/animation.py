"""Animations: discs at true radius, written frame by frame as GIF or MP4."""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path, PosixPath

import matplotlib
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter
from numpy.typing import NDArray

from mpsim.core import atomic, checks
from mpsim.core.progress import checked_progress, is_watched, of_frames
from mpsim.engine.frame_count import frames_until
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError, MpsimError, OutputError
from mpsim.output import ffmpeg
from mpsim.output.colour_scale import SCALES, ColourScale, ScaleName, percentile_scale, sampled
from mpsim.output.drawing import STYLE, THEMES, ThemeName
from mpsim.output.gif import GifWriter
from mpsim.output.moving_picture import DPI, KINDS, PIXELS, Moment, Picture, kept, moment_of
from mpsim.scene.recommended import frames_between_pictures, settings_for
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

PICTURES, MOST_PICTURES = 200, 300
"""Default number of pictures of a scene without a duration, and the largest of one with a duration."""

LONGEST = 100_000
"""Pictures of an animation at most."""

MOST_SHOWN = 20_000_000
"""Bytes of an animation that a notebook shows: the output of the cell holds them."""


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


@checks.known_names()
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
    seconds: float | None = None,
    scale: ScaleName = "linear",
    theme: ThemeName = "light",
) -> Animation:
    """Simulate a scene and write it as an animation.

    With colour="speed", the colour bar runs from the 2nd to the 98th percentile of the speeds in all pictures, and
    arrows show that speeds lie outside. To find these, the whole run is simulated before the first picture is drawn.

    Args:
        scene, settings: what is simulated and how; settings=None: those that the scene recommends, or the defaults.
        path: needed; ends in .gif, or .mp4 (needs ffmpeg, or the extra `film`). An existing file is replaced.
        frames: number of pictures, >= 1; the first shows the start. None: as many as the scene's duration needs, up to
            MOST_PICTURES; 200 without a duration.
        every: frames of the simulation from one picture to the next, >= 1; None: the scene's picture_interval, or 1.
        pictures_per_second: of the animation, 1 to 50 [1/s].
        pixels: length of the longer side of the box in a picture, 100 to 4000.
        colour: "speed"; "worker", by the worker that owns the column of a disc, or "parity", by whether that column is
            even or odd, which shows the passes (both need a method with columns, `grid` or `parallel`;
            `auto` then stands for the latter); None: one colour for all.
        progress: True: shown on standard error, if that is a terminal or a notebook; or a function, called as
            progress(done, of).
        until: time of the last picture [time], > 0, in place of `frames`; without `every` too, MOST_PICTURES at most
            are spread evenly over it.
        seconds: how long the animation lasts [s], > 0, in place of `frames`. Without `every`, its pictures are spread
            over the time to `until`, else over the scene's duration. It is then a little shorter if the frames of the
            simulation do not divide evenly, and ends early if there are fewer of them than pictures.
        scale: "linear" or "log": how speeds become colours. The latter distinguishes slow discs when a gas cools down.
        theme: "light" or "dark".

    Returns:
        The path that was written. A notebook shows the animation itself if it is smaller than 20 MB.

    Raises:
        OutputError: without ffmpeg for .mp4, or if the path cannot be written; before any work.
        InputError: for another ending, for numbers that are out of range or contradict each other, for an unknown word,
            and for a colour that needs columns with a method without them.

    >>> import tempfile
    >>> scene = Scene.random(count=20, packing=0.3, radius=0.5, seed=2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     animate(scene, Settings(dt=0.02), f"{folder}/gas.gif", frames=3, every=5).stat().st_size > 1000
    True
    """
    _demand_path(settings, path)
    settings = settings_for(scene, settings)
    rate = checks.whole("pictures_per_second", pictures_per_second, 1, 50, "25 looks smooth.")
    frames, every = pictures_of(scene, settings, frames, every, until, seconds, rate)
    pixels = checks.whole("pixels", pixels, 100, 4000, "480 suits a page.")
    look = THEMES[checks.choice("theme", theme, THEMES)]
    _check_colours(colour, scale)
    target = checked_target(path)
    if colour in ("worker", "parity") and settings.method == "auto":  # which may choose one without columns
        settings = dataclasses.replace(settings, method="parallel")
    checked_progress(progress, "progress(done, of)")
    seen = of_frames(progress if callable(progress) or is_watched() else None, "pictures")
    simulated = Simulation(scene, settings)
    with _writing(target), simulated as sim, matplotlib.rc_context(fname=STYLE), seen as show:
        writer = _writer_for(target, rate)
        with _moments(sim, frames, every, colour, scale) as (moments, found):
            picture = Picture(sim, pixels, colour, found, look)
            with atomic.atomic_write(target) as file, writer.saving(picture.figure, file.name, DPI):
                for number, moment in enumerate(moments, start=1):
                    picture.show(moment)
                    writer.grab_frame()
                    if show is not None:
                        show(number, frames)
    return Animation(target)


@contextlib.contextmanager
def _writing(target: Path) -> Iterator[None]:
    """Say which file cannot be written."""
    try:
        yield
    except OSError as error:
        if isinstance(error, MpsimError):
            raise
        raise OutputError(
            f"an animation must be a file with room on its disk; got {str(target)!r} ({error.strerror or error}). Make "
            "room, or choose another path."
        ) from error


def _check_colours(colour: object, scale: object) -> None:
    """Refuse an unknown colour, and a scale for a colour without one."""
    if colour is not None:
        checks.choice("colour", colour, KINDS)
    if checks.choice("scale", scale, SCALES) == "log" and colour != "speed":
        raise InputError(f"scale='log' must come with colour='speed'; got colour={colour!r}. Leave one out.")


@contextlib.contextmanager
def _moments(
    sim: Simulation, frames: int, every: int, colour: str | None, scale: ScaleName
) -> Iterator[tuple[Iterator[Moment], ColourScale | None]]:
    """The moments of an animation, and the scale of their colours; by speed, all of them have been simulated."""
    sample: list[NDArray[np.floating]] = []

    def taken() -> Iterator[Moment]:
        for number in range(frames):
            if number:
                sim.run(frames=every)
            moment = moment_of(sim, colour)
            if colour == "speed":
                sample.append(sampled(moment.values[moment.present]))
            yield moment

    if colour != "speed":
        yield taken(), None
        return
    with kept(taken()) as moments:
        yield moments, percentile_scale(np.concatenate(sample), scale)


def pictures_of(
    scene: Scene,
    settings: Settings,
    frames: int | None,
    every: int | None,
    until: float | None = None,
    seconds: float | None = None,
    rate: int = 25,
) -> tuple[int, int]:
    """Number of pictures of an animation, and frames between two; None stands for what the scene recommends.

    The arguments are those of `animate`; rate: pictures per second.

    Raises:
        InputError: if one is out of range, or if they contradict each other.

    >>> pictures_of(Scene.load("pi"), Settings(dt=0.01), None, None)
    (211, 20)
    >>> pictures_of(Scene.load("pi"), Settings(dt=0.01), None, None, until=20.0)
    (101, 20)
    >>> pictures_of(Scene.load("pi"), Settings(dt=0.01), None, None, until=20.0, seconds=4)
    (96, 21)
    """
    given = {"frames": frames, "until": until, "seconds": seconds}
    named = ", ".join(f"{name}={value!r}" for name, value in given.items() if value is not None)
    if frames is not None and (until is not None or seconds is not None):
        raise InputError(f"frames must not come with until or seconds; got {named}. Leave one out.")
    if every is not None:
        every = checks.whole("every", every, 1, 10**9, "1 shows every frame.")
        if until is not None and seconds is not None:
            raise InputError(
                f"every must not come with both until and seconds; got {named}, every={every}. Leave one out."
            )
    until = None if until is None else checks.positive("until", until, "[time]")
    most = MOST_PICTURES if seconds is None else _pictures_in(checks.positive("seconds", seconds, "[s]"), rate)
    between = every or frames_between_pictures(scene, settings) or 1
    end = scene.duration if until is None else until
    if end is not None and frames is None:
        frames_until(end, settings.dt, "the scene's duration" if until is None else "until")  # refused
    if seconds is not None and (every is not None or end is None):
        return most, between
    if end is not None and every is None and (until is not None or seconds is not None):
        least = 1 if seconds is not None else between
        between = max(least, math.ceil(end / settings.dt / max(most - 1, 1) - 1e-9))
    if frames is None:
        lasting = PICTURES if end is None else pictures_until(end, between, settings)
        if until is None or every is None:
            return min(lasting, most), between
        if lasting > LONGEST:
            raise InputError(
                f"until must be at most {(LONGEST - 1) * every * settings.dt:g} with every={every}, {LONGEST:,} "
                f"pictures; got {until:g}. Use a larger every, or stop earlier."
            )
        return lasting, between
    return checks.whole("frames", frames, 1, LONGEST, "Ask for at least one picture."), between


def _pictures_in(seconds: float, rate: int) -> int:
    """Pictures of an animation that lasts so long [s]."""
    if seconds * rate > LONGEST:
        raise InputError(
            f"seconds must be at most {LONGEST / rate:g} with {rate} pictures per second, {LONGEST:,} pictures; got "
            f"{seconds:g}."
        )
    return max(round(seconds * rate), 1)


def _demand_path(settings: object, path: object) -> None:
    """Refuse an animation without a path, or with the path in the place of the settings."""
    if isinstance(settings, str | os.PathLike):
        raise InputError(
            f"settings must be mpsim.Settings or None; got {os.fspath(settings)!r}. Write path={os.fspath(settings)!r}."
        )
    if not isinstance(path, str | os.PathLike) or not path:
        raise InputError(f"animate must be given a path; got {checks.brief(path)}. Write path='animation.gif'.")


def checked_target(path: str | os.PathLike[str]) -> Path:
    """The path of an animation, after a check that it can be written.

    Raises:
        InputError: for another ending.
        OutputError: without ffmpeg for .mp4, or if the path cannot be written.
    """
    target = Path(path)
    ending = target.suffix.lower()
    if ending not in (".gif", ".mp4"):
        still = " One picture is made by mpsim.draw or `mpsim plot`." if ending in (".png", ".pdf", ".svg") else ""
        raise InputError(
            f"an animation's path must end in .gif or .mp4; got {str(target)!r}. Use {target.stem}.gif.{still}"
        )
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
        return GifWriter(fps=rate)
    matplotlib.rcParams["animation.ffmpeg_path"] = ffmpeg.executable(f"write {str(target.with_suffix('.gif'))!r}")
    # One thread: on a shared machine it would otherwise take every core.
    return FFMpegWriter(fps=rate, extra_args=["-threads", "1"])
