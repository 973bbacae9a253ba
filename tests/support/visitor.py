"""A page of a live view without a browser. It reads the protocol by itself, from the description of the format."""

import io
import json
import struct
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np
from websockets.sync.client import connect

import mpsim

PATIENCE = 150.0  # seconds for what must come, on a busy machine

HEADER = struct.Struct("<4sBBHIIQd4d2d2d")
PICTURE, RADII = 1, 2
KNEE, FASTEST, ABSORBED = 223, 254, 255
STEPS = 65535


class Picture(NamedTuple):
    """A picture of one stage; `scale` has the speeds of the colours KNEE and FASTEST."""

    stage: int
    serial: int
    frame: int
    time: float
    walls: tuple[float, ...]
    extent: tuple[float, ...]
    scale: tuple[float, ...]
    position: np.ndarray
    colour: np.ndarray


def read(message: bytes) -> tuple[int, int, Any]:
    """Kind and stage of a message of bytes, and its radii or its picture."""
    magic, version, kind, stage, serial, count, frame, moment, *numbers = HEADER.unpack_from(message)
    assert (magic, version) == (b"MPSV", 1)
    if kind == RADII:
        assert len(message) == HEADER.size + 4 * count
        return kind, stage, np.frombuffer(message, "<f4", count, HEADER.size)
    assert (kind, len(message)) == (PICTURE, HEADER.size + 5 * count)
    places = np.frombuffer(message, "<u2", 2 * count, HEADER.size).reshape(count, 2)
    colour = np.frombuffer(message, np.uint8, count, HEADER.size + 4 * count)
    walls, extent, scale = tuple(numbers[:4]), tuple(numbers[4:6]), tuple(numbers[6:])
    position = places * (np.array(extent) / STEPS)
    return kind, stage, Picture(stage, serial, frame, moment, walls, extent, scale, position, colour)


