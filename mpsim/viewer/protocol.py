"""Messages between a simulation and its pages: pictures as bytes, all else as JSON.

All numbers are little-endian. A message of bytes begins with HEADER, of 96 bytes:

```text
 offset  type        what
      0  4 bytes     "MPSV"
      4  uint8       version of this format
      5  uint8       kind: 1 a picture, 2 radii
      6  uint16      stage: 0, or 1 for the second of two
      8  uint32      serial number of the picture, by which the page acknowledges it; of radii 0
     12  uint32      N, number of discs; of radii 1 if they are all equal
     16  uint64      frame of the simulation
     24  float64     simulated time
     32  4 float64   walls now: x_low, x_high, y_low, y_high
     64  2 float64   width and height that positions are fractions of: those of the scene
     80  2 float64   speed of byte KNEE and of byte FASTEST
     96  N x 2 uint16, then N x uint8: x and y, 0 to 65535, and the speed as a colour; or N x float32: radii
```

So a disc takes 5 bytes. Its colour is a byte from 0 to FASTEST, or ABSORBED for an absent disc, which is not drawn. The
message `colours` says what the colours show.

A page sends only text, of the form `{"do": NAME, ...}`, with exactly the arguments of this command. A command is
declared once, by `command` before the method `do_NAME` that carries it out.
"""

import struct
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import orjson
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.state import Box
from mpsim.engine.solvers.base import InPlace
from mpsim.errors import InputError
from mpsim.features.obstacles import filled_parts
from mpsim.kernels.output import paint_places
from mpsim.output.drawing import PAGE
from mpsim.scene.scene import Scene
from mpsim.viewer.colouring import SpeedScale

if TYPE_CHECKING:
    from mpsim.viewer.server import Pages

MAGIC, VERSION = b"MPSV", 1
PICTURE, RADII = 1, 2
HEADER = struct.Struct("<4sBBHIIQd4d2d2d")
STEPS = 65535  # number of steps across the box in which positions are sent: 0.03 pixels if the box is 1,920 pixels wide


class Header(NamedTuple):
    """The header of a picture; see the top of this file."""

    serial: int
    frame: int
    time: float
    walls: Box
    extent: tuple[float, float]  # width and height of the scene
    scale: SpeedScale
    stage: int = 0


class UnpackedPicture(NamedTuple):
    """An unpacked picture: its header, positions, rounded to STEPS, shape (N, 2) [length], and colours, shape (N,)."""

    header: Header
    position: NDArray[np.float64]
    colour: NDArray[np.uint8]


def pack(
    header: Header,
    discs: InPlace,
    periodic: tuple[bool, bool] = (False, False),
    colours: NDArray[np.uint8] | None = None,
    *,
    plain: bool = False,
) -> bytearray:
    """A picture as bytes.

    Args:
        header, discs: content of the picture.
        periodic: the axes along which discs outside the box are wrapped into it.
        colours: colour of each disc by number, shape (N,); None: from the speeds, by header.scale.
        plain: pack in Python. It takes some microseconds a disc, but loading the first kernel takes over half a second.
    """
    count = len(discs.number)
    packed = bytearray(HEADER.size + 5 * count)
    packed[: HEADER.size] = _header(PICTURE, header.serial, count, header)
    places = np.frombuffer(packed, "<u2", 2 * count, HEADER.size)
    painted = np.frombuffer(packed, np.uint8, count, HEADER.size + 4 * count)
    paint = getattr(paint_places, "py_func", paint_places) if plain else paint_places
    paint(discs.x, discs.y, discs.number, *header.extent, *periodic, STEPS, places)
    if colours is None:
        header.scale.colours(discs, out=painted, plain=plain)
    else:
        painted[:] = colours
    return packed


def _header(kind: int, serial: int, count: int, header: Header) -> bytes:
    numbers = (*header.walls, *header.extent, header.scale.usual, header.scale.fastest)
    return HEADER.pack(MAGIC, VERSION, kind, header.stage, serial, count, header.frame, header.time, *numbers)


def pack_radii(radii: NDArray[np.float64], header: Header) -> bytes:
    """Radii as bytes: all of them, or only one if they are equal. They apply to all following pictures."""
    each = np.asarray(radii[:1] if len(radii) and (radii == radii[0]).all() else radii, "<f4")
    return _header(RADII, 0, len(each), header) + each.tobytes()


