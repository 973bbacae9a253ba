"""Features in scene files: their tables, how they are made and written."""

from contextlib import suppress
from itertools import chain, groupby
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Discriminator, Field, PrivateAttr, Tag, ValidationInfo, model_validator

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.features import FEATURES
from mpsim.features.emitters import LARGEST_EMITTERS, Emitter
from mpsim.features.feature import Feature, SceneLike
from mpsim.features.obstacles import (
    LARGEST_OBSTACLES,
    OBSTACLES,
    FixedDisc,
    Obstacle,
    Polyline,
    capsules_of,
    check_lines,
    fixed_discs,
    polylines,
)
from mpsim.scene.scenefile.rules import (
    INLINE,
    Files,
    Numbers,
    Region,
    Spacing,
    Table,
    array_lines,
    array_of,
    as_in,
    one_or_many,
    pairs,
    plain,
    source_of,
)
from mpsim.scene.starts import LATTICES, lattice_sites

# --- A feature in scene files: its tables, how its values are made from them, and how it is written

Problem = tuple[str, str]
"""Key path, and the problem there."""


Tables = tuple[tuple[str, str, type[Table]], ...]
"""Of each kind of a table its name in the annotation, its title in the docs, its class."""


class Part:
    """The tables of one feature.

    Attributes:
        argument: of Scene; the key of the tables.
        several: whether there may be many tables, [[argument]].
        tables: for each kind its name in the annotation ("" if there is only one), its title in the docs, its class.
        annotation, default, description: of the key.
        relies_on_discs: whether missing values come from the discs of the scene.
        advice: what keeps a file with very many of them short, to follow "Let ".
    """

    argument: str
    several: bool = True
    tables: Tables
    annotation: Any
    default: Any = []  # noqa: RUF012 - pydantic copies it
    description: str
    relies_on_discs: bool = False
    advice: str = ""

    def made(self, tables: list[Any], problems: list[Problem]) -> tuple[list[Any], list[int]]:
        """The values of all tables, and the table number of each; problems are appended."""
        values = [each.made() for each in tables]
        owners = [index for index, some in enumerate(values) for _ in some]
        return [value for some in values for value in some], owners

    def capsules(self, values: list[Any]) -> NDArray[np.float64]:
        """Capsules that discs must not overlap, shape (K, 5)."""
        return np.empty((0, 5))

    def lines(self, scene: SceneLike, target: Path, files: Files) -> list[str]:
        """Its tables as lines of a file; files of its arrays are appended."""
        raise NotImplementedError


class SinglePart(Part):
    """The table of a feature that a scene has once: its keys are the fields of the feature's class."""

    several = False
    default = None

    def __init__(self, feature: Feature):
        (kind,) = feature.kinds
        examples = [(kind, example) for example in feature.examples]
        words = {name for name, value in feature.examples[0].items() if isinstance(value, str)}

        class SingleTable(Table):
            @model_validator(mode="after")
            def _fits_together(self) -> "SingleTable":
                self.made()
                return self

            def made(self) -> Any:
                """The value."""
                return kind(**dict(self))

        fields: dict[str, Any] = {
            name: (
                Annotated[Any, as_in(*examples, numbers=name not in words), Field(description=meaning)],
                ... if name in feature.examples[0] else None,
            )
            for name, meaning in feature.keys.items()
        }
        table = pydantic.create_model(f"{kind.__name__}Table", __base__=SingleTable, **fields)
        table.__doc__ = f"A {kind.__name__}."
        self._feature = feature
        self.argument: str = feature.argument
        self.tables: Tables = (("", f"`[{feature.argument}]`", table),)
        self.annotation: Any = table | None
        self.description: str = feature.meaning

    def lines(self, scene: SceneLike, target: Path, files: Files) -> list[str]:
        """One table."""
        value = self._feature.of(scene)
        return [] if value is None else [f"[{self.argument}]", *pairs(vars(value)), ""]


# --- Obstacles in scene files: [[obstacles]]

_PEG = (FixedDisc, {"position": (0.0, 0.0), "radius": 1.0})
_LINE = (Polyline, {"points": ((0.0, 0.0), (1.0, 0.0)), "thickness": 0.0})


