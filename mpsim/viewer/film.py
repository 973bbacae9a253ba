"""Makes a film of the latest pictures of a view, as GIF or MP4.

Two stages are drawn side by side. Each picture shows the walls as they were at its time.
"""

import io
import subprocess
import tempfile
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mpsim.errors import InputError, OutputError
from mpsim.output import ffmpeg
from mpsim.viewer import wire
from mpsim.viewer.broadcast import Shown
from mpsim.viewer.colours import ABSORBED, FASTEST

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
        self._kept: deque[Shown] = deque()
        self._extent = (0.0, 0.0)
        self._next = 0.0

    def add(self, picture: Shown, now: float) -> None:
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

    def pictures(self) -> list[Shown]:
        """The kept pictures, the oldest first."""
        return list(self._kept)


def _buffers(picture: Shown) -> Iterator[bytes | bytearray | NDArray[np.float64]]:
    yield from (picture.packed, picture.radii, picture.capsules)
    if picture.second is not None:
        yield from (picture.second.packed, picture.second.radii)


def gif(pictures: Sequence[Shown]) -> bytes:
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


def mp4(pictures: Sequence[Shown]) -> bytes:
    """Encode pictures as an MP4 (H.264).

    Raises:
        InputError: if there are no pictures.
        OutputError: if ffmpeg is missing or fails.
    """
    encoder = ffmpeg.executable("take the film as a GIF")
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


def _frames(pictures: Sequence[Shown]) -> tuple[list[Image.Image], int]:
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


def _drawn(shown: Shown) -> Image.Image:
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
