"""The tables and keys of a scene file. Every rule is that of the corresponding Python class."""

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any

import pydantic
from pydantic import Field, model_validator

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.features import NUMBERS, PER_DISC, VECTORS
from mpsim.features.feature import PerDisc
from mpsim.scene.compression import FASTEST, SLOWEST
from mpsim.scene.scene import LARGEST_COUNT, Scene
from mpsim.scene.scenefile.parts import PARTS
from mpsim.scene.scenefile.rules import (
    Numbers,
    Positive,
    Region,
    Spacing,
    Table,
    array_of,
    as_in,
    plain,
)
from mpsim.scene.settings import Settings
from mpsim.scene.starts import LATTICES

SCHEMA = 1
"""Version of this format."""


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text in quotation marks; got {checks.brief(value)}.")
    return value


def version_problem(value: Any) -> str:
    """The error text for a version that is not SCHEMA."""
    return (
        f"schema must be {SCHEMA}, the version of scene files that this mpsim reads; got {checks.brief(value)}. "
        "A newer mpsim may read it."
    )


def _version(_: str, value: Any) -> int:
    if isinstance(value, bool) or value != SCHEMA or not isinstance(value, int):
        raise InputError(version_problem(value))
    return value


Text = Annotated[str, plain(_text)]
Count = Annotated[int, plain(checks.whole, 0, LARGEST_COUNT, "Give a number in this range.")]
Seed = Annotated[int, plain(checks.whole, 0, 2**63 - 1, "Any whole number will do.")]


class About(Table):
    """Title and texts for people."""

    title: Annotated[Text, Field(description="a line")]
    text: Annotated[Text, Field(description="what it is")] = ""
    look_for: Annotated[Text, Field(description="what to look for when it runs")] = ""


_SETTINGS: dict[str, Any] = {
    field.name: (Annotated[Any, as_in((Settings, {}), numbers=False)], field.default)
    for field in dataclasses.fields(Settings)
}
if TYPE_CHECKING:

    class SettingsTable(Table):
        """Recommended settings, by the names of Settings: made below, where its keys are known."""
else:
    SettingsTable = pydantic.create_model("SettingsTable", __base__=Table, **_SETTINGS)
    SettingsTable.__doc__ = "Recommended settings, by the names of Settings."


def _key_of(each: PerDisc) -> tuple[Any, Any]:
    """Type and default of a key for a value of each disc."""
    if each.components:
        rule = array_of((2,), (None, 2), meaning="(2,) or (N, 2)")
        forms, otherwise = f"[{', '.join(each.components)}] for all, one row each, or a file", "none"
    else:
        rule = array_of((), (None,), meaning="() or (N,)", unit=each.unit or None)
        forms, otherwise = "one for all, one each, or a file", f"{each.default:g}" if each.default is not None else ""
    description = "; ".join(filter(None, (each.meaning, forms, otherwise and f"default: {otherwise}")))
    default = ... if each.default is None else None
    return Annotated[float | Numbers | None, rule, Field(description=description)], default


def _start(name: str, value: Any) -> str:
    """A word for the start of a group; the others belong elsewhere."""
    if value == "compressed":
        raise InputError(
            f"{name} must be a start of one group; got 'compressed', which is for all groups together. Use 'random' "
            "here, and a table [compressed]."
        )
    return checks.choice(name, value, ("random", *LATTICES))


class _Places(Table):
    """Where the discs of a group are."""

    position: Annotated[
        Numbers | None, array_of((None, 2), meaning="(N, 2)"), Field(description="centres [[x, y], ...], or a file")
    ] = None
    places: Annotated[
        str | None,
        plain(_start),
        Field(description="instead of position: random, square or hexagonal (a lattice)"),
    ] = None
    count: Annotated[Count | None, Field(description="number of discs; default for a lattice: all that fit")] = None
    spacing: Annotated[
        Spacing | None, Field(description="between neighbours of a lattice; default: the widest that fits count discs")
    ] = None
    region: Annotated[
        Region | None,
        Field(description="[x_low, y_low, x_high, y_high] of the centres; default: the box, a radius inside"),
    ] = None
    seed: Annotated[Seed, Field(description="seed of random positions and thermal velocities")] = 0


if TYPE_CHECKING:

    class _Own(_Places):
        """And what features have of each: made below, where its keys are known."""

        radius: float | Numbers
        mass: float | Numbers | None = None
else:
    _Own = pydantic.create_model("_Own", __base__=_Places, **{name: _key_of(each) for name, each in PER_DISC.items()})


class Discs(_Own):
    """A group of discs: initial positions and velocities, radii, masses."""

    velocity: Annotated[
        Numbers | None,
        array_of((2,), (None, 2), meaning="(2,) or (N, 2)"),
        Field(description="[vx, vy] for all, one row each, or a file; default: at rest"),
    ] = None
    temperature: Annotated[
        float | None,
        plain(checks.non_negative, "[mass length^2/time^2]"),
        Field(description="instead of velocity: kT of normally distributed ones, without drift, scaled to be exact"),
    ] = None

    @model_validator(mode="after")
    def _fits_together(self) -> "Discs":
        if (self.position is None) == (self.places is None):
            got = "neither" if self.position is None else "both"
            raise InputError(f"discs must have either position or places; got {got}.")
        if self.velocity is not None and self.temperature is not None:
            raise InputError("discs must have velocity or temperature, not both; got both.")
        needless = [name for name in ("count", "spacing", "region") if getattr(self, name) is not None]
        if self.position is not None and needless:
            raise InputError(f"{needless[0]} goes with places, but these discs have positions. Leave it out.")
        if self.places == "random":
            if self.count is None:
                raise InputError("count must be given for places = 'random'; got none.")
            if self.spacing is not None:
                raise InputError("spacing belongs to a lattice; got it for places = 'random'. Leave it out.")
        if self.places in LATTICES and self.count is None and self.spacing is None:
            raise InputError(f"count or spacing must be given for places = {self.places!r}; got neither.")
        return self


