"""Files to download from a view: the session, the scene, a program, a film."""

import dataclasses
import inspect
import io
import math
import subprocess
import tempfile
import zipfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mpsim.engine.changes import Change
from mpsim.engine.journal import Journal
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError, MpsimError, OutputError
from mpsim.features import FEATURES
from mpsim.features.piston import PISTON
from mpsim.output import animation
from mpsim.scene import scenefile, settings
from mpsim.scene.scene import Scene
from mpsim.viewer import wire
from mpsim.viewer.broadcast import SentPicture
from mpsim.viewer.colouring import ABSORBED, FASTEST

# --- Makes a film of the latest pictures of a view, as GIF or MP4
#
# Two stages are drawn side by side. Each picture shows the walls as they were at its time.

SECONDS, PICTURES_A_SECOND = 6, 20
"""Longest duration of a film [s], and its pictures per second."""

MOST_BYTES = 2**26
"""Largest size of the kept pictures of both stages, in bytes."""

MOST_DISCS = 150_000
"""Largest number of discs in all pictures of a film together: some seconds of drawing. With more discs, some pictures
are left out."""

PIXELS, FINER = 480, 2
"""Pixels of the longer side of the box, and the factor by which it is drawn finer, so that edges are smooth."""

GAP = 8
"""Pixels between two stages."""

SMALL = 1.5
"""Radius below which a disc is drawn as a square of 2 x 2 pixels, in pixels as drawn."""

VIRIDIS = np.array(
    [[0x44, 0x01, 0x54], [0x47, 0x2D, 0x7B], [0x3B, 0x52, 0x8B], [0x2C, 0x72, 0x8E], [0x21, 0x91, 0x8C],
     [0x28, 0xAE, 0x80], [0x5E, 0xC9, 0x62], [0xAD, 0xDC, 0x30], [0xFD, 0xE7, 0x25]], float
)  # fmt: skip
"""Nine colours of the map viridis, as on the page; colours between them are interpolated linearly."""

GROUND, CLOSED, SOLID = (255, 255, 255), (154, 163, 173), (58, 63, 69)


class Film:
    """Keeps the pictures of the last seconds. It starts afresh when a second stage begins or ends."""

    def __init__(self) -> None:
        self._kept: deque[SentPicture] = deque()
        self._extent = (0.0, 0.0)
        self._next = 0.0

    def add(self, picture: SentPicture, now: float) -> None:
        """Keep a picture, if it is time for one; now: time of a clock [s]."""
        if now < self._next:
            return
        extent = wire.HEADER.unpack_from(picture.packed)[12:14]
        if extent != self._extent:  # another scene
            self._kept.clear()
            self._extent = extent
        self._next = max(self._next + 1 / PICTURES_A_SECOND, now + 0.5 / PICTURES_A_SECOND)
        if self._kept and (self._kept[-1].second is None) != (picture.second is None):
            self._kept.clear()
        self._kept.append(picture)
        while len(self._kept) > SECONDS * PICTURES_A_SECOND or (len(self._kept) > 1 and self._bytes() > MOST_BYTES):
            self._kept.popleft()

    def _bytes(self) -> int:
        """Bytes of all kept arrays. Pictures mostly share radii and walls with the picture before; these count once."""
        held = {id(each): each for picture in self._kept for each in _buffers(picture)}
        return sum(each.nbytes if isinstance(each, np.ndarray) else len(each) for each in held.values())

    def pictures(self) -> list[SentPicture]:
        """The kept pictures, the oldest first."""
        return list(self._kept)


def _buffers(picture: SentPicture) -> Iterator[bytes | bytearray | NDArray[np.float64]]:
    yield from (picture.packed, picture.radii, picture.capsules)
    if picture.second is not None:
        yield from (picture.second.packed, picture.second.radii)


def gif(pictures: Sequence[SentPicture]) -> bytes:
    """Encode pictures as a GIF that repeats forever.

    Raises:
        InputError: if there are no pictures.
    """
    frames, step = _frames(pictures)
    palette = frames[-1].quantize(128)
    indexed = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    file = io.BytesIO()
    indexed[0].save(
        file, "GIF", save_all=True, append_images=indexed[1:], loop=0, duration=step * 1000 // PICTURES_A_SECOND
    )
    return file.getvalue()


