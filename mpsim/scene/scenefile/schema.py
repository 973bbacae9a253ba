"""What a scene file may hold: a table of keys per level. Every rule is that of the Python class it stands for."""

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Discriminator, Field, PrivateAttr, Tag, ValidationInfo, model_validator

from mpsim.core import checks
from mpsim.core.errors import InputError
from mpsim.features.emitters import LARGEST_EMITTERS, Emitter
from mpsim.features.obstacles import (
    LARGEST_OBSTACLES,
    FixedDisc,
    Obstacle,
    Polyline,
    check_lines,
    fixed_discs,
    polylines,
)
from mpsim.features.piston import Piston
from mpsim.scene.scene import LARGEST_COUNT, Scene
from mpsim.scene.scenefile import arrays
from mpsim.scene.scenefile.rules import Numbers, array, as_in, checked, one_or_many, plain, source_of
from mpsim.scene.settings import Settings
from mpsim.scene.starts import LATTICES, lattice_sites

SCHEMA = 1
"""Version of this format."""


class Table(pydantic.BaseModel):
    """A table of a scene file: no key but its own, no conversion of one type into another."""

    model_config: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(
        extra="forbid", strict=True, frozen=True, arbitrary_types_allowed=True
    )


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text in quotation marks; got {checks.brief(value)}.")
    return value


def version_problem(value: Any) -> str:
    """What is wrong with a version that is not SCHEMA."""
    return (
        f"schema must be {SCHEMA}, the version of scene files that this mpsim reads; got {checks.brief(value)}. "
        "A newer mpsim may read it."
    )


def _version(_: str, value: Any) -> int:
    if isinstance(value, bool) or value != SCHEMA or not isinstance(value, int):
        raise InputError(version_problem(value))
    return value


def _region(name: str, value: Any, info: ValidationInfo) -> tuple[float, float, float, float]:
    numbers = arrays.array(name, value, ((4,),), "(4,): x_low, y_low, x_high, y_high", source_of(info)).tolist()
    if numbers[0] > numbers[2] or numbers[1] > numbers[3]:
        raise InputError(f"{name} must be [x_low, y_low, x_high, y_high], low before high; got {numbers}.")
    return tuple(numbers)


Text = Annotated[str, plain(_text)]
Positive = Annotated[float, plain(checks.positive, "[length]")]
Region = Annotated[tuple[float, float, float, float], checked(_region)]
Spacing = Annotated[float, plain(checks.positive, "[length]")]
Count = Annotated[int, plain(checks.whole, 0, LARGEST_COUNT, "Simulate fewer discs.")]
Seed = Annotated[int, plain(checks.whole, 0, 2**63 - 1, "Any whole number will do.")]


class About(Table):
    """What a scene is, for people."""

    title: Annotated[Text, Field(description="a line")]
    text: Annotated[Text, Field(description="what it is")] = ""
    look_for: Annotated[Text, Field(description="what to look for when it runs")] = ""


_SETTINGS: dict[str, Any] = {
    field.name: (Annotated[Any, as_in((Settings, {}), numbers=False)], field.default)
    for field in dataclasses.fields(Settings)
}
if TYPE_CHECKING:

    class SettingsTable(Table):
        """Recommended settings, by the names that Settings has for them: made below, where its keys are known."""
else:
    SettingsTable = pydantic.create_model("SettingsTable", __base__=Table, **_SETTINGS)
    SettingsTable.__doc__ = "Recommended settings, by the names that Settings has for them."