class Compressed(Table):
    """The start is compressed: the arguments of Scene.compressed."""

    packing: Annotated[
        float,
        plain(checks.positive, "(a fraction of the area)"),
        Field(description="packing fraction of the scene, above that of the box as it is given"),
    ]
    rate: Annotated[
        float,
        plain(checks.between, SLOWEST, FASTEST),
        Field(description="speed at which discs grow, as a fraction of the thermal speed, 1e-6 to 10"),
    ] = 0.01


_SCENE = (Scene, {"width": 1.0, "height": 1.0, "position": (), "velocity": (), "radius": 0.1})


class _Box(Table):
    """The box of a scene file."""

    schema_: Annotated[int, plain(_version), Field(alias="schema", description=f"version of the format, {SCHEMA}")]
    width: Annotated[Positive | None, Field(description="width of the box")] = None
    height: Annotated[Positive | None, Field(description="height of the box")] = None
    packing: Annotated[
        float | None,
        plain(checks.positive, "(a fraction of the area)"),
        Field(description="instead of width and height: of a square box, made to fit the discs"),
    ] = None
    boundary: Annotated[
        Any,
        as_in(_SCENE, words=True),
        Field(description='"walls", "periodic", or one for x and one for y: ["periodic", "walls"]'),
    ] = "walls"


_NUMBERS: dict[str, Any] = {
    name: (Annotated[Any, as_in(_SCENE), Field(description=meaning)], default)
    for name, (default, meaning) in ({name: (None, meaning) for name, meaning in VECTORS.items()} | NUMBERS).items()
}
if TYPE_CHECKING:

    class _Physics(_Box):
        """And what features have of the scene: made below, where its keys are known."""
else:
    _Physics = pydantic.create_model("_Physics", __base__=_Box, **_NUMBERS)


class _SceneTable(_Physics):
    """A scene file, without the tables of its features."""

    absorbing: Annotated[
        Any,
        as_in(_SCENE, words=True),
        Field(description='edges at which discs leave: a list of "left", "right", "bottom", "top"'),
    ] = ()
    duration: Annotated[float | None, as_in(_SCENE), Field(description="time that a run should last")] = None
    picture_interval: Annotated[
        float | None, as_in(_SCENE), Field(description="time between two pictures of an animation or a trajectory")
    ] = None
    measures: Annotated[Any, as_in(_SCENE, words=True), Field(description="recommended measures: a list of names")] = ()
    about: Annotated[About | None, Field(description="title and texts")] = None
    settings: Annotated[SettingsTable | None, Field(description="recommended settings")] = None
    compressed: Annotated[
        Compressed | None, Field(description="the start is compressed to a higher packing, in a smaller box")
    ] = None
    discs: Annotated[list[Discs], Field(description="groups of discs")] = []  # noqa: RUF012 - pydantic copies it

    @model_validator(mode="after")
    def _box_is_given_once(self) -> "_SceneTable":
        both = self.width is not None and self.height is not None
        if (self.packing is None) != both or (self.packing is not None and (self.width or self.height)):
            raise InputError(
                "the box must be given either by packing or by width and height; "
                f"got packing={self.packing!r}, width={self.width!r}, height={self.height!r}."
            )
        return self


_PARTS: dict[str, Any] = {
    part.argument: (Annotated[part.annotation, Field(description=part.description)], part.default) for part in PARTS
}
if TYPE_CHECKING:

    class SceneTable(_SceneTable):
        """A scene file: made below, where its keys are known."""
else:
    SceneTable = pydantic.create_model("SceneTable", __base__=_SceneTable, **_PARTS)
    SceneTable.__doc__ = "A scene file."

LEVELS: dict[str, list[type[Table]]] = {
    "": [SceneTable],
    "about": [About],
    "settings": [SettingsTable],
    "compressed": [Compressed],
    "discs": [Discs],
    **{part.argument: [table for _, _, table in part.tables] for part in PARTS},
}
"""Tables by their key."""


def keys_of(table: type[Table]) -> list[str]:
    """The keys of a table, as they are written."""
    return [field.alias or name for name, field in table.model_fields.items()]


def reference() -> str:
    """All keys as tables in Markdown, for docs/scenes.md."""
    parts: list[tuple[str, type[Table]]] = [
        ("The file itself", SceneTable),
        ("`[about]`", About),
        ("`[compressed]`", Compressed),
        ("`[[discs]]`", Discs),
    ]
    for part in PARTS:
        parts += [(title, table) for _, title, table in part.tables]
    lines: list[str] = []
    for title, table in parts:
        lines += [f"### {title}", "", "| key | default | meaning |", "|---|---|---|"]
        for name, field in table.model_fields.items():
            default = "needed" if field.is_required() else _default_text(field.default)
            lines.append(f"| `{field.alias or name}` | {default} | {field.description} |")
        lines.append("")
    return "\n".join(lines)


def _default_text(default: Any) -> str:
    return "-" if default is None or default in ((), [], "") else f"`{default}`".replace("'", '"')