def unpack(packed: bytes | bytearray) -> UnpackedPicture:
    """Read back a picture from `pack`."""
    _, _, _, stage, serial, count, frame, time, x_low, x_high, y_low, y_high, width, height, *scale = (
        HEADER.unpack_from(packed)
    )
    walls = (x_low, x_high, y_low, y_high)
    header = Header(serial, frame, time, walls, (width, height), SpeedScale(*scale), stage)
    places = np.frombuffer(packed, "<u2", 2 * count, HEADER.size).reshape(count, 2)
    position = places * (np.array(header.extent) / STEPS)
    return UnpackedPicture(header, position, np.frombuffer(packed, np.uint8, count, HEADER.size + 4 * count))


def unpack_radii(packed: bytes) -> NDArray[np.float32]:
    """Read back radii from `pack_radii`, shape (N,), or (1,) if all are equal [length]."""
    return np.frombuffer(packed, "<f4", offset=HEADER.size)


# --- commands from pages

MOST_BYTES = 4096  # largest length of a message from a page; a longer one closes its connection
MOST_NUMBER = 1e100  # largest absolute value of a place, velocity or parameter from a page

Check = Callable[[str, Any], Any]
"""Checks an argument. Called as check(name, value), it returns the value or raises InputError."""


class Command(NamedTuple):
    """A command that pages can send."""

    arguments: Mapping[str, Check]  # their names and checks
    replaces: bool = False  # whether it replaces a waiting one of the same page, with the same `id` if it has one


COMMANDS: dict[str, Command] = {}  # all commands by name, from `command`

Method = TypeVar("Method", bound=Callable[..., Any])


def command(*, replaces: bool = False, **arguments: Check) -> Callable[[Method], Method]:
    """Declare the method `do_NAME` of a source as the command NAME; its parameters are the arguments."""

    def declare(method: Method) -> Method:
        COMMANDS[method.__name__.removeprefix("do_")] = Command(arguments, replaces)
        return method

    return declare


def whole(low: int, high: int) -> Check:
    """A check for whole numbers from low to high."""
    return lambda name, value: checks.whole(name, value, low, high, "See docs/howto/live-view.md.")


def one_of(choices: Collection[str]) -> Check:
    """A check for one of several words."""
    return lambda name, value: checks.choice(name, value, choices)


def number(name: str, value: Any) -> float:
    """Check a number."""
    return checks.between(name, value, -MOST_NUMBER, MOST_NUMBER)


DISC = whole(0, 2**31 - 1)  # checks the number of a disc

COMMANDS |= {"ack": Command({"serial": whole(1, 2**32 - 1)}), "visible": Command({"value": checks.truth})}


class Action(NamedTuple):
    """A command that a page has sent, with the values of its arguments."""

    name: str
    values: Mapping[str, Any]


def read_action(text: str | bytes) -> Action:
    """Read a command, or raise InputError if the message is not valid."""
    if len(text) > MOST_BYTES:
        raise InputError(f"a message must have at most {MOST_BYTES} characters; got {len(text)}. Send less.")
    try:
        message = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise InputError(f"a message must be JSON; got {checks.brief(text)} ({error!s:.60}).") from None
    if not isinstance(message, dict):
        raise InputError(f"a message must be an object of JSON; got {checks.brief(message)}.")
    name = checks.choice("do of a message", message.pop("do", None), COMMANDS)
    arguments = COMMANDS[name].arguments
    if set(message) != set(arguments):
        raise InputError(
            f"a message to {name} must have the fields {sorted(arguments)}, besides do; "
            f"got {checks.brief(sorted(message))}."
        )
    return Action(name, {argument: check(argument, message[argument]) for argument, check in arguments.items()})


# --- messages to pages


def text_of(kind: str, values: Mapping[str, Any]) -> str:
    """A message for pages as JSON, its kind in `type`; numbers that are not finite become null.

    >>> text_of("gauges", {"temperature": float("nan")})
    '{"type":"gauges","temperature":null}'
    """
    message = {"type": kind, **values}
    try:
        return orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY).decode()
    except TypeError:  # a text that is not UTF-8, such as the name of a file
        return orjson.dumps(in_utf8(message), option=orjson.OPT_SERIALIZE_NUMPY).decode()


