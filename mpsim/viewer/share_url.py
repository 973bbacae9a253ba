"""Links: what an address requests of a view. That is a scene that comes with mpsim, its settings, and a second stage.

A link is the part of an address after the question mark, such as `scene=gas&dt=0.005&seed=3&beside=event&wait`. It can
name scenes, but no files. Each value passes the usual input checks of mpsim; values that could make a frame very long
have narrower bounds. `wait`, `speed`, `zoom`, `x`, `y` and `canvas` change only the display; the page reads them itself
after they have been checked here.
"""

import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, quote, urlencode

from mpsim.core import checks
from mpsim.engine import parameters
from mpsim.engine.solvers.methods import capabilities_of, in_one_process
from mpsim.errors import InputError
from mpsim.scene import scenefile
from mpsim.scene.scene import Scene, settings_for
from mpsim.scene.settings import METHODS, Settings
from mpsim.viewer.comparison import in_step
from mpsim.viewer.edits import VALUES, longest_gravity
from mpsim.viewer.source import QUICKEST, SLOWEST

LONGEST = 1000  # largest number of characters of a link

MOST_DIVISIONS = 100
"""Largest number of passes, of sub-steps, and of frames of a second stage in one frame of the first."""

MOST_SWEEPS = 1000  # largest product of these numbers, so that a frame of a link ends soon

RANGE = 100.0
"""Largest factor between a time or speed in a link and that of its scene, up or down. For gravity, the largest factor
above the longest arrow of the page."""

MOST_SEED = 1_000_000  # largest seed, as on the page

SETTINGS: Mapping[str, type] = {
    "dt": float, "method": str, "contact": str, "law": str, "precision": str, "passes": int, "substeps": int,
    "on_fast": str, "contact_time": float,
}  # fmt: skip
"""Settings that a link can contain, and their types. The others do not change results, or depend on the machine."""

BESIDE = tuple(name for name in SETTINGS if name not in ("on_fast", "contact_time"))
"""Settings that can differ in a second stage."""

ZOOMS = (0.5, 64.0)  # range of the zoom, as on the page
SEEN = ("wait", "speed", "zoom", "x", "y", "canvas")  # names that concern only the display; the page reads them

NEAR = tuple(name for name in VALUES if name != "gravity" and name != "every" and not name.endswith("restitution"))
"""Parameters that must be near those of the scene."""

NAMES = ("scene", "seed", *SETTINGS, *VALUES, "beside", *SEEN)


class Link(NamedTuple):
    """The checked content of a link."""

    scene: str  # name of a scene that comes with mpsim
    seed: int  # of other random positions and velocities; 0: those of the scene
    settings: Settings
    changed: Mapping[str, Any]  # parameters that differ from those of the scene, as `Simulation.change` takes them
    beside: Settings | None  # of the second stage; None: there is none
    seen: Mapping[str, str] = MappingProxyType({})  # names among SEEN, and their texts

    @property
    def given(self) -> Scene:
        """The scene as it comes with mpsim."""
        return named(self.scene)


@functools.cache
def named(name: str) -> Scene:
    """A scene that comes with mpsim; for one name always the same object."""
    return Scene.load(name)


def is_link(text: str) -> bool:
    """Whether a text is an address, or the part of one from the question mark on, and not a name or a path."""
    return text.startswith(("?", "http://", "https://"))


def query_of(text: str) -> str:
    """The part of an address between its question mark and a `#`."""
    return text.partition("#")[0].partition("?")[2]


