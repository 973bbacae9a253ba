"""Messages between a simulation and its pages: pictures as bytes, all else as JSON.

A message of bytes begins with HEADER. In a picture, N x 2 uint16 follow, x and y from 0 to STEPS, and N x uint8, the
colours: a disc takes 5 bytes. A colour is from 0 to FASTEST, or ABSORBED for an absent disc, which is not drawn; the
message `colours` says what they show. In radii, N x float32 follow, or one if all are equal. All numbers are
little-endian.

A page sends only text, of the form `{"do": NAME, ...}`, with exactly the arguments of this command. A command is
declared once, by `command` before the method `do_NAME` that carries it out.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import orjson
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.state import Box, State
from mpsim.engine.solvers.base import InPlace
from mpsim.errors import InputError
from mpsim.features.capsules import polygons
from mpsim.kernels.geometry import OWNER, RADIUS
from mpsim.kernels.output import paint_places, paint_speeds
from mpsim.output.drawing import PAGE, obstacle_colours
from mpsim.scene.scene import Scene

if TYPE_CHECKING:
    from mpsim.viewer.server import Pages

# --- Maps the speeds of discs to colours, one byte per disc

KNEE, FASTEST, ABSORBED = 223, 254, 255
"""Bytes of three discs: one at the speed that 98 % of the discs do not reach, the fastest one, and an absent one."""

USUAL = 0.98
"""Fraction of the discs that are slower than the speed at KNEE. Above KNEE, one byte spans a larger range of speeds. So
a few very fast discs do not make all others look dark, and can still be told apart."""

LEAST_RATIO = 1 + (FASTEST - KNEE) / KNEE
"""Smallest ratio of the speed at FASTEST to that at KNEE. At this ratio, both parts of the scale have one slope."""

MOST_SAMPLED = 20_000
"""Largest number of speeds that are sorted to find the scale. If there are more discs, every second, every third, ...
is taken."""


@dataclass(frozen=True)
class SpeedScale:
    """A piecewise linear scale: byte 0 at speed 0, KNEE at `usual`, FASTEST at `fastest`."""

    usual: float  # > 0 [length/time]
    fastest: float  # >= LEAST_RATIO * usual [length/time]

    def colours(self, discs: InPlace, out: NDArray[np.uint8], *, plain: bool = False) -> None:
        """Write the colour of each disc into `out`, ordered by disc number; plain: without a compiled kernel."""
        steep = (FASTEST - KNEE) / (self.fastest / self.usual - 1)
        paint = getattr(paint_speeds, "py_func", paint_speeds) if plain else paint_speeds
        paint(discs.vx, discs.vy, discs.number, self.usual, KNEE, steep, FASTEST, out)
        if discs.absent is not None:
            out[discs.absent] = ABSORBED


def scale_of(state: State) -> SpeedScale:
    """The scale for the speeds of a state; if all discs are at rest, a scale from 0 to about 1."""
    speeds = np.hypot(*state.velocity[state.present].T).astype(np.float64)
    fastest = float(speeds.max(initial=0.0))
    if not fastest > 0:
        return SpeedScale(1.0, LEAST_RATIO)
    usual = float(np.quantile(speeds[:: len(speeds) // MOST_SAMPLED + 1], USUAL))
    usual = max(usual, fastest / 1000)  # where nearly all are at rest
    return SpeedScale(usual, max(fastest, LEAST_RATIO * usual))


# --- Numbers from a program

LOW, MIDDLE = FASTEST - KNEE, FASTEST // 2
"""The lowest 2 % of the values have bytes below LOW, as the highest 2 % have bytes above KNEE. A disc without a value
has the byte MIDDLE."""

PERCENTILES = (0, 2, 98, 100)
"""Percentiles of the values that have the bytes 0, LOW, KNEE and FASTEST; between them the scale is linear."""


class OwnColours:
    """Colours discs by numbers from `own_colours`, read for each picture; None: by their speeds."""

    def __init__(self, values: NDArray[np.float64] | None):
        self._values = values
        self._corners: list[float] = []

    def bytes_of(self, discs: InPlace) -> NDArray[np.uint8] | None:
        """The colour of each disc, ordered by disc number; None: by speed."""
        if self._values is None:
            return None
        count = len(discs.number)
        values = np.full(count, math.nan)
        known = self._values[:count]
        values[: len(known)] = known
        here, colours = np.isfinite(values), np.full(count, MIDDLE, np.uint8)
        if here.any():
            corners = np.percentile(values[here], PERCENTILES)
            self._corners = corners.tolist()
            if corners[0] < corners[-1]:
                colours[here] = np.interp(values[here], corners, (0, LOW, KNEE, FASTEST)) + 0.5
        if discs.absent is not None:
            colours[discs.absent] = ABSORBED
        return colours

    def told(self) -> dict[str, Any]:
        """What the legend of a page needs: the percentiles of the scale, none for speeds."""
        return {"values": self._corners}


def own_colours(colour: ArrayLike | None, count: int) -> NDArray[np.float64] | None:
    """Check numbers to colour discs by, shape (count,). A float64 array is not copied, so it can be changed later."""
    if colour is None:
        return None
    try:
        found = np.asarray(colour, np.float64)
    except (TypeError, ValueError):
        found = np.zeros(())
    if found.shape != (count,):
        raise InputError(
            f"colour must be an array of {count} numbers, one for each disc; got {checks.brief(colour)}. "
            "Use mpsim.view(sim, colour=values)."
        )
    return found


# --- pictures

MAGIC, VERSION = b"MPSV", 1
PICTURE, RADII = 1, 2
STEPS = 65535  # number of steps across the box in which positions are sent: 0.03 pixels if the box is 1,920 pixels wide

HEADER = np.dtype(
    [
        ("magic", "S4"),
        ("version", "u1"),  # of this format
        ("kind", "u1"),  # PICTURE or RADII
        ("stage", "<u2"),  # 0, or 1 for the second of two
        ("serial", "<u4"),  # of the picture, by which the page acknowledges it; of radii 0
        ("count", "<u4"),  # of discs, or of radii: 1 if all are equal
        ("frame", "<u8"),
        ("time", "<f8"),
        ("walls", "<f8", 4),  # now: x_low, x_high, y_low, y_high
        ("extent", "<f8", 2),  # width and height that places are fractions of: those of the scene
        ("speeds", "<f8", 2),  # of byte KNEE and of byte FASTEST
    ]
)
"""The beginning of a message of bytes, 96 bytes long; the page reads it in connection.js."""


def pack(
    discs: InPlace,
    scene: Scene,
    scale: SpeedScale,
    colours: NDArray[np.uint8] | None = None,
    *,
    serial: int,
    stage: int = 0,
    plain: bool = False,
) -> bytearray:
    """A picture as bytes.

    Args:
        discs, scene: content of the picture.
        scale: maps speeds to colours.
        colours: colour of each disc by number, shape (N,); None: from the speeds.
        plain: pack in Python. It takes some microseconds a disc, but loading the first kernel takes over half a second.
    """
    count, size, extent = len(discs.number), HEADER.itemsize, (scene.width, scene.height)
    packed = bytearray(size + 5 * count)
    head = (MAGIC, VERSION, PICTURE, stage, serial, count, discs.frame, discs.time, discs.box, extent)
    np.frombuffer(packed, HEADER, 1)[0] = (*head, (scale.usual, scale.fastest))
    places = np.frombuffer(packed, "<u2", 2 * count, size)
    painted = np.frombuffer(packed, np.uint8, count, size + 4 * count)
    paint = getattr(paint_places, "py_func", paint_places) if plain else paint_places
    paint(discs.x, discs.y, discs.number, *extent, *scene.periodic, STEPS, places)
    if colours is None:
        scale.colours(discs, out=painted, plain=plain)
    else:
        painted[:] = colours
    return packed


def pack_radii(radii: NDArray[np.float64], picture: bytes | bytearray) -> bytes:
    """Radii as bytes: all of them, or only one if they are equal. They apply to this picture and all that follow."""
    each = np.asarray(radii[:1] if len(radii) and (radii == radii[0]).all() else radii, "<f4")
    header = np.frombuffer(picture, HEADER, 1).copy()
    header["kind"], header["serial"], header["count"] = RADII, 0, len(each)
    return header.tobytes() + each.tobytes()


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


def unpack(stage: Stage) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], Box]:
    """Read back positions, shape (N, 2), NaN of absent discs, radii and colours, shape (N,), and the walls."""
    header, size = np.frombuffer(stage.packed, HEADER, 1)[0], HEADER.itemsize
    count = int(header["count"])
    position = np.frombuffer(stage.packed, "<u2", 2 * count, size).reshape(count, 2) * (header["extent"] / STEPS)
    colours = np.frombuffer(stage.packed, np.uint8, count, size + 4 * count)
    position[colours == ABSORBED] = np.nan
    radii = np.frombuffer(stage.radii, "<f4", offset=size).astype(np.float64)
    return position, np.broadcast_to(radii, count), colours.astype(np.float64), tuple(header["walls"].tolist())


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
        self._audience.from_outside(self._audience.show, SentPicture(self._serial, capsules, tuple(stages)))

    def _stage(self, stage: int, discs: InPlace, colours: NDArray[np.uint8] | None, plain: bool) -> Stage:
        count = len(discs.number)
        fitting = None if colours is None or len(colours) != count else colours
        packed = pack(discs, self.scene, self.scale, fitting, serial=self._serial, stage=stage, plain=plain)
        if stage not in self._radii or self._radii[stage][0] != count:
            self._radii[stage] = count, pack_radii(discs.radii, packed)
        return Stage(packed, self._radii[stage][1])

    def tell_scene(self, name: str, **more: Any) -> None:
        """Send what rarely changes: the scene, the colours of its parts, and more values from its source."""
        fixed: dict[str, Any] = {each: getattr(self.scene, each) for each in ("width", "height", "periodic")}
        fixed["theme"] = {each: getattr(PAGE, each) for each in ("ground", "behind")}
        self.tell_if_new("scene", {"version": VERSION, "name": name, **fixed, **more})
        self._told_capsules()

    def _told_capsules(self) -> NDArray[np.float64]:
        """The obstacles at the time of the last picture, sent if they differ from those sent before."""
        capsules = self.scene._capsules_at(self._time)
        if capsules is not self._capsules:
            self._capsules = capsules
            numbers = capsules[:, OWNER].astype(np.int64)
            filled = [[part.start, part.stop] for part in polygons(capsules)]
            shapes, colours = capsules[:, : RADIUS + 1].copy(), obstacle_colours(capsules, PAGE)
            told = {"capsules": shapes, "numbers": numbers, "filled": filled, "colours": colours}
            self.tell_if_new("obstacles", told)
        return capsules

    def tell(self, kind: str, values: Mapping[str, Any]) -> None:
        """Send a message of this kind; see `text_of`."""
        self._audience.texts[kind] = text_of(kind, values)
        self._audience.from_outside(self._audience.wake, kind)

    def tell_if_new(self, kind: str, values: Mapping[str, Any]) -> None:
        """Send a message of this kind, unless it equals the last one."""
        if text_of(kind, values) != self._audience.texts.get(kind):
            self.tell(kind, values)