class Visitor:
    """A connection to a view.

    Attributes:
        last: messages by kind.
        stages, radii: what came last for each stage.
        pictures: number of pictures of the first stage.
        raw: messages of bytes, in order.
    """

    def __init__(self, address: str, visible: bool = False, **options: Any):
        where = urlsplit(address)
        # Without a limit of its queue: behind a full one lies the end of the connection, for which a close waits 10 s.
        unlimited = {"max_size": None, "max_queue": None}
        options = {"origin": f"http://{where.netloc}", "compression": None, **unlimited, **options}
        self._connected = connect(f"ws://{where.netloc}{where.path}socket", **options)
        self.socket = self._connected.__enter__()
        self.last: dict[str, dict[str, Any]] = {}
        self.stages: list[Any] = [None, None]
        self.radii: list[Any] = [None, None]
        self.raw: list[bytes] = []
        self.pictures = 0
        if visible:
            self.say("visible", value=True)

    def __enter__(self) -> "Visitor":
        return self

    def __exit__(self, *exception: object) -> None:
        self._connected.__exit__(*exception)

    def say(self, do: str, **values: Any) -> None:
        self.socket.send(json.dumps({"do": do, **values}))

    def hear(self, timeout: float | None = None, ack: bool = True) -> str:
        """Take the next message; returns its kind."""
        message = self.socket.recv(timeout)
        if isinstance(message, str):
            found = json.loads(message)
            self.last[found["type"]] = found
            return found["type"]
        self.raw.append(message)
        kind, stage, content = read(message)
        if kind == RADII:
            self.radii[stage] = content
            return "radii"
        self.stages[stage] = content
        if stage == 0:  # it comes last, and stands for both
            self.pictures += 1
            if ack:
                self.say("ack", serial=content.serial)
        return "picture"

    def hear_until(self, holds: Callable[["Visitor"], Any], ack: bool = True) -> Any:
        """Take messages until something holds."""
        end = time.monotonic() + PATIENCE
        while not (found := holds(self)):
            try:
                self.hear(max(end - time.monotonic(), 0.001), ack)
            except TimeoutError:
                raise AssertionError(f"it did not come; heard last: {self.last}, {self.stages}") from None
        return found

    def hear_for(self, seconds: float, ack: bool = True) -> None:
        """Take what comes for some time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            with suppress(TimeoutError):
                self.hear(left, ack)

    def settle(self) -> None:
        """Hear all that follows from what was said before. It sets the speed to 1 and clears the note of the status."""
        for speed in (2.0, 1.0):  # of several messages at a time a page may hear the later one first
            self.say("speed", value=speed)
            self.hear_until(lambda v, speed=speed: v.last.get("status", {}).get("speed") == speed)

    def do(self, name: str, /, **values: Any) -> dict[str, Any]:
        """Do something by hand; returns what is said of it."""
        notes = self.last.get("hands", {}).get("notes", 0)
        self.say(name, **values)
        self.settle()
        hands = self.hear_until(lambda v: v.last.get("hands"))
        return {**hands, "note": hands["note"] if hands["notes"] > notes else None}

    def step_to(self, frame: int) -> None:
        """Run to a frame and no further, and see it."""
        self.hear_until(lambda v: v.phase == "paused" and v.frame >= 0)
        if frame != self.frame:
            self.say("step", frames=frame - self.frame)
        self.hear_until(lambda v: v.frame == frame)

    def refused(self, name: str, /, **values: Any) -> str:
        """Do something that cannot be done; returns why, as the status says."""
        self.settle()
        self.say(name, **values)
        return self.hear_until(lambda v: v.last["status"]["note"])

    def gauges_at(self, frame: int) -> dict[str, Any]:
        """The numbers beside the picture of a frame."""
        self.hear_until(lambda v: v.last.get("gauges", {}).get("frame") == frame)
        return self.last["gauges"]

    @property
    def picture(self) -> Any:
        return self.stages[0]

    @property
    def phase(self) -> str | None:
        return self.last.get("status", {}).get("phase")

    @property
    def frame(self) -> int:
        return -1 if self.picture is None else self.picture.frame

    @property
    def values(self) -> dict[str, Any]:
        """The parameters that the page offers, and their values."""
        return {each["name"]: each["value"] for each in self.last["hands"]["parameters"]}


@contextmanager
def viewed(source: Any, settings: Any = None, **options: Any) -> Iterator[mpsim.View]:
    """A view that is open, without a browser."""
    with mpsim.view(source, settings, browser=False, wait=False, **options) as view:
        yield view


@contextmanager
def paused(source: Any, settings: Any = None, **options: Any) -> Iterator[Visitor]:
    """The visible page of a view that waits; its attribute `view` is the view."""
    with viewed(source, settings, playing=False, **options) as view, Visitor(view.address, visible=True) as page:
        page.view = view
        begun = lambda v: {"hands", "pair"} <= v.last.keys() or "timeline" in v.last  # noqa: E731
        page.hear_until(lambda v: v.phase == "over" or (v.phase == "paused" and v.picture is not None and begun(v)))
        assert page.phase == "paused", page.last["status"]["note"]
        yield page


def fetch(address: str, method: str = "GET", path: str = "", **headers: str) -> HTTPResponse:
    """The answer of a view to a request; `path` is added to that of the address."""
    where = urlsplit(address)
    connection = HTTPConnection(where.netloc, timeout=20)
    try:
        connection.putrequest(method, where.path + path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        answer.body = answer.read()
        return answer
    finally:
        connection.close()


def downloaded(address: str, name: str) -> bytes:
    """A file that a page can keep."""
    answer = fetch(address, path=f"keep/{name}")
    assert answer.status == 200, answer.body
    return answer.body


def unpacked(content: bytes, folder: Path) -> list[str]:
    """Extract an archive; returns the names of its files."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(folder)
        return sorted(archive.namelist())


class Kept(NamedTuple):
    """What the session file of a view says: frame, digest, and the names of all changes."""

    frame: int
    digest: str
    changes: list[str]


def kept(address: str) -> Kept:
    """What a view has simulated so far."""
    return read_session(downloaded(address, "session.zip"))


def read_session(content: bytes) -> Kept:
    """What the archive of a session says."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        tables = tomllib.loads(archive.read("session.toml").decode())
    return Kept(tables["frame"], tables["digest"], [each["what"] for each in tables.get("change", [])])


@contextmanager
def replayed(address: str, **options: Any) -> Iterator[mpsim.Simulation]:
    """The simulation of a view as it is now, from its session file."""
    with tempfile.TemporaryDirectory() as folder:
        unpacked(downloaded(address, "session.zip"), Path(folder))
        with mpsim.Simulation.replay(Path(folder) / "session.toml", **options) as sim:
            yield sim


def digest_alone(scene: mpsim.Scene, settings: mpsim.Settings, frames: int) -> str:
    """Digest of a run that nobody watches."""
    with mpsim.Simulation(scene, settings) as sim:
        sim.run(frames=frames)
        return sim.digest()