class PegTable(Table):
    """A FixedDisc."""

    position: Annotated[
        Numbers,
        array_of((2,), (None, 2), meaning="(2,) or (K, 2)"),
        Field(description="centre [x, y]; of many discs [[x, y], ...], or a file"),
    ]
    radius: Annotated[
        float | Numbers,
        array_of((), (None,), meaning="() or (K,)", unit="[length]"),
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
        array_of((None, 2), meaning="(K, 2)"),
        Field(description="corners [[x, y], [x, y], ...], or a file"),
    ]
    lengths: Annotated[
        Numbers | None,
        array_of((None,), meaning="(L,)"),
        Field(description="if points holds several lines: number of points of each, or a file"),
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


def _are_too_many(tables: list[Any]) -> bool:
    """Whether the tables have more obstacles than are allowed; those that cannot be counted are left out."""
    found = 0
    for each in tables:
        with suppress(InputError):
            found += each.number
        if found > LARGEST_OBSTACLES:
            return True
    return False


class ObstaclesPart(Part):
    """Discs, discs on a lattice, and chains of walls."""

    argument = "obstacles"
    tables: Tables = (
        ("peg", "`[[obstacles]]`: a disc", PegTable),
        ("pegs", "`[[obstacles]]`: discs on a lattice", PegsTable),
        ("line", "`[[obstacles]]`: chains of walls", LineTable),
    )
    annotation = list[
        Annotated[
            Annotated[PegTable, Tag("peg")] | Annotated[PegsTable, Tag("pegs")] | Annotated[LineTable, Tag("line")],
            Discriminator(_obstacle_kind),
        ]
    ]
    description = "obstacles in the box"
    advice = "discs follow discs and lines follow lines among the obstacles"

    def made(self, tables: list[Any], problems: list[Problem]) -> tuple[list[Any], list[int]]:
        """All obstacles, and the number of the table of each."""
        made: list[Obstacle] = []
        owners: list[int] = []
        if _are_too_many(tables):
            text = f"obstacles must be at most {LARGEST_OBSTACLES:,}; got more. Use fewer, or a larger spacing."
            problems.append(("obstacles", text))
            return [], []
        for index, each in enumerate(tables):
            try:
                some = each.made()
            except InputError as error:
                problems.append((f"obstacles[{index}]", str(error)))
                continue
            made += some
            owners += [index] * len(some)
        return made, owners

    def capsules(self, values: list[Any]) -> NDArray[np.float64]:
        """The capsules of all obstacles."""
        return capsules_of(tuple(values))

    def lines(self, scene: SceneLike, target: Path, files: Files) -> list[str]:
        """A table for each obstacle; a single one for many consecutive discs, or many consecutive Polylines."""
        lines: list[str] = []
        for kind, group in groupby(OBSTACLES.of(scene), type):
            alike = list(group)
            if len(alike) > INLINE and kind in _TOGETHER:
                arrays = _TOGETHER[kind](alike)
                lines += ["[[obstacles]]", *array_lines(arrays, target, f"obstacles-{len(files)}.", files), ""]
                continue
            for obstacle in alike:
                values = dict(vars(obstacle))
                if values.get("thickness") == 0:
                    del values["thickness"]
                points = {name: values.pop(name) for name in ("points",) if len(values.get(name, ())) > INLINE}
                lines += ["[[obstacles]]", *array_lines(points, target, f"obstacles-{len(files)}.", files)]
                lines += [*pairs(values), ""]
        return lines


def _discs_together(discs: list[Any]) -> dict[str, Any]:
    """Arrays of a table of many FixedDiscs."""
    return {name: [getattr(each, name) for each in discs] for name in ("position", "radius")}


def _lines_together(polylines: list[Any]) -> dict[str, Any]:
    """Arrays of a table of many Polylines."""
    points = list(chain.from_iterable(each.points for each in polylines))
    arrays: dict[str, Any] = {"points": points, "lengths": [len(each.points) for each in polylines]}
    if any(each.thickness for each in polylines):
        arrays["thickness"] = [each.thickness for each in polylines]
    return arrays


_TOGETHER = {FixedDisc: _discs_together, Polyline: _lines_together}
"""Kinds that have a table of many; each obstacle of another kind has a table of its own."""


# --- Emitters in scene files: [[emitters]]

_EMITTERS = tuple(
    (Emitter, {"position": (0.0, 0.0), "velocity": (0.0, 0.0), **timing})
    for timing in ({"interval": 1.0}, {"every": 1})
)


class EmitterTable(Table):
    """An Emitter, or several: then each value may be an array, one row per row of position."""

    position: Annotated[
        Any,
        one_or_many(*_EMITTERS, row=(2,)),
        Field(description="centre of the new disc [x, y]; of many emitters [[x, y], ...], or a file"),
    ]
    velocity: Annotated[
        Any,
        one_or_many(*_EMITTERS, row=(2,)),
        Field(description="of the new disc [vx, vy]; of many emitters [[vx, vy], ...], or a file"),
    ]
    interval: Annotated[
        Any, one_or_many(*_EMITTERS), Field(description="time between two discs; this or every is needed")
    ] = None
    every: Annotated[
        Any,
        one_or_many(*reversed(_EMITTERS)),
        Field(description="instead of interval: frames between two discs, so another scene for each dt"),
    ] = None
    limit: Annotated[Any, one_or_many(*_EMITTERS), Field(description="total number of discs; default: no limit")] = None
    radius: Annotated[Any, one_or_many(*_EMITTERS), Field(description="default: the radius of all discs")] = None
    mass: Annotated[Any, one_or_many(*_EMITTERS), Field(description="default: 1, if all discs have mass 1")] = None

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


class EmittersPart(Part):
    """Where discs enter."""

    argument = "emitters"
    tables: Tables = (("", "`[[emitters]]`", EmitterTable),)
    annotation = list[EmitterTable]
    description = "where discs enter"
    relies_on_discs = True
    advice = "emitters those with the same keys"

    def lines(self, scene: SceneLike, target: Path, files: Files) -> list[str]:
        """A table for each emitter; a single one for many consecutive ones with values for the same keys."""
        lines: list[str] = []
        for names, group in groupby(
            getattr(scene, self.argument),
            lambda each: [name for name, value in vars(each).items() if value is not None],
        ):
            alike = list(group)
            if len(alike) > INLINE:
                arrays = {name: [getattr(each, name) for each in alike] for name in names}
                lines += ["[[emitters]]", *array_lines(arrays, target, f"emitters-{len(files)}.", files), ""]
                continue
            for emitter in alike:
                lines += ["[[emitters]]", *pairs(vars(emitter)), ""]
        return lines


# --- The list of all features in scene files

PARTS: tuple[Part, ...] = (
    ObstaclesPart(),
    EmittersPart(),
    *(SinglePart(feature) for feature in FEATURES if feature.keys),
)
