"""Links: what an address requests of a view. That is a scene that comes with mpsim, its settings, and a second stage.

A link is the part of an address after the question mark, such as `scene=gas&dt=0.005&seed=3&beside=event&wait`. It can
name scenes, but no files. `wait`, `speed`, `zoom`, `x`, `y` and `canvas` change only the display; the page reads them.
"""

import dataclasses
import functools
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, quote, urlencode

from mpsim.core import checks
from mpsim.engine import changes
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError
from mpsim.scene import scenefile
from mpsim.scene.scene import Scene, settings_for
from mpsim.scene.settings import METHODS, Settings
from mpsim.viewer.edits import VALUES

MOST_DIVISIONS = 100  # largest number of frames of a second stage in one frame of the first
MOST_SEED = 1_000_000  # largest seed, as on the page

SETTINGS: Mapping[str, type] = {
    "dt": float, "method": str, "contact": str, "law": str, "precision": str, "passes": int, "substeps": int,
    "on_fast": str, "contact_time": float,
}  # fmt: skip
"""Settings that a link can contain, and their types. The others do not change results, or depend on the machine."""

BESIDE = tuple(name for name in SETTINGS if name not in ("on_fast", "contact_time"))
"""Settings that can differ in a second stage."""

SEEN = ("wait", "speed", "zoom", "x", "y", "canvas")  # names that concern only the display; the page reads them

NAMES = ("scene", "seed", *SETTINGS, *VALUES, "beside", *SEEN)


class Link(NamedTuple):
    """The checked content of a link."""

    scene: str  # name of a scene that comes with mpsim
    seed: int  # of other random positions and velocities; 0: those of the scene
    settings: Settings
    changed: Mapping[str, Any]  # parameters that differ from those of the scene, as `Simulation.change` takes them
    beside: Settings | None  # of the second stage; None: there is none
    seen: Mapping[str, str] = MappingProxyType({})  # names among SEEN, and their texts, which the page reads

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


def read(text: str) -> Link:
    """Read and check a link, or an address, whose link lies between its question mark and a `#`.

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
    texts = _texts(text.partition("#")[0].partition("?")[2] if is_link(text) else text)
    if "scene" not in texts:
        raise InputError("a link must have a scene, as in ?scene=gas&dt=0.005; got none. Add scene=NAME.")
    name = checks.choice("scene of a link", texts["scene"], scenefile.names())
    scene = named(name)
    seed = checks.whole("seed", _number(int, texts.get("seed", "0")), 0, MOST_SEED, "Any of them will do.")
    if seed and scene._redraw is None:
        raise InputError(f"seed must be left out for a scene without random numbers; got {seed} for {name!r}.")
    values = {each: _number(kind, texts[each]) for each, kind in SETTINGS.items() if each in texts}
    settings = dataclasses.replace(settings_for(scene, None), **values)
    changed = {each: _parameter(each, texts[each]) for each in VALUES if each in texts}
    changes.in_force(scene, settings, changed, 0.0)
    beside = beside_of(settings, texts["beside"]) if "beside" in texts else None
    return Link(name, seed, settings, changed, beside, {each: texts[each] for each in SEEN if each in texts})


def _texts(query: str) -> dict[str, str]:
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
    for name in VALUES:
        if (value := link.changed.get(name)) is not None:
            values[name] = ",".join(map(repr, value)) if isinstance(value, list) else str(value)
    if link.beside is not None:
        steps = capabilities_of(link.beside).has_steps  # passes, too, concern only these
        differing = _differences(link.beside, link.settings, BESIDE if steps else ("method", "law", "precision"))
        words = [value if name == "method" else f"{name}={value}" for name, value in differing.items()]
        values["beside"] = ",".join(words) or link.beside.method
    return urlencode(values, safe=",=", quote_via=quote)


def _differences(settings: Settings, usual: Settings, names: Iterable[str]) -> dict[str, str]:
    found = {name: getattr(settings, name) for name in names}
    return {name: str(value) for name, value in found.items() if value not in (None, getattr(usual, name))}


def changed_of(now: Scene, given: Scene) -> dict[str, Any]:
    """Parameters whose present values differ from those of the given scene."""
    values = {name: value_of(now) for name, value_of in VALUES.items()}
    return {name: value for name, value in values.items() if value is not None and value != VALUES[name](given)}
