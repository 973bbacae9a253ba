"""The format of messages between a simulation and its pages: pictures as bytes, all else as JSON.

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

A page sends only text, of the form `{"do": NAME, ...}`, with exactly the fields that ACTIONS lists for this name. A new
kind of action needs one more line there.
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.state import Box
from mpsim.engine import parameters
from mpsim.engine.solvers.base import InPlace
from mpsim.errors import InputError
from mpsim.kernels.output import paint_places
from mpsim.measure.registry import ERRORS
from mpsim.scene.settings import CONTACTS, METHODS, PRECISIONS
from mpsim.viewer import link
from mpsim.viewer.colouring import CHOICES, SpeedScale
from mpsim.viewer.link import MOST_DIVISIONS, QUICKEST, SLOWEST

MAGIC, VERSION = b"MPSV", 1
PICTURE, RADII = 1, 2
HEADER = struct.Struct("<4sBBHIIQd4d2d2d")
STEPS = 65535
"""Number of steps across the box in which positions are sent: 0.03 pixels if the box is 1,920 pixels wide."""

MOST_BYTES = 4096
"""Largest length of a message from a page; a longer one closes its connection."""

MOST_STEPS = 10_000
"""Largest number of frames in the action `step`."""

MOST_PLACES = 100
"""Largest number of places in the action `stroke`."""

MOST_NUMBER, MOST_WHOLE = 1e100, 10**9
"""Largest absolute value of a place, velocity or parameter from a page, and of a whole number."""


@dataclass(frozen=True)
class Header:
    """The header of a picture; see the top of this file.

    Attributes:
        serial: number of the picture.
        frame, time: frame and time of the simulation.
        walls: present positions of the walls [length].
        extent: width and height of the scene [length].
        scale: maps speeds to colours.
        stage: 0, or 1 for the second of two.
    """

    serial: int
    frame: int
    time: float
    walls: Box
    extent: tuple[float, float]
    scale: SpeedScale
    stage: int = 0


class UnpackedPicture(NamedTuple):
    """An unpacked picture.

    Attributes:
        header: its header.
        position: positions of the discs, rounded to STEPS, shape (N, 2) [length].
        colour: colours of the discs, shape (N,), uint8.
    """

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

    >>> from mpsim.core.state import State
    >>> from mpsim.engine.solvers.base import in_place
    >>> state, box = State(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]])), (0.0, 4.0, 0.0, 4.0)
    >>> header = Header(7, 10, 0.5, box, (4.0, 4.0), SpeedScale(5.0, 10.0))
    >>> packed = pack(header, in_place(state, box, 10, 0.5, np.ones(1)))
    >>> len(packed), unpack(packed).position.round(3).tolist(), unpack(packed).colour.tolist()
    (101, [[1.0, 2.0]], [223])
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
    """Radii as bytes: all of them, or only one if they are equal. They apply to all following pictures.

    >>> header = Header(1, 0, 0.0, (0.0, 4.0, 0.0, 4.0), (4.0, 4.0), SpeedScale(5.0, 10.0))
    >>> unpack_radii(pack_radii(np.full(1000, 0.5), header)).tolist()
    [0.5]
    """
    each = np.asarray(radii[:1] if len(radii) and (radii == radii[0]).all() else radii, "<f4")
    return _header(RADII, 0, len(each), header) + each.tobytes()


def unpack(message: bytes | bytearray | memoryview) -> UnpackedPicture:
    """A picture from its bytes.

    Raises:
        InputError: if it is not a picture of this version, or is too short or too long.
    """
    header, count = _unpacked(message, PICTURE, 5)
    places = np.frombuffer(message, "<u2", 2 * count, HEADER.size).reshape(count, 2)
    position = places * (np.array(header.extent) / STEPS)
    return UnpackedPicture(header, position, np.frombuffer(message, np.uint8, count, HEADER.size + 4 * count))


def unpack_radii(message: bytes | bytearray | memoryview) -> NDArray[np.float32]:
    """Radii from their bytes, shape (N,), or (1,) if all are equal [length].

    Raises:
        InputError: as `unpack`.
    """
    _, count = _unpacked(message, RADII, 4)
    return np.frombuffer(message, "<f4", count, HEADER.size)


def _unpacked(message: bytes | bytearray | memoryview, kind: int, size: int) -> tuple[Header, int]:
    """The header of a message and its number of discs; kind, size: expected kind, and bytes per disc."""
    if len(message) < HEADER.size:
        raise InputError(f"a picture must have at least {HEADER.size} bytes; got {len(message)}. Ask for another.")
    magic, version, found, stage, serial, count, frame, time, *numbers = HEADER.unpack_from(message)
    if (magic, version, found) != (MAGIC, VERSION, kind) or stage > 1:
        raise InputError(
            f"a picture must begin with {MAGIC!r}, version {VERSION}, kind {kind} and stage 0 or 1; got {magic!r}, "
            f"{version}, {found} and {stage}. Use the mpsim that sent it."
        )
    if len(message) != HEADER.size + size * count:
        raise InputError(
            f"a picture of {count} discs must have {HEADER.size + size * count} bytes; got {len(message)}. "
            "Ask for another."
        )
    x_low, x_high, y_low, y_high, width, height, usual, fastest = numbers
    walls = (x_low, x_high, y_low, y_high)
    return Header(serial, frame, time, walls, (width, height), SpeedScale(usual, fastest), stage), count


# --- messages from pages

Field = Callable[[str, Any], Any]
"""Checks a value. Called as field(name, value), it returns the value or raises InputError."""


def _whole(low: int, high: int) -> Field:
    return lambda name, value: checks.whole(name, value, low, high, "See docs/howto/live-view.md.")


def _speed(name: str, value: Any) -> float | None:
    return None if value is None else checks.between(name, value, SLOWEST, QUICKEST)


def _number(name: str, value: Any) -> float:
    return checks.between(name, value, -MOST_NUMBER, MOST_NUMBER)


def _parameter(name: str, value: Any) -> str:
    return checks.choice(name, value, parameters.NAMES)


def _parameter_value(name: str, value: Any) -> Any:
    """A number, a pair of numbers, or a word. The simulation checks which of them the parameter takes."""
    if isinstance(value, list) and len(value) == 2:
        return [_number(name, each) for each in value]
    if isinstance(value, str):
        return checks.choice(name, value, CONTACTS)
    if isinstance(value, int) and not isinstance(value, bool):
        return checks.whole(name, value, -MOST_WHOLE, MOST_WHOLE, "Send a smaller one.")
    return _number(name, value)


def _places(name: str, value: Any) -> list[list[float]]:
    if (
        not isinstance(value, list)
        or not 1 <= len(value) <= MOST_PLACES
        or not all(isinstance(each, list) and len(each) == 2 for each in value)
    ):
        raise InputError(
            f"{name} must be a list of 1 to {MOST_PLACES} places, each [x, y]; got {checks.brief(value)}. Send others."
        )
    return [[_number(name, each) for each in place] for place in value]


def _budget(name: str, value: Any) -> float:
    return checks.between(name, value, 1 / MOST_NUMBER, MOST_NUMBER)


def _measure(name: str, value: Any) -> str:
    return checks.choice(name, value, ERRORS)


def _beside(name: str, value: Any) -> dict[str, Any] | None:
    """The changed settings of the second stage; None: no second stage."""
    if value is None:
        return None
    if not isinstance(value, dict) or not value.keys() <= BESIDE.keys():
        raise InputError(f"{name} must be an object with {', '.join(BESIDE)}, or null; got {checks.brief(value)}.")
    return {each: BESIDE[each](f"{each} of {name}", found) for each, found in value.items()}


def _link(name: str, value: Any) -> link.Link:
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text; got {checks.brief(value)}.")
    return link.read(value)


_DISC = _whole(0, 2**31 - 1)

BESIDE: Mapping[str, Field] = {
    "method": lambda name, value: checks.choice(name, value, METHODS),
    "contact": lambda name, value: checks.choice(name, value, CONTACTS),
    "precision": lambda name, value: checks.choice(name, value, PRECISIONS),
    "passes": _whole(1, MOST_DIVISIONS),
    "frames": _whole(1, MOST_DIVISIONS),
}
"""Settings that can differ in a second stage, and their checks; frames: number of its frames in one of the first."""

ACTIONS: Mapping[str, Mapping[str, Field]] = {
    "ack": {"serial": _whole(1, 2**32 - 1)},
    "visible": {"value": checks.truth},
    "play": {},
    "pause": {},
    "step": {"frames": _whole(1, MOST_STEPS)},
    "speed": {"value": _speed},
    "reset": {},
    "count": {"value": checks.truth},
    "colour": {"by": lambda name, value: checks.choice(name, value, CHOICES)},
    # for a recording, see playback.py
    "seek": {"index": _whole(0, 2**31 - 1)},
    "follow": {"value": checks.truth},
    "pass": {},
    "grid": {},
    "snapshot": {},
    "return": {},
    "seed": {"value": _whole(0, MOST_WHOLE)},
    "beside": {"settings": _beside},
    "open": {"link": _link},
    "tune": {"measure": _measure, "budget": _budget},
    "stop_tuning": {},
    # changes by hand, see hands.py; same: it continues the action before, and is undone together with it
    "hold": {"id": _DISC, "x": _number, "y": _number},
    "release": {"id": _DISC, "vx": _number, "vy": _number},
    "add": {"x": _number, "y": _number, "same": checks.truth},
    "stroke": {"places": _places, "same": checks.truth},
    "remove": {"id": _DISC, "same": checks.truth},
    "wall": {"ax": _number, "ay": _number, "bx": _number, "by": _number},
    "change": {"name": _parameter, "value": _parameter_value, "same": checks.truth},
    "undo": {},
}
"""The actions that a page can send: the fields of each, and their checks."""


@dataclass(frozen=True)
class Action:
    """An action that a page has sent: a name among ACTIONS, and the values of its fields."""

    name: str
    values: Mapping[str, Any]


def read_action(text: str | bytes) -> Action:
    """Read the action in a message.

    Raises:
        InputError: if the message is not a valid action.

    >>> read_action('{"do": "speed", "value": 0.5}')
    Action(name='speed', values={'value': 0.5})
    """
    if len(text) > MOST_BYTES:
        raise InputError(f"a message must have at most {MOST_BYTES} characters; got {len(text)}. Send less.")
    try:
        message = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise InputError(f"a message must be JSON; got {checks.brief(text)} ({error!s:.60}).") from None
    if not isinstance(message, dict):
        raise InputError(f"a message must be an object of JSON; got {checks.brief(message)}.")
    name = checks.choice("do of a message", message.pop("do", None), ACTIONS)
    fields = ACTIONS[name]
    if set(message) != set(fields):
        raise InputError(
            f"a message to {name} must have the fields {sorted(fields)}, besides do; "
            f"got {checks.brief(sorted(message))}."
        )
    return Action(name, {field: check(field, message[field]) for field, check in fields.items()})


# --- messages to pages


def text_of(kind: str, values: Mapping[str, Any]) -> str:
    """A message for pages as JSON. Its kind is in `type`; numbers that are not finite become null.

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