def read(query: str) -> Link:
    """Read and check a link.

    Raises:
        InputError: if something is not allowed; the message gives the name, the rule and the value received.

    >>> found = read("scene=gas&dt=0.005&seed=3&beside=event&wait")
    >>> found.scene, found.seed, found.settings.dt, found.beside.method
    ('gas', 3, 0.005, 'event')
    >>> read("scene=/etc/passwd")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    mpsim.InputError: scene of a link must be one of 'brazil-nut', ...; got '/etc/passwd'.
    """
    texts = _texts(query)
    if "scene" not in texts:
        raise InputError("a link must have a scene, as in ?scene=gas&dt=0.005; got none. Add scene=NAME.")
    name = checks.choice("scene of a link", texts["scene"], scenefile.names())
    scene = named(name)
    seed = checks.whole("seed", _number(int, texts.get("seed", "0")), 0, MOST_SEED, "Any of them will do.")
    if seed and scene._redraw is None:
        raise InputError(f"seed must be left out for a scene without random numbers; got {seed} for {name!r}.")
    usual = settings_for(scene, None)
    values = {each: _number(kind, texts[each]) for each, kind in SETTINGS.items() if each in texts}
    settings = dataclasses.replace(usual, **values)
    _demand_short_frames(settings, usual.dt)
    changed = {each: _parameter(each, texts[each]) for each in VALUES if each in texts}
    parameters.in_force(scene, settings, changed, 0.0)
    for each in NEAR:
        if each in changed:
            _demand_near(each, changed[each], VALUES[each](scene))
    if "gravity" in changed:
        checks.between("size of gravity", math.hypot(*changed["gravity"]), 0.0, RANGE * longest_gravity(scene))
    beside = second(settings, texts["beside"]) if "beside" in texts else None
    return Link(name, seed, settings, changed, beside, _seen(texts))


def checked(query: str) -> str:
    """The query of the page's own address, checked, in its standard form; "" if it concerns only the display."""
    texts = _texts(query)
    if set(texts) - set(SEEN):
        return write(read(query))
    _seen(texts)
    return ""


def _texts(query: str) -> dict[str, str]:
    if len(query) > LONGEST:
        raise InputError(f"a link must have at most {LONGEST} characters; got {len(query):,}. Send a scene file.")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, errors="strict", max_num_fields=len(NAMES))
    except ValueError as error:  # bytes that are not UTF-8, or too many fields
        raise InputError(f"a link must be names and values, as in ?scene=gas&dt=0.005; got {error!s:.60}.") from None
    texts: dict[str, str] = {}
    for name, value in pairs:
        checks.choice("a name in a link", name, NAMES)
        if name in texts:
            raise InputError(f"{name} must be in a link once; got it twice. Leave one out.")
        texts[name] = value
    return texts


def _number(kind: type, text: str) -> Any:
    """The value of a text. If it is not of this type it stays a text, which the input checks refuse later."""
    try:
        return kind(text)
    except ValueError:
        return text


def _parameter(name: str, text: str) -> Any:
    if name == "gravity":
        components = [_number(float, each) for each in text.split(",")]
        if [type(each) for each in components] != [float, float]:
            raise InputError(
                f"gravity in a link must be two numbers, such as gravity=0,-5; got {checks.brief(text)}. Give x and y."
            )
        return components
    return _number(int if name == "every" else float, text)


def _demand_short_frames(settings: Settings, usual: float, frames: int = 1) -> None:
    """Refuse settings that a view cannot run, or that make frames very long.

    usual: dt of the scene [time]; frames: of these settings in one frame of the first stage.
    """
    in_one_process(settings, "the view of a link")
    _demand_near("dt", settings.dt, usual)
    for name in ("passes", "substeps"):
        checks.whole(name, getattr(settings, name), 1, MOST_DIVISIONS, "A link may not ask for more.")
    if (sweeps := frames * settings.substeps * settings.passes) > MOST_SWEEPS:
        raise InputError(
            f"a link may ask for at most {MOST_SWEEPS:,} passes in one frame of the first stage; got {sweeps:,} "
            f"(frames {frames}, substeps {settings.substeps}, passes {settings.passes}). Ask for fewer of them."
        )


def _demand_near(name: str, value: float, usual: float) -> None:
    """Refuse a time or a speed that is far from that of the scene."""
    checks.between(f"size of {name}", abs(value), abs(usual) / RANGE, abs(usual) * RANGE)