def mp4(pictures: Sequence[SentPicture]) -> bytes:
    """Encode pictures as an MP4 (H.264).

    Raises:
        InputError: if there are no pictures.
        OutputError: if ffmpeg is missing or fails.
    """
    encoder = animation.executable("take the film as a GIF")
    frames, step = _frames(pictures)
    width, height = (side - side % 2 for side in frames[0].size)  # H.264 needs even sides
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        size = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
        rate = ["-framerate", f"{PICTURES_A_SECOND}/{step}", "-i", "-", "-threads", "1"]
        coded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-loglevel", "error"]
        raw = b"".join(frame.crop((0, 0, width, height)).tobytes() for frame in frames)
        done = subprocess.run([encoder, *size, *rate, *coded, str(path)], input=raw, capture_output=True, check=False)
        if done.returncode:
            raise OutputError(
                f"an .mp4 needs an ffmpeg that encodes H.264; it ended with {done.returncode} "
                f"({done.stderr.decode(errors='replace')[-200:]!r}). Take the film as a GIF."
            )
        return path.read_bytes()


def _frames(pictures: Sequence[SentPicture]) -> tuple[list[Image.Image], int]:
    """Draw every n-th picture, with n such that drawing takes a few seconds at most; returns the drawings and n.

    Raises:
        InputError: if there are no pictures.
    """
    if not pictures:
        raise InputError("a film needs pictures; got none yet. Show the simulation in the page first.")
    last = pictures[-1]
    each = max((len(last.packed) + len(b"" if last.second is None else last.second.packed)) // 5, 1)
    step = -(-len(pictures) * each // MOST_DISCS)
    return [_drawn(shown) for shown in pictures[::step]], step


def _drawn(shown: SentPicture) -> Image.Image:
    """Draw one picture: one stage, or both side by side."""
    first = _stage(shown.packed, shown.radii, shown.capsules)
    if shown.second is None:
        return first
    both = Image.new("RGB", (2 * first.width + GAP, first.height), CLOSED)
    both.paste(first, (0, 0))
    both.paste(_stage(shown.second.packed, shown.second.radii, shown.capsules), (first.width + GAP, 0))
    return both


def _stage(packed: bytes | bytearray, packed_radii: bytes, capsules: NDArray[np.float64]) -> Image.Image:
    """Draw one stage. The box fills the image."""
    header, position, colour = wire.unpack(packed)
    radii = np.broadcast_to(wire.unpack_radii(packed_radii).astype(np.float64), len(colour))
    width, height = header.extent
    scale = FINER * PIXELS / max(width, height)
    size = max(round(width * scale), FINER), max(round(height * scale), FINER)
    image = Image.new("RGB", size, CLOSED)
    draw = ImageDraw.Draw(image)
    x_low, x_high, y_low, y_high = (value * scale for value in header.walls)
    draw.rectangle((x_low, size[1] - y_high, x_high, size[1] - y_low), GROUND)
    for ax, ay, bx, by, radius in (capsules * scale).tolist():
        draw.line((ax, size[1] - ay, bx, size[1] - by), SOLID, max(round(2 * radius), FINER))
        for x, y in ((ax, ay), (bx, by)):
            draw.ellipse((x - radius, size[1] - y - radius, x + radius, size[1] - y + radius), SOLID)
    here = colour != ABSORBED
    centres = np.column_stack([position[here, 0] * scale, size[1] - position[here, 1] * scale])
    _draw_discs(draw, centres, np.asarray(radii[here] * scale, np.float64), _colours(colour[here]))
    return image.resize((size[0] // FINER, size[1] // FINER), Image.Resampling.BOX)


def _draw_discs(
    draw: ImageDraw.ImageDraw, centres: NDArray[np.float64], radii: NDArray[np.float64], colours: NDArray[np.uint8]
) -> None:
    tinted = map(tuple, colours.tolist())
    for (x, y), radius, colour in zip(centres.tolist(), radii.tolist(), tinted, strict=True):
        if radius < SMALL:
            draw.rectangle((x - 1, y - 1, x, y), colour)
        else:
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), colour)


def _colours(bytes_: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colours of the discs as on the page, shape (N, 3)."""
    at = np.minimum(bytes_ / FASTEST, 1.0) * (len(VIRIDIS) - 1)
    steps = np.arange(len(VIRIDIS))
    return np.column_stack([np.interp(at, steps, channel) for channel in VIRIDIS.T]).round().astype(np.uint8)


# --- Makes the files to download from a view: the session, the present scene, a program
#
# They are made in memory, or in a temporary folder that is removed before the answer is sent. No name from a page ever
# becomes a path.

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
    return {name: getattr(scene, name) for name in inspect.signature(Scene).parameters if name not in settings.NAMES}


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