def in_utf8(value: Any) -> Any:
    """A value whose texts have an escape in place of each character that UTF-8 cannot express."""
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, Mapping):
        return {in_utf8(name): in_utf8(each) for name, each in value.items()}
    return [in_utf8(each) for each in value] if isinstance(value, list | tuple) else value


# --- sending to all pages of a view


class Stage(NamedTuple):
    """The picture on one stage: its discs, from `pack`, and their radii, from `pack_radii`."""

    packed: bytes | bytearray
    radii: bytes  # the same object until the radii change


class SentPicture(NamedTuple):
    """A picture for the pages: its number, from 1; the obstacles at its time; and one or two stages."""

    serial: int
    capsules: NDArray[np.float64]
    stages: tuple[Stage, ...]


class Broadcast:
    """Packs pictures and messages, once for all pages."""

    def __init__(self, audience: "Pages", scene: Scene):
        self._audience = audience
        self.scene: Scene = scene  # may be replaced
        self.scale: SpeedScale = SpeedScale(1.0, 2.0)  # maps speeds to colours in the next pictures
        self._serial = 0
        self._radii: dict[int, tuple[int, bytes]] = {}  # of each stage: number of discs, and packed
        self._capsules: NDArray[np.float64] | None = None
        self._time = 0.0
        self._last: dict[str, str] = {}

    def forget_radii(self) -> None:
        """Send the radii again with the next picture: the discs or their radii have changed."""
        self._radii = {}

    def show(
        self,
        discs: InPlace,
        colours: NDArray[np.uint8] | None = None,
        second: InPlace | None = None,
        *,
        plain: bool = False,
    ) -> None:
        """Send a picture of discs, and of a second stage; colours: of both, None: by speed; plain: as `pack`."""
        self._serial += 1
        self._time = discs.time
        capsules = self._told_capsules()
        stages = [self._stage(k, each, colours, plain) for k, each in enumerate((discs, second)) if each is not None]
        self._audience.show(SentPicture(self._serial, capsules, tuple(stages)))

    def _stage(self, stage: int, discs: InPlace, colours: NDArray[np.uint8] | None, plain: bool) -> Stage:
        scene, count = self.scene, len(discs.number)
        header = Header(
            self._serial, discs.frame, discs.time, discs.box, (scene.width, scene.height), self.scale, stage
        )
        if stage not in self._radii or self._radii[stage][0] != count:
            self._radii[stage] = count, pack_radii(discs.radii, header)
        fitting = None if colours is None or len(colours) != count else colours
        return Stage(pack(header, discs, scene.periodic, fitting, plain=plain), self._radii[stage][1])

    def tell_scene(self, name: str, **more: Any) -> None:
        """Send what rarely changes: the scene, the colours of its parts, and more values from its source."""
        fixed: dict[str, Any] = {each: getattr(self.scene, each) for each in ("width", "height", "periodic")}
        fixed["theme"] = {each: getattr(PAGE, each) for each in ("ground", "behind", "solid")}
        self.tell("scene", {"version": VERSION, "name": name, **fixed, **more})
        self._told_capsules()

    def _told_capsules(self) -> NDArray[np.float64]:
        """The obstacles at the time of the last picture, sent if they differ from those sent before."""
        capsules = self.scene.capsules_at(self._time)
        if capsules is not self._capsules:
            self._capsules = capsules
            obstacles = self.scene.obstacles
            numbers = np.repeat(np.arange(len(obstacles)), [len(each.capsules()) for each in obstacles])
            filled = [[part.start, part.stop] for part in filled_parts(obstacles)]
            self.tell_if_new("obstacles", {"capsules": capsules, "numbers": numbers, "filled": filled})
        return capsules

    def tell(self, kind: str, values: Mapping[str, Any]) -> None:
        """Send a message of this kind; see `text_of`."""
        self._last[kind] = text_of(kind, values)
        self._audience.tell(kind, self._last[kind])

    def tell_if_new(self, kind: str, values: Mapping[str, Any]) -> None:
        """Send a message of this kind, unless it equals the last one."""
        if text_of(kind, values) != self._last.get(kind):
            self.tell(kind, values)