def second(first: Settings, text: str) -> Settings:
    """Settings of a second stage, whose frames fit those of the first: `beside_of` within the limits of a link."""
    wanted = beside_of(first, text)
    if not capabilities_of(wanted).has_steps:
        wanted = dataclasses.replace(wanted, dt=first.dt)  # the only dt that fits
    found, frames = in_step(wanted, first.dt)
    _demand_short_frames(found, first.dt, frames)
    return found


def _seen(texts: Mapping[str, str]) -> dict[str, str]:
    """The values that concern only the display, which the page does not check."""
    if "zoom" in texts:
        checks.between("zoom", _number(float, texts["zoom"]), *ZOOMS)
    for name in ("x", "y"):
        if name in texts:
            checks.finite_array(name, _number(float, texts[name]), (), "()")
            if "zoom" not in texts:
                raise InputError(f"{name} must come with zoom, as in zoom=4&x=3&y=5; got no zoom. Add zoom=2.")
    if "canvas" in texts:
        checks.choice("canvas", texts["canvas"], ["2d"])
    if texts.get("speed", "max") != "max":
        checks.between("speed", _number(float, texts["speed"]), SLOWEST, QUICKEST)
    return {name: texts[name] for name in SEEN if name in texts}


def beside_of(first: Settings, text: str) -> Settings:
    """Settings of a second stage: those of the first, with changes: a method and settings, separated by commas.

    `frames=2` stands for half of the dt.

    Raises:
        InputError: if the text is not of this form.

    >>> beside_of(Settings(method="grid"), "dt=0.001,passes=2").passes, beside_of(Settings(), "event").method
    (2, 'event')
    """
    values: dict[str, Any] = {}
    for word in text.split(","):
        name, equals, value = word.strip().partition("=")
        if not equals and name in METHODS:
            name, value = "method", name
        if name == "frames":
            frames = checks.whole(name, _number(int, value), 1, MOST_DIVISIONS, "Each is a step of the second stage.")
            name, value = "dt", str(first.dt / frames)
        if name not in BESIDE or name in values:
            raise InputError(
                f"beside must be a method, or {', '.join(BESIDE)} or frames with a value, each once; got "
                f"{checks.brief(word)}. Use dt=0.001,passes=2."
            )
        values[name] = _number(SETTINGS[name], value)
    if "method" in values:
        values["workers"] = None
    return dataclasses.replace(first, **values)


# --- from settings to a link


def write(link: Link) -> str:
    """The text of a link: the values that differ from those the scene recommends, without `seen`.

    >>> write(read("beside=dt%3D0.001&seed=007&dt=5e-3&wait&scene=gas&law=elastic"))
    'scene=gas&seed=7&dt=0.005&beside=dt=0.001'
    """
    usual = settings_for(link.given, None)
    values = {"scene": link.scene} | ({"seed": str(link.seed)} if link.seed else {})
    values |= _differences(link.settings, usual, SETTINGS)
    values |= {name: _text(link.changed[name]) for name in VALUES if name in link.changed}
    if link.beside is not None:
        values["beside"] = _beside_text(link.beside, link.settings)
    return urlencode(values, safe=",=", quote_via=quote)


def _beside_text(second: Settings, first: Settings) -> str:
    names = BESIDE if capabilities_of(second).has_steps else ("method", "law", "precision")
    differing = _differences(second, first, names)
    words = [value if name == "method" else f"{name}={value}" for name, value in differing.items()]
    return ",".join(words) or second.method


def _differences(settings: Settings, usual: Settings, names: Iterable[str]) -> dict[str, str]:
    found = {name: getattr(settings, name) for name in names}
    return {name: str(value) for name, value in found.items() if value not in (None, getattr(usual, name))}


def _text(value: Any) -> str:
    return ",".join(map(repr, value)) if isinstance(value, list) else str(value)


def changed_of(now: Scene, given: Scene) -> dict[str, Any]:
    """Parameters whose present values differ from those of the given scene."""
    values = {name: value_of(now) for name, value_of in VALUES.items()}
    return {name: value for name, value in values.items() if value is not None and value != VALUES[name](given)}