class Discs(Table):
    """A group of discs: where they start, how fast, how large."""

    position: Annotated[
        Numbers | None, array((None, 2), meaning="(N, 2)"), Field(description="centres [[x, y], ...], or a file")
    ] = None
    places: Annotated[
        str | None,
        plain(checks.choice, ("random", *LATTICES)),
        Field(description="instead of position: random, square or hexagonal (a lattice)"),
    ] = None
    count: Annotated[Count | None, Field(description="number of discs; of a lattice also left out: all that fit")] = (
        None
    )
    spacing: Annotated[
        Spacing | None, Field(description="of a lattice, between neighbours; left out: the widest that holds count")
    ] = None
    region: Annotated[
        Region | None,
        Field(description="[x_low, y_low, x_high, y_high], where the centres lie; left out: the box, a radius inside"),
    ] = None
    seed: Annotated[Seed, Field(description="of random places and thermal velocities")] = 0
    radius: Annotated[
        float | Numbers,
        array((), (None,), meaning="() or (N,)", unit="[length]"),
        Field(description="one for all, one each, or a file"),
    ]
    mass: Annotated[
        float | Numbers | None,
        array((), (None,), meaning="() or (N,)", unit="[mass]"),
        Field(description="one for all, one each, or a file; left out: 1"),
    ] = None
    velocity: Annotated[
        Numbers | None,
        array((2,), (None, 2), meaning="(2,) or (N, 2)"),
        Field(description="[vx, vy] for all, one row each, or a file; left out: at rest"),
    ] = None
    temperature: Annotated[
        float | None,
        plain(checks.non_negative, "[mass length^2/time^2]"),
        Field(description="instead of velocity: kT of normally distributed ones, without drift, scaled to be exact"),
    ] = None
    acceleration: Annotated[
        Numbers | None,
        array((2,), (None, 2), meaning="(2,) or (N, 2)"),
        Field(description="[ax, ay] for all, one row each, or a file; left out: none"),
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
            raise InputError(f"{needless[0]} belongs to places, and these discs have a position. Leave it out.")
        if self.places == "random":
            if self.count is None:
                raise InputError("count must be given for places = 'random'; got none.")
            if self.spacing is not None:
                raise InputError("spacing belongs to a lattice; got it for places = 'random'. Leave it out.")
        if self.places in LATTICES and self.count is None and self.spacing is None:
            raise InputError(f"count or spacing must be given for places = {self.places!r}; got neither.")
        return self


_PEG = (FixedDisc, {"position": (0.0, 0.0), "radius": 1.0})
_LINE = (Polyline, {"points": ((0.0, 0.0), (1.0, 0.0)), "thickness": 0.0})
_EMITTERS = tuple(
    (Emitter, {"position": (0.0, 0.0), "velocity": (0.0, 0.0), **timing})
    for timing in ({"interval": 1.0}, {"every": 1})
)
_PISTONS = (
    (Piston, {"wall": "left", "speed": 1.0, "stop": 1.0}),
    (Piston, {"wall": "right", "speed": -1.0, "stop": 1.0}),
)
_SCENE = (Scene, {"width": 1.0, "height": 1.0, "position": (), "velocity": (), "radius": 0.1})


class PegTable(Table):
    """A FixedDisc."""

    position: Annotated[
        Numbers,
        array((2,), (None, 2), meaning="(2,) or (K, 2)"),
        Field(description="centre [x, y]; of many discs [[x, y], ...], or a file"),
    ]
    radius: Annotated[
        float | Numbers,
        array((), (None,), meaning="() or (K,)", unit="[length]"),
        Field(description="> 0; one for all, one each, or a file"),
    ]

    @property
    def number(self) -> int:
        """How many obstacles `made` makes."""
        return np.size(self.position) // 2

    def made(self) -> list[Obstacle]:
        """The obstacles of this table."""
        places = np.reshape(self.position, (-1, 2))
        if np.ndim(self.radius) and np.shape(self.radius) != (len(places),):
            raise InputError(
                f"radius must be one number or {len(places)}, one per row of position; got {np.size(self.radius)}."
            )
        return [*fixed_discs(places, self.radius)]


class PegsTable(Table):
    """FixedDiscs on a lattice."""

    places: Annotated[str, plain(checks.choice, LATTICES), Field(description="square or hexagonal")]
    region: Annotated[Region, Field(description="[x_low, y_low, x_high, y_high], where the centres lie")]
    spacing: Annotated[Spacing, Field(description="between neighbours")]
    radius: Annotated[float, as_in(_PEG), Field(description="> 0")]

    @property
    def number(self) -> int:
        """How many obstacles `made` makes."""
        return len(self._sites)

    def made(self) -> list[Obstacle]:
        """The obstacles of this table."""
        return [*fixed_discs(self._sites, self.radius)]

    @property
    def _sites(self) -> Numbers:
        sites = lattice_sites(self.places, self.region, self.spacing)
        if len(sites) > LARGEST_OBSTACLES:
            raise InputError(
                f"spacing must leave at most {LARGEST_OBSTACLES:,} obstacles in the region; got {len(sites):,}. "
                "Use a larger spacing or a smaller region."
            )
        return sites


class LineTable(Table):
    """Polylines, one after the other."""

    points: Annotated[
        Numbers,
        array((None, 2), meaning="(K, 2)"),
        Field(description="corners [[x, y], [x, y], ...], or a file"),
    ]
    lengths: Annotated[
        Numbers | None,
        array((None,), meaning="(L,)"),
        Field(description="of many lines that follow each other in points: rows of each, or a file"),
    ] = None
    thickness: Annotated[Any, one_or_many(_LINE), Field(description=">= 0; one for all lines, one each, or a file")] = (
        0.0
    )

    @model_validator(mode="after")
    def _fits_together(self) -> "LineTable":
        check_lines(self.points, self._lengths)
        if np.ndim(self.thickness):
            if len(self.thickness) != self.number:
                count = len(self.thickness)
                raise InputError(f"thickness must be one number or {self.number}, one per line; got {count}.")
            checks.non_negative("thickness", float(np.min(self.thickness, initial=0.0)), "[length]")
        return self

    @property
    def _lengths(self) -> NDArray[Any]:
        return np.array([len(self.points)]) if self.lengths is None else self.lengths

    @property
    def number(self) -> int:
        """How many obstacles `made` makes."""
        return len(self._lengths)

    def made(self) -> list[Obstacle]:
        """The obstacles of this table."""
        return [*polylines(self.points, self._lengths, self.thickness)]


def _obstacle_kind(value: Any) -> str:
    keys = value if isinstance(value, dict) else {}
    return "line" if {"points", "lengths", "thickness"} & set(keys) else "pegs" if "places" in keys else "peg"


OBSTACLES: dict[str, type[Table]] = {"peg": PegTable, "pegs": PegsTable, "line": LineTable}
ObstacleTable = Annotated[
    Annotated[PegTable, Tag("peg")] | Annotated[PegsTable, Tag("pegs")] | Annotated[LineTable, Tag("line")],
    Discriminator(_obstacle_kind),
]


class EmitterTable(Table):
    """An Emitter, or several, of which each value may be an array, one row per row of position."""

    position: Annotated[
        Any,
        one_or_many(*_EMITTERS, row=(2,)),
        Field(description="centre of the new disc [x, y]; of many emitters [[x, y], ...], or a file"),
    ]
    velocity: Annotated[
        Any, one_or_many(*_EMITTERS, row=(2,)), Field(description="of the new disc [vx, vy], or likewise")
    ]
    interval: Annotated[
        Any, one_or_many(*_EMITTERS), Field(description="time between two discs; this or every is needed")
    ] = None
    every: Annotated[
        Any,
        one_or_many(*reversed(_EMITTERS)),
        Field(description="instead of interval: frames between two discs, so another scene for each dt"),
    ] = None
    limit: Annotated[Any, one_or_many(*_EMITTERS), Field(description="discs in all; left out: no end")] = None
    radius: Annotated[Any, one_or_many(*_EMITTERS), Field(description="left out: that of all discs")] = None
    mass: Annotated[Any, one_or_many(*_EMITTERS), Field(description="left out: 1, if all discs have that")] = None

    _made: list[Emitter] = PrivateAttr(default_factory=list)

    @model_validator(mode="after")
    def _has_its_times(self, info: ValidationInfo) -> "EmitterTable":
        source = source_of(info)
        source.emitters += np.size(self.position) // 2
        if source.emitters > LARGEST_EMITTERS:
            raise InputError(f"all emitters must be at most {LARGEST_EMITTERS:,}; got {source.emitters:,}. Use fewer.")
        self._made = self._emitters()
        return self

    def made(self) -> list[Emitter]:
        """The emitters."""
        return self._made

    def _emitters(self) -> list[Emitter]:
        each: dict[str, Any] = {name: value for name, value in dict(self).items() if value is not None}
        many = {name for name, value in each.items() if isinstance(value, np.ndarray)}
        if not many:
            return [Emitter(**each)]
        count = len(self.position) if "position" in many else 1
        for name in sorted(many):
            if len(each[name]) != count:
                raise InputError(f"{name} must have {count} rows, one per row of position; got {len(each[name])}.")
            values = each[name].tolist()
            whole = name in ("every", "limit") and all(value.is_integer() for value in values)
            each[name] = [int(value) for value in values] if whole else values
        rows = zip(*(each[name] if name in many else [each[name]] * count for name in each), strict=True)
        return [Emitter(**dict(zip(each, row, strict=True))) for row in rows]


class PistonTable(Table):
    """A Piston."""

    wall: Annotated[str, as_in(*_PISTONS, numbers=False), Field(description="left, right, bottom or top")]
    speed: Annotated[float, as_in(*_PISTONS), Field(description="along x or y, into the box")]
    stop: Annotated[float, as_in(*_PISTONS), Field(description="coordinate at which it comes to rest")]
    start: Annotated[
        float | None,
        as_in(*_PISTONS),
        Field(description="coordinate at which it begins; left out: at its wall"),
    ] = None

    @model_validator(mode="after")
    def _moves_inwards(self) -> "PistonTable":
        self.made()
        return self

    def made(self) -> Piston:
        """The piston."""
        return Piston(**dict(self))


class SceneTable(Table):
    """A scene file."""

    schema_: Annotated[int, plain(_version), Field(alias="schema", description=f"version of the format, {SCHEMA}")]
    width: Annotated[Positive | None, Field(description="of the box")] = None
    height: Annotated[Positive | None, Field(description="of the box")] = None
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
    gravity: Annotated[Any, as_in(_SCENE), Field(description="[gx, gy], one acceleration for all discs")] = None
    restitution: Annotated[float, as_in(_SCENE), Field(description="of two discs, 0 to 1")] = 1.0
    wall_restitution: Annotated[float, as_in(_SCENE), Field(description="of a disc and a wall or obstacle")] = 1.0
    absorbing: Annotated[
        Any,
        as_in(_SCENE, words=True),
        Field(description='edges at which discs leave: a list of "left", "right", "bottom", "top"'),
    ] = ()
    duration: Annotated[
        float | None, as_in(_SCENE), Field(description="how long it should run to show what it is about")
    ] = None
    about: Annotated[About | None, Field(description="for people")] = None
    settings: Annotated[SettingsTable | None, Field(description="recommended ones")] = None
    discs: Annotated[list[Discs], Field(description="groups of discs")] = []
    obstacles: Annotated[list[ObstacleTable], Field(description="what stands in the box")] = []
    emitters: Annotated[list[EmitterTable], Field(description="where discs enter")] = []
    piston: Annotated[PistonTable | None, Field(description="a wall that moves")] = None

    @model_validator(mode="after")
    def _box_is_given_once(self) -> "SceneTable":
        both = self.width is not None and self.height is not None
        if (self.packing is None) != both or (self.packing is not None and (self.width or self.height)):
            raise InputError(
                "the box must be given either by packing or by width and height; "
                f"got packing={self.packing!r}, width={self.width!r}, height={self.height!r}."
            )
        return self


LEVELS: dict[str, type[Table]] = {
    "": SceneTable,
    "about": About,
    "settings": SettingsTable,
    "discs": Discs,
    "emitters": EmitterTable,
    "piston": PistonTable,
}
"""Tables by the key that holds them; those of obstacles are in OBSTACLES."""


def keys_of(table: type[Table]) -> list[str]:
    """The keys of a table, as they are written."""
    return [field.alias or name for name, field in table.model_fields.items()]


def reference() -> str:
    """All keys as tables in Markdown, for docs/scenes.md."""
    titles = {"": "The file itself", **{name: f"`[{name}]`" for name in ("about", "settings", "piston")}}
    titles |= {name: f"`[[{name}]]`" for name in ("discs", "emitters")}
    parts = [(titles[name], table) for name, table in LEVELS.items() if name != "settings"]
    kinds = {"peg": "a disc", "pegs": "discs on a lattice", "line": "chains of walls"}
    parts[3:3] = [(f"`[[obstacles]]`: {kinds[name]}", table) for name, table in OBSTACLES.items()]
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
