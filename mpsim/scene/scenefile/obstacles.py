"""Obstacles in scene files: [[obstacles]]."""

from contextlib import suppress
from itertools import chain, groupby
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag, model_validator

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.features.feature import SceneLike
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
from mpsim.scene.scenefile.arrays import INLINE
from mpsim.scene.scenefile.part import Part, Problem, Tables
from mpsim.scene.scenefile.rules import Numbers, Region, Spacing, Table, array_of, as_in, one_or_many, plain
from mpsim.scene.scenefile.toml import Files, array_lines, pairs
from mpsim.scene.starts import LATTICES, lattice_sites

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
